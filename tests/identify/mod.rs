//! Identification of parameters on simulated trajectories, and the pendulum of several arms.

mod errors;
mod failures;
mod pendulum;
mod shooting;
mod simulated;
mod statistics;

use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad::tasks::{Arm, LossMode, MultiPendulum, Upright};
use physgrad::{DynSystem, DynTask, Integrated, Task};

/// Arms on one another in steps of 10 ms by RK4, as a type whose identification the library
/// compiles. Only the system of its task matters.
fn swinging(arms: Vec<Arm>) -> DynSystem {
    let ode = MultiPendulum { arms, gravity: 9.81.into() };
    let integrator = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    let task = Upright {
        system: Integrated { ode, integrator, dt: 0.01 },
        first_angle: 0,
        from: 0.0,
        spread: 0.0,
        loss: LossMode::Terminal,
        control_weight: 0.0,
        control_bound: 0.0,
        horizon: 1,
    };
    DynTask::new(task).system().clone()
}
