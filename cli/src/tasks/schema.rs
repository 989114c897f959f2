//! JSON schema of scenes, with one branch per task.

use crate::settings::VERSION;
use crate::tasks::{self, AnyEffectSpec, AnyTaskSpec, policy};
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value, json};
use toml::Table;

/// Sections that are not part of [`Settings`](tasks::Settings), with their descriptions.
const SECTIONS: [(&str, &str); 2] = [
    (
        "vary",
        "Physical numbers that are drawn for each sample, by the dotted names of their settings.",
    ),
    (
        "fit",
        "Physical numbers that the training or `identify` determines, by the dotted names of their settings.",
    ),
];

/// Schema of all scenes.
pub fn schema() -> Value {
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A physgrad scene",
        "description": "Task, physics, policy and training of a run. Missing settings have defaults; effects that are not listed are absent.",
        "type": "object",
        "oneOf": tasks::all().iter().map(|task| task.schema()).collect::<Vec<_>>(),
    })
}

/// Schema of a type, with defaults.
fn with_defaults<S: JsonSchema>(defaults: &Table) -> Value {
    // Inlines subschemas: sections of different tasks share type names but not contents.
    let settings =
        SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
    let mut schema = SchemaGenerator::new(settings).into_root_schema_for::<S>().to_value();
    complete(&mut schema, Some(defaults));
    if let Some(all) = schema.as_object_mut() {
        all.remove("$schema");
    }
    schema
}

/// Schema of an effect of the user.
pub fn of_section<S: JsonSchema>(defaults: &Table) -> Value {
    let mut schema = with_defaults::<S>(defaults);
    schema.as_object_mut().map(|all| all.remove("title"));
    schema
}

/// Schema of the scenes of one task, with effects of the user.
pub fn of<S: JsonSchema>(
    task: &dyn AnyTaskSpec,
    own_effects: &[(&str, &dyn AnyEffectSpec)],
) -> Value {
    let mut schema = with_defaults::<S>(&task.defaults(&Table::new()));
    schema["properties"]["policy"] = policy::section_schema(task.policy());
    for (_, effect) in own_effects {
        schema["properties"]["effects"]["properties"][effect.info().name] = effect.schema();
    }
    if let Some(all) = schema.as_object_mut() {
        all.insert("title".into(), task.name().into());
        all.insert("description".into(), task.about().into());
        all.insert("required".into(), json!(["scene", "task"]));
    }
    for (section, description) in SECTIONS {
        schema["properties"][section] = json!({ "type": "object", "description": description });
    }
    schema["properties"]["scene"]["const"] = VERSION.into();
    schema["properties"]["task"]["const"] = task.name().into();
    schema
}

/// Inserts defaults. Makes all settings of a section with defaults optional.
///
/// Sections without defaults, such as optional effects and actuators, keep their required settings.
fn complete(schema: &mut Value, defaults: Option<&Table>) {
    let Some(schema) = schema.as_object_mut() else { return };
    without_null(schema);
    if defaults.is_some() {
        schema.remove("required");
    }
    let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) else {
        return;
    };
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

/// Removes null from the types: TOML has no null, and a scene omits an optional setting.
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
            // Prefers the description of the property to the description of its type.
            one.into_iter().for_each(|(key, value)| {
                schema.entry(key).or_insert(value);
            });
        }
    }
    schema.retain(|key, value| key != "default" || !value.is_null());
}
