//! `physgrad identify`: fits the trained numbers of a scene to measured trajectories.

mod data;
mod picture;

use crate::Number;
use crate::identify::{Fit, Options, Segment};
use crate::program::platform::csv::csv;
use crate::program::platform::folder::Folder;
use crate::program::platform::terminal::print_result;
use crate::program::runs::run::threads;
use crate::program::scenes::overrides::Overrides;
use crate::program::scenes::presets;
use crate::program::tasks::Scene;
use anyhow::{Context, Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use data::Measured;
use std::path::PathBuf;
use std::time::Instant;

/// Fit the numbers in [fit] of a scene to measured trajectories.
///
/// Writes the fitted scene, the numbers with their standard errors, and measured beside simulated
/// trajectories.
#[derive(Debug, clap::Args)]
pub struct Identify {
    /// Preset or path of a scene; its section [fit] lists the unknown numbers
    pub scene: String,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Measured trajectories: columns segment (optional), t in s, states and controls by name
    #[arg(long, value_name = "FILE")]
    pub data: PathBuf,
    /// Standard deviations of the noise, as in theta_1=0.003,omega_1=0.1 [default: equal for all]
    #[arg(long, value_name = "NAME=VALUE,...", value_delimiter = ',')]
    pub noise: Vec<String>,
    /// Take the first sample of each segment as its exact initial state
    #[arg(long)]
    pub exact_starts: bool,
    /// Length of the windows of multiple shooting, in steps; 0: whole segments
    #[arg(long, value_name = "STEPS", default_value_t = 10)]
    pub window: usize,
    /// Fit every N-th segment only, and evaluate the others with free initial states
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub every: usize,
    /// Number of threads [default: RAYON_NUM_THREADS, or all cores]; results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results [default: a new one in `runs`]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Runs the command.
pub fn identify(args: &Identify) -> Result<()> {
    threads(args.threads)?;
    let mut source = presets::source(&args.scene)?;
    args.overrides.apply(&mut source)?;
    let scene = source.scene()?;
    if !scene.varied().iter().any(|(_, number)| matches!(number, Number::Trained { .. })) {
        bail!("{} has no unknown numbers; list them in [fit], as in \"system.gravity\" = {{ start = 9.8 }}", args.scene);
    }
    let measured = Measured::read(&args.data, &scene)?;
    let noise = noise(&args.noise, &scene)?;
    if args.every == 0 {
        bail!("--every is 0; allowed: 1 or more");
    }
    let options = Options {
        noise,
        free_starts: !args.exact_starts,
        window: (args.window > 0).then_some(args.window),
        ..Options::default()
    };
    let fitted: Vec<Segment> = measured.segments.iter().step_by(args.every).cloned().collect();
    let begin = Instant::now();
    let fit = scene.identify(&fitted, &options).with_context(|| format!("{} with {}", args.scene, args.data.display()))?;
    let seconds = begin.elapsed().as_secs_f64();

    for (name, &value) in fit.names.iter().zip(&fit.values) {
        source.fix(name, value)?;
    }
    let folder = Folder::named(args.out.as_deref(), &format!("identify-{}", presets::short_name(&args.scene)))?;
    folder.write("scene.toml", source.scene()?.table.to_string())?;
    folder.write("identified.csv", numbers(&fit, &scene)?)?;
    folder.write("trajectories.csv", measured.beside(&fitted, &fit, &scene)?)?;
    folder.write("identified.svg", picture::picture(&fitted, &fit, &scene))?;
    let mut text = format!(
        "{}\n{} measurements in {} segments, {} unknowns with initial states; {} iterations, {} simulations, {} Jacobians, {seconds:.1} s",
        table(&fit, &scene),
        fit.measurements,
        fitted.len(),
        fit.unknowns,
        fit.iterations,
        fit.simulations,
        fit.jacobians
    );
    text += &format!("\nχ² {:.6e}, BIC {:.1}", fit.chi_squared, fit.bic());
    text += &format!("\n{}", residuals(&fit, &fitted, &scene));
    if args.every > 1 {
        text += &format!("\n{}", validated(&measured, args, &source.scene()?, &options, &fit)?);
    }
    for combination in &fit.undetermined {
        text += &format!(
            "\nwarning: the data do not determine {} separately; fix one of them, or measure a motion with forces",
            combination.join(", ")
        );
    }
    for name in &fit.at_bound {
        text += &format!("\nwarning: {name} is at its bound");
    }
    if !fit.converged {
        text += "\nwarning: the iterations ended before convergence; try other initial values or another --window";
    }
    let results = folder.path().display();
    print_result(&format!(
        "{text}\nresults in {results}: scene.toml (with the fitted numbers), identified.csv, trajectories.csv, identified.svg"
    ))
}

/// Standard deviations in the order of the state components.
fn noise(assignments: &[String], scene: &Scene) -> Result<Option<Vec<f64>>> {
    if assignments.is_empty() {
        return Ok(None);
    }
    let names = scene.state_names();
    let mut noise = vec![None; names.len()];
    for assignment in assignments {
        let parsed = assignment.split_once('=').and_then(|(name, value)| {
            let index = names.iter().position(|known| known == name)?;
            Some((index, value.parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0)?))
        });
        let (index, value) = parsed.with_context(|| {
            format!("--noise {assignment}: write NAME=VALUE with a positive value; names: {}", names.join(", "))
        })?;
        noise[index] = Some(value);
    }
    let missing = names.iter().zip(&noise).find(|(_, value)| value.is_none());
    match missing {
        Some((name, _)) => bail!("--noise lacks {name}; give all of {}", names.join(", ")),
        None => Ok(Some(noise.into_iter().flatten().collect())),
    }
}

/// Initial value of each unknown.
fn starts(fit: &Fit, scene: &Scene) -> Vec<f64> {
    let varied = scene.varied();
    let start = |name: &String| varied.iter().find(|(known, _)| known == name).map_or(f64::NAN, |(_, number)| number.nominal());
    fit.names.iter().map(start).collect()
}

fn numbers(fit: &Fit, scene: &Scene) -> Result<Vec<u8>> {
    let mut header = ["name", "start", "value", "standard_error"].map(String::from).to_vec();
    header.extend(fit.names.iter().map(|name| format!("correlation with {name}")));
    let rows = starts(fit, scene).into_iter().enumerate().map(|(i, start)| {
        let mut row = vec![fit.names[i].clone(), start.to_string(), fit.values[i].to_string(), fit.errors[i].to_string()];
        row.extend(fit.correlations[i].iter().map(f64::to_string));
        row
    });
    csv(header, rows)
}

fn table(fit: &Fit, scene: &Scene) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_header(["number", "start", "value", "standard error"]);
    for (i, start) in starts(fit, scene).into_iter().enumerate() {
        let [start, value, error] = [start, fit.values[i], fit.errors[i]].map(|number| format!("{number:.5e}"));
        table.add_row([fit.names[i].clone(), start, value, error]);
    }
    table
}

/// Root mean square of the residuals of each component, over all segments.
fn residuals(fit: &Fit, segments: &[Segment], scene: &Scene) -> String {
    let rms = |i: usize| {
        let each = segments.iter().enumerate().map(|(index, segment)| fit.rms(index, i, segment)).filter(|rms| !rms.is_nan());
        let squares: Vec<f64> = each.map(|rms| rms * rms).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let names = scene.state_names();
    let parts: Vec<String> = names.iter().enumerate().map(|(i, name)| format!("{name} {:.3e}", rms(i))).collect();
    format!("root mean square of the residuals: {}", parts.join(", "))
}

/// Residuals of the segments that were not fitted: only their initial states are free.
fn validated(measured: &Measured, args: &Identify, scene: &Scene, options: &Options, fit: &Fit) -> Result<String> {
    let others = measured.segments.iter().enumerate().filter(|(i, _)| i % args.every != 0).map(|(_, segment)| segment.clone());
    let others: Vec<Segment> = others.collect();
    if others.is_empty() {
        bail!("--every {}: no segment remains for validation", args.every);
    }
    let simulated = scene.identify(&others, options)?;
    let mut held = fit.clone();
    held.states = simulated.states;
    Ok(format!("validation with {} other segments: {}", others.len(), residuals(&held, &others, scene)))
}
