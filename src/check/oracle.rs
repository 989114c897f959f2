//! Reference values of the checks: dual numbers through `act`, `step`, `observe` and the costs. The
//! rollouts detach the paths that a flow omits.
//!
//! N is the policy. A column is one sample at one step.

use crate::dynamics::inputs::Inputs;
use crate::dynamics::number::NoiseNumbers;
use crate::dynamics::outline::step;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::flow::Flow;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::Scalar;
use crate::policy::AnyPolicy;
use crate::policy::{Action, Observed, Policy, Weights};
use num_dual::Dual64;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::cell::RefCell;
use std::collections::HashMap;

/// Number of random directions per check of a gradient.
const DIRECTIONS: usize = 4;

/// Largest number of parameters for which a check compares every component.
const ALL: usize = 64;

/// Parameters `at`, or initial ones, plus normal noise of standard deviation `size`, so that no
/// layer is zero.
pub fn weights(
    policy: &dyn AnyPolicy<f64>,
    at: Option<&[f64]>,
    size: f64,
    rng: &mut Rng,
) -> Weights<f64> {
    let mut theta = at.map_or_else(|| vec![0.0; policy.param_count()], <[f64]>::to_vec);
    if at.is_none() {
        policy.init(rng, &mut theta);
    }
    for theta in &mut theta {
        let noise: f64 = StandardNormal.sample(rng);
        *theta += size * noise;
    }
    Weights::new(policy, theta)
}

/// Mean loss of rollouts from `starts`, initial states with parameters. Differentiable along the
/// paths of `flow`. The values of the starts are `values`, which give the keys of noise.
pub(super) fn rollouts<T: Task, P: Policy, S: Scalar>(
    task: &T,
    policy: &P,
    theta: &[S],
    starts: (&[S], &[f64]),
    flow: Flow,
) -> S {
    rollouts_by(task, policy, theta, starts, flow, &|inputs, next| {
        step(task.system(), inputs, next)
    })
}

/// [`rollouts`] with steps by `step`.
#[inline(never)]
fn rollouts_by<T: Task, P: Policy, S: Scalar>(
    task: &T,
    policy: &P,
    theta: &[S],
    (starts, values): (&[S], &[f64]),
    flow: Flow,
    step: &dyn Fn(Inputs<'_, S>, &mut [S]),
) -> S {
    let system = task.system();
    let (n, m) = (system.state_dim(), system.control_dim());
    let params = task.param_dim();
    let noise = NoiseNumbers::of(&system.varied(params));
    let len = n + params + noise.key_dim();
    let (found, expected) = (theta.len(), policy.param_count());
    assert_eq!(
        found, expected,
        "`theta` has {found} numbers, but the policy has {expected} parameters"
    );
    let (found, whole) = (starts.len(), !starts.is_empty() && starts.len().is_multiple_of(len));
    assert!(
        whole,
        "`starts` has {found} numbers; expected one or more samples of {len}: the state, then the parameters, then the key of noise"
    );
    let mut mean = S::zero();
    for (start, values) in starts.chunks_exact(len).zip(values.chunks_exact(len)) {
        let mut x = start[..n + params].to_vec();
        let mut p = x.split_off(n);
        let key = values[len - 1];
        let trained = policy.trained_params();
        for (param, &r) in trained.iter().zip(&theta[theta.len() - trained.len()..]) {
            let p = &mut p[param.index()];
            // The value comes from θ. The derivative with respect to the entry of p remains.
            *p = param.value(r) + (*p - p.detach());
        }
        let (mut next, mut u) = (x.clone(), vec![S::zero(); m]);
        let mut memory = vec![S::zero(); policy.memory_dim()];
        let mut next_memory = memory.clone();
        let mut y = vec![S::zero(); task.observation_dim().unwrap_or(n)];
        let seen =
            |x: &[S], weight: f64| -> Vec<S> { x.iter().map(|&x| passed(x, weight)).collect() };
        for t in 0..task.horizon() {
            let flow = flow.at(t);
            noise.at(key, t, |i, value| p[i] = S::from(value) + (p[i] - p[i].detach()));
            match task.observation_dim() {
                None => y.copy_from_slice(&x),
                Some(_) => task.observe(Inputs { x: &x, u: &[], p: &p, t }, &mut y),
            }
            let (seen_y, seen_memory) = (seen(&y, flow.control), seen(&memory, flow.memory));
            policy.act(
                theta,
                Observed { y: &seen_y, memory: &seen_memory, t },
                Action { u: &mut u, memory: &mut next_memory },
            );
            let inputs = Inputs { x: &x, u: &u, p: &p, t };
            step(inputs.with_x(&seen(&x, flow.physics)), &mut next);
            mean += task.running_cost(inputs, &next);
            std::mem::swap(&mut x, &mut next);
            std::mem::swap(&mut memory, &mut next_memory);
        }
        mean += task.terminal_cost(&x, &p);
    }
    mean / S::from((starts.len() / len) as f64)
}

/// The value of x, with its derivatives times `weight`.
fn passed<S: Scalar>(x: S, weight: f64) -> S {
    if weight == 1.0 {
        return x;
    }
    let value = x.detach();
    if weight == 0.0 { value } else { value + (x - value) * weight }
}

/// Mean loss of rollouts from the initial states `starts`.
///
/// # Panics
/// If the length of `theta` is not [`Policy::param_count`], or if `starts` is empty or not a whole
/// number of samples.
pub fn loss<T: Task, P: Policy>(task: &T, policy: &P, theta: &[f64], starts: &[f64]) -> f64 {
    rollouts(task, policy, theta, (starts, starts), Flow::REGULAR)
}

/// Directional derivative of the mean loss, by forward mode with num-dual.
///
/// `starts` concatenates the initial states of the samples, each followed by its parameters. `flow`
/// selects the differentiated paths. The function ignores a [`cut`](Flow::cut) of the flow.
/// `tangent(i)` is the component of the direction along policy parameter i.
///
/// # Panics
/// If the length of `theta` is not [`Policy::param_count`], or if `starts` is empty or not a whole
/// number of samples.
pub fn slope_by_duals<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: &[f64],
    starts: &[f64],
    flow: Flow,
    tangent: &dyn Fn(usize) -> f64,
) -> f64 {
    rollouts(task, policy, &along(theta, tangent), (&constants(starts), starts), flow).eps
}

/// Largest number of inputs of a step whose Jacobian [`Steps`] keeps.
const KEPT_INPUTS: usize = 64;

/// Largest number of derivatives that [`Steps`] keeps.
const KEPT: usize = 8_000_000;

/// Steps in dual numbers. Keeps their Jacobians, column by column from dual numbers: all flows,
/// components and directions of a check have the same states and controls.
#[derive(Default)]
pub(super) struct Steps {
    /// The next state and the columns, by the bits of step, state, control and parameters.
    known: RefCell<HashMap<Vec<u64>, Option<Linear>>>,
}

/// Next state, and its derivatives `[input][component]`.
type Linear = (Vec<f64>, Vec<Vec<f64>>);

impl Steps {
    fn step(
        &self,
        inputs: Inputs<'_, Dual64>,
        next: &mut [Dual64],
        direct: &dyn Fn(Inputs<'_, Dual64>, &mut [Dual64]),
    ) {
        let all = || inputs.x.iter().chain(inputs.u).chain(inputs.p);
        let count = all().count();
        let mut known = self.known.borrow_mut();
        if count > KEPT_INPUTS || known.len() * count * next.len() > KEPT {
            return direct(inputs, next);
        }
        let bits = all().map(|input| input.re.to_bits());
        let key: Vec<u64> = bits.chain([inputs.t as u64]).collect();
        let linear = known.entry(key).or_insert_with(|| linear(inputs, next.len(), direct));
        let Some((values, columns)) = linear else {
            return direct(inputs, next);
        };
        next.iter_mut().zip(values).for_each(|(next, &mut value)| *next = Dual64::from_re(value));
        for (input, column) in all().zip(columns).filter(|(input, _)| input.eps != 0.0) {
            next.iter_mut().zip(column).for_each(|(next, slope)| next.eps += input.eps * *slope);
        }
    }

    /// [`slope_by_duals`] with these steps.
    pub(super) fn slope<T: Task, P: Policy>(
        &self,
        (task, policy): (&T, &P),
        theta: &[f64],
        starts: &[f64],
        flow: Flow,
        tangent: &dyn Fn(usize) -> f64,
    ) -> f64 {
        let seeded = (&constants(starts)[..], starts);
        self.rollouts(task, policy, &along(theta, tangent), seeded, flow).eps
    }

    /// [`slope`](Self::slope) along a direction of the initial states with their parameters.
    pub(super) fn start_slope<T: Task, P: Policy>(
        &self,
        (task, policy): (&T, &P),
        theta: &[f64],
        starts: &[f64],
        flow: Flow,
        tangent: &dyn Fn(usize) -> f64,
    ) -> f64 {
        let seeded = (&along(starts, tangent)[..], starts);
        self.rollouts(task, policy, &constants(theta), seeded, flow).eps
    }

    fn rollouts<T: Task, P: Policy>(
        &self,
        task: &T,
        policy: &P,
        theta: &[Dual64],
        starts: (&[Dual64], &[f64]),
        flow: Flow,
    ) -> Dual64 {
        let direct = |inputs: Inputs<'_, Dual64>, next: &mut [Dual64]| {
            step(task.system(), inputs, next);
        };
        let step = |inputs: Inputs<'_, Dual64>, next: &mut [Dual64]| {
            self.step(inputs, next, &direct);
        };
        rollouts_by(task, policy, theta, starts, flow, &step)
    }
}

/// The step as a linear function of tangents. None if a number is not finite.
fn linear(
    inputs: Inputs<'_, Dual64>,
    components: usize,
    direct: &dyn Fn(Inputs<'_, Dual64>, &mut [Dual64]),
) -> Option<Linear> {
    let mut all = [inputs.x, inputs.u, inputs.p].concat();
    all.iter_mut().for_each(|input| input.eps = 0.0);
    let (n, m) = (inputs.x.len(), inputs.x.len() + inputs.u.len());
    let mut next = constants(&vec![0.0; components]);
    let mut columns = Vec::new();
    for i in 0..all.len() {
        all[i].eps = 1.0;
        direct(Inputs { x: &all[..n], u: &all[n..m], p: &all[m..], t: inputs.t }, &mut next);
        all[i].eps = 0.0;
        columns.push(next.iter().map(|next| next.eps).collect::<Vec<_>>());
    }
    let values: Vec<f64> = next.iter().map(|next| next.re).collect();
    let is_finite = values.iter().chain(columns.iter().flatten()).all(|number| number.is_finite());
    is_finite.then_some((values, columns))
}

/// Directional derivative, as a function of the tangent of every parameter.
type Along<'a> = &'a dyn Fn(&dyn Fn(usize) -> f64) -> f64;

/// Indices with gradient components: all of at most [`ALL`] parameters, otherwise 16 random ones.
pub fn some_components(params: usize, rng: &mut Rng, along: Along) -> Vec<(usize, f64)> {
    let all = params <= ALL;
    let indices: Vec<usize> = if all {
        (0..params).collect()
    } else {
        (0..16).map(|_| rng.random_range(0..params)).collect()
    };
    indices.into_iter().map(|i| (i, along(&|p| unit(p, i)))).collect()
}

/// Random directions with their directional derivatives.
pub fn some_directions(params: usize, rng: &mut Rng, along: Along) -> Vec<(Vec<f64>, f64)> {
    let with_slope = |direction: Vec<f64>| {
        let slope = along(&|p| direction[p]);
        (direction, slope)
    };
    directions(rng, params).into_iter().map(with_slope).collect()
}

/// Policy in dual numbers: θ, the inputs x, the index of the column, and the outputs u.
pub type Act<'a> = &'a dyn Fn(&[Dual64], &[Dual64], usize, &mut [Dual64]);

/// `(∂N/∂x)ᵀ u_bar` per column.
pub fn policy_input_gradient(
    act: Act,
    (n, m): (usize, usize),
    theta: &[f64],
    x: &[f64],
    u_bar: &[f64],
) -> Vec<f64> {
    let theta = constants(theta);
    columns((n, m), x, u_bar)
        .enumerate()
        .flat_map(|(c, (x, u_bar))| pulled_back(x, u_bar, &|x, u| act(&theta, x, c, u)))
        .collect()
}

/// `(∂f/∂inputs)ᵀ bar`, one forward pass per input.
pub fn pulled_back(inputs: &[f64], bar: &[f64], f: &dyn Fn(&[Dual64], &mut [Dual64])) -> Vec<f64> {
    let mut outputs = constants(&vec![0.0; bar.len()]);
    let mut component = |i: usize| {
        f(&along(inputs, &|j| unit(j, i)), &mut outputs);
        inner(&outputs, bar)
    };
    (0..inputs.len()).map(&mut component).collect()
}

/// `⟨u_bar, (∂N/∂θ) v⟩` per column, with `vᵢ = tangent(i)`.
fn policy_slope(
    act: Act,
    (n, m): (usize, usize),
    theta: &[f64],
    x: &[f64],
    u_bar: &[f64],
    tangent: &dyn Fn(usize) -> f64,
) -> Vec<f64> {
    let theta = along(theta, tangent);
    let mut u = constants(&vec![0.0; m]);
    let slope = |(c, (x, u_bar)): (usize, (&[f64], &[f64]))| {
        act(&theta, &constants(x), c, &mut u);
        inner(&u, u_bar)
    };
    columns((n, m), x, u_bar).enumerate().map(slope).collect()
}

/// Inputs and output cotangents of each column. Without inputs and outputs, there are no columns.
fn columns<'a>(
    (n, m): (usize, usize),
    x: &'a [f64],
    u_bar: &'a [f64],
) -> impl Iterator<Item = (&'a [f64], &'a [f64])> {
    let count = x.len().checked_div(n).or(u_bar.len().checked_div(m)).unwrap_or(0);
    (0..count).map(move |c| (&x[c * n..][..n], &u_bar[c * m..][..m]))
}

fn constants(values: &[f64]) -> Vec<Dual64> {
    values.iter().map(|&value| Dual64::from_re(value)).collect()
}

/// Dual numbers seeded with a direction.
fn along(values: &[f64], tangent: &dyn Fn(usize) -> f64) -> Vec<Dual64> {
    values.iter().enumerate().map(|(i, &value)| Dual64::new(value, tangent(i))).collect()
}

fn unit(i: usize, k: usize) -> f64 {
    f64::from(u8::from(i == k))
}

/// Inner product of the output tangents and a cotangent.
fn inner(outputs: &[Dual64], bar: &[f64]) -> f64 {
    outputs.iter().zip(bar).map(|(output, bar)| output.eps * bar).sum()
}

/// `(∂N/∂θᵢ)ᵀ u_bar` per column, for the given parameters.
pub fn policy_components(
    act: Act,
    dims: (usize, usize),
    theta: &[f64],
    x: &[f64],
    u_bar: &[f64],
    indices: &[usize],
) -> Vec<(usize, Vec<f64>)> {
    indices
        .iter()
        .map(|&i| (i, policy_slope(act, dims, theta, x, u_bar, &|p| unit(p, i))))
        .collect()
}

/// Random directions v with `⟨u_bar, (∂N/∂θ) v⟩` per column.
pub fn policy_directions(
    act: Act,
    dims: (usize, usize),
    theta: &[f64],
    x: &[f64],
    u_bar: &[f64],
    rng: &mut Rng,
) -> Vec<(Vec<f64>, Vec<f64>)> {
    let with_slopes = |direction: Vec<f64>| {
        let slopes = policy_slope(act, dims, theta, x, u_bar, &|p| direction[p]);
        (direction, slopes)
    };
    directions(rng, theta.len()).into_iter().map(with_slopes).collect()
}

/// Random directions with components of either sign and magnitude between 1/2 and 3/2. A single
/// wrong component of the gradient always changes the slope. Errors of several components cancel
/// only by chance.
fn directions(rng: &mut Rng, len: usize) -> Vec<Vec<f64>> {
    let mut component = || rng.random_range(0.5..1.5) * if rng.random() { 1.0 } else { -1.0 };
    (0..DIRECTIONS).map(|_| (0..len).map(|_| component()).collect()).collect()
}
