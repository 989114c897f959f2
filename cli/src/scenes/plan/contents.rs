//! [`Contents`]: the contents of a plan file, checked on their own. [`Plan`](super::Plan) adds the
//! scenes that they name.

use crate::scenes::grid::count;
use crate::scenes::presets;
use crate::settings::config_error::{ConfigError, allowed};
use crate::settings::{FieldName, OPTIONAL};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use toml::{Table, Value};

/// Largest number of combinations of tasks, methods and values. Also the largest number of seeds.
pub(super) const MAX: usize = 10_000;

/// Keys that a plan cannot set, with the reasons.
const REFUSED: [(&str, &str); 4] = [
    ("seed", "every combination trains several seeds; choose their number with `seeds` (--seeds)"),
    ("task", "it defines the meaning of the other settings; name another `scene`"),
    ("scene", "it defines the meaning of the other settings; name another `scene`"),
    ("physgrad", "it is the version of the program"),
];

/// Contents of the file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Contents {
    /// Title of the pictures. Default: the names of the tasks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub title: Option<String>,
    /// Number of consecutive seeds. The first one is the seed of the scene.
    #[serde(default = "default_seeds")]
    pub seeds: u64,
    /// Replaces the number of epochs of every scene. A table `set` may replace it again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epochs: Option<usize>,
    /// Short form of methods that differ in the field only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fields: Vec<FieldName>,
    /// Keys with lists of values. Results show every combination.
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub grid: Table,
    /// Keys with lists of values. Results show the best combination for each method.
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub best: Table,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub figure: Option<FigureLayout>,
    /// Chosen combinations of values, which `grid` combines with its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub list: Vec<Table>,
    #[serde(rename = "task", default)]
    pub tasks: Vec<PlannedTask>,
    #[serde(rename = "method", default, skip_serializing_if = "Vec::is_empty")]
    pub methods: Vec<PlannedMethod>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PlannedTask {
    /// Name of the task. Default: the name of the scene, or `task` if the plan contains the
    /// settings of the scene. A single task may have the empty name, which no folder and no table
    /// shows.
    pub name: Option<String>,
    /// Name of a preset, path relative to the plan, or settings of a scene.
    pub scene: Value,
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub set: Table,
}

impl PlannedTask {
    /// Name of the task, or its default.
    pub(super) fn name(&self) -> String {
        let of_scene = || self.scene.as_str().map_or_else(|| TASK.into(), presets::short_name);
        self.name.clone().unwrap_or_else(of_scene)
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PlannedMethod {
    pub name: String,
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub set: Table,
}

/// Layout of a picture with a panel of learning curves per case.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FigureLayout {
    /// Key of the grid, or `task`, with one row of panels per value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rows: Option<String>,
    /// Key of the grid, or `task`, with one column of panels per value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<String>,
    /// Title of a column. `{}` stands for the value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub panel: Option<String>,
    /// Number of epochs of the trailing mean of the curves.
    #[serde(default = "one")]
    pub mean: usize,
    /// Value of `columns` with a further panel, which shows the norm of the field.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub update_size: Option<Value>,
}

/// Name of the axis of a [`FigureLayout`] that consists of the tasks.
pub const TASK: &str = "task";

fn default_seeds() -> u64 {
    3
}

fn one() -> usize {
    1
}

/// Settings of a table by dotted key. In TOML, a dotted key without quotation marks, as in
/// `policy.widths = [4]`, is a table inside a table. Such a table gives values only to those keys
/// of a section that it contains.
pub(super) fn settings_of(table: &Table) -> Vec<(String, &Value)> {
    let mut settings = Vec::new();
    table.iter().for_each(|(key, value)| push_settings(key.clone(), value, &mut settings));
    settings
}

/// Appends the settings in the value of a key. The value of a section contains several settings.
fn push_settings<'a>(key: String, value: &'a Value, settings: &mut Vec<(String, &'a Value)>) {
    let is_section = key
        .split_once('.')
        .is_none_or(|(section, name)| OPTIONAL.contains(&section) && !name.contains('.'));
    match value {
        Value::Table(section) if is_section && !section.is_empty() => {
            section.iter().for_each(|(inner, value)| {
                push_settings(format!("{key}.{inner}"), value, settings)
            });
        }
        value => settings.push((key, value)),
    }
}

impl Contents {
    /// Number of combinations of a task, a method and values. Fields are no methods here.
    pub(super) fn combinations(&self) -> usize {
        [self.methods.len().max(1), count(&self.grid, &self.list), count(&self.best, &[])]
            .into_iter()
            .fold(self.tasks.len(), usize::saturating_mul)
    }

    /// Keys of the grid and of the list.
    pub fn varied_keys(&self) -> impl Iterator<Item = &str> {
        let list = self.list.first().into_iter().flat_map(Table::keys);
        self.grid.keys().chain(list).map(String::as_str)
    }

    /// Gives varied settings their dotted keys.
    pub(super) fn flatten(&mut self) {
        for table in [&mut self.grid, &mut self.best].into_iter().chain(&mut self.list) {
            let flat = settings_of(table).into_iter().map(|(key, value)| (key, value.clone()));
            *table = flat.collect();
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let seeds = self.seeds;
        allowed("seeds", seeds, (1..=MAX as u64).contains(&seeds), format!("1 to {MAX}"))?;
        let names: Vec<&str> = self.fields.iter().map(|field| field.0.name()).collect();
        for (i, name) in names.iter().enumerate() {
            let is_new = !names[..i].contains(name);
            allowed(&format!("fields[{i}]"), name, is_new, "distinct fields")?;
        }
        if self.tasks.is_empty() {
            return Err(ConfigError::new("task", "is missing; add an entry [[task]]"));
        }
        match (self.fields.is_empty(), self.methods.is_empty()) {
            (true, true) => {
                let what = "is missing; add an entry [[method]], or a list `fields`";
                return Err(ConfigError::new("method", what));
            }
            (false, false) => {
                let what = "is given, but `fields` replaces methods; remove one of them";
                return Err(ConfigError::new("method", what));
            }
            _ => {}
        }
        let varied = self.varied()?;
        let set = |list: &'static str| move |(i, set)| (format!("{list}[{i}].set"), set);
        let tasks = self.tasks.iter().map(|task| &task.set).enumerate().map(set("task"));
        let methods = self.methods.iter().map(|method| &method.set).enumerate().map(set("method"));
        for (path, set) in tasks.chain(methods) {
            for (key, _) in settings_of(set) {
                check_key(&format!("{path}.{key}"), &key)?;
                if let Some(section) = varied.get(&*key) {
                    let what = format!("is set, but `{section}` replaces it; remove one of them");
                    return Err(ConfigError::new(format!("{path}.{key}"), what));
                }
            }
        }
        let cells = self.combinations();
        allowed(
            "task",
            format!("{cells} combinations of tasks, methods and values"),
            cells <= MAX,
            format!("up to {MAX}"),
        )?;
        self.figure.as_ref().map_or(Ok(()), |figure| figure.validate(self))
    }

    /// Varied keys, with the names of their sections.
    fn varied(&self) -> Result<HashMap<&str, &'static str>, ConfigError> {
        let mut varied = HashMap::new();
        if !self.fields.is_empty() {
            varied.insert("field", "fields");
        }
        for (section, table) in [("grid", &self.grid), ("best", &self.best)] {
            for (key, values) in table {
                let path = format!("{section}.{key}");
                let list = values.as_array().filter(|values| !values.is_empty());
                let list = list.ok_or_else(|| {
                    ConfigError::invalid(&path, Some(values), "a list of values, as in [0.1, 0.01]")
                })?;
                for (i, value) in list.iter().enumerate() {
                    let is_new = !list[..i].contains(value);
                    allowed(&format!("{path}[{i}]"), value, is_new, "distinct values")?;
                }
            }
        }
        for (i, entry) in self.list.iter().enumerate() {
            let first = &self.list[0];
            let only = |a: &Table, b: &Table| a.keys().find(|key| !b.contains_key(*key)).cloned();
            let what = match (only(entry, first), only(first, entry)) {
                (Some(key), _) => format!("has `{key}`, which the first entry lacks"),
                (None, Some(key)) => format!("lacks `{key}`, which the first entry has"),
                (None, None) => continue,
            };
            let what = format!("{what}; give every entry the same keys");
            return Err(ConfigError::new(format!("list[{i}]"), what));
        }
        let first = self.list.first().map(|entry| ("list[0]", "list", entry));
        for (path, section, table) in
            [("grid", "grid", &self.grid), ("best", "best", &self.best)].into_iter().chain(first)
        {
            for key in table.keys() {
                let path = format!("{path}.{key}");
                check_key(&path, key)?;
                if key == "field" {
                    let what = "cannot be varied: list fields in `fields` (--fields), or set the field of a [[method]]";
                    return Err(ConfigError::new(path, what));
                }
                if let Some(other) = varied.insert(key, section) {
                    let what = format!("is also in `{other}`; give its values once");
                    return Err(ConfigError::new(path, what));
                }
            }
        }
        Ok(varied)
    }
}

/// Refuses a key that a plan cannot set. The plan has it at `path`.
fn check_key(path: &str, key: &str) -> Result<(), ConfigError> {
    match REFUSED.iter().find(|(refused, _)| *refused == key) {
        Some((_, reason)) => Err(ConfigError::new(path, format!("cannot be set: {reason}"))),
        None => Ok(()),
    }
}

impl FigureLayout {
    fn validate(&self, contents: &Contents) -> Result<(), ConfigError> {
        allowed("figure.mean", self.mean, self.mean > 0, "1 or more epochs")?;
        if !contents.list.is_empty() {
            let what = "has no axis for the entries of [[list]]; use [grid]";
            return Err(ConfigError::new("figure", what));
        }
        let axes = || [TASK].into_iter().chain(contents.grid.keys().map(String::as_str));
        let axes_of_figure = [("figure.rows", &self.rows), ("figure.columns", &self.columns)];
        for (key, axis) in axes_of_figure {
            if let Some(axis) = axis {
                let names: Vec<&str> = axes().collect();
                allowed(key, axis, names.contains(&&**axis), format!("`{}`", names.join("`, `")))?;
            }
        }
        if let Some(value) = &self.update_size {
            let values: Vec<Value> = match self.columns.as_deref() {
                Some(TASK) => contents.tasks.iter().map(|task| task.name().into()).collect(),
                Some(key) => contents.grid[key].as_array().cloned().unwrap_or_default(),
                None => Vec::new(),
            };
            let names = match values.iter().map(Value::to_string).collect::<Vec<_>>() {
                none if none.is_empty() => "a value of `columns`, which is missing".into(),
                names => names.join(", "),
            };
            allowed("figure.update_size", value, values.contains(value), names)?;
        }
        let is_shown = |axis: &str| {
            axes_of_figure.iter().filter(|(_, shown)| shown.as_deref() == Some(axis)).count() == 1
        };
        let needed = axes().skip(usize::from(contents.tasks.len() < 2));
        match needed.into_iter().find(|axis| !is_shown(axis)) {
            Some(axis) => Err(ConfigError::new(
                "figure",
                format!("needs `{axis}` as either `rows` or `columns`"),
            )),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_and_dotted_keys_give_equal_settings() {
        let settings = |text: &str| {
            let table: Table = text.parse().expect("TOML");
            let found = settings_of(&table);
            found.into_iter().map(|(key, value)| (key, value.to_string())).collect::<Vec<_>>()
        };
        for (texts, key, value) in [
            (["policy.widths = [4]", "\"policy.widths\" = [4]"], "policy.widths", "[4]"),
            (
                ["effects.gusty_wind.speed = 3", "\"effects.gusty_wind\" = { speed = 3 }"],
                "effects.gusty_wind.speed",
                "3",
            ),
            (
                ["effects = { gusty_wind.speed = 3 }", "\"effects.gusty_wind.speed\" = 3"],
                "effects.gusty_wind.speed",
                "3",
            ),
            (["effects.bumpers = {}", "\"effects.bumpers\" = {}"], "effects.bumpers", "{}"),
            (
                ["system.gravity = { a = 1 }", "\"system.gravity\" = { a = 1 }"],
                "system.gravity",
                "{ a = 1 }",
            ),
            (
                ["actuator.lag.time = { a = 1 }", "\"actuator.lag\".time = { a = 1 }"],
                "actuator.lag.time",
                "{ a = 1 }",
            ),
        ] {
            for text in texts {
                assert_eq!(settings(text), [(key.to_owned(), value.to_owned())], "{text}");
            }
        }
    }
}
