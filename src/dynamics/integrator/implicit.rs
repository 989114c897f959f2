//! [`ImplicitMidpoint`]: the implicit midpoint rule.

use super::newton::{self, Place, Stage};
use super::{Integrator, buffer, stage_time};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// The implicit midpoint rule, `x' = x + h f((x + x')/2, u, p, t + h/2)`: order 2, symplectic,
/// A-stable. Stiff components oscillate with slowly decaying amplitude;
/// [`Sdirk2`](crate::integrator::Sdirk2) damps them.
///
/// Newton's iteration solves the equation. Its first 30 iterations have one Jacobian: central
/// differences at the midpoint of an explicit Euler step. Samples that do not converge start again
/// from the state, with a new Jacobian in each iteration and damped corrections. Each sample
/// iterates until it converges, and becomes NaN after 200 of these iterations.
///
/// The reverse pass differentiates the solution, not the iteration, by the implicit function
/// theorem. For any `tolerance`, the reverse pass recomputes the solution with a tolerance of 256
/// machine epsilons. With `A = I - h/2 ∂f/∂x` at the midpoint,
///
/// ```text
/// w = A⁻ᵀ x̄',   x̄ = 2 w - x̄',   ū += h (∂f/∂u)ᵀ w
/// ```
///
/// See Hairer, Lubich and Wanner, Geometric Numerical Integration, II.1 and VIII.6.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImplicitMidpoint {
    /// Bound on the largest correction `|Δx'_i| / (1 + |x'_i|)`, to be met in two successive
    /// iterations. Clamped to at least [`floor`](ImplicitMidpoint::floor), because corrections of
    /// stiff fields stagnate near that size.
    pub tolerance: f64,
}

impl Default for ImplicitMidpoint {
    fn default() -> Self {
        Self { tolerance: 1e-12 }
    }
}

impl ImplicitMidpoint {
    /// Smallest effective `tolerance` in the precision `F`: 256 times the machine epsilon.
    pub fn floor<F: Float>() -> f64 {
        newton::floor::<F>()
    }

    /// The equation for the next state.
    #[inline(always)]
    fn stage<'a, T: Scalar>(
        ode: &'a dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'a, T>,
    ) -> Stage<'a, T> {
        let halfway = inputs.at(stage_time(inputs.t, dt, 0.5));
        Stage { ode, inputs: halfway, base: inputs.x, h: T::from(dt), place: Place::Middle }
    }

    /// Solves for the next state to `tolerance`. Returns 0 in lanes that converged, else a positive
    /// number.
    #[inline(always)]
    fn solve<T: Scalar>(
        tolerance: f64,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) -> T {
        let (h, x, n) = (T::from(dt), inputs.x, inputs.x.len());
        let stage = Self::stage(ode, dt, inputs);
        ode.rate(inputs.continuous(dt), next);
        for i in 0..n {
            next[i] = x[i] + h * next[i];
        }
        let mut inverse = buffer(T::zero(), n * n);
        let inverse = &mut inverse[..];
        stage.linearize(next, inverse);
        stage.solve(tolerance, inverse, x, next)
    }
}

impl Integrator for ImplicitMidpoint {
    #[inline(always)]
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let to_go = Self::solve(self.tolerance, ode, dt, inputs, next);
        newton::mark_unsolved(to_go, next);
    }

    fn unsolved<R: Real>(
        &self,
        ode: &dyn DynOde<R>,
        dt: f64,
        inputs: Inputs<'_, R>,
    ) -> Option<f64> {
        let mut next = buffer(R::zero(), inputs.x.len());
        // The tolerance of the forward pass, then that of the reverse pass.
        [self.tolerance, 0.0].into_iter().find_map(|tolerance| {
            let to_go = Self::solve(tolerance, ode, dt, inputs, &mut next);
            R::any_lt(R::zero(), to_go)
                .then(|| Self::stage(ode, dt, inputs).largest_residual(&next))
        })
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
        let (h, n) = (R::from(dt), inputs.x.len());
        let (mut next, mut middle) = (buffer(R::zero(), n), buffer(R::zero(), n));
        let to_go = Self::solve(0.0, ode, dt, inputs, &mut next);
        let stage = Self::stage(ode, dt, inputs);
        stage.argument(&next, &mut middle);
        let halfway = stage.inputs.with_x(&middle);
        let mut inverse = buffer(R::zero(), n * n);
        let inverse = &mut inverse[..];
        newton::exact_inverse(ode, h * R::from(0.5), halfway, inverse);
        newton::mark_unsolved(to_go, inverse);
        // rate_bar = h w.
        let mut rate_bar = buffer(C::null(), n);
        for j in 0..n {
            let w = newton::transposed(inverse, next_bar, j);
            rate_bar[j] = w * h;
            if let Some(x_bar) = &mut cotangents.x {
                x_bar[j] += w + w - next_bar[j];
            }
        }
        cotangents.x = None;
        if !cotangents.is_empty() {
            ode.rate_vjp(halfway, &rate_bar, cotangents);
        }
    }
}
