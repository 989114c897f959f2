//! [`Bounded`]: a policy with bounded controls.

use super::{Action, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor, TrainedParam};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};

/// Bounds the controls of a policy: `u_i = b_i tanh(v_i / b_i)` for its controls v.
///
/// |u_i| is at most `b_i`, and `u_i` is close to `v_i` if |v_i| is small relative to `b_i`.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounded<P> {
    policy: P,
    bounds: Vec<f64>,
}

impl<P: Policy> Bounded<P> {
    /// Bounds each control of `policy`.
    ///
    /// # Panics
    /// If the number of bounds differs from the number of controls. If a bound is not between 1e-37
    /// and 1e37. If the policy has neither observations nor a memory.
    #[track_caller]
    pub fn new(policy: P, bounds: impl Into<Vec<f64>>) -> Self {
        let bounds = bounds.into();
        let controls = policy.control_dim();
        let inputs = policy.observation_dim() + policy.memory_dim();
        assert!(
            inputs > 0,
            "a bounded policy needs at least one observed component or memory component; add one"
        );
        assert_eq!(
            bounds.len(),
            controls,
            "the policy has {controls} controls, but there are {} bounds",
            bounds.len()
        );
        // Bounds and their reciprocals have to be normal numbers in f32.
        let is_valid = bounds.iter().all(|bound| (1e-37..=1e37).contains(bound));
        assert!(
            is_valid,
            "bounds of controls are positive numbers from 1e-37 to 1e37, not {bounds:?}"
        );
        Self { policy, bounds }
    }

    /// Length of an output column: controls and next memory.
    fn outputs(&self) -> usize {
        self.bounds.len() + self.policy.memory_dim()
    }

    /// Number of columns of a pass.
    fn columns<F>(&self, pass: &PolicyPass<F>) -> usize {
        pass.x.len() / (self.policy.observation_dim() + self.policy.memory_dim())
    }

    /// Offsets of this policy's own entries: in the tape the slopes `∂u_i/∂v_i`, in `tape_bar` the
    /// cotangents of v and of the next memory.
    fn own<F: Float>(&self, pass: &PolicyPass<F>) -> Sizes {
        self.policy.sizes::<F>(self.columns(pass))
    }
}

impl<P: Policy> Policy for Bounded<P> {
    fn observation_dim(&self) -> usize {
        self.policy.observation_dim()
    }

    fn control_dim(&self) -> usize {
        self.policy.control_dim()
    }

    fn memory_dim(&self) -> usize {
        self.policy.memory_dim()
    }

    fn param_count(&self) -> usize {
        self.policy.param_count()
    }

    fn trained_params(&self) -> &[TrainedParam] {
        self.policy.trained_params()
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        self.policy.init(rng, theta);
    }

    fn act<T: Scalar>(
        &self,
        theta: &[T],
        observed: Observed<'_, T>,
        Action { u, memory }: Action<'_, T>,
    ) {
        self.policy.act(theta, observed, Action { u, memory });
        for (u, &bound) in u.iter_mut().zip(&self.bounds) {
            *u = (*u * (1.0 / bound)).tanh() * bound;
        }
    }

    fn tensors(&self) -> Vec<Tensor> {
        self.policy.tensors()
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        let inner = self.policy.sizes::<F>(columns);
        let (slopes, cotangents) = (columns * self.bounds.len(), columns * self.outputs());
        Sizes { tape: inner.tape + slopes, tape_bar: inner.tape_bar + cotangents, ..inner }
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        self.policy.pack(theta, packed);
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        let (tape, slopes) = tape.split_at_mut(self.own(&pass).tape);
        self.policy.forward(pass, tape, u);
        let (m, outputs) = (self.bounds.len(), self.outputs());
        for c in pass.at.iter() {
            let (u, slopes) = (&mut u[c * outputs..][..m], &mut slopes[c * m..][..m]);
            for i in 0..m {
                let h = (u[i] * F::from_f64(1.0 / self.bounds[i])).tanh();
                (u[i], slopes[i]) = (h * F::from_f64(self.bounds[i]), F::one() - h * h);
            }
        }
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        let sizes = self.own(&pass);
        let (tape, slopes) = tape.split_at(sizes.tape);
        let (tape_bar, v_bar) = tape_bar.split_at_mut(sizes.tape_bar);
        let (m, outputs) = (self.bounds.len(), self.outputs());
        for c in pass.at.iter() {
            let v_bar = &mut v_bar[c * outputs..][..outputs];
            v_bar.copy_from_slice(&u_bar[c * outputs..][..outputs]);
            for (bar, &slope) in v_bar.iter_mut().zip(&slopes[c * m..][..m]) {
                *bar *= slope;
            }
        }
        self.policy.backward(pass, tape, v_bar, tape_bar, x_bar);
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        let sizes = self.own(&pass);
        let (tape_bar, v_bar) = record.tape_bar.split_at(sizes.tape_bar);
        let record =
            PolicyRecord { tape: &record.tape[..sizes.tape], u_bar: v_bar, tape_bar, ..record };
        self.policy.param_gradient(pass, record, scratch, theta_bar);
    }
}
