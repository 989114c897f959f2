//! [`Forces`]: arrows of contact forces.
//!
//! All frames have the same arrows, those of the contacts that ever push. Without a force, an arrow is
//! a point without width, where the body last touched.

use super::camera::Camera;
use super::colour::FORCE;
use super::space::{Pose, Vec3, add, length, minus, times, transform};
use physgrad_bodies::ContactForce;
use physgrad_bodies::model::Model;
use physgrad_plot::Shape;
use std::collections::BTreeMap;

/// Forces of contacts at one time.
pub type Touching = Vec<ContactForce<f64>>;

/// Length of an arrow in reaches, for a force of the weight of all bodies.
const WEIGHT: f64 = 0.4;
/// Length of the longest arrows, in reaches. Impacts have larger forces.
const LONGEST: f64 = 1.2;
/// Width of a shaft, and length and width of a head, in reaches.
const SIZES: [f64; 3] = [0.02, 0.1, 0.08];
/// Smallest force that is drawn, in weights.
const LEAST: f64 = 1e-3;
/// Standard gravity, m/s², for models without gravity.
const GRAVITY: f64 = 9.81;

/// Scale of arrows, and where the bodies last touched.
pub struct Forces<'a> {
    camera: &'a Camera,
    /// Length of an arrow per force, m/N.
    scale: f64,
    /// By the contact: body, and the point in its frame.
    last: BTreeMap<usize, (usize, Vec3)>,
}

impl<'a> Forces<'a> {
    /// Arrows of a motion with these poses and forces.
    pub fn new(model: &Model, camera: &'a Camera, motion: &[(&Vec<Pose>, &Touching)]) -> Self {
        let masses: f64 = model.bodies.iter().map(|body| body.mass).sum();
        let gravity = length(model.options.gravity);
        let weight = masses * if gravity > 0.0 { gravity } else { GRAVITY };
        let scale = WEIGHT * camera.reach / weight;
        let mut forces = Self { camera, scale, last: BTreeMap::new() };
        // Before its first force, an arrow is where that will act.
        motion.iter().rev().for_each(|(poses, touching)| forces.place(poses, touching));
        forces
    }

    /// Moves arrows to the contacts that push.
    fn place(&mut self, poses: &[Pose], touching: &Touching) {
        for force in touching {
            if self.arrow(force.force).is_none() {
                continue;
            }
            let pose = &poses[force.body];
            let from = minus(force.point, pose.0);
            let local = [0, 1, 2].map(|j| (0..3).map(|i| pose.1[i][j] * from[i]).sum());
            self.last.insert(force.contact, (force.body, local));
        }
    }

    /// The vector of an arrow.
    fn arrow(&self, force: Vec3) -> Option<Vec3> {
        let size = self.scale * length(force);
        let reach = self.camera.reach;
        let drawn = size > LEAST * WEIGHT * reach && size.is_finite();
        drawn.then(|| times(self.scale * (LONGEST * reach / size).min(1.0), force))
    }

    /// The arrows at the next time, with two solids each from the identifier `first` on.
    pub fn at(&mut self, poses: &[Pose], touching: &Touching, first: usize) -> Vec<Shape> {
        self.place(poses, touching);
        let target = self.camera.target(poses);
        let see = |point: Vec3| self.camera.see(target, point);
        let [thin, head, wide] = SIZES.map(|size| size * self.camera.reach);
        let arrow = |(&contact, (body, local)): (&usize, &(usize, Vec3))| {
            let force = touching.iter().find(|force| force.contact == contact);
            let along = force.and_then(|force| Some((force.point, self.arrow(force.force)?)));
            let start = along.map_or_else(|| transform(&poses[*body], *local), |(point, _)| point);
            let along = along.map_or([0.0; 3], |(_, along)| along);
            let (from, to) = (see(start), see(add(start, along)));
            let flat = [0, 1].map(|i| to.at[i] - from.at[i]);
            let size = flat[0].hypot(flat[1]);
            let unit = if size > 0.0 { flat.map(|x| x / size) } else { [0.0; 2] };
            // Short arrows have small heads.
            let share = (size / (2.0 * head)).min(1.0);
            let (head, wide) = (share * head, share * wide);
            let neck = [0, 1].map(|i| to.at[i] - head * unit[i]);
            let corner = |side: f64| {
                [neck[0] - side * wide * 0.5 * unit[1], neck[1] + side * wide * 0.5 * unit[0]]
            };
            let solid = |id: usize, points: Vec<[f64; 2]>, width: f64| Shape::Solid {
                id,
                points,
                width,
                color: FORCE.into(),
            };
            let id = first + 2 * contact;
            [
                solid(id, vec![from.at, neck], share * thin),
                solid(id + 1, vec![to.at, corner(1.0), corner(-1.0)], 0.0),
            ]
        };
        self.last.iter().flat_map(arrow).collect()
    }

    /// Whether no contact pushes.
    pub fn is_empty(&self) -> bool {
        self.last.is_empty()
    }
}
