//! Actuators of hinges and slides.

use super::classes::Classes;
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
    let view = classes.view(element, 0, &names)?;
    view.check(&known)?;
    let joint = joint(&view, joints, by_name)?;
    let drive = Drive::of(&view)?;
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

fn refusal(name: &str) -> String {
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

/// The law of force, while the layers of an actuator apply in sequence.
struct Drive<'a> {
    /// The kind of the last layer that set the law.
    kind: &'static str,
    gain: [f64; 10],
    bias: [f64; 3],
    biased: bool,
    /// Whether the dynamics are those of a position actuator with a time constant.
    filtered: bool,
    /// The layers whose gain, bias or dynamics are not supported, with the reason.
    unsupported: [Option<(&'a Element, String)>; 3],
}

impl<'a> Drive<'a> {
    const NEW: Self = Self {
        kind: "general",
        gain: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        bias: [0.0; 3],
        biased: false,
        filtered: false,
        unsupported: [None, None, None],
    };

    fn of(view: &View<'a>) -> Result<Self, FileError> {
        let mut drive = Self::NEW;
        for layer in view.layers() {
            drive.apply(layer)?;
        }
        match drive.unsupported.iter().flatten().next() {
            Some((element, what)) => Err(element.error(what)),
            None => Ok(drive),
        }
    }

    /// Applies an element of a class or the actuator itself.
    fn apply(&mut self, layer: &'a Element) -> Result<(), FileError> {
        let view = View::new(vec![layer]);
        match layer.name.as_str() {
            "general" => return self.general(&view),
            "motor" => *self = Self { kind: "motor", ..Self::NEW },
            "position" => self.position(&view)?,
            "velocity" => {
                self.begin("velocity");
                let kv = view.natural("kv", self.gain[0])?;
                self.set(kv, [0.0, 0.0, -kv]);
            }
            other => {
                *self = Self { kind: "other", ..Self::NEW };
                self.refuse(0, layer, &refusal(other));
            }
        }
        Ok(())
    }

    /// The proportional and damping gains are those of the layers before, unless this layer has
    /// them.
    fn position(&mut self, view: &View<'a>) -> Result<(), FileError> {
        let layer = view.element();
        self.begin("position");
        let filter = self.unsupported[2].take().filter(|_| self.filtered);
        let kp = view.number("kp", self.gain[0])?;
        let kv = view.natural("kv", (-self.bias[2]).max(0.0))?;
        // A damping ratio stands as a positive number in the place of the damping.
        let inherited = view.text("kv").is_none() && self.bias[2] > 0.0;
        let ratio = view.natural("dampratio", f64::from(inherited))?;
        self.set(kp, [0.0, -kp, -kv]);
        if ratio != 0.0 {
            self.bias[2] = ratio;
            self.refuse(1, layer, "`dampratio` is not supported; write the damping as `kv`");
        }
        if view.number("timeconst", 0.0)? != 0.0 {
            let what = "`timeconst` is not supported; remove it, controls act at once";
            self.refuse(2, layer, what);
        } else if view.text("timeconst").is_none() {
            self.unsupported[2] = filter;
        }
        self.filtered = self.unsupported[2].is_some();
        Ok(())
    }

    /// Begins the law of a shortcut. Only a law of the same kind, or a general law with a fixed
    /// gain, hands its numbers on.
    fn begin(&mut self, kind: &'static str) {
        let same = self.kind == kind || self.kind == "general";
        if !same || self.unsupported[0].is_some() {
            *self = Self::NEW;
        }
        self.kind = kind;
    }

    /// A law without state.
    fn set(&mut self, gain: f64, bias: [f64; 3]) {
        let mut all = [0.0; 10];
        all[0] = gain;
        *self = Self { kind: self.kind, gain: all, bias, biased: true, ..Self::NEW };
    }

    /// Refuses the gain (0), the bias (1) or the dynamics (2), unless a later layer replaces it.
    fn refuse(&mut self, part: usize, layer: &'a Element, what: &str) {
        self.unsupported[part] = Some((layer, what.to_string()));
    }

    fn general(&mut self, view: &View<'a>) -> Result<(), FileError> {
        let layer = view.element();
        self.gain = view.fill("gainprm", self.gain)?;
        let mut bias = [0.0; 10];
        bias[..3].copy_from_slice(&self.bias);
        bias = view.fill("biasprm", bias)?;
        self.bias.copy_from_slice(&bias[..3]);
        let biases = ["none", "affine", "muscle", "dcmotor", "so3", "user"];
        let gains = ["fixed", "affine", "muscle", "dcmotor", "pid", "so3", "user"];
        let dynamics =
            ["none", "integrator", "filter", "filterexact", "pid", "dcmotor", "muscle", "user"];
        self.kind = "general";
        for (part, name, words, supported) in [
            (0, "gaintype", &gains[..], 1),
            (1, "biastype", &biases[..], 2),
            (2, "dyntype", &dynamics[..], 1),
        ] {
            let Some(text) = view.text(name) else { continue };
            let word = view.word(name, words, 0)?;
            self.unsupported[part] = None;
            if word >= supported {
                let advice = words[..supported].join(" or ");
                let what = format!("`{name}` {text} is not supported; it can be {advice}");
                self.refuse(part, layer, &what);
            }
            match name {
                "biastype" => self.biased = word == 1,
                "dyntype" => self.filtered = text == "filterexact",
                _ => {}
            }
        }
        Ok(())
    }
}
