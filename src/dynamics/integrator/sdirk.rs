//! [`Sdirk2`]: an L-stable diagonally implicit Runge–Kutta method.

use super::newton::{self, Place, Stage};
use super::{Integrator, buffer, stage_time};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// The diagonally implicit Runge–Kutta method of Alexander 1977 (doi:10.1137/0714068, theorem 5)
/// with two stages: order 2, L-stable. Stiff components decay to 0 and do not oscillate.
///
/// ```text
/// Y = x + γ h f(Y, u, p, t + γ h),                γ = 1 - 1/√2
/// x' = x + (1 - γ)/γ (Y - x) + γ h f(x', u, p, t + h)
/// ```
///
/// Newton's iteration solves one stage after the other, as in
/// [`ImplicitMidpoint`](crate::integrator::ImplicitMidpoint). Both stages begin with one Jacobian:
/// central differences at the state.
///
/// The reverse pass recomputes the stages with a tolerance of 256 machine epsilons, for any
/// `tolerance`, and differentiates the solutions by the implicit function theorem. With
/// `A = I - γ h ∂f/∂x` at Y, and `A'` at x',
///
/// ```text
/// v' = A'⁻ᵀ x̄',   κ = (1 - γ)/γ v',   v = A⁻ᵀ κ
/// x̄ = v' + v - κ,   ū += γ h (∂f'/∂u)ᵀ v' + γ h (∂f/∂u)ᵀ v
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sdirk2 {
    /// Bound on the largest correction `|ΔY_i| / (1 + |Y_i|)`, to be met in two successive
    /// iterations. Clamped to at least [`floor`](Sdirk2::floor), because corrections of stiff
    /// fields stagnate near that size.
    pub tolerance: f64,
}

impl Default for Sdirk2 {
    fn default() -> Self {
        Self { tolerance: 1e-12 }
    }
}

/// Diagonal coefficient: the root of `γ² - 2 γ + 1/2` below 1.
const GAMMA: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;
/// Weight of the move of the first stage in the second one, `(1 - γ)/γ`.
const WEIGHT: f64 = 1.0 + std::f64::consts::SQRT_2;

impl Sdirk2 {
    /// Smallest effective `tolerance` in the precision `F`: 256 times the machine epsilon.
    pub fn floor<F: Float>() -> f64 {
        newton::floor::<F>()
    }

    /// Inputs at a fraction of the step.
    #[inline(always)]
    fn inputs<T: Scalar>(dt: f64, inputs: Inputs<'_, T>, fraction: f64) -> OdeInputs<'_, T> {
        inputs.at(stage_time(inputs.t, dt, fraction))
    }

    /// Solves both stages to `tolerance`. Writes NaN in lanes that do not converge, and returns a
    /// positive number in these lanes, else 0. Calls `unsolved(stage, z)` at a stage that some lane
    /// does not solve.
    #[inline(always)]
    fn solve<T: Scalar>(
        tolerance: f64,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        [first, next]: [&mut [T]; 2],
        mut unsolved: impl FnMut(&Stage<'_, T>, &[T]),
    ) -> T {
        let (x, n, h) = (inputs.x, inputs.x.len(), T::from(GAMMA * dt));
        let (mut base, mut inverse) = (buffer(T::zero(), n), buffer(T::zero(), n * n));
        let (base, inverse) = (&mut base[..], &mut inverse[..]);
        let mut solve = |stage: Stage<'_, T>, inverse: &[T], guess: &[T], z: &mut [T]| {
            z.copy_from_slice(guess);
            let to_go = stage.solve(tolerance, inverse, guess, z);
            if T::any_lt(T::zero(), to_go) {
                unsolved(&stage, z);
            }
            newton::mark_unsolved(to_go, z);
            to_go
        };
        let stage =
            Stage { ode, inputs: Self::inputs(dt, inputs, GAMMA), base: x, h, place: Place::End };
        stage.linearize(x, inverse);
        let to_go = solve(stage, inverse, x, first);
        for i in 0..n {
            base[i] = x[i] + (first[i] - x[i]) * WEIGHT;
        }
        let stage =
            Stage { ode, inputs: Self::inputs(dt, inputs, 1.0), base, h, place: Place::End };
        to_go.max(solve(stage, inverse, first, next))
    }
}

impl Integrator for Sdirk2 {
    #[inline(always)]
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let mut first = buffer(T::zero(), next.len());
        Self::solve(self.tolerance, ode, dt, inputs, [&mut first, next], |_, _| {});
    }

    fn unsolved<R: Real>(
        &self,
        ode: &dyn DynOde<R>,
        dt: f64,
        inputs: Inputs<'_, R>,
    ) -> Option<f64> {
        let n = inputs.x.len();
        let (mut first, mut next) = (buffer(R::zero(), n), buffer(R::zero(), n));
        let mut residual = None;
        // The tolerance of the forward pass, then that of the reverse pass.
        for tolerance in [self.tolerance, 0.0] {
            Self::solve(tolerance, ode, dt, inputs, [&mut first, &mut next], |stage, z| {
                residual.get_or_insert_with(|| stage.largest_residual(z));
            });
        }
        residual
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
        let (h, n) = (R::from(GAMMA * dt), inputs.x.len());
        let (mut first, mut next) = (buffer(R::zero(), n), buffer(R::zero(), n));
        let to_go = Self::solve(0.0, ode, dt, inputs, [&mut first, &mut next], |_, _| {});
        let mut inverse = buffer(R::zero(), n * n);
        let inverse = &mut inverse[..];
        let (mut bar, mut v, mut rate_bar) =
            (buffer(C::null(), n), buffer(C::null(), n), buffer(C::null(), n));
        let (bar, v, rate_bar) = (&mut bar[..], &mut v[..], &mut rate_bar[..]);
        let mut x_bar = cotangents.x.take();
        bar.copy_from_slice(next_bar);
        for (fraction, z) in [(1.0, &next), (GAMMA, &first)] {
            let at = Self::inputs(dt, inputs, fraction).with_x(z);
            newton::exact_inverse(ode, h, at, inverse);
            newton::mark_unsolved(to_go, inverse);
            for i in 0..n {
                v[i] = newton::transposed(inverse, bar, i);
                rate_bar[i] = v[i] * h;
            }
            if !cotangents.is_empty() {
                ode.rate_vjp(at, rate_bar, cotangents.reborrow());
            }
            if let Some(x_bar) = &mut x_bar {
                for i in 0..n {
                    // κ is 0 in the last stage.
                    x_bar[i] += if fraction < 1.0 { v[i] - bar[i] } else { v[i] };
                }
            }
            for i in 0..n {
                bar[i] = v[i] * R::from(WEIGHT);
            }
        }
    }
}
