//! Joints between links.

use super::{natural, number, origin, vector};
use crate::files::FileError;
use crate::model::{Joint, JointKind, Limit, Softness};
use crate::rotation::{Pose, unit};
use crate::xml::{Element, hint, shorten};
use std::collections::HashMap;

/// A joint with the indices of its links.
pub(crate) struct Hinged<'a> {
    pub element: &'a Element,
    pub parent: usize,
    pub child: usize,
}

impl<'a> Hinged<'a> {
    pub fn new(element: &'a Element, links: &HashMap<&'a str, usize>) -> Result<Self, FileError> {
        const READ: [&str; 6] = ["parent", "child", "origin", "axis", "limit", "dynamics"];
        const IGNORED: [&str; 3] = ["calibration", "safety_controller", "mimic"];
        for child in &element.children {
            let name = child.name.as_str();
            if name == "mimic" {
                return Err(child.error("coupled joints are not supported; remove `mimic`"));
            }
            if !READ.contains(&name) && !IGNORED.contains(&name) {
                let hint = hint(name, READ.into_iter().chain(IGNORED));
                return Err(child.error(format!("unknown element in a joint; {hint}")));
            }
        }
        let link = |role: &str| {
            let child = element.child(role);
            let name = child.and_then(|c| c.get("link")).unwrap_or("");
            links.get(name).copied().ok_or_else(|| {
                let hint = hint(name, links.keys().copied());
                let name = shorten(name);
                child.unwrap_or(element).error(format!("unknown link `{name}` as {role}; {hint}"))
            })
        };
        Ok(Self { element, parent: link("parent")?, child: link("child")? })
    }

    /// Pose of the child in the frame of the parent.
    pub fn pose(&self) -> Result<Pose, FileError> {
        origin(self.element)
    }

    /// The joint of a body; none if it is fixed.
    pub fn motion(&self, body: usize) -> Result<Option<Joint>, FileError> {
        let element = self.element;
        let kind = match element.get("type").unwrap_or("") {
            "fixed" => return Ok(None),
            "revolute" | "continuous" => JointKind::Hinge,
            "prismatic" => JointKind::Slide,
            "floating" => JointKind::Free,
            "planar" => {
                let what = "planar joints are not supported; use two prismatic joints and a hinge";
                return Err(element.error(what));
            }
            other => {
                const KNOWN: [&str; 5] =
                    ["revolute", "continuous", "prismatic", "fixed", "floating"];
                let (other, hint) = (shorten(other), hint(other, KNOWN));
                return Err(element.error(format!("unknown type `{other}`; {hint}")));
            }
        };
        let mut joint = Joint::new(self.element.get("name").unwrap_or(""), body, kind);
        if kind == JointKind::Free {
            return Ok(Some(joint));
        }
        let axis = match element.child("axis") {
            Some(axis) => vector(axis, "xyz")?.unwrap_or([1.0, 0.0, 0.0]),
            None => [1.0, 0.0, 0.0],
        };
        joint.axis =
            unit(axis).ok_or_else(|| element.error("its axis has length 0; correct it"))?;
        if let Some(dynamics) = element.child("dynamics") {
            joint.damping = natural(dynamics, "damping", 0.0)?;
            joint.friction_loss = natural(dynamics, "friction", 0.0)?;
        }
        (joint.limit, joint.force_range) = self.limits()?;
        Ok(Some(joint))
    }

    /// Ranges of position and of force or torque.
    fn limits(&self) -> Result<(Option<Limit>, Option<[f64; 2]>), FileError> {
        let endless = self.element.get("type") == Some("continuous");
        let Some(limit) = self.element.child("limit") else {
            return match endless {
                true => Ok((None, None)),
                false => Err(self.element.error("has no limits; add `limit`")),
            };
        };
        let effort = natural(limit, "effort", 0.0)?;
        let force = (effort > 0.0).then_some([-effort, effort]);
        if endless {
            return Ok((None, force));
        }
        let low = number(limit, "lower")?.unwrap_or(0.0);
        let high = number(limit, "upper")?.unwrap_or(0.0);
        if low >= high {
            return Err(limit.error(
                "`lower` must be less than `upper`; make the joint `fixed` or `continuous` instead",
            ));
        }
        let limit = Limit { range: [low, high], margin: 0.0, softness: Softness::default() };
        Ok((Some(limit), force))
    }
}
