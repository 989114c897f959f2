//! `physgrad scene` and `physgrad schema`: print presets and the JSON schema of scenes.

use crate::program::platform::terminal::print_result;
use crate::program::scenes::presets;
use crate::program::tasks;
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Print a preset, as a template for your own scene: physgrad scene cart_pole > my_scene.toml
///
/// A scene is a TOML file. `physgrad train my_scene.toml` runs it; every command that takes a
/// preset also takes a path. Missing settings have the task's defaults. Effects that the file does
/// not name are absent. For completion and hints in an editor: `physgrad schema --out
/// scene.schema.json`, and `#:schema scene.schema.json` as the first line of the scene.
#[derive(Debug, clap::Args)]
pub struct Scene {
    /// Name of the preset [default: list all]
    pub preset: Option<String>,
}

/// Write the JSON schema of scenes, for completion and validation in editors.
#[derive(Debug, clap::Args)]
pub struct Schema {
    /// Output file [default: standard output]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Runs `scene`.
pub fn scene(args: &Scene) -> Result<()> {
    match &args.preset {
        Some(name) => print_result(presets::text(name)?.trim_end()),
        None => {
            let width = presets::all().map(|(name, _)| name.len()).max().unwrap_or(0);
            presets::all().try_for_each(|(name, about)| print_result(&format!("{name:width$}  {about}")))
        }
    }
}

/// Runs `schema`.
pub fn schema(args: &Schema) -> Result<()> {
    let text = serde_json::to_string_pretty(&tasks::schema())?;
    match &args.out {
        Some(path) => std::fs::write(path, text + "\n").with_context(|| format!("cannot write {}", path.display())),
        None => print_result(&text),
    }
}
