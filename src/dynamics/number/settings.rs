//! A [`Number`] in a scene: a plain number, or a table with a distribution or an initial value.

use super::{Choice, Noise, Number};
use serde::de::{Deserialize, Deserializer, Error, MapAccess, Visitor};
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::fmt;

/// Keys of the table of a number that is not fixed.
const KEYS: [&str; 10] =
    ["uniform", "normal", "log_uniform", "choice", "noise", "mean", "hold", "start", "min", "max"];

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
            Self::Noise(Noise { mean, deviation, hold }) => {
                map.serialize_entry("noise", deviation)?;
                if *mean != 0.0 {
                    map.serialize_entry("mean", mean)?;
                }
                if *hold != 1 {
                    map.serialize_entry("hold", hold)?;
                }
            }
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
             { choice = [...] }, { noise = deviation, mean = value, hold = steps } or { start = value, min = bound, max = bound }",
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
        let mut drawn: Option<(String, Vec<f64>)> = None;
        let [mut start, mut min, mut max, mut noise, mut mean] = [None; 5];
        let mut hold = None;
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "start" => start = Some(map.next_value()?),
                "min" => min = Some(map.next_value()?),
                "max" => max = Some(map.next_value()?),
                "noise" => noise = Some(map.next_value()?),
                "mean" => mean = Some(map.next_value()?),
                "hold" => hold = Some(map.next_value::<u32>()?),
                _ if !KEYS.contains(&&*key) => return Err(A::Error::unknown_field(&key, &KEYS)),
                _ if drawn.is_some() => {
                    return Err(A::Error::custom("two distributions; choose one"));
                }
                _ => drawn = Some((key, map.next_value()?)),
            }
        }
        let number = match (drawn, noise, start) {
            (Some((key, values)), None, None)
                if [min, max, mean] == [None; 3] && hold.is_none() =>
            {
                distribution(&key, &values)
            }
            (None, Some(deviation), None) if [min, max] == [None; 2] => {
                noise_of(deviation, mean.unwrap_or(0.0), hold.unwrap_or(1))
            }
            (None, None, Some(start)) if mean.is_none() && hold.is_none() => {
                trained(start, min.unwrap_or(f64::NEG_INFINITY), max.unwrap_or(f64::INFINITY))
            }
            _ => Err("the table needs one of: one distribution; `noise` with optional `mean` and \
                      `hold`; `start` with optional `min` and `max`"
                .into()),
        };
        number.map_err(A::Error::custom)
    }
}

/// Creates a number that is trained.
fn trained(start: f64, min: f64, max: f64) -> Result<Number, String> {
    if max.is_finite() && !min.is_finite() {
        return Err("`max` requires `min`".into());
    }
    if !(min < start && start < max && start.is_finite()) {
        return Err(format!("`start = {start}` is not strictly between its bounds"));
    }
    Ok(Number::Trained { start, min, max })
}

/// Creates noise.
fn noise_of(deviation: f64, mean: f64, hold: u32) -> Result<Number, String> {
    if !(deviation.is_finite() && deviation >= 0.0) {
        return Err(format!("`noise = {deviation}`; allowed: a standard deviation of 0 or more"));
    }
    if !mean.is_finite() {
        return Err(format!("`mean = {mean}`; allowed: a finite number"));
    }
    if hold == 0 {
        return Err("`hold = 0`; allowed: a number of steps of 1 or more".into());
    }
    Ok(Number::Noise(Noise { mean, deviation, hold: hold as usize }))
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
                    "properties": {
                        "noise": { "type": "number" }, "mean": { "type": "number" },
                        "hold": { "type": "integer", "minimum": 1 }
                    },
                    "required": ["noise"],
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
