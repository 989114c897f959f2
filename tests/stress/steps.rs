//! Helpers of the stress cases: rollouts, adjoints and error norms.

use super::{AnySystem, vjp};
use physgrad::{Float, Real};
use physgrad::{Inputs, Tangents};

/// States `x_0 .. x_T` under a constant control.
pub(super) fn states(
    system: &dyn AnySystem<f64>,
    start: &[f64],
    u: f64,
    steps: usize,
) -> Vec<Vec<f64>> {
    let mut states = vec![start.to_vec()];
    for _ in 0..steps {
        let mut next = vec![0.0; start.len()];
        system.step(Inputs::new(&states[states.len() - 1], &[u]), &mut next);
        states.push(next);
    }
    states
}

/// Derivatives of a component of the last state with respect to the initial state and to the
/// constant control.
pub(super) fn derivative(
    system: &dyn AnySystem<f64>,
    states: &[Vec<f64>],
    u: f64,
    component: usize,
) -> (Vec<f64>, f64) {
    let n = states[0].len();
    let (mut bar, mut u_bar) = (vec![0.0; n], 0.0);
    bar[component] = 1.0;
    for x in states[..states.len() - 1].iter().rev() {
        let [x_bar, part, _] = vjp(system, Inputs::new(x, &[u]), &bar);
        bar = x_bar;
        u_bar += part[0];
    }
    (bar, u_bar)
}

/// `(∂S/∂x)ᵀ bar` and `(∂S/∂u)ᵀ bar` for the step S of a system, by forward mode, one component of
/// x or u at a time.
pub(super) fn vjp_by_jvps<R: Real>(
    system: &dyn AnySystem<R>,
    x: &[R],
    u: &[R],
    bar: &[R],
) -> [Vec<R>; 2] {
    let mut next = x.to_vec();
    let mut along = |len: usize, jvp: &dyn Fn(&[R], &mut [R])| -> Vec<R> {
        let component = |i: usize| {
            let mut tangent = vec![R::zero(); len];
            tangent[i] = R::one();
            jvp(&tangent, &mut next);
            next.iter().zip(bar).fold(R::zero(), |sum, (&next, &bar)| sum + next * bar)
        };
        (0..len).map(component).collect()
    };
    [
        along(x.len(), &|tangent, next| {
            system.jvp(
                Inputs::new(x, u),
                Tangents { x: Some(tangent), ..Tangents::default() },
                next,
            )
        }),
        along(u.len(), &|tangent, next| {
            system.jvp(
                Inputs::new(x, u),
                Tangents { u: Some(tangent), ..Tangents::default() },
                next,
            )
        }),
    ]
}

/// True if all numbers are finite. Reads lane 0 only.
pub(super) fn finite<R: Real>(numbers: &[R]) -> bool {
    numbers.iter().all(|number| number.lane(0).to_f64().is_finite())
}

/// Larger of two errors; NaN if either is NaN.
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if a > b || a.is_nan() { a } else { b }
}

/// Largest absolute difference, relative to the largest expected component; absolute if all
/// expected components are zero. Reads lane 0 only.
pub(super) fn error<R: Real>(found: &[R], expected: &[R]) -> f64 {
    let (mut scale, mut worst) = (0.0, 0.0f64);
    for (found, expected) in found.iter().zip(expected) {
        scale = f64::max(scale, expected.lane(0).to_f64().abs());
        worst = larger(worst, (found.lane(0).to_f64() - expected.lane(0).to_f64()).abs());
    }
    if scale > 0.0 { worst / scale } else { worst }
}
