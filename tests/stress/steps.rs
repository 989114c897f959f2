//! Helpers of the stress cases: rollouts, adjoints and error norms.

use super::{AnySystem, Four, vjp};
use physgrad::Inputs;
use physgrad::{Float, Real};

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

/// `(∂S/∂x)ᵀ bar` and `(∂S/∂u)ᵀ bar` for the step S of a system, by forward mode, four components
/// of x and u at a time.
pub(super) fn vjp_by_duals<R: Real>(
    system: &dyn AnySystem<R>,
    x: &[R],
    u: &[R],
    bar: &[R],
) -> [Vec<R>; 2] {
    let inputs = [x, u].concat();
    let mut cotangents = Vec::with_capacity(inputs.len());
    let mut next = vec![Four::constant(R::zero()); x.len()];
    for first in (0..inputs.len()).step_by(4) {
        let count = (inputs.len() - first).min(4);
        let mut duals: Vec<Four<R>> = inputs.iter().map(|&input| Four::constant(input)).collect();
        for (index, dual) in duals[first..][..count].iter_mut().enumerate() {
            dual.tangents[index] = R::one();
        }
        let (x, u) = duals.split_at(x.len());
        system.step_by_duals(Inputs::new(x, u), &mut next);
        cotangents.extend((0..count).map(|index| {
            let terms = next.iter().zip(bar).map(|(next, &bar)| next.tangents[index] * bar);
            terms.fold(R::zero(), |sum, term| sum + term)
        }));
    }
    let by_control = cotangents.split_off(x.len());
    [cotangents, by_control]
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
