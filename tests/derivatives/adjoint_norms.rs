//! Norms of the adjoint along rollouts of linear plants.

use physgrad::policy::Linear;
use physgrad::rng::Rng;
use physgrad::{Adjoint, Flow, Gradient, Inputs, Rollout, Scalar, Start, System, Task, Weights};

/// `x' = 1.25 x + u` in each of `CONTROLS` components, over 60 steps. The loss is half the squared
/// norm of the final state.
struct Plant<const CONTROLS: usize>;

/// Factor of the state per step without control.
const GROWTH: f64 = 1.25;
/// Gain k of the policy `u = k x`.
const GAIN: f64 = -0.5;
/// Number of steps.
const HORIZON: usize = 60;

impl<const CONTROLS: usize> System for Plant<CONTROLS> {
    fn state_dim(&self) -> usize {
        CONTROLS
    }
    fn control_dim(&self) -> usize {
        CONTROLS
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        for i in 0..CONTROLS {
            next[i] = T::from(GROWTH) * x[i] + u[i];
        }
    }
}

impl<const CONTROLS: usize> Task for Plant<CONTROLS> {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        HORIZON
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x.fill(1.0);
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x.iter().fold(T::zero(), |sum, &x| sum + T::from(0.5) * x * x)
    }
}

/// Returns the norms of the adjoints of R and M for 11 samples. All components of sample b start at
/// b, for b from 1 to 11.
fn norms<const CONTROLS: usize>(scale: f64) -> [Vec<f64>; 2] {
    let (task, samples) = (Plant::<CONTROLS>, 11);
    let policy = Linear::new(CONTROLS, CONTROLS);
    let gain = |i: usize| if i.is_multiple_of(CONTROLS + 1) { GAIN } else { 0.0 };
    let weights = Weights::new(&policy, (0..CONTROLS * CONTROLS).map(gain).collect());
    let mut rollout = Rollout::new(&task, &policy, samples);
    rollout.start(&(0..samples * CONTROLS).map(|i| (1 + i / CONTROLS) as f64).collect::<Vec<_>>());
    rollout.run(&task, &policy, &weights).expect("the rollout is finite");
    let mut adjoint =
        Adjoint::new(&task, &policy, &rollout, &[Flow::REGULAR, Flow::MODIFIED]).keep_norms();
    adjoint.run(&task, &policy, &weights, &rollout, scale).expect("the adjoint is finite");
    [0, 1].map(|k| adjoint.norms(k).to_vec())
}

fn assert_powers<const CONTROLS: usize>() {
    let [regular, modified] = norms::<CONTROLS>(1.0);
    let closed_loop = GROWTH + GAIN;
    // Root mean square of the norms of the final states.
    let end = closed_loop.powi(HORIZON as i32)
        * (CONTROLS as f64 * (1..=11).map(|b| f64::from(b * b)).sum::<f64>() / 11.0).sqrt();
    assert_eq!((regular.len(), modified.len()), (HORIZON + 1, HORIZON + 1));
    for t in 0..=HORIZON {
        let steps = (HORIZON - t) as i32;
        for (name, norm, factor) in [("R", regular[t], closed_loop), ("M", modified[t], GROWTH)] {
            let expected = end * factor.powi(steps);
            assert!(
                (norm / expected - 1.0).abs() < 1e-12,
                "{name} at step {t}: {norm:e}, expected {expected:e}"
            );
        }
    }
}

#[test]
fn r_shrinks_by_0_75_and_m_grows_by_1_25_per_step_back() {
    assert_powers::<1>();
    // With more than one control, the reverse pass through the policy runs step by step.
    assert_powers::<2>();
}

/// Task on `Plant<1>` with the running cost `x²/2` instead of a terminal cost.
struct RunningLoss;

impl Task for RunningLoss {
    type System = Plant<1>;
    fn system(&self) -> &Plant<1> {
        &Plant
    }
    fn horizon(&self) -> usize {
        HORIZON
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x.fill(1.0);
    }
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, x: &[T]) -> T {
        T::from(0.5) * x[0] * x[0]
    }
}

#[test]
fn the_norm_at_a_state_omits_the_cost_of_that_state() {
    let policy = Linear::new(1, 1);
    let weights = Weights::new(&policy, vec![GAIN]);
    let mut rollout = Rollout::new(&RunningLoss, &policy, 1);
    rollout.start(&[1.0]);
    rollout.run(&RunningLoss, &policy, &weights).expect("the rollout is finite");
    let mut adjoint = Adjoint::new(&RunningLoss, &policy, &rollout, &[Flow::REGULAR]).keep_norms();
    adjoint.run(&RunningLoss, &policy, &weights, &rollout, 1.0).expect("the adjoint is finite");
    let a = GROWTH + GAIN;
    for (t, &norm) in adjoint.norms(0).iter().enumerate() {
        // The costs of the states after x_t sum to x_t² (a² + a⁴ + …) / 2. The norm is the
        // derivative of this sum with respect to x_t.
        let later: f64 = (1..=HORIZON - t).map(|k| a.powi(2 * k as i32)).sum();
        let expected = a.powi(t as i32) * later;
        assert!(
            (norm - expected).abs() <= 1e-12 * expected,
            "step {t}: {norm:e}, expected {expected:e}"
        );
    }
    assert_eq!(adjoint.norms(0)[HORIZON], 0.0);
}

#[test]
fn norms_do_not_depend_on_the_scale_of_the_loss() {
    let ([a, b], [c, d]) = (norms::<2>(1.0), norms::<2>(0.125));
    assert_eq!((a, b), (c, d));
}

#[test]
fn adjoints_and_gradients_beyond_the_range_of_f32_are_exact_to_1e_4() {
    let (task, policy) = (Plant::<1>, Linear::new(1, 1));
    let weights = Weights::<f32>::new(&policy, vec![GAIN as f32]);
    let mut rollout = Rollout::new(&task, &policy, 1);
    rollout.start(&[1e3]);
    rollout.run(&task, &policy, &weights).expect("the rollout is finite");
    let mut adjoint = Adjoint::new(&task, &policy, &rollout, &[Flow::MODIFIED]).keep_norms();
    // With this scale, neither the adjoint nor the parameter gradient of M fits in f32.
    adjoint.run(&task, &policy, &weights, &rollout, f32::MAX).expect("the adjoint has an exponent");
    let end = f64::from(rollout.state(HORIZON, 0, 0));
    for (t, &norm) in adjoint.norms(0).iter().enumerate() {
        let expected = end * GROWTH.powi((HORIZON - t) as i32);
        assert!((norm / expected - 1.0).abs() < 1e-4, "step {t}: {norm:e}, expected {expected:e}");
    }
    let mut gradient = Gradient::zeros(1);
    adjoint.param_gradient(0, &policy, &weights, &rollout, 0..1, &mut gradient);
    let expected: f64 =
        (0..HORIZON).map(|t| adjoint.norms(0)[t + 1] * f64::from(rollout.state(t, 0, 0))).sum();
    assert!(
        (gradient.norm().get() / f64::from(f32::MAX) / expected - 1.0).abs() < 1e-4,
        "{}",
        gradient.norm()
    );
    assert_eq!(gradient.to_vec(), [f32::INFINITY]);
}

/// The terminal cost is `2e38 Σ x_i`, and a step changes the state only by `1e-30 u`. Each
/// component of the adjoint is 2e38 times the scale of the loss.
struct Steep<const STATES: usize, const CONTROLS: usize>;

impl<const STATES: usize, const CONTROLS: usize> System for Steep<STATES, CONTROLS> {
    fn state_dim(&self) -> usize {
        STATES
    }
    fn control_dim(&self) -> usize {
        CONTROLS
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next.copy_from_slice(x);
        for (next, &u) in next.iter_mut().zip(u) {
            *next += u * 1e-30;
        }
    }
}

impl<const STATES: usize, const CONTROLS: usize> Task for Steep<STATES, CONTROLS> {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        3
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x.fill(1e-10);
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x.iter().fold(T::zero(), |sum, &x| sum + x * 2e38)
    }
}

/// Returns the norms of the adjoint of R in f32, for one sample that starts at 1e-10 in all
/// components.
fn steep_norms<const STATES: usize, const CONTROLS: usize>() -> Vec<f64> {
    let (task, policy) = (Steep::<STATES, CONTROLS>, Linear::new(STATES, CONTROLS));
    let weights = Weights::<f32>::new(&policy, vec![0.0; STATES * CONTROLS]);
    let mut rollout = Rollout::new(&task, &policy, 1);
    rollout.start(&[1e-10; STATES]);
    rollout.run(&task, &policy, &weights).expect("the rollout is finite");
    let mut adjoint = Adjoint::new(&task, &policy, &rollout, &[Flow::REGULAR]).keep_norms();
    adjoint
        .run(&task, &policy, &weights, &rollout, 1.0)
        .expect("every component of the adjoint is finite");
    adjoint.norms(0).to_vec()
}

#[test]
fn finite_components_whose_sum_overflows_f32_are_no_divergence() {
    for (t, norm) in steep_norms::<4, 1>().into_iter().enumerate() {
        assert!((norm / 4e38 - 1.0).abs() < 1e-6, "step {t}: {norm:e}");
    }
}

#[test]
fn the_adjoint_of_a_system_without_controls_is_rescaled() {
    for (t, norm) in steep_norms::<1, 0>().into_iter().enumerate() {
        assert!((norm / 2e38 - 1.0).abs() < 1e-6, "step {t}: {norm:e}");
    }
}
