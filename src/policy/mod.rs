//! [`Policy`]: the controller `u = N(x; θ)` that is trained.

mod any;
mod conv;
mod linear;
mod mlp;
mod toy;

pub use any::AnyPolicy;
pub use conv::Conv;
pub use linear::Linear;
pub use mlp::Mlp;
pub use toy::{Constant, Quadratic};

use crate::numbers::aligned::Aligned;
use crate::numbers::forward_mode::{Chunk, jacobian};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use smallvec::SmallVec;
use std::ops::Range;

/// A controller `u = N(x; θ)`, the same at every step. `θ` is one flat slice.
///
/// Only the dimensions, [`init`](Policy::init) and [`act`](Policy::act) must be written. The batched passes default to
/// `act`, one evaluation after the other, with exact derivatives by dual numbers; a policy with large layers overrides
/// all of them together, and [`check::policy`](crate::check::policy) compares them with `act`.
///
/// # The batched passes
/// They work on *columns*: one column is one evaluation, of one sample at one step. The columns of a sample at successive
/// steps are neighbours, and so are those of successive samples over some steps. `x` holds `state_dim` numbers per column, `u` and `u_bar` hold `control_dim`.
/// Which columns a call works on is said by [`PolicyColumns`].
pub trait Policy: Send + Sync {
    /// Number of state components it sees.
    fn state_dim(&self) -> usize;
    /// Number of control components it sets.
    fn control_dim(&self) -> usize;
    /// Length of `θ`.
    fn param_count(&self) -> usize;

    /// Draws initial parameters into `theta`.
    fn init(&self, rng: &mut Rng, theta: &mut [f64]);

    /// `u = N(x; θ)` for one state. The definition that everything else is checked against.
    fn act<T: Scalar>(&self, theta: &[T], x: &[T], u: &mut [T]);

    /// The named pieces of `θ`, in order, for files that other programs read.
    fn tensors(&self) -> Vec<Tensor> {
        vec![Tensor { name: "theta".into(), shape: vec![self.param_count()], range: 0..self.param_count() }]
    }

    /// Numbers that the batched passes need, for a rollout of so many columns.
    fn sizes<F: Float>(&self, _columns: usize) -> Sizes {
        Sizes { packed: self.param_count(), tape: 0, tape_bar: 0, scratch: 0 }
    }

    /// Brings `θ` into the form the batched passes like. Called once per update.
    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        packed.copy_from_slice(theta);
    }

    /// `u = N(x)` in the columns `at`; what the derivative needs is kept in `tape`.
    fn forward<F: Float>(&self, pass: PolicyPass<F>, _tape: &mut [F], u: &mut [F]) {
        let (n, m) = (self.state_dim(), self.control_dim());
        for c in pass.at.iter() {
            self.act(pass.packed, &pass.x[c * n..][..n], &mut u[c * m..][..m]);
        }
    }

    /// `x_bar = (∂N/∂x)ᵀ u_bar` in the columns `at`, after [`forward`](Policy::forward); overwrites. What the
    /// parameter gradient needs is kept in `tape_bar`. Without `x_bar`, `∂N/∂x` is not evaluated.
    fn backward<F: Float>(&self, pass: PolicyPass<F>, _tape: &[F], u_bar: &[F], _tape_bar: &mut [F], x_bar: Option<&mut [F]>) {
        let (n, m) = (self.state_dim(), self.control_dim());
        let Some(x_bar) = x_bar else { return };
        let theta = constants(pass.packed);
        for c in pass.at.iter() {
            let act = |x: &[_], u: &mut [_]| self.act(&theta, x, u);
            jacobian(&pass.x[c * n..][..n], 0..n, m, act, |i, slope| {
                x_bar[c * n + i] = dot(slope, &u_bar[c * m..][..m]);
            });
        }
    }

    /// `theta_bar += Σ_c weight[c]·(∂N/∂θ)ᵀ u_bar[c]` over the columns `at`, which are neighbours, after
    /// [`backward`](Policy::backward).
    fn param_gradient<F: Float>(&self, pass: PolicyPass<F>, record: PolicyRecord<F>, _scratch: &mut [F], theta_bar: &mut [F]) {
        let (n, m) = (self.state_dim(), self.control_dim());
        for c in pass.at.iter() {
            let x = constants(&pass.x[c * n..][..n]);
            let weight = record.weight.map_or(F::one(), |w| w[c]);
            let act = |theta: &[_], u: &mut [_]| self.act(theta, &x, u);
            jacobian(pass.packed, 0..pass.packed.len(), m, act, |i, slope| {
                theta_bar[i] += weight * dot(slope, &record.u_bar[c * m..][..m]);
            });
        }
    }
}

fn constants<F: Float>(values: &[F]) -> SmallVec<[Chunk<F>; 32]> {
    values.iter().map(|&value| Chunk::constant(value)).collect()
}

fn dot<F: Float>(a: &[F], b: &[F]) -> F {
    a.iter().zip(b).fold(F::zero(), |sum, (&a, &b)| sum + a * b)
}

/// What the batched passes of a [`Policy`] start from.
#[derive(Clone, Copy, Debug)]
pub struct PolicyPass<'a, F> {
    /// The parameters, as [`Policy::pack`] left them.
    pub packed: &'a [F],
    /// The columns to work on.
    pub at: PolicyColumns,
    /// The states of all columns.
    pub x: &'a [F],
}

/// What the passes before it left for [`Policy::param_gradient`], in all columns.
#[derive(Clone, Copy, Debug)]
pub struct PolicyRecord<'a, F> {
    /// Kept by the forward pass.
    pub tape: &'a [F],
    /// The cotangents that the backward pass was given.
    pub u_bar: &'a [F],
    /// Kept by the backward pass.
    pub tape_bar: &'a [F],
    /// What each column counts, one number a column; without it, all count 1.
    pub weight: Option<&'a [F]>,
}

/// A named piece of `θ`, row-major.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tensor {
    /// What it is, for instance `layer1.kernel`.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Where it is in `θ`.
    pub range: Range<usize>,
}

/// How many numbers the batched passes of a [`Policy`] need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// For the parameters in the form the passes like.
    pub packed: usize,
    /// Kept by the forward pass.
    pub tape: usize,
    /// Kept by the backward pass.
    pub tape_bar: usize,
    /// Used within one call.
    pub scratch: usize,
}

/// Columns `first, first + step, …`, `count` of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolicyColumns {
    /// The first column.
    pub first: usize,
    /// From one to the next.
    pub step: usize,
    /// How many.
    pub count: usize,
}

impl PolicyColumns {
    /// Contiguous columns.
    pub fn range(columns: Range<usize>) -> Self {
        Self { first: columns.start, step: 1, count: columns.len() }
    }

    /// The columns as a range; they must be neighbours.
    pub fn as_range(self) -> Range<usize> {
        debug_assert!(self.step == 1, "these columns are not neighbours");
        self.first..self.first + self.count
    }

    /// Their indices.
    pub fn iter(self) -> impl Iterator<Item = usize> {
        (0..self.count).map(move |i| self.first + i * self.step)
    }

    /// The same columns in pieces of at most `size`.
    pub fn blocks(self, size: usize) -> impl Iterator<Item = PolicyColumns> {
        (0..self.count).step_by(size).map(move |done| Self {
            first: self.first + done * self.step,
            step: self.step,
            count: size.min(self.count - done),
        })
    }
}

/// Parameters and their packed form, kept in step.
#[derive(Clone, Debug)]
pub struct Weights<F> {
    theta: Vec<F>,
    packed: Aligned<F>,
}

impl<F: Float> Weights<F> {
    /// The given parameters.
    ///
    /// # Panics
    /// If there are not [`Policy::param_count`] of them.
    #[track_caller]
    pub fn new(policy: &dyn AnyPolicy<F>, theta: Vec<F>) -> Self {
        assert_eq!(theta.len(), policy.param_count(), "the policy has {} parameters, not {}", policy.param_count(), theta.len());
        let mut packed = Aligned::zeros(policy.sizes(1).packed);
        policy.pack(&theta, &mut packed);
        Self { theta, packed }
    }

    /// Fresh parameters from [`Policy::init`].
    pub fn init(policy: &dyn AnyPolicy<F>, rng: &mut Rng) -> Self {
        let mut theta = vec![0.0; policy.param_count()];
        policy.init(rng, &mut theta);
        Self::new(policy, theta.into_iter().map(F::lift).collect())
    }

    /// The parameters.
    pub fn theta(&self) -> &[F] {
        &self.theta
    }

    /// The parameters in the form of the batched passes.
    pub fn packed(&self) -> &[F] {
        &self.packed
    }

    /// Changes the parameters and packs them again.
    pub fn update(&mut self, policy: &dyn AnyPolicy<F>, change: impl FnOnce(&mut [F])) {
        change(&mut self.theta);
        policy.pack(&self.theta, &mut self.packed);
    }
}
