//! `physgrad identify`: fits the trained numbers of a scene to measured trajectories.

pub mod data;
mod picture;
pub mod remarks;
pub mod table;

use crate::commands::report::identification::{
    self, ASSUMED, FIT, IDENTIFIED, TRAJECTORIES, VALIDATION, WARNING,
};
use crate::platform::csv::csv;
use crate::platform::folder::{Folder, REPORT, SCENE};
use crate::platform::json::{object, print_json, rows};
use crate::platform::table::Table;
use crate::platform::terminal::{counted, listed, print_text};
use crate::runs::saved;
use crate::scenes::overrides::{Overrides, hide, is_of_training};
use crate::scenes::presets;
use crate::scenes::source::SceneSource;
use crate::tasks::{self, Scene};
use anyhow::{Context, Result, anyhow, bail};
use data::Measured;
use physgrad::Number;
use physgrad::identify::{Fit, IdentifyError, Options, Segment, Status};
use physgrad::text::{digits, rough, short};
use remarks::{COMMAND, Remarks, Rows, measured_components, rms, starts};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;
use table::Reading;

/// File of the picture.
const PICTURE: &str = "identified.svg";

/// Fit the numbers in [fit] of a scene to measured trajectories.
///
/// Writes a report, the fitted scene, the numbers with their standard errors, and measured beside
/// simulated trajectories.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  physgrad identify pendulum.toml --data measured.csv --noise theta_1=0.003,omega_1=0.1"
)]
#[command(mut_args(hide(is_unread)))]
pub struct Identify {
    /// Preset or path of a scene; its section [fit] lists the unknown numbers
    pub scene: String,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Measured trajectories: columns segment (optional), t in s from the start of the rollout,
    /// states, controls and parameters by name
    #[arg(long, value_name = "FILE")]
    pub data: PathBuf,
    /// Standard deviations of the noise of all measured states, as in theta_1=0.003,omega_1=0.1
    /// [default: equal for all]
    #[arg(long, value_name = "NAME=VALUE,...", value_delimiter = ',')]
    pub noise: Vec<String>,
    /// Take the first sample of each segment as its exact initial state
    #[arg(long)]
    pub exact_starts: bool,
    /// Length of the windows of multiple shooting, in steps; 0: whole segments
    #[arg(long, value_name = "STEPS", default_value_t = 10)]
    pub window: usize,
    /// Fit every N-th segment only, and simulate the others from fitted initial states
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub every: usize,
    /// Number of threads [default: RAYON_NUM_THREADS, or all cores]; results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results [default: a new one in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn identify(args: &Identify) -> Result<()> {
    let (mut source, scene) = read(args)?;
    let table = table::Table::read(&args.data, [&scene, &source.scene()?], &Reading::default())?;
    let measured = Measured::read(&table, &scene, &source, &COMMAND)?;
    let options = options(args, &scene, &measured)?;
    let [fitted, others] = measured.split(args.every);
    if args.every > 1 && others.is_empty() {
        bail!("--every {}: no segment remains for validation", args.every);
    }
    let segments = measured.chosen(&fitted, &scene);
    let reserved = Folder::reserve(args.out.as_deref())?;
    let begin = Instant::now();
    let fit = scene
        .identify(&segments, &options)
        .map_err(|error| in_file(error, &fitted, &measured, &scene));
    let fit = fit.with_context(|| format!("{} with {}", args.scene, args.data.display()))?;
    let seconds = begin.elapsed().as_secs_f64();

    for (name, &value) in fit.names.iter().zip(&fit.values) {
        source.fix(name, value)?;
    }
    // A fitted value can be outside of the range of its setting.
    let found = if fit.converged {
        let scene = source.scene().and_then(|scene| Ok(scene.without_sensor()?));
        scene.map_err(|error| anyhow!("{error:#}; add bounds to [fit]"))
    } else {
        Err(anyhow!("the fit has not converged"))
    };
    // The validation fixes the numbers, and fits only the initial states.
    let validating = Options { free_starts: true, ..options };
    let validate = |found: &Scene| found.identify(&measured.chosen(&others, found), &validating);
    let validation = found.as_ref().ok().filter(|_| !others.is_empty()).map(validate).transpose();
    let folder =
        Folder::or_fresh(reserved, &format!("identify-{}", presets::short_name(&args.scene)))?;
    let outcome = Outcome {
        scene: &scene,
        measured: &measured,
        fitted: &fitted,
        others: &others,
        segments: &segments,
        facts: facts(&fit, seconds),
        fit,
        found,
        validation,
    };
    let remarks = outcome.remarks(!args.noise.is_empty());
    let identified = outcome.write(&folder, &remarks)?;
    outcome.print(&folder, &remarks, args.json.then_some(&*identified))?;
    let failed = outcome.validation.err().map(|error| in_file(error, &others, &measured, &scene));
    failed.map_or(Ok(()), |error| Err(error).context("validation with the fitted numbers"))
}

/// Whether the command does not read the setting with this key.
fn is_unread(key: &str) -> bool {
    let sections = ["training.", "loss.", "policy."];
    is_of_training(key)
        || sections.iter().any(|section| key.starts_with(section))
        || ["seed", "precision", "horizon"].contains(&key)
}

/// Whether only costs of a built-in task depend on the setting with this key.
fn is_of_costs(key: &str) -> bool {
    ["system.weighting", "system.target"].contains(&key)
}

/// Scene of the command without its sensor, and its source.
///
/// # Errors
/// An option has no effect on an identification. The scene has no unknown numbers.
fn read(args: &Identify) -> Result<(SceneSource, Scene)> {
    args.overrides.refuse(
        is_unread,
        "an identification, which trains no policy and simulates the measured steps in f64",
    )?;
    let mut source = presets::source(&args.scene)?;
    args.overrides.apply(&mut source)?;
    let scene = source.scene()?.without_sensor()?;
    if !tasks::own().iter().any(|own| own.name() == scene.task.name()) {
        args.overrides.refuse(is_of_costs, "an identification, which has no cost")?;
    }
    if !scene.varied().iter().any(|(_, number)| matches!(number, Number::Trained { .. })) {
        bail!(
            "{} has no unknown numbers; list them in [fit], as in \"system.gravity\" = {{ start = 9.8 }}",
            args.scene
        );
    }
    Ok((source, scene))
}

/// Options of the fit.
///
/// # Errors
/// An option is invalid, or a result would replace an input.
fn options(args: &Identify, scene: &Scene, measured: &Measured) -> Result<Options> {
    if args.every == 0 {
        bail!("--every is 0; allowed: 1 or more");
    }
    // Exact first samples have no noise. Those of validation segments are not exact.
    let first = usize::from(args.exact_starts && args.every == 1);
    let noise = noise(&args.noise, scene, [first, 0].map(|first| measured.components(first)))?;
    if let Some(out) = args.out.as_deref().map(Folder::at) {
        let outputs = [SCENE, IDENTIFIED, FIT, TRAJECTORIES, VALIDATION, PICTURE, REPORT];
        out.check_inputs(&[Path::new(&args.scene), &args.data], &outputs)?;
    }
    Ok(Options {
        noise,
        free_starts: !args.exact_starts,
        window: (args.window > 0).then_some(args.window),
        ..Options::default()
    })
}

/// A fit with its data and its validation.
struct Outcome<'a> {
    scene: &'a Scene,
    measured: &'a Measured,
    /// Indices of the fitted segments in the file, and of those of the validation.
    fitted: &'a [usize],
    others: &'a [usize],
    segments: &'a [Segment],
    fit: Fit,
    facts: Vec<(&'static str, String)>,
    /// Scene with the fitted numbers, or the reason why there is none.
    found: Result<Scene>,
    validation: Result<Option<Fit>, IdentifyError>,
}

impl Outcome<'_> {
    /// Fit of the validation, with the scene of the fitted numbers.
    fn validated(&self) -> Option<(&Scene, &Fit)> {
        self.found.as_ref().ok().zip(self.validation.as_ref().ok()?.as_ref())
    }

    /// Remarks about the data, the fit and the validation.
    fn remarks(&self, noise_is_known: bool) -> Remarks {
        let Self { scene, measured, fitted, others, segments, fit, .. } = self;
        let of = |fit: &Fit, scene: &Scene, segments: &[Segment], numbers: &[usize]| {
            let given = Fitted { measured, numbers };
            let Remarks { notes: turns, warnings } =
                remarks::remarks(fit, scene, segments, &given, noise_is_known, &COMMAND);
            let mut notes = measured.notes(numbers);
            notes.extend(turns);
            Remarks { notes, warnings }
        };
        let mut all = of(fit, scene, segments, fitted);
        if let Some((found, validation)) = self.validated() {
            let segments = measured.chosen(others, found);
            let Remarks { notes, warnings } = of(validation, found, &segments, others);
            let of_validation = |text: String| format!("validation: {text}");
            all.notes.extend(notes.into_iter().map(of_validation));
            all.warnings.extend(warnings.into_iter().map(of_validation));
        }
        if let Err(error) = &self.found {
            all.warnings.push(format!("there is no scene.toml and no validation: {error:#}"));
        }
        all
    }

    /// Writes the results. Returns the table of the numbers.
    fn write(&self, folder: &Folder, remarks: &Remarks) -> Result<Vec<u8>> {
        let Self { scene, measured, fitted, others, segments, fit, .. } = self;
        match &self.found {
            Ok(found) => saved::write_scene(folder, SCENE, found)?,
            Err(_) => folder.remove(SCENE)?,
        }
        let identified = numbers(fit, scene)?;
        folder.write(IDENTIFIED, &identified)?;
        let notes = remarks.notes.iter().map(|note| [ASSUMED.to_owned(), note.clone()]);
        let warnings = remarks.warnings.iter().map(|warning| [WARNING.to_owned(), warning.clone()]);
        let facts = self.facts.iter().map(|(name, value)| [(*name).to_owned(), value.clone()]);
        folder.write(FIT, csv(["name", "value"], facts.chain(notes).chain(warnings))?)?;
        folder.write(TRAJECTORIES, measured.beside(fitted, fit, scene)?)?;
        match self.validated() {
            Some((_, validation)) => {
                folder.write(VALIDATION, measured.beside(others, validation, scene)?)?
            }
            // An earlier fit may have left its validation.
            None => folder.remove(VALIDATION)?,
        }
        folder.write(PICTURE, picture::picture(measured, fitted, segments, fit, scene))?;
        folder.write(REPORT, identification::page(&Folder::existing(folder.path())?)?)?;
        Ok(identified)
    }

    /// Prints the results as text or, with the table of the numbers, as JSON.
    fn print(&self, folder: &Folder, remarks: &Remarks, json: Option<&[u8]>) -> Result<()> {
        let Remarks { notes, warnings } = remarks;
        if let Some(identified) = json {
            return print_json(&json!({
                "folder": folder.path(),
                "numbers": rows(identified)?,
                "fit": object(self.facts.iter().map(|(name, value)| (*name, value.as_str()))),
                "notes": notes,
                "warnings": warnings,
            }));
        }
        let mut text = table(&self.fit, self.scene).to_string();
        for (name, value) in &self.facts {
            text += &format!("{}{name} {value}", if *name == "segments" { "\n" } else { ", " });
        }
        text += &format!("\n{}", residuals(&self.fit, self.segments, self.scene));
        let mut validated = String::new();
        if let Some((_, validation)) = self.validated() {
            let segments = self.measured.chosen(self.others, self.scene);
            text += &format!(
                "\nvalidation with {}: {}",
                counted(self.others.len(), "other segment"),
                residuals(validation, &segments, self.scene)
            );
            validated = format!(", {VALIDATION}");
        }
        notes.iter().for_each(|note| text += &format!("\n{ASSUMED}: {note}"));
        warnings.iter().for_each(|warning| text += &format!("\n{WARNING}: {warning}"));
        let written =
            if self.found.is_ok() { "scene.toml (with the fitted numbers), " } else { "" };
        print_text(&format!(
            "{text}\nresults in {}: report.html, {written}{IDENTIFIED}, {FIT}, {TRAJECTORIES}, identified.svg{validated}",
            folder.path().display()
        ))
    }
}

/// The fitted segments of a file.
struct Fitted<'a> {
    measured: &'a Measured,
    /// Indices of the segments in the file.
    numbers: &'a [usize],
}

impl Rows for Fitted<'_> {
    fn values(&self, segment: usize, component: usize) -> Vec<f64> {
        self.measured.values(self.numbers[segment], component)
    }

    fn place(&self, segment: usize, row: usize) -> [String; 2] {
        self.measured.place(self.numbers[segment], row)
    }
}

/// The error with the name of its segment in the file, and with names of states. `numbers` are the
/// indices of the chosen segments.
fn in_file(
    error: IdentifyError,
    numbers: &[usize],
    measured: &Measured,
    scene: &Scene,
) -> anyhow::Error {
    use IdentifyError::{Diverged, Empty, MissingParam, MissingStart, NonFinite, Shape};
    let (Shape { segment, .. }
    | NonFinite { segment, .. }
    | Empty { segment }
    | MissingParam { segment, .. }
    | MissingStart { segment, .. }
    | Diverged { segment, .. }) = error
    else {
        return error.into();
    };
    let (number, label) = (numbers[segment], measured.label(numbers[segment]));
    if matches!(error, MissingStart { .. }) {
        let first = measured.first(number).iter().zip(scene.state_names());
        let missing: Vec<String> =
            first.filter(|(y, _)| y.is_nan()).map(|(_, name)| name).collect();
        return anyhow!(
            "segment {label}: the first row lacks {}, but --exact-starts takes it as the exact initial state; \
             omit --exact-starts, or begin at a complete row",
            listed(&missing)
        );
    }
    let index = format!("segment {segment}");
    anyhow!("{}", error.to_string().replacen(&index, &format!("segment {label}"), 1))
}

/// Sizes, χ², BIC and effort of the fit, by name.
fn facts(fit: &Fit, seconds: f64) -> Vec<(&'static str, String)> {
    vec![
        ("segments", fit.states.len().to_string()),
        ("measurements", fit.measurements.to_string()),
        ("unknowns with initial states", fit.unknowns.to_string()),
        ("χ²", digits(fit.chi_squared, 7)),
        ("BIC", format!("{:.1}", fit.bic())),
        (
            "window",
            fit.window.map_or_else(|| "whole segments".into(), |steps| counted(steps, "step")),
        ),
        ("iterations", fit.iterations.to_string()),
        ("simulations", fit.simulations.to_string()),
        ("Jacobians", fit.jacobians.to_string()),
        ("seconds", format!("{seconds:.1}")),
    ]
}

/// Standard deviations in the order of the state components. The components `fitted` need an
/// assignment, and components without a measurement have none. The default is 1 for others. None
/// without assignments.
fn noise(
    assignments: &[String],
    scene: &Scene,
    [fitted, measured]: [Vec<usize>; 2],
) -> Result<Option<Vec<f64>>> {
    if assignments.is_empty() {
        return Ok(None);
    }
    let names = scene.state_names();
    let list = |states: &[usize]| {
        listed(&states.iter().map(|&i| names[i].clone()).collect::<Vec<String>>())
    };
    let mut noise = vec![None; names.len()];
    for assignment in assignments {
        let parsed = assignment.split_once('=').and_then(|(name, value)| {
            let index = names.iter().position(|known| known == name)?;
            Some((
                index,
                value.parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0)?,
            ))
        });
        let (index, value) = parsed.with_context(|| {
            format!(
                "--noise {assignment}: write NAME=VALUE with a positive value; names: {}",
                listed(&names)
            )
        })?;
        if !measured.contains(&index) {
            bail!(
                "--noise {assignment} has no effect: the file has no measurement of {}; measured states: {}",
                names[index],
                list(&measured)
            );
        }
        if noise[index].replace(value).is_some() {
            bail!("--noise {assignment}: {} is given twice; give each name once", names[index]);
        }
    }
    let missing: Vec<usize> = fitted.iter().copied().filter(|&i| noise[i].is_none()).collect();
    if !missing.is_empty() {
        bail!("--noise lacks {}; give all measured states: {}", list(&missing), list(&fitted));
    }
    Ok(Some(noise.into_iter().map(|noise| noise.unwrap_or(1.0)).collect()))
}

fn numbers(fit: &Fit, scene: &Scene) -> Result<Vec<u8>> {
    let mut header = ["name", "start", "value", "standard_error", "robust_error", "status"]
        .map(String::from)
        .to_vec();
    header.extend(fit.names.iter().map(|name| format!("correlation with {name}")));
    let rows = starts(fit, scene).into_iter().enumerate().map(|(i, start)| {
        let mut row = vec![fit.names[i].clone()];
        row.extend(
            [start, fit.values[i], fit.errors[i], fit.robust_errors[i]]
                .map(|number| number.to_string()),
        );
        row.push(fit.statuses[i].name().into());
        row.extend(fit.correlations[i].iter().map(f64::to_string));
        row
    });
    csv(header, rows)
}

/// The numbers, with a column of robust errors if there are any.
fn table(fit: &Fit, scene: &Scene) -> Table {
    let has_robust = fit.robust_errors.iter().any(|error| error.is_finite());
    let header = ["number", "start", "value", "standard error", "robust error"];
    let columns = if has_robust { header.len() } else { header.len() - 1 };
    let mut table = Table::new(header[..columns].iter().copied());
    for (i, start) in starts(fit, scene).into_iter().enumerate() {
        let error = |error: f64| if error.is_finite() { rough(error) } else { "none".into() };
        let [own, robust] = match fit.statuses[i] {
            Status::Estimated => [fit.errors[i], fit.robust_errors[i]].map(error),
            status => [status.name().into(), String::new()],
        };
        let cells = [fit.names[i].clone(), digits(start, 6), digits(fit.values[i], 6), own, robust];
        table.row(cells.into_iter().take(columns));
    }
    table
}

/// Root mean square of the residuals of each component with a measurement after the first row.
fn residuals(fit: &Fit, segments: &[Segment], scene: &Scene) -> String {
    let names = scene.state_names();
    let parts = measured_components(segments, 1)
        .into_iter()
        .map(|i| format!("{} {}", names[i], short(rms(fit, segments, i))));
    let parts: Vec<String> = parts.collect();
    format!("root mean square of the residuals: {}", parts.join(", "))
}
