//! Hard case: bitwise reproducibility across threads, memory budgets and resumption.

use crate::Record;
use crate::program::operations::session::{AnyRun, Epoch};
use crate::program::scenes::presets;
use crate::program::tasks::Scene;
use crate::stress::{Case, Finding};
use anyhow::Result;
use toml::Value;

pub const CASES: [Case; 1] = [Case::new(
    "reproducible",
    "training of cart_pole over 300 steps, alone and with wind, bumpers and a lag. Runs use 1, 2 and 8 workers, a memory \
     budget, and resumption after every epoch",
    "parameters and records are bitwise equal. They differ with another seed",
    STORY,
    reproducible,
)];

const STORY: &str = "Sums over threads in the order of completion give different bits in each run. Here every sum has a fixed \
            order. Bits may differ between processors: matrix products and the tanh of layers use fused multiply-add \
            where available";

const EPOCHS: usize = 3;

/// Scene of a short training run of a preset.
fn scene(name: &str, overrides: &[(&str, Value)]) -> Result<Scene> {
    let mut source = presets::source(name)?;
    let counts = [("epochs", EPOCHS), ("training.batch", 13), ("training.train_samples", 39), ("training.test_samples", 8)];
    let counts = counts.map(|(key, count)| (key, Value::Integer(count as i64)));
    let widths = ("policy.widths", Value::Array(vec![Value::Integer(16)]));
    for (key, value) in counts.into_iter().chain([widths]).chain(overrides.iter().cloned()) {
        source.put(key, value, "stress")?;
    }
    source.scene()
}

/// Trains to the last epoch. Returns the bits of the parameters, and the records of all epochs with
/// times set to 0.
fn trained(mut run: Box<dyn AnyRun>) -> Result<(Vec<u64>, Vec<Record>)> {
    while !run.is_done() {
        run.advance(&|| false)?;
    }
    let records = run.records().iter().map(|record| Record { seconds: 0.0, ..record.clone() });
    Ok((run.theta(Epoch::Last).into_iter().map(f64::to_bits).collect(), records.collect()))
}

/// Returns the results of [`trained`] from a training that resumes after `after` epochs in a
/// session with another number of workers.
fn resumed(scene: &Scene, after: usize) -> Result<(Vec<u64>, Vec<Record>)> {
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

fn of(name: &str, overrides: &[(&str, Value)]) -> Vec<Finding> {
    let Ok(scene) = scene(name, overrides) else {
        return vec![Finding::holds(name, "a valid scene", false, "invalid")];
    };
    let open = |workers: usize| scene.open(workers).and_then(trained).ok();
    let one = open(1);
    let same = |what: String, other: Option<_>| {
        let pass = one.is_some() && other == one;
        Finding::holds(format!("{name}, {what}"), "bitwise equal", pass, if pass { "equal" } else { "different" })
    };
    let with = |key: &'static str, value: Value| self::scene(name, &[overrides, &[(key, value)]].concat());
    let small = with("training.memory", Value::String("1.5MB".into())).and_then(|scene| trained(scene.open(1)?)).ok();
    let mut findings =
        vec![same("2 workers".into(), open(2)), same("8 workers".into(), open(8)), same("with 1.5 MB".into(), small)];
    findings.extend((0..=EPOCHS).map(|after| same(format!("resumed after epoch {after}"), resumed(&scene, after).ok())));
    let other = with("seed", Value::Integer(1)).and_then(|scene| trained(scene.open(1)?)).ok();
    let pass = other.is_some() && other != one;
    findings.push(Finding::holds(format!("{name}, another seed"), "different", pass, if pass { "different" } else { "equal" }));
    findings
}
