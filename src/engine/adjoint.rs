//! [`Flow`] and [`Adjoint`]: the adjoint recursion, for one or two flows of one forward pass.
//!
//! ```text
//! λ ← ∂φ/∂x_T,  μ ← 0
//! for t = T-1 .. 0:
//!     λ ← λ + ∂l/∂x_{t+1}
//!     h_t ← (∂S/∂u)ᵀ λ + ∂l/∂u_t
//!     ȳ, m̄ ← (∂N/∂(y, m))ᵀ (h_t, μ)
//!     λ ← physics·(∂S/∂x)ᵀ λ + ∂l/∂x_t + control·(∂y/∂x)ᵀ ȳ
//!     g ← g + (∂N/∂θ)ᵀ (h_t, μ)                        in matrix products over units of steps
//!     μ ← memory·m̄
//! ```
//!
//! λ is the cotangent of the state, h that of the control. μ is the cotangent of the memory after
//! step t. Policies without a memory have no μ. g, initially 0, is the parameter gradient. [`Flow`]
//! defines the weights physics, control and memory, and the other symbols.
//!
//! λ, h and μ of every sample are mantissas times a common power of two, so they neither overflow
//! nor underflow. Within a moderate range the power is 1, and results are bitwise those of plain
//! numbers.

mod cost_gradient;
mod exponents;
mod given;
mod measure;
mod policy;
mod recursion;
mod restart;
mod reverse_step;
mod starts;
mod state;
mod step_back;

use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::pass::{Closed, Pass};
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::Float;
use crate::policy::AnyPolicy;
use crate::policy::{PolicyPass, Weights};
use given::Given;
use policy::{PolicyAdjoint, PolicyBufferSizes, nested_bytes};
use state::Recursion;
use std::ops::Range;
pub use step_back::StepBack;

/// Workspace of the reverse pass of a [`Rollout`]. The constructor,
/// [`keep_norms`](Adjoint::keep_norms) and [`keep_start_gradients`](Adjoint::keep_start_gradients)
/// allocate all buffers.
///
/// A run allocates only in the cases that [`Rollout`] lists, and for gradients with respect to
/// physical numbers that vary.
#[derive(Debug)]
pub struct Adjoint<F: Float> {
    horizon: usize,
    /// Largest number of samples.
    samples: usize,
    param_dim: usize,
    /// Norms of λ, per flow and step, if recorded.
    norms: Option<Vec<Vec<f64>>>,
    /// True if [`measure`](Adjoint::measure) requested the growth of λ.
    measured: bool,
    policy: PolicyAdjoint<F>,
    carried: Carried<F>,
}

/// Flows, and the state of their recursion.
#[derive(Debug)]
enum Carried<F: Float> {
    One([Flow; 1], Recursion<F, 1>),
    Two([Flow; 2], Recursion<F, 2>),
}

impl<F: Float> Adjoint<F> {
    /// Allocates a workspace for the gradients of one or two flows.
    ///
    /// Two flows share one pass through the physics, which always evaluates `∂S/∂x`. A workspace
    /// for N or S alone does not evaluate `∂S/∂x`.
    ///
    /// # Panics
    /// If `flows` does not have one or two elements, or `rollout` has no tape.
    #[track_caller]
    #[inline(never)]
    pub fn new(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        rollout: &Rollout<F>,
        flows: &[Flow],
    ) -> Self {
        assert!(
            rollout.has_tape(),
            "a rollout created for evaluation stores no tape, so it has no reverse pass"
        );
        Self::of_kept(task, policy, rollout, flows)
    }

    /// Allocates a workspace for the stored steps of a rollout, which may be fewer than the
    /// horizon.
    #[track_caller]
    pub(crate) fn of_kept(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        rollout: &Rollout<F>,
        flows: &[Flow],
    ) -> Self {
        let carried = match *flows {
            [flow] => Carried::One([flow], Recursion::new(rollout)),
            [first, second] => Carried::Two([first, second], Recursion::new(rollout)),
            _ => panic!("an adjoint has one or two flows, not {}", flows.len()),
        };
        let buffers = PolicyAdjoint::new(&PolicyBufferSizes::new(
            task,
            policy,
            rollout.capacity(),
            rollout.kept,
            flows,
        ));
        let (samples, param_dim) = (rollout.capacity(), task.param_dim());
        let adjoint = Self {
            horizon: rollout.horizon,
            samples,
            param_dim,
            norms: None,
            measured: false,
            policy: buffers,
            carried,
        };
        if policy.trained_params().is_empty() { adjoint } else { adjoint.keep_start_gradients() }
    }

    /// Flows of the workspace, in order.
    pub fn flows(&self) -> &[Flow] {
        match &self.carried {
            Carried::One(flows, _) => flows,
            Carried::Two(flows, _) => flows,
        }
    }

    /// Bytes on the heap, without the rollout. Independent of the number of samples started.
    pub fn stored_bytes(&self) -> usize {
        let carried = match &self.carried {
            Carried::One(_, recursion) => recursion.stored_bytes(),
            Carried::Two(_, recursion) => recursion.stored_bytes(),
        };
        carried + self.policy.stored_bytes() + self.norms.as_deref().map_or(0, nested_bytes)
    }

    /// Returns the [`stored_bytes`](Adjoint::stored_bytes) of [`of_kept`](Adjoint::of_kept), for a
    /// rollout that stores `kept` steps.
    pub(crate) fn bytes_of(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        kept: usize,
        flows: &[Flow],
    ) -> usize {
        let dims = [task.state_dim(), task.control_dim(), policy.memory_dim()];
        let params = (!policy.trained_params().is_empty()).then(|| task.param_dim());
        let carried = match flows.len() {
            1 => Recursion::<F, 1>::bytes_of(dims, params, samples),
            _ => Recursion::<F, 2>::bytes_of(dims, params, samples),
        };
        carried + PolicyBufferSizes::new(task, policy, samples, kept, flows).bytes::<F>()
    }

    /// Records the norm of the adjoint at every step of subsequent runs, for
    /// [`norms`](Adjoint::norms).
    pub fn keep_norms(mut self) -> Self {
        self.norms = Some(vec![vec![f64::NAN; self.horizon + 1]; self.flows().len()]);
        self
    }

    /// Norms of the adjoint of flow `k` at the states `x_0 .. x_T` of the last run, `horizon + 1`
    /// numbers.
    ///
    /// Each is the root mean square of ‖λ_t‖ over the samples. λ_t is the adjoint of the loss of
    /// one sample, without the `scale` of the run. The norm measures how strongly later costs
    /// depend on a state, along the paths of the flow. λ_t contains the costs of step t and of
    /// later steps, not the cost of the step that ends in `x_t`. λ_T is the gradient of the
    /// terminal cost, or 0 without a terminal cost. Steps that a diverged run did not reach are
    /// NaN.
    ///
    /// # Panics
    /// Without [`keep_norms`](Adjoint::keep_norms), or if `k` is not below the number of flows.
    #[track_caller]
    pub fn norms(&self, k: usize) -> &[f64] {
        &self.norms.as_ref().expect("the norms of an adjoint are stored only after `keep_norms`")[k]
    }

    /// Records the gradients with respect to initial states and parameters p in later runs, for
    /// [`start_gradient`](Adjoint::start_gradient). The constructor enables this for policies that
    /// train entries of p.
    pub fn keep_start_gradients(mut self) -> Self {
        match &mut self.carried {
            Carried::One(_, recursion) => {
                recursion.keep_start_gradients(self.samples, self.param_dim)
            }
            Carried::Two(_, recursion) => {
                recursion.keep_start_gradients(self.samples, self.param_dim)
            }
        }
        self
    }

    /// Makes later runs differentiate `Σ states_bar · states + Σ controls_bar · controls` in place of
    /// the costs, so that any function of a trajectory has a gradient.
    ///
    /// The layout is `[sample][step][component]`, with T + 1 states and T controls for each sample
    /// of a rollout. The next run must have as many samples.
    ///
    /// # Panics
    /// If the lengths are not those of a number of samples between 1 and the capacity.
    #[track_caller]
    pub fn give(&mut self, states_bar: &[F], controls_bar: &[F]) {
        let horizon = self.horizon;
        let [n, m] = match &self.carried {
            Carried::One(_, recursion) => recursion.dims(),
            Carried::Two(_, recursion) => recursion.dims(),
        };
        let samples = states_bar.len() / ((horizon + 1) * n);
        assert!(
            (1..=self.samples).contains(&samples)
                && states_bar.len() == samples * (horizon + 1) * n
                && controls_bar.len() == samples * horizon * m,
            "{} and {} cotangents are not those of {horizon} steps of up to {} samples with {n} states and {m} controls",
            states_bar.len(),
            controls_bar.len(),
            self.samples
        );
        let given = Given::new(states_bar, controls_bar, samples, horizon);
        match &mut self.carried {
            Carried::One(_, recursion) => recursion.given = Some(given),
            Carried::Two(_, recursion) => recursion.given = Some(given),
        }
    }

    /// Gradient of the cost of `sample` with respect to its initial state and parameters p, along
    /// flow `k`.
    ///
    /// The first `state_dim` values are derivatives with respect to the initial state, the next
    /// `param_dim` with respect to p. All are multiplied by the `scale` of the last run. If that
    /// run diverged, the values are invalid.
    ///
    /// A flow has weights only for paths through state, observation and memory. The direct effects
    /// of p on steps and costs have weight 1. The effect of p on the observation has weight
    /// `control`.
    ///
    /// ```
    /// use physgrad::policy::Linear;
    /// use physgrad::prelude::*;
    /// use physgrad::{Adjoint, Flow, Rollout, Weights};
    ///
    /// /// x_{t+1} = p x_t + u_t for one step, with the cost x_1.
    /// struct Growth;
    /// impl System for Growth {
    ///     fn state_dim(&self) -> usize { 1 }
    ///     fn control_dim(&self) -> usize { 1 }
    ///     fn param_dim(&self) -> usize { 1 }
    ///     fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
    ///         next[0] = p[0] * x[0] + u[0];
    ///     }
    /// }
    /// impl Task for Growth {
    ///     type System = Self;
    ///     fn system(&self) -> &Self { self }
    ///     fn horizon(&self) -> usize { 1 }
    ///     fn start(&self, _: &mut Rng, Start { x, p }: Start<'_>) { (x[0], p[0]) = (3.0, 2.0) }
    ///     fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T { x[0] }
    /// }
    ///
    /// let policy = Linear::new(1, 1);
    /// let gain = Weights::<f64>::new(&policy, vec![-0.5]);
    /// let mut rollout = Rollout::new(&Growth, &policy, 1);
    /// rollout.start(&[3.0, 2.0]);
    /// rollout.run(&Growth, &policy, &gain)?;
    /// let mut adjoint = Adjoint::new(&Growth, &policy, &rollout, &[Flow::REGULAR]).keep_start_gradients();
    /// adjoint.run(&Growth, &policy, &gain, &rollout, 1.0)?;
    /// // ∂x_1/∂x_0 = p + gain, ∂x_1/∂p = x_0.
    /// assert_eq!(adjoint.start_gradient(0, 0).to_vec(), [1.5, 3.0]);
    /// # Ok::<(), physgrad::Divergence>(())
    /// ```
    ///
    /// # Panics
    /// If the gradients are not recorded; see
    /// [`keep_start_gradients`](Adjoint::keep_start_gradients). If `sample` is not below the
    /// capacity, or `k` is not below the number of flows.
    #[track_caller]
    pub fn start_gradient(&self, k: usize, sample: usize) -> &Gradient<F> {
        let missing = "the gradients with respect to initial states are stored only after `keep_start_gradients`";
        match &self.carried {
            Carried::One(_, recursion) => recursion.starts.as_ref().expect(missing).of(k, sample),
            Carried::Two(_, recursion) => recursion.starts.as_ref().expect(missing).of(k, sample),
        }
    }

    /// Enables or disables the measurement of growth.
    pub(crate) fn measure(&mut self, measured: bool) {
        self.measured = measured;
    }

    /// Returns true if runs measure growth, on request or for flows that cut.
    pub(crate) fn measures(&self) -> bool {
        self.measured || self.flows().iter().any(|flow| flow.cut.is_some())
    }

    /// Calls `add` with the two numbers of [`Growth`](crate::engine::Growth) of flow `k`, for each
    /// sample of the last run. Both are 0 if not measured.
    pub(crate) fn growth(&self, k: usize, samples: usize, add: &mut dyn FnMut([f64; 2])) {
        match &self.carried {
            Carried::One(_, recursion) => {
                recursion.growth().of(k, samples).for_each(|meter| add(meter.growth()))
            }
            Carried::Two(_, recursion) => {
                recursion.growth().of(k, samples).for_each(|meter| add(meter.growth()))
            }
        }
    }

    /// Runs the recursion backwards through `rollout`.
    ///
    /// All cotangents are multiplied by `scale`. Use 1 / batch size for the gradient of a batch
    /// mean.
    ///
    /// # Errors
    /// [`Divergence`] if a cotangent of a state, control or memory is non-finite. Does not check
    /// the gradients with respect to parameters and initial states.
    ///
    /// # Panics
    /// If the rollout has no tape, another horizon, or more samples than the workspace.
    #[track_caller]
    #[inline(never)]
    pub fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        rollout: &Rollout<F>,
        scale: F,
    ) -> Result<(), Divergence> {
        let (found, expected) = (rollout.horizon, self.horizon);
        assert!(
            rollout.has_tape(),
            "an adjoint needs a rollout that stores all steps: use `Rollout::new`"
        );
        assert_eq!(
            found, expected,
            "the rollout has {found} steps, but the adjoint has {expected}"
        );
        let (found, capacity) = (rollout.samples, self.samples);
        assert!(
            found <= capacity,
            "the rollout has {found} samples, but the adjoint has space for {capacity}"
        );
        let closed = Closed { task, policy, weights };
        let pass = Pass { closed, rollout, scale, measured: self.measures() };
        self.begin(&pass);
        Rollout::<F>::units(0..rollout.horizon).try_for_each(|unit| self.back(&pass, unit))
    }

    /// Initializes the recursion with the gradient of the terminal cost.
    pub(crate) fn begin(&mut self, pass: &Pass<'_, F>) {
        let norms = self.norms.as_deref_mut().unwrap_or_default();
        norms.iter_mut().for_each(|norms| norms.fill(f64::NAN));
        self.policy.reset_exponents();
        match &mut self.carried {
            Carried::One(_, recursion) => recursion.begin(pass, norms),
            Carried::Two(_, recursion) => recursion.begin(pass, norms),
        }
    }

    /// Runs the recursion backwards through the stored steps of a unit, from its last state.
    pub(crate) fn back(
        &mut self,
        pass: &Pass<'_, F>,
        unit: Range<usize>,
    ) -> Result<(), Divergence> {
        let all = pass.rollout.columns_of(&unit, 0..pass.rollout.samples);
        self.policy.reset_exponents_of(all);
        if self.policy.linearized {
            self.policy.backward(pass, 0, all, unit.clone(), true);
        }
        let norms = self.norms.as_deref_mut().unwrap_or_default();
        let steps = unit.clone();
        match &mut self.carried {
            Carried::One(flows, recursion) => {
                recursion.back(pass, pass.closed.task, *flows, steps, &mut self.policy, norms)?
            }
            Carried::Two(flows, recursion) => {
                recursion.back(pass, pass.closed.task, *flows, steps, &mut self.policy, norms)?
            }
        }
        for k in 0..self.flows().len() {
            if !self.policy.through_inputs(self.flows()[k]) && !self.policy.linearized {
                // Without a path through the policy's inputs, one policy pass covers all steps of
                // the unit.
                self.policy.backward(pass, k, all, unit.clone(), false);
            }
        }
        Ok(())
    }

    /// Computes the parameter gradient `Σ_t (∂N/∂θ)ᵀ (h_t, μ)` of flow `k`, summed over `samples`.
    ///
    /// Includes the gradient with respect to the trained entries of p. Overwrites `theta_bar`.
    /// Policy, weights and rollout must be those of the last [`run`](Adjoint::run).
    ///
    /// # Panics
    /// If `samples` exceeds the samples of the rollout, the rollout has no tape, or `k` is not
    /// below the number of flows.
    #[track_caller]
    #[inline(never)]
    pub fn param_gradient(
        &mut self,
        k: usize,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        rollout: &Rollout<F>,
        samples: Range<usize>,
        theta_bar: &mut Gradient<F>,
    ) {
        let (end, count) = (samples.end, rollout.samples);
        assert!(end <= count, "the range of samples ends at {end}, but the rollout has {count}");
        assert!(
            rollout.has_tape(),
            "a parameter gradient needs the rollout of the last run of the adjoint"
        );
        theta_bar.clear();
        for unit in Rollout::<F>::units(0..rollout.horizon) {
            let at = rollout.columns_of(&unit, samples.clone());
            let pass = PolicyPass::new(weights.packed(), at, rollout.inputs()).at_steps(unit);
            self.policy.add_param_gradient(k, policy, pass, &rollout.tape, theta_bar);
        }
        self.add_trained_gradient(k, policy, weights, samples, theta_bar);
        theta_bar.normalize();
    }

    /// Adds the gradient with respect to the trained entries of `p`, after the whole recursion.
    pub(crate) fn add_trained_gradient(
        &self,
        k: usize,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        samples: Range<usize>,
        theta_bar: &mut Gradient<F>,
    ) {
        let (params, trained) = (policy.trained_params(), weights.trained(policy));
        let first = weights.theta().len() - params.len();
        for (i, (param, r)) in params.iter().zip(trained).enumerate() {
            let slope = F::from_f64(param.slope(r.as_()));
            for sample in samples.clone() {
                let (by_p, exponent) = match &self.carried {
                    Carried::One(_, recursion) => recursion.by_param(k, sample, param.index()),
                    Carried::Two(_, recursion) => recursion.by_param(k, sample, param.index()),
                };
                theta_bar.add_at(first + i, by_p * slope, exponent);
            }
        }
    }

    /// Adds the contribution of a unit to the parameter gradient, after [`back`](Self::back).
    pub(crate) fn add_param_gradient(
        &mut self,
        k: usize,
        pass: &Pass<'_, F>,
        unit: &Range<usize>,
        samples: Range<usize>,
        theta_bar: &mut Gradient<F>,
    ) {
        let (Closed { policy, weights, .. }, rollout) = (pass.closed, pass.rollout);
        let at = rollout.columns_of(unit, samples);
        let pass = PolicyPass::new(weights.packed(), at, rollout.inputs()).at_steps(unit.clone());
        self.policy.add_param_gradient(k, policy, pass, &rollout.tape, theta_bar);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Task;
    use crate::dynamics::inputs::Start;
    use crate::numbers::kernels::portable;
    use crate::numbers::rng::{Purpose, stream};
    use crate::policy::Mlp;
    use crate::tasks::CartPole;

    /// Returns costs, the first state component at step 100, and the gradients of three flows.
    fn results<F: Float>(samples: usize) -> Vec<F> {
        let task = CartPole::new(2);
        let policy = Mlp::new(vec![6, 8, 1]);
        let weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Policy, 0));
        let mut starts = vec![0.0; 6 * samples];
        for (i, x) in starts.chunks_exact_mut(6).enumerate() {
            Task::start(&task, &mut stream(0, Purpose::Train, i as u64), Start { x, p: &mut [] });
        }
        let starts: Vec<F> = starts.into_iter().map(F::from_f64).collect();
        let mut rollout = Rollout::new(&task, &policy, 16);
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        let mut all: Vec<F> = (0..samples)
            .flat_map(|sample| [rollout.cost(sample), rollout.state(100, sample, 0)])
            .collect();
        for flows in [&[Flow::REGULAR, Flow::MODIFIED][..], &[Flow::STOPPED]] {
            let mut adjoint = Adjoint::new(&task, &policy, &rollout, flows);
            adjoint.run(&task, &policy, &weights, &rollout, F::one()).expect("finite");
            for k in 0..flows.len() {
                let mut theta_bar = Gradient::zeros(weights.theta().len());
                adjoint.param_gradient(k, &policy, &weights, &rollout, 0..samples, &mut theta_bar);
                all.extend(theta_bar.to_vec());
            }
        }
        all
    }

    #[test]
    fn portable_and_vectorized_passes_of_1_8_and_13_samples_are_bitwise_equal() {
        for samples in [1, 8, 13] {
            assert_eq!(results::<f32>(samples), portable::force(|| results::<f32>(samples)));
            assert_eq!(results::<f64>(samples), portable::force(|| results::<f64>(samples)));
        }
    }
}
