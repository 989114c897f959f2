//! Quantum control with the library alone: steers a superposition of the two lowest eigenstates
//! into the third.
//!
//! Run: `cargo run --release --example quantum -- [epochs]`

use physgrad::policy::Conv;
use physgrad::tasks::Quantum;
use physgrad::{Field, Rollout, System, Task, TrainError, Trainer, check};

fn main() -> Result<(), TrainError> {
    let epochs =
        std::env::args().nth(1).map_or(30, |text| text.parse().expect("a number of epochs"));
    let task = Quantum::new(3);
    let n = task.system.state_dim();
    let policy = Conv::new(task.system.grid, 60);
    check::system(&task.system).unwrap();

    let mut session =
        Trainer::new(task, policy.clone()).field(Field::combined()).epochs(epochs).session()?;
    while !session.is_done() {
        let record = session.epoch()?;
        if record.epoch.is_power_of_two() || record.epoch == epochs {
            println!(
                "epoch {:>4}: test loss {:.2} of {}",
                record.epoch, record.test_loss, task.horizon
            );
        }
    }

    // Rolls out one test sample. Prints the fidelity with the target and the squared norm of the
    // wave, every 32 steps.
    let mut rollout = Rollout::new(&task, &policy, 1);
    rollout.start(&session.test_starts()[..n]);
    if let Err(divergence) = rollout.run(&task, &policy, session.weights()) {
        println!("{divergence}");
    }
    for t in (0..=task.horizon).step_by(32) {
        let psi: Vec<f64> = (0..n).map(|i| f64::from(rollout.state(t, 0, i))).collect();
        let norm: f64 = psi.iter().map(|x| x * x).sum();
        // The terminal cost of `LossMode::Terminal` is the infidelity.
        let fidelity = 1.0
            - Quantum { loss: physgrad::tasks::LossMode::Terminal, ..task }
                .terminal_cost(&psi, &[]);
        println!(
            "  time {:>4.1}: fidelity {fidelity:.3}, squared norm {norm:.6}",
            t as f64 * task.system.dt
        );
    }
    Ok(())
}
