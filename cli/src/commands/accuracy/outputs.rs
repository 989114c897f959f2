//! Output files of `physgrad accuracy`: CSV, charts and a table.

use crate::commands::accuracy::gradient_outputs::{percent, time};
use crate::commands::accuracy::row::{Errors, Row};
use crate::commands::accuracy::study::Measured;
use crate::platform::csv::csv;
use crate::platform::folder::Folder;
use crate::platform::table::Table;
use crate::platform::terminal::counted;
use anyhow::Result;
use physgrad::text::rough;
use physgrad_plot::{Dash, Series, Work, work_precision};

/// Okabe-Ito colours, grey and brown.
const COLORS: [&str; 10] = [
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
    "#888888", "#8B5A2B",
];

const HEADER: [&str; 19] = [
    "method",
    "substeps",
    "precision",
    "diverged",
    "trajectory_error",
    "loss_error",
    "r_error",
    "r_signs_right",
    "m_error",
    "m_signs_right",
    "drift",
    "operations",
    "bytes",
    "forward_us",
    "forward_us_lowest",
    "forward_us_highest",
    "gradient_us",
    "gradient_us_lowest",
    "gradient_us_highest",
];

/// Writes all files. Returns the contents of `accuracy.csv`.
pub fn write(
    folder: &Folder,
    name: &str,
    conserved: Option<&str>,
    Measured { rows, rounds, reference }: &Measured,
) -> Result<Vec<u8>> {
    let list = csv(HEADER, rows.iter().map(record))?;
    folder.write("accuracy.csv", &list)?;
    folder.write("accuracy.svg", diagrams(name, rows, *rounds).to_svg().as_bytes())?;
    folder.write("accuracy.md", markdown(name, reference, conserved, rows).as_bytes())?;
    Ok(list)
}

fn record(row: &Row) -> Vec<String> {
    let (setting, [forward, gradient]) = (&row.setting, row.seconds);
    let errors = match &row.errors {
        Ok(Errors { trajectory, loss, gradients: [r, m], signs: [r_signs, m_signs] }) => {
            [trajectory, loss, r, r_signs, m, m_signs].map(f64::to_string).to_vec()
        }
        Err(_) => vec![String::new(); 6],
    };
    let times = [forward[1], forward[0], forward[2], gradient[1], gradient[0], gradient[2]]
        .map(|s| (s * 1e6).to_string());
    let head =
        [setting.method.into(), setting.substeps.to_string(), setting.precision.name().into()];
    let diverged = row.errors.as_ref().err().cloned().unwrap_or_default();
    let drift = if row.drift.is_nan() { String::new() } else { row.drift.to_string() };
    let counts = [drift, row.operations.to_string(), row.bytes.to_string()];
    [&head[..], &[diverged], &errors, &counts, &times].concat()
}

/// Charts of errors against computing time and operations, with one line per method and precision.
fn diagrams(name: &str, rows: &[Row], rounds: usize) -> physgrad_plot::Drawing {
    let mut methods: Vec<&str> = rows.iter().map(|row| row.setting.method).collect();
    methods.dedup();
    // Points (work, error). A time has a spread from its lowest to its highest value.
    let series = |work: fn(&Row) -> [f64; 3], error: fn(&Errors) -> f64| {
        let of_method = |(i, method): (usize, &&'static str)| {
            ["f32", "f64"].map(|precision| {
                let selected = rows.iter().filter(|row| {
                    row.setting.method == *method && row.setting.precision.name() == precision
                });
                let points =
                    selected.filter_map(|row| Some((work(row), error(row.errors.as_ref().ok()?))));
                let (line, spread) = points
                    .map(|([low, median, high], error)| ((median, error), (low, high)))
                    .unzip();
                let dash = if precision == "f32" { Dash::Dashed } else { Dash::Solid };
                Series { spread, ..Series::new(*method, COLORS[i % COLORS.len()], line).dash(dash) }
            })
        };
        methods.iter().enumerate().flat_map(of_method).collect::<Vec<Series>>()
    };
    work_precision(
        &format!(
            "{name}: error by cost; times are median and range of {}",
            counted(rounds, "round")
        ),
        &[("f32", Dash::Dashed), ("f64", Dash::Solid)],
        vec![
            Work {
                x_label: "forward, µs per step",
                y_label: "error of the trajectory",
                series: series(|row| row.seconds[0].map(|s| s * 1e6), |errors| errors.trajectory),
            },
            Work {
                x_label: "operations, step and VJP",
                y_label: "error of the trajectory",
                series: series(|row| [row.operations as f64; 3], |errors| errors.trajectory),
            },
            Work {
                x_label: "with gradients, µs per step",
                y_label: "error of the gradient of R",
                series: series(|row| row.seconds[1].map(|s| s * 1e6), |errors| errors.gradients[0]),
            },
        ],
    )
}

const COLUMNS: [&str; 7] = ["setting", "trajectory", "loss", "R", "signs of R", "M", "signs of M"];
const COSTS: [&str; 3] = ["operations", "forward, µs", "with gradients, µs"];

fn table(conserved: Option<&str>, rows: &mut dyn Iterator<Item = &Row>) -> Table {
    let drift = conserved.map(|name| format!("drift of the {name}"));
    let header: Vec<String> =
        COLUMNS.map(String::from).into_iter().chain(drift).chain(COSTS.map(String::from)).collect();
    let most_important =
        ["R", "with gradients, µs", "loss", "signs of R", "operations", "M", "signs of M"];
    let mut table = Table::new(header).optional(&most_important);
    let error = |error: f64| if error.is_nan() { "-".to_owned() } else { rough(error) };
    for row in rows {
        let mut cells = vec![row.setting.name()];
        match &row.errors {
            Ok(Errors { trajectory, loss, gradients: [r, m], signs: [r_signs, m_signs] }) => {
                let share = |share: f64| percent(Some(share));
                cells.extend([
                    error(*trajectory),
                    error(*loss),
                    error(*r),
                    share(*r_signs),
                    error(*m),
                    share(*m_signs),
                ]);
            }
            Err(_) => cells.extend(["diverged"; 6].map(String::from)),
        }
        cells.extend(conserved.map(|_| error(row.drift)));
        cells.extend([
            row.operations.to_string(),
            time(row.seconds[0], 1e6),
            time(row.seconds[1], 1e6),
        ]);
        table.row(cells);
    }
    table
}

/// Sentence with the smallest error of the trajectory in each precision.
fn floors(rows: &[Row]) -> String {
    let of = |precision: &str| {
        let errors = rows.iter().filter(|row| row.setting.precision.name() == precision);
        let least = errors
            .filter_map(|row| Some((row, row.errors.as_ref().ok()?.trajectory)))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        least.map(|(row, error)| {
            format!(
                "{} in {precision} ({} x{})",
                rough(error),
                row.setting.method,
                row.setting.substeps
            )
        })
    };
    let found: Vec<String> = ["f32", "f64"].into_iter().filter_map(of).collect();
    match &found[..] {
        [] => "All settings diverge.".to_owned(),
        found => format!("The smallest errors of the trajectory are {}.", found.join(" and ")),
    }
}

fn about(rows: &[Row], check: &Errors) -> String {
    floors(rows)
        + " "
        + &format!(
            "The reference differs from one with half as many steps by {} in the trajectory, {} in the gradient of R and \
         {} in the gradient of M. Smaller errors are below its resolution.",
            rough(check.trajectory),
            rough(check.gradients[0]),
            rough(check.gradients[1])
        )
}

fn markdown(name: &str, check: &Errors, conserved: Option<&str>, rows: &[Row]) -> String {
    format!(
        "# Accuracy and cost: {name}\n\nErrors are relative to the reference. Operations are those of one step of the \
         system and of its VJP, without the policy. Times are microseconds per step and sample, with half the spread of the \
         rounds. {}\n\n![error by cost](accuracy.svg)\n\n{}\n",
        about(rows, check),
        table(conserved, &mut rows.iter()).markdown()
    )
}

/// Table of the Pareto-optimal settings in forward time and trajectory error. A setting whose error
/// is as large as the states is none of them. Below the table: the smallest errors, the resolution of
/// the reference, and the numbers of useless and of diverged settings, if any.
pub fn summary(rows: &[Row], check: &Errors, conserved: Option<&str>) -> String {
    let error = |row: &Row| row.errors.as_ref().ok().map(|errors| errors.trajectory);
    let is_useful = |error: &f64| *error < 1.0;
    let point = |row: &Row| Some((row.seconds[0][1], error(row).filter(is_useful)?));
    let dominates = |a: (f64, f64), b: (f64, f64)| a.0 <= b.0 && a.1 <= b.1 && a != b;
    let best = |row: &&Row| {
        point(row)
            .is_some_and(|own| !rows.iter().filter_map(point).any(|other| dominates(other, own)))
    };
    let mut front: Vec<&Row> = rows.iter().filter(best).collect();
    front.sort_by(|a, b| a.seconds[0][1].total_cmp(&b.seconds[0][1]));
    let diverged = rows.iter().filter(|row| row.errors.is_err()).count();
    let mut text = format!(
        "Pareto-optimal settings in time and trajectory error, out of {}; errors are relative to the reference:\n{}\n{}",
        rows.len(),
        table(conserved, &mut front.into_iter()),
        about(rows, check)
    );
    let useless = rows.iter().filter_map(error).filter(|error| !is_useful(error)).count();
    if useless > 0 {
        text += &format!(
            "\n{} with an error of the trajectory of 1 or more, as large as the states",
            counted(useless, "setting")
        );
    }
    if diverged > 0 {
        text += &format!("\n{} diverged", counted(diverged, "setting"));
    }
    text
}
