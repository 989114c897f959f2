//! Losses of two controllers over a grid of pole lengths. One trains with varied pole lengths, the
//! other with the nominal length.
//!
//! Run: `cargo run --release --example robust -- [epochs]`

use physgrad::engine::Evaluation;
use physgrad::policy::Mlp;
use physgrad::rng::Purpose;
use physgrad::tasks::{CartPole, CartPoleSystem, LossMode};
use physgrad::{Number, TrainError, Trainer, Weights, initial_states};

/// Swing-up of one pole whose half length, in m, is fixed, drawn or trained.
fn task(half_length: Number) -> CartPole {
    let system = CartPoleSystem { half_length, ..CartPoleSystem::default() };
    CartPole { loss: LossMode::Running, ..CartPole::with_system(system) }
}

fn main() -> Result<(), TrainError> {
    let epochs =
        std::env::args().nth(1).map_or(200, |text| text.parse().expect("a number of epochs"));
    let policy = Mlp::new([4, 100, 100, 1]);
    let train = |half_length: Number| -> Result<Weights<f32>, TrainError> {
        Ok(Trainer::new(task(half_length), policy.clone()).epochs(epochs).run()?.weights)
    };
    let nominal = train(0.5.into())?;
    let varied = train(Number::LogUniform { low: 0.25, high: 1.0 })?;

    println!("half length    nominal     varied");
    for half_length in [0.15, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5] {
        let task = task(half_length.into());
        let starts = initial_states(&task, 1, Purpose::Test, 256);
        let mut evaluation = Evaluation::new(&task, &policy, 1);
        let losses =
            [&nominal, &varied].map(|weights| evaluation.run(&task, &policy, weights, &starts));
        let [nominal, varied] =
            losses.map(|loss| loss.map_or_else(|_| "diverged".into(), |loss| format!("{loss:.4}")));
        println!("{half_length:>9.2} m {nominal:>10} {varied:>10}");
    }
    Ok(())
}
