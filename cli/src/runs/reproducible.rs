//! Equal bits of trainings across threads, memory budgets and resumption.

use crate::operations::session::{AnyRun, Epoch};
use crate::scenes::presets;
use crate::tasks::Scene;
use anyhow::Result;
use physgrad::train::Record;
use toml::Value;

const EPOCHS: usize = 3;

/// Scene of a short training run of a preset.
fn scene(name: &str, overrides: &[(&str, Value)]) -> Result<Scene> {
    let mut source = presets::source(name)?;
    let counts = [
        ("epochs", EPOCHS),
        ("training.batch", 13),
        ("training.train_samples", 39),
        ("training.test_samples", 8),
    ];
    let counts = counts.map(|(key, count)| (key, Value::Integer(count as i64)));
    let widths = ("policy.widths", Value::Array(vec![Value::Integer(16)]));
    for (key, value) in counts.into_iter().chain([widths]).chain(overrides.iter().cloned()) {
        source.put(key, value, "a test")?;
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

/// Bits depend on the processor: matrix products and the tanh of layers use fused multiply-add where
/// available. So the test compares runs on this machine.
#[test]
fn trainings_have_equal_bits_for_any_number_of_threads_memory_budget_and_resumption() {
    let long = [("horizon", Value::Integer(300))];
    for name in ["cart_pole", "cart_pole_windy"] {
        let with = |key: &'static str, value: Value| {
            scene(name, &[&long[..], &[(key, value)]].concat()).expect("a scene")
        };
        let whole = |scene: &Scene, workers: usize| {
            scene.open(workers).and_then(trained).expect("a training")
        };
        let scene = scene(name, &long).expect("a scene");
        let one = whole(&scene, 1);
        for workers in [2, 8] {
            assert_eq!(whole(&scene, workers), one, "{name}, {workers} workers");
        }
        assert_eq!(
            whole(&with("training.memory", Value::String("1.5MB".into())), 1),
            one,
            "{name}, 1.5 MB"
        );
        for after in 0..=EPOCHS {
            assert_eq!(
                resumed(&scene, after).expect("a training"),
                one,
                "{name}, resumed after epoch {after}"
            );
        }
        assert_ne!(whole(&with("seed", Value::Integer(1)), 1), one, "{name}, another seed");
    }
}
