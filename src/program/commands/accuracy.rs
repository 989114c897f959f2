//! `physgrad accuracy`: errors and costs of integrators, step sizes and precisions.

mod derivatives;
mod gradient_outputs;
mod gradients;
mod outputs;
mod row;

use crate::numbers::text::{rough, short};
use crate::program::operations::simulation::{Job, Simulated};
use crate::program::platform::folder::Folder;
use crate::program::platform::json::{self, print_json};
use crate::program::platform::terminal::{print_message, print_result, print_text, progress_bar};
use crate::program::scenes::overrides::{Overrides, hide_training};
use crate::program::scenes::presets;
use crate::program::scenes::source::SceneSource;
use crate::program::settings::Precision;
use crate::program::tasks::Scene;
use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use row::{Errors, Row, Setting};
use serde_json::json;
use std::path::PathBuf;
use toml::Value;

/// Simulate a scene with every integrator, step size and precision, and report errors and times.
///
/// Errors are those of trajectory, loss and gradients. Operations and memory are counts.
///
/// The reference is a run in f64 with a high-order method and small steps, checked against half as
/// many steps. The policy has the initial parameters of the scene, with a nonzero output layer. A
/// rollout has eight samples and runs on one thread.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad accuracy my_scene.toml --target 1e-4\n  physgrad accuracy cart_pole --target 0.01 --metric r\n  physgrad accuracy cart_pole --gradients"
)]
#[command(mut_args(hide_training))]
pub struct Accuracy {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    pub scene: String,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Name the cheapest setting with at most this error, and print its lines for the scene file
    #[arg(long, value_name = "ERROR")]
    pub target: Option<f64>,
    /// Error that --target refers to
    #[arg(long, value_enum, default_value_t = Metric::Trajectory)]
    pub metric: Metric,
    /// Measure the costs of gradients instead: reverse passes, forward mode, differences,
    /// checkpoints, horizons
    #[arg(long, conflicts_with_all = ["target", "metric"])]
    pub gradients: bool,
    /// Horizons at which --gradients computes R, in steps
    #[arg(long, value_name = "STEPS", value_delimiter = ',', requires = "gradients",
          default_values_t = [10, 32, 100, 316, 1000, 3162, 10_000, 31_623, 100_000])]
    pub horizons: Vec<usize>,
    /// Folder for the results [default: a new one in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print only the results
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/json.md)
    #[arg(long)]
    pub json: bool,
}

/// Error measure of `--target`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Metric {
    /// Error of the states
    Trajectory,
    /// Error of the loss
    Loss,
    /// Error of the gradient of R
    R,
    /// Error of the gradient of M
    M,
}

impl Metric {
    fn read(self, errors: &Errors) -> f64 {
        match self {
            Self::Trajectory => errors.trajectory,
            Self::Loss => errors.loss,
            Self::R => errors.gradients[0],
            Self::M => errors.gradients[1],
        }
    }

    /// Median seconds per step and sample of the pass that computes this quantity: forward, or
    /// forward with gradients.
    fn time(self, row: &Row) -> f64 {
        row.seconds[usize::from(matches!(self, Self::R | Self::M))][1]
    }

    fn name(self) -> &'static str {
        match self {
            Self::Trajectory => "trajectory",
            Self::Loss => "loss",
            Self::R => "gradient of R",
            Self::M => "gradient of M",
        }
    }
}

/// Numbers of physics steps per control step.
const SUBSTEPS: [usize; 5] = [1, 2, 4, 8, 16];
/// Number of timing rounds.
const ROUNDS: usize = 5;
/// Minimum time per round, setting and pass, s.
const MIN_TIME: f64 = 0.003;

/// Runs the command.
pub fn accuracy(args: &Accuracy) -> Result<()> {
    if let Some(target) = args.target
        && (target.is_nan() || target <= 0.0)
    {
        bail!("--target {target}; allowed: a positive error, for example 1e-3");
    }
    let mut source = presets::source(&args.scene)?;
    args.overrides.apply(&mut source)?;
    let given = source.clone();
    let scene = source.scene()?;
    if scene.table.get("policy").is_some_and(|policy| policy.get("zero_init_output").is_some()) {
        source.put("policy.zero_init_output", Value::Boolean(false), "accuracy")?;
    }
    let name = presets::short_name(&args.scene);
    let folder = || Folder::named(args.out.as_deref(), &format!("accuracy_{name}"));
    let study = Study { scene, given, source };
    if args.gradients {
        let horizons = gradients::parse(&args.horizons)?;
        return gradients::gradients(&study, &name, &*folder()?, &horizons, [args.quiet, args.json]);
    }
    let refined = Setting { method: "native", substeps: 2, precision: Precision::F64 };
    refined.of(&study.source).context("accuracy varies the time step, which this task does not support; choose another task")?;
    let (reference, check) = study.reference()?;
    let settings = study.settings();
    let bar = bar(settings.len() * (1 + ROUNDS), args.quiet);
    if !args.quiet && bar.is_hidden() {
        print_message(&format!("measuring {} settings, {ROUNDS} rounds of timing", settings.len()));
    }
    let mut jobs = Vec::new();
    for setting in &settings {
        bar.set_message(setting.name());
        jobs.push(study.job(setting)?);
        bar.inc(1);
    }
    // Interleaves the settings: other load on the machine then affects all settings.
    let mut times = vec![Vec::new(); jobs.len()];
    for round in 0..ROUNDS {
        for (job, times) in jobs.iter_mut().zip(&mut times) {
            if job.found.is_ok() {
                times.push(job.time(MIN_TIME));
            }
            bar.inc(1);
        }
        bar.set_message(format!("round {} of {ROUNDS}", round + 1));
    }
    bar.finish_and_clear();
    let conserved = study.scene.conserved();
    let rows: Vec<Row> = settings
        .into_iter()
        .zip(&jobs)
        .zip(&times)
        .map(|((setting, job), times)| Row::new(setting, job, &reference, conserved.as_ref(), times))
        .collect();
    let folder = folder()?;
    let conserved = conserved.map(|conserved| conserved.name);
    let list = outputs::write(&folder, &name, &check, conserved, &rows)?;
    if args.json {
        let cheapest = args.target.and_then(|target| cheapest(rows.iter(), args.metric, target));
        let cheapest = cheapest.map(|(row, error)| json!({ "setting": row.setting.name(), "error": error }));
        return print_json(&json!({ "folder": folder.path(), "settings": json::rows(&list)?, "cheapest": cheapest }));
    }
    print_text(&outputs::summary(&rows, &check, conserved))?;
    print_text(&format!("results in {}: accuracy.csv, accuracy.svg, accuracy.md", folder.path().display()))?;
    let Some(target) = args.target else { return Ok(()) };
    let scenes = study.scenes(&rows, args.metric, target)?;
    if !scenes.is_empty() {
        let inner = Folder::at(folder.file("scenes")).lock()?;
        for (method, scene) in scenes {
            inner.write(&format!("{method}.toml"), scene.table.to_string())?;
        }
        print_text(&format!("scenes with the cheapest setting of each method are in {}", inner.path().display()))?;
    }
    name_cheapest(&rows, args.metric, target)
}

/// Progress bar with the given number of steps.
fn bar(steps: usize, quiet: bool) -> ProgressBar {
    progress_bar(steps, "{bar:20} {msg}  {elapsed}, ETA {eta}", quiet)
}

/// Scene whose integrator and precision are varied.
struct Study {
    /// Source of the scene with the user's overrides only.
    given: SceneSource,
    /// Validated scene of `given`.
    scene: Scene,
    /// Source of the scene with the user's overrides and a nonzero initial output layer.
    source: SceneSource,
}

impl Study {
    fn job(&self, setting: &Setting) -> Result<Job> {
        Ok(setting.of(&self.source)?.prepare())
    }

    /// Scenes with the cheapest setting of every method that reaches the target.
    fn scenes(&self, rows: &[Row], metric: Metric, target: f64) -> Result<Vec<(&'static str, Scene)>> {
        let mut methods: Vec<&str> = rows.iter().map(|row| row.setting.method).collect();
        methods.dedup();
        let cheapest = |method: &str| cheapest(rows.iter().filter(|row| row.setting.method == method), metric, target);
        let all = methods.into_iter().filter_map(cheapest);
        all.map(|(row, _)| Ok((row.setting.method, row.setting.of(&self.given)?))).collect()
    }

    /// Reference solution, and its difference from the solution with half as many steps.
    fn reference(&self) -> Result<(Simulated, Errors)> {
        let (method, substeps) = self.scene.task.reference();
        let run = |substeps| {
            let setting = Setting { method, substeps, precision: Precision::F64 };
            let found = self.job(&setting)?.found;
            found.map_err(anyhow::Error::msg).with_context(|| {
                format!(
                    "the reference solution ({}) diverged; choose a scene with a finite trajectory, for example a shorter \
                     `horizon`",
                    setting.name()
                )
            })
        };
        let (coarse, fine) = (run(substeps / 2)?, run(substeps)?);
        let check = Errors::of(&coarse, &fine);
        Ok((fine, check))
    }

    fn settings(&self) -> Vec<Setting> {
        let methods = ["native"].into_iter().chain(self.scene.task.methods().iter().map(|method| method.name()));
        let each = methods.flat_map(|method| {
            // Tries one number of substeps for the adaptive method, which selects its step sizes.
            let counts = if method == "adaptive" { &SUBSTEPS[..1] } else { &SUBSTEPS };
            counts.iter().map(move |&substeps| (method, substeps))
        });
        each.flat_map(|(method, substeps)| {
            [Precision::F32, Precision::F64].map(|precision| Setting { method, substeps, precision })
        })
        .collect()
    }
}

/// Cheapest setting that reaches the target, with its error.
fn cheapest<'a>(rows: impl Iterator<Item = &'a Row>, metric: Metric, target: f64) -> Option<(&'a Row, f64)> {
    let reached =
        rows.filter_map(|row| Some((row, metric.read(row.errors.as_ref().ok()?)))).filter(|(_, error)| *error <= target);
    reached.min_by(|a, b| metric.time(a.0).total_cmp(&metric.time(b.0)))
}

/// Prints the cheapest setting that reaches the target.
///
/// # Errors
/// No setting reaches the target. The message names the most accurate setting.
fn name_cheapest(rows: &[Row], metric: Metric, target: f64) -> Result<()> {
    let finite = || rows.iter().filter_map(|row| Some((row, metric.read(row.errors.as_ref().ok()?))));
    if let Some((row, error)) = cheapest(rows.iter(), metric, target) {
        print_text(&format!(
            "\nthe cheapest setting with an error of the {} of at most {target:e} is {}: error {}, {} µs per step \
             and sample; its lines in a scene file:\n",
            metric.name(),
            row.setting.name(),
            rough(error),
            short(metric.time(row) * 1e6),
        ))?;
        return print_result(&row.setting.lines());
    }
    let best = finite().min_by(|a, b| a.1.total_cmp(&b.1));
    let Some((row, error)) = best else {
        bail!(
            "--target {target:e}: every setting diverged; choose a scene with a finite trajectory, for example a shorter `horizon`"
        )
    };
    let advice = match row.setting.precision {
        Precision::F32 => "f32 rounding limits the accuracy; choose a larger target",
        Precision::F64 => "use more substeps than those tried here, or choose a larger target",
    };
    bail!(
        "--target {target:e}: no setting reaches this error of the {}; the most accurate is {}, with {}: {advice}",
        metric.name(),
        row.setting.name(),
        rough(error)
    )
}
