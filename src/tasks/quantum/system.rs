//! The physics of a particle in a box.

use super::elimination::Elimination;
use crate::effect::{Effect, Host, system_without_effects};
use crate::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};
use smallvec::{SmallVec, smallvec};
use std::f64::consts::PI;

/// Grid points that are worked on without allocating; larger grids allocate in every step.
pub(super) const STACK: usize = 64;
/// A complex number as its real and imaginary part.
pub(super) type Pair<T> = (T, T);
/// A number for each grid point.
type PerPoint<T> = SmallVec<[T; STACK]>;
/// Real and imaginary part for each grid point.
pub(super) type Wave<T> = SmallVec<[T; 2 * STACK]>;

/// The physics: Schrödinger's equation in a box with a linear potential, by Crank and Nicolson.
///
/// State `[Re ψ_1, Im ψ_1, Re ψ_2, …]`, shape (grid, 2) row-major, at the points `x_j = j dx`, `j = 1 .. grid`; ψ is 0
/// at the walls, `j = 0` and `j = grid + 1`, and `Σ_j |ψ_j|² = 1`, without dx. Control `[c]`, the slope of the potential.
///
/// ```text
/// H = -D₂ + diag(V_j)                 D₂: second difference over dx², dx = length / (grid + 1)
/// V_j = c x_j                         or c (x_j - length/2): see ControlShape
/// A = I + i dt/2 H
/// ψ' = A⁻¹ (I - i dt/2 H) ψ = 2 A⁻¹ ψ - ψ
/// ```
///
/// Forces, for effects to add to: the potential `V_j` at the grid points, `grid` real numbers. Where it depends on the
/// state, that is the state in which the step begins.
///
/// The step is unitary whatever the potential. It costs one tridiagonal solve, O(grid). Elimination without pivoting is
/// safe although large potentials end the dominance of the diagonal: the Hermitian part of A is the identity, so the
/// real part of every pivot is at least 1 (`p_j = A_jj + b²/p_{j-1}` with `b = dt / 2dx²`; `Re A_jj = 1`, and 1/p has
/// its real part positive when p has). Golub and Van Loan, Matrix Computations, 4.2.2.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct QuantumSystem {
    /// Number of grid points between the walls, at least 3.
    pub grid: usize,
    /// Length of the box, positive.
    pub length: f64,
    /// Time step, positive. The control is constant during it.
    pub dt: f64,
    /// Where the control's potential is 0.
    pub control: ControlShape,
}

impl Default for QuantumSystem {
    fn default() -> Self {
        Self { grid: 32, length: 2.0, dt: 0.0625, control: ControlShape::Tilt }
    }
}

/// The potential that a control c makes.
///
/// The two differ by the same energy everywhere, `c length/2`. In continuous time that is a phase common to all points,
/// which no probability knows of; a step of Crank and Nicolson turns energies into phases by `2 atan(E dt/2)`, so that
/// relative phases differ by O(c dt³) in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ControlShape {
    /// `V = c x`, 0 at the left wall: a tilted floor, as in the authors' code.
    #[default]
    Tilt,
    /// `V = c (x - length/2)`, 0 in the middle: a charge in a uniform field. The opposite control does the same to the
    /// mirrored state.
    Dipole,
}

impl QuantumSystem {
    /// Eigenstate `number` of the box without potential, at the grid points; 1 is the ground state.
    ///
    /// ```text
    /// φ_j = sqrt(2 / (grid + 1)) sin(π number j / (grid + 1)),  Σ_j φ_j² = 1,  1 ≤ number ≤ grid
    /// ```
    #[inline(always)]
    pub fn eigenstate(&self, number: usize) -> impl Iterator<Item = f64> + use<> {
        let intervals = (self.grid + 1) as f64;
        // One sine, then rotations: their error grows by one rounding a grid point.
        let (sin, cos) = Scalar::sin_cos(PI * number as f64 / intervals);
        let (mut s, mut c) = (0.0, (2.0 / intervals).sqrt());
        (0..self.grid).map(move |_| {
            (s, c) = (s * cos + c * sin, c * cos - s * sin);
            s
        })
    }

    /// Distance dx between grid points.
    #[inline(always)]
    pub fn spacing(&self) -> f64 {
        self.length / (self.grid + 1) as f64
    }

    /// The grid points `x_j`, from 0 at the left wall.
    #[inline(always)]
    pub fn points(&self) -> impl Iterator<Item = f64> + use<> {
        self.places(0.0)
    }

    /// The grid points from the middle of the box, `ξ_j = x_j - length/2`. Mirrored points have the same number with the
    /// opposite sign, bit for bit.
    #[inline(always)]
    pub fn centered_points(&self) -> impl Iterator<Item = f64> + use<> {
        self.places(self.middle())
    }

    /// The middle of the box, in grid points.
    #[inline(always)]
    fn middle(&self) -> f64 {
        0.5 * (self.grid + 1) as f64
    }

    /// The grid points from `origin`, which is in grid points.
    #[inline(always)]
    fn places(&self, origin: f64) -> impl Iterator<Item = f64> + use<> {
        let dx = self.spacing();
        (1..=self.grid).map(move |j| (j as f64 - origin) * dx)
    }

    /// The potential under control 1.
    #[inline(always)]
    fn lever(&self) -> impl Iterator<Item = f64> + use<> {
        self.places(match self.control {
            ControlShape::Tilt => 0.0,
            ControlShape::Dipole => self.middle(),
        })
    }

    /// A of a step. What it works with, it writes to `potential`, which begins as the control, and to `per_pivot`: a
    /// full array that is returned may be copied.
    #[inline(always)]
    fn eliminate<'a, E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        x: &[T],
        potential: &mut [T],
        per_pivot: &'a mut [Pair<T>],
    ) -> Elimination<'a, T> {
        for (v, lever) in potential.iter_mut().zip(self.lever()) {
            *v *= T::lift(lever);
        }
        effects.act(self, x, potential);
        Elimination::new(self.dt, self.spacing(), potential, per_pivot)
    }

    /// `x_bar = 2 w - v` with `w = A⁻ᴴ v`: the cotangents of real and imaginary parts are carried by the conjugate
    /// transpose of the complex matrix.
    #[inline(always)]
    fn reverse_state<R: Real, C: Cotangent<R>>(conjugate: &Elimination<'_, R>, next_bar: &[C], x_bar: &mut [C]) {
        conjugate.solve(next_bar, x_bar);
        for (x_bar, &next_bar) in x_bar.iter_mut().zip(next_bar) {
            *x_bar = *x_bar + *x_bar - next_bar;
        }
    }

    /// The potential's cotangent, from `w = (x_bar + v) / 2`:
    ///
    /// ```text
    /// A y = ψ, so dψ'/dV_j = 2 dy/dV_j = -i dt A⁻¹ e_j y_j
    /// V_bar_j = Re ⟨v, dψ'/dV_j⟩ = dt Im(w̄_j y_j)
    /// ```
    #[inline(always)]
    fn reverse_potential<R: Real, C: Cotangent<R>>(&self, y: &[R], next_bar: &[C], x_bar: &[C], potential_bar: &mut [C]) {
        let half_dt = R::lift(0.5 * self.dt);
        let waves = y.chunks_exact(2).zip(next_bar.chunks_exact(2)).zip(x_bar.chunks_exact(2));
        for (potential_bar, ((y, v), x_bar)) in potential_bar.iter_mut().zip(waves) {
            let (twice_re, twice_im) = (x_bar[0] + v[0], x_bar[1] + v[1]);
            *potential_bar = (twice_re * y[1] - twice_im * y[0]) * half_dt;
        }
    }
}

impl Host for QuantumSystem {
    type Body = Self;

    fn body(&self) -> &Self {
        self
    }

    fn state_dim(&self) -> usize {
        2 * self.grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn dt(&self) -> f64 {
        self.dt
    }

    #[inline(always)]
    fn step_with<E: Effect<Self>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], next: &mut [T]) {
        let mut potential: PerPoint<T> = smallvec![u[0]; self.grid];
        let mut per_pivot: PerPoint<Pair<T>> = smallvec![(T::zero(), T::zero()); self.grid];
        self.eliminate(effects, x, &mut potential, &mut per_pivot).solve(x, next);
        for (next, &x) in next.iter_mut().zip(x) {
            *next = *next + *next - x;
        }
    }

    #[inline(always)]
    fn reverse<E: Effect<Self>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        next_bar: &[C],
        x_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        let n = 2 * self.grid;
        let mut potential: PerPoint<R> = smallvec![u[0]; self.grid];
        let mut per_pivot: PerPoint<Pair<R>> = smallvec![(R::zero(), R::zero()); self.grid];
        let mut a = self.eliminate(effects, x, &mut potential, &mut per_pivot);
        let effects_read = x_bar.is_some() && effects.reads_state();
        // What only the state's cotangent needs ends here.
        if u_bar.is_none() && !effects_read {
            if let Some(x_bar) = x_bar {
                a.conjugate();
                Self::reverse_state(&a, next_bar, &mut x_bar[..n]);
            }
            return;
        }
        // Solved again rather than kept by the forward pass.
        let mut y: Wave<R> = smallvec![R::zero(); n];
        a.solve(x, &mut y);
        a.conjugate();
        let mut scratch: Wave<C> = smallvec![C::null(); if x_bar.is_some() { 0 } else { n }];
        let x_bar = x_bar.unwrap_or(&mut scratch);
        Self::reverse_state(&a, next_bar, &mut x_bar[..n]);
        let mut potential_bar: PerPoint<C> = smallvec![C::null(); self.grid];
        self.reverse_potential(&y, next_bar, x_bar, &mut potential_bar);
        if let Some(u_bar) = u_bar {
            u_bar[0] = C::null();
            for (&potential_bar, lever) in potential_bar.iter().zip(self.lever()) {
                u_bar[0] += potential_bar * R::lift(lever);
            }
        }
        if effects_read {
            effects.vjp(self, x, &potential_bar, x_bar);
        }
    }
}

system_without_effects!(QuantumSystem);
