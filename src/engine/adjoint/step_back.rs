//! [`reverse_step`] for all samples, one block of lanes at a time.

use super::exponents::Limits;
use super::reverse_step::{BlockStep, reverse_step};
use super::state::Recursion;
use crate::dynamics::task::Task;
use crate::engine::flow::Flow;
use crate::engine::rollout::Rollout;
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::scalar::Float;

/// Reverse step of a task for all samples and `K` flows.
pub trait StepBack<F: Float, const K: usize> {
    /// Applies costs and physics to all blocks. Returns false if rescaling is needed or a cotangent
    /// is non-finite.
    fn step_back(
        &self,
        flows: [Flow; K],
        rollout: &Rollout<F>,
        t: usize,
        carried: &mut Recursion<F, K>,
    ) -> bool;
}

impl<T: Task, F: Float, const K: usize> StepBack<F, K> for T {
    #[inline(never)]
    fn step_back(
        &self,
        flows: [Flow; K],
        rollout: &Rollout<F>,
        t: usize,
        carried: &mut Recursion<F, K>,
    ) -> bool {
        let mut in_range = true;
        dispatch_lanes(Back { task: self, flows, rollout, t, carried, in_range: &mut in_range });
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

impl<T: Task, F: Float, const K: usize> Vectorized for Back<'_, T, F, K> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { task, flows, rollout, t, carried: r, in_range } = self;
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let outputs = m + rollout.memory_dim;
        let next = rollout.states_at(t + 1);
        let limits = Limits::new();
        for block in 0..next.len() / n {
            let of_state = block * n..(block + 1) * n;
            let (u_bar, memory_bar) = r.u_bar[block * outputs..][..outputs].split_at_mut(m);
            if let Some(given) = &r.given {
                given.write(t, block, &mut r.cost);
            }
            let step = BlockStep {
                inputs: rollout.inputs_of(t, block),
                next: &next[of_state.clone()],
                lambda: &mut r.lambda[of_state.clone()],
                x_bar: &mut r.x_bar[of_state],
                u_bar,
                p_bar: r.starts.as_mut().map(|starts| starts.of_block(block)),
                memory_bar,
                cost: &mut r.cost,
                is_given: r.given.is_some(),
                inject: r.exponents.blocks[block].inject,
            };
            let size = reverse_step(task, flows, step);
            if let Some(starts) = &mut r.starts {
                starts.set_cost(block, &r.cost.p);
            }
            for column in &size.0 {
                for &size in &column.0 {
                    *in_range &= limits.holds(size, r.exponents.any);
                }
            }
        }
    }
}
