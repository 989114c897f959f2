//! Reader of URDF, the robot descriptions of ROS.
//!
//! Links become bodies, also those of fixed joints. The outermost link is fixed in the world, or is
//! the world if its name is `world`. Every hinge and slide has a motor of its name, whose control
//! is the torque or force. Lengths are in m, angles in rad.

mod joint;
mod link;
#[cfg(test)]
mod tests;

use crate::files::FileError;
use crate::mass::immovable;
use crate::model::{Actuator, Body, JointKind, Model, Options, Transmission};
use crate::names;
use crate::rotation::{IDENTITY, Pose};
use crate::xml::{self, Element, hint, shorten};
use joint::Hinged;
use std::collections::HashMap;
use std::path::Path;

/// Reads a model from a file.
///
/// # Errors
///
/// If the file cannot be read, is malformed, or has something that is not supported.
pub fn read(path: &Path) -> Result<Model, FileError> {
    model(&xml::read(path)?)
}

/// Reads a model from text. The name of its file appears in errors.
///
/// # Errors
///
/// If the text is malformed, or has something that is not supported.
pub fn parse(text: &str, name: &str) -> Result<Model, FileError> {
    model(&xml::parse(text, name)?)
}

fn model(root: &Element) -> Result<Model, FileError> {
    if root.name != "robot" {
        return Err(root.error("is not URDF; its outermost element must be `robot`"));
    }
    let mut model = Model {
        name: root.get("name").unwrap_or("robot").to_string(),
        options: Options::default(),
        bodies: Vec::new(),
        joints: Vec::new(),
        shapes: Vec::new(),
        sites: Vec::new(),
        actuators: Vec::new(),
        excluded: Vec::new(),
        poses: Vec::new(),
        remarks: Vec::new(),
    };
    let parts = Parts::new(root)?;
    let order = parts.order(root)?;
    build(&parts, &order, &mut model)?;
    if let Some((body, what)) = immovable(&model.bodies, &model.joints) {
        let name = model.bodies[body].name.as_str();
        let link = parts.links.iter().find(|l| l.get("name") == Some(name)).unwrap_or(&root);
        return Err(link.error(what));
    }
    names::fill(&mut model);
    parts.remarks(root, &mut model);
    Ok(model)
}

/// Links and joints of a file.
struct Parts<'a> {
    links: Vec<&'a Element>,
    joints: Vec<Hinged<'a>>,
}

impl<'a> Parts<'a> {
    fn new(root: &'a Element) -> Result<Self, FileError> {
        const READ: [&str; 2] = ["link", "joint"];
        // Extensions of simulators and drawing, named in a remark.
        const IGNORED: [&str; 6] =
            ["material", "transmission", "gazebo", "ros2_control", "mujoco", "sensor"];
        let mut by_name = HashMap::new();
        let mut parts = Self { links: Vec::new(), joints: Vec::new() };
        for element in &root.children {
            if element.name.contains(':') {
                return Err(element.error("macros are not expanded; run xacro first"));
            }
            match element.name.as_str() {
                "link" => {
                    let name = named(element)?;
                    if by_name.insert(name, parts.links.len()).is_some() {
                        return Err(element.error("another link has the same name; rename one"));
                    }
                    parts.links.push(element);
                }
                name if READ.contains(&name) || IGNORED.contains(&name) => {}
                other => {
                    let hint = hint(other, READ.into_iter().chain(IGNORED));
                    return Err(element.error(format!("unknown element; {hint}")));
                }
            }
        }
        let mut names = HashMap::new();
        for element in root.children.iter().filter(|e| e.name == "joint") {
            if names.insert(named(element)?, ()).is_some() {
                return Err(element.error("another joint has the same name; rename one of them"));
            }
            parts.joints.push(Hinged::new(element, &by_name)?);
        }
        Ok(parts)
    }

    /// The links with their joints to their parents: the outermost first, then branch by branch in
    /// the order of the joints.
    fn order(&self, root: &Element) -> Result<Vec<(usize, Option<usize>)>, FileError> {
        let mut parents = vec![None; self.links.len()];
        let mut children = vec![Vec::new(); self.links.len()];
        for (i, joint) in self.joints.iter().enumerate() {
            if parents[joint.child].replace(i).is_some() {
                return Err(joint.element.error("its child is the child of another joint as well"));
            }
            children[joint.parent].push(i);
        }
        let mut outermost = (0..self.links.len()).filter(|l| parents[*l].is_none());
        let Some(first) = outermost.next() else {
            return Err(root.error("no link is outermost; a robot is a tree of links"));
        };
        if let Some(second) = outermost.next() {
            let name = self.links[first].get("name").unwrap_or("");
            return Err(self.links[second].error(format!(
                "no joint leads to this link, and none leads to `{}`; join them",
                shorten(name)
            )));
        }
        let mut order = Vec::new();
        let mut open = vec![(first, None)];
        while let Some((link, joint)) = open.pop() {
            order.push((link, joint));
            open.extend(children[link].iter().rev().map(|j| (self.joints[*j].child, Some(*j))));
        }
        if order.len() < self.links.len() {
            return Err(root.error("some links form a loop; a robot is a tree of links"));
        }
        Ok(order)
    }

    /// Names what the file has and what is left out.
    fn remarks(&self, root: &Element, model: &mut Model) {
        let within = |parts: &mut dyn Iterator<Item = &'a Element>, name: &str| {
            parts.flat_map(|p| &p.children).filter(|c| c.name == name).count()
        };
        let count = |name: &str| root.children.iter().filter(|c| c.name == name).count();
        let simulators = ["gazebo", "mujoco", "ros2_control", "sensor"].map(count).iter().sum();
        let velocity =
            |j: &&Hinged| j.element.child("limit").is_some_and(|l| l.get("velocity").is_some());
        for (count, what) in [
            (within(&mut self.links.iter().copied(), "visual"), "Visual shapes are only drawn"),
            (count("transmission"), "Transmissions are not read, each joint has a motor"),
            (simulators, "Elements for other programs are not read"),
            (self.joints.iter().filter(velocity).count(), "Limits of velocities do not act"),
        ] {
            match count {
                0 => {}
                1 => model.remarks.push(format!("{what}; 1 is left out.")),
                _ => model.remarks.push(format!("{what}; {count} are left out.")),
            }
        }
    }
}

/// The name of a link or joint.
fn named(element: &Element) -> Result<&str, FileError> {
    match element.get("name") {
        Some(name) if !name.is_empty() => Ok(name),
        _ => Err(element.error("has no name; add `name`")),
    }
}

/// Makes bodies, joints, shapes and motors.
fn build(
    parts: &Parts,
    order: &[(usize, Option<usize>)],
    model: &mut Model,
) -> Result<(), FileError> {
    model.bodies.push(Body::new("world", 0, [0.0; 3], IDENTITY));
    let mut index = vec![0; parts.links.len()];
    let mut meshes = Vec::new();
    for (link, joint) in order {
        let element = parts.links[*link];
        let name = named(element)?;
        let outermost = joint.is_none();
        if name == "world" && !outermost {
            return Err(element.error("only the outermost link can be `world`; rename it"));
        }
        if !(name == "world" && outermost) {
            index[*link] = model.bodies.len();
            let (parent, pose) = match joint.map(|j| &parts.joints[j]) {
                Some(joint) => (index[joint.parent], joint.pose()?),
                None => (0, Pose::IDENTITY),
            };
            let mut body = Body::new(name, parent, pose.position, pose.rotation);
            link::weigh(element, &mut body)?;
            model.bodies.push(body);
        }
        link::shapes(element, index[*link], model, &mut meshes)?;
        if let Some(joint) = joint.map(|j| &parts.joints[j]) {
            join(joint, index[*link], model)?;
        }
    }
    if let Some(first) = meshes.first() {
        let (count, file) = (meshes.len(), shorten(first));
        model.remarks.push(format!(
            "Meshes do not touch; {count} left out of the collisions, the first `{file}`."
        ));
    }
    Ok(())
}

/// Adds the joint and its motor.
fn join(joint: &Hinged, body: usize, model: &mut Model) -> Result<(), FileError> {
    let Some(motion) = joint.motion(body)? else { return Ok(()) };
    if motion.kind == JointKind::Free && model.bodies[body].parent != 0 {
        return Err(joint.element.error(
            "the parent of a floating joint must be a link with the name `world`, without parent",
        ));
    }
    if motion.kind != JointKind::Free {
        model.actuators.push(Actuator {
            name: motion.name.clone(),
            on: Transmission::Joint(model.joints.len()),
            gear: 1.0,
            gain: 1.0,
            bias: [0.0; 3],
            control_range: motion.force_range,
            force_range: None,
        });
    }
    model.joints.push(motion);
    Ok(())
}

/// Position and orientation of the child `origin` of an element, if it has one.
fn origin(element: &Element) -> Result<Pose, FileError> {
    let Some(origin) = element.child("origin") else { return Ok(Pose::IDENTITY) };
    Ok(Pose {
        position: vector(origin, "xyz")?.unwrap_or([0.0; 3]),
        rotation: crate::rotation::from_euler(vector(origin, "rpy")?.unwrap_or([0.0; 3]), *b"XYZ"),
    })
}

fn vector(element: &Element, name: &str) -> Result<Option<[f64; 3]>, FileError> {
    match element.get(name) {
        None => Ok(None),
        Some(_) => element.numbers(name, 3, 3).map(|v| Some([v[0], v[1], v[2]])),
    }
}

fn number(element: &Element, name: &str) -> Result<Option<f64>, FileError> {
    match element.get(name) {
        None => Ok(None),
        Some(_) => element.numbers(name, 1, 1).map(|v| Some(v[0])),
    }
}

/// A number of at least zero; the default without one.
fn natural(element: &Element, name: &str, default: f64) -> Result<f64, FileError> {
    match number(element, name)?.unwrap_or(default) {
        value if value >= 0.0 => Ok(value),
        _ => Err(element.error(format!("`{name}` is negative; it must be at least 0"))),
    }
}
