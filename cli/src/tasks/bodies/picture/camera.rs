//! [`Camera`]: from space to the plane of a picture.

use super::space::{
    AXES, Pose, Vec3, add, cross, dot, length, minus, reference, rotate, times, unit,
};
use physgrad_bodies::model::{Form, Joint, JointKind, Model};

/// Direction of sight onto models that are not planar: mostly along y, so that x points to the right.
const SIGHT: Vec3 = [0.35, 0.85, -0.38];
/// Distance of the eye from the target, in reaches.
const DISTANCE: f64 = 4.0;
/// Smallest distance from the eye along the sight at which something is seen, in distances of the
/// target.
const NEAR: f64 = 0.25;

/// Camera with a fixed direction.
pub struct Camera {
    right: Vec3,
    up: Vec3,
    /// Unit vector away from the eye.
    pub forward: Vec3,
    /// Distance from the eye to the target. `None` for parallel projection along one axis.
    distance: Option<f64>,
    /// Body that the target follows horizontally.
    followed: Option<usize>,
    /// Target while this body is in its reference pose.
    target: Vec3,
    /// Reference position of this body.
    start: Vec3,
    /// Radius of a ball about the target that contains the moving bodies of a standing or following
    /// camera, m.
    pub reach: f64,
}

/// Where a point is in a picture.
#[derive(Clone, Copy)]
pub struct Seen {
    /// Position relative to the target, m at the distance of the target.
    pub at: [f64; 2],
    /// Magnification relative to the target.
    pub scale: f64,
    /// Distance behind the target, m.
    pub depth: f64,
}

impl Camera {
    /// The camera of a model, the same for all its motions.
    pub fn of(model: &Model) -> Self {
        let poses = reference(model);
        let followed = model.joints.iter().find(|joint| is_endless(joint)).map(|joint| joint.body);
        let first = followed.or(model.joints.first().map(|joint| joint.body)).unwrap_or(0);
        let target = poses[first].0;
        let reach = reach(model, &poses, target, followed);
        let [x, y, z] = AXES;
        let (right, up, forward, distance) = match normal(model, &poses) {
            Some(1) => (x, z, y, None),
            Some(2) => (x, y, times(-1.0, z), None),
            Some(_) => (y, z, times(-1.0, x), None),
            None => {
                let forward = unit(SIGHT);
                let right = unit(cross(forward, z));
                (right, cross(right, forward), forward, Some(DISTANCE * reach))
            }
        };
        Self { right, up, forward, distance, followed, target, start: target, reach }
    }

    pub fn is_planar(&self) -> bool {
        self.distance.is_none()
    }

    pub fn follows(&self) -> bool {
        self.followed.is_some()
    }

    /// The target while the bodies have these poses.
    pub fn target(&self, poses: &[Pose]) -> Vec3 {
        let Some(body) = self.followed else { return self.target };
        let [x, y, _] = minus(poses[body].0, self.start);
        add(self.target, [x, y, 0.0])
    }

    pub fn see(&self, target: Vec3, point: Vec3) -> Seen {
        let from = minus(point, target);
        let depth = dot(from, self.forward);
        let scale = self.distance.map_or(1.0, |d| d / (d + depth).max(NEAR * d));
        let at = [self.right, self.up].map(|axis| scale * dot(from, axis));
        Seen { at, scale, depth }
    }

    /// Ends of the visible part of a segment.
    pub fn see_segment(&self, target: Vec3, ends: [Vec3; 2]) -> [[f64; 2]; 2] {
        let nearest = self.distance.map_or(f64::NEG_INFINITY, |d| (NEAR - 1.0) * d);
        let depths = ends.map(|end| self.see(target, end).depth);
        [0, 1].map(|i| {
            let (end, other) = (ends[i], ends[1 - i]);
            let (hidden, all) = (nearest - depths[i], depths[1 - i] - depths[i]);
            let share = if hidden > 0.0 && all > 0.0 { (hidden / all).min(1.0) } else { 0.0 };
            self.see(target, add(end, times(share, minus(other, end)))).at
        })
    }
}

/// Whether a joint lets a body move away without bounds.
fn is_endless(joint: &Joint) -> bool {
    joint.kind == JointKind::Free || joint.kind == JointKind::Slide && joint.limit.is_none()
}

/// Index of the axis of the world along which no body moves, if there is one. First y, so that
/// pictures from the side come before those from above.
fn normal(model: &Model, poses: &[Pose]) -> Option<usize> {
    [1, 2, 0].into_iter().find(|&normal| {
        model.joints.iter().all(|joint| {
            let along = rotate(&poses[joint.body].1, joint.axis)[normal].abs();
            match joint.kind {
                JointKind::Hinge => along > 1.0 - 1e-9,
                JointKind::Slide => along < 1e-9,
                JointKind::Ball | JointKind::Free => false,
            }
        })
    })
}

/// Largest distance of a shape from the target, if the chains of bodies to the shapes are straight.
fn reach(model: &Model, poses: &[Pose], target: Vec3, followed: Option<usize>) -> f64 {
    // Distances of the frames of bodies, without one for bodies that are fixed in the world.
    let mut distances: Vec<Option<f64>> = vec![None];
    for (i, body) in model.bodies.iter().enumerate().skip(1) {
        let joints = || model.joints.iter().filter(move |joint| joint.body == i);
        let Some(first) = joints().next().map(|joint| joint.point) else {
            distances.push(distances[body.parent].map(|d| d + length(body.position)));
            continue;
        };
        let own = match distances[body.parent] {
            _ if followed == Some(i) => 0.0,
            None => length(minus(poses[i].0, target)),
            Some(d) => {
                d + length(add(body.position, rotate(&body.rotation, first))) + length(first)
            }
        };
        distances.push(Some(own + joints().map(slide).sum::<f64>()));
    }
    let shapes = model.shapes.iter().filter(|shape| shape.form != Form::Plane);
    let ends = shapes.filter_map(|shape| {
        Some(distances[shape.body]? + length(shape.position) + radius(&shape.form))
    });
    ends.fold(1e-3, f64::max)
}

/// Largest displacement of a slide with limits.
fn slide(joint: &Joint) -> f64 {
    match (joint.kind, joint.limit) {
        (JointKind::Slide, Some(limit)) => {
            limit.range.iter().map(|x| (x - joint.reference).abs()).fold(0.0, f64::max)
        }
        _ => 0.0,
    }
}

/// Radius of a ball that contains a form about its centre.
fn radius(form: &Form) -> f64 {
    match *form {
        Form::Plane => 0.0,
        Form::Sphere(radius) => radius,
        Form::Capsule(radius, half) => radius + half,
        Form::Cylinder(radius, half) => radius.hypot(half),
        Form::Ellipsoid(axes) => axes.into_iter().fold(0.0, f64::max),
        Form::Box(half) => length(half),
    }
}
