//! A [`Number`] in a scene: a plain number, or a table with a distribution or an initial value.

use super::{Choice, Number};
use serde::de::{Deserialize, Deserializer, Error, MapAccess, Visitor};
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::fmt;

/// Keys of the table of a number that is not fixed.
const KEYS: [&str; 7] = ["uniform", "normal", "log_uniform", "choice", "start", "min", "max"];

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = match self {
            Self::Fixed(value) => return serializer.serialize_f64(*value),
            _ => serializer.serialize_map(None)?,
        };
        match self {
            Self::Fixed(_) => {}
            Self::Uniform { low, high } => map.serialize_entry("uniform", &[low, high])?,
            Self::Normal { mean, deviation } => {
                map.serialize_entry("normal", &[mean, deviation])?
            }
            Self::LogUniform { low, high } => map.serialize_entry("log_uniform", &[low, high])?,
            Self::Choice(choice) => map.serialize_entry("choice", choice.values())?,
            Self::Trained { start, min, max } => {
                map.serialize_entry("start", start)?;
                for (key, bound) in [("min", min), ("max", max)] {
                    if bound.is_finite() {
                        map.serialize_entry(key, bound)?;
                    }
                }
            }
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumberVisitor)
    }
}

struct NumberVisitor;

impl<'de> Visitor<'de> for NumberVisitor {
    type Value = Number;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "a number, { uniform = [low, high] }, { normal = [mean, deviation] }, { log_uniform = [low, high] }, \
             { choice = [...] } or { start = value, min = bound, max = bound }",
        )
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Number, E> {
        Ok(Number::Fixed(value))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Number, E> {
        Ok(Number::Fixed(value as f64))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Number, E> {
        Ok(Number::Fixed(value as f64))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Number, A::Error> {
        let mut drawn = None;
        let [mut start, mut min, mut max] = [None; 3];
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "start" => start = Some(map.next_value()?),
                "min" => min = Some(map.next_value()?),
                "max" => max = Some(map.next_value()?),
                key if KEYS.contains(&key) && drawn.is_none() => {
                    drawn = Some(distribution(key, &map.next_value::<Vec<f64>>()?))
                }
                key if KEYS.contains(&key) => {
                    return Err(A::Error::custom("two distributions; choose one"));
                }
                _ => return Err(A::Error::unknown_field(&key, &KEYS)),
            }
        }
        match (drawn, start) {
            (Some(number), None) if min.is_none() && max.is_none() => {
                number.map_err(A::Error::custom)
            }
            (None, Some(start)) => {
                let (min, max) = (min.unwrap_or(f64::NEG_INFINITY), max.unwrap_or(f64::INFINITY));
                if max.is_finite() && !min.is_finite() {
                    return Err(A::Error::custom("`max` requires `min`"));
                }
                if !(min < start && start < max && start.is_finite()) {
                    return Err(A::Error::custom(format!(
                        "`start = {start}` is not strictly between its bounds"
                    )));
                }
                Ok(Number::Trained { start, min, max })
            }
            _ => Err(A::Error::custom(
                "the table needs either one distribution, or `start` with optional `min` and `max`",
            )),
        }
    }
}

/// Creates a number from the key of a distribution and its values.
fn distribution(key: &str, values: &[f64]) -> Result<Number, String> {
    if values.iter().any(|value| !value.is_finite()) {
        return Err(format!("`{key}` has a value that is not finite"));
    }
    let number = match (key, values) {
        ("uniform", &[low, high]) if low <= high => Some(Number::Uniform { low, high }),
        ("normal", &[mean, deviation]) if deviation >= 0.0 => {
            Some(Number::Normal { mean, deviation })
        }
        ("log_uniform", &[low, high]) if 0.0 < low && low <= high => {
            Some(Number::LogUniform { low, high })
        }
        ("choice", values) => Choice::new(values).map(Number::Choice),
        _ => None,
    };
    let allowed = match key {
        "normal" => "[mean, deviation], with a deviation of 0 or more",
        "log_uniform" => "[low, high], with 0 < low <= high",
        "choice" => "a list of one or more numbers",
        _ => "[low, high], with low <= high",
    };
    number.ok_or_else(|| format!("`{key} = {values:?}`; allowed: {allowed}"))
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Number {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Number".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let pair = serde_json_pair();
        schemars::json_schema!({
            "anyOf": [
                { "type": "number" },
                { "type": "object", "properties": { "uniform": pair }, "required": ["uniform"], "additionalProperties": false },
                { "type": "object", "properties": { "normal": pair }, "required": ["normal"], "additionalProperties": false },
                { "type": "object", "properties": { "log_uniform": pair }, "required": ["log_uniform"], "additionalProperties": false },
                {
                    "type": "object",
                    "properties": { "choice": { "type": "array", "items": { "type": "number" }, "minItems": 1 } },
                    "required": ["choice"],
                    "additionalProperties": false
                },
                {
                    "type": "object",
                    "properties": { "start": { "type": "number" }, "min": { "type": "number" }, "max": { "type": "number" } },
                    "required": ["start"],
                    "additionalProperties": false
                }
            ]
        })
    }
}

#[cfg(feature = "schema")]
fn serde_json_pair() -> schemars::Schema {
    schemars::json_schema!({ "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2 })
}
