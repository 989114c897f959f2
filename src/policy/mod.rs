//! [`Policy`]: the controller `u = N(y, t; θ)` to be trained, for an observation y.
//!
//! - Feedback: [`Mlp`], [`Conv`], [`Linear`], and the small [`Quadratic`].
//! - Feedback with memory: [`Gru`], [`Elman`].
//! - Open loop: a control sequence, [`OpenLoop`], or one control for all steps, [`Constant`].
//! - Combinations: [`Bounded`] controls, the [`Sum`] of two policies, and [`WithParams`] for
//!   trained parameters of the system.
//! - [`DynPolicy`]: any policy, chosen at run time.
//! - [`AnyPolicy`]: object-safe [`Policy`] for one precision.
//! - [`NetworkLayer`]: layers of a policy, for files that other programs read.
//! - [`Weights`]: parameters together with their packed form.
//!
//! Start with [`Policy::act`]; only large policies need the batched passes.

mod activation;
mod any;
pub(crate) mod blocks;
mod bounded;
mod by_act;
mod controls;
mod conv;
mod dyn_policy;
mod linear;
mod mlp;
mod network;
mod open_loop;
mod recurrent;
mod sum;
mod trained_params;
mod two_params;

pub use activation::Activation;
pub use any::AnyPolicy;
pub use bounded::Bounded;
pub use controls::controls;
pub use conv::Conv;
pub use dyn_policy::DynPolicy;
pub use linear::Linear;
pub use mlp::Mlp;
pub use network::{Bound, InputLayer, LayerKind, NetworkLayer};
pub use open_loop::OpenLoop;
pub use recurrent::{Elman, Gru};
pub use sum::Sum;
pub use trained_params::{TrainedParam, WithParams};
pub use two_params::{Constant, Quadratic};

use crate::numbers::aligned::Aligned;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, LANES, Scalar};
use std::ops::Range;

/// A controller `(u_t, m_{t+1}) = N(y_t, m_t, t; θ)` with parameters `θ` in one flat slice.
///
/// y is the observation, m the memory, of [`memory_dim`](Policy::memory_dim) components, and t the
/// number of the step. Most policies have no memory and do not depend on t. The memory is 0 at the
/// start of a rollout.
///
/// Required: [`observation_dim`](Policy::observation_dim), [`control_dim`](Policy::control_dim),
/// [`param_count`](Policy::param_count), [`init`](Policy::init) and [`act`](Policy::act). The
/// batched passes default to `act` on blocks of up to eight samples. Default derivatives are exact:
/// by dual numbers for at most 16 observed components, memory components and parameters together,
/// otherwise in reverse mode. A policy with large layers overrides all batched passes together;
/// [`check::policy`](crate::check::policy) compares them with `act`.
///
/// # Batched passes
/// The batched passes are [`forward`](Policy::forward), [`backward`](Policy::backward) and
/// [`param_gradient`](Policy::param_gradient). [`sizes`](Policy::sizes) and [`pack`](Policy::pack)
/// prepare their buffers and parameters. The passes work on *columns*. One column is one
/// evaluation: one sample at one time step. `x` holds the observation and the memory of each
/// column. `u` holds the control and the next memory, `u_bar` their cotangents.
///
/// Columns are stored in units of several time steps. Within a unit, the steps of one sample are
/// adjacent, and the samples follow one another. [`PolicyColumns`] selects the columns of a call.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a policy",
    note = "use one of `physgrad::policy`, or implement `physgrad::Policy`: the dimensions, `init` and `act`"
)]
pub trait Policy: Send + Sync {
    /// Number of observed components.
    fn observation_dim(&self) -> usize;
    /// Number of control components.
    fn control_dim(&self) -> usize;
    /// Number of memory components. Default: 0.
    fn memory_dim(&self) -> usize {
        0
    }
    /// Number of parameters, the length of `θ`.
    fn param_count(&self) -> usize;

    /// Draws initial parameters into `theta`.
    fn init(&self, rng: &mut Rng, theta: &mut [f64]);

    /// Writes the control and the next memory, `action.u` and `action.memory`.
    ///
    /// Defines the policy: all other methods must agree with it.
    ///
    /// ```
    /// # use physgrad::{Scalar, policy::{Action, Observed}};
    /// // Proportional and integral feedback; the memory is the sum of the errors.
    /// fn act<T: Scalar>(theta: &[T], Observed { y, memory, .. }: Observed<'_, T>, action: Action<'_, T>) {
    ///     action.memory[0] = memory[0] + y[0];
    ///     action.u[0] = theta[0] * y[0] + theta[1] * action.memory[0];
    /// }
    /// ```
    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>);

    /// Trained entries of the parameters `p` of the system. The last components of `θ` determine
    /// them. Default: none. [`WithParams`] adds trained entries to a policy.
    fn trained_params(&self) -> &[TrainedParam] {
        &[]
    }

    /// Named tensors within `θ`, in order, for export to other programs. Default: one tensor with
    /// the name `theta`.
    fn tensors(&self) -> Vec<Tensor> {
        vec![Tensor {
            name: "theta".into(),
            shape: vec![self.param_count()],
            range: 0..self.param_count(),
        }]
    }

    /// Layers of the policy, for export to other programs. Default: `None`, for policies that are
    /// not a sequence of layers.
    fn network(&self) -> Option<Vec<NetworkLayer>> {
        None
    }

    /// The layer through which alone the policy depends on the observation, for training in units of
    /// the observation. Default: `None`, for policies without such a layer.
    fn input_layer(&self) -> Option<InputLayer> {
        None
    }

    /// Entries of `θ` of a last layer: the weights, row-major, with one column per control, and the
    /// biases after them. It serves for training in units of the ranges of the controls. Default:
    /// `None`, for policies without such a layer.
    fn output_layer(&self) -> Option<Range<usize>> {
        None
    }

    /// Bounds `[low, high]` of each control, which no control of the policy exceeds by more than its
    /// rounding. Default: `None`, for policies without bounds.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        None
    }

    /// Buffer sizes of the batched passes, for a rollout of `columns` columns.
    fn sizes<F: Float>(&self, _columns: usize) -> Sizes {
        Sizes { packed: self.param_count(), tape: 0, tape_bar: 0, scratch: 0 }
    }

    /// Writes `θ` to `packed` in the layout of the batched passes. [`Weights`] calls it after every
    /// change of `θ`.
    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        packed.copy_from_slice(theta);
    }

    /// Evaluates the policy in the columns `pass.at`. Stores intermediate values in `tape`.
    fn forward<F: Float>(&self, pass: PolicyPass<F>, _tape: &mut [F], u: &mut [F]) {
        by_act::forward(self, pass, u);
    }

    /// Writes `x_bar = (∂N/∂(y, m))ᵀ u_bar` in the columns `pass.at`, after
    /// [`forward`](Policy::forward).
    ///
    /// Stores cotangents of intermediate values in `tape_bar`, for
    /// [`param_gradient`](Policy::param_gradient), even if `x_bar` is `None`.
    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        _tape: &[F],
        u_bar: &[F],
        _tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        if let Some(x_bar) = x_bar {
            by_act::input_vjp(self, pass, u_bar, x_bar);
        }
    }

    /// Adds `Σ_c weight[c]·(∂N/∂θ)ᵀ u_bar[c]` to `theta_bar`, after
    /// [`backward`](Policy::backward).
    ///
    /// Sums over the columns `pass.at`, which must be contiguous.
    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        _scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        by_act::add_param_vjp(self, pass, record, theta_bar);
    }
}

/// Inputs of [`Policy::act`].
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a, T> {
    /// Observation, `observation_dim` components.
    pub y: &'a [T],
    /// Memory, `memory_dim` components, 0 at step 0.
    pub memory: &'a [T],
    /// Number of the step, from 0.
    pub t: usize,
}

/// Outputs of [`Policy::act`].
#[derive(Debug)]
pub struct Action<'a, T> {
    /// Control, `control_dim` components.
    pub u: &'a mut [T],
    /// Next memory, `memory_dim` components.
    pub memory: &'a mut [T],
}

/// Evaluates [`Policy::act`] on a concatenated observation and memory, `x`. Writes the concatenated
/// control and next memory to `u`.
#[inline(always)]
pub(crate) fn act_on<P: Policy + ?Sized, T: Scalar>(
    policy: &P,
    theta: &[T],
    x: &[T],
    t: usize,
    u: &mut [T],
) {
    let ((y, memory), (u, next)) =
        (x.split_at(policy.observation_dim()), u.split_at_mut(policy.control_dim()));
    policy.act(theta, Observed { y, memory, t }, Action { u, memory: next });
}

/// Lengths of the inputs and outputs of one column.
fn dims<P: Policy + ?Sized>(policy: &P) -> (usize, usize) {
    let memory = policy.memory_dim();
    (policy.observation_dim() + memory, policy.control_dim() + memory)
}

/// Inputs of the batched passes of a [`Policy`].
#[derive(Clone, Copy, Debug)]
pub struct PolicyPass<'a, F> {
    /// Parameters in the layout of [`Policy::pack`].
    pub packed: &'a [F],
    /// Columns to evaluate.
    pub at: PolicyColumns,
    /// Observation and memory of all columns, `observation_dim + memory_dim` numbers each.
    pub x: &'a [F],
    /// Number of the step of the first column.
    pub first_step: usize,
    /// Number of steps of each sample. The columns of one sample follow one another.
    pub steps: usize,
}

impl<'a, F> PolicyPass<'a, F> {
    /// A pass over columns of step 0.
    pub fn new(packed: &'a [F], at: PolicyColumns, x: &'a [F]) -> Self {
        Self { packed, at, x, first_step: 0, steps: 1 }
    }

    /// Sets the steps of each sample.
    pub fn at_steps(self, steps: Range<usize>) -> Self {
        Self { first_step: steps.start, steps: steps.len(), ..self }
    }

    /// Iterates over the steps, each with the columns of all samples at this step.
    pub fn each_step(&self) -> impl Iterator<Item = (usize, PolicyColumns)> + use<F> {
        let (PolicyColumns { first, step, count }, first_step, steps) =
            (self.at, self.first_step, self.steps);
        let columns = move |i: usize| PolicyColumns {
            first: first + i * step,
            step: step * steps,
            count: count / steps,
        };
        (0..steps).map(move |i| (first_step + i, columns(i)))
    }

    /// Iterates over blocks of at most [`LANES`] samples at one step, each with its step.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = (usize, PolicyColumns)> + use<F> {
        self.each_step().flat_map(|(t, columns)| columns.blocks(LANES).map(move |block| (t, block)))
    }
}

/// Inputs of [`Policy::param_gradient`] in all columns: results of the other passes, cotangents and
/// weights.
#[derive(Clone, Copy, Debug)]
pub struct PolicyRecord<'a, F> {
    /// Values stored by [`Policy::forward`].
    pub tape: &'a [F],
    /// Cotangents of the controls and next memories, the input of [`Policy::backward`].
    pub u_bar: &'a [F],
    /// Cotangents stored by [`Policy::backward`].
    pub tape_bar: &'a [F],
    /// Weight of each column in the gradient; `None` for weights of 1.
    pub weight: Option<&'a [F]>,
}

/// A named, row-major tensor within `θ`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tensor {
    /// Name, for instance `layer1.kernel`.
    pub name: String,
    /// Dimensions.
    pub shape: Vec<usize>,
    /// Entries of `θ`.
    pub range: Range<usize>,
}

/// Buffer sizes of the batched passes of a [`Policy`], in numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Packed parameters, the output of [`Policy::pack`].
    pub packed: usize,
    /// Values stored by [`Policy::forward`].
    pub tape: usize,
    /// Cotangents stored by [`Policy::backward`].
    pub tape_bar: usize,
    /// Workspace within one call of [`Policy::param_gradient`].
    pub scratch: usize,
}

/// A strided selection of `count` columns: `first, first + step, …`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolicyColumns {
    /// Index of the first column.
    pub first: usize,
    /// Distance between successive columns.
    pub step: usize,
    /// Number of columns.
    pub count: usize,
}

impl PolicyColumns {
    /// Contiguous columns.
    pub fn range(columns: Range<usize>) -> Self {
        Self { first: columns.start, step: 1, count: columns.len() }
    }

    /// The columns as a range.
    ///
    /// # Panics
    /// With debug assertions, if the columns are not contiguous.
    pub fn as_range(self) -> Range<usize> {
        debug_assert!(self.step == 1, "the columns are not contiguous");
        self.first..self.first + self.count
    }

    /// Iterates over the column indices.
    pub fn iter(self) -> impl Iterator<Item = usize> {
        (0..self.count).map(move |i| self.first + i * self.step)
    }

    /// Splits the columns into blocks of at most `size`.
    pub fn blocks(self, size: usize) -> impl Iterator<Item = PolicyColumns> {
        (0..self.count).step_by(size).map(move |done| Self {
            first: self.first + done * self.step,
            step: self.step,
            count: size.min(self.count - done),
        })
    }
}

/// Parameters `θ` and their packed form, always consistent.
#[derive(Clone, Debug)]
pub struct Weights<F> {
    theta: Vec<F>,
    packed: Aligned<F>,
}

impl<F: Float> Weights<F> {
    /// Packs the given parameters.
    ///
    /// # Panics
    /// If the length of `theta` is not [`Policy::param_count`].
    #[track_caller]
    pub fn new(policy: &dyn AnyPolicy<F>, theta: Vec<F>) -> Self {
        assert_eq!(
            theta.len(),
            policy.param_count(),
            "the policy has {} parameters, not {}",
            policy.param_count(),
            theta.len()
        );
        let mut packed = Aligned::zeros(policy.sizes(1).packed);
        policy.pack(&theta, &mut packed);
        Self { theta, packed }
    }

    /// Draws initial parameters by [`Policy::init`].
    pub fn init(policy: &dyn AnyPolicy<F>, rng: &mut Rng) -> Self {
        let mut theta = vec![0.0; policy.param_count()];
        policy.init(rng, &mut theta);
        Self::new(policy, theta.into_iter().map(F::from_f64).collect())
    }

    /// Panics if the number of parameters is not that of the policy.
    #[track_caller]
    pub(crate) fn assert_fits(&self, policy: &dyn AnyPolicy<F>) {
        let sizes = [self.theta.len(), self.packed.len()];
        let expected = [policy.param_count(), policy.sizes(1).packed];
        assert!(
            sizes == expected,
            "the weights have {} parameters in another layout than the {} of the policy; make them with the same policy",
            sizes[0],
            expected[0]
        );
    }

    /// The parameters `θ`.
    pub fn theta(&self) -> &[F] {
        &self.theta
    }

    /// Entries of `θ` for the [trained entries](Policy::trained_params) of `p`.
    pub(crate) fn trained(&self, policy: &dyn AnyPolicy<F>) -> &[F] {
        &self.theta[self.theta.len() - policy.trained_params().len()..]
    }

    /// The parameters in the layout of the batched passes.
    pub fn packed(&self) -> &[F] {
        &self.packed
    }

    /// Applies `change` to the parameters and repacks them.
    pub fn update(&mut self, policy: &dyn AnyPolicy<F>, change: impl FnOnce(&mut [F])) {
        change(&mut self.theta);
        policy.pack(&self.theta, &mut self.packed);
    }
}
