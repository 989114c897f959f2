//! `physgrad scene` and `physgrad schema`: what one needs to write a scene of one's own.

use super::kind;
use super::presets;
use super::terminal::say;
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Print a preset, to start a scene of your own from: physgrad scene cart_pole > my_scene.toml
///
/// A scene is a TOML file. It is run by `physgrad train my_scene.toml`, and goes wherever the name of a preset goes. What
/// it does not say has the task's default; effects that it does not name are absent. For completion and hints in an
/// editor: `physgrad schema --out scene.schema.json`, and `#:schema scene.schema.json` as the first line of the scene.
#[derive(Debug, clap::Args)]
pub struct Scene {
    /// The preset [default: list all]
    pub preset: Option<String>,
}

/// Write the JSON schema of scenes, by which editors complete and check them.
#[derive(Debug, clap::Args)]
pub struct Schema {
    /// The file [default: print it]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Runs `scene`.
pub fn scene(args: &Scene) -> Result<()> {
    match &args.preset {
        Some(name) => say(presets::text(name)?.trim_end()),
        None => {
            let width = presets::all().map(|(name, _)| name.len()).max().unwrap_or(0);
            presets::all().try_for_each(|(name, about)| say(&format!("{name:width$}  {about}")))
        }
    }
}

/// Runs `schema`.
pub fn schema(args: &Schema) -> Result<()> {
    let text = serde_json::to_string_pretty(&kind::schema())?;
    match &args.out {
        Some(path) => std::fs::write(path, text + "\n").with_context(|| format!("cannot write {}", path.display())),
        None => say(&text),
    }
}
