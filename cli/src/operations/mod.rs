//! Computations with a task and its policy: sessions, checks, simulations, gradients, fields, norms
//! of adjoints, costs, memory, evaluation, trajectories, policy files, ONNX models and
//! identification.
//!
//! Imports `platform` and `settings`. Start with `session`.

pub mod adjoint_norms;
pub mod amplification;
pub mod checks;
pub mod costs;
pub mod evaluation;
pub mod gradients;
pub mod identification;
pub mod memory;
pub mod onnx;
pub mod policy_file;
pub mod session;
pub mod simulation;
pub mod trajectory;

use std::time::Instant;

/// Mean seconds per call of `run`. Calls it at least once, and until `least` seconds elapse.
pub fn seconds_per_run(least: f64, mut run: impl FnMut()) -> f64 {
    let (start, mut runs) = (Instant::now(), 0.0);
    while runs == 0.0 || start.elapsed().as_secs_f64() < least {
        run();
        runs += 1.0;
    }
    start.elapsed().as_secs_f64() / runs
}
