//! [`Joined`]: one section of a scene with the settings of two structs.

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::ser::{Error, Serialize, Serializer};
use std::borrow::Cow;
use toml::Table;

/// Name by which the deserializer of settings recognizes a [`Joined`] section.
pub const JOINED: &str = "Joined";

/// Two structs whose fields are the keys of one section, for example the physics of the library and
/// the settings that the program adds. `#[serde(flatten)]` would lose the keys in errors.
#[derive(Clone, Copy, Debug, Default, serde::Deserialize)]
pub struct Joined<A, B>(pub A, pub B);

impl<A: Serialize, B: Serialize> Serialize for Joined<A, B> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut table = Table::try_from(&self.0).map_err(Error::custom)?;
        table.extend(Table::try_from(&self.1).map_err(Error::custom)?);
        table.serialize(serializer)
    }
}

impl<A: JsonSchema, B: JsonSchema> JsonSchema for Joined<A, B> {
    fn schema_name() -> Cow<'static, str> {
        format!("{}And{}", A::schema_name(), B::schema_name()).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let (mut all, other) = (A::json_schema(generator), B::json_schema(generator));
        for key in ["properties", "required"] {
            match (all.get_mut(key), other.get(key).cloned()) {
                (Some(serde_json::Value::Object(all)), Some(serde_json::Value::Object(more))) => {
                    all.extend(more);
                }
                (Some(serde_json::Value::Array(all)), Some(serde_json::Value::Array(more))) => {
                    all.extend(more);
                }
                (None, Some(more)) => drop(all.insert(key.into(), more)),
                _ => {}
            }
        }
        all
    }
}
