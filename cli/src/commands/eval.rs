//! `physgrad eval`: losses of trained policies from new initial states, with their worst rollouts.

use crate::operations::evaluation::{AnyEvaluation, Evaluated};
use crate::operations::session::Epoch;
use crate::platform::csv::csv;
use crate::platform::folder::Folder;
use crate::platform::json::{print_json, rows};
use crate::platform::parallel;
use crate::platform::table::Table;
use crate::platform::terminal::{counted, print_text};
use crate::runs::outputs;
use crate::runs::trained::Trained;
use crate::scenes::overrides::{Overrides, is_of_training};
use crate::scenes::presets;
use crate::tasks::Scene;
use anyhow::{Context, Result, bail};
use physgrad::text::{rough, short};
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Animation, distribution};
use serde_json::json;
use std::path::PathBuf;

/// Evaluate trained policies on new initial states: losses, and the worst rollouts.
///
/// The initial states differ from those of every training and test set.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad eval runs/one --samples 4096\n  physgrad eval runs/one runs/two --scene cart_pole_windy"
)]
pub struct Eval {
    /// Folders of trained runs of one task, or scenes whose policy has no trained numbers
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Scene of the evaluation: a task, a preset, or the path of a scene [default: that of each
    /// run]
    #[arg(long, value_name = "SCENE")]
    pub scene: Option<String>,
    /// Change or add a setting of the scene, for example system.cart_mass=2
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Remove an effect, or a part of the actuator or the sensor, from the scene
    #[arg(long, value_name = "NAME")]
    pub without: Vec<String>,
    /// Epoch of the policies
    #[arg(long, value_enum, default_value_t = Epoch::Last)]
    pub epoch: Epoch,
    /// Number of initial states
    #[arg(long, value_name = "N", default_value_t = 1024)]
    pub samples: usize,
    /// Seed of the initial states
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Number of the rollouts with the largest losses that are written and animated
    #[arg(long, value_name = "K", default_value_t = 3)]
    pub worst: usize,
    /// Folder for the results; replaces earlier results of this command in it [default: a new one
    /// in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Results of one policy.
struct OfPolicy {
    name: String,
    /// Steps of an episode that does not end early.
    horizon: usize,
    results: Vec<Evaluated>,
}

/// Probabilities of the quantiles.
const SHARES: [f64; 5] = [0.05, 0.25, 0.5, 0.75, 0.95];

/// Largest number of rollouts that are written and animated. Each takes the memory of its states.
const MAX_WORST: usize = 100;

/// Runs the command.
pub fn eval(args: &Eval) -> Result<()> {
    check_samples(args.samples)?;
    if args.worst > MAX_WORST {
        bail!("--worst is {}; allowed: 0 to {MAX_WORST}", args.worst);
    }
    let policies = Trained::load_all(&args.runs, args.epoch)?;
    let scenes =
        policies.iter().map(|policy| scene(args, policy)).collect::<Result<Vec<Scene>>>()?;
    let reserved = Folder::reserve(args.out.as_deref())?;
    let pairs: Vec<(&Trained, &Scene)> = policies.iter().zip(&scenes).collect();
    let evaluation = |(policy, scene): &(&Trained, &Scene)| {
        policy
            .evaluation(scene, args.seed)
            .with_context(|| format!("cannot evaluate {}", policy.name))
    };
    let results = parallel::map(&pairs, |pair| Ok(evaluation(pair)?.results(args.samples)));
    let results = results.into_iter().collect::<Result<Vec<_>>>()?;
    let of_policy = |((policy, scene), results): (&(&Trained, &Scene), Vec<Evaluated>)| OfPolicy {
        name: policy.name.clone(),
        horizon: scene.horizon,
        results,
    };
    let results: Vec<OfPolicy> = pairs.iter().zip(results).map(of_policy).collect();

    let folder = Folder::or_fresh(reserved, "eval")?;
    folder.write("losses.csv", losses_csv(&results)?)?;
    let summary = csv(SUMMARY, results.iter().map(OfPolicy::summary))?;
    folder.write("summary.csv", &summary)?;
    folder.write("losses.svg", picture(&title(args, &policies), &results))?;
    let is_separator = |c: char| matches!(c, '/' | '\\') || c.is_control();
    for (i, (pair, result)) in pairs.iter().zip(&results).enumerate() {
        let (scene, evaluation, samples) = (pair.1, evaluation(pair)?, result.worst(args.worst));
        if results.len() == 1 {
            write_worst(&folder, scene, &*evaluation, &samples)?;
        } else {
            // Several policies have a subfolder each.
            write_worst(
                &*folder
                    .inside(&format!("{}-{}", i + 1, pair.0.name.replace(is_separator, "-")))?
                    .lock()?,
                scene,
                &*evaluation,
                &samples,
            )?;
        }
    }
    if args.json {
        return print_json(&json!({ "folder": folder.path(), "runs": rows(&summary)? }));
    }
    let worst = match results.len() {
        _ if args.worst == 0 => "",
        1 => ", worst.csv and animations of the worst rollouts",
        _ => ", and a folder for each policy with worst.csv and animations of its worst rollouts",
    };
    let files = format!("losses.svg, losses.csv, summary.csv{worst}");
    print_text(&format!(
        "{}\nresults in {}: {files}",
        table(args, &results),
        folder.path().display()
    ))
}

/// Checks the number of initial states of an evaluation.
pub fn check_samples(samples: usize) -> Result<()> {
    const MOST: usize = 1_000_000;
    if (1..=MOST).contains(&samples) {
        Ok(())
    } else {
        bail!("--samples is {samples}; allowed: 1 to {MOST}")
    }
}

/// Refuses settings of trainings.
fn check_set(overrides: &Overrides) -> Result<()> {
    for option in &overrides.set {
        if option.split('=').next().is_some_and(|key| key.trim() == "seed") {
            bail!(
                "--set {option} has no effect on an evaluation; give the seed of the initial states by --seed"
            );
        }
    }
    overrides.refuse(is_of_training, "an evaluation, which trains nothing")
}

/// Scene for the evaluation of a policy. It has the policy section and the precision of the run,
/// unless `--set` changes them.
fn scene(args: &Eval, policy: &Trained) -> Result<Scene> {
    let overrides =
        Overrides { set: args.set.clone(), without: args.without.clone(), ..Overrides::default() };
    check_set(&overrides)?;
    let mut source = match &args.scene {
        Some(name) => presets::source(name)?,
        None => policy.source.clone(),
    };
    if args.scene.is_some() {
        // Another kind of policy has other settings.
        source.without_section("policy");
        for key in ["policy", "precision"] {
            if let Some(value) = policy.source.table().get(key) {
                source.replace(key, value.clone(), policy.source.name())?;
            }
        }
    }
    overrides.apply(&mut source)?;
    // Windows have no effect on an evaluation, whose horizon may be shorter.
    source.without_section("window");
    let scene = source.scene()?;
    let [of_scene, of_run] = [&scene, &policy.scene].map(|scene| scene.task.name());
    if of_scene != of_run {
        bail!(
            "{} has the task {of_run}, but the scene has the task {of_scene}; name a scene of {of_run}",
            policy.name
        );
    }
    Ok(scene)
}

const SUMMARY: [&str; 14] = [
    "run",
    "samples",
    "diverged",
    "mean",
    "standard_error",
    "quantile_05",
    "quartile_1",
    "median",
    "quartile_3",
    "quantile_95",
    "worst",
    "worst_sample",
    "mean_length",
    "ended_early",
];

impl OfPolicy {
    fn losses(&self) -> impl Iterator<Item = f64> {
        self.results.iter().map(|result| result.loss)
    }

    fn finite(&self) -> impl Iterator<Item = f64> {
        self.losses().filter(|loss| loss.is_finite())
    }

    fn diverged(&self) -> usize {
        self.results.len() - self.finite().count()
    }

    /// Mean and its standard error, over the rollouts that do not diverge.
    fn mean(&self) -> [f64; 2] {
        let count = self.finite().count() as f64;
        let mean = self.finite().sum::<f64>() / count;
        let variance = self.finite().map(|loss| (loss - mean).powi(2)).sum::<f64>() / (count - 1.0);
        [mean, (variance / count).sqrt()]
    }

    /// Number of rollouts with more than a thousand times the median loss, and the mean of the
    /// others, if there are at most 5 % of such rollouts or a single one. Diverged rollouts do not
    /// count.
    fn outliers(&self) -> Option<(usize, f64)> {
        let losses = sorted(self.finite());
        let median = quantile(&losses, 0.5);
        let others = losses.partition_point(|loss| *loss <= 1e3 * median);
        let few = losses.len() - others;
        let is_some = median > 0.0 && (1..=(losses.len() / 20).max(1)).contains(&few);
        is_some.then(|| (few, losses[..others].iter().sum::<f64>() / others as f64))
    }

    /// Quantiles over all rollouts. Losses of diverged rollouts are infinite.
    fn quantiles(&self) -> [f64; 5] {
        let sorted = sorted(self.losses());
        SHARES.map(|share| quantile(&sorted, share))
    }

    /// Indices of the `count` largest losses, the largest first.
    fn worst(&self, count: usize) -> Vec<usize> {
        let mut samples: Vec<usize> = (0..self.results.len()).collect();
        let loss = |sample: usize| self.results[sample].loss;
        samples.sort_by(|&a, &b| loss(b).total_cmp(&loss(a)));
        samples.truncate(count);
        samples
    }

    /// Mean steps of the episodes that did not diverge, if episodes can end.
    fn length(&self) -> Option<f64> {
        let lengths = || self.results.iter().filter_map(|result| result.length);
        let count = lengths().count();
        (count > 0).then(|| lengths().sum::<usize>() as f64 / count as f64)
    }

    /// Number of episodes that ended before the horizon, if episodes can end.
    fn ended_early(&self) -> Option<usize> {
        let lengths = self.results.iter().filter_map(|result| result.length);
        self.length().map(|_| lengths.filter(|&length| length < self.horizon).count())
    }

    /// Row of `summary.csv`.
    fn summary(&self) -> Vec<String> {
        let worst = self.worst(1)[0];
        let numbers =
            self.mean().into_iter().chain(self.quantiles()).chain([self.results[worst].loss]);
        let row = [self.name.clone(), self.results.len().to_string(), self.diverged().to_string()];
        let length = self.length().map(|length| length.to_string()).unwrap_or_default();
        let early = self.ended_early().map(|early| early.to_string()).unwrap_or_default();
        let last = [worst.to_string(), length, early];
        row.into_iter().chain(numbers.map(|x| x.to_string())).chain(last).collect()
    }
}

/// `losses.csv`: one row per policy and initial state. The length is empty if episodes cannot end.
fn losses_csv(policies: &[OfPolicy]) -> Result<Vec<u8>> {
    let rows = policies.iter().flat_map(|policy| {
        let row = |(sample, result): (usize, &Evaluated)| {
            let length = result.length.map(|length| length.to_string()).unwrap_or_default();
            [policy.name.clone(), sample.to_string(), result.loss.to_string(), length]
        };
        policy.results.iter().enumerate().map(row)
    });
    csv(["run", "sample", "loss", "length"], rows)
}

/// Writes `worst.csv` with the trajectories of the samples, and an animation of each sample.
fn write_worst(
    folder: &Folder,
    scene: &Scene,
    evaluation: &dyn AnyEvaluation,
    samples: &[usize],
) -> Result<()> {
    folder.remove("worst.csv")?;
    folder.remove_all("worst_", ".svg")?;
    if samples.is_empty() {
        return Ok(());
    }
    let rollouts: Vec<_> = samples.iter().map(|&sample| evaluation.rollout(sample)).collect();
    folder.write(
        "worst.csv",
        outputs::trajectories(scene, samples.iter().copied().zip(&rollouts))?,
    )?;
    let mut animations: Vec<Animation> =
        rollouts.iter().map(|rollout| scene.animation(rollout)).collect();
    Animation::share_scale(&mut animations.iter_mut().collect::<Vec<_>>());
    for (rank, animation) in animations.iter().enumerate() {
        folder.write(&format!("worst_{}.svg", rank + 1), animation.to_svg())?;
    }
    Ok(())
}

fn title(args: &Eval, policies: &[Trained]) -> String {
    let scene = args.scene.as_deref().unwrap_or(policies[0].scene.task.name());
    format!("{scene}: losses of {}", counted(args.samples, "rollout"))
}

fn picture(title: &str, results: &[OfPolicy]) -> String {
    let line = |result: &OfPolicy| (result.name.clone(), sorted(result.losses()));
    distribution(title, results.iter().map(line).collect()).to_svg()
}

fn table(args: &Eval, results: &[OfPolicy]) -> String {
    let can_end = results.iter().any(|result| result.length().is_some());
    let header = ["run", "mean", "5 %", "median", "95 %", "worst", "diverged"];
    let of_ends = ["mean steps", "ended early"].into_iter().filter(|_| can_end);
    let header = header.into_iter().chain(of_ends);
    let mut table = Table::new(header).optional(&["diverged", "95 %", "5 %"]);
    for result in results {
        let ([mean, error], quantiles) = (result.mean(), result.quantiles());
        let worst = result.results[result.worst(1)[0]].loss;
        let row = [quantiles[0], quantiles[2], quantiles[4], worst].map(short);
        // One rollout has no standard error.
        let mean = if error.is_nan() {
            short(mean)
        } else {
            format!("{} ± {}", short(mean), rough(error))
        };
        let first = [result.name.clone(), mean];
        let early = result.ended_early().map_or("-".into(), |early| early.to_string());
        let ends = [result.length().map_or("-".into(), short), early];
        let ends = ends.into_iter().filter(|_| can_end);
        table.row(first.into_iter().chain(row).chain([result.diverged().to_string()]).chain(ends));
    }
    let rollouts = counted(args.samples, "rollout");
    let note = |result: &OfPolicy| {
        let (few, mean) = result.outliers()?;
        let (few, name) = (counted(few, "rollout"), &result.name);
        Some(format!(
            "\n{name}: {few} with more than a thousand times the median loss; the mean of the others is {}",
            short(mean)
        ))
    };
    format!(
        "{table}\nlosses of {rollouts}, seed {}; mean ± standard error, without diverged rollouts{}",
        args.seed,
        results.iter().filter_map(note).collect::<String>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_losses_with_almost_the_whole_sum_are_outliers() {
        let outliers = |large: &[f64], small: usize| {
            let losses = [large, &vec![0.5; small], &[f64::INFINITY]].concat();
            let result = |loss| Evaluated { loss, length: None };
            let results = losses.into_iter().map(result).collect();
            OfPolicy { name: String::new(), horizon: 1, results }.outliers()
        };
        assert_eq!(outliers(&[1e153], 9), Some((1, 0.5)));
        assert_eq!(outliers(&[1e153, 1e90], 198), Some((2, 0.5)));
        assert_eq!(outliers(&[1e153, 1e90], 18), None, "10 % of the rollouts");
        assert_eq!([outliers(&[], 200), outliers(&[], 0), outliers(&[1.0], 0)], [None; 3]);
        assert_eq!([outliers(&[499.0], 9), outliers(&[501.0], 9)], [None, Some((1, 0.5))]);
    }
}
