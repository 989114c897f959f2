//! [`Flow`] and [`Adjoint`]: the adjoint recursion, for one or two vector fields from one forward pass.
//!
//! ```text
//! λ ← ∂φ/∂x_T
//! for t = T-1 .. 0:
//!     λ ← λ + ∂l/∂x(x_{t+1}, u_t)
//!     h_t ← (∂S/∂u)ᵀ λ + ∂l/∂u(x_{t+1}, u_t)
//!     λ ← physics·(∂S/∂x)ᵀ λ + control·(∂N/∂x)ᵀ h_t
//! g ← Σ_t (∂N/∂θ)ᵀ h_t                                 in large products, a fixed number of steps at a time
//! ```
//!
//! λ and h of every sample are mantissas times a power of two, so that they neither overflow nor vanish; where that power
//! is 1, as it is unless they are far from it, all bits are those of plain numbers.

mod exponents;
mod policy;
mod recursion;
mod step;

use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::gradient::Gradient;
use crate::engine::growth::Together;
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::Float;
use crate::policy::AnyPolicy;
use crate::policy::{PolicyPass, Weights};
use policy::{PolicyAdjoint, PolicyRoom, nested_bytes};
use recursion::Recursion;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Range;
pub use step::StepBack;

/// Which paths carry the adjoint back in time. The forward values are the same for all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Flow {
    /// Through the physics, `∂S/∂x`.
    pub physics: bool,
    /// Through the policy's input, `∂N/∂x`.
    pub control: bool,
}

impl Flow {
    /// R: full backpropagation through time, the true gradient.
    pub const REGULAR: Self = Self { physics: true, control: true };
    /// M: the physics path only; the policy's input is detached.
    pub const MODIFIED: Self = Self { physics: true, control: false };
    /// N: the policy's path only; the physics' state input is detached.
    pub const NETWORK: Self = Self { physics: false, control: true };
    /// S: neither; every control sees only the cost of the step it caused.
    pub const STOPPED: Self = Self { physics: false, control: false };
    /// All four.
    pub const ALL: [Self; 4] = [Self::REGULAR, Self::MODIFIED, Self::NETWORK, Self::STOPPED];
}

impl fmt::Display for Flow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.physics, self.control) {
            (true, true) => "R",
            (true, false) => "M",
            (false, true) => "N",
            (false, false) => "S",
        })
    }
}

/// Room for the reverse pass of a [`Rollout`]: sized once, then run without allocating.
#[derive(Debug)]
pub struct Adjoint<F: Float> {
    horizon: usize,
    /// Lengths of λ, per flow and step, if they are to be kept.
    norms: Option<Vec<Vec<f64>>>,
    /// Whether the next run measures the growth of λ.
    measured: bool,
    policy: PolicyAdjoint<F>,
    carried: Carried<F>,
}

/// The flows, and what the recursion carries for them.
#[derive(Debug)]
enum Carried<F: Float> {
    One([Flow; 1], Recursion<F, 1>),
    Two([Flow; 2], Recursion<F, 2>),
}

impl<F: Float> Adjoint<F> {
    /// Room for the gradients of one or two flows of such a rollout. Two are carried through the physics together, to state
    /// and control: only N or S alone spares the system its derivative to the state.
    ///
    /// # Panics
    /// With no flow or more than two, or a rollout without tape.
    #[track_caller]
    pub fn new(policy: &dyn AnyPolicy<F>, rollout: &Rollout<F>, flows: &[Flow]) -> Self {
        assert!(rollout.has_tape(), "a rollout made for evaluation cannot be differentiated");
        Self::of_kept(policy, rollout, flows)
    }

    /// The same, for the steps that a rollout keeps.
    #[track_caller]
    pub(crate) fn of_kept(policy: &dyn AnyPolicy<F>, rollout: &Rollout<F>, flows: &[Flow]) -> Self {
        let carried = match *flows {
            [flow] => Carried::One([flow], Recursion::new(rollout)),
            [first, second] => Carried::Two([first, second], Recursion::new(rollout)),
            _ => panic!("an adjoint carries one or two flows, not {}", flows.len()),
        };
        let policy = PolicyAdjoint::new(&PolicyRoom::new(policy, rollout.capacity() * rollout.kept, flows));
        Self { horizon: rollout.horizon, norms: None, measured: false, policy, carried }
    }

    /// The flows it was made for.
    pub fn flows(&self) -> &[Flow] {
        match &self.carried {
            Carried::One(flows, _) => flows,
            Carried::Two(flows, _) => flows,
        }
    }

    /// Bytes on the heap, beyond those of the rollout it belongs to. They do not depend on how many samples are started.
    pub fn stored_bytes(&self) -> usize {
        let carried = match &self.carried {
            Carried::One(_, recursion) => recursion.stored_bytes(),
            Carried::Two(_, recursion) => recursion.stored_bytes(),
        };
        carried + self.policy.stored_bytes() + self.norms.as_deref().map_or(0, nested_bytes)
    }

    /// The [`stored_bytes`](Adjoint::stored_bytes) of an adjoint of a rollout that keeps so many steps.
    pub(crate) fn bytes_of(policy: &dyn AnyPolicy<F>, samples: usize, kept: usize, flows: &[Flow]) -> usize {
        let (n, m) = (policy.state_dim(), policy.control_dim());
        let carried = match flows.len() {
            1 => Recursion::<F, 1>::bytes_of(n, m, samples),
            _ => Recursion::<F, 2>::bytes_of(n, m, samples),
        };
        carried + PolicyRoom::new(policy, samples * kept, flows).bytes::<F>()
    }

    /// Keeps the length of the adjoint at every step of every run from now on, for [`norms`](Adjoint::norms).
    pub fn keep_norms(mut self) -> Self {
        self.norms = Some(vec![vec![f64::NAN; self.horizon + 1]; self.flows().len()]);
        self
    }

    /// The length of the adjoint of flow number `k` at the states `x_0 .. x_T` of the last run, `horizon + 1` numbers:
    /// how strongly what comes after a state depends on it, along the paths of the flow. It is the root mean square over the
    /// samples of ‖λ_t‖ for the loss of a sample. λ_t holds the costs after `x_t`, not that of `x_t` itself; at `T` it
    /// is the terminal cost's gradient, which is 0 where only states on the way are paid for. NaN where a run that
    /// diverged did not come.
    ///
    /// # Panics
    /// Without [`keep_norms`](Adjoint::keep_norms).
    #[track_caller]
    pub fn norms(&self, k: usize) -> &[f64] {
        &self.norms.as_ref().expect("the norms of an adjoint are kept only after `keep_norms`")[k]
    }

    /// Whether the next runs measure how the adjoints grow, which takes a little time.
    pub(crate) fn measure(&mut self, measured: bool) {
        self.measured = measured;
    }

    /// Whether they do.
    pub(crate) fn measures(&self) -> bool {
        self.measured
    }

    /// Adds the growth of flow number `k` in the last run, of every sample, if that was measured.
    pub(crate) fn add_growth(&self, k: usize, samples: usize, together: &mut Together) {
        match &self.carried {
            Carried::One(_, recursion) => recursion.meters(k, samples).for_each(|meter| together.add(meter)),
            Carried::Two(_, recursion) => recursion.meters(k, samples).for_each(|meter| together.add(meter)),
        }
    }

    /// Runs the recursion back through `rollout`. Cotangents are scaled by `scale`: 1 / batch for a batch mean.
    ///
    /// # Errors
    /// [`Divergence`] says where a cotangent was not finite.
    pub fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        rollout: &Rollout<F>,
        scale: F,
    ) -> Result<(), Divergence> {
        let pass = Pass { task, policy, weights, rollout, scale, measured: self.measured };
        self.begin(&pass);
        Rollout::<F>::units(0..rollout.horizon).try_for_each(|unit| self.back(&pass, unit))
    }

    /// Begins at the last state.
    pub(crate) fn begin(&mut self, pass: &Pass<'_, F>) {
        let norms = self.norms.as_deref_mut().unwrap_or_default();
        norms.iter_mut().for_each(|norms| norms.fill(f64::NAN));
        self.policy.reset_exponents();
        match &mut self.carried {
            Carried::One(_, recursion) => recursion.begin(pass, norms),
            Carried::Two(_, recursion) => recursion.begin(pass, norms),
        }
    }

    /// Goes back through the steps of a unit that the rollout keeps, from the state they end with.
    pub(crate) fn back(&mut self, pass: &Pass<'_, F>, unit: Range<usize>) -> Result<(), Divergence> {
        let all = pass.rollout.columns_of(&unit, 0..pass.rollout.samples);
        self.policy.reset_exponents_of(all);
        if self.policy.unit {
            self.policy.backward(pass, 0, all, true);
        }
        let norms = self.norms.as_deref_mut().unwrap_or_default();
        match &mut self.carried {
            Carried::One(flows, recursion) => recursion.back(pass, pass.task, *flows, unit, &mut self.policy, norms)?,
            Carried::Two(flows, recursion) => recursion.back(pass, pass.task, *flows, unit, &mut self.policy, norms)?,
        }
        for k in 0..self.flows().len() {
            if !self.flows()[k].control && !self.policy.unit {
                // Nothing in the loop needed the policy's derivative: all of it at once, without ∂N/∂x.
                self.policy.backward(pass, k, all, false);
            }
        }
        Ok(())
    }

    /// `theta_bar = Σ (∂N/∂θ)ᵀ h` of flow number `k`, over the given samples, in large products. Overwrites it.
    pub fn param_gradient(
        &mut self,
        k: usize,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        rollout: &Rollout<F>,
        samples: Range<usize>,
        theta_bar: &mut Gradient<F>,
    ) {
        theta_bar.clear();
        for unit in Rollout::<F>::units(0..rollout.horizon) {
            self.add_param_gradient(k, policy, weights, rollout, &unit, samples.clone(), theta_bar);
        }
        theta_bar.settle();
    }

    /// Adds the part of a unit that was gone [`back`](Self::back) through.
    #[allow(clippy::too_many_arguments)]
    pub(crate) fn add_param_gradient(
        &mut self,
        k: usize,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        rollout: &Rollout<F>,
        unit: &Range<usize>,
        samples: Range<usize>,
        theta_bar: &mut Gradient<F>,
    ) {
        let pass = PolicyPass { packed: weights.packed(), at: rollout.columns_of(unit, samples), x: rollout.inputs() };
        self.policy.add_param_gradient(k, policy, pass, &rollout.tape, theta_bar);
    }
}

/// What stays the same throughout one reverse pass.
pub(crate) struct Pass<'a, F: Float> {
    pub(crate) task: &'a dyn AnyTask<F>,
    pub(crate) policy: &'a dyn AnyPolicy<F>,
    pub(crate) weights: &'a Weights<F>,
    pub(crate) rollout: &'a Rollout<F>,
    pub(crate) scale: F,
    /// Whether the growth of the adjoints is measured on the way.
    pub(crate) measured: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Task;
    use crate::dynamics::effect::With;
    use crate::numbers::kernels::portable;
    use crate::numbers::rng::{Purpose, stream};
    use crate::policy::Mlp;
    use crate::tasks::{Bumpers, CartDamping, CartPole, CartPoleSystem};

    /// The last state of every sample, the costs, and the gradients of two flows.
    fn all_of_it<F: Float>(samples: usize) -> Vec<F> {
        let system = CartPoleSystem { poles: 2, ..CartPoleSystem::default() };
        let task = CartPole::around(With { system, effects: (CartDamping::default(), Bumpers::default()) });
        let policy = Mlp::new(vec![6, 8, 1]);
        let weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Policy, 0));
        let mut starts = vec![0.0; 6 * samples];
        for (i, x) in starts.chunks_exact_mut(6).enumerate() {
            Task::start(&task, &mut stream(0, Purpose::Train, i as u64), x);
        }
        let starts: Vec<F> = starts.into_iter().map(F::lift).collect();
        let mut rollout = Rollout::new(&task, &policy, 16);
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        let mut all: Vec<F> = (0..samples).flat_map(|sample| [rollout.cost(sample), rollout.state(100, sample, 0)]).collect();
        for flows in [&[Flow::REGULAR, Flow::MODIFIED][..], &[Flow::STOPPED]] {
            let mut adjoint = Adjoint::new(&policy, &rollout, flows);
            adjoint.run(&task, &policy, &weights, &rollout, F::one()).expect("finite");
            for k in 0..flows.len() {
                let mut theta_bar = Gradient::zeros(weights.theta().len());
                adjoint.param_gradient(k, &policy, &weights, &rollout, 0..samples, &mut theta_bar);
                all.extend(theta_bar.plain());
            }
        }
        all
    }

    #[test]
    fn samples_one_by_one_have_the_bits_of_samples_in_lanes() {
        for samples in [1, 8, 13] {
            assert_eq!(all_of_it::<f32>(samples), portable::force(|| all_of_it::<f32>(samples)));
            assert_eq!(all_of_it::<f64>(samples), portable::force(|| all_of_it::<f64>(samples)));
        }
    }
}
