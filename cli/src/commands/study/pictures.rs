//! Pictures of the results of a plan.

use super::results::{Group, Results};
use crate::platform::folder::Folder;
use crate::platform::terminal::counted;
use crate::runs::statistics::{
    InScene, MAX_DASHED, Method, Outcome, curves, curves_of_scenes, trailing_mean,
};
use crate::scenes::grid::{last_part, number, text};
use crate::scenes::plan::{self, FigureLayout, TASK};
use anyhow::Result;
use physgrad::train::Record;
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{
    Abscissa, Case, Curve, Drawing, Series, TaskLosses, comparison, final_losses, settings, study,
};
use toml::Value;

/// Largest number of cases in `curves.svg`.
pub const MAX_CURVES: usize = 8;

/// Largest number of cases in `losses.svg`.
const MAX_LOSSES: usize = 32;

/// Largest number of panels in a row, if every case has a panel.
const COLUMNS: usize = 4;

/// Writes the pictures. Returns their names.
pub fn write(results: &Results, folder: &Folder) -> Result<Vec<&'static str>> {
    let contents = &results.plan.contents;
    let title = format!("{}, {}", results.plan.title(), counted(contents.seeds as usize, "seed"));
    let scenes = results.scenes();
    let mut files = Vec::new();
    let mut write = |name: &'static str, drawing: &Drawing| {
        files.push(name);
        folder.write(name, drawing.to_svg())
    };
    if let Some(layout) = &contents.figure {
        let drawing = figure(&title, layout, results, &scenes);
        write("figure.svg", &drawing)?;
        folder.write("figure.png", drawing.to_png())?;
    } else if scenes.len() <= MAX_CURVES {
        write("curves.svg", &learning_curves(&title, results, &scenes))?;
    }
    if scenes.len() <= MAX_LOSSES {
        write("losses.svg", &losses(&title, results))?;
    }
    if let Some(drawing) = over_settings(&title, results) {
        write("settings.svg", &drawing)?;
    }
    Ok(files)
}

/// Test losses of all cases, against epochs and against time. Up to three cases share the panels
/// and differ in dashes. With more cases, each case has panels of its own. All these panels share
/// the range of their y axes if the plan has one task.
fn learning_curves(title: &str, results: &Results, scenes: &[InScene]) -> Drawing {
    if scenes.len() <= MAX_DASHED {
        return comparison(title, &curves_of_scenes(scenes, |r| r.test_loss));
    }
    let one_task = results.plan.has_one_task();
    let columns = scenes.len().div_ceil(scenes.len().div_ceil(COLUMNS));
    let row = |x: Abscissa, first: usize, scenes: &[InScene]| -> Vec<Case> {
        // Fills the last row with empty cases, which have no panel.
        let case = |i: usize| {
            let scene = scenes.get(i);
            let title = scene.map(|scene| scene.name).filter(|_| x == Abscissa::Epoch);
            Case {
                title: title.unwrap_or_default().to_owned(),
                y_label: "test loss".into(),
                y_axis: if one_task { 0 } else { first + i },
                x,
                curves: scene.map(|scene| curves(&scene.runs, |r| r.test_loss)).unwrap_or_default(),
            }
        };
        (0..columns).map(case).collect()
    };
    let rows = scenes.chunks(columns).enumerate().flat_map(|(i, scenes)| {
        [Abscissa::Epoch, Abscissa::Seconds].map(|x| row(x, i * columns, scenes))
    });
    study(title, &rows.collect::<Vec<_>>())
}

/// The picture that a plan lays out.
fn figure(title: &str, layout: &FigureLayout, results: &Results, scenes: &[InScene]) -> Drawing {
    let columns = axis(results, layout.columns.as_deref());
    let mut rows = Vec::new();
    for (i, row) in axis(results, layout.rows.as_deref()).iter().enumerate() {
        // Puts titles above the first row only.
        let titled = |text: String| if i == 0 { text } else { String::new() };
        let of_row = match (row, layout.rows.as_deref().map(last_part)) {
            (Some(value), Some(key)) => format!(" ({key}: {})", text(value)),
            _ => String::new(),
        };
        let (mut losses, mut sizes) = (Vec::new(), Vec::new());
        for (j, column) in columns.iter().enumerate() {
            let is_here = |case: &&plan::Case| {
                is_at(results, case, layout.rows.as_deref(), row)
                    && is_at(results, case, layout.columns.as_deref(), column)
            };
            let runs = results.cases.iter().position(|case| is_here(&case));
            let runs = runs.map_or(&[][..], |case| &scenes[case].runs);
            let case = |title: String, y_label: String, y_axis, value| Case {
                title: titled(title),
                y_label,
                y_axis,
                x: Abscissa::Epoch,
                curves: smooth(runs, layout.mean, value),
            };
            let title = panel_title(layout, column);
            // Shares the loss axis within a column. Losses of different columns differ by orders of
            // magnitude.
            losses.push(case(title.clone(), format!("test loss{of_row}"), j, |r| r.test_loss));
            if column.is_some() && *column == layout.update_size {
                let title = format!("{title}: update size");
                let axis = columns.len();
                sizes.push(case(title, "norm of the field".into(), axis, |r| r.grad_norm.get()));
            }
        }
        losses.extend(sizes);
        rows.push(losses);
    }
    let smoothed = match layout.mean {
        1 => String::new(),
        epochs => format!(", means of {epochs} epochs"),
    };
    study(&format!("{title}{smoothed}"), &rows)
}

/// Values along an axis of the figure: names of tasks, or values of a setting. A single None if no
/// key varies along the axis.
fn axis(results: &Results, key: Option<&str>) -> Vec<Option<Value>> {
    let tasks = results.plan.contents.tasks.iter();
    match key {
        None => vec![None],
        Some(TASK) => tasks.map(|task| task.name.clone().map(Value::String)).collect(),
        Some(key) => {
            let values = results.plan.contents.grid[key].as_array().into_iter().flatten();
            values.cloned().map(Some).collect()
        }
    }
}

/// Whether a case has this value along the [`axis`] of a key.
fn is_at(results: &Results, case: &plan::Case, key: Option<&str>, value: &Option<Value>) -> bool {
    match key {
        None => true,
        Some(TASK) => {
            let name = results.plan.contents.tasks[case.task].name.as_deref();
            name == value.as_ref().and_then(Value::as_str)
        }
        Some(key) => case.point.get(key) == value.as_ref(),
    }
}

/// Title of the panels in the column with this value. Empty without a value.
fn panel_title(layout: &FigureLayout, value: &Option<Value>) -> String {
    let Some(value) = value else { return String::new() };
    let shown = number(value).map_or_else(|| text(value), |number| number.to_string());
    let key = layout.columns.as_deref().map_or("", last_part);
    let whole = if key == TASK { "{}".to_owned() } else { format!("{key}: {{}}") };
    layout.panel.as_ref().unwrap_or(&whole).replace("{}", &shown)
}

/// One curve per method, with trailing means over this number of epochs.
fn smooth(runs: &[Outcome], epochs: usize, value: fn(&Record) -> f64) -> Vec<Curve> {
    let mut curves = curves(runs, value);
    for points in curves.iter_mut().flat_map(|curve| &mut curve.runs) {
        let values: Vec<f64> = points.iter().map(|point| point.value).collect();
        for (point, mean) in points.iter_mut().zip(trailing_mean(&values, epochs)) {
            point.value = mean;
        }
    }
    curves
}

/// Final test losses: one panel per case, one dot per seed.
fn losses(title: &str, results: &Results) -> Drawing {
    let best: Vec<&Group> = results.best().collect();
    let panel = |groups: &[&Group]| {
        let runs = groups.iter().flat_map(|group| &group.runs);
        let losses =
            |group: &&Group| (group.method.label(), group.runs.iter().map(Outcome::loss).collect());
        TaskLosses {
            task: results.cases[groups[0].case].name.clone(),
            methods: groups.iter().map(losses).collect(),
            untrained: quantile(&sorted(runs.map(|run| run.untrained)), 0.5),
        }
    };
    final_losses(title, best.chunk_by(|a, b| a.case == b.case).map(panel).collect())
}

/// Medians and quartiles of the final test loss against each setting of the grid with at least two
/// numbers, over the seeds and the other settings. One panel per setting, one line per method. None
/// without such a setting, and for scenes of several tasks.
fn over_settings(title: &str, results: &Results) -> Option<Drawing> {
    if !results.plan.has_one_task() {
        return None;
    }
    let mut methods: Vec<Method> = Vec::new();
    for group in results.best() {
        if !methods.contains(&group.method) {
            methods.push(group.method);
        }
    }
    let at = |group: &Group, key: &str| results.cases[group.case].point.get(key).and_then(number);
    let panel = |key: &str| {
        let mut values: Vec<f64> = results.best().filter_map(|group| at(group, key)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        let losses = |method: Method, value: f64| {
            let is_there = |group: &&Group| group.method == method && at(group, key) == Some(value);
            let groups = results.best().filter(is_there);
            sorted(groups.flat_map(|group| group.runs.iter().map(Outcome::loss)))
        };
        let series = |&method: &Method| {
            let losses: Vec<(f64, Vec<f64>)> =
                values.iter().map(|&value| (value, losses(method, value))).collect();
            let quantiles = |q: f64| losses.iter().map(move |(_, losses)| quantile(losses, q));
            let line = values.iter().copied().zip(quantiles(0.5)).collect();
            let band = quantiles(0.25).zip(quantiles(0.75)).collect();
            Series { band, ..Series::new(method.label(), method.color(), line) }
        };
        (values.len() > 1).then(|| (key.to_owned(), methods.iter().map(series).collect()))
    };
    let panels: Vec<_> = results.plan.contents.varied_keys().filter_map(panel).collect();
    (!panels.is_empty())
        .then(|| settings(&format!("{title}: median and quartiles of the final test loss"), panels))
}
