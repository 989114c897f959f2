//! Compares the fields R and C, each with and without clipping, and the field M without clipping,
//! on the tasks of three other examples.
//!
//! Run: `cargo run --release --example which_field -- [seeds] [epochs]`

use physgrad::policy::{Gru, Policy};
use physgrad::prelude::*;
use physgrad::tasks::CartPoleSystem;
use physgrad::{Clip, Training};
use std::num::{NonZeroU64, NonZeroUsize};
use std::thread::scope;

#[allow(dead_code)]
mod arm;
#[allow(dead_code)]
mod partial_observation;
#[allow(dead_code)]
mod quadrotor;

const RATES: [f64; 5] = [0.001, 0.003, 0.01, 0.03, 0.1];

/// Compares the methods on one task. Prints each method at the learning rate with the lowest median
/// of the test loss after the last epoch. The median of an even number of losses is the larger
/// middle one.
fn compare<T: Task + Clone, P: Policy + Clone>(
    name: &str,
    task: &T,
    policy: &P,
    epochs: usize,
    seeds: u64,
) {
    let (none, norm) = (Clip::None, Clip::Norm(1.0));
    let methods = [
        ("R", Field::regular(), none),
        ("R, clipped", Field::regular(), norm),
        ("M", Field::modified(), none),
        ("C", Field::combined(), none),
        ("C, clipped", Field::combined(), norm),
    ];
    for (method, field, clip) in methods {
        // A training that stops early counts as an infinite loss.
        let loss = |learning_rate, seed| {
            let training = Training { epochs, learning_rate, clip, seed, ..Training::default() };
            let trainer =
                Trainer::new(task.clone(), policy.clone()).field(field).training(training);
            trainer
                .run_with_warnings(|_| ())
                .map_or(f64::INFINITY, |report| report.records[epochs - 1].test_loss)
        };
        let losses = |rate| {
            let mut losses: Vec<f64> = scope(|scope| {
                let threads: Vec<_> =
                    (0..seeds).map(|seed| scope.spawn(move || loss(rate, seed))).collect();
                threads
                    .into_iter()
                    .map(|thread| thread.join().expect("no training panics"))
                    .collect()
            });
            losses.sort_by(f64::total_cmp);
            (rate, losses)
        };
        let median = |losses: &[f64]| losses[losses.len() / 2];
        let results = RATES.map(losses);
        let best = results
            .iter()
            .min_by(|a, b| median(&a.1).total_cmp(&median(&b.1)))
            .expect("there are rates");
        let (rate, losses) = best;
        let (lowest, highest) = (losses[0], losses[losses.len() - 1]);
        println!(
            "{name:<20} {method:<11} {rate:>6} {:>11.5} {lowest:>11.5} {highest:>11.5}",
            median(losses)
        );
    }
}

fn main() -> Result<(), std::num::ParseIntError> {
    let mut args = std::env::args().skip(1);
    let seeds =
        args.next().map(|text| text.parse::<NonZeroU64>()).transpose()?.map_or(5, u64::from);
    let epochs = args.next().map(|text| text.parse::<NonZeroUsize>()).transpose()?.map(usize::from);
    println!(
        "{:<20} {:<11} {:>6} {:>11} {:>11} {:>11}",
        "task", "method", "rate", "median", "lowest", "highest"
    );
    let task = quadrotor::Quadrotor { mass: 0.8, arm: 0.2, dt: 0.05 };
    compare("quadrotor", &task, &Mlp::new([7, 32, 32, 2]), epochs.unwrap_or(150), seeds);
    let task = arm::Arm { mass: 1.0, length: 0.5, damping: 0.2, dt: 0.05 };
    compare("arm", &task, &Mlp::new([8, 32, 32, 2]), epochs.unwrap_or(200), seeds);
    let task = partial_observation::PositionsOnly {
        cart_pole: CartPoleSystem { dt: 0.02, ..CartPoleSystem::default() },
    };
    compare("cart-pole, positions", &task, &Gru::new(3, 24, 1), epochs.unwrap_or(100), seeds);
    Ok(())
}
