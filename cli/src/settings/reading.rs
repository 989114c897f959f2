//! Merges TOML tables of settings, and deserializes them. Errors name the key.
//!
//! The program uses this module instead of `serde_path_to_error` and the deserializer of `toml`.
//! The latter reads a list as a section, and its errors omit the allowed values of a choice.

use crate::settings::config_error::{ConfigError, Problem, one_of};
use crate::settings::joined::JOINED;
use serde::de::{
    Deserialize, DeserializeSeed, Deserializer, Error, Expected, IntoDeserializer, MapAccess,
    SeqAccess, Unexpected, Visitor,
};
use std::fmt::Display;
use toml::{Table, Value};

/// Deserializes a table.
pub fn read<T: for<'de> Deserialize<'de>>(table: Table) -> Result<T, ConfigError> {
    T::deserialize(Reading(&Value::Table(table)))
}

/// Replaces values of `lower` by those of `upper`, section by section. Replaces a number that is
/// drawn, or becomes drawn, as a whole.
pub fn overlay(lower: &mut Table, upper: &Table) {
    for (key, value) in upper {
        match (lower.get_mut(key), value) {
            (Some(Value::Table(lower)), Value::Table(upper))
                if !is_drawn(lower) && !is_drawn(upper) =>
            {
                overlay(lower, upper)
            }
            _ => {
                lower.insert(key.clone(), value.clone());
            }
        }
    }
}

/// All settings by dotted key. An empty section counts as a setting: it is an effect without
/// parameters.
pub fn flat(table: &Table) -> Vec<(String, Value)> {
    let inner = |(key, value): (&String, &Value)| match value {
        Value::Table(section) if !section.is_empty() => flat(section)
            .into_iter()
            .map(|(rest, value)| (format!("{key}.{rest}"), value))
            .collect(),
        value => vec![(key.clone(), value.clone())],
    };
    table.iter().flat_map(inner).collect()
}

/// Keys of the table of a drawn or trained [`Number`](physgrad::Number).
pub const NUMBER_KEYS: [&str; 10] =
    ["uniform", "normal", "log_uniform", "choice", "noise", "mean", "hold", "start", "min", "max"];

/// Returns whether the table is a drawn [`Number`](physgrad::Number), noise included.
pub fn is_drawn(table: &Table) -> bool {
    let is_distribution =
        |(key, value): (&String, &Value)| NUMBER_KEYS[..4].contains(&&**key) && value.is_array();
    let is_noise = |(key, value): (&String, &Value)| {
        NUMBER_KEYS[4..7].contains(&&**key) && (value.is_float() || value.is_integer())
    };
    table.len() == 1 && table.iter().all(is_distribution)
        || table.contains_key("noise") && table.iter().all(is_noise)
}

/// Returns whether the table is a drawn or trained [`Number`](physgrad::Number).
pub fn is_number(table: &Table) -> bool {
    let is_trained = table.get("start").is_some_and(|start| start.is_float() || start.is_integer());
    is_drawn(table) || is_trained && table.keys().all(|key| NUMBER_KEYS[7..].contains(&&**key))
}

/// Implements the methods on the left by the method on the right. The visitor checks the range.
macro_rules! read_as {
    ($($($method:ident)+: $other:ident;)+) => {$($(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
            self.$other(visitor)
        }
    )+)+};
}

/// Deserializer of a value. Most methods accept one type of value, which limits monomorphization.
struct Reading<'a>(&'a Value);

impl Reading<'_> {
    /// Error of a value of another type.
    fn unexpected(&self, allowed: impl Display) -> ConfigError {
        let (found, allowed) = (self.found(), allowed.to_string());
        ConfigError::of("", Problem::Value { found, allowed })
    }

    fn found(&self) -> String {
        let found = match self.0 {
            Value::Boolean(value) => Unexpected::Bool(*value),
            Value::Integer(value) => Unexpected::Signed(*value),
            Value::Float(value) => Unexpected::Float(*value),
            Value::String(value) => Unexpected::Str(value),
            Value::Datetime(_) => Unexpected::Other("a date"),
            Value::Array(_) => Unexpected::Other("a list"),
            Value::Table(_) => Unexpected::Other("a section"),
        };
        found.to_string()
    }
}

impl<'de> Deserializer<'de> for Reading<'_> {
    type Error = ConfigError;

    /// Used by settings that are a number or a section, and by values of any type except dates.
    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        match self.0 {
            Value::Float(value) => visitor.visit_f64(*value),
            Value::Integer(value) => visitor.visit_i64(*value),
            Value::String(_) => self.deserialize_string(visitor),
            Value::Boolean(_) => self.deserialize_bool(visitor),
            Value::Array(_) => self.deserialize_seq(visitor),
            Value::Table(_) => self.deserialize_map(visitor),
            Value::Datetime(_) => Err(self.unexpected(&visitor as &dyn Expected)),
        }
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        if let Value::Boolean(value) = self.0 {
            visitor.visit_bool(*value)
        } else {
            Err(self.unexpected("a boolean"))
        }
    }

    fn deserialize_i64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        if let Value::Integer(value) = self.0 {
            visitor.visit_i64(*value)
        } else {
            Err(self.unexpected("a whole number"))
        }
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        match self.0 {
            Value::Integer(value @ 0..) => visitor.visit_i64(*value),
            _ => {
                let problem = Problem::NotWhole { found: self.found(), range: None };
                Err(ConfigError::of("", problem))
            }
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        match self.0 {
            Value::Float(value) => visitor.visit_f64(*value),
            Value::Integer(value) => visitor.visit_i64(*value),
            _ => Err(self.unexpected("a number")),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        if let Value::String(value) = self.0 {
            visitor.visit_str(value)
        } else {
            Err(self.unexpected(&visitor as &dyn Expected))
        }
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        let Value::Array(list) = self.0 else { return Err(self.unexpected("a list")) };
        let mut elements = Elements { list, read: 0 };
        let value = visitor.visit_seq(&mut elements)?;
        let is_complete = elements.read == list.len();
        if is_complete {
            Ok(value)
        } else {
            Err(Error::invalid_length(list.len(), &"a shorter list"))
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, ConfigError> {
        match self.0 {
            Value::Array(list) if list.len() != len => {
                Err(Error::invalid_length(list.len(), &&*format!("a list of {len}")))
            }
            _ => self.deserialize_seq(visitor),
        }
    }

    /// Refuses unknown keys, also of structs without `deny_unknown_fields`.
    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &str,
        keys: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ConfigError> {
        if let Value::Table(table) = self.0
            && let Some(key) = table.keys().find(|key| !keys.contains(&key.as_str()))
        {
            return Err(Error::unknown_field(key, keys));
        }
        self.deserialize_map(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &str,
        visitor: V,
    ) -> Result<V::Value, ConfigError> {
        visitor.visit_newtype_struct(self)
    }

    /// Variants are strings.
    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &str,
        names: &[&str],
        visitor: V,
    ) -> Result<V::Value, ConfigError> {
        match self.0 {
            Value::String(name) => visitor.visit_enum(name.as_str().into_deserializer()),
            _ => Err(self.unexpected(one_of(names))),
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ConfigError> {
        let Value::Table(table) = self.0 else { return Err(self.unexpected("a section")) };
        visitor.visit_map(Entries { entries: table.iter(), of: None, value: None })
    }

    read_as! {
        deserialize_i8 deserialize_i16 deserialize_i32 deserialize_u8 deserialize_u16 deserialize_u32: deserialize_i64;
        deserialize_f32: deserialize_f64;
        deserialize_char deserialize_str: deserialize_string;
    }

    /// Reads [`Joined`](crate::settings::Joined) structs from one section.
    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        name: &str,
        _len: usize,
        visitor: V,
    ) -> Result<V::Value, ConfigError> {
        if name != JOINED {
            return self.deserialize_seq(visitor);
        }
        let mut parts = Parts { section: self.0, allowed: Vec::new() };
        let value = visitor.visit_seq(&mut parts)?;
        let Parts { section, allowed } = parts;
        let keys = section.as_table().into_iter().flat_map(Table::keys);
        match keys.into_iter().find(|key| !allowed.contains(&key.as_str())) {
            None => Ok(value),
            Some(key) => {
                Err(ConfigError::of(key, Problem::Unknown { allowed, hint: String::new() }))
            }
        }
    }

    serde::forward_to_deserialize_any! {
        i128 u128 bytes byte_buf unit unit_struct identifier ignored_any
    }
}

/// The structs of a [`Joined`] section.
struct Parts<'a> {
    section: &'a Value,
    /// Keys of the structs that were read.
    allowed: Vec<&'static str>,
}

impl<'de> SeqAccess<'de> for &mut Parts<'_> {
    type Error = ConfigError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, ConfigError> {
        seed.deserialize(Part(self)).map(Some)
    }
}

/// Deserializer of one struct of a [`Joined`] section: reads only the keys of the struct.
struct Part<'p, 'a>(&'p mut Parts<'a>);

impl<'de> Deserializer<'de> for Part<'_, '_> {
    type Error = ConfigError;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &str,
        keys: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ConfigError> {
        let Value::Table(table) = self.0.section else {
            return Err(Reading(self.0.section).unexpected("a section"));
        };
        self.0.allowed.extend(keys);
        visitor.visit_map(Entries { entries: table.iter(), of: Some(keys), value: None })
    }

    fn deserialize_any<V: Visitor<'de>>(self, _visitor: V) -> Result<V::Value, ConfigError> {
        Err(Error::custom("a part of a section is not a struct"))
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option
        unit unit_struct newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

struct Elements<'a> {
    list: &'a [Value],
    read: usize,
}

impl<'de> SeqAccess<'de> for &mut Elements<'_> {
    type Error = ConfigError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, ConfigError> {
        let Some(value) = self.list.get(self.read) else { return Ok(None) };
        let index = self.read;
        self.read += 1;
        seed.deserialize(Reading(value))
            .map(Some)
            .map_err(|error: ConfigError| error.within(&format!("[{index}]")))
    }
}

struct Entries<'a> {
    entries: toml::map::Iter<'a, String, Value>,
    /// Keys to read. None for all keys.
    of: Option<&'static [&'static str]>,
    /// Entry of the last key that was read.
    value: Option<(&'a str, &'a Value)>,
}

impl<'de> MapAccess<'de> for Entries<'_> {
    type Error = ConfigError;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, ConfigError> {
        let of = self.of;
        let entry =
            self.entries.find(|(key, _)| of.is_none_or(|keys| keys.contains(&key.as_str())));
        let Some((key, value)) = entry else { return Ok(None) };
        self.value = Some((key, value));
        seed.deserialize(String::as_str(key).into_deserializer()).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(
        &mut self,
        seed: V,
    ) -> Result<V::Value, ConfigError> {
        let (key, value) =
            self.value.take().ok_or_else(|| Error::custom("a value without a key"))?;
        seed.deserialize(Reading(value)).map_err(|error: ConfigError| error.within(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Settings of a user's task, without `deny_unknown_fields`.
    #[derive(Debug, PartialEq, serde::Deserialize)]
    struct Own {
        length: f32,
        count: u32,
        level: i8,
        axis: char,
        springs: BTreeMap<String, f64>,
    }

    #[test]
    fn sections_are_merged_and_drawn_numbers_are_replaced() {
        let table = |text: &str| text.parse::<Table>().expect("TOML");
        let mut merged = table(
            "a = { uniform = [0, 1] }\nb = { start = 1, min = 0 }\nc = { normal = 1, y = 2 }\n",
        );
        overlay(
            &mut merged,
            &table("a = { normal = [1, 2] }\nb = { start = 2 }\nc = { normal = 3 }\n"),
        );
        assert_eq!(
            merged,
            table(
                "a = { normal = [1, 2] }\nb = { start = 2, min = 0 }\nc = { normal = 3, y = 2 }\n"
            )
        );
    }

    #[test]
    fn settings_may_be_f32_u32_i8_char_or_map_and_unknown_keys_are_refused() {
        let table = |count: i64| {
            let text = format!(
                "length = 0.5\ncount = {count}\nlevel = -3\naxis = \"x\"\n[springs]\nleft = 2\n"
            );
            text.parse::<Table>().expect("TOML")
        };
        let springs = BTreeMap::from([("left".to_owned(), 2.0)]);
        let expected = Own { length: 0.5, count: 7, level: -3, axis: 'x', springs };
        assert_eq!(read::<Own>(table(7)).expect("settings"), expected);
        assert_eq!(read::<Own>(table(-1)).expect_err("a negative count").key, "count");
        let mut misspelt = table(7);
        misspelt.insert("lenght".into(), Value::Float(0.5));
        let error = read::<Own>(misspelt).expect_err("an unknown key").to_string();
        assert!(error.contains("`lenght`") && error.contains("`length`, `count`"), "{error}");
    }
}
