//! `physgrad scene` and `physgrad schema`: print presets and the JSON schema of scenes.

use crate::platform::folder::Folder;
use crate::platform::json::print_json;
use crate::platform::terminal::{print_result, print_text};
use crate::scenes::presets;
use crate::tasks;
use anyhow::{Context, Result};
use serde_json::json;
use std::path::PathBuf;

/// Print a preset, as a template for your own scene: physgrad scene cart_pole > my_scene.toml
///
/// A scene is a TOML file. `physgrad train my_scene.toml` runs it; every command that takes a
/// preset also takes a path. Missing settings have the task's defaults. Effects that the file does
/// not name are absent. For completion and hints in an editor: `physgrad schema --out
/// scene.schema.json`, and `#:schema scene.schema.json` as the first line of the scene.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  physgrad scene\n  physgrad scene cart_pole_windy")]
pub struct Scene {
    /// Name of the preset [default: list all]
    pub preset: Option<String>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Write the JSON schema of scenes, for completion and validation in editors.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  physgrad schema -o scene.schema.json")]
pub struct Schema {
    /// Output file [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Runs `scene`.
pub fn scene(args: &Scene) -> Result<()> {
    match &args.preset {
        Some(name) if args.json => print_json(&json!(presets::source(name)?.scene()?.table())),
        None if args.json => {
            let all = presets::all()
                .map(|(name, about)| json!({ "name": name, "about": about }))
                .collect::<Vec<_>>();
            print_json(&json!({ "presets": all }))
        }
        Some(name) => print_result(presets::text(name)?.trim_end()),
        None => {
            let width = presets::all().map(|(name, _)| name.len()).max().unwrap_or(0);
            presets::all()
                .try_for_each(|(name, about)| print_text(&format!("{name:width$}  {about}")))
        }
    }
}

/// Runs `schema`.
pub fn schema(args: &Schema) -> Result<()> {
    let text = serde_json::to_string_pretty(&tasks::schema())?;
    match &args.out {
        Some(path) => Folder::write_at(path, text + "\n").context("--out"),
        None => print_result(&text),
    }
}
