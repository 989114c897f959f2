//! Names of the state components of a model, and of numbers that follow from a state.

use crate::model::{JointKind, Model};
use crate::system::Bodies;
use physgrad::Scalar;
use physgrad::graph::Quantities;

/// Components of the position of a free joint, and of its velocity.
const FREE: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];
const FREE_SPEED: [&str; 6] = ["x", "y", "z", "wx", "wy", "wz"];

/// A name as a word of expressions: other characters than letters, digits and `_` become `_`.
pub fn word(name: &str) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '_' };
    name.chars().map(letter).collect()
}

/// Names of the positions: `JOINT`, and `JOINT_x` to `JOINT_qz` for ball and free joints.
pub fn positions(model: &Model) -> Vec<String> {
    components(model, &FREE, 3)
}

/// Names of the velocities: `JOINT`, and `JOINT_x` to `JOINT_wz` for ball and free joints.
pub fn velocities(model: &Model) -> Vec<String> {
    components(model, &FREE_SPEED, 3)
}

fn components(model: &Model, free: &[&str], turn: usize) -> Vec<String> {
    let of = |joint: &crate::model::Joint| {
        let name = word(&joint.name);
        let list = match joint.kind {
            JointKind::Slide | JointKind::Hinge => return vec![name],
            JointKind::Ball => &free[turn..],
            JointKind::Free => free,
        };
        list.iter().map(|component| format!("{name}_{component}")).collect()
    };
    model.joints.iter().flat_map(of).collect()
}

/// Names of the state: `qpos.` and `qvel.` before those of positions and velocities.
pub fn states(model: &Model) -> Vec<String> {
    let positions = positions(model).into_iter().map(|name| format!("qpos.{name}"));
    positions.chain(velocities(model).into_iter().map(|name| format!("qvel.{name}"))).collect()
}

/// Names of the controls: those of the actuators.
pub fn controls(model: &Model) -> Vec<String> {
    model.actuators.iter().map(|actuator| word(&actuator.name)).collect()
}

/// Indices of the state components that are angles of hinges in rad.
pub fn angles(model: &Model) -> Vec<usize> {
    let mut index = 0;
    let mut angles = Vec::new();
    for joint in &model.joints {
        if joint.kind == JointKind::Hinge {
            angles.push(index);
        }
        index += match joint.kind {
            JointKind::Slide | JointKind::Hinge => 1,
            JointKind::Ball => 4,
            JointKind::Free => 7,
        };
    }
    angles
}

/// Positions of bodies and sites in axes of the world, m, and the z axes of bodies: `body.NAME.x`,
/// `.y`, `.z`, `body.NAME.up` (the z component of the body's z axis), `site.NAME.x`, `.y`, `.z`,
/// and the centre of mass of all bodies, `com.x`, `.y`, `.z`.
impl Quantities for Bodies {
    fn names(&self) -> Vec<String> {
        let model = self.model();
        let axes = |kind: &str, name: &str| {
            ["x", "y", "z"].map(|axis| format!("{kind}.{}.{axis}", word(name)))
        };
        let mut names = Vec::new();
        for body in &model.bodies[1..] {
            names.extend(axes("body", &body.name));
            names.push(format!("body.{}.up", word(&body.name)));
        }
        for site in &model.sites {
            names.extend(axes("site", &site.name));
        }
        names.extend(["com.x", "com.y", "com.z"].map(str::to_owned));
        names
    }

    fn of<T: Scalar>(&self, x: &[T], p: &[T]) -> Vec<T> {
        let model = self.model();
        let poses = self.poses(x, p);
        let point = |body: usize, at: [T; 3]| -> [T; 3] {
            let (position, turn) = &poses[body];
            std::array::from_fn(|i| {
                position[i] + turn[i][0] * at[0] + turn[i][1] * at[1] + turn[i][2] * at[2]
            })
        };
        let mut all = Vec::new();
        for (position, turn) in &poses[1..] {
            all.extend(position);
            all.push(turn[2][2]);
        }
        for site in &model.sites {
            all.extend(point(site.body, site.position.map(T::from)));
        }
        let masses = self.masses(p);
        let (mut total, mut centre) = (T::zero(), [T::zero(); 3]);
        for (index, &(mass, at)) in masses.iter().enumerate().skip(1) {
            let at = point(index, at);
            total += mass;
            for i in 0..3 {
                centre[i] += at[i] * mass;
            }
        }
        let centre = centre.map(|moment| moment / total);
        all.extend(centre);
        all
    }
}
