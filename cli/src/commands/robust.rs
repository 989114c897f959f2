//! `physgrad robust`: losses of trained policies over a grid of settings.

use crate::commands::eval::check_samples;
use crate::operations::session::Epoch;
use crate::platform::csv::csv;
use crate::platform::folder::Folder;
use crate::platform::json::{print_json, rows as objects};
use crate::platform::parallel;
use crate::platform::table::Table;
use crate::platform::terminal::{counted, print_text};
use crate::runs::trained::Trained;
use crate::scenes::overrides::is_of_training;
use crate::tasks::Scene;
use anyhow::{Context, Result, bail};
use physgrad::text::short;
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Series, line_style, robustness};
use serde_json::json;
use std::path::PathBuf;
use toml::Value;

/// Evaluate trained policies over a grid of one or two settings.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad robust runs/one --grid system.cart_mass=0.5:2:7\n  physgrad robust runs/one runs/two --grid system.cart_mass=0.5:2:4 --grid system.gravity=8:11:4"
)]
pub struct Robust {
    /// Folders of trained runs of one task, or scenes whose policy has no trained numbers
    #[arg(required = true)]
    pub runs: Vec<PathBuf>,
    /// Setting and its values, as in system.cart_mass=0.5:2:7 (7 values from 0.5 to 2); one or two
    #[arg(long, value_name = "KEY=LOW:HIGH:COUNT", required = true, value_parser = Axis::parse)]
    pub grid: Vec<Axis>,
    /// Epoch of the policies
    #[arg(long, value_enum, default_value_t = Epoch::Last)]
    pub epoch: Epoch,
    /// Number of initial states per grid point
    #[arg(long, value_name = "N", default_value_t = 256)]
    pub samples: usize,
    /// Seed of the initial states
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Folder for the results; replaces earlier results of this command in it [default: a new one
    /// in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// A setting and its values.
#[derive(Clone, Debug)]
pub struct Axis {
    key: String,
    values: Vec<f64>,
}

impl Axis {
    fn parse(text: &str) -> Result<Self, String> {
        let parts = || {
            let (key, range) = text.split_once('=')?;
            let [low, high, count] = range.split(':').collect::<Vec<_>>().try_into().ok()?;
            let (low, high): (f64, f64) = (low.parse().ok()?, high.parse().ok()?);
            let count: usize = count.parse().ok()?;
            let valid = low.is_finite() && high.is_finite() && (2..=200).contains(&count);
            valid.then(|| (key.trim().to_owned(), low, high, count))
        };
        let (key, low, high, count) = parts().ok_or(
            "allowed: KEY=LOW:HIGH:COUNT with 2 to 200 values, as in system.cart_mass=0.5:2:7",
        )?;
        let step = (high - low) / (count - 1) as f64;
        let value = |i: usize| if i + 1 == count { high } else { low + step * i as f64 };
        Ok(Self { key, values: (0..count).map(value).collect() })
    }
}

/// Result of one policy at one grid point.
struct Cell {
    /// Index of the run.
    run: usize,
    /// Value of each setting.
    at: Vec<f64>,
    /// Quartiles and 90 % quantile of the losses. The loss of a diverged rollout is infinite.
    quantiles: [f64; 4],
    /// Number of diverged rollouts.
    diverged: usize,
    /// Mean steps of the episodes, if they can end.
    length: Option<f64>,
}

/// Probabilities of the quantiles in a [`Cell`].
const SHARES: [f64; 4] = [0.25, 0.5, 0.75, 0.9];

/// Runs the command.
pub fn robust(args: &Robust) -> Result<()> {
    if args.grid.len() > 2 {
        bail!("--grid is given {} times; allowed: once or twice", args.grid.len());
    }
    if let [first, second] = &args.grid[..]
        && first.key == second.key
    {
        bail!("--grid gives {} twice; give each setting once", first.key);
    }
    check_samples(args.samples)?;
    let unused = |axis: &&Axis| axis.key == "seed" || is_of_training(&axis.key);
    if let Some(Axis { key, .. }) = args.grid.iter().find(unused) {
        bail!("--grid {key}: an evaluation does not use this setting; choose a number of the task");
    }
    let runs = Trained::load_all(&args.runs, args.epoch)?;
    for Axis { key, .. } in &args.grid {
        let is_trained = |run: &&Trained| {
            run.scene.policy_numbers(&run.theta).iter().any(|(name, _)| name == key)
        };
        if let Some(run) = runs.iter().find(is_trained) {
            bail!(
                "--grid {key}: the training of {} has determined this number; choose another one",
                run.name
            );
        }
    }
    let mut points = Vec::new();
    for run in 0..runs.len() {
        for &first in &args.grid[0].values {
            match args.grid.get(1) {
                Some(second) => {
                    points.extend(second.values.iter().map(|&second| (run, vec![first, second])))
                }
                None => points.push((run, vec![first])),
            }
        }
    }
    // Checks all scenes before the first evaluation.
    let valid = parallel::map(&points, |(run, at)| scene(&runs[*run], at, args).map(drop));
    valid.into_iter().collect::<Result<()>>()?;
    let reserved = Folder::reserve(args.out.as_deref())?;
    let cells = parallel::map(&points, |(run, at)| evaluate(&runs[*run], *run, at, args));
    let cells = cells.into_iter().collect::<Result<Vec<_>>>()?;
    let folder = Folder::or_fresh(reserved, "robust")?;
    let points = table_csv(args, &runs, &cells)?;
    folder.write("robust.csv", &points)?;
    folder.write("robust.svg", picture(args, &runs, &cells))?;
    if args.json {
        return print_json(&json!({ "folder": folder.path(), "points": objects(&points)? }));
    }
    print_text(&format!(
        "{}\nresults in {}: robust.csv, robust.svg",
        table(args, &runs, &cells),
        folder.path().display()
    ))
}

/// Scene of a policy at one grid point.
fn scene(policy: &Trained, at: &[f64], args: &Robust) -> Result<Scene> {
    let mut source = policy.source.clone();
    for (axis, &value) in args.grid.iter().zip(at) {
        // Whole-number settings reject 1.0. All numeric settings accept integers.
        let integer = value as i64;
        let number =
            if integer as f64 == value { Value::Integer(integer) } else { Value::Float(value) };
        source.replace(&axis.key, number, &format!("{} = {value}", axis.key))?;
    }
    // Windows have no effect on an evaluation, whose horizon may be shorter.
    source.without_section("window");
    source.scene().context("--grid")
}

/// Evaluates a policy at one grid point.
fn evaluate(policy: &Trained, run: usize, at: &[f64], args: &Robust) -> Result<Cell> {
    let evaluation = policy.evaluation(&scene(policy, at, args)?, args.seed)?;
    let results = evaluation.results(args.samples);
    let lengths: Vec<usize> = results.iter().filter_map(|result| result.length).collect();
    let length = lengths.iter().sum::<usize>() as f64 / lengths.len() as f64;
    let losses: Vec<f64> = results.into_iter().map(|result| result.loss).collect();
    let diverged = losses.iter().filter(|loss| !loss.is_finite()).count();
    let losses = sorted(losses.into_iter());
    Ok(Cell {
        run,
        at: at.to_vec(),
        quantiles: SHARES.map(|share| quantile(&losses, share)),
        diverged,
        length: (!lengths.is_empty()).then_some(length),
    })
}

/// Header and rows of `robust.csv`.
fn rows<'a>(
    args: &'a Robust,
    runs: &'a [Trained],
    cells: &'a [Cell],
) -> (Vec<String>, impl Iterator<Item = Vec<String>>) {
    let mut header = vec!["run".to_owned()];
    header.extend(args.grid.iter().map(|axis| axis.key.clone()));
    header.extend(
        ["quartile_1", "median", "quartile_3", "quantile_90", "diverged", "mean_length"]
            .map(String::from),
    );
    let row = |cell: &Cell| {
        let mut row = vec![runs[cell.run].name.clone()];
        row.extend(cell.at.iter().map(f64::to_string));
        row.extend(cell.quantiles.iter().map(f64::to_string));
        row.push(cell.diverged.to_string());
        row.push(cell.length.map(|length| length.to_string()).unwrap_or_default());
        row
    };
    (header, cells.iter().map(row))
}

fn table_csv(args: &Robust, runs: &[Trained], cells: &[Cell]) -> Result<Vec<u8>> {
    let (header, rows) = rows(args, runs, cells);
    csv(header, rows)
}

/// Median losses, 90 % quantiles in parentheses, and lengths of episodes that can end: one row per grid point, one column per run.
fn table(args: &Robust, runs: &[Trained], cells: &[Cell]) -> String {
    let keys = args.grid.iter().map(|axis| axis.key.clone());
    let names: Vec<&str> = runs.iter().map(|run| &*run.name).collect();
    let mut table =
        Table::new(keys.chain(names.iter().map(ToString::to_string))).optional(&names[1..]);
    let points = cells.len() / runs.len();
    for (point, cell) in cells.iter().take(points).enumerate() {
        let losses = (0..runs.len()).map(|run| {
            let cell = &cells[run * points + point];
            let [_, median, _, high] = cell.quantiles.map(short);
            let steps = |length| format!(", {} steps", short(length));
            format!("{median} ({high}){}", cell.length.map_or_else(String::new, steps))
        });
        table.row(cell.at.iter().map(|&value| short(value)).chain(losses));
    }
    let can_end = cells.iter().any(|cell| cell.length.is_some());
    let steps = if can_end { ", and mean steps of the episodes" } else { "" };
    format!("{table}\nmedian loss (90 % quantile){steps} of {}", counted(args.samples, "rollout"))
}

/// One panel per value of the second setting, one line per run: the median, with a band from the
/// first to the third quartile.
fn picture(args: &Robust, runs: &[Trained], cells: &[Cell]) -> String {
    let seconds: Vec<Option<f64>> = match args.grid.get(1) {
        Some(axis) => axis.values.iter().map(|&value| Some(value)).collect(),
        None => vec![None],
    };
    let panel = |second: Option<f64>| {
        let series = |(i, run): (usize, &Trained)| {
            let own: Vec<&Cell> = cells
                .iter()
                .filter(|cell| cell.run == i && cell.at.get(1).copied() == second)
                .collect();
            let line = own.iter().map(|cell| (cell.at[0], cell.quantiles[1])).collect();
            let band = own.iter().map(|cell| (cell.quantiles[0], cell.quantiles[2])).collect();
            let (color, dash) = line_style(i);
            Series { band, ..Series::new(&*run.name, color, line).dash(dash) }
        };
        let title = second
            .map_or_else(String::new, |value| format!("{} = {}", args.grid[1].key, short(value)));
        (title, runs.iter().enumerate().map(series).collect())
    };
    let rollouts = counted(args.samples, "rollout");
    let title = format!("{}: median loss and quartiles of {rollouts}", runs[0].scene.task.name());
    robustness(&title, &args.grid[0].key, seconds.into_iter().map(panel).collect()).to_svg()
}
