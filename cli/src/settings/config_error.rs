//! Errors in settings, and functions that check single values.

use crate::settings::reading::Unreadable;
use physgrad::Number;
use std::fmt::Display;
use std::ops::RangeInclusive;
use toml::Value;

/// An invalid setting. The caller adds file and line.
#[derive(Debug, thiserror::Error)]
#[error("`{key}` {what}")]
pub struct ConfigError {
    /// Dotted key: `system.dt`.
    pub key: String,
    /// Message after the key: value found and values allowed.
    pub what: String,
}

/// Keys of earlier versions and their replacements.
const RENAMED_KEYS: [(&str, &str); 4] = [
    ("policy.zero_last", "policy.zero_init_output"),
    ("effects.bumpers.reach", "effects.bumpers.half_travel"),
    ("system.reach", "system.contact_distance"),
    ("loss.effort", "loss.control_weight"),
];

/// Values of earlier versions: key, old value, new value.
const RENAMED_VALUES: [(&str, &str, &str); 2] =
    [("loss.mode", "final", "terminal"), ("loss.mode", "continuous", "running")];

/// Allowed values of a count whose range is unknown.
pub const WHOLE_NUMBER: &str = "a whole number, 0 or more";

impl ConfigError {
    pub fn new(key: impl Into<String>, what: impl Into<String>) -> Self {
        Self { key: key.into(), what: what.into() }
    }

    /// Translates a serde error into key, value found and values allowed.
    pub fn unreadable(error: &Unreadable) -> Self {
        let Unreadable { key, message } = error;
        let within = |field: &str| {
            format!("{key}.{}", field.trim_end_matches('`')).trim_start_matches('.').to_owned()
        };
        if let Some(field) = message.strip_prefix("missing field `") {
            return Self::new(within(field), "is missing");
        }
        if let Some((field, expected)) =
            message.strip_prefix("unknown field `").and_then(|rest| rest.split_once("`, "))
        {
            if let Some((_, new)) = RENAMED_KEYS.into_iter().find(|(old, _)| *old == within(field))
            {
                return Self::new(within(field), format!("was renamed; write `{new}`"));
            }
            let allowed = expected
                .strip_prefix("expected ")
                .map_or("nothing", |names| names.trim_start_matches("one of "));
            return Self::new(within(field), format!("is unknown; allowed: {allowed}"));
        }
        let Some((found, expected)) = message.rsplit_once(", expected ") else {
            return Self::new(key, format!("is invalid: {message}"));
        };
        if let Some((_, old, new)) = RENAMED_VALUES
            .into_iter()
            .find(|(renamed, old, _)| renamed == key && found.ends_with(&format!("`{old}`")))
        {
            return Self::new(key, format!("= \"{old}\" was renamed; write \"{new}\""));
        }
        let starts = ["invalid type: ", "invalid value: ", "invalid length ", "unknown variant "];
        let found = starts.iter().find_map(|start| found.strip_prefix(start)).unwrap_or(found);
        let found = if found == "sequence" { "a list" } else { found };
        let expected = match expected {
            "usize" | "u64" => WHOLE_NUMBER,
            "f64" => "a number",
            "a sequence" => "a list",
            "an array of length 2" => "a list of 2",
            "fewer elements" => "a shorter list",
            section if section.starts_with("struct ") => "a section",
            names => names.trim_start_matches("one of "),
        };
        Self::new(key, format!("is {found}; allowed: {expected}"))
    }

    /// Adds further allowed names to the error of an unknown key of this section.
    pub fn also_allowed(
        mut self,
        section: &str,
        names: impl Iterator<Item = &'static str>,
    ) -> Self {
        let is_of_section = self.key.rsplit_once('.').is_some_and(|(parent, _)| parent == section);
        if is_of_section && self.what.starts_with("is unknown") {
            names.for_each(|name| {
                self.what = match self.what.strip_suffix("nothing") {
                    Some(none) => format!("{none}`{name}`"),
                    None => format!("{}, `{name}`", self.what),
                };
            });
        }
        self
    }

    /// Error of a setting with an invalid value. `value` is `None` if the value is unknown.
    pub fn invalid(key: &str, value: Option<&Value>, allowed: &str) -> Self {
        let found = match value {
            // Omits the decimal point of a whole number.
            Some(Value::Float(value)) => value.to_string(),
            Some(value) => value.to_string(),
            None => "invalid".into(),
        };
        Self::new(key, format!("is {found}; allowed: {allowed}"))
    }

    /// Error of a setting that another setting makes ineffective.
    pub fn unread(key: &str, value: impl Display, because: &str) -> Self {
        Self::new(key, format!("is {value}, but has no effect: {because}"))
    }
}

/// Returns an error unless `is_allowed`.
pub fn allowed(
    key: &str,
    value: impl Display,
    is_allowed: bool,
    allowed: impl Display,
) -> Result<(), ConfigError> {
    if is_allowed {
        Ok(())
    } else {
        Err(ConfigError::new(key, format!("is {value}; allowed: {allowed}")))
    }
}

/// Returns an error unless the extreme values of the number satisfy `is_allowed`.
fn every(
    key: &str,
    number: Number,
    is_allowed: fn(f64) -> bool,
    what: &str,
) -> Result<(), ConfigError> {
    number.extremes().into_iter().try_for_each(|value| allowed(key, value, is_allowed(value), what))
}

/// Returns an error unless the number is finite and positive.
pub fn positive(key: &str, number: impl Into<Number>) -> Result<(), ConfigError> {
    every(key, number.into(), |value| value.is_finite() && value > 0.0, "a positive number")
}

/// Returns an error unless the number is finite and not negative.
pub fn not_negative(key: &str, number: impl Into<Number>) -> Result<(), ConfigError> {
    every(key, number.into(), |value| value.is_finite() && value >= 0.0, "0 or more")
}

/// Returns an error if more than one of these effects is present.
pub fn exclusive(effects: &[(&str, bool)], because: &str) -> Result<(), ConfigError> {
    let mut present = effects.iter().filter(|(_, present)| *present).map(|(name, _)| *name);
    match (present.next(), present.next()) {
        (Some(first), Some(second)) => Err(ConfigError::new(
            format!("effects.{second}"),
            format!("cannot be combined with `effects.{first}`: {because}; allowed: one of them"),
        )),
        _ => Ok(()),
    }
}

/// Returns an error unless the number is finite.
pub fn finite(key: &str, number: impl Into<Number>) -> Result<(), ConfigError> {
    every(key, number.into(), f64::is_finite, "a finite number")
}

/// Returns an error unless the value is within the range.
pub fn count(key: &str, value: usize, range: RangeInclusive<usize>) -> Result<(), ConfigError> {
    allowed(key, value, range.contains(&value), format!("{} to {}", range.start(), range.end()))
}
