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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::reading::read;
    use physgrad::tasks::DoublePendulum;

    /// Settings beside those of the physics.
    #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields)]
    struct Beside {
        dt: f64,
    }

    #[test]
    fn two_structs_share_a_section_and_errors_keep_their_keys() {
        let joined = |text: &str| {
            read::<Joined<DoublePendulum, Beside>>(text.parse().expect("TOML"))
                .map_err(|error| error.to_string())
        };
        let Joined(physics, beside) = joined("masses = [2, 3]\ndt = 0.5").expect("settings");
        assert_eq!((physics.masses, beside), ([2.0, 3.0], Beside { dt: 0.5 }));
        let table = Table::try_from(Joined(physics, Beside { dt: 0.5 })).expect("a table");
        assert_eq!(table.keys().collect::<Vec<_>>(), ["masses", "lengths", "gravity", "dt"]);
        for (text, error) in [
            (
                "dt = 1\nmass = 1",
                "`mass` is unknown; allowed: `masses`, `lengths`, `gravity`, `dt`",
            ),
            ("dt = 1\nmasses = [1, true]", "`masses[1]` is boolean `true`; allowed: a number"),
            ("dt = \"fast\"", "`dt` is string \"fast\"; allowed: a number"),
            ("gravity = 1", "`dt` is missing"),
        ] {
            assert_eq!(joined(text).expect_err(text), error);
        }
        let mut generator = SchemaGenerator::default();
        let schema = Joined::<DoublePendulum, Beside>::json_schema(&mut generator);
        let keys = schema.get("properties").and_then(|all| Some(all.as_object()?.len()));
        assert_eq!((keys, schema.get("required")), (Some(4), Some(&serde_json::json!(["dt"]))));
    }
}
