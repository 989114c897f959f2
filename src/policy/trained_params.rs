//! [`WithParams`]: a policy and parameters of the system, trained together.

use super::{
    Action, InputLayer, NetworkLayer, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor,
};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use std::ops::Range;

/// Trained entry of the parameters `p`. All samples share its value.
///
/// `θ` holds an unbounded number r for the entry. The constructors differ in the map from r to the
/// entry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainedParam {
    index: usize,
    initial: f64,
    scale: Scale,
}

/// Factor by which a distance changes before an entry counts as lost, or as at its bound.
const FACTOR: f64 = 1e6;

/// Map from r to the entry of `p`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Scale {
    /// `r`.
    Linear,
    /// `low + exp(r)`.
    Above { low: f64 },
    /// `low + (high - low) / (1 + exp(-r))`.
    Bounded { low: f64, high: f64 },
}

impl TrainedParam {
    /// Trains `p[index] = r`, from an initial value.
    pub const fn linear(index: usize, initial: f64) -> Self {
        Self { index, initial, scale: Scale::Linear }
    }

    /// Trains `p[index] = exp(r)`, from a positive initial value: for masses, lengths and other
    /// positive numbers.
    ///
    /// # Panics
    /// If the initial value is not positive and finite.
    #[track_caller]
    pub fn log(index: usize, initial: f64) -> Self {
        Self::above(index, initial, 0.0)
    }

    /// Trains `p[index] = low + exp(r)`, from an initial value above the bound `low`.
    ///
    /// # Panics
    /// If the initial value is not above the bound, or either is not finite.
    #[track_caller]
    pub fn above(index: usize, initial: f64, low: f64) -> Self {
        assert!(
            low.is_finite() && low < initial && initial.is_finite(),
            "p[{index}] is trained above {low} from an initial value of {initial}; pass a finite initial value above the bound, \
             or use `TrainedParam::linear` for any value"
        );
        Self { index, initial, scale: Scale::Above { low } }
    }

    /// Trains `p[index] = low + (high - low) / (1 + exp(-r))`, from an initial value between the
    /// bounds.
    ///
    /// # Panics
    /// If the initial value is not strictly between the bounds, or a bound is not finite.
    #[track_caller]
    pub fn bounded(index: usize, initial: f64, low: f64, high: f64) -> Self {
        assert!(
            low.is_finite() && low < initial && initial < high && high.is_finite(),
            "p[{index}] is trained between {low} and {high} from an initial value of {initial}; pass finite bounds and an \
             initial value strictly between them, or use `TrainedParam::above` for a lower bound alone"
        );
        Self { index, initial, scale: Scale::Bounded { low, high } }
    }

    /// Trains `p[index]` from an initial value within bounds, which may be infinite. A finite upper
    /// bound requires a finite lower bound.
    ///
    /// # Panics
    /// As [`above`](Self::above) and [`bounded`](Self::bounded).
    #[track_caller]
    pub fn within(index: usize, initial: f64, [low, high]: [f64; 2]) -> Self {
        if high.is_finite() {
            Self::bounded(index, initial, low, high)
        } else if low.is_finite() {
            Self::above(index, initial, low)
        } else {
            Self::linear(index, initial)
        }
    }

    /// Index in `p`.
    pub fn index(&self) -> usize {
        self.index
    }

    /// Bounds of the entry, infinite where it has none.
    pub fn bounds(&self) -> [f64; 2] {
        match self.scale {
            Scale::Linear => [f64::NEG_INFINITY, f64::INFINITY],
            Scale::Above { low } => [low, f64::INFINITY],
            Scale::Bounded { low, high } => [low, high],
        }
    }

    /// Returns the number r that maps to the initial value.
    pub(crate) fn initial(&self) -> f64 {
        match self.scale {
            Scale::Linear => self.initial,
            Scale::Above { low } => (self.initial - low).ln(),
            Scale::Bounded { low, high } => ((self.initial - low) / (high - self.initial)).ln(),
        }
    }

    /// Returns the entry of `p` for r.
    pub fn value<T: Scalar>(&self, r: T) -> T {
        match self.scale {
            Scale::Linear => r,
            Scale::Above { low } => r.exp() + low,
            // The logistic function, in forms that neither overflow nor cancel.
            Scale::Bounded { low, high } => {
                let e = (-r.abs()).exp();
                let share = T::select_lt(r, T::zero(), e, T::one()) / (e + 1.0);
                share * (high - low) + low
            }
        }
    }

    /// Returns whether r is so far from its start that the training has lost the entry. An
    /// unbounded entry exceeds a million times its start, or 1e6 if it starts within ±1. An entry
    /// with only a lower bound is a million times as far from the bound as at its start.
    pub(crate) fn has_run_away(&self, r: f64) -> bool {
        let within = match self.scale {
            Scale::Linear => r.abs() <= FACTOR * self.initial.abs().max(1.0),
            Scale::Above { .. } => r - self.initial() <= FACTOR.ln(),
            Scale::Bounded { .. } => !r.is_nan(),
        };
        // True for NaN.
        !within
    }

    /// Returns whether the distance of the entry to a bound is below a millionth of the distance at
    /// its start, and of half the distance of both bounds. The slope of the entry is then almost 0.
    pub(crate) fn is_at_bound(&self, r: f64) -> bool {
        self.is_within(FACTOR, r)
    }

    /// Returns whether the distance to a bound has become smaller by this factor.
    fn is_within(&self, factor: f64, r: f64) -> bool {
        let (start, far) = (self.initial(), factor.ln());
        match self.scale {
            Scale::Linear => false,
            Scale::Above { .. } => r < start - far,
            Scale::Bounded { .. } => r < start.min(0.0) - far || r > start.max(0.0) + far,
        }
    }

    /// Returns whether the distance of the entry to a bound is below 1 % of the distance at its
    /// start, and of half the distance of both bounds.
    pub(crate) fn is_near_bound(&self, r: f64) -> bool {
        self.is_within(100.0, r)
    }

    /// Returns the derivative of [`value`](Self::value).
    pub(crate) fn slope(&self, r: f64) -> f64 {
        match self.scale {
            Scale::Linear => 1.0,
            Scale::Above { .. } => r.exp(),
            Scale::Bounded { low, high } => {
                let e = (-r.abs()).exp();
                (high - low) * e / (1.0 + e).powi(2)
            }
        }
    }
}

/// A policy whose `θ` ends with the numbers r of trained entries of the parameters `p`; see
/// [`TrainedParam`].
///
/// Rollouts replace these entries of each sample by the trained values. The task reads drawn and
/// trained parameters alike. Uses: system identification, and joint design of a controller and its
/// system.
///
/// ```
/// use physgrad::policy::{Constant, TrainedParam, WithParams};
/// use physgrad::prelude::*;
/// use physgrad::{Training, train::Decay};
///
/// /// Decay at an unknown rate, compared with measurements: p = [rate in 1/s].
/// struct Cooling { measured: Vec<f64> }
///
/// impl System for Cooling {
///     fn state_dim(&self) -> usize { 1 }
///     fn control_dim(&self) -> usize { 1 }
///     fn param_dim(&self) -> usize { 1 }
///     fn step<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, next: &mut [T]) {
///         next[0] = x[0] - p[0] * x[0] * 0.1;
///     }
/// }
///
/// impl Task for Cooling {
///     type System = Self;
///     fn system(&self) -> &Self { self }
///     fn horizon(&self) -> usize { self.measured.len() }
///     fn start(&self, _: &mut Rng, Start { x, .. }: Start<'_>) { x[0] = 1.0 }
///     fn running_cost<T: Scalar>(&self, Inputs { t, .. }: Inputs<'_, T>, next: &[T]) -> T {
///         let error = next[0] - self.measured[t];
///         error * error
///     }
/// }
///
/// // Measured at a rate of 0.7/s. Training starts from 0.2/s.
/// let cooling = Cooling { measured: (1..=20).map(|t| 0.93_f64.powi(t)).collect() };
/// let policy = WithParams::new(Constant::new(1, 1), [TrainedParam::log(0, 0.2)]);
/// let training = Training { epochs: 30, train_samples: 8, test_samples: 1, batch: 1, learning_rate: 0.1, ..Training::default() };
/// let training = Training { decay: Decay::Cosine { end: 0.0 }, ..training };
/// let report = Trainer::new(cooling, policy.clone()).precision::<f64>().field(Field::regular()).training(training).run()?;
/// let rate = policy.values(report.weights.theta())[0];
/// assert!((rate - 0.7).abs() < 1e-3, "{rate}");
/// # Ok::<(), physgrad::TrainError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct WithParams<P> {
    policy: P,
    /// All trained entries: those of `policy`, then those added.
    params: Vec<TrainedParam>,
}

impl<P: Policy> WithParams<P> {
    /// Trains `params` together with `policy`, and with the trained entries of `policy`.
    ///
    /// # Panics
    /// If an entry of `p` is trained twice.
    #[track_caller]
    pub fn new(policy: P, params: impl Into<Vec<TrainedParam>>) -> Self {
        let params = [policy.trained_params(), &params.into()].concat();
        for (i, TrainedParam { index, .. }) in params.iter().enumerate() {
            let twice = params[..i].iter().any(|before| before.index == *index);
            assert!(
                !twice,
                "p[{index}] is trained twice; pass one `TrainedParam` for each trained entry of p"
            );
        }
        Self { policy, params }
    }

    /// The policy.
    pub fn policy(&self) -> &P {
        &self.policy
    }

    /// Values of the trained entries of `p`, from `θ`, in the order of
    /// [`trained_params`](Policy::trained_params).
    pub fn values<F: Float>(&self, theta: &[F]) -> Vec<f64> {
        let trained = &theta[self.first()..];
        self.params.iter().zip(trained).map(|(param, r)| param.value(r.as_())).collect()
    }

    /// Index in `θ` of the number r of the first trained entry.
    fn first(&self) -> usize {
        self.policy.param_count() - self.policy.trained_params().len()
    }

    /// The parameters of the policy without the added entries.
    fn own<'a, T>(&self, theta: &'a [T]) -> &'a [T] {
        &theta[..self.policy.param_count()]
    }
}

impl<P: Policy> Policy for WithParams<P> {
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
        self.first() + self.params.len()
    }

    fn trained_params(&self) -> &[TrainedParam] {
        &self.params
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        let (own, added) = theta.split_at_mut(self.policy.param_count());
        self.policy.init(rng, own);
        for (r, param) in added.iter_mut().zip(&self.params[self.policy.trained_params().len()..]) {
            *r = param.initial();
        }
    }

    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>) {
        self.policy.act(self.own(theta), observed, action);
    }

    fn tensors(&self) -> Vec<Tensor> {
        let mut tensors = self.policy.tensors();
        if self.params.is_empty() {
            return tensors;
        }
        // One tensor holds the numbers r of all trained entries. It replaces the tensor of `policy`
        // with the numbers of its own trained entries.
        let trained = self.first()..self.param_count();
        tensors.retain(|tensor| tensor.range.start < trained.start);
        tensors.push(Tensor {
            name: "trained_params".into(),
            shape: vec![self.params.len()],
            range: trained,
        });
        tensors
    }

    fn network(&self) -> Option<Vec<NetworkLayer>> {
        self.policy.network()
    }

    fn input_layer(&self) -> Option<InputLayer> {
        self.policy.input_layer()
    }

    fn output_layer(&self) -> Option<Range<usize>> {
        self.policy.output_layer()
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        self.policy.control_bounds()
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        self.policy.sizes::<F>(columns)
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        self.policy.pack(self.own(theta), packed);
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        self.policy.forward(pass, tape, u);
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        self.policy.backward(pass, tape, u_bar, tape_bar, x_bar);
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        let own = self.policy.param_count();
        self.policy.param_gradient(pass, record, scratch, &mut theta_bar[..own]);
    }
}
