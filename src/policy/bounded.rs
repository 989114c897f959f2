//! [`Bounded`]: a policy with bounded controls.

use super::{
    Action, Bound, InputLayer, NetworkLayer, Observed, Policy, PolicyPass, PolicyRecord, Sizes,
    Tensor, TrainedParam,
};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};

/// Bounds the controls of a policy by a tanh.
///
/// With [`new`](Self::new), `u_i = b_i tanh(v_i / b_i)` for the controls v of the policy: |u_i| is
/// at most `b_i`, and `u_i` is close to `v_i` if |v_i| is small relative to `b_i`. Other ranges have
/// a middle c and a half-width b, and
///
/// - [`between`](Self::between) `u_i = c_i + b_i tanh(v_i / b_i)`, for networks, whose controls are
///   about 0 at first and then lie in the middle of the range;
/// - [`saturating`](Self::saturating) `u_i = c_i + b_i tanh((v_i - c_i) / b_i)`, for controllers that
///   compute the control itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounded<P> {
    policy: P,
    ranges: Vec<Range>,
}

/// Range of one control.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Range {
    bounds: [f64; 2],
    half_width: f64,
    /// Middle of the range; -0.0, the neutral element of addition, in place of 0.
    middle: f64,
    /// Control of the policy that becomes the middle.
    origin: f64,
}

impl Range {
    /// The range between two bounds.
    fn new([low, high]: [f64; 2]) -> Self {
        let middle = 0.5 * low + 0.5 * high;
        let middle = if middle == 0.0 { -0.0 } else { middle };
        Self { bounds: [low, high], half_width: 0.5 * high - 0.5 * low, middle, origin: 0.0 }
    }

    /// The tanh of a control of the policy.
    fn tanh<T: Scalar>(&self, v: T) -> T {
        ((v - self.origin) * (1.0 / self.half_width)).tanh()
    }
}

impl<P: Policy> Bounded<P> {
    /// Bounds each control of `policy` to `±bound`.
    ///
    /// # Panics
    /// If the number of bounds differs from the number of controls. If a bound is not between 1e-37
    /// and 1e37. If the policy has neither observations nor a memory.
    #[track_caller]
    pub fn new(policy: P, bounds: impl Into<Vec<f64>>) -> Self {
        let bounds = bounds.into();
        // Bounds and their reciprocals have to be normal numbers in f32.
        let is_valid = bounds.iter().all(|bound| (1e-37..=1e37).contains(bound));
        assert!(
            is_valid,
            "bounds of controls are positive numbers from 1e-37 to 1e37, not {bounds:?}"
        );
        let range = |&bound: &f64| Range::new([-bound, bound]);
        Self::with_ranges(policy, bounds.iter().map(range).collect())
    }

    /// Bounds each control of `policy` to a range `[low, high]`, with the control 0 of the policy in
    /// its middle.
    ///
    /// # Panics
    /// As [`new`](Self::new), for half the width of a range, or if a bound exceeds 1e37.
    #[track_caller]
    pub fn between(policy: P, ranges: impl Into<Vec<[f64; 2]>>) -> Self {
        let ranges = ranges.into();
        let is_valid = |&[low, high]: &[f64; 2]| {
            high - low >= 2e-37 && low.abs() <= 1e37 && high.abs() <= 1e37
        };
        assert!(
            ranges.iter().all(is_valid),
            "ranges of controls are pairs of bounds within ±1e37, the smaller first, not {ranges:?}"
        );
        Self::with_ranges(policy, ranges.into_iter().map(Range::new).collect())
    }

    /// Bounds each control of `policy` to a range `[low, high]`, and hardly changes controls near
    /// its middle.
    ///
    /// # Panics
    /// As [`between`](Self::between).
    #[track_caller]
    pub fn saturating(policy: P, ranges: impl Into<Vec<[f64; 2]>>) -> Self {
        let mut bounded = Self::between(policy, ranges);
        bounded.ranges.iter_mut().for_each(|range| range.origin = range.middle + 0.0);
        bounded
    }

    #[track_caller]
    fn with_ranges(policy: P, ranges: Vec<Range>) -> Self {
        let controls = policy.control_dim();
        let inputs = policy.observation_dim() + policy.memory_dim();
        assert!(
            inputs > 0,
            "a bounded policy needs at least one observed component or memory component; add one"
        );
        assert_eq!(
            ranges.len(),
            controls,
            "the policy has {controls} controls, but there are {} bounds",
            ranges.len()
        );
        Self { policy, ranges }
    }

    /// Length of an output column: controls and next memory.
    fn outputs(&self) -> usize {
        self.ranges.len() + self.policy.memory_dim()
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
        for (u, range) in u.iter_mut().zip(&self.ranges) {
            *u = range.tanh(*u) * range.half_width + range.middle;
        }
    }

    fn tensors(&self) -> Vec<Tensor> {
        self.policy.tensors()
    }

    fn input_layer(&self) -> Option<InputLayer> {
        self.policy.input_layer()
    }

    fn output_layer(&self) -> Option<std::ops::Range<usize>> {
        self.policy.output_layer()
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(self.ranges.iter().map(|range| range.bounds).collect())
    }

    fn network(&self) -> Option<Vec<NetworkLayer>> {
        let mut layers = self.policy.network()?;
        let last = layers.last_mut().filter(|last| last.bounds.is_none())?;
        let bound = |&Range { half_width, middle, origin, .. }: &Range| Bound {
            // Without the sign of -0.0, the neutral element.
            middle: middle + 0.0,
            half_width,
            origin,
        };
        last.bounds = Some(self.ranges.iter().map(bound).collect());
        Some(layers)
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        let inner = self.policy.sizes::<F>(columns);
        let (slopes, cotangents) = (columns * self.ranges.len(), columns * self.outputs());
        Sizes { tape: inner.tape + slopes, tape_bar: inner.tape_bar + cotangents, ..inner }
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        self.policy.pack(theta, packed);
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        let (tape, slopes) = tape.split_at_mut(self.own(&pass).tape);
        self.policy.forward(pass, tape, u);
        let (m, outputs) = (self.ranges.len(), self.outputs());
        for c in pass.at.iter() {
            let (u, slopes) = (&mut u[c * outputs..][..m], &mut slopes[c * m..][..m]);
            for i in 0..m {
                let Range { half_width, middle, origin, .. } = self.ranges[i];
                let h = ((u[i] - F::from_f64(origin)) * F::from_f64(1.0 / half_width)).tanh();
                u[i] = h * F::from_f64(half_width) + F::from_f64(middle);
                slopes[i] = F::one() - h * h;
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
        let (m, outputs) = (self.ranges.len(), self.outputs());
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
