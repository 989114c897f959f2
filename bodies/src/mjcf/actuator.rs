//! Actuators of hinges, slides and fixed tendons.

use super::classes::Classes;
use super::drive::Drive;
use super::known;
use super::tendon::{Tendons, ends, scalar_joint};
use super::view::View;
use crate::files::FileError;
use crate::model::{Actuator, Joint, Transmission};
use crate::xml::{Element, hint, shorten};
use std::collections::HashMap;

/// What actuators may act on.
pub(crate) struct Targets<'a, 'b> {
    pub joints: &'b [Joint],
    pub by_name: HashMap<String, usize>,
    pub tendons: Tendons<'a>,
    pub classes: &'b Classes<'a>,
}

/// Reads an actuator. All kinds share one set of defaults in a class.
pub(crate) fn actuator<'a>(
    element: &'a Element,
    targets: &Targets<'a, '_>,
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
    let groups = targets.classes.groups(element, 0, &names)?;
    let view = View::new(groups.concat());
    view.check(&known)?;
    let on = transmission(&view, targets)?;
    let drive = Drive::of(&groups)?;
    let [gear, ..] = view.fill::<6>("gear", [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])?;
    Ok(Actuator {
        name: element.get("name").unwrap_or("").to_string(),
        on,
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

/// The joint or tendon that the actuator names.
fn transmission<'a>(view: &View<'a>, targets: &Targets<'a, '_>) -> Result<Transmission, FileError> {
    // For scalar joints both attributes of joints mean the same.
    let mut named =
        ["joint", "jointinparent", "tendon"].into_iter().filter(|name| view.text(name).is_some());
    let Some(attribute) = named.next() else {
        return Err(view.error("has no joint; add `joint`"));
    };
    if let Some(other) = named.next() {
        return Err(view.error(format!("has `{attribute}` and `{other}`; remove one of them")));
    }
    let Targets { joints, by_name, tendons, classes } = targets;
    if attribute != "tendon" {
        return scalar_joint(view, attribute, joints, by_name).map(Transmission::Joint);
    }
    let name = view.text(attribute).unwrap_or("");
    let Some(tendon) = tendons.get(name) else {
        let hint = hint(name, tendons.keys().copied());
        let name = shorten(name);
        return Err(view.error_at(attribute, format!("unknown tendon `{name}`; {hint}")));
    };
    ends(tendon, classes, joints, by_name).map(Transmission::Tendon)
}
