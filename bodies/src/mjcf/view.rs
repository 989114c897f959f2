//! Attributes of an element together with those of its default classes.

use crate::files::FileError;
use crate::rotation::{self, Pose};
use crate::xml::{Element, hint, shorten};

/// The attributes that an element may have.
pub(crate) struct Known {
    /// Attributes that the reader uses.
    pub read: &'static [&'static str],
    /// Attributes that do not change the physics here.
    pub ignored: &'static [&'static str],
    /// Attributes that would change it, with the value that does not and with advice.
    pub refused: &'static [(&'static str, &'static str, &'static str)],
}

impl Known {
    fn names(&self) -> impl Iterator<Item = &'static str> {
        let refused = self.refused.iter().map(|r| r.0);
        self.read.iter().chain(self.ignored).copied().chain(refused)
    }

    /// Refuses attributes that no MJCF element of this kind has.
    pub fn check(&self, element: &Element) -> Result<(), FileError> {
        for (name, _) in &element.attributes {
            if !self.names().any(|known| known == name) {
                let hint = hint(name, self.names());
                return Err(element.error(format!("unknown attribute `{}`; {hint}", shorten(name))));
            }
        }
        Ok(())
    }
}

/// How files write angles and rotations.
#[derive(Clone, Copy)]
pub(crate) struct Angles {
    /// Unit of angles in rad.
    pub unit: f64,
    /// Axes of Euler angles.
    pub sequence: [u8; 3],
}

/// An element with the elements of its default classes: the outermost class first, the element
/// itself last. A later layer replaces the numbers that it has; the rest of a list stays.
pub(crate) struct View<'a> {
    layers: Vec<&'a Element>,
}

impl<'a> View<'a> {
    /// The layers must not be empty.
    pub fn new(layers: Vec<&'a Element>) -> Self {
        assert!(!layers.is_empty());
        Self { layers }
    }

    pub fn layers(&self) -> &[&'a Element] {
        &self.layers
    }

    /// The element itself.
    pub fn element(&self) -> &'a Element {
        self.layers[self.layers.len() - 1]
    }

    pub fn error(&self, what: impl Into<String>) -> FileError {
        self.element().error(what)
    }

    /// The last layer that has the attribute.
    pub fn holder(&self, name: &str) -> Option<&'a Element> {
        self.layers.iter().rev().find(|e| e.get(name).is_some()).copied()
    }

    pub fn text(&self, name: &str) -> Option<&'a str> {
        self.holder(name).and_then(|e| e.get(name))
    }

    /// An error at the element that has the attribute.
    pub fn error_at(&self, name: &str, what: impl Into<String>) -> FileError {
        self.holder(name).unwrap_or(self.element()).error(what)
    }

    /// Refuses unknown attributes, and attributes that the physics here lacks.
    pub fn check(&self, known: &Known) -> Result<(), FileError> {
        known.check(self.element())?;
        for (name, harmless, advice) in known.refused {
            let Some(holder) = self.holder(name) else { continue };
            let value = holder.get(name).unwrap_or("").trim();
            let zero = *harmless == "0"
                && value.split_ascii_whitespace().all(|w| w.parse::<f64>().is_ok_and(|x| x == 0.0));
            if !zero && !harmless.split('|').any(|h| h == value) {
                return Err(holder.error(format!("`{name}` is not supported; {advice}")));
            }
        }
        Ok(())
    }

    /// Numbers over defaults. A layer may have fewer numbers.
    pub fn fill<const N: usize>(
        &self,
        name: &str,
        mut values: [f64; N],
    ) -> Result<[f64; N], FileError> {
        for layer in self.layers.iter().filter(|l| l.get(name).is_some()) {
            for (value, new) in values.iter_mut().zip(layer.numbers(name, 0, N)?) {
                *value = new;
            }
        }
        Ok(values)
    }

    /// As many numbers as the attribute must have.
    pub fn exact<const N: usize>(&self, name: &str) -> Result<Option<[f64; N]>, FileError> {
        let Some(holder) = self.holder(name) else { return Ok(None) };
        let mut values = [0.0; N];
        values.copy_from_slice(&holder.numbers(name, N, N)?);
        Ok(Some(values))
    }

    pub fn number(&self, name: &str, default: f64) -> Result<f64, FileError> {
        Ok(self.exact::<1>(name)?.map_or(default, |[value]| value))
    }

    /// A number of at least zero, or the default.
    pub fn natural(&self, name: &str, default: f64) -> Result<f64, FileError> {
        let value = self.number(name, default)?;
        if value < 0.0 && self.holder(name).is_some() {
            return Err(self.error_at(name, format!("`{name}` is negative; it must be at least 0")));
        }
        Ok(value)
    }

    /// A polynomial of which only the first number is supported.
    pub fn linear(&self, name: &str) -> Result<f64, FileError> {
        let [first, rest @ ..] = self.fill(name, [0.0; 3])?;
        if rest != [0.0; 2] {
            return Err(self.error_at(
                name,
                format!("`{name}` is a polynomial; only its first number is supported"),
            ));
        }
        Ok(first)
    }

    /// A whole number of 32 bits.
    pub fn integer(&self, name: &str, default: i32) -> Result<i32, FileError> {
        match self.text(name) {
            None => Ok(default),
            Some(text) => text.trim().parse().map_err(|_| {
                let text = shorten(text);
                self.error_at(name, format!("`{name}` has `{text}`, not a whole number of 32 bits"))
            }),
        }
    }

    /// The index of a word of a list.
    pub fn word(&self, name: &str, words: &[&str], default: usize) -> Result<usize, FileError> {
        let Some(text) = self.text(name) else { return Ok(default) };
        words.iter().position(|w| *w == text).ok_or_else(|| {
            let list = words.join(", ");
            self.error_at(name, format!("`{name}` is `{}`; it can be {list}", shorten(text)))
        })
    }

    pub fn flag(&self, name: &str, default: bool) -> Result<bool, FileError> {
        Ok(self.word(name, &["false", "true"], usize::from(default))? == 1)
    }

    /// A range, if it applies: by the word `true`, or by `auto` with numbers that increase.
    pub fn range(
        &self,
        name: &str,
        limited: &str,
        auto: bool,
    ) -> Result<Option<[f64; 2]>, FileError> {
        let [low, high] = self.exact(name)?.unwrap_or([0.0; 2]);
        let choice = self.word(limited, &["false", "true", "auto"], 2)?;
        if choice == 0 {
            return Ok(None);
        }
        if low > high || (choice == 1 && low == high) {
            return Err(self.error_at(
                if self.holder(name).is_some() { name } else { limited },
                format!("`{name}` must have a lower and a higher number, if it applies"),
            ));
        }
        if choice == 2 && low < high && !auto {
            return Err(self.error_at(
                name,
                format!("`{name}` without `{limited}`, and `autolimits` is false; add `{limited}`"),
            ));
        }
        Ok((low < high).then_some([low, high]))
    }

    /// Position and orientation.
    pub fn pose(&self, angles: Angles) -> Result<Pose, FileError> {
        Ok(Pose {
            position: self.exact("pos")?.unwrap_or([0.0; 3]),
            rotation: self.rotation(angles)?.unwrap_or(rotation::IDENTITY),
        })
    }

    /// Orientation, of the last layer that has one.
    pub fn rotation(&self, angles: Angles) -> Result<Option<[[f64; 3]; 3]>, FileError> {
        const NOTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];
        for layer in self.layers.iter().rev() {
            let mut used = NOTATIONS.iter().filter(|n| layer.get(n).is_some());
            let Some(notation) = used.next() else { continue };
            if let Some(other) = used.next() {
                let what = format!("has `{notation}` and `{other}`; remove one of them");
                return Err(layer.error(what));
            }
            return orientation(layer, notation, angles).map(Some);
        }
        Ok(None)
    }
}

fn orientation(
    element: &Element,
    notation: &str,
    angles: Angles,
) -> Result<[[f64; 3]; 3], FileError> {
    let count = match notation {
        "quat" | "axisangle" => 4,
        "xyaxes" => 6,
        _ => 3,
    };
    let v = element.numbers(notation, count, count)?;
    let matrix = match notation {
        "quat" => rotation::unit([v[0], v[1], v[2], v[3]]).map(rotation::from_quaternion),
        "axisangle" => {
            rotation::unit([v[0], v[1], v[2]]).map(|a| rotation::about(a, v[3] * angles.unit))
        }
        "euler" => {
            let angle = [v[0], v[1], v[2]].map(|a| a * angles.unit);
            Some(rotation::from_euler(angle, angles.sequence))
        }
        "xyaxes" => rotation::from_xy([v[0], v[1], v[2]], [v[3], v[4], v[5]]),
        _ => rotation::from_z([v[0], v[1], v[2]]),
    };
    matrix.ok_or_else(|| element.error(format!("`{notation}` has no direction; its length is 0")))
}
