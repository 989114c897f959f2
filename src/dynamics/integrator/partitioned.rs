//! Partitioned methods for mechanics: [`SemiImplicit`] and [`Verlet`].
//!
//! A component is a position if [`Ode::velocity`](crate::Ode::velocity) returns the index of its
//! velocity. Both methods update all other components like velocities.

use super::{Integrator, buffer, stage_time};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs, add};
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Semi-implicit Euler: `v' = v + h a(q, v)`, then `q' = q + h v'`. Order 1, one evaluation.
///
/// Symplectic if the accelerations are `-M⁻¹ ∇V(q)` with a constant mass matrix `M`. The energy
/// then oscillates but does not drift (Hairer, Lubich and Wanner, Geometric Numerical Integration,
/// I.1).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SemiImplicit;

impl Integrator for SemiImplicit {
    #[inline(always)]
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let (h, x) = (T::from(dt), inputs.x);
        let mut rate = buffer(T::zero(), x.len());
        ode.rate(inputs.continuous(dt), &mut rate);
        for i in 0..x.len() {
            if ode.velocity(i).is_none() {
                next[i] = x[i] + h * rate[i];
            }
        }
        for i in 0..x.len() {
            if let Some(velocity) = ode.velocity(i) {
                next[i] = x[i] + h * next[velocity];
            }
        }
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
        let (h, x) = (R::from(dt), inputs.x);
        let mut x_bar = buffer(C::null(), x.len());
        x_bar.copy_from_slice(next_bar);
        for (i, &next_bar) in next_bar.iter().enumerate() {
            if let Some(velocity) = ode.velocity(i) {
                x_bar[velocity] += next_bar * h;
            }
        }
        let mut rate_bar = buffer(C::null(), x.len());
        for i in 0..x.len() {
            if ode.velocity(i).is_none() {
                rate_bar[i] = x_bar[i] * h;
            }
        }
        if let Some(bar) = &mut cotangents.x {
            add(bar, &x_bar);
        }
        ode.rate_vjp(inputs.continuous(dt), &rate_bar, cotangents);
    }
}

/// Velocity Verlet (Swope et al. 1982, doi:10.1063/1.442716). Order 2, two evaluations.
///
/// ```text
/// q' = q + h v + h²/2 a(q, v)
/// v' = v + h/2 (a(q, v) + a(q', v + h a(q, v)))
/// ```
///
/// Symplectic if the accelerations are `-M⁻¹ ∇V(q)` with a constant mass matrix `M`. The second
/// evaluation uses the velocities of an explicit Euler step, as in Heun's method. If accelerations
/// depend on velocities, the order is therefore still 2, but the method is not symplectic.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verlet;

/// Inputs with the time of the end of the step.
#[inline(always)]
fn end<T: Scalar>(dt: f64, inputs: Inputs<'_, T>) -> OdeInputs<'_, T> {
    inputs.at(stage_time(inputs.t, dt, 1.0))
}

impl Verlet {
    /// Writes the argument of the second evaluation: the new positions and predicted velocities.
    #[inline(always)]
    fn guess<T: Scalar>(ode: &dyn DynOde<T>, h: T, x: &[T], rate: &[T], guess: &mut [T]) {
        let half_square = h * h * 0.5;
        for i in 0..x.len() {
            guess[i] = match ode.velocity(i) {
                Some(velocity) => x[i] + h * x[velocity] + half_square * rate[velocity],
                None => x[i] + h * rate[i],
            };
        }
    }
}

impl Integrator for Verlet {
    #[inline(always)]
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let (h, x) = (T::from(dt), inputs.x);
        let (mut first, mut second) = (buffer(T::zero(), x.len()), buffer(T::zero(), x.len()));
        ode.rate(inputs.continuous(dt), &mut first);
        Self::guess(ode, h, x, &first, next);
        ode.rate(end(dt, inputs).with_x(next), &mut second);
        let half = h * 0.5;
        for i in 0..x.len() {
            if ode.velocity(i).is_none() {
                next[i] = x[i] + half * (first[i] + second[i]);
            }
        }
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
        let (h, x) = (R::from(dt), inputs.x);
        let n = x.len();
        let (half, half_square) = (h * R::from(0.5), h * h * R::from(0.5));
        let (mut rate, mut guess) = (buffer(R::zero(), n), buffer(R::zero(), n));
        ode.rate(inputs.continuous(dt), &mut rate);
        Self::guess(ode, h, x, &rate, &mut guess);
        let (mut rate_bar, mut guess_bar) = (buffer(C::null(), n), buffer(C::null(), n));
        for i in 0..n {
            match ode.velocity(i) {
                Some(_) => guess_bar[i] = next_bar[i],
                None => rate_bar[i] = next_bar[i] * half,
            }
        }
        let mut guess_bars = cotangents.reborrow();
        guess_bars.x = Some(&mut guess_bar);
        ode.rate_vjp(end(dt, inputs).with_x(&guess), &rate_bar, guess_bars);
        let mut x_bar = buffer(C::null(), n);
        for i in 0..n {
            x_bar[i] += guess_bar[i];
            match ode.velocity(i) {
                Some(velocity) => {
                    x_bar[velocity] += guess_bar[i] * h;
                    rate_bar[velocity] += guess_bar[i] * half_square;
                }
                None => {
                    x_bar[i] += next_bar[i];
                    rate_bar[i] += guess_bar[i] * h;
                }
            }
        }
        if let Some(bar) = &mut cotangents.x {
            add(bar, &x_bar);
        }
        ode.rate_vjp(inputs.continuous(dt), &rate_bar, cotangents);
    }
}
