//! Cart-pole with the library alone: trains with the fields R and C, then prints a rollout of each
//! trained policy.
//!
//! Run: `cargo run --release --example cart_pole -- [epochs] [poles]`

use physgrad::policy::Mlp;
use physgrad::tasks::CartPole;
use physgrad::{Field, Rollout, System, TrainError, Trainer, check};

fn main() -> Result<(), TrainError> {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse().expect("a number"));
    let epochs = numbers.next().unwrap_or(50);
    let task = CartPole::new(numbers.next().unwrap_or(2));
    let n = task.system.state_dim();
    let policy = Mlp::new([n, 100, 100, 1]);
    check::system(&task.system).unwrap();

    for field in [Field::regular(), Field::combined()] {
        let mut session =
            Trainer::new(task, policy.clone()).field(field).epochs(epochs).session()?;
        while !session.is_done() {
            let record = session.epoch()?;
            if record.epoch.is_power_of_two() || record.epoch == epochs {
                let cosine = record
                    .cosine
                    .map_or_else(String::new, |c| format!(", cosine of M and R {c:.3}"));
                println!(
                    "{field:>8}, epoch {:>4}: test loss {:.5}{cosine}",
                    record.epoch, record.test_loss
                );
            }
        }

        // Rolls out one test sample under the trained policy and prints every twentieth step.
        let mut rollout = Rollout::new(&task, &policy, 1);
        rollout.start(&session.test_starts()[..n]);
        if let Err(divergence) = rollout.run(&task, &policy, session.weights()) {
            println!("{divergence}");
        }
        for t in (0..=task.horizon).step_by(20) {
            let angle = |pole: usize| format!("{:>8.3}", rollout.state(t, 0, 2 + 2 * pole));
            println!(
                "  step {t:>3}: angles {}",
                (0..task.system.poles).map(angle).collect::<String>()
            );
        }
    }
    Ok(())
}
