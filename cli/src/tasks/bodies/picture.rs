//! [`film`]: an animation of articulated bodies.
//!
//! A [`Camera`](camera::Camera) projects the outlines of shapes ([`solid`]) and the floor
//! ([`ground`]) onto the picture, which has the origin at the target of the camera.

mod camera;
mod colour;
mod force;
mod ground;
mod solid;
mod space;

use camera::Camera;
use force::Forces;
pub use force::Touching;
use physgrad_bodies::model::{Form, Model};
use physgrad_plot::{Animation, Shape, View};
use solid::{Outline, Solid};
use space::{Pose, Vec3};

/// Largest number of frames. Longer motions are thinned.
const MAX_FRAMES: usize = 400;
/// Absolute value of a coordinate from which bodies count as diverged, m.
const FAR: f64 = 1e6;
/// Margin of the view, as a share of the reach of the bodies.
const MARGIN: f64 = 0.15;
/// Smallest width of a view, in heights: first of a camera that stays, then of one that follows.
const WIDTH: [f64; 2] = [1.2, 1.5];
/// Smallest height of a view, in widths.
const HEIGHT: f64 = 1.0 / 3.0;

/// Animates a motion. `poses` has the positions and orientations of all bodies, `dt` seconds apart, and
/// `touching` the contact forces at the same times.
///
/// Planar models are drawn from the side or from above, others in perspective. The camera follows
/// bodies that move freely. Motions shorter than 2 s play at one third of real time. The animation
/// ends before the first pose that is non-finite or beyond 1e6 m.
pub fn film(
    model: &Model,
    poses: &[Vec<Pose>],
    touching: &[Touching],
    dt: f64,
    title: &str,
) -> Animation {
    let near = |(bodies, _): &(&Vec<Pose>, &Touching)| {
        bodies.iter().all(|(at, _)| at.iter().all(|x| x.abs() < FAR))
    };
    let shown: Vec<(&Vec<Pose>, &Touching)> = poses.iter().zip(touching).take_while(near).collect();
    let time = shown.len().saturating_sub(1) as f64 * dt;
    let (slowness, speed) = if time < 2.0 { (3.0, "at ⅓ speed") } else { (1.0, "in real time") };

    let camera = Camera::of(model);
    let solids = solid::of(model);
    let count = shown.len().min(MAX_FRAMES);
    let motion: Vec<(&Vec<Pose>, &Touching)> =
        (0..count).map(|frame| shown[frame * (shown.len() - 1) / (count - 1).max(1)]).collect();
    let frames: Vec<Frame> =
        motion.iter().map(|(poses, _)| Frame::new(model, &camera, &solids, poses)).collect();
    let mut forces = Forces::new(model, &camera, &motion);
    let view = view(&camera, frames.iter().flat_map(|frame| &frame.outlines));
    let reach = [-1.0, 1.0].map(|sign| [sign * camera.reach; 2]);
    Animation {
        title: format!("{title}: {time:.1} s {speed}"),
        seconds: time * slowness,
        view,
        reach: Some(union(view, (reach[0], reach[1]))),
        legend: legend(!forces.is_empty()),
        frames: { frames.into_iter().zip(motion) }
            .map(|(frame, (poses, touching))| {
                // Beyond the identifiers of solids and their shadows.
                let arrows = forces.at(poses, touching, 3 * solids.len());
                [frame.shapes(&camera, &solids), arrows].concat()
            })
            .collect(),
        // In perspective, lengths depend on the distance.
        unit: if camera.is_planar() { "m" } else { "" },
        time,
        ..Animation::default()
    }
}

/// The legend of a film with or without contact forces.
pub fn legend(has_forces: bool) -> Vec<(String, &'static str)> {
    has_forces.then(|| ("contact force".to_owned(), colour::FORCE)).into_iter().collect()
}

/// What the camera sees at one time.
struct Frame {
    ground: Vec<Shape>,
    shadows: Vec<Outline>,
    /// One per solid.
    outlines: Vec<Outline>,
}

impl Frame {
    fn new(model: &Model, camera: &Camera, solids: &[Solid], poses: &[Pose]) -> Self {
        let target = camera.target(poses);
        let planes = model.shapes.iter().filter(|shape| shape.form == Form::Plane);
        let planes: Vec<Pose> = planes.map(|plane| space::placed(poses, plane)).collect();
        let seen = |place: &dyn Fn(Vec3) -> Vec3| -> Vec<Outline> {
            let see = |point: Vec3| camera.see(target, place(point));
            solids.iter().map(|solid| solid.outline(poses, see)).collect()
        };
        let floor = planes.iter().find(|plane| !camera.is_planar() && ground::is_floor(plane));
        Self {
            ground: ground::of(&planes, camera, target),
            shadows: floor.map_or(Vec::new(), |floor| seen(&|x| ground::below(floor, x))),
            outlines: seen(&|x| x),
        }
    }

    /// The shapes in the order of painting.
    fn shapes(self, camera: &Camera, solids: &[Solid]) -> Vec<Shape> {
        let edge = 0.008 * camera.reach;
        // Rounding must not decide between solids of equal depth.
        let rank = |i: &usize| (-1e6 * self.outlines[*i].depth / camera.reach).round();
        let mut order: Vec<usize> = (0..solids.len()).collect();
        order.sort_by(|i, j| rank(i).total_cmp(&rank(j)));
        let shape = |id: usize, outline: &Outline, width: f64, color: &str| Shape::Solid {
            id,
            points: outline.points.clone(),
            width,
            color: color.into(),
        };
        let n = solids.len();
        let shadows = self.shadows.iter().enumerate();
        let shadows = shadows.map(|(i, o)| shape(2 * n + i, o, 0.6 * o.width, colour::SHADOW));
        let bodies = order.iter().flat_map(|&i| {
            let (outline, solid) = (&self.outlines[i], &solids[i]);
            [
                shape(2 * i, outline, outline.width + edge, &solid.edge),
                shape(2 * i + 1, outline, outline.width - edge, &solid.colour),
            ]
        });
        self.ground.iter().cloned().chain(shadows).chain(bodies).collect()
    }
}

/// The view of all outlines, but not of what is far away from the target.
fn view<'a>(camera: &Camera, outlines: impl Iterator<Item = &'a Outline>) -> View {
    let (far, margin) = (2.0 * camera.reach, MARGIN * camera.reach);
    let start = ([-2.0 * margin; 2], [2.0 * margin; 2]);
    let (mut low, mut high) = outlines.fold(start, |view, outline| {
        let radius = margin + 0.5 * outline.width;
        outline.points.iter().fold(view, |view, point| {
            let end = |sign: f64| point.map(|x| (x + sign * radius).clamp(-far, far));
            union(view, (end(-1.0), end(1.0)))
        })
    });
    let size = [high[0] - low[0], high[1] - low[1]];
    let smallest = [WIDTH[usize::from(camera.follows())] * size[1], HEIGHT * size[0]];
    for i in 0..2 {
        let missing = (smallest[i] - size[i]).max(0.0);
        (low[i], high[i]) = (low[i] - missing / 2.0, high[i] + missing / 2.0);
    }
    (low, high)
}

/// Smallest rectangle that contains both.
fn union(a: View, b: View) -> View {
    let pick = |i: usize| (a.0[i].min(b.0[i]), a.1[i].max(b.1[i]));
    let (x, y) = (pick(0), pick(1));
    ([x.0, y.0], [x.1, y.1])
}

#[cfg(test)]
mod tests;
