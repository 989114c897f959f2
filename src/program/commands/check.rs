//! `physgrad check`: the gradient checks of the library, as a table.

use crate::program::operations::checks::Results;
use crate::program::platform::terminal::print_result;
use crate::program::scenes::presets;
use crate::program::tasks::{self, Scene};
use anyhow::{Result, bail};

/// Check the gradients of systems, policies and whole rollouts against dual numbers.
///
/// For a named task or scene, also check the stability of the time step in states of test rollouts,
/// and whether the loss has a slope at the initial parameters.
#[derive(Debug, clap::Args)]
pub struct Check {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    /// [default: all tasks, and each task of the paper with effects]
    pub scene: Option<String>,
}

/// Runs the command.
pub fn check(args: &Check) -> Result<()> {
    let mut results = Results::new();
    for (variant, scene) in scenes(args.scene.as_deref())? {
        results.begin(scene.task.name());
        scene.check(&variant, &mut results);
    }
    let (table, failures) = results.finish();
    print_result(&table.to_string())?;
    print_result("errors in f64 against dual numbers, relative to the largest component")?;
    if let Some(name) = &args.scene {
        for sentence in presets::source(name)?.scene()?.diagnosis() {
            print_result(&sentence)?;
        }
    }
    if failures.is_empty() {
        return Ok(());
    }
    bail!("{} gradient checks failed:\n{}", failures.len(), failures.join("\n"));
}

/// Named scenes to check.
fn scenes(name: Option<&str>) -> Result<Vec<(String, Scene)>> {
    let tasks = tasks::all().iter().filter(|kind| name.is_none_or(|name| name == kind.name()));
    let variants: Vec<_> = tasks.flat_map(|kind| kind.variants()).collect();
    let preset = |name: &str| Ok((name.to_owned(), presets::source(name)?.scene()?));
    match name {
        Some(name) if variants.is_empty() => Ok(vec![preset(name)?]),
        Some(_) => Ok(variants),
        None => variants.into_iter().map(Ok).chain(presets::RICH.into_iter().map(preset)).collect(),
    }
}
