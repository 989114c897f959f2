//! Numbers of the quadrotor of `examples/quadrotor.rs`, for the same system in NumPy.
//!
//! The program has no such task, so `python/tests/test_ports.py` compares the system in NumPy with
//! these numbers: bits of numbers as hexadecimal digits, and losses as text.

use physgrad::policy::Mlp;
use physgrad::rng::{Purpose, stream};
use physgrad::scalar::Single;
use physgrad::{Clip, Cotangents, Float, Inputs, System, Trainer, Training};
use quadrotor::Quadrotor;
use rand::RngExt as _;
use serde_json::{Value, json};

#[allow(dead_code, reason = "the example has a main function")]
#[path = "../examples/quadrotor.rs"]
mod quadrotor;

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../python/tests/quadrotor.json");
const TASK: Quadrotor = Quadrotor { mass: 0.8, arm: 0.2, dt: 0.05 };

fn in_f64(numbers: &[f64]) -> String {
    numbers.iter().map(|number| format!("{:016x}", number.to_bits())).collect()
}

fn in_f32(numbers: &[Single<f32>]) -> String {
    numbers.iter().map(|number| format!("{:08x}", number.0[0].to_bits())).collect()
}

/// States and controls, the next states in both precisions, cotangents of the next states, and
/// those of states and controls.
fn steps() -> Value {
    let mut rng = stream(0, Purpose::Check, 0);
    let rows = (0..50).map(|_| {
        let mut draw = |count: usize| -> Vec<f64> {
            (0..count).map(|_| rng.random_range(-2.0..2.0)).collect()
        };
        let (x, u, bar) = (draw(6), draw(2), draw(6));
        let mut next = vec![0.0; 6];
        TASK.step(Inputs { x: &x, u: &u, p: &[], t: 0 }, &mut next);
        let (mut x_bar, mut u_bar) = (vec![0.0; 6], vec![0.0; 2]);
        let inputs = Inputs { x: &x[..], u: &u, p: &[], t: 0 };
        TASK.vjp(inputs, &bar, Cotangents::of(&mut x_bar, &mut u_bar));
        let single = |numbers: &[f64]| numbers.iter().map(|&n| Single::from(n)).collect();
        let (x32, u32): (Vec<Single<f32>>, Vec<Single<f32>>) = (single(&x), single(&u));
        let mut next32 = x32.clone();
        TASK.step(Inputs { x: &x32, u: &u32, p: &[], t: 0 }, &mut next32);
        let mut row = json!({ "next_f32": in_f32(&next32) });
        let lists =
            [("x", x), ("u", u), ("next", next), ("bar", bar), ("x_bar", x_bar), ("u_bar", u_bar)];
        lists.iter().for_each(|(name, numbers)| row[name] = in_f64(numbers).into());
        row
    });
    rows.collect()
}

/// Test losses of ten epochs.
fn losses<F: Float>() -> Vec<String> {
    let training = Training {
        epochs: 10,
        seed: 1,
        train_samples: 64,
        test_samples: 64,
        clip: Clip::Norm(1.0),
        ..Training::default()
    };
    let trainer = Trainer::new(TASK, Mlp::new([7, 32, 32, 2]).zero_init_output(true))
        .precision::<F>()
        .training(training);
    let records = trainer.run().expect("a training").records;
    records.iter().map(|record| format!("{:.4}", record.test_loss)).collect()
}

#[test]
fn the_numbers_for_python_are_those_of_the_example() {
    let found =
        json!({ "steps": steps(), "losses": { "f32": losses::<f32>(), "f64": losses::<f64>() } });
    let stored = std::fs::read_to_string(FILE).unwrap_or_default();
    if serde_json::from_str::<Value>(&stored).ok() != Some(found.clone()) {
        let path = std::env::temp_dir().join("quadrotor.json");
        std::fs::write(&path, format!("{found:#}\n")).expect("a writable folder");
        panic!(
            "{FILE} differs from the example; the numbers of the example are in {}",
            path.display()
        );
    }
}
