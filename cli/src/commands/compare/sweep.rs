//! Outputs of a comparison that sweeps settings.

use super::SweepPoint;
use crate::platform::csv::csv;
use crate::runs::statistics::{InScene, Outcome, best, by_field, field_label};
use anyhow::Result;
use physgrad::Field;
use physgrad::text::short;
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Drawing, Series, field_color, settings};
use toml::Value;

/// Swept keys of all points.
fn keys(points: &[SweepPoint]) -> Vec<String> {
    let mut keys: Vec<String> = Vec::new();
    for (key, _) in points.iter().flat_map(|point| &point.point.0) {
        if !keys.contains(key) {
            keys.push(key.clone());
        }
    }
    keys
}

/// Value of a key at a point. None for a point without the key.
fn value<'a>(point: &'a SweepPoint, key: &str) -> Option<&'a Value> {
    point.point.0.iter().find(|(own, _)| own == key).map(|(_, value)| value)
}

/// `summary.csv`: one row per run, with a column for each swept setting. Final losses of a failed
/// run are NaN.
pub fn summary(points: &[SweepPoint], scenes: &[InScene]) -> Result<Vec<u8>> {
    let keys = keys(points);
    // Omits the name of a single scene.
    let name = if scenes.len() > 1 { &["scene"][..] } else { &[] };
    let results =
        ["field", "seed", "final_train_loss", "final_test_loss", "best_test_loss", "seconds"];
    let header = name.iter().copied().chain(keys.iter().map(String::as_str)).chain(results);
    let runs = points
        .iter()
        .zip(scenes)
        .flat_map(|(point, scene)| scene.runs.iter().map(move |run| (point, run)));
    let rows = runs.map(|(point, run)| {
        let name = name.iter().map(|_| point.name.clone());
        let swept = keys.iter().map(|key| value(point, key).map_or_else(String::new, text));
        let names = [run.field.letter().to_owned(), run.seed.to_string()];
        let numbers = [
            run.last(|r| r.train_loss),
            run.last(|r| r.test_loss),
            best(run.records),
            run.seconds(),
        ];
        name.chain(swept).chain(names).chain(numbers.map(|x| x.to_string())).collect::<Vec<_>>()
    });
    csv(header, rows)
}

/// Text of a value in a table.
fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), String::from)
}

/// Medians and quartiles of the final test loss against each swept setting with at least two
/// numeric values. One panel per setting, one line per field. None without such a setting.
pub fn picture(title: &str, points: &[SweepPoint], scenes: &[InScene]) -> Option<Drawing> {
    let number = |value: &Value| value.as_float().or_else(|| value.as_integer().map(|x| x as f64));
    let mut fields: Vec<Field> = Vec::new();
    for (field, _) in scenes.iter().flat_map(|scene| by_field(&scene.runs)) {
        if !fields.contains(&field) {
            fields.push(field);
        }
    }
    let panel = |key: &String| {
        let mut values: Vec<f64> =
            points.iter().filter_map(|point| number(value(point, key)?)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        let losses = |field: Field, at: f64| {
            let there = points
                .iter()
                .zip(scenes)
                .filter(move |(point, _)| value(point, key).and_then(number) == Some(at));
            let runs =
                there.flat_map(|(_, scene)| &scene.runs).filter(move |run| run.field == field);
            sorted(runs.map(|run| run.last(|r| r.test_loss)))
        };
        let series = |&field: &Field| {
            let losses: Vec<(f64, Vec<f64>)> =
                values.iter().map(|&at| (at, losses(field, at))).collect();
            let line = losses.iter().map(|(at, losses)| (*at, quantile(losses, 0.5))).collect();
            let band = losses
                .iter()
                .map(|(_, losses)| (quantile(losses, 0.25), quantile(losses, 0.75)))
                .collect();
            Series { band, ..Series::new(field_label(field), field_color(field.letter()), line) }
        };
        (values.len() > 1).then(|| (key.clone(), fields.iter().map(series).collect()))
    };
    let panels: Vec<_> = keys(points).iter().filter_map(panel).collect();
    (!panels.is_empty())
        .then(|| settings(&format!("{title}: median and quartiles of the final test loss"), panels))
}

/// Line with the scene and field of the lowest median final test loss. Empty for a single scene, or
/// if every median is NaN.
pub fn lowest(scenes: &[InScene]) -> String {
    let median =
        |runs: &[Outcome]| quantile(&sorted(runs.iter().map(|run| run.last(|r| r.test_loss))), 0.5);
    let all = scenes.iter().flat_map(|scene| {
        by_field(&scene.runs).map(|(field, runs)| (median(runs), scene.name, field))
    });
    match all.filter(|(loss, ..)| !loss.is_nan()).min_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((loss, scene, field)) if scenes.len() > 1 => {
            format!("\nlowest median final test loss: {scene}, {field}: {}", short(loss))
        }
        _ => String::new(),
    }
}
