//! Simulation of a scene with one setting: results and costs.

use crate::program::operations::Visit;
use crate::program::settings::Precision;
use physgrad::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::rng::{Purpose, stream};
use physgrad::{Adjoint, Float, Flow, Gradient, OpCount, Ops, Policy, Rollout, Task, Weights};
use std::time::Instant;

/// Number of samples in the rollout: one full block of lanes.
const SAMPLES: usize = 8;

/// Results of a rollout.
#[derive(Clone, Default)]
pub struct Found {
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
    pub found: Result<Found, String>,
    /// States with zero control, `[sample][step]`. Empty if that rollout diverges.
    pub idle: Vec<Vec<Vec<f64>>>,
    /// Operations of one control step and of its VJP for one adjoint.
    pub operations: u64,
    /// Bytes of rollout and adjoint, per sample and step.
    pub bytes: f64,
    /// Number of steps in a run, over all samples.
    steps: f64,
    run: Box<dyn FnMut(bool)>,
}

impl Job {
    /// Seconds per sample and step: forward, and forward with the adjoints of R and M.
    ///
    /// Measures each for about `least` seconds.
    pub fn time(&mut self, least: f64) -> [f64; 2] {
        [false, true].map(|gradient| {
            let (start, mut runs) = (Instant::now(), 0.0);
            while runs == 0.0 || start.elapsed().as_secs_f64() < least {
                (self.run)(gradient);
                runs += 1.0;
            }
            start.elapsed().as_secs_f64() / (runs * self.steps)
        })
    }
}

/// Visitor that makes the job of a scene.
pub struct Preparing {
    pub precision: Precision,
    pub seed: u64,
}

impl Visit for Preparing {
    type Out = Job;

    fn visit<T: Task + Clone + 'static, P: Policy + Clone + 'static>(self, task: T, policy: P) -> Job {
        let cost = OpCount::of(task.system());
        match self.precision {
            Precision::F32 => prepare::<f32>(Box::new(task), Box::new(policy), cost, self.seed),
            Precision::F64 => prepare::<f64>(Box::new(task), Box::new(policy), cost, self.seed),
        }
    }
}

fn sum(counts: Ops) -> u64 {
    let Ops { add, negate, multiply, divide, sqrt, transcendental, compare } = counts;
    add + negate + multiply + divide + sqrt + transcendental + compare
}

fn prepare<F: Float>(task: Box<dyn AnyTask<F>>, policy: Box<dyn AnyPolicy<F>>, cost: OpCount, seed: u64) -> Job {
    let (n, horizon) = (task.state_dim(), task.horizon());
    let weights = Weights::<F>::init(&*policy, &mut stream(seed, Purpose::Policy, 0));
    let mut x = vec![0.0; SAMPLES * n];
    for (sample, x) in x.chunks_exact_mut(n).enumerate() {
        task.start(&mut stream(seed, Purpose::Test, sample as u64), x);
    }
    let starts: Vec<F> = x.into_iter().map(F::lift).collect();
    let mut rollout = Rollout::new(&*task, &*policy, SAMPLES);
    let mut adjoint = Adjoint::new(&*policy, &rollout, &[Flow::REGULAR, Flow::MODIFIED]);
    let scale = F::lift(1.0 / SAMPLES as f64);

    let run = |rollout: &mut Rollout<F>, adjoint: &mut Adjoint<F>| {
        rollout.start(&starts);
        rollout.run(&*task, &*policy, &weights)?;
        adjoint.run(&*task, &*policy, &weights, rollout, scale)
    };
    let found = run(&mut rollout, &mut adjoint).map_err(|divergence| divergence.to_string()).map(|()| {
        let state = |t: usize| {
            let rollout = &rollout;
            (0..SAMPLES).flat_map(move |sample| (0..n).map(move |i| rollout.state(t, sample, i).as_()))
        };
        let gradients = [0, 1].map(|k| {
            let mut theta_bar = Gradient::zeros(weights.theta().len());
            adjoint.param_gradient(k, &*policy, &weights, &rollout, 0..SAMPLES, &mut theta_bar);
            theta_bar.to_vec().into_iter().map(|g| g.as_()).collect()
        });
        let loss = (0..SAMPLES).map(|sample| rollout.cost(sample).as_()).sum::<f64>() / SAMPLES as f64;
        Found { states: (0..=horizon).flat_map(state).collect(), loss, gradients }
    });
    // A network with zero parameters outputs zero control.
    let zeros = Weights::new(&*policy, vec![F::zero(); weights.theta().len()]);
    rollout.start(&starts);
    let is_finite = rollout.run(&*task, &*policy, &zeros).is_ok();
    let state = |sample: usize, t: usize| (0..n).map(|i| rollout.state(t, sample, i).as_()).collect();
    let idle = (0..SAMPLES).filter(|_| is_finite).map(|sample| (0..=horizon).map(|t| state(sample, t)).collect()).collect();
    let steps = (SAMPLES * horizon) as f64;
    let bytes = (rollout.stored_bytes() + adjoint.stored_bytes()) as f64 / steps;
    let run = Box::new(move |gradient: bool| {
        rollout.start(&starts);
        // Ignores divergence: diverged jobs are reported and not timed.
        if rollout.run(&*task, &*policy, &weights).is_ok() && gradient {
            let _ = adjoint.run(&*task, &*policy, &weights, &rollout, scale);
        }
    });
    Job { found, idle, operations: sum(cost.step) + sum(cost.vjp), bytes, steps, run }
}
