//! Errors in settings, and functions that check single values.

use physgrad::Number;
use serde::de::{self, Expected, Unexpected};
use std::fmt::{self, Display};
use std::ops::RangeInclusive;
use toml::Value;

/// An invalid setting. The caller adds file and line.
#[derive(Debug, thiserror::Error)]
#[error("`{key}` {problem}")]
pub struct ConfigError {
    /// Dotted key, for example `policy.widths[1]`. Empty for the whole table.
    pub key: String,
    /// What is wrong with the setting.
    pub problem: Problem,
}

/// What is wrong with a setting.
#[derive(Debug)]
pub enum Problem {
    Missing,
    /// No setting has this key. `hint` is a question about a similar key, or empty.
    Unknown {
        allowed: Vec<&'static str>,
        hint: String,
    },
    /// A value that is not allowed.
    Value {
        found: String,
        allowed: String,
    },
    /// A value that should be a whole number, with the range of the setting if it is known.
    NotWhole {
        found: String,
        range: Option<String>,
    },
    /// Any other problem, as text after the key.
    Other(String),
}

impl Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => write!(f, "is missing"),
            Self::Unknown { allowed, hint } => {
                write!(f, "is unknown; allowed: {}{hint}", one_of(allowed))
            }
            Self::Value { found, allowed } => write!(f, "is {found}; allowed: {allowed}"),
            Self::NotWhole { found, range } => {
                let range = range.as_deref().unwrap_or("0 or more");
                write!(f, "is {found}; allowed: a whole number, {range}")
            }
            Self::Other(what) => f.write_str(what),
        }
    }
}

/// Lists names in messages.
pub fn one_of(names: &[&str]) -> String {
    match names {
        [] => "nothing".into(),
        [first, second] => format!("`{first}` or `{second}`"),
        names => format!("`{}`", names.join("`, `")),
    }
}

impl de::Error for ConfigError {
    fn custom<T: Display>(message: T) -> Self {
        Self::new("", format!("is invalid: {message}"))
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        let found = match found {
            Unexpected::Seq => "a list".into(),
            Unexpected::Map => "a section".into(),
            found => found.to_string(),
        };
        Self::of("", Problem::Value { found, allowed: expected.to_string() })
    }

    fn invalid_value(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::invalid_type(found, expected)
    }

    fn invalid_length(length: usize, expected: &dyn Expected) -> Self {
        let entries = if length == 1 { "entry" } else { "entries" };
        Self::new("", format!("has {length} {entries}; allowed: {expected}"))
    }

    fn unknown_variant(found: &str, names: &'static [&'static str]) -> Self {
        Self::of("", Problem::Value { found: format!("`{found}`"), allowed: one_of(names) })
    }

    fn unknown_field(key: &str, names: &'static [&'static str]) -> Self {
        Self::of(key, Problem::Unknown { allowed: names.to_vec(), hint: String::new() })
    }

    fn missing_field(key: &'static str) -> Self {
        Self::of(key, Problem::Missing)
    }
}

impl ConfigError {
    /// Error with a text after the key.
    pub fn new(key: impl Into<String>, what: impl Into<String>) -> Self {
        Self::of(key, Problem::Other(what.into()))
    }

    pub fn of(key: impl Into<String>, problem: Problem) -> Self {
        Self { key: key.into(), problem }
    }

    /// Prepends the name of the section, or the index in the list, to the key.
    pub fn within(self, name: &str) -> Self {
        let dot = if self.key.is_empty() || self.key.starts_with('[') { "" } else { "." };
        Self { key: format!("{name}{dot}{}", self.key), ..self }
    }

    /// Adds further allowed names to the error of an unknown key of this section.
    pub fn also_allowed(
        mut self,
        section: &str,
        names: impl Iterator<Item = &'static str>,
    ) -> Self {
        let parent = self.key.rsplit_once('.').map_or("", |(parent, _)| parent);
        let is_of_section = parent == section;
        if let Problem::Unknown { allowed, .. } = &mut self.problem
            && is_of_section
        {
            allowed.extend(names);
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
        Self::of(key, Problem::Value { found, allowed: allowed.into() })
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
        let (found, allowed) = (value.to_string(), allowed.to_string());
        Err(ConfigError::of(key, Problem::Value { found, allowed }))
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
