//! [`Adaptive`]: Tsitouras' method with error control.

use super::{Integrator, Room, RungeKutta, StepInput, room};
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use crate::numbers::zip::zip;

/// Tsitouras 5(4) (doi:10.1016/j.camwa.2011.06.002) with adaptive steps within each time step.
///
/// The error of an attempt is the largest `|error_i| / (atol + rtol max(|x_i|, |x'_i|))`:
///
/// ```text
/// below 1          the step is taken, and the next is tried as long; twice as long if it is below 1/64
/// 1 or more        it is tried again, half as long
/// ```
///
/// Every sample has its own step sizes. Lanes are bit-identical to scalar computations. Derivatives
/// are those of the accepted steps at constant step sizes. Step sizes are piecewise constant
/// functions of the state.
///
/// Yields NaN if a time step is incomplete after `most` attempts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Relative tolerance. Below [`floor`](Adaptive::floor), rounding errors dominate.
    pub rtol: f64,
    /// Absolute tolerance, in the unit of each component.
    pub atol: f64,
    /// Maximal number of attempts per time step.
    pub most: usize,
}

impl Default for Adaptive {
    fn default() -> Self {
        Self { rtol: 1e-6, atol: 1e-9, most: 1000 }
    }
}

/// Error estimate, the difference of the fifth- and fourth-order results: weights of the six stages
/// and of the rate at the end of the step.
const ERROR: [f64; 7] = [
    -0.001_780_011_052_225_777,
    -0.000_816_434_459_656_746_9,
    0.007_880_878_010_261_995,
    -0.144_711_007_173_262_9,
    0.582_357_165_452_555_2,
    -0.458_082_105_929_186_97,
    0.015_151_515_151_515_152,
];

impl Adaptive {
    /// Integrates over `h`, attempt by attempt, and writes the final state to `next`.
    ///
    /// Calls `tell(state, step)` for each attempt, with its initial state and its accepted step
    /// size: 0 for a rejected attempt.
    #[inline(always)]
    fn attempts<T: Scalar>(&self, ode: &dyn DynOde<T>, h: T, x: &[T], u: &[T], next: &mut [T], mut tell: impl FnMut(&[T], T)) {
        let (n, tableau, one) = (x.len(), RungeKutta::TSIT5, T::one());
        let (mut at, mut rates) = tableau.room(n);
        let (mut candidate, mut last) = (room(T::zero(), n), room(T::zero(), n));
        next.copy_from_slice(x);
        let (mut left, mut trial) = (h, h);
        for _ in 0..self.most {
            if !T::any_lt(T::zero(), left) {
                break;
            }
            // Finished lanes take steps of size 0, which leave the state unchanged.
            let step = left.min(trial);
            tableau.run(ode, step, next, u, &mut at, &mut rates);
            candidate.copy_from_slice(next);
            tableau.sum(tableau.weights(), step, &rates, &mut candidate);
            ode.rate(&candidate, u, &mut last);
            let error = self.error(step, next, &candidate, &rates, &last);
            tell(next, T::select_lt(error, one, step, T::zero()));
            for (next, &candidate) in zip(next.iter_mut(), &candidate) {
                *next = T::select_lt(error, one, candidate, *next);
            }
            left = T::select_lt(error, one, left - step, left);
            let longer = T::select_lt(error, T::lift(1.0 / 64.0), T::lift(2.0), one);
            trial = step * T::select_lt(error, one, longer, T::lift(0.5));
        }
        for next in next {
            *next = T::select_lt(T::zero(), left, T::lift(f64::NAN), *next);
        }
    }

    /// Largest error relative to the tolerance, detached from differentiation.
    #[inline(always)]
    fn error<T: Scalar>(&self, step: T, x: &[T], candidate: &[T], rates: &[T], last: &[T]) -> T {
        let n = x.len();
        let mut largest = T::zero();
        for c in 0..n {
            let mut error = last[c] * T::lift(ERROR[6]);
            for (i, &weight) in ERROR[..6].iter().enumerate() {
                error += rates[i * n + c] * T::lift(weight);
            }
            let size = x[c].abs().max(candidate[c].abs());
            let ratio = (error * step).abs() / (T::lift(self.atol) + T::lift(self.rtol) * size);
            // Selects a NaN ratio. A later finite ratio replaces it.
            largest = T::select_lt(ratio, largest, largest, ratio);
        }
        largest.detach()
    }
}

impl Integrator for Adaptive {
    #[inline(always)]
    fn advance<T: Scalar>(&self, ode: &dyn DynOde<T>, step: StepInput<'_, T>, next: &mut [T]) {
        let StepInput { h, x, u } = step;
        self.attempts(ode, h, x, u, next, |_, _| {});
    }

    #[inline(always)]
    fn reverse<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        step: StepInput<'_, R>,
        next_bar: &[C],
        x_bar: &mut [C],
        mut u_bar: Option<&mut [C]>,
    ) {
        let StepInput { h, x, u } = step;
        let n = x.len();
        let (mut states, mut steps): (Room<R>, Room<R>) = (Room::new(), Room::new());
        let mut next = room(R::zero(), n);
        self.attempts(ode, h, x, u, &mut next, |x, step| {
            states.extend_from_slice(x);
            steps.push(step);
        });
        let mut bar = room(C::null(), n);
        bar.copy_from_slice(next_bar);
        for (state, &step) in states.chunks_exact(n).zip(&steps).rev() {
            RungeKutta::TSIT5.reverse(ode, StepInput { h: step, x: state, u }, &bar, x_bar, u_bar.as_deref_mut());
            bar.copy_from_slice(x_bar);
        }
        x_bar.copy_from_slice(&bar);
    }
}

impl Adaptive {
    /// Smallest effective `rtol` in the precision `F`: 100 times the machine epsilon.
    pub fn floor<F: Float>() -> f64 {
        100.0 * F::EPSILON
    }
}
