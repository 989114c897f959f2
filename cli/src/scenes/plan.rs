//! [`Plan`]: tasks, methods and learning rates of a study.
//!
//! ```toml
//! seeds = 5
//! epochs = 100
//! learning_rates = [0.01, 0.003]
//!
//! [[task]]
//! scene = "cart_pole"
//! set = { "system.poles" = 2 }
//!
//! [[method]]
//! name = "C, clipped"
//! set = { field = "C", "training.clip" = "norm" }
//! ```

use crate::scenes::presets;
use crate::scenes::source::{SceneSource, parse_table, place, read_text};
use crate::settings::OPTIONAL;
use crate::settings::config_error::{ConfigError, allowed};
use crate::settings::reading::read;
use crate::tasks::Scene;
use crate::tasks::scene::INITIAL_POLICY;
use anyhow::{Result, anyhow, bail};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::path::Path;
use toml::{Table, Value};

/// Largest number of combinations of a task, a method and a learning rate. Also the largest number
/// of seeds.
const MAX: usize = 10_000;

/// Largest length of a name, in bytes. The name of a folder contains two such names.
const MAX_NAME: usize = 100;

/// Key of the learning rate in a scene.
const LEARNING_RATE: &str = "training.learning_rate";

/// Settings of a fast trial run.
const QUICK: [(&str, i64); 3] =
    [("epochs", 5), ("training.train_samples", 64), ("training.test_samples", 64)];

/// Keys that a plan cannot set, with the reasons.
const REFUSED: [(&str, &str); 5] = [
    (INITIAL_POLICY, "a study trains from random parameters"),
    ("seed", "a study trains several seeds; choose their number with `seeds`"),
    ("task", "it defines the meaning of the other settings; name another `scene`"),
    ("scene", "it defines the meaning of the other settings; name another `scene`"),
    ("physgrad", "it is the version of the program"),
];

/// Tasks, methods and learning rates of a study. A study trains every combination with each seed.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Name of the file in messages.
    name: String,
    /// Text of the file, for line numbers.
    text: String,
    contents: Contents,
    /// Scene of each task.
    sources: Vec<SceneSource>,
}

/// Contents of the file.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Contents {
    #[serde(default = "default_seeds")]
    seeds: u64,
    /// Replaces the number of epochs of every scene. A table `set` may replace it again.
    #[serde(skip_serializing_if = "Option::is_none")]
    epochs: Option<usize>,
    /// Learning rates of every method. None if the scenes and the tables `set` determine the rates.
    #[serde(skip_serializing_if = "Option::is_none")]
    learning_rates: Option<Vec<f64>>,
    #[serde(rename = "task", default)]
    tasks: Vec<PlannedTask>,
    #[serde(rename = "method", default)]
    methods: Vec<PlannedMethod>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct PlannedTask {
    /// Name of the task. Default: the name of the scene, or `task` if the plan contains the
    /// settings of the scene.
    name: Option<String>,
    /// Name of a preset, path relative to the plan, or settings of a scene.
    scene: Value,
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    set: Table,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct PlannedMethod {
    name: String,
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    set: Table,
}

fn default_seeds() -> u64 {
    3
}

/// Combination of a task, a method and a learning rate.
pub struct Cell {
    pub task: String,
    pub method: String,
    pub learning_rate: f64,
    /// Name of the folder with its runs.
    pub folder: String,
    pub scene: Scene,
}

impl Plan {
    /// Reads the file at this path, and the scenes that it names.
    ///
    /// # Errors
    /// The file or a scene cannot be read. A key is unknown or has an invalid value. A scene has an
    /// initial policy. Names are not distinct, or cannot be parts of the names of folders.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(
            &path.display().to_string(),
            read_text(path)?,
            path.parent().unwrap_or(Path::new("")),
        )
    }

    /// Parses the text of the file with this name in `folder`.
    fn parse(name: &str, text: String, folder: &Path) -> Result<Self> {
        let located = |error: ConfigError| anyhow!("{}: {error}", place(name, &text, &error.key));
        let contents = read::<Contents>(parse_table(name, &text)?).map_err(located)?;
        contents.validate().map_err(located)?;
        let mut plan = Self { name: name.to_owned(), text, contents, sources: Vec::new() };
        for i in 0..plan.contents.tasks.len() {
            let task = &plan.contents.tasks[i];
            let key = format!("task[{i}].scene");
            let source = match &task.scene {
                Value::String(scene) if presets::is_path(scene) => {
                    presets::source(&folder.join(scene).to_string_lossy())
                }
                Value::String(scene) => presets::source(scene),
                Value::Table(table) => {
                    SceneSource::inner(&format!("{name}, `{key}`"), table.clone())
                }
                other => {
                    Err(anyhow!("`{key}` is {other}; allowed: a preset, or the path of a scene"))
                }
            };
            let source = source.map_err(|error| anyhow!("{}: {error:#}", plan.place(&key)))?;
            if source.table().contains_key(INITIAL_POLICY) {
                bail!(
                    "{}: the scene sets `{INITIAL_POLICY}`; a study trains from random parameters",
                    plan.place(&key)
                );
            }
            plan.sources.push(source);
        }
        plan.name_tasks()?;
        Ok(plan)
    }

    /// Gives each task a name. Replaces the scenes by their settings, so that the plan does not
    /// depend on other files. Checks the names of tasks and methods.
    fn name_tasks(&mut self) -> Result<()> {
        for (task, source) in self.contents.tasks.iter_mut().zip(&self.sources) {
            let scene = task.scene.as_str().map_or_else(|| "task".into(), presets::short_name);
            task.name.get_or_insert(scene);
            task.scene = Value::Table(source.table().clone());
        }
        let Contents { tasks, methods, .. } = &self.contents;
        self.check_names("task", tasks.iter().filter_map(|task| task.name.as_deref()))?;
        self.check_names("method", methods.iter().map(|method| &*method.name))
    }

    /// Checks that names are distinct and can be parts of the names of folders.
    fn check_names<'a>(&self, list: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
        let mut seen = HashSet::new();
        for (i, name) in names.enumerate() {
            let origin = self.place(&format!("{list}[{i}].name"));
            let is_reserved = name.starts_with('.') || name.contains(".previous-");
            if name.is_empty()
                || is_reserved
                || name.len() > MAX_NAME
                || name.contains(|c: char| "/\\+:".contains(c) || c.is_control())
            {
                bail!(
                    "{origin}: `{list}[{i}].name` is {name:?}; allowed: a name of up to {MAX_NAME} bytes without `/`, `\\`, \
                     `+`, `:`, `.previous-` and control characters, and without a dot at its start"
                );
            }
            // Some file systems ignore the case of names.
            if !seen.insert(name.to_lowercase()) {
                bail!(
                    "{origin}: two entries [[{list}]] have the name {name:?}; give them distinct names"
                );
            }
        }
        Ok(())
    }

    /// File and line of a key.
    fn place(&self, key: &str) -> String {
        place(&self.name, &self.text, key)
    }

    /// Sets few epochs and small data sets, for a fast trial run.
    #[must_use]
    pub fn quick(mut self) -> Self {
        for method in &mut self.contents.methods {
            method.set.extend(QUICK.map(|(key, value)| (key.to_owned(), Value::Integer(value))));
        }
        self
    }

    /// Number of consecutive seeds. The first one is the seed of the scene.
    pub fn seeds(&self) -> u64 {
        self.contents.seeds
    }

    /// Number of combinations of a task, a method and a learning rate.
    pub fn combinations(&self) -> usize {
        self.contents.combinations()
    }

    /// Plan as a TOML file, with the settings of every scene.
    pub fn to_toml(&self) -> Result<String> {
        Ok(toml::to_string(&self.contents)?)
    }

    /// All combinations, grouped by task, then by method.
    ///
    /// # Errors
    /// A setting is invalid.
    pub fn cells(&self) -> Result<Vec<Cell>> {
        let Contents { tasks, methods, learning_rates, .. } = &self.contents;
        let rates = || {
            learning_rates
                .as_ref()
                .map_or_else(|| vec![None], |rates| rates.iter().copied().map(Some).collect())
        };
        let mut cells = Vec::new();
        for task in 0..tasks.len() {
            for method in 0..methods.len() {
                for rate in rates() {
                    cells.push(self.cell(task, method, rate)?);
                }
            }
        }
        Ok(cells)
    }

    fn cell(&self, task: usize, method: usize, rate: Option<f64>) -> Result<Cell> {
        let Contents { tasks, methods, epochs, .. } = &self.contents;
        let names = [tasks[task].name.clone().unwrap_or_default(), methods[method].name.clone()];
        let of_cell =
            |error: anyhow::Error| anyhow!("{error:#} (task {}, method {})", names[0], names[1]);
        let mut source = self.sources[task].clone();
        if let Some(epochs) = epochs {
            source.replace("epochs", Value::try_from(epochs)?, &self.place("epochs"))?;
        }
        self.set(&mut source, &format!("task[{task}].set"), &tasks[task].set).map_err(of_cell)?;
        self.set(&mut source, &format!("method[{method}].set"), &methods[method].set)
            .map_err(of_cell)?;
        if let Some(rate) = rate {
            source.replace(LEARNING_RATE, Value::Float(rate), &self.place("learning_rates"))?;
        }
        let scene = source.scene().map_err(of_cell)?;
        if scene.epochs == 0 {
            return Err(of_cell(anyhow!(
                "{}: `epochs` is 0; allowed: 1 or more",
                self.place("epochs")
            )));
        }
        let learning_rate = scene.training.learning_rate;
        let [task, method] = names;
        let folder = match rate {
            Some(rate) => format!("{task}+{method}+learning_rate={rate}"),
            None => format!("{task}+{method}"),
        };
        Ok(Cell { task, method, learning_rate, folder, scene })
    }

    /// Sets the values of the table `set`, which has the key `path` in the plan. In TOML, a dotted
    /// key without quotation marks, as in `policy.widths = [4]`, is a table inside a table. Such a
    /// table replaces only those keys of a section that it contains.
    fn set(&self, source: &mut SceneSource, path: &str, set: &Table) -> Result<()> {
        for (key, value) in set {
            let mut settings = Vec::new();
            settings_of(key.clone(), value, &mut settings);
            for (key, value) in settings {
                let origin = self.place(&format!("{path}.{key}"));
                if let Some((_, reason)) = REFUSED.iter().find(|(refused, _)| *refused == key) {
                    bail!("{origin}: `{key}` cannot be set: {reason}");
                }
                if key == LEARNING_RATE && self.contents.learning_rates.is_some() {
                    bail!(
                        "{origin}: `{key}` is set, but `learning_rates` replaces it; remove one of them"
                    );
                }
                match value {
                    // An effect with its defaults, or with the settings of the scene.
                    Value::Table(section) if section.is_empty() => {
                        source.put(&key, value.clone(), &origin)?
                    }
                    value => source.replace(&key, value.clone(), &origin)?,
                }
            }
        }
        Ok(())
    }
}

/// Appends the settings in the value of a key. The value of a section contains several settings.
fn settings_of<'a>(key: String, value: &'a Value, settings: &mut Vec<(String, &'a Value)>) {
    let is_section = key
        .split_once('.')
        .is_none_or(|(section, name)| OPTIONAL.contains(&section) && !name.contains('.'));
    match value {
        Value::Table(section) if is_section && !section.is_empty() => {
            section
                .iter()
                .for_each(|(inner, value)| settings_of(format!("{key}.{inner}"), value, settings));
        }
        value => settings.push((key, value)),
    }
}

impl Contents {
    fn combinations(&self) -> usize {
        let rates = self.learning_rates.as_ref().map_or(1, Vec::len);
        self.tasks.len().saturating_mul(self.methods.len()).saturating_mul(rates)
    }

    fn validate(&self) -> Result<(), ConfigError> {
        allowed(
            "seeds",
            self.seeds,
            (1..=MAX as u64).contains(&self.seeds),
            format!("1 to {MAX}"),
        )?;
        if let Some(rates) = &self.learning_rates {
            allowed("learning_rates", "[]", !rates.is_empty(), "one learning rate or more")?;
            for (i, rate) in rates.iter().enumerate() {
                let key = format!("learning_rates[{i}]");
                allowed(&key, rate, !rates[..i].contains(rate), "distinct learning rates")?;
            }
        }
        for (key, count) in [("task", self.tasks.len()), ("method", self.methods.len())] {
            if count == 0 {
                return Err(ConfigError::new(key, format!("is missing; add an entry [[{key}]]")));
            }
        }
        let cells = self.combinations();
        allowed(
            "task",
            format!("{cells} combinations of task, method and learning rate"),
            cells <= MAX,
            format!("up to {MAX}"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_and_dotted_keys_give_equal_settings() {
        let settings = |text: &str| {
            let table: Table = text.parse().expect("TOML");
            let mut found = Vec::new();
            table.iter().for_each(|(key, value)| settings_of(key.clone(), value, &mut found));
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
