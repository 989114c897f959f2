//! `physgrad accuracy --gradients`: errors, times and memory of gradient methods, and errors of R
//! at several horizons.

use crate::commands::accuracy::derivatives::{Checkpoint, Derivative, Horizon};
use crate::commands::accuracy::gradient_outputs::write;
use crate::commands::accuracy::{Study, bar};
use crate::operations::gradients::{Derived, GradientMethod, REFERENCES, chosen};
use crate::platform::folder::Folder;
use crate::platform::json::print_json;
use crate::platform::parallel;
use crate::platform::terminal::{print_message, print_text};
use crate::settings::Precision;
use crate::tasks::Scene;
use anyhow::{Result, bail};
use indicatif::ProgressBar;
use physgrad::Field;
use physgrad::train::{Combination, GradientCombiner};
use toml::Value;

/// Step sizes of central differences.
const STEPS: [f64; 10] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10];
/// Minimum time per round, method and precision, s.
const MIN_TIME: f64 = 0.01;
/// Minimum horizon of the checkpoint measurements, in steps.
const CHECKPOINTED: usize = 1024;
/// Divisors of the memory of a pass without a budget. The pass for the divisor 1 has no budget. For
/// the other divisors, each quotient is a budget.
const PARTS: [u64; 4] = [1, 2, 4, 8];
/// Memory budget of a reverse pass at each of the `--horizons`, in bytes.
const BUDGET: u64 = 256_000_000;

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

const fn reverse(field: Field, budget: Option<u64>) -> GradientMethod {
    GradientMethod::Reverse { field, budget, nudged: false }
}

/// Measures methods, budgets and horizons, and writes and prints the results.
pub fn gradients(
    study: &Study,
    name: &str,
    folder: &Folder,
    horizons: &[usize],
    rounds: usize,
    [quiet, json]: [bool; 2],
) -> Result<()> {
    let methods = methods();
    let bar =
        bar(methods.len() * (1 + rounds) + REFERENCES + 3 * horizons.len() + PARTS.len(), quiet);
    if !quiet && bar.is_hidden() {
        print_message(&format!(
            "measuring {} gradient methods, {REFERENCES} double-double derivatives, {} horizons",
            methods.len(),
            horizons.len()
        ));
    }
    bar.set_message("double-double reference");
    let scene = study.source.scene()?;
    // Rejects invalid horizons before the measurements.
    let scenes = horizons
        .iter()
        .map(|&horizon| with_horizon(study, horizon))
        .collect::<Result<Vec<Scene>>>()?;
    let theta = scene.initial_theta()?;
    let derivatives = derivatives(&scene, &theta, &methods, rounds, &bar);
    let checkpoints = checkpoints(study, rounds, &bar)?;
    let horizons = along(&scenes, &theta, &bar);
    bar.finish_and_clear();
    let (text, object) = write(folder, name, &derivatives, &checkpoints, &horizons)?;
    if json {
        return print_json(&object);
    }
    print_text(&text)?;
    print_text(&format!(
        "results in {}: gradients.csv, horizons.csv, checkpoints.csv, gradients.svg, gradients.md",
        folder.path().display()
    ))?;
    Ok(())
}

/// Measures every method: errors against the double-double reference, and seconds.
fn derivatives(
    scene: &Scene,
    theta: &[f64],
    methods: &[(GradientMethod, Precision)],
    rounds: usize,
    bar: &ProgressBar,
) -> Vec<Derivative> {
    let [r, m, s] = scene.refer(theta, &|| bar.inc(1));
    let mut c = vec![0.0; r.len()];
    Combination::SignAgreement.combine(&m, &r, &mut c);
    let right = |method: &GradientMethod| match method {
        GradientMethod::Reverse { field, .. } => match field.letter() {
            "M" => &m,
            "S" => &s,
            "C" => &c,
            _ => &r,
        },
        _ => &r,
    };

    let mut derived = Vec::new();
    for (method, precision) in methods {
        bar.set_message(format!("{method} {}", precision.name()));
        derived.push(scene.derive(theta, *precision, *method));
        bar.inc(1);
    }
    let times = times(&mut derived, rounds, bar);
    // Compares signs with the gradient in f64, because the reference has only chosen components.
    let full = |field: Field| {
        let found =
            methods.iter().position(|method| *method == (reverse(field, None), Precision::F64));
        found.and_then(|i| derived[i].gradient.as_ref().ok())
    };
    methods
        .iter()
        .zip(&derived)
        .zip(times)
        .map(|(((method, precision), derived), times)| {
            let full = if let GradientMethod::Reverse { field, .. } = method {
                full(*field)
            } else {
                None
            };
            Derivative::new(*method, *precision, derived, times, right(method), full)
        })
        .collect()
}

/// All gradient methods, each with its precision, in the order of the results.
fn methods() -> Vec<(GradientMethod, Precision)> {
    let fields = [Field::regular(), Field::modified(), Field::stopped(), Field::combined()];
    let exact = fields.map(|field| reverse(field, None));
    let both = exact
        .into_iter()
        .chain(STEPS.map(GradientMethod::Central))
        .flat_map(|method| PRECISIONS.map(|precision| (method, precision)));
    let forward = PRECISIONS.map(|precision| (GradientMethod::Forward, precision));
    forward.into_iter().chain(both).chain([(GradientMethod::Duals, Precision::F64)]).collect()
}

/// Seconds of each of the gradients in each round. Empty for a gradient with an error.
fn times(derived: &mut [Derived], rounds: usize, bar: &ProgressBar) -> Vec<Vec<f64>> {
    // Interleaves the methods: other load on the machine then affects all methods.
    let mut times = vec![Vec::new(); derived.len()];
    for round in 1..=rounds {
        bar.set_message(format!("round {round} of {rounds}"));
        for (derived, times) in derived.iter_mut().zip(&mut times) {
            if derived.gradient.is_ok() {
                times.push(derived.time(MIN_TIME));
            }
            bar.inc(1);
        }
    }
    times
}

/// Scene with another horizon, and with a nonzero initial output layer.
fn with_horizon(study: &Study, horizon: usize) -> Result<Scene> {
    let mut source = study.source.clone();
    source.put("horizon", Value::Integer(horizon as i64), "accuracy --gradients")?;
    source.without_section("window");
    // Sets a memory budget. Without one, validation rejects a horizon whose mini-batch does not
    // fit into memory.
    source.put("training.memory", Value::String("1GB".into()), "accuracy --gradients")?;
    source.scene()
}

/// Measures the reverse pass of R without a memory budget, then with decreasing budgets.
fn checkpoints(study: &Study, rounds: usize, bar: &ProgressBar) -> Result<Vec<Checkpoint>> {
    let scene = with_horizon(study, study.scene.horizon.max(CHECKPOINTED))?;
    let theta = scene.initial_theta()?;
    let run =
        |budget| scene.derive(&theta, study.scene.precision, reverse(Field::regular(), budget));
    let mut all = run(None);
    let (bytes, gradient) = (all.bytes as u64, all.gradient.clone());
    let mut jobs: Vec<Derived> = PARTS[1..].iter().map(|part| run(Some(bytes / part))).collect();
    let mut jobs: Vec<&mut Derived> = std::iter::once(&mut all).chain(&mut jobs).collect();
    let mut times = vec![Vec::new(); jobs.len()];
    for _ in 0..rounds {
        for (job, times) in jobs.iter_mut().zip(&mut times) {
            if job.gradient.is_ok() {
                times.push(job.time(MIN_TIME));
            }
        }
    }
    let checkpoint = |((part, job), times): ((u64, &mut Derived), Vec<f64>)| {
        bar.inc(1);
        Checkpoint::new(scene.horizon, bytes / part, job, times, &gradient)
    };
    Ok(PARTS.into_iter().zip(jobs).zip(times).map(checkpoint).collect())
}

/// Errors of R at each horizon, in f32, and in f64 from perturbed initial states.
fn along(scenes: &[Scene], theta: &[f64], bar: &ProgressBar) -> Vec<Horizon> {
    bar.set_message("horizons");
    let runs = [(Precision::F32, false), (Precision::F64, false), (Precision::F64, true)];
    let jobs: Vec<(&Scene, (Precision, bool))> =
        scenes.iter().flat_map(|scene| runs.map(|run| (scene, run))).collect();
    let run = |(scene, (precision, nudged)): (&Scene, (Precision, bool))| {
        let method =
            GradientMethod::Reverse { field: Field::regular(), budget: Some(BUDGET), nudged };
        let gradient = scene.derive(theta, precision, method).gradient;
        bar.inc(1);
        gradient
    };
    // Lists the longest horizons first to balance the load.
    let jobs: Vec<_> = jobs.into_iter().rev().collect();
    let mut gradients: Vec<Result<Vec<f64>, String>> = parallel::map(&jobs, |&job| run(job));
    gradients.reverse();
    scenes
        .iter()
        .zip(gradients.chunks(3))
        .map(|(scene, found)| Horizon::new(scene.horizon, found))
        .collect()
}

/// Checks the horizons, sorts them and removes duplicates.
pub fn parse(horizons: &[usize]) -> Result<Vec<usize>> {
    if let Some(bad) = horizons.iter().find(|horizon| !(1..=100_000_000).contains(*horizon)) {
        bail!("--horizons {bad}; allowed: 1 to 100000000 steps");
    }
    let mut horizons = horizons.to_vec();
    horizons.sort_unstable();
    horizons.dedup();
    Ok(horizons)
}

/// Components of a gradient at the [`chosen`] parameters. `reference` is their number.
pub fn at_chosen(gradient: &[f64], reference: usize) -> Vec<f64> {
    // Methods that differentiate with respect to one parameter at a time return only the chosen
    // components.
    if gradient.len() == reference {
        gradient.to_vec()
    } else {
        chosen(gradient.len()).into_iter().map(|i| gradient[i]).collect()
    }
}
