//! A cart swings its pole up and stops at the origin: controls by trajectory optimization.
//!
//! Run: `cargo run --release --example optimize -- [largest force in N] [trajectory.csv]`

use physgrad::optimize::{Initial, Options, optimize};
use physgrad::prelude::*;
use physgrad::tasks::CartPoleSystem;
use std::f64::consts::PI;
use std::fmt::Write as _;

/// Swing-up in 2 s, in 100 steps, from hanging at rest. State [position m, velocity m/s, angle rad
/// (0 = up), rate rad/s], control [force N].
struct SwingUp {
    system: CartPoleSystem,
}

const START: [f64; 4] = [0.0, 0.0, PI, 0.0];

#[rustfmt::skip]
impl Task for SwingUp {
    type System = CartPoleSystem;
    fn system(&self) -> &CartPoleSystem { &self.system }
    fn horizon(&self) -> usize { 100 }
    fn start(&self, _: &mut Rng, Start { x, .. }: Start<'_>) { x.copy_from_slice(&START) }
    fn running_cost<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, _next: &[T]) -> T {
        (u[0] * u[0] * 1e-3 + x[0] * x[0] * 0.1) * self.system.dt
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        (T::one() - x[2].cos()) * 100.0 + (x[0] * x[0] + x[1] * x[1] + x[3] * x[3]) * 10.0
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let force = args.next().map_or(Ok(10.0), |text| text.parse())?;
    let task = SwingUp { system: CartPoleSystem { dt: 0.02, ..CartPoleSystem::default() } };
    // With zero controls the pole hangs at rest, and the gradient is 0. The search therefore starts
    // from a sine.
    let push: Vec<f64> = (0..task.horizon()).map(|t| (0.1 * t as f64).sin()).collect();
    let plan = optimize(
        &task,
        &START,
        &[],
        Initial::Controls(&push),
        &Options::default().bounded(1, force),
    )?;
    for (iteration, cost) in plan.costs.iter().enumerate().step_by(10) {
        println!("iteration {iteration:3}: cost {cost:.6}");
    }
    println!("iteration {:3}: cost {:.6}, since {}", plan.iterations(), plan.cost, plan.stop);
    let last = plan.state(plan.horizon());
    let turns = (last[2] / (2.0 * PI)).round();
    println!(
        "after 2 s: {:.4} m, {:.4} m/s, {:.4} rad from upright, {:.4} rad/s; largest force {:.2} N; gradient {:.1e}",
        last[0],
        last[1],
        last[2] - turns * 2.0 * PI,
        last[3],
        plan.u.iter().fold(0.0, |most: f64, u| most.max(u.abs())),
        plan.gradient_norm()
    );
    if let Some(path) = args.next() {
        let mut table = String::from("t_s,position_m,velocity_m_s,angle_rad,rate_rad_s,force_n\n");
        for t in 0..plan.horizon() {
            let x = plan.state(t);
            writeln!(
                table,
                "{:.2},{},{},{},{},{}",
                t as f64 * task.system.dt,
                x[0],
                x[1],
                x[2],
                x[3],
                plan.control(t)[0]
            )?;
        }
        writeln!(
            table,
            "{:.2},{},{},{},{},",
            plan.horizon() as f64 * task.system.dt,
            last[0],
            last[1],
            last[2],
            last[3]
        )?;
        std::fs::write(path, table)?;
    }
    Ok(())
}
