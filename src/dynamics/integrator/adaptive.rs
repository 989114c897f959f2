//! [`Adaptive`]: Tsitouras' method with error control.

use super::{Buffer, Integrator, RungeKutta, buffer};
use crate::dynamics::inputs::{Cotangents, Inputs, add};
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use crate::numbers::zip::zip;

/// Tsitouras 5(4) (doi:10.1016/j.camwa.2011.06.002) with adaptive steps within each time step.
///
/// The error of an attempt is the largest `|e_i| / (atol + rtol max(|x_i|, |x'_i|))`. Here, `x` is
/// the state before the attempt, and `x'` is the fifth-order result. The vector `e` is the
/// difference of the fifth- and fourth-order results.
///
/// ```text
/// below 1/64       accept the step, double the next step size
/// below 1          accept the step, keep the step size
/// 1 or more, NaN   reject the step, halve the step size
/// ```
///
/// Every sample has its own step sizes. Lanes are bit-identical to scalar computations.
///
/// Derivatives are those of the accepted steps at constant step sizes. Step sizes are piecewise
/// constant functions of the state, so these derivatives are exact almost everywhere.
///
/// A sample becomes NaN if its time step is incomplete after `most` attempts. All samples become
/// NaN if the time step is negative or NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Relative tolerance. Below [`floor`](Adaptive::floor), rounding errors dominate.
    pub rtol: f64,
    /// Absolute tolerance, in the unit of each component. Must be positive if a component may be 0.
    pub atol: f64,
    /// Maximal number of attempts per time step.
    pub most: usize,
}

impl Default for Adaptive {
    fn default() -> Self {
        Self { rtol: 1e-6, atol: 1e-9, most: 1000 }
    }
}

/// Weights of the error estimate, the difference of the fifth- and fourth-order results. Six are
/// for the stages, the last one is for the rate at the end of the step.
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
    /// Integrates over `dt`, attempt by attempt, and writes the final state to `next`.
    ///
    /// Calls `record(state, time, step)` for each attempt, with its initial state and its initial
    /// time. `step` is the accepted duration, 0 if the attempt is rejected.
    #[inline(always)]
    fn attempts<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
        mut record: impl FnMut(&[T], T, T),
    ) {
        if dt.is_nan() || dt < 0.0 {
            return next.fill(T::from(f64::NAN));
        }
        let (n, tableau, one, h) = (inputs.x.len(), RungeKutta::TSIT5, T::one(), T::from(dt));
        let end = inputs.continuous(dt).t + h;
        let (mut at, mut rates) = tableau.stage_buffers(n);
        let (mut candidate, mut last) = (buffer(T::zero(), n), buffer(T::zero(), n));
        next.copy_from_slice(inputs.x);
        let (mut left, mut trial) = (h, h);
        for _ in 0..self.most {
            if !T::any_lt(T::zero(), left) {
                break;
            }
            // Finished lanes take steps of size 0, which leave the state unchanged.
            let (step, time) = (left.min(trial), end - left);
            tableau.run(ode, step, span(inputs, time, step).with_x(next), &mut at, &mut rates);
            candidate.copy_from_slice(next);
            tableau.sum(tableau.weights(), step, &rates, &mut candidate);
            ode.rate(inputs.at(time + step).with_x(&candidate), &mut last);
            let error = self.error(step, next, &candidate, &rates, &last);
            record(next, time, T::select_lt(error, one, step, T::zero()));
            for (next, &candidate) in zip(next.iter_mut(), &candidate) {
                *next = T::select_lt(error, one, candidate, *next);
            }
            left = T::select_lt(error, one, left - step, left);
            let longer = T::select_lt(error, T::from(1.0 / 64.0), T::from(2.0), one);
            trial = step * T::select_lt(error, one, longer, T::from(0.5));
        }
        for next in next {
            *next = T::select_lt(T::zero(), left, T::from(f64::NAN), *next);
        }
    }

    /// Largest error among the components, relative to the tolerance. Detached from
    /// differentiation.
    #[inline(always)]
    fn error<T: Scalar>(&self, step: T, x: &[T], candidate: &[T], rates: &[T], last: &[T]) -> T {
        let n = x.len();
        let mut largest = T::zero();
        for c in 0..n {
            let mut error = last[c] * ERROR[6];
            for (i, &weight) in ERROR[..6].iter().enumerate() {
                error += rates[i * n + c] * weight;
            }
            let size = x[c].abs().max(candidate[c].abs());
            let ratio = (error * step).abs() / (T::from(self.atol) + T::from(self.rtol) * size);
            // Selects a NaN ratio, and keeps an infinite or NaN maximum.
            let larger = T::select_lt(ratio, largest, largest, ratio);
            largest = T::select_lt(largest, T::from(f64::INFINITY), larger, largest);
        }
        largest.detach()
    }
}

/// Inputs of a step of duration `step` s that begins at `time` s; see [`RungeKutta::run`].
#[inline(always)]
fn span<T: Scalar>(
    inputs: Inputs<'_, T>,
    time: T,
    step: T,
) -> Inputs<'_, T, impl Fn(f64) -> T + Copy> {
    inputs.at(move |fraction| time + step * fraction)
}

impl Integrator for Adaptive {
    #[inline(always)]
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        self.attempts(ode, dt, inputs, next, |_, _, _| {});
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        dt: f64,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let n = inputs.x.len();
        let (mut states, mut steps): (Buffer<R>, Buffer<(R, R)>) = (Buffer::new(), Buffer::new());
        let mut next = buffer(R::zero(), n);
        self.attempts(ode, dt, inputs, &mut next, |x, time, step| {
            states.extend_from_slice(x);
            steps.push((time, step));
        });
        let (mut bar, mut before) = (buffer(C::null(), n), buffer(C::null(), n));
        bar.copy_from_slice(next_bar);
        for (state, &(time, step)) in states.chunks_exact(n).zip(&steps).rev() {
            before.fill(C::null());
            let mut step_bars = cotangents.reborrow();
            step_bars.x = Some(&mut before);
            RungeKutta::TSIT5.run_back(
                ode,
                step,
                span(inputs, time, step).with_x(state),
                &bar,
                step_bars,
            );
            std::mem::swap(&mut bar, &mut before);
        }
        if let Some(x_bar) = cotangents.x {
            add(x_bar, &bar);
        }
    }
}

impl Adaptive {
    /// Smallest effective `rtol` in the precision `F`: 100 times the machine epsilon.
    pub fn floor<F: Float>() -> f64 {
        100.0 * F::EPSILON
    }
}
