//! [`reverse_step`] for all samples: in lanes, or one by one on processors without AVX2.

use super::Flow;
use super::exponents::Limits;
use super::recursion::{Recursion, Step, reverse_step};
use crate::dynamics::task::Task;
use crate::engine::rollout::{FEW, Lane, Rollout, WIDTH, read_lane};
use crate::numbers::kernels::{Vectorized, dispatch_narrow, in_lanes};
use crate::numbers::scalar::{CotangentPack, Float};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};

/// Reverse step of a task for all samples at once, for `K` flows.
pub trait StepBack<F: Float, const K: usize> {
    /// Applies costs and physics to all blocks. Returns false if rescaling is needed.
    fn step_back(&self, flows: [Flow; K], rollout: &Rollout<F>, t: usize, carried: &mut Recursion<F, K>) -> bool;
}

impl<T: Task, F: Float, const K: usize> StepBack<F, K> for T {
    fn step_back(&self, flows: [Flow; K], rollout: &Rollout<F>, t: usize, carried: &mut Recursion<F, K>) -> bool {
        let mut in_range = true;
        dispatch_narrow(Back { task: self, flows, rollout, t, carried, in_range: &mut in_range });
        in_range
    }
}

struct Back<'a, T, F: Float, const K: usize> {
    task: &'a T,
    flows: [Flow; K],
    rollout: &'a Rollout<F>,
    t: usize,
    carried: &'a mut Recursion<F, K>,
    in_range: &'a mut bool,
}

impl<T: Task, F: Float, const K: usize> Back<'_, T, F, K> {
    #[inline(always)]
    fn in_lanes(self) {
        let Self { task, flows, rollout, t, carried: r, .. } = self;
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let (states, next, controls) = (rollout.states_at(t), rollout.states_at(t + 1), rollout.controls_at(t));
        let limits = Limits::new();
        let mut in_range = true;
        for block in 0..states.len() / n {
            let (of_state, of_control) = (block * n..(block + 1) * n, block * m..(block + 1) * m);
            let step = Step {
                x: &states[of_state.clone()],
                next: &next[of_state.clone()],
                u: &controls[of_control.clone()],
                lambda: &mut r.lambda[of_state.clone()],
                x_bar: &mut r.x_bar[of_state],
                u_bar: &mut r.u_bar[of_control],
                cost_x: &mut r.cost_x,
                cost_u: &mut r.cost_u,
                inject: r.exponents.blocks[block].inject,
            };
            let size = reverse_step(task, flows, step);
            for column in &size.0 {
                for &size in &column.0 {
                    in_range &= limits.holds(size, r.exponents.any);
                }
            }
        }
        *self.in_range = in_range;
    }

    fn one_by_one(self) {
        let Self { task, flows, rollout, t, carried, in_range } = self;
        *in_range = one_by_one(&|step, flow| back_alone(task, step, flow), flows, rollout, t, carried);
    }
}

/// Outlined: one copy of the reverse step serves any number of flows.
#[inline(never)]
fn back_alone<T: Task, F: Float>(task: &T, step: Step<F, 1>, flow: Flow) -> F {
    reverse_step(task, [flow], step).0[0]
}

/// Reverse step of one sample and flow. Returns Σ|λ| + Σ|h|.
type Alone<'a, F> = &'a dyn Fn(Step<F, 1>, Flow) -> F;

/// Performs the reverse step one sample and flow at a time, for processors without AVX2.
///
/// Takes the step as a trait object, so it is compiled once for all tasks.
#[inline(never)]
fn one_by_one<F: Float, const K: usize>(
    alone: Alone<F>,
    flows: [Flow; K],
    rollout: &Rollout<F>,
    t: usize,
    r: &mut Recursion<F, K>,
) -> bool {
    let (n, m) = (rollout.state_dim, rollout.control_dim);
    let mut numbers: SmallVec<[F; FEW]> = smallvec![F::zero(); 3 * n + 2 * m];
    let mut columns: SmallVec<[CotangentPack<F, 1>; FEW]> = smallvec![CotangentPack([F::zero()]); 2 * n + m];
    let (x, rest) = numbers.split_at_mut(n);
    let (next, rest) = rest.split_at_mut(n);
    let (cost_x, rest) = rest.split_at_mut(n);
    let (u, cost_u) = rest.split_at_mut(m);
    let (lambda, rest) = columns.split_at_mut(n);
    let (x_bar, u_bar) = rest.split_at_mut(n);
    let limits = Limits::new();
    let mut in_range = true;
    for sample in 0..rollout.states_at(t).len() / n * WIDTH {
        let (block, lane) = (sample / WIDTH, sample % WIDTH);
        let (of_state, of_control) = (block * n..(block + 1) * n, block * m..(block + 1) * m);
        read_lane(&rollout.states_at(t)[of_state.clone()], lane, x);
        read_lane(&rollout.states_at(t + 1)[of_state.clone()], lane, next);
        read_lane(&rollout.controls_at(t)[of_control.clone()], lane, u);
        for (k, flow) in flows.into_iter().enumerate() {
            for (one, lanes) in zip(lambda.iter_mut(), &r.lambda[of_state.clone()]) {
                *one = CotangentPack([lanes.0[k].0[lane]]);
            }
            let inject = CotangentPack([r.exponents.blocks[block].inject.0[k].0[lane]]);
            let one = Step { x, next, u, lambda, x_bar, u_bar, cost_x, cost_u, inject };
            in_range &= limits.holds(alone(one, flow), r.exponents.any);
            let write = |ones: &[CotangentPack<F, 1>], lanes: &mut [CotangentPack<Lane<F>, K>]| {
                zip(ones, lanes).for_each(|(one, lanes)| lanes.0[k].0[lane] = one.0[0]);
            };
            write(lambda, &mut r.lambda[of_state.clone()]);
            write(u_bar, &mut r.u_bar[of_control.clone()]);
        }
    }
    in_range
}

impl<T: Task, F: Float, const K: usize> Vectorized for Back<'_, T, F, K> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        if in_lanes::<FMA>() { self.in_lanes() } else { self.one_by_one() }
    }
}
