//! `physgrad check`: the gradient checks of the library, as a table.

mod time_step;

use crate::operations::amplification::Place;
use crate::operations::checks::Results;
use crate::platform::json::print_json;
use crate::platform::terminal::{counted, print_text};
use crate::scenes::overrides::{Overrides, is_of_training, is_of_windows};
use crate::scenes::presets;
use crate::scenes::source::SceneSource;
use crate::tasks::scene::INITIAL_POLICY;
use crate::tasks::{self, Scene};
use anyhow::{Result, bail};
use physgrad::Divergence;
use physgrad::check::{Jumps, Kink, KinkInput, Stability};
use physgrad::text::rough;
use serde_json::json;
use std::path::PathBuf;
use time_step::{is_harmless, stability};
use toml::Value;

/// Check the gradients of systems, policies and whole rollouts against dual numbers.
///
/// For a named task or scene, also check the stability of the time step in states of test rollouts,
/// the slope of the loss, and kinks of the step and of the costs. Also compare R with the derivative of
/// the mean loss over a small ball of parameters. These checks use the policy of `--policy`, otherwise the initial parameters of the
/// scene.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad check\n  physgrad check my_scene.toml\n  physgrad check my_scene.toml --policy runs/one"
)]
pub struct Check {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    /// [default: all tasks, and each task of the paper with effects]
    pub scene: Option<String>,
    /// Change or add a setting of the scene, for example system.cart_mass=2
    #[arg(long, value_name = "KEY=VALUE", requires = "scene")]
    pub set: Vec<String>,
    /// Parameters of the policy: a file `policy.safetensors`, or the folder of a run
    #[arg(long, value_name = "FILE", requires = "scene")]
    pub policy: Option<PathBuf>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn check(args: &Check) -> Result<()> {
    let mut results = Results::new(!args.json);
    let overrides =
        Overrides { set: args.set.clone(), policy: args.policy.clone(), ..Overrides::default() };
    let named = args.scene.as_deref().map(presets::source).transpose()?;
    let of_scene = named.is_some_and(|source| source.table().contains_key("window"));
    let has_windows = of_scene || args.set.iter().any(|set| set.starts_with("window"));
    let is_unread = |key: &str| match key {
        "precision" => true,
        INITIAL_POLICY => false,
        // The costs of a window are discounted.
        "training.discount" => !has_windows,
        _ => is_of_training(key) && !is_of_windows(key),
    };
    overrides.refuse(is_unread, "the checks, which train nothing and compute in f64")?;
    let is_changed = args.policy.is_some() || !args.set.is_empty();
    let changed = |name: &str| -> Result<SceneSource> {
        let mut source = presets::source(name)?;
        overrides.apply(&mut source)?;
        Ok(source)
    };
    let source = args.scene.as_deref().map(changed).transpose()?;
    let scenes = match (&args.scene, &source) {
        (Some(name), Some(source)) if is_changed => vec![(name.clone(), source.scene()?)],
        (name, _) => scenes(name.as_deref())?,
    };
    if !args.json {
        print_text("task, checked, number of compared values, worst and allowed error, result")?;
    }
    for (variant, scene) in scenes {
        scene.check_memory()?;
        results.begin(scene.task.name());
        let theta = scene.initial_policy().map(|_| scene.initial_theta()).transpose()?;
        scene.check(&variant, theta.as_deref(), &mut results);
    }
    let (table, failures) = results.finish();
    let mut notes = Vec::new();
    let mut note = |note: String| -> Result<()> {
        if !args.json {
            print_text(&note)?;
        }
        notes.push(note);
        Ok(())
    };
    if !args.json {
        print_text("errors in f64 against dual numbers, relative to the largest component")?;
    }
    if let Some(source) = source {
        let scene = source.scene()?;
        let theta = scene.checked_theta()?;
        about(&scene, source, &theta, &mut note)?;
    }
    if args.json {
        print_json(&json!({ "checks": table.objects(), "notes": notes, "failures": failures }))?;
    }
    if failures.is_empty() {
        return Ok(());
    }
    bail!("{} failed:\n{}", counted(failures.len(), "gradient check"), failures.join("\n"));
}

/// Largest number of kinks in the notes.
const MAX_KINKS: usize = 8;

/// Largest number of parameters for which the exact gradient is advised in place of C.
const FEW: usize = 10;

/// Makes a note about each property of the scene, and of its test rollouts with the parameters
/// `theta`. `source` is that of the scene.
pub fn about(
    scene: &Scene,
    source: SceneSource,
    theta: &[f64],
    note: &mut dyn FnMut(String) -> Result<()>,
) -> Result<()> {
    scene.remarks().into_iter().try_for_each(&mut *note)?;
    about_rollouts(scene, source, theta, note)
}

fn about_rollouts(
    scene: &Scene,
    source: SceneSource,
    theta: &[f64],
    note: &mut dyn FnMut(String) -> Result<()>,
) -> Result<()> {
    let diverged = |divergence: &Divergence| {
        let place = scene.expression_at(divergence).map(|error| source.located(&error));
        let place = place.map_or_else(String::new, |place| format!("{place}: "));
        format!("test rollouts: {place}{divergence}")
    };
    let found = match scene.amplification(theta, None) {
        Ok(found) => found,
        Err(divergence) => {
            return note(format!(
                "{}. Time step, kinks, loss and jumps are therefore not checked",
                diverged(&divergence)
            ));
        }
    };
    if let Some(divergence) = &found.divergence {
        note(format!("{}. Kinks, loss and jumps are therefore not checked", diverged(divergence)))?;
    }
    let names = scene.state_names();
    note(stability(scene, source.clone(), theta, &found))?;
    if let Some(ringing) = found.ringing {
        let Place { sample, step, stability: Stability { lowest, lowest_component, .. } } = ringing;
        note(format!(
            "time step: the step rings in test rollout {sample}, step {step}: a perturbation of {} changes its sign in nearly \
             every step (multiplier about {lowest:.3}). The step does not resolve this motion. Shorten it, or use an \
             integrator that damps fast motion",
            names[lowest_component]
        ))?;
    }
    if scene.field.0.letter() == "C" && (1..=FEW).contains(&theta.len()) && is_harmless(&found) {
        note(format!(
            "field: with {} and without growth of perturbations, C has no advantage, and it is 0 for a parameter where R and M \
             disagree. Choose the gradient: `field = \"R\"`",
            counted(theta.len(), "parameter")
        ))?;
    }
    if found.divergence.is_some() {
        return Ok(());
    }
    let kinks = scene.kinks(theta);
    for kink in kinks.iter().take(MAX_KINKS) {
        note(described(kink, &names, &scene.control_names()))?;
    }
    match kinks.len().saturating_sub(MAX_KINKS) {
        0 if kinks.is_empty() => note("kinks: none in the states of the test rollouts".into())?,
        0 => note(
            "kinks: gradients have the derivative on one side of a kink, and omit jumps. Rollouts that rest on a kink have \
             misleading gradients; a smoothed function avoids this"
                .into(),
        )?,
        more => note(format!("kinks: {more} more, in other functions or arguments"))?,
    }
    if let Some(lengths) = scene.lengths(theta) {
        note(about_lengths(&lengths, scene.horizon))?;
    }
    if theta.is_empty() {
        return note("loss: without a slope, because the policy has no trained numbers".into());
    }
    let plateau = scene
        .plateau(theta)
        .map_or_else(|divergence| divergence.to_string(), |plateau| plateau.to_string());
    note(format!("loss at the initial parameters: {plateau}"))?;
    about_jumps(scene, source, theta, note)
}

fn about_lengths(lengths: &[usize], horizon: usize) -> String {
    let [least, most] =
        [lengths.iter().min(), lengths.iter().max()].map(|n| n.copied().unwrap_or(0));
    if most == 1 && horizon > 1 {
        return "episodes: all test episodes end in their first step. Check whether the condition of the end holds in the \
                initial states"
            .into();
    }
    let range = if least == most { most.to_string() } else { format!("{least} to {most}") };
    format!("episodes: test episodes with these parameters last {range} of {horizon} steps")
}

/// Makes a note about the error of R against the derivative of the mean loss, and about a setting that
/// reduces it, over the steps that an update differentiates.
fn about_jumps(
    scene: &Scene,
    source: SceneSource,
    theta: &[f64],
    note: &mut dyn FnMut(String) -> Result<()>,
) -> Result<()> {
    let window = scene.window_steps();
    let over = window.map(|steps| format!(" over a window of {}", counted(steps, "step")));
    let (over, steps) = (over.unwrap_or_default(), scene.steps());
    let found = match scene.jumps(theta, steps) {
        None => {
            return note(format!(
                "mean loss and R{over}: not compared, because it would take long"
            ));
        }
        Some(Err(divergence)) => return note(format!("mean loss and R{over}: {divergence}")),
        Some(Ok(found)) => found,
    };
    note(format!("mean loss and R{over}: {found}"))?;
    if !is_bad(&found) {
        return Ok(());
    }
    if window.is_some() {
        shorter(scene, theta, steps).map_or(Ok(()), &mut *note)?;
    }
    smoother(scene, source, theta, steps, &found).map_or(Ok(()), note)
}

fn is_bad(found: &Jumps) -> bool {
    found.is_biased() || found.is_undecided()
}

/// Advises the longest of some shorter windows over which R is not biased.
fn shorter(scene: &Scene, theta: &[f64], steps: usize) -> Option<String> {
    let halves = std::iter::successors(Some(steps / 2), |steps| Some(steps / 2));
    let (steps, found) = halves.take_while(|&steps| steps > 0).find_map(|steps| {
        let found = scene.jumps(theta, steps)?.ok()?;
        (!is_bad(&found) && found.error.is_finite()).then_some((steps, found))
    })?;
    Some(format!(
        "window: with `window.steps = {steps}`, R differs from the derivative of the mean loss by {} %. It may train \
         better: the value function stands for the steps that follow (docs/episodes.md)",
        rough(100.0 * found.error)
    ))
}

/// Advises smooth contacts if R is not biased with them, or less.
fn smoother(
    scene: &Scene,
    mut source: SceneSource,
    theta: &[f64],
    steps: usize,
    found: &Jumps,
) -> Option<String> {
    /// Largest share of the error that remains.
    const LESS: f64 = 0.5;
    let (key, value) = scene.smoother()?;
    source.put(key, Value::String(value.into()), "smooth contacts").ok()?;
    let smooth = source.scene().ok()?.jumps(theta, steps)?.ok()?;
    let [share, now] = [smooth.error, found.error].map(|error| rough(100.0 * error));
    (smooth.error < LESS * found.error && !smooth.is_undecided()).then(|| {
        format!(
            "contacts: with `{key} = \"{value}\"`, R differs from the derivative of the mean loss by {share} % in place of \
             {now} %. Train with it, and evaluate with the contacts of the file (docs/bodies.md)"
        )
    })
}

/// Describes a kink with the names of states and controls.
fn described(kink: &Kink, states: &[String], controls: &[String]) -> String {
    let input = match kink.input {
        KinkInput::State(i) => states[i].clone(),
        KinkInput::Control(i) => controls[i].clone(),
        KinkInput::Next(i) => format!("the next {}", states[i]),
    };
    let mut text = "kink: ".to_owned();
    kink.describe(&mut text, &input).expect("a string takes any text");
    text
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Half cheetah over 16 steps with controls between -0.7 and 0.7.
    fn half_cheetah(contacts: &str) -> (Scene, SceneSource, Vec<f64>) {
        let mut source = presets::source("half_cheetah").expect("a preset");
        let mut put = |key: &str, value: Value| source.put(key, value, "test").expect("a setting");
        put("horizon", Value::Integer(16));
        put("system.contacts", Value::String(contacts.into()));
        put("policy.kind", Value::String("open_loop".into()));
        put("policy.bounds", Value::Boolean(false));
        let scene = source.scene().expect("a valid scene");
        let theta = (0..16 * 6).map(|i| 0.7 * (1.7 * f64::from(i * i)).sin()).collect();
        (scene, source, theta)
    }

    #[test]
    fn stiff_contact_biases_r_and_smooth_contact_does_not() {
        let notes = |contacts: &str| {
            let (scene, source, theta) = half_cheetah(contacts);
            let found = scene
                .jumps(&theta, scene.horizon)
                .expect("short rollouts")
                .expect("finite rollouts");
            let mut notes = Vec::new();
            let mut note = |text: String| {
                notes.push(text);
                Ok(())
            };
            about_jumps(&scene, source, &theta, &mut note).expect("notes");
            (found, notes)
        };
        let (smooth, said) = notes("smooth");
        assert!(smooth.error < 0.02 && !smooth.is_biased() && !smooth.is_undecided(), "{smooth:?}");
        assert!(said.len() == 1 && said[0].starts_with("mean loss and R: no jumps"), "{said:?}");
        let (stiff, said) = notes("file");
        assert!(stiff.error > 0.1 && stiff.error > 10.0 * smooth.interval[1], "{stiff:?}");
        assert!(stiff.is_biased() || stiff.is_undecided(), "{stiff:?}");
        assert!(said[1].contains("`system.contacts = \"smooth\"`"), "{said:?}");
    }
}
