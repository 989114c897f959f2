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
/// Also check the slope of the loss, and compare R with differences of the mean loss. These checks
/// use the initial parameters of the scene.
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
        let theta = scene.initial_policy().map(|_| scene.initial_theta()).transpose()?;
        scene.check(&variant, theta.as_deref(), &mut results);
    }
    let (table, failures) = results.finish();
    let mut notes = Vec::new();
    if let Some(name) = &args.scene {
        let source = changed(name)?;
        let scene = source.scene()?;
        let theta = scene.initial_theta()?;
        notes.push(stability(&scene, source, &theta)?);
        let plateau = scene.plateau(&theta).map_or_else(|divergence| divergence.to_string(), |plateau| plateau.to_string());
        notes.push(format!("loss at the initial parameters: {plateau}"));
        let compared = scene.jumps(&theta);
        let jumps = compared.map(|jumps| jumps.map_or_else(|divergence| divergence.to_string(), |jumps| jumps.to_string()));
        notes.push(format!("mean loss and R: {}", jumps.as_deref().unwrap_or("not compared beyond 10,000 steps")));
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

/// Largest factor by which [`stability`] increases the number of substeps.
const MAX_REFINEMENT: i64 = 64;

/// Describes the stability of the time step, in rollouts with the parameters `theta`. Refines an
/// unstable step until it is stable or its multiplier converges, if the scene admits substeps.
fn stability(scene: &Scene, mut refined: SceneSource, theta: &[f64]) -> Result<String> {
    let names = scene.state_names();
    if names.len() > MAX_STATES {
        return Ok(format!("time step: not checked beyond {MAX_STATES} state components"));
    }
    let Some(Amplification { sample, step, stability, evaluated, states }) = scene.amplification(theta) else {
        return Ok("time step: not checked, because a test rollout diverges in the first step".into());
    };
    let Stability { multiplier, component } = stability;
    let all = if evaluated == states { String::new() } else { format!(" of {states}") };
    let place = format!("in test rollout {sample}, step {step}");
    if stability.is_stable() || multiplier.is_nan() {
        let name = &names[component];
        return Ok(format!("time step, worst of {evaluated}{all} states, {place}, component {component} ({name}): {stability}"));
    }
    let found = format!("time step: a perturbation of {} grows by {multiplier:.4} per step {place}", names[component]);
    let substeps = scene.table.get("integrator").and_then(|section| section.get("substeps")?.as_integer()).unwrap_or(1);
    let (mut last, mut times) = (None, 1);
    while times < MAX_REFINEMENT {
        times *= 2;
        let count = substeps * times;
        refined.put("integrator.substeps", Value::Integer(count), "more substeps")?;
        let multiplier_of = |scene: Scene| Some(scene.amplification(theta)?.stability);
        let Some(next) = refined.scene().ok().and_then(multiplier_of).filter(|next| !next.multiplier.is_nan()) else { break };
        let more = if times == 2 { "twice".to_owned() } else { format!("{times} times") };
        if next.is_stable() {
            return Ok(format!(
                "{found}, but not with {more} as many substeps. Shorten the step: `integrator.substeps = {count}`"
            ));
        }
        let before = last.replace(next.multiplier).unwrap_or(multiplier);
        if (next.multiplier - before).abs() < 0.1 * (next.multiplier - 1.0) {
            let with = format!("by {:.4} with {more} as many substeps", next.multiplier);
            // Half of the growth of the long step is not physical.
            let is_too_long = multiplier - 1.0 > 2.0 * (next.multiplier - 1.0);
            return Ok(if is_too_long {
                format!(
                    "{found}, but {with}. The physics is unstable, and the step is too long. Shorten the step: `integrator.substeps = {count}`"
                )
            } else {
                format!("{found}, and {with}: the physics is unstable, not the step")
            });
        }
    }
    Ok(match last {
        Some(last) => format!(
            "{found}, and by {last:.4} with {times} times as many substeps. Use an implicit integrator or more damping, or \
             reduce the time step further"
        ),
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
