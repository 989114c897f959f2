//! [`ImplicitMidpoint`]: the implicit midpoint rule.

use super::{Integrator, buffer, stage_time};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// The implicit midpoint rule, `x' = x + h f((x + x')/2, u, p, t + h/2)`: order 2, symplectic,
/// A-stable.
///
/// Simplified Newton iteration solves the equation. The Jacobian is constant during the iteration:
/// central differences at the midpoint of an explicit Euler step. Each sample iterates until it
/// converges, and becomes NaN after 30 iterations without convergence.
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
    /// iterations. Clamped to at least 256 machine epsilons, because corrections of stiff fields
    /// stagnate near that size.
    pub tolerance: f64,
}

impl Default for ImplicitMidpoint {
    fn default() -> Self {
        Self { tolerance: 1e-12 }
    }
}

/// Maximal number of Newton iterations.
const MAX_ITERATIONS: usize = 30;

impl ImplicitMidpoint {
    /// Writes `h/2 ∂f/∂x` by central differences, detached from differentiation.
    ///
    /// The Jacobian affects the rate of convergence, not the solution.
    #[inline(always)]
    fn differences<T: Scalar>(ode: &dyn DynOde<T>, h: T, inputs: OdeInputs<'_, T>, matrix: &mut [T]) {
        let (x, n) = (inputs.x, inputs.x.len());
        let (mut at, mut before, mut after) = (buffer(T::zero(), n), buffer(T::zero(), n), buffer(T::zero(), n));
        // Slices: indexing a `SmallVec` may compile to a call.
        let (at, before, after) = (&mut at[..], &mut before[..], &mut after[..]);
        at.copy_from_slice(x);
        let width = <T::Real as Float>::EPSILON.cbrt();
        for j in 0..n {
            let by = (T::from(width) * (T::one() + x[j].abs())).detach();
            at[j] = x[j] - by;
            ode.rate(inputs.with_x(at), before);
            at[j] = x[j] + by;
            ode.rate(inputs.with_x(at), after);
            at[j] = x[j];
            let factor = h * 0.25 / by;
            for i in 0..n {
                matrix[i * n + j] = ((after[i] - before[i]) * factor).detach();
            }
        }
    }

    /// Solves for the next state to `tolerance`. Writes NaN in lanes that do not converge.
    #[inline(always)]
    fn solve<T: Scalar>(tolerance: f64, ode: &dyn DynOde<T>, dt: f64, inputs: Inputs<'_, T>, next: &mut [T]) {
        let to_go = Self::iterate(tolerance, ode, dt, inputs, next);
        for next in next {
            *next = T::select_lt(T::zero(), to_go, T::from(f64::NAN), *next);
        }
    }

    /// Solves for the next state by simplified Newton iteration. Returns 0 in lanes that converged,
    /// else a positive number.
    #[inline(always)]
    fn iterate<T: Scalar>(tolerance: f64, ode: &dyn DynOde<T>, dt: f64, inputs: Inputs<'_, T>, next: &mut [T]) -> T {
        let (h, x, n) = (T::from(dt), inputs.x, inputs.x.len());
        let halfway = halfway(dt, inputs);
        let (mut middle, mut rate, mut residual) = (buffer(T::zero(), n), buffer(T::zero(), n), buffer(T::zero(), n));
        let (middle, rate, residual) = (&mut middle[..], &mut rate[..], &mut residual[..]);
        let half = T::from(0.5);
        ode.rate(inputs.continuous(dt), rate);
        for i in 0..n {
            next[i] = x[i] + h * rate[i];
            middle[i] = (x[i] + next[i]) * half;
        }
        let (mut matrix, mut inverse) = (buffer(T::zero(), n * n), buffer(T::zero(), n * n));
        let (matrix, inverse) = (&mut matrix[..], &mut inverse[..]);
        Self::differences(ode, h, halfway.with_x(middle), matrix);
        invert_one_minus(matrix, inverse, n);
        let tolerance = T::from(tolerance.max(256.0 * <T::Real as Float>::EPSILON));
        // Tangents of dual numbers converge one iteration after the values.
        let rounds_after = T::from(2.0);
        let mut to_go = rounds_after;
        for _ in 0..MAX_ITERATIONS {
            if !T::any_lt(T::zero(), to_go) {
                break;
            }
            for i in 0..n {
                middle[i] = (x[i] + next[i]) * half;
            }
            ode.rate(halfway.with_x(middle), rate);
            for i in 0..n {
                residual[i] = next[i] - x[i] - h * rate[i];
            }
            let mut largest = T::zero();
            for i in 0..n {
                let mut correction = T::zero();
                for j in 0..n {
                    correction += inverse[i * n + j] * residual[j];
                }
                let size = correction.abs() / (T::one() + next[i].abs());
                largest = T::select_lt(size, largest, largest, size);
                next[i] = T::select_lt(T::zero(), to_go, next[i] - correction, next[i]);
            }
            let next_to_go = T::select_lt(largest, tolerance, to_go - T::one(), rounds_after).detach();
            // A converged lane stays converged, so its result does not depend on the other lanes.
            to_go = T::select_lt(T::zero(), to_go, next_to_go, to_go);
        }
        to_go
    }
}

/// Inputs with the time of the middle of the step.
#[inline(always)]
fn halfway<T: Scalar>(dt: f64, inputs: Inputs<'_, T>) -> OdeInputs<'_, T> {
    inputs.at(stage_time(inputs.t, dt, 0.5))
}

/// Writes `(I - matrix)⁻¹` to `inverse` by Gauss–Jordan elimination; destroys `matrix`.
///
/// Pivoting is branch-free. In each column, conditional row swaps move the entry of largest
/// absolute value, on or below the diagonal, to the diagonal.
#[inline(always)]
fn invert_one_minus<T: Scalar>(matrix: &mut [T], inverse: &mut [T], n: usize) {
    for i in 0..n {
        for j in 0..n {
            let one = if i == j { T::one() } else { T::zero() };
            matrix[i * n + j] = one - matrix[i * n + j];
            inverse[i * n + j] = one;
        }
    }
    for column in 0..n {
        for row in column + 1..n {
            let (here, below) = (matrix[column * n + column].abs(), matrix[row * n + column].abs());
            for both in [&mut *matrix, &mut *inverse] {
                for j in 0..n {
                    let (a, b) = (both[column * n + j], both[row * n + j]);
                    both[column * n + j] = T::select_lt(here, below, b, a);
                    both[row * n + j] = T::select_lt(here, below, a, b);
                }
            }
        }
        let per_pivot = T::one() / matrix[column * n + column];
        for both in [&mut *matrix, &mut *inverse] {
            for j in 0..n {
                both[column * n + j] *= per_pivot;
            }
        }
        for row in (0..n).filter(|&row| row != column) {
            let factor = matrix[row * n + column];
            for both in [&mut *matrix, &mut *inverse] {
                for j in 0..n {
                    let above = both[column * n + j];
                    both[row * n + j] -= factor * above;
                }
            }
        }
    }
}

impl Integrator for ImplicitMidpoint {
    #[inline(always)]
    fn advance<T: Scalar>(&self, ode: &dyn DynOde<T>, dt: f64, inputs: Inputs<'_, T>, next: &mut [T]) {
        Self::solve(self.tolerance, ode, dt, inputs, next);
    }

    fn unsolved<R: Real>(&self, ode: &dyn DynOde<R>, dt: f64, inputs: Inputs<'_, R>) -> Option<f64> {
        let (h, x) = (R::from(dt), inputs.x);
        let (mut next, mut rate, mut middle) =
            (buffer(R::zero(), x.len()), buffer(R::zero(), x.len()), buffer(R::zero(), x.len()));
        let to_go = Self::iterate(self.tolerance, ode, dt, inputs, &mut next);
        for i in 0..x.len() {
            middle[i] = (x[i] + next[i]) * R::from(0.5);
        }
        ode.rate(halfway(dt, inputs).with_x(&middle), &mut rate);
        let residual = (0..x.len()).map(|i| (next[i] - x[i] - h * rate[i]).lane(0).to_f64().abs());
        // Reports a NaN residual as infinite.
        let largest = residual.fold(0.0, |largest, r| if r.is_nan() { f64::INFINITY } else { r.max(largest) });
        R::any_lt(R::zero(), to_go).then_some(largest)
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
        let (h, x, n) = (R::from(dt), inputs.x, inputs.x.len());
        let mut middle = buffer(R::zero(), n);
        Self::solve(0.0, ode, dt, inputs, &mut middle);
        for i in 0..n {
            middle[i] = (x[i] + middle[i]) * R::from(0.5);
        }
        let halfway = halfway(dt, inputs).with_x(&middle);
        let (mut matrix, mut inverse) = (buffer(R::zero(), n * n), buffer(R::zero(), n * n));
        let (matrix, inverse) = (&mut matrix[..], &mut inverse[..]);
        for i in 0..n {
            let row = &mut matrix[i * n..][..n];
            ode.slopes(halfway, i, row);
            for slope in row {
                *slope *= h * R::from(0.5);
            }
        }
        invert_one_minus(matrix, inverse, n);
        // rate_bar = h w.
        let mut rate_bar = buffer(C::null(), n);
        for j in 0..n {
            let mut w = C::null();
            for i in 0..n {
                w += next_bar[i] * inverse[i * n + j];
            }
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
