//! What a command line changes of a scene, or of a run that is to be resumed.

use crate::program::scenes::source::{SceneSource, short};
use crate::program::settings::{FieldName, Precision};
use anyhow::{Context, Result, bail};
use toml::Value;

/// What differs from the scene.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Overrides {
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
    /// Change or add a setting, for example system.poles=4; `physgrad tasks` lists them
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Leave an effect or a part of the actuator out
    #[arg(long, value_name = "NAME")]
    pub without: Vec<String>,
}

impl Overrides {
    /// Makes the changes in a document.
    pub fn apply(&self, document: &mut SceneSource) -> Result<()> {
        for name in &self.without {
            document.without(name)?;
        }
        for assignment in &self.set {
            set(document, assignment)?;
        }
        let named = [
            ("field", self.field.map(|f| Value::String(f.into()))),
            ("epochs", self.epochs.map(|e| integer("--epochs", e as u64)).transpose()?),
            ("seed", self.seed.map(|s| integer("--seed", s)).transpose()?),
            ("precision", self.precision.map(Value::try_from).transpose()?),
        ];
        for (key, value) in named {
            if let Some(value) = value {
                document.put(key, value, &format!("--{key}"))?;
            }
        }
        Ok(())
    }

    /// Makes the changes in a document in which they may have been made before: what it was left without may be gone.
    pub fn apply_again(&self, document: &mut SceneSource) -> Result<()> {
        let without = self.without.iter().filter(|name| document.has(name)).cloned().collect();
        Self { without, ..self.clone() }.apply(document)
    }
}

/// TOML's integers are signed.
fn integer(option: &str, value: u64) -> Result<Value> {
    let value = i64::try_from(value).ok().with_context(|| format!("{option} is {value}; allowed: up to {}", i64::MAX))?;
    Ok(Value::Integer(value))
}

/// Changes one setting: `training.learning_rate=3e-4`.
pub fn set(document: &mut SceneSource, assignment: &str) -> Result<()> {
    let option = format!("--set {}", short(assignment));
    let (key, text) =
        assignment.split_once('=').with_context(|| format!("{option}: write KEY=VALUE, for example system.poles=4"))?;
    let (key, text) = (key.trim(), text.trim());
    if ["physgrad", "scene", "task"].contains(&key) {
        bail!("{option}: `{key}` says what the other settings are of, and cannot be set");
    }
    // A word that is no TOML value is a string: shells take the quotes away.
    let value = text.parse().unwrap_or_else(|_| Value::String(text.into()));
    document.put(key, value, &option)
}
