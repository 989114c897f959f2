//! [`Plan`]: many trainings. A plan lists tasks, methods, values of further settings, and seeds.
//!
//! ```toml
//! seeds = 5
//! epochs = 100
//!
//! [[task]]
//! scene = "cart_pole"
//! set = { "system.poles" = 2 }
//!
//! [[method]]                            # or `fields = ["R", "C"]`
//! name = "C, clipped"
//! set = { field = "C", "training.clip" = "norm" }
//!
//! [grid]                                # every combination; [[list]] gives chosen combinations
//! "training.batch" = [8, 32]
//!
//! [best]                                # every combination; results show the best one
//! "training.learning_rate" = [0.01, 0.003]
//! ```

mod contents;

pub use contents::{Contents, FigureLayout, PlannedTask, TASK};

use crate::platform::folder::{COMPARISON, Folder, is_name};
use crate::platform::terminal::counted;
use crate::scenes::grid::{Point, combinations};
use crate::scenes::presets;
use crate::scenes::source::{SceneSource, parse_table, place, read_text};
use crate::settings::FieldName;
use crate::settings::config_error::ConfigError;
use crate::settings::reading::read;
use crate::tasks::Scene;
use crate::tasks::scene::{INITIAL_POLICY, checksum};
use anyhow::{Context, Result, anyhow, bail};
use contents::settings_of;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;
use toml::{Table, Value};

/// Largest number of runs. A run takes about 5 kB before it starts.
const MAX_RUNS: u64 = 100_000;

/// Largest size of the plan in a folder, in bytes.
pub const MAX_PLAN: usize = 40_000_000;

/// Largest length of a name, in bytes. The name of a folder contains two such names.
const MAX_NAME: usize = 100;

/// Number of epochs of a fast trial run.
const QUICK_EPOCHS: usize = 5;

/// Number of samples of each data set of a fast trial run.
const QUICK_SAMPLES: i64 = 64;

/// A validated plan.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Name of the file in messages.
    name: String,
    /// Text of the file, for line numbers.
    text: String,
    pub contents: Contents,
    /// Scene of each task.
    sources: Vec<SceneSource>,
    /// Contents of the initial policies, by the names of their copies beside the plan.
    policies: BTreeMap<String, Vec<u8>>,
}

/// A task at a point of the grid.
pub struct Case {
    /// Index of the task.
    pub task: usize,
    pub point: Point,
    /// Names of task and point, joined by `+`. Empty if neither has a name.
    pub name: String,
}

/// Trainings that differ only in field and seed.
pub struct Cell {
    /// Index of the case.
    pub case: usize,
    /// Index of the method. None if the fields are the methods.
    pub method: Option<usize>,
    /// Index of the combination of the values in `best`.
    pub chosen: usize,
    /// Name of the folder with its runs. Empty for the folder of the plan.
    pub folder: String,
    pub fields: Vec<FieldName>,
    pub scene: Scene,
}

/// All trainings of a plan.
pub struct Expanded {
    pub cases: Vec<Case>,
    /// Combinations of the values in `best`.
    pub chosen: Vec<Point>,
    /// One cell per case, method and combination, in this order.
    pub cells: Vec<Cell>,
}

/// A value that a plan gives to a setting, and the place where it does.
struct Setting {
    key: String,
    value: Value,
    origin: String,
}

impl Plan {
    /// Reads the file at this path, and the scenes that it names.
    ///
    /// # Errors
    /// The file or a scene cannot be read. A key is unknown or has an invalid value. Names are not
    /// distinct, or cannot be parts of the names of folders.
    pub fn read(path: &Path) -> Result<Self> {
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse(&path.display().to_string(), read_text(path)?, folder)?.with_policies(folder)
    }

    /// Plan in the folder of its runs.
    ///
    /// # Errors
    /// As [`read`](Self::read), or an initial policy is not beside the plan.
    pub fn stored(folder: &Folder) -> Result<Self> {
        let name = folder.file(COMPARISON).display().to_string();
        let text = String::from_utf8(folder.read_up_to(COMPARISON, MAX_PLAN)?);
        let mut plan = Self::parse(&name, text.with_context(|| name.clone())?, folder.path())?;
        plan.policies_mut(|name, _| match is_name(name) {
            true => Ok(()),
            false => bail!("`{INITIAL_POLICY}` is {name:?}; allowed: a file beside the plan"),
        })?;
        plan.with_policies(folder.path())
    }

    /// Plan with this name in messages and this text, which names presets only.
    pub fn built_in(name: &str, text: &str) -> Result<Self> {
        Self::parse(name, text.to_owned(), Path::new(""))
    }

    /// Plan of these scenes, of which options name the other contents. Messages name `option` as
    /// the source of the contents.
    pub fn of(option: &str, scenes: Vec<SceneSource>, contents: Contents) -> Result<Self> {
        let (name, text) = (option.to_owned(), String::new());
        let plan = Self { name, text, contents, sources: scenes, policies: BTreeMap::new() };
        plan.contents.validate().map_err(|error| plan.located(&error))?;
        plan.named()?.with_policies(Path::new(""))
    }

    /// Parses the text of the file with this name in `folder`.
    fn parse(name: &str, text: String, folder: &Path) -> Result<Self> {
        let contents = read::<Contents>(parse_table(name, &text)?)
            .map_err(|error| anyhow!("{}: {error}", place(name, &text, &error.key)))?;
        let (name, policies) = (name.to_owned(), BTreeMap::new());
        let mut plan = Self { name, text, contents, sources: Vec::new(), policies };
        plan.contents.flatten();
        plan.contents.validate().map_err(|error| plan.located(&error))?;
        for (i, task) in plan.contents.tasks.iter().enumerate() {
            let key = format!("task[{i}].scene");
            let source = match &task.scene {
                Value::String(scene) if presets::is_path(scene) => {
                    presets::source(&folder.join(scene).to_string_lossy())
                }
                Value::String(scene) => presets::source(scene),
                Value::Table(table) => {
                    SceneSource::inner(&format!("{}, `{key}`", plan.name), table.clone(), folder)
                }
                other => {
                    Err(anyhow!("`{key}` is {other}; allowed: a preset, or the path of a scene"))
                }
            };
            plan.sources.push(source.map_err(|error| anyhow!("{}: {error:#}", plan.place(&key)))?);
        }
        plan.named()
    }

    /// Gives each task a name. Checks the names of tasks and methods.
    fn named(mut self) -> Result<Self> {
        for task in &mut self.contents.tasks {
            task.name = Some(task.name());
        }
        let Contents { tasks, methods, .. } = &self.contents;
        let is_single = tasks.len() == 1;
        let names = tasks.iter().filter_map(|task| task.name.as_deref());
        self.check_names("task", names.filter(|name| !(is_single && name.is_empty())))?;
        self.check_names("method", methods.iter().map(|method| &*method.name))?;
        Ok(self)
    }

    /// Checks that names are distinct and can be parts of the names of folders.
    fn check_names<'a>(&self, list: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
        let mut seen = HashSet::new();
        for (i, name) in names.enumerate() {
            let origin = || self.place(&format!("{list}[{i}].name"));
            if name.is_empty() {
                bail!(
                    "{}: `{list}[{i}].name` is empty; only a single task may have no name",
                    origin()
                );
            }
            let is_reserved = name.starts_with('.') || name.contains(".previous-");
            if is_reserved
                || name.len() > MAX_NAME
                || name.contains(|c: char| "/\\+:".contains(c) || c.is_control())
            {
                bail!(
                    "{}: `{list}[{i}].name` is {name:?}; allowed: a name of up to {MAX_NAME} bytes without `/`, `\\`, \
                     `+`, `:`, `.previous-` and control characters, and without a dot at its start",
                    origin()
                );
            }
            // Some file systems ignore the case of names.
            if !seen.insert(name.to_lowercase()) {
                bail!(
                    "{}: two entries [[{list}]] have the name {name:?}; give them distinct names",
                    origin()
                );
            }
        }
        Ok(())
    }

    /// Reads the initial policies, and replaces their paths by the names of copies beside the plan.
    /// Replaces the scenes by their settings. The plan then depends on no other file.
    fn with_policies(mut self, folder: &Path) -> Result<Self> {
        let mut policies = BTreeMap::new();
        // Points of a grid may have different policies. Names differ with the contents.
        let mut copy = |bytes: Vec<u8>| {
            let name = format!("{INITIAL_POLICY}_{:08x}.safetensors", checksum(&bytes));
            policies.insert(name.clone(), bytes);
            name
        };
        for source in &mut self.sources {
            if let Some(policy) = source.initial_policy()? {
                source.replace(INITIAL_POLICY, Value::String(copy(policy)), "the plan")?;
            }
        }
        for (task, source) in self.contents.tasks.iter_mut().zip(&self.sources) {
            task.scene = Value::Table(source.table().clone());
        }
        self.policies_mut(|path, is_of_scene| {
            if !is_of_scene {
                let policy = Folder::at(folder).read(path);
                *path = copy(policy.with_context(|| format!("`{INITIAL_POLICY}`"))?);
            }
            Ok(())
        })?;
        self.policies = policies;
        Ok(self)
    }

    /// Calls `change` with every path of an initial policy, and with true for the path in a scene.
    fn policies_mut(
        &mut self,
        mut change: impl FnMut(&mut String, bool) -> Result<()>,
    ) -> Result<()> {
        let Contents { grid, best, list, tasks, methods, .. } = &mut self.contents;
        let mut found: Vec<(String, Option<&mut Value>, bool)> = Vec::new();
        for (i, PlannedTask { scene, set, .. }) in tasks.iter_mut().enumerate() {
            found.push((format!("task[{i}].scene"), scene.get_mut(INITIAL_POLICY), true));
            found.push((format!("task[{i}].set"), set.get_mut(INITIAL_POLICY), false));
        }
        for (i, method) in methods.iter_mut().enumerate() {
            found.push((format!("method[{i}].set"), method.set.get_mut(INITIAL_POLICY), false));
        }
        for (i, entry) in list.iter_mut().enumerate() {
            found.push((format!("list[{i}]"), entry.get_mut(INITIAL_POLICY), false));
        }
        for (section, table) in [("grid", grid), ("best", best)] {
            let values = table.get_mut(INITIAL_POLICY).and_then(Value::as_array_mut);
            let values = values.into_iter().flatten();
            found.extend(values.map(|value| (section.to_owned(), Some(value), false)));
        }
        for (section, value, is_of_scene) in found {
            if let Some(Value::String(path)) = value {
                change(path, is_of_scene).map_err(|error| {
                    let place =
                        place(&self.name, &self.text, &format!("{section}.{INITIAL_POLICY}"));
                    anyhow!("{place}: {error:#}")
                })?;
            }
        }
        Ok(())
    }

    /// File and line of a key.
    fn place(&self, key: &str) -> String {
        place(&self.name, &self.text, key)
    }

    fn located(&self, error: &ConfigError) -> anyhow::Error {
        anyhow!("{}: {error}", self.place(&error.key))
    }

    /// Sets few epochs and small data sets, for a fast trial run.
    #[must_use]
    pub fn quick(mut self) -> Self {
        let Contents { epochs, tasks, methods, .. } = &mut self.contents;
        *epochs = Some(QUICK_EPOCHS);
        let sets = tasks.iter_mut().map(|task| &mut task.set);
        for set in sets.chain(methods.iter_mut().map(|method| &mut method.set)) {
            set.remove("epochs");
            for key in ["training.train_samples", "training.test_samples"] {
                set.insert(key.into(), Value::Integer(QUICK_SAMPLES));
            }
        }
        self
    }

    /// Title of the pictures.
    pub fn title(&self) -> String {
        let names = || self.contents.tasks.iter().filter_map(|task| task.name.as_deref());
        self.contents.title.clone().unwrap_or_else(|| names().collect::<Vec<_>>().join(", "))
    }

    /// Returns whether the scenes of all tasks have equal `task`, so that a chart can compare their
    /// losses.
    pub fn has_one_task(&self) -> bool {
        let mut names = self.sources.iter().map(|source| source.text("task"));
        names.next().is_none_or(|first| names.all(|other| other == first))
    }

    /// Returns whether the plan has one cell, whose runs are in the folder of the plan.
    pub fn is_single(&self) -> bool {
        let Contents { tasks, methods, best, .. } = &self.contents;
        let is_unnamed = tasks.iter().all(|task| task.name.as_deref() == Some(""));
        let is_varied = !best.is_empty() || self.contents.varied_keys().next().is_some();
        is_unnamed && methods.is_empty() && !is_varied
    }

    /// Names and contents of the initial policies, which a folder holds beside the plan.
    pub fn policies(&self) -> impl Iterator<Item = (&str, &[u8])> {
        self.policies.iter().map(|(name, bytes)| (&**name, &**bytes))
    }

    /// Plan as a TOML file, with the settings of every scene.
    pub fn to_toml(&self) -> Result<String> {
        Ok(toml::to_string(&self.contents)?)
    }

    /// All trainings.
    ///
    /// # Errors
    /// There are too many. A setting is invalid. Two combinations have one name. There are several
    /// fields, but an estimator follows no field.
    pub fn expand(&self) -> Result<Expanded> {
        let Contents { grid, list, best, tasks, methods, fields, seeds, .. } = &self.contents;
        check_runs(self.contents.combinations(), fields.len().max(1), *seeds)?;
        let (points, chosen) = (combinations(grid, list), combinations(best, &[]));
        let task_sets: Vec<Vec<Setting>> =
            (0..tasks.len()).map(|i| self.set(&format!("task[{i}].set"), &tasks[i].set)).collect();
        let method_sets: Vec<Vec<Setting>> = (0..methods.len())
            .map(|i| self.set(&format!("method[{i}].set"), &methods[i].set))
            .collect();
        let origins = self.origins();
        let indices: Vec<Option<usize>> = match methods.len() {
            0 => vec![None],
            count => (0..count).map(Some).collect(),
        };
        let (mut cases, mut cells, mut seen) = (Vec::new(), Vec::new(), HashSet::new());
        for (task, planned) in tasks.iter().enumerate() {
            let base = self.base(task, &task_sets[task])?;
            let task_name = planned.name.as_deref().unwrap_or_default();
            for point in &points {
                let name = joined(&[task_name, &point.name()]);
                for &method in &indices {
                    let method_name = method.map_or("", |method| &methods[method].name);
                    let of_cell = |error| in_cell(error, task_name, method_name);
                    for (i, chosen) in chosen.iter().enumerate() {
                        let mut source = base.clone();
                        for (key, value) in point.iter().chain(chosen.iter()) {
                            source.replace(key, value.clone(), &origins[key]).map_err(of_cell)?;
                        }
                        if let Some(method) = method {
                            apply(&mut source, &method_sets[method]).map_err(of_cell)?;
                        }
                        let folder = joined(&[&name, method_name, &chosen.name()]);
                        if !seen.insert(folder.to_lowercase()) {
                            bail!(
                                "{}: two combinations have the name {folder}; give distinct values",
                                self.name
                            );
                        }
                        let scene = self.scene(&source).map_err(of_cell)?;
                        let fields =
                            if fields.is_empty() { vec![scene.field] } else { fields.clone() };
                        self.check_estimator(&source, &scene, &fields).map_err(of_cell)?;
                        let case = cases.len();
                        cells.push(Cell { case, method, chosen: i, folder, fields, scene });
                    }
                }
                cases.push(Case { task, point: point.clone(), name });
            }
        }
        Ok(Expanded { cases, chosen, cells })
    }

    /// File and line of each varied setting, by its key.
    fn origins(&self) -> HashMap<String, String> {
        let Contents { grid, list, best, .. } = &self.contents;
        let varied =
            |section: &str, key: &String| (key.clone(), self.place(&format!("{section}.{key}")));
        grid.keys()
            .map(|key| varied("grid", key))
            .chain(best.keys().map(|key| varied("best", key)))
            .chain(list.iter().take(1).flat_map(Table::keys).map(|key| varied("list[0]", key)))
            .collect()
    }

    /// Scene of a task with its table `set`.
    fn base(&self, task: usize, set: &[Setting]) -> Result<SceneSource> {
        let mut source = self.sources[task].clone();
        if let Some(epochs) = self.contents.epochs {
            source.replace("epochs", Value::try_from(epochs)?, &self.place("epochs"))?;
        }
        apply(&mut source, set)?;
        Ok(source)
    }

    /// Validates the scene of a cell.
    fn scene(&self, source: &SceneSource) -> Result<Scene> {
        let policy = source.text(INITIAL_POLICY).and_then(|name| self.policies.get(name));
        let scene = source.starting_from(policy.map(Vec::as_slice))?;
        if scene.epochs == 0 {
            bail!("{}: `epochs` is 0; allowed: 1 or more", self.place("epochs"));
        }
        scene.check_truncation().map_err(|error| source.located(&error))?;
        Ok(scene)
    }

    /// Checks that fields differ with the estimator of a scene, and read the settings of its
    /// training.
    ///
    /// # Errors
    /// There are several fields, but the estimator reads losses only. No field reads a setting.
    fn check_estimator(
        &self,
        source: &SceneSource,
        scene: &Scene,
        fields: &[FieldName],
    ) -> Result<()> {
        if fields.len() > 1 && scene.reads_losses_only() {
            bail!(
                "{}: `fields` names {} fields, but has no effect: `training.estimator` is zeroth_order, which follows differences \
                 of losses; name one field, for example R, or choose another estimator",
                self.place("fields"),
                fields.len()
            );
        }
        // A setting of a task is one of all its methods.
        if self.contents.methods.is_empty() {
            let fields: Vec<_> = fields.iter().map(|field| field.0).collect();
            scene.check_fields(&fields).map_err(|error| source.located(&error))?;
        }
        Ok(())
    }

    /// Settings of the table `set`, which has the key `path` in the plan.
    fn set(&self, path: &str, set: &Table) -> Vec<Setting> {
        let setting = |(key, value): (String, &Value)| {
            let origin = self.place(&format!("{path}.{key}"));
            Setting { key, value: value.clone(), origin }
        };
        settings_of(set).into_iter().map(setting).collect()
    }
}

/// Checks the number of runs before they are planned.
///
/// # Errors
/// Combinations of settings, fields and seeds give more than [`MAX_RUNS`] runs.
fn check_runs(combinations: usize, fields: usize, seeds: u64) -> Result<()> {
    let runs = (combinations as u64).saturating_mul(fields as u64).saturating_mul(seeds);
    if runs > MAX_RUNS {
        bail!(
            "{combinations} combinations of settings, {} and {seeds} seeds give {runs} runs; allowed: up to {MAX_RUNS}",
            counted(fields, "field")
        );
    }
    Ok(())
}

/// Appends the names of task and method to an error, except for empty names.
fn in_cell(error: anyhow::Error, task: &str, method: &str) -> anyhow::Error {
    let place = [("task", task), ("method", method)]
        .into_iter()
        .filter(|(_, name)| !name.is_empty())
        .map(|(kind, name)| format!("{kind} {name}"))
        .collect::<Vec<_>>()
        .join(", ");
    match &*place {
        "" => error,
        place => anyhow!("{error:#} ({place})"),
    }
}

/// Sets values in a scene.
fn apply(source: &mut SceneSource, settings: &[Setting]) -> Result<()> {
    for Setting { key, value, origin } in settings {
        match value {
            // An effect with its defaults, or with the settings of the scene.
            Value::Table(section) if section.is_empty() => {
                source.put(key, value.clone(), origin)?
            }
            value => source.replace(key, value.clone(), origin)?,
        }
    }
    Ok(())
}

/// Joins the names that are not empty by `+`.
fn joined(names: &[&str]) -> String {
    names.iter().filter(|name| !name.is_empty()).copied().collect::<Vec<_>>().join("+")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plan with one task, the field C and these further lines.
    fn plan(lines: &str) -> Result<Plan> {
        let text = format!("fields = [\"C\"]\n{lines}\n[[task]]\nscene = \"lqr\"\n");
        Plan::built_in("plan", &text)
    }

    #[test]
    fn varied_keys_have_distinct_values_in_one_section() {
        for (lines, message) in [
            ("grid.x = []", "`grid.x` is []; allowed: a list of values"),
            ("grid.x = 3", "`grid.x` is 3; allowed: a list of values"),
            ("grid.x = [1, 2, 1]", "`grid.x[2]` is 1; allowed: distinct values"),
            ("grid.x = [1]\nbest.x = [2]", "plan:3: `best.x` is also in `grid`"),
            ("grid.x = [1]\n[[list]]\nx = 2", "`list[0].x` is also in `grid`"),
            ("[[list]]\nx = 1\n[[list]]\ny = 1", "`list[1]` has `y`, which the first entry lacks"),
            (
                "[[list]]\nx = 1\ny = 2\n[[list]]\ny = 1",
                "`list[1]` lacks `x`, which the first entry has",
            ),
            ("grid.field = [\"R\"]", "`grid.field` cannot be varied"),
            ("grid.seed = [1]", "`grid.seed` cannot be set"),
            ("[figure]\nmean = 0", "`figure.mean` is 0; allowed: 1 or more"),
            ("[figure]\nrows = \"x\"", "`figure.rows` is x; allowed: `task`"),
            (
                "grid.x = [1, 2]\n[figure]\ncolumns = \"x\"\nupdate_size = 3",
                "`figure.update_size` is 3; allowed: 1, 2",
            ),
            (
                "grid.x = [1, 2]\n[figure]\nrows = \"x\"\nupdate_size = 2",
                "`figure.update_size` is 2; allowed: a value of `columns`, which is missing",
            ),
            ("grid.x = [1]\n[figure]", "`figure` needs `x` as either `rows` or `columns`"),
            ("[[method]]\nname = \"a\"", "`fields` replaces methods"),
        ] {
            let found = plan(lines).expect_err(lines).to_string();
            assert!(found.contains(message), "{lines}: {found}");
        }
        let name = "grid.\"training.batch\" = [8, 4]\nbest.training.learning_rate = [0.1, 1.0]";
        let expanded = plan(name).expect("a plan").expand().expect("trainings");
        let folders: Vec<&str> = expanded.cells.iter().map(|cell| &*cell.folder).collect();
        assert_eq!(folders[0], "lqr+batch=8+learning_rate=0.1");
        assert_eq!(folders[3], "lqr+batch=4+learning_rate=1");
        let same = plan("grid.\"training.clip_limit\" = [1, 1.0]\n").expect("distinct values");
        let error = same.expand().err().expect("one name").to_string();
        assert!(error.contains("two combinations have the name lqr+clip_limit=1"), "{error}");
    }
}
