//! Options of the command line that override settings of a scene or of a resumed run.

use crate::platform::folder::POLICY;
use crate::platform::terminal::print_message;
use crate::scenes::grid::several;
use crate::scenes::source::{SceneSource, find, short};
use crate::settings::reading::{NUMBER_KEYS, is_drawn, is_number};
use crate::settings::{FieldName, LogFormat, Precision};
use crate::tasks::scene::INITIAL_POLICY;
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use toml::{Table, Value};

/// Options that replace settings of a scene.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Overrides {
    /// Vector field to follow: combined, regular, modified, network, stopped, projected,
    /// conflict_free, modified_signed, regular_scaled (C, R, M, N, S, P, F, MR, RM)
    #[arg(long, value_parser = |name: &str| name.parse().map(FieldName))]
    pub field: Option<FieldName>,
    /// Total number of epochs, including those before --resume
    #[arg(long, value_name = "N")]
    pub epochs: Option<u64>,
    /// Seed of initial states and initial parameters
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Floating-point precision of all computations
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    /// Start from this policy: a file `policy.safetensors`, or the folder of a run
    #[arg(long, value_name = "FILE")]
    pub policy: Option<PathBuf>,
    /// Tag of the run, for `physgrad runs --tag`
    #[arg(long)]
    pub tag: Vec<String>,
    /// Also write the metrics of every epoch in these formats, for other tools
    #[arg(long, value_enum, value_delimiter = ',', value_name = "FORMAT")]
    pub log: Vec<LogFormat>,
    /// Change or add a setting, for example system.poles=4; `physgrad tasks TASK` lists them
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Remove an effect, or a part of the actuator or the sensor
    #[arg(long, value_name = "NAME")]
    pub without: Vec<String>,
}

/// Options that set a key each, with the key.
const OPTIONS: [(&str, &str); 7] = [
    ("field", "field"),
    ("epochs", "epochs"),
    ("seed", "seed"),
    ("precision", "precision"),
    ("tag", "tags"),
    ("log", "log"),
    ("policy", INITIAL_POLICY),
];

impl Overrides {
    /// Applies the overrides to a scene: first `--without`, then `--set`, then the other options.
    pub fn apply(&self, source: &mut SceneSource) -> Result<()> {
        for name in &self.without {
            source.without(name)?;
        }
        for assignment in &self.set {
            set(source, assignment)?;
        }
        let overrides = [
            ("field", self.field.map(|f| Value::String(f.into()))),
            ("epochs", self.epochs.map(|e| integer("--epochs", e)).transpose()?),
            ("seed", self.seed.map(|s| integer("--seed", s)).transpose()?),
            ("precision", self.precision.map(Value::try_from).transpose()?),
        ];
        for (key, value) in overrides {
            if let Some(value) = value {
                source.put(key, value, &format!("--{key}"))?;
            }
        }
        if !self.tag.is_empty() {
            source.put("tags", Value::from(self.tag.clone()), "--tag")?;
        }
        if !self.log.is_empty() {
            source.put("log", Value::try_from(&self.log)?, "--log")?;
        }
        if let Some(path) = &self.policy {
            let option = format!("--policy {}", path.display());
            let file = if path.is_dir() { path.join(POLICY) } else { path.clone() };
            let file =
                file.to_str().with_context(|| format!("{option}: the path is not UTF-8 text"))?;
            source.put(INITIAL_POLICY, Value::String(file.into()), &option)?;
        }
        Ok(())
    }

    /// Refuses options for settings that a command does not read. `is_unread` decides by the key,
    /// `what` names the command.
    pub fn refuse(&self, is_unread: impl Fn(&str) -> bool, what: &str) -> Result<()> {
        let is_given = [
            self.field.is_some(),
            self.epochs.is_some(),
            self.seed.is_some(),
            self.precision.is_some(),
            !self.tag.is_empty(),
            !self.log.is_empty(),
            self.policy.is_some(),
        ];
        let options = OPTIONS.into_iter().zip(is_given).filter(|(_, is_given)| *is_given);
        let assigned = self.set.iter().map(|assignment| {
            let key = assignment.split('=').next().unwrap_or_default().trim();
            (key, format!("--set {}", short(assignment)))
        });
        let given = options.map(|((option, key), _)| (key, format!("--{option}")));
        match given.chain(assigned).find(|(key, _)| is_unread(key)) {
            Some((_, option)) => bail!("{option} has no effect on {what}; remove it"),
            None => Ok(()),
        }
    }

    /// Applies the overrides to a scene that may already contain them.
    ///
    /// Ignores names in `--without` that the scene does not contain.
    pub fn apply_again(&self, source: &mut SceneSource) -> Result<()> {
        let without = self.without.iter().filter(|name| source.has(name)).cloned().collect();
        Self { without, ..self.clone() }.apply(source)
    }
}

/// Whether only trainings read the setting with this key. The budget of a training is also that of
/// rollouts.
pub fn is_of_training(key: &str) -> bool {
    key.starts_with("training.") && key != "training.memory"
        || is_of_windows(key)
        || ["epochs", "field", "tags", "log", INITIAL_POLICY].contains(&key)
}

/// Whether the setting with this key is one of windows, whose length also checks and the memory need.
pub fn is_of_windows(key: &str) -> bool {
    key == "window" || key.starts_with("window.")
}

/// Hides the options that a command refuses in its help. `is_unread` as in [`Overrides::refuse`].
pub fn hide(is_unread: impl Fn(&str) -> bool) -> impl Fn(clap::Arg) -> clap::Arg {
    move |arg| {
        let option = OPTIONS.iter().find(|(option, _)| *option == arg.get_id().as_str());
        let is_hidden = option.is_some_and(|(_, key)| is_unread(key));
        if is_hidden { arg.hide(true) } else { arg }
    }
}

/// Removes the assignments with several values from `set`. Returns their keys with lists of values.
///
/// # Errors
/// Another assignment or an option sets a key with several values.
pub fn take_several(overrides: &mut Overrides) -> Result<Table> {
    let mut grid = Table::new();
    let (mut single, mut keys) = (Vec::new(), Vec::new());
    for assignment in std::mem::take(&mut overrides.set) {
        let (key, text) = assignment.split_once('=').unwrap_or((&*assignment, ""));
        let key = key.trim().to_owned();
        match several(text.trim()) {
            Some(values) => drop(grid.insert(key.clone(), Value::Array(values))),
            None => single.push(assignment),
        }
        keys.push(key);
    }
    overrides.set = single;
    let options =
        [("epochs", overrides.epochs.is_some()), ("precision", overrides.precision.is_some())];
    keys.extend(options.into_iter().filter(|(_, given)| *given).map(|(key, _)| key.to_owned()));
    match grid.keys().find(|key| keys.iter().filter(|other| other == key).count() > 1) {
        Some(key) => bail!("`{key}` has several values and is set twice; give its values once"),
        None => Ok(grid),
    }
}

/// Converts to an integer of TOML, which is signed.
fn integer(option: &str, value: u64) -> Result<Value> {
    let value = i64::try_from(value)
        .ok()
        .with_context(|| format!("{option} is {value}; allowed: up to {}", i64::MAX))?;
    Ok(Value::Integer(value))
}

/// Applies one assignment, for example `training.learning_rate=3e-4`.
pub fn set(source: &mut SceneSource, assignment: &str) -> Result<()> {
    let option = format!("--set {}", short(assignment));
    let (key, text) = assignment
        .split_once('=')
        .with_context(|| format!("{option}: write KEY=VALUE, for example system.poles=4"))?;
    let (key, text) = (key.trim(), text.trim());
    if ["physgrad", "scene", "task"].contains(&key) {
        bail!(
            "{option}: `{key}` defines the meaning of the other settings and cannot be set; edit the scene file"
        );
    }
    if let Some((section, number)) =
        key.split_once('.').filter(|(section, _)| ["vary", "fit"].contains(section))
    {
        let example = if section == "vary" { "{ uniform = [1, 2] }" } else { "{ start = 1 }" };
        // A key of the section may be quoted, and a key of its value may follow.
        let number = match number.strip_prefix(['"', '\'']) {
            Some(quoted) => quoted.split(['"', '\'']).next().unwrap_or_default(),
            None => number
                .rsplit_once('.')
                .filter(|(_, key)| NUMBER_KEYS.contains(key))
                .map_or(number, |(key, _)| key),
        };
        let number =
            if number.contains('.') { number.to_owned() } else { format!("system.{number}") };
        bail!(
            "{option}: only scene files have the section `{section}`; write the setting itself, as in --set '{number}={example}'"
        );
    }
    if several(text).is_some() {
        bail!("{option}: `{key}` has several values, which only `compare` trains; choose one");
    }
    // Reads text that is not a TOML value as a string, because shells remove quotes.
    let value = text.parse().unwrap_or_else(|_| Value::String(text.into()));
    if let Some(before) = find(source.table(), key).and_then(Value::as_table)
        && is_number(before)
        && !value.is_table()
    {
        let what = if is_drawn(before) { "varies" } else { "is unknown" };
        print_message(&format!(
            "note: {option} replaces {}, so that the number no longer {what}",
            Value::Table(before.clone())
        ));
    }
    source.put(key, value, &option)
}
