//! `physgrad check`: the gradient checks of the library, as a table.

use crate::check::Stability;
use crate::program::operations::checks::{Amplification, Results};
use crate::program::platform::json::print_json;
use crate::program::platform::terminal::{counted, print_text};
use crate::program::scenes::overrides::Overrides;
use crate::program::scenes::presets;
use crate::program::scenes::source::SceneSource;
use crate::program::tasks::{self, Scene};
use anyhow::{Result, bail};
use serde_json::json;
use toml::Value;

/// Check the gradients of systems, policies and whole rollouts against dual numbers.
///
/// For a named task or scene, also check the stability of the time step in states of test rollouts.
/// Also check the slope of the loss at the initial parameters. With an initial policy, these are
/// random.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  physgrad check\n  physgrad check my_scene.toml")]
pub struct Check {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    /// [default: all tasks, and each task of the paper with effects]
    pub scene: Option<String>,
    /// Change or add a setting of the scene, for example system.cart_mass=2
    #[arg(long, value_name = "KEY=VALUE", requires = "scene")]
    pub set: Vec<String>,
    /// Print the result as one JSON object; messages stay on standard error (docs/json.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn check(args: &Check) -> Result<()> {
    let mut results = Results::new();
    let changed = |name: &str| -> Result<SceneSource> {
        let mut source = presets::source(name)?;
        Overrides { set: args.set.clone(), ..Overrides::default() }.apply(&mut source)?;
        Ok(source)
    };
    let scenes = match &args.scene {
        Some(name) if !args.set.is_empty() => vec![(name.clone(), changed(name)?.scene()?)],
        name => scenes(name.as_deref())?,
    };
    for (variant, scene) in scenes {
        results.begin(scene.task.name());
        scene.check(&variant, None, &mut results);
    }
    let (table, failures) = results.finish();
    let mut notes = Vec::new();
    if let Some(name) = &args.scene {
        let source = changed(name)?;
        let scene = source.scene()?;
        notes.push(stability(&scene, source)?);
        let parameters = if scene.initial_policy().is_some() { "random" } else { "the initial" };
        let plateau = scene.plateau().map_or_else(|divergence| divergence.to_string(), |plateau| plateau.to_string());
        notes.push(format!("loss at {parameters} parameters: {plateau}"));
    }
    if args.json {
        print_json(&json!({ "checks": table.objects(), "notes": notes, "failures": failures }))?;
    } else {
        print_text(&format!("{table}\nerrors in f64 against dual numbers, relative to the largest component"))?;
        notes.iter().try_for_each(|note| print_text(note))?;
    }
    if failures.is_empty() {
        return Ok(());
    }
    bail!("{} failed:\n{}", counted(failures.len(), "gradient check"), failures.join("\n"));
}

/// Largest number of state components for which the command computes the stability.
const MAX_STATES: usize = 100;

/// Describes the stability of the time step. Compares an unstable step with half the step, if the
/// scene admits substeps.
fn stability(scene: &Scene, mut halved: SceneSource) -> Result<String> {
    let names = scene.state_names();
    if names.len() > MAX_STATES {
        return Ok(format!("time step: not checked beyond {MAX_STATES} state components"));
    }
    let Some(Amplification { sample, step, stability }) = scene.amplification() else {
        return Ok("time step: not checked, because a test rollout diverges in the first step".into());
    };
    let Stability { multiplier, component } = stability;
    let place = format!("in test rollout {sample}, step {step}");
    if stability.is_stable() || multiplier.is_nan() {
        return Ok(format!("time step, worst {place}, component {component} ({}): {stability}", names[component]));
    }
    let substeps = scene.table.get("integrator").and_then(|section| section.get("substeps")?.as_integer()).unwrap_or(1);
    halved.put("integrator.substeps", Value::Integer(2 * substeps), "half the step")?;
    let found = format!("time step: a perturbation of {} grows by {multiplier:.4} per step {place}", names[component]);
    let half = halved
        .scene()
        .ok()
        .and_then(|scene| scene.amplification())
        .map(|half| half.stability)
        .filter(|half| !half.multiplier.is_nan());
    Ok(match half {
        Some(half) if half.is_stable() || half.multiplier - 1.0 < 0.5 * (multiplier - 1.0) => {
            format!(
                "{found}, but by {:.4} with twice as many substeps. Shorten the step: `integrator.substeps = {}`",
                half.multiplier,
                2 * substeps
            )
        }
        Some(half) => {
            format!("{found}, and by {:.4} with twice as many substeps: the physics is unstable, not the step", half.multiplier)
        }
        None => format!("{found}. Without substeps, step and physics cannot be distinguished"),
    })
}

/// Scenes to check, with their names in the table. Without a name, all variants of all tasks, and
/// the presets in `RICH`.
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
