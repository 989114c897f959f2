//! Rollout of a scene, with its adjoints: results, operations, memory and time.

use crate::operations::seconds_per_run;
use crate::settings::Precision;
use physgrad::count::OpCount;
use physgrad::engine::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::rng::Purpose;
use physgrad::{
    Adjoint, DynTask, Float, Flow, Gradient, Policy, Rollout, Task, Weights, initial_states,
};

/// Number of samples in the rollout: one full block of lanes.
const SAMPLES: usize = 8;

/// Results of a rollout.
#[derive(Clone, Default)]
pub struct Simulated {
    /// States at the control steps, for all samples; layout `[step][sample][component]`.
    pub states: Vec<f64>,
    /// Mean loss over the samples.
    pub loss: f64,
    /// Gradients of R and M.
    pub gradients: [Vec<f64>; 2],
}

/// Rollout that can be timed repeatedly.
pub struct Job {
    /// Results, or the message of a divergence.
    pub found: Result<Simulated, String>,
    /// States of a rollout with zero control, `[sample][step][component]`. Empty if the rollout
    /// diverges.
    pub idle: Vec<Vec<Vec<f64>>>,
    /// Number of operations of one control step and its VJP for one adjoint, per sample.
    pub operations: u64,
    /// Bytes of the rollout and of the adjoints of R and M, per sample and step.
    pub bytes: f64,
    /// Number of steps in a run, over all samples.
    steps: f64,
    run: Box<dyn FnMut(bool)>,
}

impl Job {
    /// Seconds per sample and step: forward, and forward with the adjoints of R and M.
    ///
    /// Measures each pass for at least `least` seconds.
    pub fn time(&mut self, least: f64) -> [f64; 2] {
        [false, true].map(|gradient| seconds_per_run(least, || (self.run)(gradient)) / self.steps)
    }
}

/// Runs a rollout and its adjoints once, and prepares them for timing.
pub fn job<P: Policy + 'static>(
    task: DynTask,
    policy: P,
    theta: &[f64],
    precision: Precision,
    seed: u64,
) -> Job {
    let cost = OpCount::of(task.system());
    match precision {
        Precision::F32 => prepare::<f32>(Box::new(task), Box::new(policy), cost, theta, seed),
        Precision::F64 => prepare::<f64>(Box::new(task), Box::new(policy), cost, theta, seed),
    }
}

fn prepare<F: Float>(
    task: Box<dyn AnyTask<F>>,
    policy: Box<dyn AnyPolicy<F>>,
    cost: OpCount,
    theta: &[f64],
    seed: u64,
) -> Job {
    let (n, horizon) = (task.state_dim(), task.horizon());
    let weights = Weights::new(&*policy, theta.iter().map(|&theta| F::from_f64(theta)).collect());
    let starts = initial_states(&*task, seed, Purpose::Test, SAMPLES);
    let mut rollout = Rollout::new(&*task, &*policy, SAMPLES);
    let mut adjoint = Adjoint::new(&*task, &*policy, &rollout, &[Flow::REGULAR, Flow::MODIFIED]);
    let scale = F::from_f64(1.0 / SAMPLES as f64);

    let run = |rollout: &mut Rollout<F>, adjoint: &mut Adjoint<F>| {
        rollout.start(&starts);
        rollout.run(&*task, &*policy, &weights)?;
        adjoint.run(&*task, &*policy, &weights, rollout, scale)
    };
    let found =
        run(&mut rollout, &mut adjoint).map_err(|divergence| divergence.to_string()).map(|()| {
            let state = |t: usize| {
                let rollout = &rollout;
                (0..SAMPLES)
                    .flat_map(move |sample| (0..n).map(move |i| rollout.state(t, sample, i).as_()))
            };
            let gradients = [0, 1].map(|k| {
                let mut theta_bar = Gradient::zeros(weights.theta().len());
                adjoint.param_gradient(k, &*policy, &weights, &rollout, 0..SAMPLES, &mut theta_bar);
                theta_bar.to_f64()
            });
            let loss =
                (0..SAMPLES).map(|sample| rollout.cost(sample).as_()).sum::<f64>() / SAMPLES as f64;
            Simulated { states: (0..=horizon).flat_map(state).collect(), loss, gradients }
        });
    // A network with zero parameters outputs zero control.
    let zeros = Weights::new(&*policy, vec![F::zero(); weights.theta().len()]);
    rollout.start(&starts);
    let is_finite = rollout.run(&*task, &*policy, &zeros).is_ok();
    let state =
        |sample: usize, t: usize| (0..n).map(|i| rollout.state(t, sample, i).as_()).collect();
    let idle = (0..SAMPLES)
        .filter(|_| is_finite)
        .map(|sample| (0..=horizon).map(|t| state(sample, t)).collect())
        .collect();
    let steps = (SAMPLES * horizon) as f64;
    let bytes = (rollout.stored_bytes() + adjoint.stored_bytes()) as f64 / steps;
    let run = Box::new(move |gradient: bool| {
        rollout.start(&starts);
        // Ignores divergence: the command reports diverged jobs and does not time them.
        if rollout.run(&*task, &*policy, &weights).is_ok() && gradient {
            let _ = adjoint.run(&*task, &*policy, &weights, &rollout, scale);
        }
    });
    Job { found, idle, operations: cost.step.total() + cost.vjp.total(), bytes, steps, run }
}
