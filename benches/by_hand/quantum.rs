//! Handwritten step and VJP of a particle in a box with a harmonic trap and a cubic term. The
//! control is the slope of a linear potential. [`QuantumSystem`] documents the equations.

use arrayvec::ArrayVec;
use physgrad::effect::HasModel;
use physgrad::rng::Rng;
use physgrad::tasks::{Cubic, Harmonic, QuantumSystem};
use physgrad::{Cotangent, Cotangents, Inputs, Real, Scalar, Start, System};
use std::ops::{Add, Mul, Sub};

/// Physics for at most 64 grid points. The const generics enable the trap and the cubic term.
#[derive(Clone)]
pub struct ByHand<const TRAP: bool, const CUBIC: bool> {
    pub system: QuantumSystem,
    pub trap: Harmonic,
    pub cubic: Cubic,
}

/// One value per grid point.
type PerPoint<T> = ArrayVec<T, 64>;

/// Solves `A y = rhs` for a tridiagonal A, from its reciprocal pivots and its off-diagonal entry
/// `-ib`.
#[inline(always)]
fn solve<T, V>(inverse_pivots: &[(T, T)], b: T, rhs: &[V], y: &mut [V])
where
    T: Scalar,
    V: Copy + Add<Output = V> + Sub<Output = V> + Mul<T, Output = V>,
{
    let mut previous: Option<(V, V)> = None;
    for ((rhs, y), &(q_re, q_im)) in
        rhs.chunks_exact(2).zip(y.chunks_exact_mut(2)).zip(inverse_pivots)
    {
        let (mut re, mut im) = (rhs[0], rhs[1]);
        if let Some((s_re, s_im)) = previous {
            (re, im) = (re - s_im * b, im + s_re * b);
        }
        (y[0], y[1]) = (re * q_re - im * q_im, re * q_im + im * q_re);
        previous = Some((y[0], y[1]));
    }
    let mut following: Option<(V, V)> = None;
    for (y, &(q_re, q_im)) in y.chunks_exact_mut(2).zip(inverse_pivots).rev() {
        if let Some((y_re, y_im)) = following {
            let (re, im) = (q_re * b, q_im * b);
            y[0] = y[0] - (y_re * im + y_im * re);
            y[1] = y[1] + (y_re * re - y_im * im);
        }
        following = Some((y[0], y[1]));
    }
}

impl<const TRAP: bool, const CUBIC: bool> ByHand<TRAP, CUBIC> {
    /// Returns the off-diagonal magnitude `b` and stores the reciprocal pivots of A.
    #[inline(always)]
    fn eliminate<T: Scalar>(&self, x: &[T], u: &[T], inverse_pivots: &mut PerPoint<(T, T)>) -> T {
        let (s, dx, half_dt) = (&self.system, self.system.spacing(), 0.5 * self.system.dt);
        let off_diagonal = half_dt / (dx * dx);
        let (b, kinetic) = (T::from(off_diagonal), T::from(2.0 * off_diagonal));
        let (tilt, strength) = (u[0] * (half_dt * dx), T::from(half_dt * self.cubic.strength / dx));
        let b_squared = b * b;
        let (mut q_re, mut q_im) = (T::zero(), T::zero());
        for (j, psi) in x.chunks_exact(2).enumerate() {
            let point = (j + 1) as f64;
            let mut potential = kinetic + tilt * point;
            if TRAP {
                let xi = point * dx - 0.5 * s.length - self.trap.center;
                potential += half_dt * self.trap.stiffness * xi * xi;
            }
            if CUBIC {
                potential += strength * (psi[0] * psi[0] + psi[1] * psi[1]);
            }
            let re = T::one() + b_squared * q_re;
            let im = potential + b_squared * q_im;
            let per_square = T::one() / (re * re + im * im);
            (q_re, q_im) = (re * per_square, -(im * per_square));
            inverse_pivots.push((q_re, q_im));
        }
        b
    }
}

impl<const TRAP: bool, const CUBIC: bool> System for ByHand<TRAP, CUBIC> {
    fn state_dim(&self) -> usize {
        2 * self.system.grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let mut inverse_pivots = PerPoint::new();
        let b = self.eliminate(x, u, &mut inverse_pivots);
        solve(&inverse_pivots, b, x, next);
        for (next, &x) in next.iter_mut().zip(x) {
            *next = *next + *next - x;
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, u, .. }: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        // Scratch for cotangents that are not requested.
        let (mut x_scratch, mut u_scratch) = (ArrayVec::<C, 128>::new(), ArrayVec::<C, 64>::new());
        let x_bar = cotangents.x.unwrap_or_else(|| {
            x_scratch.extend(x.iter().map(|_| C::null()));
            &mut x_scratch[..]
        });
        let u_bar = cotangents.u.unwrap_or_else(|| {
            u_scratch.extend(u.iter().map(|_| C::null()));
            &mut u_scratch[..]
        });
        let mut inverse_pivots = PerPoint::new();
        let b = self.eliminate(x, u, &mut inverse_pivots);
        let mut y = PerPoint::new();
        y.extend(x.chunks_exact(2).map(|_| [R::zero(); 2]));
        solve(&inverse_pivots, b, x, y.as_flattened_mut());
        for (_, im) in &mut inverse_pivots {
            *im = -*im;
        }
        let mut waves_bar = PerPoint::new();
        waves_bar.extend(x.chunks_exact(2).map(|_| [C::null(); 2]));
        solve(&inverse_pivots, -b, next_bar, waves_bar.as_flattened_mut());
        let (factor, dx) = (0.5 * self.system.dt * self.system.spacing(), self.system.spacing());
        let slope = R::from(self.system.dt * self.cubic.strength / dx);
        let waves = x
            .chunks_exact(2)
            .zip(&y)
            .zip(next_bar.chunks_exact(2))
            .zip(&waves_bar)
            .zip(x_bar.chunks_exact_mut(2));
        for (j, ((((psi, y), v), w), x_bar)) in waves.enumerate() {
            // y = A⁻¹ ψ, w = A⁻ᴴ v, and V_bar = dt Im(w̄ y).
            let bar = (w[0] * y[1] - w[1] * y[0]) * R::from(2.0);
            u_bar[0] += bar * R::from(factor * (j + 1) as f64);
            x_bar[0] += w[0] + w[0] - v[0];
            x_bar[1] += w[1] + w[1] - v[1];
            if CUBIC {
                let bar = bar * slope;
                x_bar[0] += bar * psi[0];
                x_bar[1] += bar * psi[1];
            }
        }
    }
}

impl<const TRAP: bool, const CUBIC: bool> HasModel<QuantumSystem> for ByHand<TRAP, CUBIC> {
    #[inline(always)]
    fn model(&self) -> &QuantumSystem {
        &self.system
    }

    fn start_extra(&self, _rng: &mut Rng, _start: Start<'_>) {}
}
