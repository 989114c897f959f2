//! Methods of computing a gradient, and their costs.

use crate::operations::seconds_per_run;
use crate::platform::parallel;
use crate::settings::Precision;
use physgrad::engine::Batch;
use physgrad::engine::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::rng::Purpose;
use physgrad::{
    DynTask, Field, Float, Flow, Gradient, Policy, Rollout, Weights, check, initial_states,
};
use std::sync::Arc;

/// Number of samples in the mean loss.
const SAMPLES: usize = 4;
/// Largest number of gradient components to compare with the reference.
const CHOSEN: usize = 8;
/// Perturbation of one rounding in f64: relative, but absolute for components that are 0.
const ROUNDING: f64 = f64::EPSILON;

/// Method of computing a gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GradientMethod {
    /// Loss without a gradient.
    Forward,
    /// Reverse pass.
    Reverse {
        /// Field to compute.
        field: Field,
        /// Memory budget in bytes. Unbounded if None.
        budget: Option<u64>,
        /// Perturbs the initial states by one rounding in f64. In f32, this changes only components
        /// that are 0.
        nudged: bool,
    },
    /// Central differences with this step: two losses per parameter.
    Central(f64),
    /// Forward mode with dual numbers, one parameter at a time.
    Duals,
}

type Run = Box<dyn FnMut() + Send>;

/// Gradient computed by one method, and its costs.
pub struct Derived {
    /// All components, or those at the [`chosen`] parameters. Empty for
    /// [`GradientMethod::Forward`]. An error is the message of a divergence or of a budget that is
    /// too small.
    pub gradient: Result<Vec<f64>, String>,
    /// Bytes in the buffers of rollouts and adjoints. 0 for [`GradientMethod::Duals`], which has none.
    pub bytes: usize,
    /// Number of calls of `run` for a whole gradient.
    rounds: f64,
    run: Run,
}

impl Derived {
    /// Seconds for a whole gradient, or for the loss of [`GradientMethod::Forward`]. Calls `run` at
    /// least once, and until `least` seconds elapse.
    pub fn time(&mut self, least: f64) -> f64 {
        seconds_per_run(least, &mut self.run) * self.rounds
    }
}

/// Evenly spaced indices of the gradient components to compare with the reference.
pub fn chosen(count: usize) -> Vec<usize> {
    let chosen = CHOSEN.min(count);
    (0..chosen).map(|i| i * (count - 1) / (chosen - 1).max(1)).collect()
}

/// Parameters and initial states, rounded to f32, which makes them equal in every precision.
fn inputs(task: &dyn AnyTask<f32>, theta: &[f64], seed: u64) -> (Vec<f64>, Vec<f64>) {
    let starts = initial_states(task, seed, Purpose::Test, SAMPLES);
    let rounded = theta.iter().map(|&theta| f64::from(theta as f32)).collect();
    (rounded, starts.iter().map(|&start| f64::from(start)).collect())
}

/// Computes a gradient with one method. [`GradientMethod::Duals`] computes in f64 in either
/// precision.
pub fn derived<P: Policy + 'static>(
    task: DynTask,
    policy: P,
    theta: &[f64],
    precision: Precision,
    seed: u64,
    method: GradientMethod,
) -> Derived {
    let inputs = inputs(&task, theta, seed);
    let (task, policy) = (Arc::new(task), Arc::new(policy));
    let slope: Slope = {
        let (task, policy) = (task.clone(), policy.clone());
        let unit = |i: usize, p: usize| f64::from(u8::from(p == i));
        Box::new(move |theta, starts, i| {
            check::slope_by_duals(&*task, &*policy, theta, starts, Flow::REGULAR, &|p| unit(i, p))
        })
    };
    match precision {
        Precision::F32 => derive::<f32>(task, policy, inputs, method, slope),
        Precision::F64 => derive::<f64>(task, policy, inputs, method, slope),
    }
}

/// Derivative of the loss with respect to one parameter. Takes parameters, initial states and the
/// index of the parameter.
type Slope = Box<dyn Fn(&[f64], &[f64], usize) -> f64 + Send>;

fn derive<F: Float>(
    task: Arc<dyn AnyTask<F>>,
    policy: Arc<dyn AnyPolicy<F>>,
    (theta, mut starts): (Vec<f64>, Vec<f64>),
    method: GradientMethod,
    slope: Slope,
) -> Derived {
    let count = theta.len();
    if let GradientMethod::Reverse { nudged: true, .. } = method {
        nudge(&mut starts);
    }
    let (weights, converted) = (Weights::new(&*policy, convert(&theta)), convert(&starts));
    match method {
        GradientMethod::Reverse { field, budget, nudged: _ } => {
            match reverse(task, policy, weights, converted, field, budget) {
                Ok((gradient, bytes, run)) => {
                    Derived { gradient: Ok(gradient), bytes, rounds: 1.0, run }
                }
                Err(error) => {
                    Derived { gradient: Err(error), bytes: 0, rounds: 1.0, run: Box::new(|| ()) }
                }
            }
        }
        GradientMethod::Forward => {
            let (mut loss, bytes) = losses(task, policy, converted);
            let first = loss(&weights);
            Derived {
                gradient: first.map(|_| Vec::new()),
                bytes,
                rounds: 1.0,
                run: Box::new(move || drop(loss(&weights))),
            }
        }
        GradientMethod::Central(step) => central(task, policy, theta, converted, step),
        GradientMethod::Duals => {
            // Reports a divergence. The rollout in dual numbers would continue after it.
            let first = losses(task, policy, converted).0(&weights);
            let slope = move |i: usize| slope(&theta, &starts, i);
            let gradient =
                first.and_then(|_| chosen(count).into_iter().map(|i| Ok(slope(i))).collect());
            Derived {
                gradient,
                bytes: 0,
                rounds: count as f64,
                run: Box::new(move || _ = slope(0)),
            }
        }
    }
}

/// Perturbs each number by one rounding in f64, in alternating directions.
fn nudge(numbers: &mut [f64]) {
    for (i, x) in numbers.iter_mut().enumerate() {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        *x = if *x == 0.0 { sign * ROUNDING } else { *x * (1.0 + sign * ROUNDING) };
    }
}

fn convert<F: Float>(numbers: &[f64]) -> Vec<F> {
    numbers.iter().map(|&x| F::from_f64(x)).collect()
}

/// Central differences of the loss with this step of the parameters, at the [`chosen`] parameters.
fn central<F: Float>(
    task: Arc<dyn AnyTask<F>>,
    policy: Arc<dyn AnyPolicy<F>>,
    theta: Vec<f64>,
    starts: Vec<F>,
    step: f64,
) -> Derived {
    let count = theta.len();
    let (mut loss, bytes) = losses(task, policy.clone(), starts);
    let mut difference = move |i: usize| {
        let mut side = |step: f64| {
            let mut theta: Vec<F> = convert(&theta);
            theta[i] = F::from_f64(theta[i].as_() + step);
            let perturbed = theta[i].as_();
            loss(&Weights::new(&*policy, theta)).map(|loss| (loss, perturbed))
        };
        // Divides by the difference of the two rounded values of the parameter.
        Ok((side(step)?, side(-step)?))
            .map(|((above, right), (below, left))| (above - below) / (right - left))
    };
    let gradient = chosen(count).into_iter().map(&mut difference).collect();
    Derived {
        gradient,
        bytes,
        rounds: count as f64,
        run: Box::new(move || drop::<Result<f64, String>>(difference(0))),
    }
}

/// Mean loss as a function of the parameters, and the bytes in its buffers.
fn losses<F: Float>(
    task: Arc<dyn AnyTask<F>>,
    policy: Arc<dyn AnyPolicy<F>>,
    starts: Vec<F>,
) -> (impl FnMut(&Weights<F>) -> Result<f64, String> + Send + 'static, usize) {
    let mut rollout = Rollout::for_evaluation(&*task, &*policy, SAMPLES);
    let bytes = rollout.stored_bytes();
    let loss = move |weights: &Weights<F>| {
        rollout.start(&starts);
        rollout.run(&*task, &*policy, weights).map_err(|divergence| divergence.to_string())?;
        Ok((0..SAMPLES).map(|sample| rollout.cost(sample).as_()).sum::<f64>() / SAMPLES as f64)
    };
    (loss, bytes)
}

fn reverse<F: Float>(
    task: Arc<dyn AnyTask<F>>,
    policy: Arc<dyn AnyPolicy<F>>,
    weights: Weights<F>,
    starts: Vec<F>,
    field: Field,
    budget: Option<u64>,
) -> Result<(Vec<f64>, usize, Run), String> {
    let flows = field.flows();
    let batch = match budget {
        Some(budget) => Batch::within(&*task, &*policy, SAMPLES, &flows, 1, budget),
        None => Ok(Batch::new(&*task, &*policy, SAMPLES, &flows, 1)),
    };
    let mut batch = batch.map_err(|error| error.to_string())?;
    let bytes = batch.stored_bytes();
    let mut run = move || {
        batch
            .run(&*task, &*policy, &weights, &starts)
            .map_err(|divergence| divergence.to_string())?;
        let mut gradient = Gradient::zeros(weights.theta().len());
        field.combine(batch.gradients(), &mut gradient);
        Ok(gradient)
    };
    let gradient = run()?.to_f64();
    Ok((gradient, bytes, Box::new(move || drop::<Result<Gradient<F>, String>>(run()))))
}

/// Flows of the reference.
pub const FLOWS: [Flow; 3] = [Flow::REGULAR, Flow::MODIFIED, Flow::STOPPED];

/// Largest number of derivatives that [`reference`] computes.
pub const REFERENCES: usize = FLOWS.len() * CHOSEN;

/// Components of the gradients of R, M and S in double-double arithmetic, at the [`chosen`]
/// parameters. Calls `done` after each component.
pub fn reference(
    task: &DynTask,
    policy: &impl Policy,
    theta: &[f64],
    seed: u64,
    done: &(dyn Fn() + Sync),
) -> [Vec<f64>; 3] {
    let (theta, starts) = inputs(task, theta, seed);
    let derivative: &(dyn Fn((Flow, usize)) -> f64 + Sync) = &|(flow, parameter)| {
        let direction = |i| f64::from(u8::from(i == parameter));
        let [_, slope] = check::slope(task, policy, &theta, &starts, flow, direction);
        done();
        slope
    };
    let parameters = chosen(theta.len());
    let pairs: Vec<(Flow, usize)> =
        FLOWS.into_iter().flat_map(|flow| parameters.iter().map(move |&p| (flow, p))).collect();
    let slopes: Vec<f64> = parallel::map(&pairs, |&pair| derivative(pair));
    let mut flows = slopes.chunks(parameters.len()).map(<[f64]>::to_vec);
    [(); 3].map(|()| flows.next().expect("a chunk for every flow"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operations::policy_file;
    use physgrad::policy::Mlp;
    use physgrad::tasks::{CartPole, CartPoleSystem};

    #[test]
    fn every_method_reports_a_divergence() {
        let system = CartPoleSystem { gravity: f64::INFINITY.into(), ..CartPoleSystem::default() };
        let task = DynTask::new(CartPole::with_system(system));
        let reverse =
            GradientMethod::Reverse { field: Field::regular(), budget: None, nudged: false };
        for method in
            [GradientMethod::Forward, reverse, GradientMethod::Central(0.1), GradientMethod::Duals]
        {
            let policy = Mlp::new([4, 4, 1]);
            let theta = policy_file::random(&policy, 0);
            let gradient =
                derived(task.clone(), policy, &theta, Precision::F64, 0, method).gradient;
            assert!(gradient.is_err(), "{method:?}: {gradient:?}");
        }
    }
}
