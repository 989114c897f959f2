//! `physgrad accuracy`: errors and costs of integrators, step sizes and precisions.

mod derivatives;
mod gradient_outputs;
mod gradients;
mod outputs;
mod row;
mod study;

pub use row::{Errors, Row, Setting};
pub use study::{Cheapest, Measured, Metric, ROUNDS, Study};

use crate::platform::folder::Folder;
use crate::platform::json::{self, print_json};
use crate::platform::terminal::{counted, print_message, print_result, print_text, progress_bar};
use crate::runs::saved;
use crate::scenes::overrides::{Overrides, hide, is_of_training, is_of_windows};
use crate::scenes::presets;
use crate::settings::Precision;
use crate::tasks::Scene;
use crate::tasks::scene::INITIAL_POLICY;
use anyhow::{Result, anyhow, bail};
use indicatif::ProgressBar;
use physgrad::text::{rough, short};
use serde_json::json;
use std::path::PathBuf;

/// Simulate a scene with every integrator, step size and precision, and report errors and times.
///
/// Errors are those of trajectory, loss and gradients. Operations and memory are counts.
///
/// The reference is a run in f64 with a high-order method and small steps, checked against half as
/// many steps. Without --policy, the parameters are random, with a nonzero output layer. A
/// rollout has eight samples and runs on one thread.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad accuracy my_scene.toml --target 1e-4\n  physgrad accuracy cart_pole --target 0.01 --metric r\n  physgrad accuracy cart_pole --gradients"
)]
#[command(mut_args(hide(is_unread)), mut_arg("policy", |arg| arg.help("Parameters of the policy: a file `policy.safetensors`, or the folder of a run")))]
pub struct Accuracy {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    pub scene: String,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Name the cheapest setting with at most this error, and print its lines for the scene file.
    /// If times overlap, operations decide
    #[arg(long, value_name = "ERROR")]
    pub target: Option<f64>,
    /// Error that --target refers to
    #[arg(long, value_enum, default_value_t = Metric::Trajectory, requires = "target")]
    pub metric: Metric,
    /// Measure the costs of gradients instead: reverse passes, forward mode, differences,
    /// checkpoints, horizons
    #[arg(long, conflicts_with_all = ["target", "metric"])]
    pub gradients: bool,
    /// Horizons at which --gradients computes R, in steps
    #[arg(long, value_name = "STEPS", value_delimiter = ',', requires = "gradients",
          default_values_t = [10, 32, 100, 316, 1000, 3162, 10_000, 31_623, 100_000])]
    pub horizons: Vec<usize>,
    /// Number of timing rounds; with fewer the command ends sooner, and times are less certain
    #[arg(long, value_name = "N", default_value_t = ROUNDS)]
    pub rounds: usize,
    /// Folder for the results; replaces earlier results of this command in it [default: a new one
    /// in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print only the results
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Whether the command does not read the setting with this key. It draws all parameters itself, and
/// tries both precisions.
fn is_unread(key: &str) -> bool {
    let of_parameters = is_of_training(key) && !is_of_windows(key) && key != INITIAL_POLICY;
    of_parameters || ["policy.zero_init_output", "precision"].contains(&key)
}

/// Runs the command.
pub fn accuracy(args: &Accuracy) -> Result<()> {
    check(args)?;
    let mut source = presets::source(&args.scene)?;
    args.overrides.apply(&mut source)?;
    let study = Study::new(source)?;
    let name = presets::short_name(&args.scene);
    let horizons = if args.gradients { gradients::parse(&args.horizons)? } else { Vec::new() };
    let reserved = Folder::reserve(args.out.as_deref())?;
    let folder = || Folder::or_fresh(reserved, &format!("accuracy_{name}"));
    if args.gradients {
        return gradients::gradients(
            &study,
            &name,
            &*folder()?,
            &horizons,
            args.rounds,
            [args.quiet, args.json],
        );
    }
    let settings = study.settings()?;
    let measured = measured(args, &study, settings)?;
    let conserved = study.scene.conserved();
    let folder = folder()?;
    let conserved = conserved.map(|conserved| conserved.name);
    let list = outputs::write(&folder, &name, conserved, &measured)?;
    let rows = &measured.rows;
    let resolved = args.target.filter(|&target| measured.resolves(args.metric, target));
    let scenes =
        resolved.map_or(Ok(Vec::new()), |target| study.scenes(rows, args.metric, target))?;
    let inner = folder.file("scenes");
    if !scenes.is_empty() || args.target.is_some() && inner.is_dir() {
        write_scenes(Folder::at(inner.clone()), rows, &scenes)?;
    }
    let cheapest = args.target.map(|target| (target, measured.cheapest(args.metric, target)));
    if args.json {
        let object = cheapest.and_then(|(_, found)| found).as_ref().map(decision);
        print_json(
            &json!({ "folder": folder.path(), "settings": json::rows(&list)?, "cheapest": object }),
        )?;
    } else {
        print_text(&outputs::summary(rows, &measured.reference, conserved))?;
        print_text(&format!(
            "results in {}: accuracy.csv, accuracy.svg, accuracy.md",
            folder.path().display()
        ))?;
        if !scenes.is_empty() {
            print_text(&format!(
                "scenes with the cheapest setting of each method are in {}",
                inner.display()
            ))?;
        }
    }
    match cheapest {
        None => Ok(()),
        Some((target, None)) => Err(unreached(&measured, args.metric, target)),
        Some(_) if args.json => Ok(()),
        Some((target, Some(found))) => print_cheapest(&found, args.metric, target),
    }
}

/// Checks options, and refuses changes of settings that the command does not read or tries itself.
fn check(args: &Accuracy) -> Result<()> {
    if let Some(target) = args.target
        && (target.is_nan() || target <= 0.0)
    {
        bail!("--target {target}; allowed: a positive error, for example 1e-3");
    }
    if !(1..=1000).contains(&args.rounds) {
        bail!("--rounds {}; allowed: an integer from 1 to 1000", args.rounds);
    }
    args.overrides.refuse(
        is_unread,
        "this command, which trains nothing, has nonzero parameters in every layer, and tries every precision",
    )?;
    if !args.gradients {
        args.overrides.refuse(
            |key| key.starts_with("integrator."),
            "this command, which tries every integrator and step size",
        )?;
    }
    Ok(())
}

/// Measures the settings, with a progress bar, or with a message where no bar is visible.
fn measured(args: &Accuracy, study: &Study, settings: Vec<Setting>) -> Result<Measured> {
    let bar = bar(Study::parts(&settings, args.rounds), args.quiet);
    if !args.quiet && bar.is_hidden() {
        let settings = settings.len();
        print_message(&format!(
            "measuring {settings} settings, {} of timing",
            counted(args.rounds, "round")
        ));
    }
    let measured = study.measure(settings, args.rounds, &mut |part| {
        bar.set_message(part);
        bar.inc(1);
        Ok(())
    })?;
    bar.finish_and_clear();
    Ok(measured)
}

/// Replaces the scenes of all methods of `rows` by these, each with the name of its method.
///
/// # Errors
/// Another process has locked the folder, or it cannot be written to.
fn write_scenes(folder: Folder, rows: &[Row], scenes: &[(&str, Scene)]) -> Result<()> {
    let folder = folder.lock()?;
    // The error of a scene of an earlier command may exceed the current target.
    rows.iter().try_for_each(|row| folder.remove(&format!("{}.toml", row.setting.method)))?;
    for (method, scene) in scenes {
        saved::write_scene(&folder, &format!("{method}.toml"), scene)?;
    }
    Ok(())
}

/// The cheapest setting in the result of `--json`, with its error, and what decided.
fn decision(Cheapest { row, error, fastest }: &Cheapest<'_>) -> serde_json::Value {
    let by = if fastest.is_some() { "operations" } else { "time" };
    json!({ "setting": row.setting.name(), "error": error, "decided_by": by })
}

/// Progress bar with the given number of steps.
fn bar(steps: usize, quiet: bool) -> ProgressBar {
    progress_bar(steps, "{bar:20} {msg}  {elapsed}, ETA {eta}", quiet)
}

/// Prints the cheapest setting that reaches the target, with its error, and what decided.
fn print_cheapest(
    Cheapest { row, error, fastest }: &Cheapest<'_>,
    metric: Metric,
    target: f64,
) -> Result<()> {
    let costs = |row: &Row| {
        format!(
            "{} µs per step and sample, {} operations",
            short(metric.time(row) * 1e6),
            row.operations
        )
    };
    let decided = fastest.map_or_else(String::new, |fastest| {
        let name = fastest.setting.name();
        format!(
            ". Operations decide, because its time overlaps with that of {name} ({})",
            costs(fastest)
        )
    });
    print_text(&format!(
        "\nthe cheapest setting with an error of the {} of at most {target:e} is {}: error {}, {}{decided}; its lines in a scene \
         file:\n",
        metric.name(),
        row.setting.name(),
        rough(*error),
        costs(row),
    ))?;
    print_result(&row.setting.lines())
}

/// Error message for a target that no setting reaches, or that the reference does not resolve. Names
/// the most accurate setting, or states that every setting diverged.
fn unreached(measured: &Measured, metric: Metric, target: f64) -> anyhow::Error {
    let (rows, reference) = (&measured.rows, metric.read(&measured.reference));
    let reaches = |row: &Row| row.errors.as_ref().is_ok_and(|found| metric.read(found) <= target);
    if !measured.resolves(metric, target) && (reference.is_nan() || rows.iter().any(reaches)) {
        return anyhow!(
            "--target {target:e}: no setting can be recommended, because the {} of the reference itself has an error of about \
             {}; choose a larger target, a shorter `horizon`, or a scene that amplifies errors less",
            metric.name(),
            rough(reference)
        );
    }
    let finite = rows.iter().filter_map(|row| Some((row, metric.read(row.errors.as_ref().ok()?))));
    let best = finite.min_by(|a, b| a.1.total_cmp(&b.1));
    let Some((row, error)) = best else {
        return anyhow!(
            "--target {target:e}: every setting diverged; choose a scene with a finite trajectory, for example with a shorter `horizon`"
        );
    };
    let advice = match row.setting.precision {
        Precision::F32 => "f32 rounding limits the accuracy; choose a larger target",
        Precision::F64 => "use more substeps than those tried here, or choose a larger target",
    };
    anyhow!(
        "--target {target:e}: no setting reaches this error of the {}; the most accurate is {}, with {}: {advice}",
        metric.name(),
        row.setting.name(),
        rough(error)
    )
}
