//! Adjoints that become 0 or very large.

use physgrad::policy::OpenLoop;
use physgrad::rng::Rng;
use physgrad::{Adjoint, Float, Flow, Inputs, Rollout, Scalar, Start, System, Task, Weights};

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

/// The adjoint grows by a factor of 8 per step until a truncation at about 2^192 or a cut at about
/// 10^50. Both exceed the range of f32. Then the adjoint restarts from 0.
#[test]
fn adjoints_restart_from_a_truncation_or_cut_beyond_the_range_of_f32() {
    let task = Timed { factor: |_| 8.0, horizon: 128 };
    for flow in [Flow::REGULAR.truncated(64), Flow::REGULAR.cut(50.0)] {
        let (single, double) = (norms::<f32>(&task, flow), norms::<f64>(&task, flow));
        for (t, (single, double)) in single.into_iter().zip(double).enumerate() {
            assert!((single - double).abs() <= 1e-5 * double, "{flow}, step {t}: {single:e}, in f64 {double:e}");
        }
    }
}

/// The adjoint λ_t is 10 + … + 10^(T - t). The square of the largest λ_t exceeds the range of f64.
#[test]
fn norms_of_adjoints_have_the_whole_range_of_f64() {
    let norms = norms::<f64>(&Timed { factor: |_| 10.0, horizon: 300 }, Flow::REGULAR);
    for (t, norm) in norms.into_iter().enumerate() {
        let expected = (10f64.powi(300 - t as i32) - 1.0) / 0.9;
        assert!((norm - expected).abs() <= 1e-12 * expected, "step {t}: {norm:e}, expected {expected:e}");
    }
}
