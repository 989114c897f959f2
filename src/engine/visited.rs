//! [`Visited`]: what samples visited in a run, for targets of a value function.

use crate::engine::any::AnyTask;
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::{Float, LANES, Lane, Scalar};

/// States, observations and costs of samples along their rollouts.
#[derive(Clone, Debug, Default)]
pub(crate) struct Visited<F> {
    /// `[sample][step][component]`, steps 0 to T.
    pub(crate) states: Vec<F>,
    /// `[sample][step][component]`, steps 0 to T.
    pub(crate) observations: Vec<F>,
    /// Running costs, `[sample][step]`, steps 0 to T - 1.
    pub(crate) costs: Vec<F>,
}

impl<F: Float> Visited<F> {
    pub(crate) fn clear(&mut self) {
        self.lists().into_iter().for_each(Vec::clear);
    }

    /// Moves the samples of `other` to the end.
    pub(crate) fn take(&mut self, other: &mut Self) {
        self.lists().into_iter().zip(other.lists()).for_each(|(own, other)| own.append(other));
    }

    fn lists(&mut self) -> [&mut Vec<F>; 3] {
        [&mut self.states, &mut self.observations, &mut self.costs]
    }

    /// Appends the samples of a rollout with a tape.
    pub(crate) fn append(&mut self, task: &dyn AnyTask<F>, rollout: &Rollout<F>) {
        rollout.append(&mut self.states, &mut Vec::new());
        let (steps, samples, n) = (rollout.horizon, rollout.samples, rollout.state_dim);
        let (blocks, k) = (samples.div_ceil(LANES), rollout.observed_dim);
        let mut lanes = vec![Lane::<F>::zero(); blocks * k];
        let all = &mut self.observations;
        let first = all.len();
        all.resize(first + samples * (steps + 1) * k, F::zero());
        for t in 0..=steps {
            match task.own_observation() {
                None => lanes.copy_from_slice(rollout.states_at(t)),
                Some(_) => task.observe(rollout.observed_at(t), &mut lanes),
            }
            for sample in 0..samples {
                let y = &mut all[first + (sample * (steps + 1) + t) * k..][..k];
                let block = &lanes[sample / LANES * k..][..k];
                y.iter_mut().zip(block).for_each(|(y, lanes)| *y = lanes.0[sample % LANES]);
            }
        }
        let first = self.costs.len();
        self.costs.resize(first + samples * steps, F::zero());
        for t in 0..steps {
            for block in 0..blocks {
                let next = &rollout.states_at(t + 1)[block * n..][..n];
                let cost = task.running_cost(rollout.inputs_of(t, block), next);
                let of_block = (block * LANES..samples).take(LANES).enumerate();
                of_block.for_each(|(lane, sample)| {
                    self.costs[first + sample * steps + t] = cost.0[lane];
                });
            }
        }
    }
}
