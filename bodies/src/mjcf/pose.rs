//! Keyframes: named poses.

use super::known;
use super::view::View;
use crate::files::FileError;
use crate::model::{JointKind, Model};
use crate::rotation::{to_quaternion, unit};
use std::collections::HashSet;

/// Largest count of numbers of all poses. A key without numbers has as many as the model.
const NUMBERS: usize = 1_000_000;

/// Reads the positions of all keyframes.
pub(crate) fn poses(root: &crate::xml::Element, model: &mut Model) -> Result<(), FileError> {
    let start = reference(model);
    let mut names = HashSet::new();
    let sections = root.children.iter().filter(|c| c.name == "keyframe");
    for key in sections.flat_map(|s| &s.children) {
        if key.name != "key" {
            return Err(key.error("unknown element in `keyframe`; did you mean `key`?"));
        }
        let view = View::new(vec![key]);
        view.check(&known::KEY)?;
        let name = match key.get("name") {
            Some(name) if !name.is_empty() => name.to_string(),
            _ => format!("key{}", model.poses.len()),
        };
        if !names.insert(name.clone()) {
            return Err(key.error("another key has the same name; rename one of them"));
        }
        if (model.poses.len() + 1) * start.len() > NUMBERS {
            return Err(
                key.error(format!("the keys have more than {NUMBERS} numbers; remove some"))
            );
        }
        let positions = match view.text("qpos") {
            None => start.clone(),
            Some(_) => normal(model, key.numbers("qpos", start.len(), start.len())?)
                .ok_or_else(|| key.error("`qpos` has a quaternion of length 0; correct it"))?,
        };
        let moving = ["qvel", "act", "ctrl"].into_iter().filter(|a| view.text(a).is_some());
        let left: Vec<String> = moving.map(|a| format!("`{a}`")).collect();
        if !left.is_empty() {
            let list = left.join(" and ");
            model.remarks.push(format!("Of the key `{name}`, {list} is left out."));
        }
        model.poses.push((name, positions));
    }
    Ok(())
}

/// Positions of the joints in the reference pose.
fn reference(model: &Model) -> Vec<f64> {
    let mut positions = Vec::new();
    for joint in &model.joints {
        match joint.kind {
            JointKind::Slide | JointKind::Hinge => positions.push(joint.reference),
            JointKind::Ball => positions.extend([1.0, 0.0, 0.0, 0.0]),
            JointKind::Free => {
                let body = &model.bodies[joint.body];
                positions.extend(body.position);
                positions.extend(to_quaternion(&body.rotation));
            }
        }
    }
    positions
}

/// The positions with unit quaternions.
fn normal(model: &Model, mut positions: Vec<f64>) -> Option<Vec<f64>> {
    let mut at = 0;
    for joint in &model.joints {
        at += match joint.kind {
            JointKind::Slide | JointKind::Hinge => 1,
            JointKind::Ball => 0,
            JointKind::Free => 3,
        };
        if matches!(joint.kind, JointKind::Ball | JointKind::Free) {
            let quaternion: [f64; 4] = positions[at..at + 4].try_into().ok()?;
            positions[at..at + 4].copy_from_slice(&unit(quaternion)?);
            at += 4;
        }
    }
    Some(positions)
}
