//! Adjoints that become 0 or very large.

use physgrad::policy::{Linear, OpenLoop, TrainedParam, WithParams};
use physgrad::rng::Rng;
use physgrad::{
    Adjoint, Float, Flow, Gradient, Inputs, Rollout, Scalar, Start, System, Task, Weights,
};

/// `x' = factor(t) x + u` from x = 0, with the running cost `x'`.
struct Timed {
    factor: fn(usize) -> f64,
    horizon: usize,
}

impl System for Timed {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * (self.factor)(t) + u[0];
    }
}

impl Task for Timed {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        self.horizon
    }
    fn start(&self, _: &mut Rng, _: Start<'_>) {}
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, x: &[T]) -> T {
        x[0]
    }
}

/// Norms of the adjoint at the states `x_0` to `x_T`.
fn norms<F: Float>(task: &Timed, flow: Flow) -> Vec<f64> {
    let policy = OpenLoop::new(1, 1, task.horizon);
    let weights = Weights::<F>::new(&policy, vec![F::zero(); task.horizon]);
    let mut rollout = Rollout::new(task, &policy, 1);
    rollout.start(&[F::zero()]);
    rollout.run(task, &policy, &weights).expect("the rollout stays at 0");
    let mut adjoint = Adjoint::new(task, &policy, &rollout, &[flow]).keep_norms();
    adjoint.run(task, &policy, &weights, &rollout, F::one()).expect("finite");
    adjoint.norms(0).to_vec()
}

#[test]
fn a_cut_limits_an_adjoint_that_was_0_at_a_later_step() {
    for factor in [|_| 10.0, |t| if t == 58 { 0.0 } else { 10.0 }] as [fn(usize) -> f64; 2] {
        let norms = norms::<f64>(&Timed { factor, horizon: 60 }, Flow::REGULAR.cut(5.0));
        let largest = norms.iter().copied().fold(0.0, f64::max);
        assert!((1e5..1e7).contains(&largest), "{largest:e}");
    }
}

/// The adjoint grows by a factor of 8 per step, beyond the range of f32. Then it restarts from 0 at
/// a truncation, a cut or a derivative of 0, or becomes small by derivatives of 1e-18.
#[test]
fn adjoints_restart_from_truncations_cuts_and_small_derivatives_beyond_the_range_of_f32() {
    let growing = |_| 8.0;
    let plain = Flow::REGULAR;
    let flows = [plain.truncated(64), plain.cut(50.0), plain, plain, plain];
    let factors: [fn(usize) -> f64; 5] = [
        growing,
        growing,
        |t| if t == 50 { 0.0 } else { 8.0 },
        |t| if t == 80 { 0.0 } else { 8.0 },
        |t| if (68..=71).contains(&t) { 1e-18 } else { 8.0 },
    ];
    for (flow, factor) in flows.into_iter().zip(factors) {
        let task = Timed { factor, horizon: 128 };
        let (single, double) = (norms::<f32>(&task, flow), norms::<f64>(&task, flow));
        for (t, (single, double)) in single.into_iter().zip(double).enumerate() {
            assert!(
                (single - double).abs() <= 1e-5 * double,
                "{flow}, step {t}: {single:e}, in f64 {double:e}"
            );
        }
    }
}

/// The adjoint λ_t is 10 + … + 10^(T - t). The square of the largest λ_t exceeds the range of f64.
#[test]
fn norms_of_adjoints_have_the_whole_range_of_f64() {
    let norms = norms::<f64>(&Timed { factor: |_| 10.0, horizon: 300 }, Flow::REGULAR);
    for (t, norm) in norms.into_iter().enumerate() {
        let expected = (10f64.powi(300 - t as i32) - 1.0) / 0.9;
        assert!(
            (norm - expected).abs() <= 1e-12 * expected,
            "step {t}: {norm:e}, expected {expected:e}"
        );
    }
}

/// As [`Timed`] with a factor of 8, and 0 at step `zero`, but with the cost `1e6 x_t`. The gain of
/// the control is `gain` at step `zero`, else 1. If `gain` is 0, no cotangent of later steps
/// remains at step `zero`. If `gain` is tiny, the cotangent of the control sets the exponent. A
/// large `gain` raises the exponent.
#[test]
fn costs_of_the_current_state_survive_a_derivative_of_0() {
    struct Before {
        zero: usize,
        gain: f64,
    }
    impl System for Before {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            let [factor, gain] = if t == self.zero { [0.0, self.gain] } else { [8.0, 1.0] };
            next[0] = x[0] * factor + u[0] * gain;
        }
    }
    impl Task for Before {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            128
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn running_cost<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, _next: &[T]) -> T {
            x[0] * 1e6
        }
    }
    for (zero, gain) in [(50, 0.0), (50, 1e-22), (50, 1e-30), (96, 2f64.powi(50)), (80, 1e12)] {
        let task = Before { zero, gain };
        let policy = OpenLoop::new(1, 1, 128);
        let weights = Weights::<f32>::new(&policy, vec![0.0; 128]);
        let mut rollout = Rollout::new(&task, &policy, 1);
        rollout.start(&[0.0]);
        rollout.run(&task, &policy, &weights).expect("the rollout stays at 0");
        let mut adjoint = Adjoint::new(&task, &policy, &rollout, &[Flow::REGULAR]).keep_norms();
        adjoint.run(&task, &policy, &weights, &rollout, 1.0).expect("finite");
        let mut expected = 0.0;
        for (t, norm) in adjoint.norms(0).iter().enumerate().take(128).rev() {
            expected = expected * if t == zero { 0.0 } else { 8.0 } + 1e6;
            assert!(
                (norm - expected).abs() <= 1e-5 * expected,
                "{zero}, {gain:e}, step {t}: {norm:e}, expected {expected:e}"
            );
        }
    }
}

/// The adjoint grows by a factor of 8 per step, beyond the range of f32, and restarts at step 50.
/// The controls and the trained parameter occur in the cost only.
#[test]
fn gradients_of_direct_costs_survive_a_restart() {
    struct Priced;
    impl System for Priced {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = x[0] * if t == 50 { 0.0 } else { 8.0 };
        }
    }
    impl Task for Priced {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            128
        }
        fn param_dim(&self) -> usize {
            1
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn running_cost<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, _next: &[T]) -> T {
            x[0] + u[0] * 3.0 + p[0] * 2.0
        }
    }

    let policy = WithParams::new(OpenLoop::new(1, 1, 128), [TrainedParam::linear(0, 0.0)]);
    let weights = Weights::<f32>::new(&policy, vec![0.0; 129]);
    let mut rollout = Rollout::new(&Priced, &policy, 3);
    rollout.start(&[0.0; 6]);
    rollout.run(&Priced, &policy, &weights).expect("the rollout stays at 0");
    for flows in [&[Flow::REGULAR][..], &[Flow::MODIFIED, Flow::REGULAR]] {
        let mut adjoint = Adjoint::new(&Priced, &policy, &rollout, flows);
        adjoint.run(&Priced, &policy, &weights, &rollout, 0.5).expect("finite");
        for k in 0..flows.len() {
            let mut gradient = Gradient::zeros(129);
            adjoint.param_gradient(k, &policy, &weights, &rollout, 0..3, &mut gradient);
            let gradient = gradient.to_vec();
            // Sums over three samples, times the scale 0.5: the control at the last step, the
            // control at the restart, and the trained parameter.
            assert_eq!(
                [127, 50, 128].map(|i| gradient[i]),
                [3.0 * 1.5, 3.0 * 1.5, 2.0 * 128.0 * 1.5],
                "flow {k}"
            );
        }
    }
}

/// A cut also removes the path from p through the observation. Growth by a factor of 3.5 per step
/// exceeds one decade at every second step.
#[test]
fn a_cut_removes_the_effect_of_parameters_on_the_observation() {
    /// `x_{t+1} = 3 x_t + u_t` with the observation `x_t + p`.
    struct Offset;
    impl System for Offset {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = x[0] * 3.0 + u[0];
        }
    }
    impl Task for Offset {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            20
        }
        fn param_dim(&self) -> usize {
            1
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn observation_dim(&self) -> Option<usize> {
            Some(1)
        }
        fn observe<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, y: &mut [T]) {
            y[0] = x[0] + p[0];
        }
        fn running_cost<T: Scalar>(&self, _: Inputs<'_, T>, next: &[T]) -> T {
            next[0]
        }
    }

    let policy = Linear::new(1, 1);
    let weights = Weights::<f64>::new(&policy, vec![0.5]);
    let mut rollout = Rollout::new(&Offset, &policy, 3);
    rollout.start(&[0.0; 6]);
    rollout.run(&Offset, &policy, &weights).expect("the rollout stays at 0");
    for flows in [&[Flow::REGULAR.cut(1.0)][..], &[Flow::MODIFIED, Flow::REGULAR.cut(1.0)]] {
        let mut adjoint = Adjoint::new(&Offset, &policy, &rollout, flows).keep_start_gradients();
        adjoint.run(&Offset, &policy, &weights, &rollout, 1.0).expect("finite");
        let (mut lambda, mut by_p, mut decades) = (0.0, 0.0, 0.0);
        for _ in 0..20 {
            lambda += 1.0;
            decades += 3.5_f64.log10();
            if decades > 1.0 {
                (lambda, decades) = (0.0, 0.0);
            } else {
                by_p += 0.5 * lambda;
                lambda *= 3.5;
            }
        }
        for sample in 0..3 {
            assert_eq!(adjoint.start_gradient(flows.len() - 1, sample).to_vec(), [lambda, by_p]);
        }
    }
}

/// The unused lanes of a block are copies of the last sample. A cut of this sample has to include
/// the copies, which otherwise overflow in f32.
#[test]
fn a_cut_of_the_last_sample_includes_its_copies() {
    let factor = |t| {
        if t == 20 {
            1e12
        } else if t == 19 {
            1e27
        } else {
            1.0
        }
    };
    let task = Timed { factor, horizon: 40 };
    let (single, double) =
        (norms::<f32>(&task, Flow::REGULAR.cut(5.0)), norms::<f64>(&task, Flow::REGULAR.cut(5.0)));
    for (single, double) in single.into_iter().zip(double) {
        assert!((single - double).abs() <= 1e-5 * double, "{single:e}, in f64 {double:e}");
    }
}

/// A plain sum of 1e5 costs of 0.1 in f32 has a relative error of 1.4e-4.
#[test]
fn the_loss_of_a_long_rollout_is_accurate_in_f32() {
    struct Constant;
    impl System for Constant {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = x[0];
        }
    }
    impl Task for Constant {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            100_000
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn running_cost<T: Scalar>(&self, _: Inputs<'_, T>, next: &[T]) -> T {
            next[0]
        }
    }
    let policy = Linear::new(1, 1);
    let mut rollout = Rollout::<f32>::for_evaluation(&Constant, &policy, 1);
    rollout.start(&[0.1]);
    rollout.run(&Constant, &policy, &Weights::new(&policy, vec![0.0])).expect("finite");
    assert!((rollout.cost(0) - 1e4).abs() < 0.05, "{}", rollout.cost(0));
}

#[test]
#[should_panic(expected = "an adjoint needs a rollout that stores all steps")]
fn an_adjoint_of_a_rollout_without_tape_is_refused() {
    let (task, policy) = (Timed { factor: |_| 1.0, horizon: 5 }, OpenLoop::new(1, 1, 5));
    let weights = Weights::<f64>::new(&policy, vec![0.0; 5]);
    let mut adjoint =
        Adjoint::new(&task, &policy, &Rollout::new(&task, &policy, 1), &[Flow::REGULAR]);
    let mut rollout = Rollout::for_evaluation(&task, &policy, 1);
    rollout.start(&[0.0]);
    rollout.run(&task, &policy, &weights).expect("finite");
    let _ = adjoint.run(&task, &policy, &weights, &rollout, 1.0);
}
