//! Fixed tendons: joints with coefficients, on which actuators act.

use super::classes::Classes;
use super::known;
use super::view::View;
use crate::files::FileError;
use crate::model::{Joint, JointKind};
use crate::xml::{Element, hint, shorten};
use std::collections::{HashMap, HashSet};

/// The tendons of a file by name.
pub(crate) type Tendons<'a> = HashMap<&'a str, &'a Element>;

/// Names the tendons, and refuses those that act by themselves. Others only measure, and transmit
/// forces of actuators.
pub(crate) fn named<'a>(
    elements: impl Iterator<Item = &'a Element>,
    classes: &Classes<'a>,
) -> Result<Tendons<'a>, FileError> {
    let mut tendons = Tendons::new();
    for element in elements {
        if !matches!(element.name.as_str(), "fixed" | "spatial") {
            return Err(element.error("unknown tendon; it can be `fixed` or `spatial`"));
        }
        let view = classes.view(element, 0, &["tendon"])?;
        view.check(&known::TENDON)?;
        if view.range("range", "limited", true)?.is_some() {
            return Err(view.error_at("range", "limits of tendons are not supported, remove it"));
        }
        if let Some(name) = element.get("name").filter(|name| !name.is_empty())
            && tendons.insert(name, element).is_some()
        {
            return Err(element.error("another tendon has the same name; rename one of them"));
        }
    }
    Ok(tendons)
}

/// The joints and coefficients of a tendon on which an actuator acts.
pub(crate) fn ends<'a>(
    tendon: &'a Element,
    classes: &Classes<'a>,
    joints: &[Joint],
    by_name: &HashMap<String, usize>,
) -> Result<Vec<(usize, f64)>, FileError> {
    if tendon.name != "fixed" {
        return Err(tendon.error("actuators of spatial tendons are not supported; use `fixed`"));
    }
    let view = classes.view(tendon, 0, &["tendon"])?;
    if view.range("actuatorfrcrange", "actuatorfrclimited", true)?.is_some() {
        let what = "`actuatorfrcrange` is not supported; write `forcerange` to the actuator";
        return Err(view.error_at("actuatorfrcrange", what));
    }
    let mut seen = HashSet::new();
    let mut ends = Vec::new();
    for element in &tendon.children {
        if element.name != "joint" {
            return Err(element.error("unknown element in a fixed tendon; it can be `joint`"));
        }
        let view = View::new(vec![element]);
        view.check(&known::FIXED_JOINT)?;
        let index = scalar_joint(&view, "joint", joints, by_name)?;
        if !seen.insert(index) {
            return Err(element.error("the tendon has this joint twice; add the coefficients"));
        }
        let Some([by]) = view.exact("coef")? else {
            return Err(element.error("has no coefficient; add `coef`"));
        };
        ends.push((index, by));
    }
    if ends.is_empty() {
        return Err(tendon.error("has no joints; add `joint` with `coef`"));
    }
    Ok(ends)
}

/// The hinge or slide that an attribute names.
pub(crate) fn scalar_joint(
    view: &View,
    attribute: &str,
    joints: &[Joint],
    by_name: &HashMap<String, usize>,
) -> Result<usize, FileError> {
    let name = view.text(attribute).unwrap_or("");
    let Some(&index) = by_name.get(name) else {
        let hint = hint(name, by_name.keys().map(String::as_str));
        let name = shorten(name);
        return Err(view.error_at(attribute, format!("unknown joint `{name}`; {hint}")));
    };
    if matches!(joints[index].kind, JointKind::Ball | JointKind::Free) {
        return Err(view.error_at(
            attribute,
            "actuators of ball and free joints are not supported; use hinges and slides",
        ));
    }
    Ok(index)
}
