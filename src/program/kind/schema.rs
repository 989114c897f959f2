//! The JSON schema of scenes: one branch a task.

use super::{AnyKind, KINDS};
use crate::program::settings::VERSION;
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value, json};
use toml::Table;

/// The schema of all scenes.
pub fn schema() -> Value {
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A physgrad scene",
        "description": "What is trained, and how. Whatever is left out has the task's default; effects that are not named are absent.",
        "type": "object",
        "oneOf": KINDS.map(|kind| kind.schema()),
    })
}

/// The schema of the scenes of one task.
pub fn of<S: JsonSchema>(kind: &dyn AnyKind) -> Value {
    // Written out in place: the sections of tasks differ, whatever they are called.
    let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
    let mut schema = SchemaGenerator::new(settings).into_root_schema_for::<S>().to_value();
    complete(&mut schema, Some(&kind.defaults()));
    if let Some(all) = schema.as_object_mut() {
        all.remove("$schema");
        all.insert("title".into(), kind.name().into());
        all.insert("description".into(), kind.about().into());
        all.insert("required".into(), json!(["scene", "task"]));
    }
    schema["properties"]["scene"]["const"] = VERSION.into();
    schema["properties"]["task"]["const"] = kind.name().into();
    schema
}

/// What has a default need not be written; what an effect or actuator asks for, once it is named, has none.
fn complete(schema: &mut Value, defaults: Option<&Table>) {
    let Some(schema) = schema.as_object_mut() else { return };
    without_null(schema);
    if defaults.is_some() {
        schema.remove("required");
    }
    let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) else { return };
    for (key, property) in properties {
        let default = defaults.and_then(|defaults| defaults.get(key));
        complete(property, default.and_then(toml::Value::as_table));
        if let Some(default) = default.filter(|default| !default.is_table())
            && let Ok(default) = serde_json::to_value(default)
        {
            property["default"] = default;
        }
    }
}

/// TOML has no null: what is optional is left out.
fn without_null(schema: &mut Map<String, Value>) {
    if let Some(Value::Array(types)) = schema.get_mut("type") {
        types.retain(|name| name != "null");
        if let [one] = &types[..] {
            schema["type"] = one.clone();
        }
    }
    if let Some(Value::Array(choices)) = schema.get_mut("anyOf") {
        choices.retain(|choice| choice["type"] != "null");
        if let [Value::Object(one)] = &choices[..] {
            let one = one.clone();
            schema.remove("anyOf");
            // What is said of the section here is more than what is said of it in general.
            one.into_iter().for_each(|(key, value)| {
                schema.entry(key).or_insert(value);
            });
        }
    }
    schema.retain(|key, value| key != "default" || !value.is_null());
}
