//! Tsitouras' method with control of its error.

use super::{Integrator, Room, RungeKutta, Stretch, room};
use crate::dynamics::ode::{RateOn, ReverseOn};
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use crate::numbers::zip::zip;

/// Tsitouras 5(4) (doi:10.1016/j.camwa.2011.06.002) with steps of its own choice within each step: as many as its estimate
/// of the error asks for. Where the largest of `|error_i| / (atol + rtol |x_i|)` is
///
/// ```text
/// below 1          the step is taken, and the next is tried as long; twice as long if it is below 1/64
/// 1 or more        it is tried again, half as long
/// ```
///
/// Every sample chooses for itself, and so has the bits that it would have alone. The accepted steps are differentiated as
/// taken: their lengths, which jump from one power of two to another, count as constants.
///
/// A step that `most` attempts do not finish is not a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Error allowed in relation to a component's size. Below some 100 roundings nothing is gained.
    pub rtol: f64,
    /// Error allowed whatever the size, in the component's unit.
    pub atol: f64,
    /// The most attempts in a step.
    pub most: usize,
}

impl Default for Adaptive {
    fn default() -> Self {
        Self { rtol: 1e-6, atol: 1e-9, most: 1000 }
    }
}

/// What the fifth-order result differs by from the fourth-order one: weights of the six stages, and of the rate at the end.
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
    /// Goes through the attempts: tells of the state before each and of the time by which it went on, 0 if it was rejected.
    #[inline(always)]
    fn attempts<T: Scalar>(&self, ode: &dyn RateOn<T>, h: T, x: &[T], u: &[T], next: &mut [T], mut tell: impl FnMut(&[T], T)) {
        let (n, tableau, one) = (x.len(), RungeKutta::TSIT5, T::one());
        let (mut at, mut rates) = tableau.room(n);
        let (mut candidate, mut last) = (room(T::zero(), n), room(T::zero(), n));
        next.copy_from_slice(x);
        let (mut left, mut trial) = (h, h);
        for _ in 0..self.most {
            if !T::any_lt(T::zero(), left) {
                break;
            }
            // Samples that have arrived take steps of length 0, which change nothing.
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

    /// The largest error in relation to what is allowed, as a constant.
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
            // What is not a number is not allowed either.
            largest = T::select_lt(ratio, largest, largest, ratio);
        }
        largest.detach()
    }
}

impl Integrator for Adaptive {
    #[inline(always)]
    fn advance<T: Scalar>(&self, ode: &dyn RateOn<T>, step: Stretch<'_, T>, next: &mut [T]) {
        let Stretch { h, x, u } = step;
        self.attempts(ode, h, x, u, next, |_, _| {});
    }

    #[inline(always)]
    fn reverse<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn ReverseOn<R, C>,
        step: Stretch<'_, R>,
        next_bar: &[C],
        x_bar: &mut [C],
        mut u_bar: Option<&mut [C]>,
    ) {
        let Stretch { h, x, u } = step;
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
            RungeKutta::TSIT5.reverse(ode, Stretch { h: step, x: state, u }, &bar, x_bar, u_bar.as_deref_mut());
            bar.copy_from_slice(x_bar);
        }
        x_bar.copy_from_slice(&bar);
    }
}

impl Adaptive {
    /// The least `rtol` worth asking for in this precision.
    pub fn floor<F: Float>() -> f64 {
        100.0 * F::EPSILON
    }
}
