//! Vectors and rotations.

use physgrad_bodies::model::{Mat3, Model, Shape};

pub use physgrad_bodies::model::Vec3;
/// Position and orientation.
pub type Pose = (Vec3, Mat3);

pub const AXES: Mat3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub fn times(factor: f64, a: Vec3) -> Vec3 {
    a.map(|x| factor * x)
}

pub fn minus(a: Vec3, b: Vec3) -> Vec3 {
    add(a, times(-1.0, b))
}

pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn length(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

pub fn unit(a: Vec3) -> Vec3 {
    times(1.0 / length(a), a)
}

pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn rotate(rotation: &Mat3, a: Vec3) -> Vec3 {
    rotation.map(|row| dot(row, a))
}

pub fn transform((position, rotation): &Pose, a: Vec3) -> Vec3 {
    add(*position, rotate(rotation, a))
}

/// The pose whose frame has the pose `inner` in the frame of `outer`.
pub fn compose(outer: &Pose, inner: &Pose) -> Pose {
    let columns = [0, 1, 2].map(|j| rotate(&outer.1, [0, 1, 2].map(|i| inner.1[i][j])));
    let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| columns[j][i]));
    (transform(outer, inner.0), rotation)
}

/// Pose of a shape of a body.
pub fn placed(poses: &[Pose], shape: &Shape) -> Pose {
    compose(&poses[shape.body], &(shape.position, shape.rotation))
}

/// Poses of all bodies in the reference pose.
pub fn reference(model: &Model) -> Vec<Pose> {
    let mut poses: Vec<Pose> = Vec::with_capacity(model.bodies.len());
    for body in &model.bodies {
        let own = (body.position, body.rotation);
        poses.push(poses.get(body.parent).map_or(own, |parent| compose(parent, &own)));
    }
    poses
}
