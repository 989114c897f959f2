//! [`Stage`]: the equation of one implicit stage, solved by Newton's iteration.

use super::buffer;
use crate::dynamics::inputs::OdeInputs;
use crate::dynamics::ode::{DynOde, DynOdeVjp};
use crate::dynamics::outline::outline;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// Smallest effective tolerance, in machine epsilons: corrections of stiff fields stagnate near
/// this size.
const FLOOR: f64 = 256.0;

/// Smallest effective `tolerance` in the precision `F`.
pub(super) fn floor<F: Float>() -> f64 {
    FLOOR * F::EPSILON
}

/// Maximal number of iterations with the first Jacobian.
const MOST_FROZEN: usize = 30;

/// Maximal number of iterations with renewed Jacobians.
const MOST_RENEWED: usize = 200;

/// A lane gives up at a larger shift σ, for example if the rate at the guess is NaN.
const LARGEST_SHIFT: f64 = 1e8;

/// The correction must be small in two successive iterations: tangents of dual numbers converge
/// after the values.
const SMALL_ROUNDS: f64 = 2.0;

/// Further iterations for the derivatives that numbers carry. Each one multiplies their error by the
/// relative error of a new Jacobian, about 1e-3 where a stiff field bends within 1e-4. At rest, the values
/// converge at once, and the derivatives do not.
const TANGENT_ROUNDS: usize = 6;

/// Where a stage evaluates the vector field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    /// At the mean of `base` and the solution.
    Middle,
    /// At the solution.
    End,
}

/// The equation `z = base + h f(y, u, p, t)` for z, where y is z or the mean of `base` and z.
///
/// Each lane iterates until its largest correction `|Δz_i| / (1 + |z_i|)` is below the tolerance in
/// two successive iterations. First come up to 30 iterations of simplified Newton iteration, with
/// one Jacobian. Lanes that do not converge start again from another guess, with a new Jacobian in
/// each iteration and with damped corrections.
pub(super) struct Stage<'a, T> {
    pub ode: &'a dyn DynOde<T>,
    /// Control, parameters and time of the stage; the state is ignored.
    pub inputs: OdeInputs<'a, T>,
    pub base: &'a [T],
    /// Factor of the rate, s.
    pub h: T,
    pub place: Place,
}

impl<T: Scalar> Stage<'_, T> {
    /// Derivative of y with respect to z.
    #[inline(always)]
    fn share(&self) -> f64 {
        match self.place {
            Place::Middle => 0.5,
            Place::End => 1.0,
        }
    }

    /// Writes y.
    #[inline(always)]
    pub fn argument(&self, z: &[T], y: &mut [T]) {
        for i in 0..z.len() {
            y[i] = match self.place {
                Place::Middle => (self.base[i] + z[i]) * T::from(0.5),
                Place::End => z[i],
            };
        }
    }

    /// Writes `z - base - h f(y)`; `y` is a workspace.
    #[inline(always)]
    fn residual(&self, z: &[T], y: &mut [T], residual: &mut [T]) {
        self.argument(z, y);
        self.ode.rate(self.inputs.with_x(y), residual);
        for i in 0..z.len() {
            residual[i] = z[i] - self.base[i] - self.h * residual[i];
        }
    }

    /// Writes `h ∂f/∂z` by central differences, detached from differentiation.
    ///
    /// The Jacobian affects the rate of convergence, not the solution.
    #[inline(always)]
    fn differences(&self, z: &[T], matrix: &mut [T]) {
        let n = z.len();
        let (mut at, mut before, mut after) =
            (buffer(T::zero(), n), buffer(T::zero(), n), buffer(T::zero(), n));
        // Slices: indexing a `SmallVec` may compile to a call.
        let (at, before, after) = (&mut at[..], &mut before[..], &mut after[..]);
        self.argument(z, at);
        let width = <T::Real as Float>::EPSILON.cbrt();
        for j in 0..n {
            let y = at[j];
            let by = (T::from(width) * (T::one() + y.abs())).detach();
            at[j] = y - by;
            self.ode.rate(self.inputs.with_x(at), before);
            at[j] = y + by;
            self.ode.rate(self.inputs.with_x(at), after);
            at[j] = y;
            let factor = self.h * (0.5 * self.share()) / by;
            for i in 0..n {
                matrix[i * n + j] = ((after[i] - before[i]) * factor).detach();
            }
        }
    }

    /// Writes the inverse of the Jacobian of the residual at `z`, `(I - h ∂f/∂z)⁻¹`. Outlined.
    pub fn linearize(&self, z: &[T], inverse: &mut [T]) {
        outline::<T>(Linearize { stage: self, z, inverse });
    }

    /// Solves for `z` from the guess in `z`. `inverse` is that of [`linearize`](Self::linearize) at
    /// a point nearby. Lanes that do not converge with it start again from the guess `again`.
    /// Returns 0 in lanes that converged, else a positive number. Outlined.
    pub fn solve(&self, tolerance: f64, inverse: &[T], again: &[T], z: &mut [T]) -> T {
        let mut to_go = T::zero();
        outline::<T>(Solve { stage: self, tolerance, inverse, again, z, to_go: &mut to_go });
        to_go
    }

    /// [`solve`](Self::solve), inlined.
    #[inline(always)]
    fn iterate(&self, tolerance: f64, inverse: &[T], again: &[T], z: &mut [T]) -> T {
        let n = z.len();
        let tolerance = T::from(tolerance.max(floor::<T::Real>()));
        let rounds = T::from(SMALL_ROUNDS);
        let (mut y, mut residual) = (buffer(T::zero(), n), buffer(T::zero(), n));
        let (y, residual) = (&mut y[..], &mut residual[..]);
        let mut to_go = rounds;
        for _ in 0..MOST_FROZEN {
            if !T::any_lt(T::zero(), to_go) {
                break;
            }
            self.residual(z, y, residual);
            let mut largest = T::zero();
            for i in 0..n {
                let mut correction = T::zero();
                for j in 0..n {
                    correction += inverse[i * n + j] * residual[j];
                }
                let size = correction.abs() / (T::one() + z[i].abs());
                largest = T::select_lt(size, largest, largest, size);
                z[i] = T::select_lt(T::zero(), to_go, z[i] - correction, z[i]);
            }
            let next_to_go = T::select_lt(largest, tolerance, to_go - T::one(), rounds).detach();
            // A converged lane stays converged, so its result does not depend on the other lanes.
            to_go = T::select_lt(T::zero(), to_go, next_to_go, to_go);
        }
        if T::any_lt(T::zero(), to_go) {
            for i in 0..n {
                z[i] = T::select_lt(T::zero(), to_go, again[i], z[i]);
            }
            to_go = self.solve_renewed(tolerance, to_go, z);
        }
        if T::DIFFERENTIATES {
            let mut inverse = buffer(T::zero(), n * n);
            self.linearize(z, &mut inverse);
            for _ in 0..TANGENT_ROUNDS {
                self.residual(z, y, residual);
                for i in 0..n {
                    let row = inverse[i * n..][..n].iter().zip(residual.iter());
                    let correction = row.fold(T::zero(), |sum, (&entry, &r)| sum + entry * r);
                    z[i] = T::select_lt(T::zero(), to_go, z[i], z[i] - correction);
                }
            }
        }
        to_go
    }

    /// Continues lanes with positive `to_go` from the guess in `z`, with a new Jacobian in each
    /// iteration. Returns 0 in lanes that converged.
    ///
    /// Pseudo-transient continuation (Kelley and Keyes 1998, doi:10.1137/S0036142996304796). The
    /// correction is that of one linearly implicit Euler step of `dz/dτ = -residual(z)`,
    ///
    /// ```text
    /// Δ = ((1 + σ) I - h ∂f/∂z)⁻¹ residual(z),   z ← z - Δ
    /// ```
    ///
    /// with the step 1/σ; Newton's iteration has σ = 0. An iteration is accepted if what the
    /// linearization misses would correct Δ by at most its half, and the determinant is positive.
    /// Otherwise the lane stays at z. Acceptance decreases σ, rejection increases it. Unlike a line
    /// search on the residual, the iteration passes a point where the Jacobian is singular, as
    /// at an ignition, and follows the solution in the direction of time.
    #[cold]
    #[inline(never)]
    fn solve_renewed(&self, tolerance: T, mut to_go: T, z: &mut [T]) -> T {
        let n = z.len();
        let (zero, one, rounds) = (T::zero(), T::one(), T::from(SMALL_ROUNDS));
        let (mut y, mut residual, mut step, mut trial) =
            (buffer(zero, n), buffer(zero, n), buffer(zero, n), buffer(zero, n));
        let (mut matrix, mut inverse) = (buffer(zero, n * n), buffer(zero, n * n));
        to_go = T::select_lt(zero, to_go, rounds, to_go).detach();
        let mut sigma = one;
        for _ in 0..MOST_RENEWED {
            // 0 in lanes that converged or gave up.
            let left = T::select_lt(sigma, T::from(LARGEST_SHIFT), to_go, zero);
            if !T::any_lt(zero, left) {
                break;
            }
            self.differences(z, &mut matrix);
            let determinant = invert_minus(one + sigma, &mut matrix, &mut inverse, n);
            self.residual(z, &mut y, &mut residual);
            let length = multiply(&inverse, &residual, z, &mut step);
            for i in 0..n {
                trial[i] = z[i] - step[i];
            }
            self.residual(&trial, &mut y, &mut residual);
            for i in 0..n {
                residual[i] -= sigma * step[i];
            }
            // The workspace y receives the correction of the step.
            let missed = multiply(&inverse, &residual, z, &mut y);
            // Differences of rounding errors are accepted.
            let allowed = (length * 0.5).max(tolerance);
            let accepted =
                T::select_lt(missed, allowed, T::select_lt(zero, determinant, one, zero), zero)
                    .detach();
            // A lane has converged only without a shift; positive shifts are at least 1/128.
            let small = T::select_lt(
                sigma,
                T::from(1e-3),
                T::select_lt(length, tolerance, one, zero),
                zero,
            );
            let next_to_go = T::select_lt(zero, small * accepted, to_go - one, rounds).detach();
            let moves = T::select_lt(zero, left, accepted, zero);
            for i in 0..n {
                z[i] = T::select_lt(zero, moves, trial[i], z[i]);
            }
            let smaller = T::select_lt(sigma, T::from(1.0 / 16.0), zero, sigma * 0.125);
            let next_sigma =
                T::select_lt(zero, accepted, smaller, sigma * 4.0 + T::from(1.0 / 16.0));
            sigma = T::select_lt(zero, left, next_sigma, sigma).detach();
            to_go = T::select_lt(zero, left, next_to_go, to_go);
        }
        to_go
    }

    /// Largest absolute residual at `z` in the first lane; infinite if a residual is NaN.
    pub fn largest_residual(&self, z: &[T]) -> f64
    where
        T: Real,
    {
        let (mut y, mut residual) = (buffer(T::zero(), z.len()), buffer(T::zero(), z.len()));
        self.residual(z, &mut y, &mut residual);
        let sizes = residual.iter().map(|residual| residual.lane(0).to_f64().abs());
        sizes.fold(
            0.0,
            |largest, size| if size.is_nan() { f64::INFINITY } else { size.max(largest) },
        )
    }
}

/// Outlined [`Stage::linearize`].
struct Linearize<'a, 's, T> {
    stage: &'a Stage<'s, T>,
    z: &'a [T],
    inverse: &'a mut [T],
}

impl<T: Scalar> Vectorized for Linearize<'_, '_, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { stage, z, inverse } = self;
        let mut matrix = buffer(T::zero(), inverse.len());
        stage.differences(z, &mut matrix);
        invert_minus(T::one(), &mut matrix, inverse, z.len());
    }
}

/// Outlined [`Stage::solve`].
struct Solve<'a, 's, T> {
    stage: &'a Stage<'s, T>,
    tolerance: f64,
    inverse: &'a [T],
    again: &'a [T],
    z: &'a mut [T],
    to_go: &'a mut T,
}

impl<T: Scalar> Vectorized for Solve<'_, '_, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { stage, tolerance, inverse, again, z, to_go } = self;
        *to_go = stage.iterate(tolerance, inverse, again, z);
    }
}

/// Writes `matrix vector` to `product`. Returns the largest `|product_i| / (1 + |z_i|)`; infinite or
/// NaN if an entry is.
#[inline(always)]
fn multiply<T: Scalar>(matrix: &[T], vector: &[T], z: &[T], product: &mut [T]) -> T {
    let n = z.len();
    let mut largest = T::zero();
    for i in 0..n {
        let mut sum = T::zero();
        for j in 0..n {
            sum += matrix[i * n + j] * vector[j];
        }
        product[i] = sum;
        let size = sum.abs() / (T::one() + z[i].abs());
        let larger = T::select_lt(size, largest, largest, size);
        largest = T::select_lt(largest, T::from(f64::INFINITY), larger, largest);
    }
    largest.detach()
}

/// Writes NaN in lanes with positive `to_go`.
#[inline(always)]
pub(super) fn mark_unsolved<T: Scalar>(to_go: T, z: &mut [T]) {
    for z in z {
        *z = T::select_lt(T::zero(), to_go, T::from(f64::NAN), *z);
    }
}

/// Writes `(I - h ∂f/∂x)⁻¹` at `inputs`, with the exact Jacobian.
#[inline(always)]
pub(super) fn exact_inverse<R: Real, C: Cotangent<R>>(
    ode: &dyn DynOdeVjp<R, C>,
    h: R,
    inputs: OdeInputs<'_, R>,
    inverse: &mut [R],
) {
    let n = inputs.x.len();
    let mut matrix = buffer(R::zero(), n * n);
    let matrix = &mut matrix[..];
    for i in 0..n {
        let row = &mut matrix[i * n..][..n];
        ode.slopes(inputs, i, row);
        for slope in row {
            *slope *= h;
        }
    }
    invert_minus(R::one(), matrix, inverse, n);
}

/// Entry `j` of `inverseᵀ bar`.
#[inline(always)]
pub(super) fn transposed<R: Real, C: Cotangent<R>>(inverse: &[R], bar: &[C], j: usize) -> C {
    let n = bar.len();
    let mut sum = C::null();
    for i in 0..n {
        sum += bar[i] * inverse[i * n + j];
    }
    sum
}

/// Writes `(diagonal I - matrix)⁻¹` to `inverse` by Gauss–Jordan elimination; destroys `matrix`.
/// Returns a number with the sign of the determinant.
///
/// Pivoting is branch-free. In each column, conditional row swaps move the entry of largest
/// absolute value, on or below the diagonal, to the diagonal. Outlined.
fn invert_minus<T: Scalar>(diagonal: T, matrix: &mut [T], inverse: &mut [T], n: usize) -> T {
    let mut sign = T::one();
    outline::<T>(Invert { diagonal, matrix, inverse, n, sign: &mut sign });
    sign
}

/// Outlined [`invert_minus`].
struct Invert<'a, T> {
    diagonal: T,
    matrix: &'a mut [T],
    inverse: &'a mut [T],
    n: usize,
    sign: &'a mut T,
}

impl<T: Scalar> Vectorized for Invert<'_, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        *self.sign = eliminate(self.diagonal, self.matrix, self.inverse, self.n);
    }
}

/// [`invert_minus`], inlined.
#[inline(always)]
fn eliminate<T: Scalar>(diagonal: T, matrix: &mut [T], inverse: &mut [T], n: usize) -> T {
    let mut sign = T::one();
    for i in 0..n {
        for j in 0..n {
            let (own, one) = if i == j { (diagonal, T::one()) } else { (T::zero(), T::zero()) };
            matrix[i * n + j] = own - matrix[i * n + j];
            inverse[i * n + j] = one;
        }
    }
    for column in 0..n {
        for row in column + 1..n {
            let (here, below) = (matrix[column * n + column].abs(), matrix[row * n + column].abs());
            sign = T::select_lt(here, below, -sign, sign);
            for both in [&mut *matrix, &mut *inverse] {
                for j in 0..n {
                    let (a, b) = (both[column * n + j], both[row * n + j]);
                    both[column * n + j] = T::select_lt(here, below, b, a);
                    both[row * n + j] = T::select_lt(here, below, a, b);
                }
            }
        }
        let pivot = matrix[column * n + column];
        sign = T::select_lt(pivot, T::zero(), -sign, sign);
        let per_pivot = T::one() / pivot;
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
    sign
}
