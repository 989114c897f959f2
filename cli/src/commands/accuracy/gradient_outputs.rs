//! Output files of `physgrad accuracy --gradients`: CSV, charts and tables.

use crate::commands::accuracy::derivatives::{Checkpoint, Derivative, Horizon};
use crate::operations::gradients::GradientMethod;
use crate::platform::csv::csv;
use crate::platform::folder::Folder;
use crate::platform::json::rows;
use crate::platform::table::Table;
use crate::settings::Precision;
use anyhow::Result;
use physgrad::text::rough;
use physgrad_plot::{Dash, Series, Work, work_precision};
use serde_json::{Value, json};

fn small(x: f64) -> String {
    if x.is_nan() { "-".into() } else { rough(x) }
}

pub fn percent(share: Option<f64>) -> String {
    share
        .filter(|share| !share.is_nan())
        .map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share))
}

/// A median time in s, in a unit of which a second has `units`, with half the spread in percent.
pub fn time([low, median, high]: [f64; 3], units: f64) -> String {
    match (high - low) / median {
        spread if spread.is_nan() => "-".into(),
        spread => format!("{:.3} ±{:.0} %", median * units, 50.0 * spread),
    }
}

fn megabytes(bytes: usize) -> String {
    format!("{:.3}", bytes as f64 * 1e-6)
}

fn table(header: &[&str], optional: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Table {
    let mut table = Table::new(header.iter().copied()).optional(optional);
    rows.for_each(|row| table.row(row));
    table
}

const METHODS: [&str; 8] =
    ["method", "f32 error", "f32 signs", "f32 ms", "f32 MB", "f64 error", "f64 ms", "f64 MB"];
const CHECKPOINTS: [&str; 4] = ["budget, MB", "peak memory, MB", "time, ms", "bits"];
const HORIZONS: [&str; 6] =
    ["horizon", "norm of R", "f32 error", "f32 signs", "f64 error", "f64 signs"];

fn tables(methods: &[Derivative], checkpoints: &[Checkpoint], along: &[Horizon]) -> [Table; 3] {
    let error = |row: &Derivative| match (&row.error, row.method) {
        (_, GradientMethod::Forward) => "-".into(),
        (Ok(error), _) => small(*error),
        (Err(_), _) => "diverged".into(),
    };
    let one = |found: Option<&Derivative>| {
        found.map_or_else(
            || ["-"; 4].map(String::from),
            |row| [error(row), percent(row.signs), time(row.seconds, 1e3), megabytes(row.bytes)],
        )
    };
    let mut names: Vec<GradientMethod> = methods.iter().map(|row| row.method).collect();
    names.dedup();
    let cells = |method: &GradientMethod| {
        let of = |precision| {
            one(methods.iter().find(|row| row.method == *method && row.precision == precision))
        };
        let ([single, signs, single_time, single_bytes], [double, _, double_time, double_bytes]) =
            (of(Precision::F32), of(Precision::F64));
        vec![
            method.to_string(),
            single,
            signs,
            single_time,
            single_bytes,
            double,
            double_time,
            double_bytes,
        ]
    };
    // A rollout that diverges without a budget also diverges with one.
    let diverged = checkpoints.first().is_some_and(|row| row.same.is_err());
    let checkpoint = |row: &Checkpoint| {
        let same = match &row.same {
            Ok(true) => "equal".to_owned(),
            Ok(false) => "different".to_owned(),
            Err(_) if diverged => "diverged".into(),
            Err(_) => "budget too small".into(),
        };
        vec![megabytes(row.budget as usize), megabytes(row.bytes), time(row.seconds, 1e3), same]
    };
    let horizon = |row: &Horizon| {
        let cells = |found: &Result<(f64, f64), String>| match found {
            Ok((error, signs)) => [small(*error), percent(Some(*signs))],
            Err(_) => ["non-finite".into(), "-".into()],
        };
        let head = [row.horizon.to_string(), small(row.norm)];
        head.into_iter().chain(row.found.iter().flat_map(cells)).collect()
    };
    [
        table(
            &METHODS,
            &["f32 error", "f32 ms", "f64 error", "f64 ms", "f32 MB", "f64 MB", "f32 signs"],
            names.iter().map(cells),
        ),
        table(&CHECKPOINTS, &[], checkpoints.iter().map(checkpoint)),
        table(&HORIZONS, &[], along.iter().map(horizon)),
    ]
}

/// Sentence with the last horizon up to which at least 99 % of the signs are correct. `which` is 0
/// for f32, and 1 for f64 from perturbed initial states.
fn trusted(along: &[Horizon], which: usize) -> String {
    let right = |row: &&Horizon| row.found[which].as_ref().is_ok_and(|(_, signs)| *signs >= 0.99);
    let precision = ["f32", "f64"][which];
    match along.iter().take_while(right).last() {
        Some(row) if row.horizon == along.last().map_or(0, |row| row.horizon) => {
            format!(
                "99 % of the signs of R are correct in {precision} up to {} steps, the longest horizon measured",
                row.horizon
            )
        }
        Some(row) => {
            format!(
                "99 % of the signs of R are correct in {precision} up to {} steps, but not at the next horizon",
                row.horizon
            )
        }
        None => format!(
            "fewer than 99 % of the signs of R are correct in {precision} at the first horizon"
        ),
    }
}

/// Writes all files. Returns the text for the terminal, and the object of `--json`.
pub fn write(
    folder: &Folder,
    name: &str,
    methods: &[Derivative],
    checkpoints: &[Checkpoint],
    along: &[Horizon],
) -> Result<(String, Value)> {
    let lists = [methods_csv(methods)?, checkpoints_csv(checkpoints)?, horizons_csv(along)?];
    for (file, list) in ["gradients.csv", "checkpoints.csv", "horizons.csv"].into_iter().zip(&lists)
    {
        folder.write(file, list)?;
    }
    let [methods_list, checkpoints_list, horizons_list] = lists.map(|list| rows(&list));
    let object = json!({
        "folder": folder.path(), "methods": methods_list?, "checkpoints": checkpoints_list?, "horizons": horizons_list?,
    });
    folder.write("gradients.svg", diagrams(name, methods, along).to_svg().as_bytes())?;
    let horizon = checkpoints.first().map_or(0, |row| row.horizon);
    let text = |[methods, checkpoints, horizons]: [String; 3]| {
        format!(
            "Errors at eight parameters, relative to double-double. Signs: those equal to f64. Times of the whole gradient on one \
             thread.\n\n{methods}\n\n\
             Reverse pass of R through {horizon} steps, with checkpoints:\n\n{checkpoints}\n\nError of R by horizon, \
             relative to f64, and correct signs: in f32, and in f64 from initial states perturbed by one rounding:\n\n{horizons}\n\n{}.\n{}.",
            trusted(along, 0),
            trusted(along, 1)
        )
    };
    let tables = tables(methods, checkpoints, along);
    let markdown = text(tables.each_ref().map(Table::markdown));
    folder.write(
        "gradients.md",
        format!("# Costs of gradients: {name}\n\n![errors](gradients.svg)\n\n{markdown}\n")
            .as_bytes(),
    )?;
    Ok((text(tables.map(|table| table.to_string())), object))
}

fn milliseconds([low, median, high]: [f64; 3]) -> [String; 3] {
    [median, low, high].map(|s| (s * 1e3).to_string())
}

fn optional(x: Option<f64>) -> String {
    x.map_or_else(String::new, |x| x.to_string())
}

fn methods_csv(methods: &[Derivative]) -> Result<Vec<u8>> {
    let header = [
        "method",
        "step",
        "precision",
        "diverged",
        "error",
        "signs_as_in_f64",
        "ms",
        "ms_lowest",
        "ms_highest",
        "peak_bytes",
    ];
    let row = |row: &Derivative| {
        let (name, step) = match row.method {
            GradientMethod::Central(step) => ("central differences".to_owned(), step.to_string()),
            method => (method.to_string(), String::new()),
        };
        let error = if row.method == GradientMethod::Forward {
            None
        } else {
            row.error.as_ref().ok().copied()
        };
        let head = [
            name,
            step,
            row.precision.name().into(),
            row.error.as_ref().err().cloned().unwrap_or_default(),
        ];
        let tail =
            [optional(error), optional(row.signs)].into_iter().chain(milliseconds(row.seconds));
        head.into_iter().chain(tail).chain([row.bytes.to_string()])
    };
    csv(header, methods.iter().map(row))
}

fn checkpoints_csv(checkpoints: &[Checkpoint]) -> Result<Vec<u8>> {
    let row = |row: &Checkpoint| {
        let same = row.same.as_ref().map_or_else(String::clone, |same| same.to_string());
        let head = [row.horizon.to_string(), row.budget.to_string(), row.bytes.to_string()];
        head.into_iter().chain(milliseconds(row.seconds)).chain([same])
    };
    csv(
        ["horizon", "budget_bytes", "peak_bytes", "ms", "ms_lowest", "ms_highest", "same_bits"],
        checkpoints.iter().map(row),
    )
}

fn horizons_csv(along: &[Horizon]) -> Result<Vec<u8>> {
    let row = |row: &Horizon| {
        let cells = |found: &Result<(f64, f64), String>| match found {
            Ok((error, signs)) => [error.to_string(), signs.to_string()],
            Err(error) => [error.clone(), String::new()],
        };
        let head = [row.horizon.to_string(), row.norm.to_string()];
        head.into_iter().chain(row.found.iter().flat_map(cells)).collect::<Vec<_>>()
    };
    csv(
        ["horizon", "r_norm", "f32_error", "f32_signs_right", "f64_error", "f64_signs_right"],
        along.iter().map(row),
    )
}

fn diagrams(name: &str, methods: &[Derivative], along: &[Horizon]) -> physgrad_plot::Drawing {
    let colors = [("f32", "#D55E00"), ("f64", "#0072B2")];
    let of = |precision: &'static str| {
        methods.iter().filter(move |row| row.precision.name() == precision)
    };
    let steps = colors.iter().flat_map(|&(precision, color)| {
        let central = of(precision).filter_map(|row| match row.method {
            GradientMethod::Central(step) => Some((step, row.error.clone().ok()?)),
            _ => None,
        });
        let mut central: Vec<(f64, f64)> = central.collect();
        central.reverse();
        let exact =
            of(precision).find(|row| matches!(row.method, GradientMethod::Reverse { field, .. } if field.letter() == "R"));
        let error = exact.and_then(|row| row.error.clone().ok()).unwrap_or(f64::NAN);
        let line = central.iter().map(|&(step, _)| (step, error)).collect();
        [
            Series::new(format!("differences, {precision}"), color, central),
            Series::new(format!("reverse, {precision}"), color, line).dash(Dash::Dashed),
        ]
    });
    let horizons = |read: fn(&(f64, f64)) -> f64| {
        let line = move |which: usize| {
            along
                .iter()
                .filter_map(move |row| {
                    Some((row.horizon as f64, read(row.found[which].as_ref().ok()?)))
                })
                .collect()
        };
        colors
            .iter()
            .enumerate()
            .map(move |(which, &(precision, color))| Series::new(precision, color, line(which)))
            .collect()
    };
    work_precision(
        &format!("{name}: errors of the gradient of R"),
        &[],
        vec![
            Work {
                x_label: "step of the differences",
                y_label: "error of the gradient of R",
                series: steps.collect(),
            },
            Work {
                x_label: "horizon, steps",
                y_label: "error of the gradient of R",
                series: horizons(|found| found.0),
            },
            Work {
                x_label: "horizon, steps",
                y_label: "share of wrong signs of R",
                series: horizons(|found| 1.0 - found.1),
            },
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_without_a_value_have_a_dash() {
        assert_eq!([None, Some(f64::NAN), Some(0.5)].map(percent), ["-", "-", "50.0 %"]);
        let times = [[0.0; 3], [f64::NAN; 3], [1e-3, 2e-3, 3e-3]];
        assert_eq!(times.map(|seconds| time(seconds, 1e3)), ["-", "-", "2.000 ±50 %"]);
    }
}
