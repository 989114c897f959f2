//! Guidance by repulsion with the library alone: compares two weights of the control cost.
//!
//! Run: `cargo run --release --example guidance -- [epochs]`

use physgrad::effect::HasModel;
use physgrad::policy::Mlp;
use physgrad::tasks::Guidance;
use physgrad::{Field, Rollout, System, TrainError, Trainer, check};

fn main() -> Result<(), TrainError> {
    let epochs =
        std::env::args().nth(1).map_or(50, |text| text.parse().expect("a number of epochs"));
    for regularization in [1.0, 0.01] {
        let task = Guidance { regularization, ..Guidance::new(2, 4) };
        let herds = task.system.model();
        let n = task.system.state_dim();
        let policy = Mlp::new([n, 100, 100, task.system.control_dim()]).zero_init_output(true);
        check::system(&task.system).unwrap();
        println!("regularization {regularization}");
        for field in [Field::regular(), Field::combined()] {
            let mut session =
                Trainer::new(task, policy.clone()).field(field).epochs(epochs).session()?;
            while !session.is_done() {
                session.epoch()?;
            }
            let loss = session.records().last().map_or(f64::NAN, |record| record.test_loss);

            // Mean distance of the evaders from the origin in one test rollout.
            let mut rollout = Rollout::new(&task, &policy, 1);
            rollout.start(&session.test_starts()[..n]);
            if let Err(divergence) = rollout.run(&task, &policy, session.weights()) {
                println!("{divergence}");
            }
            let herd = |t: usize| {
                let at = |evader: usize, axis: usize| {
                    rollout.state(t, 0, 4 * (herds.drivers + evader) + axis)
                };
                let distance = |evader| at(evader, 0).hypot(at(evader, 1));
                (0..herds.evaders).map(distance).sum::<f32>() / herds.evaders as f32
            };
            let (start, end) = (herd(0), herd(task.horizon));
            println!(
                "  {field:>8}: test loss {loss:.4}; mean distance of a herd from the origin {start:.2} m, after 4 s {end:.2} m"
            );
        }
    }
    Ok(())
}
