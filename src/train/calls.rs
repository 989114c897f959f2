//! Rollouts, losses and gradients of many samples in one call each: [`rollout`], [`losses`] and
//! [`gradients`].
//!
//! Threads share the samples in blocks of 32. Each function has a variant that ends early, with `None`,
//! once a condition holds, which is read before every block.

use crate::engine::adjoint::Adjoint;
use crate::engine::any::AnyTask;
use crate::engine::batch::GROUP;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::parallel::for_each;
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::Float;
use crate::policy::{AnyPolicy, Weights};
use crate::train::field::Field;

/// Largest number of samples in one rollout.
const BLOCK: usize = 8 * GROUP;

/// Number of blocks whose results are in memory at once. Sums do not depend on the number of
/// threads.
const WAVE: usize = 32;

/// A call that nobody stops.
const WHOLE: &str = "the call runs to its end";

/// States and controls of rollouts.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectories<F> {
    /// States, `[sample][step][component]`, with T + 1 steps.
    pub states: Vec<F>,
    /// Controls, `[sample][step][component]`, with T steps.
    pub controls: Vec<F>,
}

/// Rollouts from `starts`, in the layout of [`initial_states`](crate::initial_states).
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If `starts` is not a whole number of initial states, or if `weights` are those of a policy with
/// other sizes.
pub fn rollout<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
) -> Result<Trajectories<F>, Divergence> {
    Ok(rollout_until(task, policy, weights, starts, &|| false)?.expect(WHOLE))
}

/// [`rollout`] that ends once `is_stopped` returns true.
///
/// # Errors
/// As [`rollout`].
#[inline(never)]
pub fn rollout_until<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Trajectories<F>>, Divergence> {
    weights.assert_fits(policy);
    let mut all = Trajectories { states: Vec::new(), controls: Vec::new() };
    let one = |_: usize, starts: &[F]| {
        let mut found = Trajectories { states: Vec::new(), controls: Vec::new() };
        simulated(task, policy, weights, starts)?.append(&mut found.states, &mut found.controls);
        Ok(found)
    };
    let is_done = in_blocks(starts, task.start_dim(), is_stopped, one, &mut |mut found| {
        all.states.append(&mut found.states);
        all.controls.append(&mut found.controls);
    })?;
    Ok(is_done.then_some(all))
}

/// A rollout with a tape.
fn simulated<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
) -> Result<Rollout<F>, Divergence> {
    let mut rollout = Rollout::new(task, policy, starts.len() / task.start_dim());
    rollout.start(starts);
    rollout.run(task, policy, weights)?;
    Ok(rollout)
}

/// Calls `work` with the index of the first sample and the initial states of each block of samples,
/// on several threads, and `take` with the results in order. Returns false if `is_stopped` ends it.
fn in_blocks<F: Float, R: Send>(
    starts: &[F],
    width: usize,
    is_stopped: &(dyn Fn() -> bool + Sync),
    work: impl Fn(usize, &[F]) -> Result<R, Divergence> + Sync,
    take: &mut dyn FnMut(R),
) -> Result<bool, Divergence> {
    for (wave, starts) in starts.chunks(WAVE * BLOCK * width).enumerate() {
        let mut blocks: Vec<_> =
            starts.chunks(BLOCK * width).map(|starts| (starts, None)).collect();
        for_each(&mut blocks, &|i, (starts, found)| {
            if !is_stopped() {
                let first = (wave * WAVE + i) * BLOCK;
                *found = Some(work(first, starts).map_err(|divergence| divergence.offset(first)));
            }
        });
        for (_, found) in blocks {
            match found {
                Some(found) => take(found?),
                None => return Ok(false),
            }
        }
    }
    Ok(true)
}

/// Losses of rollouts from `starts`, one per sample.
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If `starts` is not a whole number of initial states, or if `weights` are those of a policy with
/// other sizes.
pub fn losses<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
) -> Result<Vec<F>, Divergence> {
    Ok(losses_until(task, policy, weights, starts, &|| false)?.expect(WHOLE))
}

/// [`losses`] that end once `is_stopped` returns true.
///
/// # Errors
/// As [`losses`].
#[inline(never)]
pub fn losses_until<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Vec<F>>, Divergence> {
    weights.assert_fits(policy);
    let mut losses = Vec::new();
    let one = |_: usize, starts: &[F]| {
        let samples = starts.len() / task.start_dim();
        let mut rollout = Rollout::for_evaluation(task, policy, samples);
        rollout.start(starts);
        rollout.run(task, policy, weights)?;
        Ok((0..samples).map(|sample| rollout.cost(sample)).collect::<Vec<F>>())
    };
    let take = &mut |mut found| losses.append(&mut found);
    let is_done = in_blocks(starts, task.start_dim(), is_stopped, one, take)?;
    Ok(is_done.then_some(losses))
}

/// Vectors of the fields for the mean loss of rollouts from `starts`, `[field][parameter]`. All
/// fields share the forward passes. For up to 32 samples, the vectors are bit for bit those of a
/// training update with the mini-batch `starts`.
///
/// ```
/// use physgrad::{Field, Weights, gradients, initial_states, policy::Mlp, rng, tasks::CartPole};
///
/// let (task, policy) = (CartPole::new(1), Mlp::new([4, 16, 1]));
/// let weights = Weights::<f64>::init(&policy, &mut rng::stream(0, rng::Purpose::Policy, 0));
/// let starts = initial_states(&task, 0, rng::Purpose::Train, 8);
/// let vectors = gradients(&task, &policy, &weights, &starts, &[Field::regular(), Field::combined()])?;
/// assert_eq!([vectors[0].len(), vectors[1].len()], [weights.theta().len(); 2]);
/// # Ok::<(), physgrad::Divergence>(())
/// ```
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If `starts` is empty or not a whole number of initial states, or if `weights` are those of a
/// policy with other sizes.
pub fn gradients<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    fields: &[Field],
) -> Result<Vec<Vec<F>>, Divergence> {
    Ok(gradients_until(task, policy, weights, starts, fields, &|| false)?.expect(WHOLE))
}

/// [`gradients`] that end once `is_stopped` returns true.
///
/// # Errors
/// As [`gradients`].
#[inline(never)]
pub fn gradients_until<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    fields: &[Field],
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Vec<Vec<F>>>, Divergence> {
    weights.assert_fits(policy);
    let flows = distinct_flows(fields);
    let zeros = || Gradient::<F>::zeros(weights.theta().len());
    let samples = starts.len() / task.start_dim();
    assert!(samples > 0, "gradients need at least one initial state");
    let scale = F::from_f64(1.0 / samples as f64);
    let of_block = |_: usize, starts: &[F]| {
        let rollout = simulated(task, policy, weights, starts)?;
        let (mut sums, mut one) = (Vec::new(), zeros());
        // One reverse pass carries up to two flows.
        for flows in flows.chunks(2) {
            let mut adjoint = Adjoint::new(task, policy, &rollout, flows);
            adjoint.run(task, policy, weights, &rollout, scale)?;
            for k in 0..flows.len() {
                let mut sum = zeros();
                for first in (0..rollout.samples()).step_by(GROUP) {
                    let group = first..rollout.samples().min(first + GROUP);
                    adjoint.param_gradient(k, policy, weights, &rollout, group, &mut one);
                    sum.set_or_add(&one, first == 0);
                }
                sums.push(sum);
            }
        }
        Ok(sums)
    };
    let mut sums: Vec<Gradient<F>> = Vec::new();
    let is_done = in_blocks(
        starts,
        task.start_dim(),
        is_stopped,
        of_block,
        &mut |found| match sums.is_empty() {
            true => sums = found,
            false => sums.iter_mut().zip(&found).for_each(|(sum, more)| sum.add(more)),
        },
    )?;
    if !is_done {
        return Ok(None);
    }
    sums.iter_mut().for_each(Gradient::normalize);
    for (&flow, sum) in flows.iter().zip(&sums) {
        if let Some(parameter) = sum.values().iter().position(|value| !value.as_().is_finite()) {
            return Err(Divergence::Gradient { flow, parameter });
        }
    }
    Ok(Some(fields.iter().map(|field| vector(field, &flows, &sums)).collect()))
}

/// The products of the transposed Jacobian of [`rollout`] with the cotangents `bars` of its states
/// and controls: cotangents of the parameters θ, and of `starts`. The derivative follows `flow`: for
/// the chain rule it is [`Flow::REGULAR`]. Noise and its keys have the cotangent 0.
///
/// ```
/// use physgrad::{Flow, Weights, initial_states, policy::Mlp, rng, tasks::CartPole};
/// use physgrad::train::calls::{rollout, rollout_vjp};
///
/// // The gradient of the mean position of the cart at the end.
/// let (task, policy) = (CartPole::new(1), Mlp::new([4, 16, 1]));
/// let weights = Weights::<f64>::init(&policy, &mut rng::stream(0, rng::Purpose::Policy, 0));
/// let starts = initial_states(&task, 0, rng::Purpose::Train, 8);
/// let mut bars = rollout(&task, &policy, &weights, &starts)?;
/// bars.states.fill(0.0);
/// bars.controls.fill(0.0);
/// let steps = bars.states.len() / (8 * 4);
/// bars.states.chunks_mut(steps * 4).for_each(|sample| sample[(steps - 1) * 4] = 1.0 / 8.0);
/// let (theta_bar, starts_bar) = rollout_vjp(&task, &policy, &weights, &starts, &bars, Flow::REGULAR)?;
/// assert_eq!([theta_bar.len(), starts_bar.len()], [weights.theta().len(), starts.len()]);
/// # Ok::<(), physgrad::Divergence>(())
/// ```
///
/// # Errors
/// The first [`Divergence`].
///
/// # Panics
/// If `starts` is not a whole number of initial states, `bars` are not those of its rollouts, or
/// `weights` are those of a policy with other sizes.
#[inline(never)]
pub fn rollout_vjp<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    bars: &Trajectories<F>,
    flow: Flow,
) -> Result<(Vec<F>, Vec<F>), Divergence> {
    weights.assert_fits(policy);
    let (width, horizon) = (task.start_dim(), task.horizon());
    let (n, m) = ((horizon + 1) * task.state_dim(), horizon * task.control_dim());
    // The policy replaces numbers that it trains, and the rollout those that are noise.
    let mut replaced: Vec<usize> =
        policy.trained_params().iter().map(|param| param.index()).collect();
    task.noise().at(0.0, 0, |i, _| replaced.push(i));
    let zeros = || Gradient::<F>::zeros(weights.theta().len());
    let of_block = |first: usize, starts: &[F]| {
        let count = starts.len() / width;
        let rollout = simulated(task, policy, weights, starts)?;
        let mut adjoint = Adjoint::new(task, policy, &rollout, &[flow]).keep_start_gradients();
        adjoint
            .give(&bars.states[first * n..][..count * n], &bars.controls[first * m..][..count * m]);
        adjoint.run(task, policy, weights, &rollout, F::one())?;
        let (mut theta_bar, mut starts_bar) = (zeros(), Vec::with_capacity(starts.len()));
        adjoint.param_gradient(0, policy, weights, &rollout, 0..count, &mut theta_bar);
        for sample in 0..count {
            starts_bar.extend(adjoint.start_gradient(0, sample).to_vec());
            starts_bar.resize((sample + 1) * width, F::zero());
            let first = sample * width + task.state_dim();
            replaced.iter().for_each(|i| starts_bar[first + i] = F::zero());
        }
        Ok((theta_bar, starts_bar))
    };
    let (mut theta_bar, mut starts_bar) = (zeros(), Vec::with_capacity(starts.len()));
    in_blocks(starts, width, &|| false, of_block, &mut |(by_theta, mut by_starts)| {
        theta_bar.add(&by_theta);
        starts_bar.append(&mut by_starts);
    })?;
    theta_bar.normalize();
    let theta_bar = theta_bar.to_vec();
    match theta_bar.iter().position(|value| !value.as_().is_finite()) {
        Some(parameter) => Err(Divergence::Gradient { flow, parameter }),
        None => Ok((theta_bar, starts_bar)),
    }
}

/// Flows of all fields, each once, in the order of their first field.
fn distinct_flows(fields: &[Field]) -> Vec<Flow> {
    let mut flows: Vec<Flow> = Vec::new();
    for flow in fields.iter().flat_map(Field::flows) {
        if !flows.contains(&flow) {
            flows.push(flow);
        }
    }
    flows
}

/// Vector of a field, from the gradients of `flows`.
fn vector<F: Float>(field: &Field, flows: &[Flow], gradients: &[Gradient<F>]) -> Vec<F> {
    let own: Vec<Gradient<F>> = field
        .flows()
        .iter()
        .filter_map(|flow| flows.iter().position(|known| known == flow))
        .map(|k| gradients[k].clone())
        .collect();
    let mut out = Gradient::zeros(gradients[0].values().len());
    field.combine(&own, &mut out);
    out.to_vec()
}
