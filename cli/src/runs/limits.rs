//! [`Limits`]: limits of the settings whose values a run trains.

use crate::scenes::source::SceneSource;
use crate::settings::config_error::Problem;
use crate::tasks::Scene;
use physgrad::Number;
use physgrad::text::digits;
use physgrad::train::Warning;
use std::path::Path;

/// Kind of the warnings. There is one per number.
const KIND: &str = "number outside of its range";

/// Checks values of trained numbers as a scene with these values would.
pub struct Limits {
    source: Option<SceneSource>,
    numbers: Vec<Limited>,
}

/// A trained number.
struct Limited {
    /// Index in the parameters of a rollout.
    index: usize,
    name: String,
    min: f64,
    max: f64,
    /// Smallest and largest value known to be allowed. Values in between need no check.
    allowed: [f64; 2],
}

impl Limits {
    /// Limits of the numbers that the scene trains. `names` are those of the parameters of a
    /// rollout.
    pub fn new(scene: &Scene, names: &[String]) -> Self {
        let limited = |(name, number): (String, Number)| {
            let Number::Trained { start, min, max } = number else { return None };
            let index = names.iter().position(|known| *known == name)?;
            let extremes = number.extremes();
            // The scene is valid, so these values are allowed.
            let low = extremes.iter().copied().fold(start, f64::min);
            let high = extremes.iter().copied().fold(start, f64::max);
            Some(Limited { index, name, min, max, allowed: [low, high] })
        };
        let numbers: Vec<Limited> = scene.varied().into_iter().filter_map(limited).collect();
        let source = (!numbers.is_empty())
            .then(|| SceneSource::inner("the scene", scene.table(), Path::new("")).ok())
            .flatten();
        Self { source, numbers }
    }

    /// Returns whether the scene trains no number.
    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// Warnings about the values after the epoch, each with its index in the parameters of a
    /// rollout. A non-finite value has a warning of the library.
    pub fn warnings(&mut self, epoch: usize, values: &[(usize, f64)]) -> Vec<Warning> {
        let Self { source: Some(source), numbers } = self else { return Vec::new() };
        let warning = |number: &mut Limited| {
            let (_, value) = values.iter().find(|(index, _)| *index == number.index)?;
            let cause = number.refused(source, *value)?;
            let number = Some(number.name.clone());
            Some(Warning { epoch, kind: KIND, number, cause, divergence: None })
        };
        numbers.iter_mut().filter_map(warning).collect()
    }
}

impl Limited {
    /// Text about this value if the scene does not allow it.
    fn refused(&mut self, source: &SceneSource, value: f64) -> Option<String> {
        let [low, high] = self.allowed;
        // Rounding can lead past a bound.
        let value = value.max(self.min).min(self.max);
        if !value.is_finite() || (low..=high).contains(&value) {
            return None;
        }
        let mut source = source.clone();
        source.fix(&self.name, value).ok()?;
        let section = |key: &str| key.split('.').next().map(str::to_owned);
        // Other settings may have limits that depend on this number.
        let error = source.refusal().filter(|error| section(&error.key) == section(&self.name));
        let Some(error) = error else {
            self.allowed = [low.min(value), high.max(value)];
            return None;
        };
        let Self { name, .. } = self;
        let why = match &error.problem {
            Problem::Value { allowed, .. } if error.key == *name => {
                format!("outside of its range; allowed: {allowed}")
            }
            _ => format!("which a scene cannot have: {error}"),
        };
        Some(format!(
            "training moves {name} to {}, {why}. Add bounds within the range to [fit]: min, or min and max",
            digits(value, 6)
        ))
    }
}
