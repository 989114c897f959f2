//! Actuators of hinges and slides.

use super::classes::Classes;
use super::drive::Drive;
use super::known;
use super::view::View;
use crate::files::FileError;
use crate::model::{Actuator, Joint, JointKind};
use crate::xml::{Element, hint, shorten};
use std::collections::HashMap;

/// Reads an actuator. All kinds share one set of defaults in a class.
pub(crate) fn actuator<'a>(
    element: &'a Element,
    classes: &Classes<'a>,
    joints: &[Joint],
    by_name: &HashMap<String, usize>,
    auto_limits: bool,
) -> Result<Actuator, FileError> {
    let known = match element.name.as_str() {
        "general" => known::GENERAL,
        "motor" => known::MOTOR,
        "position" => known::POSITION,
        "velocity" => known::VELOCITY,
        other => return Err(element.error(refusal(other))),
    };
    let names: Vec<&str> = known::ACTUATORS.into_iter().chain(known::OTHER_ACTUATORS).collect();
    let groups = classes.groups(element, 0, &names)?;
    let view = View::new(groups.concat());
    view.check(&known)?;
    let joint = joint(&view, joints, by_name)?;
    let drive = Drive::of(&groups)?;
    let [gear, ..] = view.fill::<6>("gear", [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])?;
    Ok(Actuator {
        name: element.get("name").unwrap_or("").to_string(),
        joint,
        gear,
        gain: drive.gain[0],
        bias: if drive.biased { drive.bias } else { [0.0; 3] },
        control_range: view.range("ctrlrange", "ctrllimited", auto_limits)?,
        force_range: view.range("forcerange", "forcelimited", auto_limits)?,
    })
}

/// Why an element is not an actuator that is read.
pub(crate) fn refusal(name: &str) -> String {
    if known::OTHER_ACTUATORS.contains(&name) {
        let list = known::ACTUATORS.join(", ");
        format!("this actuator is not supported; those that are supported are {list}")
    } else {
        format!("unknown actuator; {}", hint(name, known::ACTUATORS))
    }
}

/// The hinge or slide that the actuator names.
fn joint(
    view: &View,
    joints: &[Joint],
    by_name: &HashMap<String, usize>,
) -> Result<usize, FileError> {
    // For scalar joints both attributes mean the same.
    let (attribute, name) = match (view.text("joint"), view.text("jointinparent")) {
        (Some(_), Some(_)) => {
            return Err(view.error("has `joint` and `jointinparent`; remove one of them"));
        }
        (None, Some(name)) => ("jointinparent", name),
        (Some(name), None) => ("joint", name),
        (None, None) => return Err(view.error("has no joint; add `joint`")),
    };
    let Some(index) = by_name.get(name) else {
        let hint = hint(name, by_name.keys().map(String::as_str));
        let name = shorten(name);
        return Err(view.error_at(attribute, format!("unknown joint `{name}`; {hint}")));
    };
    if matches!(joints[*index].kind, JointKind::Ball | JointKind::Free) {
        return Err(view.error_at(
            attribute,
            "actuators of ball and free joints are not supported; use hinges and slides",
        ));
    }
    Ok(*index)
}
