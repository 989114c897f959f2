//! Merges TOML tables of settings, and deserializes them. Errors name the key.
//!
//! The program uses this module instead of `serde_path_to_error` and the deserializer of `toml`.
//! The latter reads a list as a section, and its errors omit the allowed values of a choice.

use serde::de::{
    Deserialize, DeserializeSeed, Deserializer, Error, Expected, IntoDeserializer, MapAccess,
    SeqAccess, Unexpected, Visitor,
};
use std::fmt::{self, Display};
use toml::{Table, Value};

/// Serde error with the key of the value, for example `policy.widths[1]`.
///
/// The key is empty for the whole table.
#[derive(Debug)]
pub struct Unreadable {
    pub key: String,
    pub message: String,
}

impl Unreadable {
    /// Prepends the name of the section, or the index in the list.
    fn within(self, name: &str) -> Self {
        let dot = if self.key.is_empty() || self.key.starts_with('[') { "" } else { "." };
        Self { key: format!("{name}{dot}{}", self.key), ..self }
    }
}

impl Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}`: {}", self.key, self.message)
    }
}

impl std::error::Error for Unreadable {}

impl Error for Unreadable {
    fn custom<T: Display>(message: T) -> Self {
        Self { key: String::new(), message: message.to_string() }
    }
}

/// Deserializes a table.
pub fn read<T: for<'de> Deserialize<'de>>(table: Table) -> Result<T, Unreadable> {
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

/// Returns whether the table is a drawn [`Number`](physgrad::Number).
pub fn is_drawn(table: &Table) -> bool {
    const DISTRIBUTIONS: [&str; 4] = ["uniform", "normal", "log_uniform", "choice"];
    table.len() == 1
        && table.iter().all(|(key, value)| DISTRIBUTIONS.contains(&&**key) && value.is_array())
}

/// Returns whether the table is a drawn or trained [`Number`](physgrad::Number).
pub fn is_number(table: &Table) -> bool {
    let is_trained = table.get("start").is_some_and(|start| start.is_float() || start.is_integer());
    is_drawn(table)
        || is_trained && table.keys().all(|key| ["start", "min", "max"].contains(&&**key))
}

/// Implements the methods on the left by the method on the right. The visitor checks the range.
macro_rules! read_as {
    ($($($method:ident)+: $other:ident;)+) => {$($(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
            self.$other(visitor)
        }
    )+)+};
}

/// Deserializer of a value. Most methods accept one type of value, which limits monomorphization.
struct Reading<'a>(&'a Value);

impl Reading<'_> {
    fn unexpected(&self, expected: &dyn Expected) -> Unreadable {
        let found = match self.0 {
            Value::Boolean(value) => Unexpected::Bool(*value),
            Value::Integer(value) => Unexpected::Signed(*value),
            Value::Float(value) => Unexpected::Float(*value),
            Value::String(value) => Unexpected::Str(value),
            Value::Datetime(_) => Unexpected::Other("a date"),
            Value::Array(_) => Unexpected::Other("a list"),
            Value::Table(_) => Unexpected::Other("a section"),
        };
        Error::invalid_type(found, expected)
    }
}

impl<'de> Deserializer<'de> for Reading<'_> {
    type Error = Unreadable;

    /// Used by settings that are a number or a section, and by values of any type except dates.
    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        match self.0 {
            Value::Float(_) | Value::Integer(_) => self.deserialize_f64(visitor),
            Value::String(_) => self.deserialize_string(visitor),
            Value::Boolean(_) => self.deserialize_bool(visitor),
            Value::Array(_) => self.deserialize_seq(visitor),
            Value::Table(_) => self.deserialize_map(visitor),
            Value::Datetime(_) => Err(self.unexpected(&visitor)),
        }
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        if let Value::Boolean(value) = self.0 {
            visitor.visit_bool(*value)
        } else {
            Err(self.unexpected(&visitor))
        }
    }

    fn deserialize_i64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        if let Value::Integer(value) = self.0 {
            visitor.visit_i64(*value)
        } else {
            Err(self.unexpected(&visitor))
        }
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        self.deserialize_i64(visitor)
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        if let Value::Float(value) = self.0 {
            visitor.visit_f64(*value)
        } else {
            self.deserialize_i64(visitor)
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        if let Value::String(value) = self.0 {
            visitor.visit_str(value)
        } else {
            Err(self.unexpected(&visitor))
        }
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        let Value::Array(list) = self.0 else { return Err(self.unexpected(&visitor)) };
        let mut elements = Elements { list, read: 0 };
        let value = visitor.visit_seq(&mut elements)?;
        let is_complete = elements.read == list.len();
        if is_complete {
            Ok(value)
        } else {
            Err(Error::invalid_length(list.len(), &"fewer elements"))
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        _len: usize,
        visitor: V,
    ) -> Result<V::Value, Unreadable> {
        self.deserialize_seq(visitor)
    }

    /// Refuses unknown keys, also of structs without `deny_unknown_fields`.
    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &str,
        keys: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Unreadable> {
        if let Value::Table(table) = self.0
            && let Some(key) = table.keys().find(|key| !keys.contains(&key.as_str()))
        {
            return Err(Error::unknown_field(key, keys));
        }
        self.deserialize_map(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &str,
        visitor: V,
    ) -> Result<V::Value, Unreadable> {
        visitor.visit_newtype_struct(self)
    }

    /// Variants are strings.
    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &str,
        names: &[&str],
        visitor: V,
    ) -> Result<V::Value, Unreadable> {
        match self.0 {
            Value::String(name) => visitor.visit_enum(name.as_str().into_deserializer()),
            _ => Err(self.unexpected(&format!("`{}`", names.join("`, `")).as_str())),
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unreadable> {
        let Value::Table(table) = self.0 else { return Err(self.unexpected(&visitor)) };
        visitor.visit_map(Entries { entries: table.iter(), value: None })
    }

    read_as! {
        deserialize_i8 deserialize_i16 deserialize_i32 deserialize_u8 deserialize_u16 deserialize_u32: deserialize_i64;
        deserialize_f32: deserialize_f64;
        deserialize_char deserialize_str: deserialize_string;
    }

    serde::forward_to_deserialize_any! {
        i128 u128 bytes byte_buf unit unit_struct tuple_struct identifier
        ignored_any
    }
}

struct Elements<'a> {
    list: &'a [Value],
    read: usize,
}

impl<'de> SeqAccess<'de> for &mut Elements<'_> {
    type Error = Unreadable;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Unreadable> {
        let Some(value) = self.list.get(self.read) else { return Ok(None) };
        let index = self.read;
        self.read += 1;
        seed.deserialize(Reading(value))
            .map(Some)
            .map_err(|error| error.within(&format!("[{index}]")))
    }
}

struct Entries<'a> {
    entries: toml::map::Iter<'a, String, Value>,
    /// Entry of the last key that was read.
    value: Option<(&'a str, &'a Value)>,
}

impl<'de> MapAccess<'de> for Entries<'_> {
    type Error = Unreadable;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Unreadable> {
        let Some((key, value)) = self.entries.next() else { return Ok(None) };
        self.value = Some((key, value));
        seed.deserialize(String::as_str(key).into_deserializer()).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(
        &mut self,
        seed: V,
    ) -> Result<V::Value, Unreadable> {
        let (key, value) =
            self.value.take().ok_or_else(|| Unreadable::custom("a value without a key"))?;
        seed.deserialize(Reading(value)).map_err(|error| error.within(key))
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
