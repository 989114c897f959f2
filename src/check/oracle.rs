//! What the checks compare with: num-dual's numbers through `act` and `step`, with what a flow leaves out detached.

use crate::apart::step;
use crate::backward::Flow;
use crate::policy::{Policy, Weights};
use crate::rng::Rng;
use crate::scalar::Scalar;
use crate::scalar::num_dual::{seeded, tangents};
use crate::system::System;
use crate::task::Task;
use num_dual::DualSVec64;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// Tangents that go through one rollout together.
const TOGETHER: usize = 4;
type Num = DualSVec64<TOGETHER>;

/// Up to so many parameters, all are compared.
const ALL: usize = 64;

/// Initial parameters, with noise of this size added so that no layer is zero.
pub fn weights<P: Policy>(policy: &P, size: f64, rng: &mut Rng) -> Weights<f64> {
    let mut theta = vec![0.0; policy.param_count()];
    policy.init(rng, &mut theta);
    for theta in &mut theta {
        let noise: f64 = StandardNormal.sample(rng);
        *theta += size * noise;
    }
    Weights::new(policy, theta)
}

/// The mean loss of rollouts from `starts`, with the derivative that `flow` carries.
pub(super) fn rollouts<T: Task, P: Policy, S: Scalar>(task: &T, policy: &P, theta: &[S], starts: &[f64], flow: Flow) -> S {
    let system = task.system();
    let (n, m) = (system.state_dim(), system.control_dim());
    let mut mean = S::zero();
    for start in starts.chunks_exact(n) {
        let mut x: Vec<S> = start.iter().map(|&x| S::lift(x)).collect();
        let (mut next, mut u) = (x.clone(), vec![S::zero(); m]);
        let seen = |x: &[S], with: bool| -> Vec<S> { x.iter().map(|&x| if with { x } else { x.detach() }).collect() };
        for _ in 0..task.horizon() {
            policy.act(theta, &seen(&x, flow.control), &mut u);
            step(system, &seen(&x, flow.physics), &u, &mut next);
            mean += task.stage_cost(&next, &u);
            std::mem::swap(&mut x, &mut next);
        }
        mean += task.terminal_cost(&x);
    }
    mean * S::lift(n as f64 / starts.len() as f64)
}

/// The mean loss.
pub fn loss<T: Task, P: Policy>(task: &T, policy: &P, theta: &[f64], starts: &[f64]) -> f64 {
    rollouts(task, policy, theta, starts, Flow::REGULAR)
}

/// Derivatives of the mean loss in the directions that `tangent(parameter)` spans.
fn derivatives<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: &[f64],
    starts: &[f64],
    flow: Flow,
    tangent: impl Fn(usize) -> [f64; TOGETHER],
) -> [f64; TOGETHER] {
    let theta: Vec<_> = theta.iter().enumerate().map(|(i, &t)| seeded(t, tangent(i))).collect();
    tangents(&rollouts(task, policy, &theta, starts, flow))
}

/// The derivatives of the mean loss of rollouts from `starts` that `flow` carries, along these parameters: forward mode by
/// dual numbers, all four in one rollout.
pub fn slopes_by_duals<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: &[f64],
    starts: &[f64],
    flow: Flow,
    parameters: [usize; TOGETHER],
) -> [f64; TOGETHER] {
    derivatives(task, policy, theta, starts, flow, |i| parameters.map(|p| f64::from(u8::from(p == i))))
}

/// Components of the gradient and their indices: all of a few, some of many.
pub fn some_components<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: &[f64],
    starts: &[f64],
    flow: Flow,
    rng: &mut Rng,
) -> Vec<(usize, f64)> {
    let all = theta.len() <= ALL;
    let indices: Vec<usize> =
        if all { (0..theta.len()).collect() } else { (0..16).map(|_| rng.random_range(0..theta.len())).collect() };
    let together = indices.chunks(TOGETHER).flat_map(|some| {
        let unit = |i: usize| std::array::from_fn(|k| if some.get(k) == Some(&i) { 1.0 } else { 0.0 });
        some.iter().copied().zip(derivatives(task, policy, theta, starts, flow, unit))
    });
    together.collect()
}

/// Random directions and the derivatives in them.
pub fn some_directions<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: &[f64],
    starts: &[f64],
    flow: Flow,
    rng: &mut Rng,
) -> Vec<(Vec<f64>, f64)> {
    let directions: [Vec<f64>; TOGETHER] = std::array::from_fn(|_| dense(rng, theta.len()));
    let slopes = derivatives(task, policy, theta, starts, flow, |i| std::array::from_fn(|k| directions[k][i]));
    directions.into_iter().zip(slopes).collect()
}

/// `(∂N/∂x)ᵀ u_bar` of every column.
pub fn policy_input_gradient<P: Policy>(policy: &P, theta: &[f64], x: &[f64], u_bar: &[f64]) -> Vec<f64> {
    let theta: Vec<Num> = theta.iter().map(|&t| Num::from_re(t)).collect();
    let columns = x.chunks_exact(policy.state_dim()).zip(u_bar.chunks_exact(policy.control_dim()));
    columns.flat_map(|(x, u_bar)| pulled_back(x, u_bar, &|x, u| policy.act(&theta, x, u))).collect()
}

/// `(∂S/∂x)ᵀ next_bar` and `(∂S/∂u)ᵀ next_bar`.
pub fn step_vjp<S: System>(system: &S, x: &[f64], u: &[f64], next_bar: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = x.len();
    let mut x_bar = pulled_back(&[x, u].concat(), next_bar, &|xu, next| step(system, &xu[..n], &xu[n..], next));
    let u_bar = x_bar.split_off(n);
    (x_bar, u_bar)
}

/// `(∂f/∂inputs)ᵀ bar`.
fn pulled_back(inputs: &[f64], bar: &[f64], f: &dyn Fn(&[Num], &mut [Num])) -> Vec<f64> {
    let mut outputs = vec![Num::from_re(0.0); bar.len()];
    let mut inputs_bar = Vec::with_capacity(inputs.len());
    for first in (0..inputs.len()).step_by(TOGETHER) {
        let lift = |(i, &input): (usize, &f64)| match i.checked_sub(first) {
            Some(k) if k < TOGETHER => seeded(input, unit(k)),
            _ => Num::from_re(input),
        };
        f(&inputs.iter().enumerate().map(lift).collect::<Vec<_>>(), &mut outputs);
        for k in 0..TOGETHER.min(inputs.len() - first) {
            inputs_bar.push(outputs.iter().zip(bar).map(|(output, bar)| tangents(output)[k] * bar).sum());
        }
    }
    inputs_bar
}

fn unit(k: usize) -> [f64; TOGETHER] {
    std::array::from_fn(|i| f64::from(u8::from(i == k)))
}

/// `⟨u_bar, (∂N/∂θ) v⟩` of every column, for the directions v that `tangent(parameter)` spans.
fn policy_slopes<P: Policy>(
    policy: &P,
    theta: &[f64],
    x: &[f64],
    u_bar: &[f64],
    tangent: impl Fn(usize) -> [f64; TOGETHER],
) -> [Vec<f64>; TOGETHER] {
    let (n, m) = (policy.state_dim(), policy.control_dim());
    let lift = |(i, &t): (usize, &f64)| match tangent(i) {
        // Without a tangent of its own, a number is cheaper to multiply.
        zero if zero == [0.0; TOGETHER] => Num::from_re(t),
        tangents => seeded(t, tangents),
    };
    let theta: Vec<_> = theta.iter().enumerate().map(lift).collect();
    let mut slopes = [(); TOGETHER].map(|()| Vec::with_capacity(x.len() / n));
    for (x, u_bar) in x.chunks_exact(n).zip(u_bar.chunks_exact(m)) {
        let x: Vec<Num> = x.iter().map(|&x| Num::from_re(x)).collect();
        let mut u = vec![Num::from_re(0.0); m];
        policy.act(&theta, &x, &mut u);
        for (k, slopes) in slopes.iter_mut().enumerate() {
            slopes.push(u.iter().zip(u_bar).map(|(u, u_bar)| tangents(u)[k] * u_bar).sum());
        }
    }
    slopes
}

/// `(∂N/∂θᵢ)ᵀ u_bar` of every column, for some of the parameters.
pub fn policy_components<P: Policy>(
    policy: &P,
    theta: &[f64],
    x: &[f64],
    u_bar: &[f64],
    indices: &[usize],
) -> Vec<(usize, Vec<f64>)> {
    let together = indices.chunks(TOGETHER).flat_map(|some| {
        let unit = |i: usize| std::array::from_fn(|k| if some.get(k) == Some(&i) { 1.0 } else { 0.0 });
        some.iter().copied().zip(policy_slopes(policy, theta, x, u_bar, unit))
    });
    together.collect()
}

/// Random directions, and `⟨u_bar, (∂N/∂θ) v⟩` of every column in them.
pub fn policy_directions<P: Policy>(
    policy: &P,
    theta: &[f64],
    x: &[f64],
    u_bar: &[f64],
    rng: &mut Rng,
) -> Vec<(Vec<f64>, Vec<f64>)> {
    let directions: [Vec<f64>; TOGETHER] = std::array::from_fn(|_| dense(rng, theta.len()));
    let slopes = policy_slopes(policy, theta, x, u_bar, |i| std::array::from_fn(|k| directions[k][i]));
    directions.into_iter().zip(slopes).collect()
}

/// A direction in which every parameter has a part: of either sign, its size between 1/2 and 3/2. One wrong component
/// cannot hide in it, and several do not cancel but by chance.
fn dense(rng: &mut Rng, len: usize) -> Vec<f64> {
    (0..len).map(|_| rng.random_range(0.5..1.5) * if rng.random() { 1.0 } else { -1.0 }).collect()
}
