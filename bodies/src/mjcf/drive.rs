//! Laws of force of actuators.
//!
//! A class has one law, that all kinds of actuators share. The rules of inheritance are those that
//! MuJoCo 4.0 shows with random files.

use super::actuator::refusal;
use super::view::View;
use crate::files::FileError;
use crate::xml::Element;

/// The law of force, while the elements of the classes and the actuator itself apply in sequence.
#[derive(Clone)]
pub(crate) struct Drive<'a> {
    /// The kind of the last element that set the law.
    kind: &'static str,
    pub gain: [f64; 10],
    pub bias: [f64; 3],
    pub biased: bool,
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

    /// The law of an actuator. The groups are the elements of its classes, the outermost class
    /// first, and the actuator itself.
    pub fn of(groups: &[Vec<&'a Element>]) -> Result<Self, FileError> {
        let mut laws: Vec<Self> = Vec::new();
        for group in groups {
            let mut law = laws.last().cloned().unwrap_or(Self::NEW);
            for element in group {
                law.apply(element, &laws)?;
            }
            laws.push(law);
        }
        let law = laws.pop().unwrap_or(Self::NEW);
        match law.unsupported.iter().flatten().next() {
            Some((element, what)) => Err(element.error(what)),
            None => Ok(law),
        }
    }

    /// Applies an element of a class with these outer laws, or the actuator itself.
    fn apply(&mut self, layer: &'a Element, outer: &[Self]) -> Result<(), FileError> {
        let view = View::new(vec![layer]);
        match layer.name.as_str() {
            "general" => return self.general(&view),
            "motor" => *self = Self { kind: "motor", ..Self::NEW },
            "position" => {
                self.begin("position", outer);
                self.position(&view)?;
            }
            "velocity" => {
                self.begin("velocity", outer);
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

    /// Begins the law of a shortcut. A law of the same kind, or a general law with a fixed gain,
    /// hands its numbers on; if this one does not, the innermost of the outer laws that does.
    fn begin(&mut self, kind: &'static str, outer: &[Self]) {
        let hands_on = |law: &Self| {
            (law.kind == kind || law.kind == "general") && law.unsupported[0].is_none()
        };
        if !hands_on(self) {
            *self = outer.iter().rev().find(|law| hands_on(law)).cloned().unwrap_or(Self::NEW);
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
