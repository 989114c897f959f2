//! What a command line changes of a task's defaults, or of a run that is to be resumed.

use super::folder::Folder;
use super::saved;
use super::scene::Scene;
use super::settings::{self, FieldName, Precision, Settings};
use anyhow::{Context, Result, bail};
use physgrad::differences;
use toml::{Table, Value};

/// What differs from a task's defaults.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Changes {
    /// Vector field to follow: combined, regular, modified, network, stopped (C, R, M, N, S)
    #[arg(long, value_parser = |name: &str| name.parse().map(FieldName))]
    pub field: Option<FieldName>,
    /// Epochs in all, those before a --resume included
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Seed of start states and initial parameters
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Precision of all numbers
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    /// Change a setting, for example system.poles=4; `physgrad tasks` lists them
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl Changes {
    /// Makes the changes in a table of settings.
    pub fn apply(&self, table: &mut Table) -> Result<()> {
        for assignment in &self.set {
            settings::set(table, assignment)?;
        }
        let named = [
            ("field", self.field.map(|f| Value::String(f.into()))),
            ("epochs", self.epochs.map(|e| integer("--epochs", e as u64)).transpose()?),
            ("seed", self.seed.map(|s| integer("--seed", s)).transpose()?),
            ("precision", self.precision.map(Value::try_from).transpose()?),
        ];
        for (key, value) in named {
            if let Some(value) = value {
                settings::put(table, key, value)?;
            }
        }
        Ok(())
    }
}

/// TOML's integers are signed.
fn integer(option: &str, value: u64) -> Result<Value> {
    let value = i64::try_from(value).ok().with_context(|| format!("{option} is {value}; allowed: up to {}", i64::MAX))?;
    Ok(Value::Integer(value))
}

/// A task's defaults with these changes.
pub fn changed_settings<S: Scene>(changes: &Changes) -> Result<Settings<S>> {
    let mut table = Settings::<S>::defaults().to_table();
    changes.apply(&mut table)?;
    Settings::from_table(table)
}

/// An error unless the run in the folder has these settings; only the number of epochs may differ.
pub fn check_resumable<S: Scene>(folder: &Folder, settings: &Settings<S>) -> Result<()> {
    let saved = saved::settings::<S>(folder)?.identity();
    if settings.identity() != saved {
        bail!(
            "a resumed run keeps its settings (only the number of epochs may change); in {}, these differ:\n{}",
            folder.path().display(),
            differences(&saved, &settings.identity())
        );
    }
    Ok(())
}

/// The settings of the run in the folder, with these changes.
pub fn resumed_settings<S: Scene>(folder: &Folder, changes: &Changes) -> Result<Settings<S>> {
    if !saved::has_run(folder) {
        bail!("there is no run to resume in {}; without --resume, a new one starts there", folder.path().display());
    }
    let mut table = saved::settings::<S>(folder)?.to_table();
    changes.apply(&mut table)?;
    let settings = Settings::<S>::from_table(table)?;
    check_resumable(folder, &settings)?;
    Ok(settings)
}
