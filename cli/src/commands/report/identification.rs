//! Page about an identification, from the files that `physgrad identify` writes.

use crate::commands::report::figure::Figure;
use crate::commands::report::page::{document, figures, section, table};
use crate::platform::csv::unguarded;
use crate::platform::folder::Folder;
use anyhow::{Context, Result, bail};
use maud::{Markup, html};
use physgrad::text::short;
use physgrad_plot::{Chart, Dash, Series};

/// File of the identified numbers, with errors and correlations. Present in every folder of an
/// identification.
pub const IDENTIFIED: &str = "identified.csv";
/// File of the fit: numbers of segments, measurements and unknowns, χ², BIC, effort, and warnings.
pub const FIT: &str = "fit.csv";
/// File of the measured and simulated states of the fitted segments.
pub const TRAJECTORIES: &str = "trajectories.csv";
/// File of the measured and simulated states of the validation segments.
pub const VALIDATION: &str = "validation.csv";
/// Name of a row of [`FIT`] with a warning.
pub const WARNING: &str = "warning";

/// Name of a row of [`FIT`] with a note about what the fit assumes.
pub const ASSUMED: &str = "note";

/// Number of columns of [`IDENTIFIED`] before the correlations.
const NUMBERS: usize = 6;

const NOTE: &str = "Residuals are simulated minus measured states. A standard error assumes independent residuals. A robust error \
                    allows for correlated residuals within a segment; it needs more segments than numbers.";

/// The page of the identification in the folder.
///
/// # Errors
/// A file cannot be read or is damaged.
pub fn page(folder: &Folder) -> Result<String> {
    let (header, numbers) = &rows(folder, IDENTIFIED, NUMBERS)?;
    let (_, fit) = rows(folder, FIT, 2)?;
    let (warnings, facts): (Vec<_>, Vec<_>) = fit.iter().partition(|row| row[0] == WARNING);
    let warnings: Vec<String> = warnings.into_iter().map(|row| row[1].clone()).collect();
    let (notes, facts): (Vec<_>, Vec<_>) = facts.into_iter().partition(|row| row[0] == ASSUMED);
    let (names, values): (Vec<String>, Vec<String>) =
        facts.into_iter().map(|row| (row[0].clone(), row[1].clone())).unzip();
    let names_and = |row: &[String], cells: Vec<String>| [vec![row[0].clone()], cells].concat();
    let errors = |row: &Vec<String>| {
        names_and(row, row[1..NUMBERS].iter().map(|cell| rounded(cell)).collect())
    };
    let errors: Vec<Vec<String>> = numbers.iter().map(errors).collect();
    let two_digits =
        |cell: &String| cell.parse::<f64>().map_or_else(|_| cell.clone(), |x| format!("{x:.2}"));
    let correlations =
        |row: &Vec<String>| names_and(row, row[NUMBERS..].iter().map(two_digits).collect());
    let correlations: Vec<Vec<String>> = numbers.iter().map(correlations).collect();
    let headers = ["name", "start", "value", "standard error", "robust error", "status"];
    let columns = names_and(header, correlations.iter().map(|row| row[0].clone()).collect());
    let content = html! {
        (section("Numbers", table(&headers, &errors)))
        (section("Correlations", table(&columns, &correlations)))
        (section("Fit", html! {
            (table(&names, &[values]))
            @for note in notes { p { "Note: " (note[1]) } }
        }))
        (compared("Fitted segments", &Trajectories::read(folder, TRAJECTORIES)?))
        @if folder.has(VALIDATION) {
            (compared("Validation: segments that were not fitted", &Trajectories::read(folder, VALIDATION)?))
        }
    };
    Ok(document(
        "Identification",
        Some(&folder.name()),
        env!("CARGO_PKG_VERSION"),
        NOTE,
        &warnings,
        &content,
    ))
}

/// Header and rows of a CSV file with at least this number of columns. All rows have equal lengths.
///
/// # Errors
/// The file cannot be read, or has no header or fewer columns.
fn rows(folder: &Folder, name: &str, columns: usize) -> Result<(Vec<String>, Vec<Vec<String>>)> {
    let damaged = || {
        format!(
            "{} is damaged; restore the file, or repeat `physgrad identify`",
            folder.file(name).display()
        )
    };
    let bytes = folder.read(name)?;
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(&bytes[..]);
    let row = |record: csv::Result<csv::StringRecord>| -> Result<Vec<String>> {
        let record = record.with_context(damaged)?;
        if record.len() < columns {
            bail!(damaged());
        }
        Ok(record.iter().map(|cell| unguarded(cell).to_owned()).collect())
    };
    let mut rows = reader.records().map(row);
    Ok((rows.next().with_context(damaged)??, rows.collect::<Result<_>>()?))
}

/// A number with four significant digits; "unknown" if it is not finite. Text that is not a number
/// stays unchanged.
fn rounded(cell: &str) -> String {
    cell.parse::<f64>().map_or_else(
        |_| cell.to_owned(),
        |x| if x.is_finite() { short(x) } else { "unknown".into() },
    )
}

/// A finite number. A picture has no place for others.
fn finite(cell: &str) -> Option<f64> {
    cell.parse().ok().filter(|number: &f64| number.is_finite())
}

/// Measured and simulated value of a state component at one time.
#[derive(Clone, Copy)]
struct Sample {
    t: f64,
    measured: f64,
    simulated: f64,
}

impl Sample {
    fn residual(&self) -> f64 {
        self.simulated - self.measured
    }
}

/// Measured samples by segment and state component.
struct Trajectories {
    components: Vec<String>,
    /// Name of the segment, and samples of each component.
    segments: Vec<(String, Vec<Vec<Sample>>)>,
}

impl Trajectories {
    fn read(folder: &Folder, name: &str) -> Result<Self> {
        let (header, rows) = rows(folder, name, 2)?;
        let components: Vec<String> = header[2..]
            .iter()
            .step_by(2)
            .map(|name| name.trim_end_matches("_measured").to_owned())
            .collect();
        let mut segments: Vec<(String, Vec<Vec<Sample>>)> = Vec::new();
        for row in &rows {
            if segments.last().is_none_or(|(name, _)| *name != row[0]) {
                segments.push((row[0].clone(), vec![Vec::new(); components.len()]));
            }
            let Some((_, samples)) = segments.last_mut() else { continue };
            // An empty cell marks a missing measurement. A chart has no place for a number that is not
            // finite.
            for (samples, pair) in samples.iter_mut().zip(row[2..].chunks_exact(2)) {
                if let (Some(t), Some(measured), Some(simulated)) =
                    (finite(&row[1]), finite(&pair[0]), finite(&pair[1]))
                {
                    samples.push(Sample { t, measured, simulated });
                }
            }
        }
        Ok(Self { components, segments })
    }
}

fn rms(samples: &[Sample]) -> f64 {
    (samples.iter().map(|sample| sample.residual().powi(2)).sum::<f64>() / samples.len() as f64)
        .sqrt()
}

/// Charts of every measured component, and a table of the root mean square residuals of every
/// segment.
fn compared(title: &str, trajectories: &Trajectories) -> Markup {
    let Trajectories { components, segments } = trajectories;
    let measured: Vec<usize> = (0..components.len())
        .filter(|&i| segments.iter().any(|(_, all)| !all[i].is_empty()))
        .collect();
    let header: Vec<String> = ["segment"]
        .map(String::from)
        .into_iter()
        .chain(measured.iter().map(|&i| components[i].clone()))
        .collect();
    let row = |(name, all): &(String, Vec<Vec<Sample>>)| -> Vec<String> {
        let cells = measured
            .iter()
            .map(|&i| if all[i].is_empty() { String::new() } else { short(rms(&all[i])) });
        [name.clone()].into_iter().chain(cells).collect()
    };
    let rows: Vec<Vec<String>> = segments.iter().map(row).collect();
    section(
        title,
        html! {
            (figures(measured.iter().flat_map(|&i| [worst(&components[i], i, segments), over_time(&components[i], i, segments)])))
            h3 { "Root mean square residuals" }
            (table(&header, &rows))
        },
    )
}

/// Measured and simulated values in the segment with the largest root mean square residual.
fn worst(name: &str, component: usize, segments: &[(String, Vec<Vec<Sample>>)]) -> Figure {
    let size =
        |all: &[Vec<Sample>]| if all[component].is_empty() { 0.0 } else { rms(&all[component]) };
    let worst = segments.iter().max_by(|(_, a), (_, b)| size(a).total_cmp(&size(b)));
    let (segment, samples) =
        worst.map_or(("", &[][..]), |(name, all)| (&**name, &all[component][..]));
    let line = |value: fn(&Sample) -> f64| {
        samples.iter().map(|sample| (sample.t, value(sample))).collect()
    };
    let measured = Series::new("measured", "#0072B2", line(|sample| sample.measured));
    let simulated =
        Series::new("simulated", "#D55E00", line(|sample| sample.simulated)).dash(Dash::Dashed);
    Figure::new(
        format!("{name}, segment {segment}"),
        chart("state", vec![measured, simulated]),
        "Measured and simulated state in the segment with the largest residuals.",
    )
}

/// Largest, smallest and root mean square residual over all segments, against time.
fn over_time(name: &str, component: usize, segments: &[(String, Vec<Vec<Sample>>)]) -> Figure {
    let mut samples: Vec<Sample> =
        segments.iter().flat_map(|(_, all)| all[component].iter().copied()).collect();
    samples.sort_by(|a, b| a.t.total_cmp(&b.t));
    let instants = || samples.chunk_by(|a, b| a.t == b.t);
    let line = |value: fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
        let extreme =
            |all: &[Sample]| all.iter().map(Sample::residual).reduce(value).unwrap_or(0.0);
        instants().map(|all| (all[0].t, extreme(all))).collect()
    };
    let series = vec![
        Series::new("largest", "#D55E00", line(f64::max)),
        Series::new("smallest", "#0072B2", line(f64::min)),
        Series::new(
            "root mean square",
            "#009E73",
            instants().map(|all| (all[0].t, rms(all))).collect(),
        ),
    ];
    Figure::new(
        format!("Residuals of {name}"),
        chart("simulated - measured", series),
        "Largest, smallest and root mean square residual of all segments. Residuals that vary slowly show an error of the model.",
    )
}

fn chart(y_label: &'static str, series: Vec<Series>) -> Chart {
    let values = || series.iter().flat_map(|series| &series.line).map(|&(_, y)| y);
    let (low, high) = values()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
    let (low, high) =
        if low < high { (low, high) } else { (low.min(0.0) - 1.0, high.max(0.0) + 1.0) };
    let margin = 0.05 * (high - low);
    Chart::linear("time (s)", y_label, [low - margin, high + margin], series)
}
