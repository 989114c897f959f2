//! Output files of `physgrad accuracy --gradients`: CSV, charts and tables.

use crate::program::commands::accuracy::derivatives::{Checkpoint, Derivative, Horizon};
use crate::program::commands::accuracy::outputs::right_aligned;
use crate::program::operations::gradients::GradientMethod;
use crate::program::platform::folder::Folder;
use crate::program::settings::Precision;
use anyhow::Result;
use comfy_table::presets::{ASCII_MARKDOWN, UTF8_FULL_CONDENSED};
use comfy_table::{Table, TableStyle};
use physgrad::report::{Series, Work, work_precision};

fn small(x: f64) -> String {
    if x.is_nan() { "-".into() } else { format!("{x:.1e}") }
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share))
}

fn time([low, median, high]: [f64; 3]) -> String {
    if median.is_nan() { "-".into() } else { format!("{:.3} ms ±{:.0} %", median * 1e3, 50.0 * (high - low) / median) }
}

fn megabytes(bytes: usize) -> String {
    format!("{:.3} MB", bytes as f64 * 1e-6)
}

fn table(style: TableStyle, header: &[&str], rows: Vec<Vec<String>>) -> Table {
    let mut table = Table::new();
    table.load_style(style).set_header(header).add_rows(rows);
    right_aligned(table)
}

const WAYS: [&str; 8] =
    ["way", "f32: error", "signs as in f64", "whole gradient", "memory", "f64: error", "whole gradient", "memory"];
const KEPT: [&str; 4] = ["budget", "peak memory", "time", "bits"];
const ALONG: [&str; 6] = ["horizon", "length of R", "f32: error", "signs right", "f64: error", "signs right"];

fn tables(style: TableStyle, ways: &[Derivative], kept: &[Checkpoint], along: &[Horizon]) -> [Table; 3] {
    let error = |row: &Derivative| match (&row.error, row.way) {
        (_, GradientMethod::Forward) => "-".into(),
        (Ok(error), _) => small(*error),
        (Err(_), _) => "diverged".into(),
    };
    let one = |found: Option<&Derivative>| {
        found.map_or_else(
            || ["-"; 4].map(String::from),
            |row| [error(row), percent(row.signs), time(row.seconds), megabytes(row.bytes)],
        )
    };
    let mut names: Vec<GradientMethod> = ways.iter().map(|row| row.way).collect();
    names.dedup();
    let way = |way: &GradientMethod| {
        let of = |precision| one(ways.iter().find(|row| row.way == *way && row.precision == precision));
        let ([single, signs, single_time, single_bytes], [double, _, double_time, double_bytes]) =
            (of(Precision::F32), of(Precision::F64));
        vec![way.to_string(), single, signs, single_time, single_bytes, double, double_time, double_bytes]
    };
    // A divergence without a budget also occurs with one.
    let diverged = kept.first().is_some_and(|row| row.same.is_err());
    let checkpoint = |row: &Checkpoint| {
        let same = match &row.same {
            Ok(true) => "the same".to_owned(),
            Ok(false) => "others".to_owned(),
            Err(_) if diverged => "diverged".into(),
            Err(_) => "too little memory".into(),
        };
        vec![megabytes(row.budget as usize), megabytes(row.bytes), time(row.seconds), same]
    };
    let horizon = |row: &Horizon| {
        let cells = |found: &Result<(f64, f64), String>| match found {
            Ok((error, signs)) => [small(*error), percent(Some(*signs))],
            Err(_) => ["not finite".into(), "-".into()],
        };
        let head = [row.horizon.to_string(), small(row.length)];
        head.into_iter().chain(row.found.iter().flat_map(cells)).collect()
    };
    [
        table(style, &WAYS, names.iter().map(way).collect()),
        table(style, &KEPT, kept.iter().map(checkpoint).collect()),
        table(style, &ALONG, along.iter().map(horizon).collect()),
    ]
}

/// Sentence with the last horizon up to which at least 99 % of the signs are correct.
fn trusted(along: &[Horizon], which: usize) -> String {
    let right = |row: &&Horizon| row.found[which].as_ref().is_ok_and(|(_, signs)| *signs >= 0.99);
    let precision = ["f32", "f64"][which];
    match along.iter().take_while(right).last() {
        Some(row) if row.horizon == along.last().map_or(0, |row| row.horizon) => {
            format!("99 % of the signs of R are right in {precision} up to {} steps, the longest tried", row.horizon)
        }
        Some(row) => {
            format!("99 % of the signs of R are right in {precision} up to {} steps, and not at the next horizon", row.horizon)
        }
        None => format!("fewer than 99 % of the signs of R are right in {precision} at the first horizon"),
    }
}

/// Writes all files and returns the text for the terminal.
pub fn write(folder: &Folder, name: &str, ways: &[Derivative], kept: &[Checkpoint], along: &[Horizon]) -> Result<String> {
    folder.write("gradients.csv", ways_csv(ways)?)?;
    folder.write("checkpoints.csv", kept_csv(kept)?)?;
    folder.write("horizons.csv", along_csv(along)?)?;
    folder.write("gradients.svg", diagrams(name, ways, along).to_svg().as_bytes())?;
    let horizon = kept.first().map_or(0, |row| row.horizon);
    let text = |[ways, kept, along_table]: [Table; 3]| {
        format!(
            "Errors at eight parameters, in relation to double-double; the time of a whole gradient, on one thread:\n\n{ways}\n\nThe \
             reverse pass of R through {horizon} steps, with checkpoints:\n\n{kept}\n\nR against the horizon: f32 in relation to f64, and \
             f64 to itself from starts that differ by a rounding:\n\n{along_table}\n\n{}.\n{}.",
            trusted(along, 0),
            trusted(along, 1)
        )
    };
    let markdown = text(tables(ASCII_MARKDOWN, ways, kept, along));
    folder
        .write("gradients.md", format!("# What gradients cost: {name}\n\n![errors](gradients.svg)\n\n{markdown}\n").as_bytes())?;
    Ok(text(tables(UTF8_FULL_CONDENSED, ways, kept, along)))
}

fn csv(header: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(header)?;
    for row in rows {
        csv.write_record(row)?;
    }
    Ok(csv.into_inner()?)
}

fn milliseconds([low, median, high]: [f64; 3]) -> [String; 3] {
    [median, low, high].map(|s| (s * 1e3).to_string())
}

fn optional(x: Option<f64>) -> String {
    x.map_or_else(String::new, |x| x.to_string())
}

fn ways_csv(ways: &[Derivative]) -> Result<Vec<u8>> {
    let header =
        ["way", "step", "precision", "diverged", "error", "signs_as_in_f64", "ms", "ms_lowest", "ms_highest", "peak_bytes"];
    let row = |row: &Derivative| {
        let (name, step) = match row.way {
            GradientMethod::Central(step) => ("central differences".to_owned(), step.to_string()),
            way => (way.to_string(), String::new()),
        };
        let error = if row.way == GradientMethod::Forward { None } else { row.error.as_ref().ok().copied() };
        let head = [name, step, row.precision.name().into(), row.error.as_ref().err().cloned().unwrap_or_default()];
        let tail = [optional(error), optional(row.signs)].into_iter().chain(milliseconds(row.seconds));
        head.into_iter().chain(tail).chain([row.bytes.to_string()]).collect()
    };
    csv(&header, ways.iter().map(row))
}

fn kept_csv(kept: &[Checkpoint]) -> Result<Vec<u8>> {
    let row = |row: &Checkpoint| {
        let same = row.same.as_ref().map_or_else(String::clone, |same| same.to_string());
        let head = [row.horizon.to_string(), row.budget.to_string(), row.bytes.to_string()];
        head.into_iter().chain(milliseconds(row.seconds)).chain([same]).collect()
    };
    csv(&["horizon", "budget_bytes", "peak_bytes", "ms", "ms_lowest", "ms_highest", "same_bits"], kept.iter().map(row))
}

fn along_csv(along: &[Horizon]) -> Result<Vec<u8>> {
    let row = |row: &Horizon| {
        let cells = |found: &Result<(f64, f64), String>| match found {
            Ok((error, signs)) => [error.to_string(), signs.to_string()],
            Err(error) => [error.clone(), String::new()],
        };
        let head = [row.horizon.to_string(), row.length.to_string()];
        head.into_iter().chain(row.found.iter().flat_map(cells)).collect()
    };
    csv(&["horizon", "r_length", "f32_error", "f32_signs_right", "f64_error", "f64_signs_right"], along.iter().map(row))
}

fn diagrams(name: &str, ways: &[Derivative], along: &[Horizon]) -> physgrad::report::Drawing {
    let colors = [("f32", "#D55E00"), ("f64", "#0072B2")];
    let of = |precision: &'static str| ways.iter().filter(move |row| row.precision.name() == precision);
    let steps = colors.iter().flat_map(|&(precision, color)| {
        let central = of(precision).filter_map(|row| match row.way {
            GradientMethod::Central(step) => Some((step, row.error.clone().ok()?)),
            _ => None,
        });
        let mut central: Vec<(f64, f64)> = central.collect();
        central.reverse();
        let exact = of(precision).find(|row| matches!(row.way, GradientMethod::Reverse { field, .. } if field.letter() == "R"));
        let error = exact.and_then(|row| row.error.clone().ok()).unwrap_or(f64::NAN);
        let line = central.iter().map(|&(step, _)| (step, error)).collect();
        [
            Series::new(format!("differences, {precision}"), color, central),
            Series::new(format!("reverse, {precision}"), color, line).dashed(),
        ]
    });
    let horizons = |read: fn(&(f64, f64)) -> f64| {
        let line = move |which: usize| {
            along.iter().filter_map(move |row| Some((row.horizon as f64, read(row.found[which].as_ref().ok()?)))).collect()
        };
        colors.iter().enumerate().map(move |(which, &(precision, color))| Series::new(precision, color, line(which))).collect()
    };
    work_precision(
        &format!("{name}: errors of the gradient of R"),
        vec![
            Work { x_label: "step of the differences", y_label: "error of the gradient of R", series: steps.collect() },
            Work { x_label: "horizon, steps", y_label: "error of the gradient of R", series: horizons(|found| found.0) },
            Work { x_label: "horizon, steps", y_label: "share of wrong signs of R", series: horizons(|found| 1.0 - found.1) },
        ],
    )
}
