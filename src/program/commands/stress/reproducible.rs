//! Hard case: bitwise reproducibility across threads, memory budgets and resumption.

use crate::program::operations::session::AnyRun;
use crate::program::scenes::presets;
use crate::program::tasks::Scene;
use anyhow::Result;
use physgrad::Record;
use physgrad::stress::{Case, Finding};
use toml::Value;

pub const CASES: [Case; 1] = [Case::new(
    "reproducible",
    "trainings of cart_pole over 300 steps, and with wind, bumpers and a lag; with 1, 2 and 8 workers, in little memory, resumed after \
     every epoch",
    "the same bytes of parameters and records; other bytes with another seed",
    STORY,
    reproducible,
)];

const STORY: &str = "Sums over threads in the order in which they finish give other bits in each run. Here every sum has a fixed \
            order. Between processors, bits may differ: matrix products and the layers' tanh fuse where the processor \
            does";

const EPOCHS: usize = 3;

/// Scene of a short training run of a preset.
fn scene(name: &str, changes: &[(&str, Value)]) -> Result<Scene> {
    let mut document = presets::document(name)?;
    let counts = [("epochs", EPOCHS), ("training.batch", 13), ("training.train_samples", 39), ("training.test_samples", 8)];
    let counts = counts.map(|(key, count)| (key, Value::Integer(count as i64)));
    let widths = ("policy.widths", Value::Array(vec![Value::Integer(16)]));
    for (key, value) in counts.into_iter().chain([widths]).chain(changes.iter().cloned()) {
        document.put(key, value, "stress")?;
    }
    document.scene()
}

/// Trained parameters, serialized, and the records of all epochs without times.
fn trained(mut run: Box<dyn AnyRun>) -> Result<(Vec<u8>, Vec<Record>)> {
    while !run.is_done() {
        run.advance(&|| false)?;
    }
    let records = run.records().iter().map(|record| Record { seconds: 0.0, ..record.clone() });
    Ok((run.safetensors(String::new())?, records.collect()))
}

/// As [`trained`], but resumed after some epochs in a session with another number of workers.
fn resumed(scene: &Scene, after: usize) -> Result<(Vec<u8>, Vec<Record>)> {
    let (mut first, mut second) = (scene.open(1)?, scene.open(2)?);
    for _ in 0..after {
        first.advance(&|| false)?;
    }
    second.restore(&first.checkpoint("a run"), "a run")?;
    trained(second)
}

fn reproducible() -> Vec<Finding> {
    let long = [("horizon", Value::Integer(300))];
    ["cart_pole", "cart_pole_windy"].into_iter().flat_map(|name| of(name, &long)).collect()
}

fn of(name: &str, changes: &[(&str, Value)]) -> Vec<Finding> {
    let Ok(scene) = scene(name, changes) else {
        return vec![Finding::holds(name, "a scene", false, "it cannot be read")];
    };
    let open = |workers: usize| scene.open(workers).and_then(trained).ok();
    let one = open(1);
    let same = |what: String, other: Option<_>| {
        let pass = one.is_some() && other == one;
        Finding::holds(format!("{name}, {what}"), "the same bytes", pass, if pass { "the same" } else { "others" })
    };
    let with = |key: &'static str, value: Value| self::scene(name, &[changes, &[(key, value)]].concat());
    let small = with("training.memory", Value::String("1.5MB".into())).and_then(|scene| trained(scene.open(1)?)).ok();
    let mut findings =
        vec![same("2 workers".into(), open(2)), same("8 workers".into(), open(8)), same("in 1.5 MB".into(), small)];
    findings.extend((0..=EPOCHS).map(|after| same(format!("resumed after epoch {after}"), resumed(&scene, after).ok())));
    let other = with("seed", Value::Integer(1)).and_then(|scene| trained(scene.open(1)?)).ok();
    let pass = other.is_some() && other != one;
    findings.push(Finding::holds(format!("{name}, another seed"), "other bytes", pass, if pass { "others" } else { "the same" }));
    findings
}
