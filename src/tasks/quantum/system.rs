//! [`QuantumSystem`]: a particle in a box.

use super::elimination::{Elimination, Pivots, Rows};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs, add};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use std::f64::consts::PI;

/// Number of grid points up to which steps do not allocate.
pub(super) const STACK: usize = 64;
/// Complex number as real and imaginary part.
pub(super) type Pair<T> = (T, T);
/// One value per grid point.
pub(super) type PerPoint<T> = SmallVec<[T; STACK]>;
/// Real and imaginary part per grid point.
pub(super) type Wave<T> = SmallVec<[T; 2 * STACK]>;

/// Returns the distance from the left wall to grid point `j`, in units of dx. `j` counts from 0.
/// Converts via `u32`, because conversion from `u64` is slower.
#[inline(always)]
pub(super) fn place(j: usize) -> f64 {
    f64::from(j as u32 + 1)
}

/// Particle in a box with a linear potential: Schrödinger's equation by Crank-Nicolson.
///
/// State `[Re ψ_1, Im ψ_1, Re ψ_2, …]`, shape (grid, 2) row-major. The grid points are `x_j = j dx`
/// with `j = 1 .. grid`. ψ is 0 at the walls, `j = 0` and `j = grid + 1`. The norm is
/// `Σ_j |ψ_j|² = 1`, without dx. Control `[c]`, the slope of the potential.
///
/// ```text
/// H = -D₂ + diag(V_j)                 D₂: second difference over dx², dx = length / (grid + 1)
/// V_j = c x_j                         or c (x_j - length/2): see ControlShape
/// A = I + i dt/2 H
/// ψ' = A⁻¹ (I - i dt/2 H) ψ = 2 A⁻¹ ψ - ψ
/// ```
///
/// Forces, to which effects add: the potential `V_j` at the grid points, `grid` real numbers.
/// State-dependent potentials use the state at the beginning of the step.
///
/// Other schemes for the same equation are [`Pade`](super::Pade) and [`Strang`](super::Strang).
/// [`QuantumScheme`](super::QuantumScheme) is any of the three.
///
/// The step is unitary for any potential and costs one tridiagonal solve, O(grid). Elimination
/// needs no pivoting, although some negative potentials violate diagonal dominance. The Hermitian
/// part of A is the identity, so the real part of each pivot is at least 1. Proof:
/// `p_j = A_jj + b²/p_{j-1}` with `b = dt / (2 dx²)` and `Re A_jj = 1`, and the real part of 1/p is
/// positive if that of p is. See Golub and Van Loan, Matrix Computations, 4.2.2.
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
    /// Shape of the control potential.
    pub control: ControlShape,
}

impl Default for QuantumSystem {
    fn default() -> Self {
        Self { grid: 32, length: 2.0, dt: 0.0625, control: ControlShape::Tilt }
    }
}

/// Potential of a control c.
///
/// The two shapes differ by a constant energy, `c length/2`. In continuous time this is a global
/// phase, which affects no probability. A Crank-Nicolson step converts energies to phases by
/// `2 atan(E dt/2)`, so relative phases differ by O(c dt³) per step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ControlShape {
    /// `V = c x`, 0 at the left wall: a tilted floor, as in the authors' code.
    #[default]
    Tilt,
    /// `V = c (x - length/2)`, 0 in the middle: a charge in a uniform field. Mirroring the state
    /// and negating the control leaves the physics invariant.
    Dipole,
}

impl QuantumSystem {
    /// Returns eigenstate `number` of the box without potential, at the grid points. Number 1 is
    /// the ground state.
    ///
    /// ```text
    /// φ_j = sqrt(2 / (grid + 1)) sin(π number j / (grid + 1)),  Σ_j φ_j² = 1,  1 ≤ number ≤ grid
    /// ```
    #[inline(always)]
    pub fn eigenstate(&self, number: usize) -> impl Iterator<Item = f64> + use<> {
        let intervals = (self.grid + 1) as f64;
        // Computes one sine and cosine, then rotates. The error grows by one rounding per grid
        // point.
        let (sin, cos) = Scalar::sin_cos(PI * number as f64 / intervals);
        let (mut s, mut c) = (0.0, (2.0 / intervals).sqrt());
        (0..self.grid).map(move |_| {
            (s, c) = (s * cos + c * sin, c * cos - s * sin);
            s
        })
    }

    /// Returns the distance dx between grid points.
    #[inline(always)]
    pub fn spacing(&self) -> f64 {
        self.length / (self.grid + 1) as f64
    }

    /// Returns the grid points `x_j`, measured from the left wall.
    #[inline(always)]
    pub fn points(&self) -> impl Iterator<Item = f64> + use<> {
        self.places(0.0)
    }

    /// Returns the grid points measured from the middle of the box, `ξ_j = x_j - length/2`.
    /// Mirrored points have equal magnitude, bit for bit.
    #[inline(always)]
    pub fn centered_points(&self) -> impl Iterator<Item = f64> + use<> {
        self.places(self.middle())
    }

    /// Returns the distance of the middle of the box from the left wall, in units of dx.
    #[inline(always)]
    fn middle(&self) -> f64 {
        0.5 * (self.grid + 1) as f64
    }

    /// Returns the grid points measured from `origin`, which is in units of dx from the left wall.
    #[inline(always)]
    fn places(&self, origin: f64) -> impl Iterator<Item = f64> + use<> {
        let dx = self.spacing();
        (0..self.grid).map(move |j| (place(j) - origin) * dx)
    }

    /// Returns the zero of the control's potential, in units of dx from the left wall.
    #[inline(always)]
    pub(super) fn control_origin(&self) -> f64 {
        match self.control {
            ControlShape::Tilt => 0.0,
            ControlShape::Dipole => self.middle(),
        }
    }

    /// Writes the potential of the control and of the effects to an empty `potential`.
    #[inline(always)]
    pub(super) fn potential<'a, E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        potential: &'a mut PerPoint<T>,
    ) -> &'a [T] {
        let (control, dx, origin) = (inputs.u[0], self.spacing(), self.control_origin());
        potential.extend((0..self.grid).map(|j| control * ((place(j) - origin) * dx)));
        effects.add_forces(self, inputs, potential);
        potential
    }

    /// Returns the elimination of A for one step, with `per_pivot` as buffer.
    #[inline(always)]
    fn eliminate<'a, E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        per_pivot: &'a mut PerPoint<Pair<T>>,
    ) -> Elimination<'a, T> {
        let mut potential = PerPoint::new();
        let mut rows = Rows::new(Pivots::new(self.dt, self.spacing(), 0.0), self.grid, per_pivot);
        for &v in self.potential(effects, inputs, &mut potential) {
            rows.push(v);
        }
        rows.elimination()
    }

    /// Writes `x_bar = 2 w - v`, given `w = A⁻ᴴ v` in `x_bar`. The conjugate transpose of the
    /// complex matrix propagates cotangents of real and imaginary parts. Returns the cotangent of
    /// the control if `with_control`, else 0. Writes the cotangent of the potential to
    /// `potential_bar`, if given:
    ///
    /// ```text
    /// A y = ψ, so dψ'/dV_j = 2 dy/dV_j = -i dt A⁻¹ e_j y_j
    /// V_bar_j = Re ⟨v, dψ'/dV_j⟩ = dt Im(conj(w_j) y_j)
    /// ```
    ///
    /// `v` is `next_bar`, and `dt` the time step of A.
    #[inline(always)]
    pub(super) fn reverse_potential<R: Real, C: Cotangent<R>>(
        &self,
        dt: f64,
        y: &[[R; 2]],
        next_bar: &[C],
        x_bar: &mut [C],
        with_control: bool,
        mut potential_bar: Option<&mut [C]>,
    ) -> C {
        let (dt, dx, origin, n) = (R::from(dt), self.spacing(), self.control_origin(), y.len());
        let v = &next_bar.as_chunks::<2>().0[..n];
        let mut control_bar = C::null();
        for j in 0..n {
            let w = &mut x_bar.as_chunks_mut::<2>().0[j];
            let bar = (w[0] * y[j][1] - w[1] * y[j][0]) * dt;
            *w = [w[0] + w[0] - v[j][0], w[1] + w[1] - v[j][1]];
            if with_control {
                control_bar += bar * R::from((place(j) - origin) * dx);
            }
            if let Some(potential_bar) = &mut potential_bar {
                potential_bar[j] = bar;
            }
        }
        control_bar
    }
}

impl ForcedSystem for QuantumSystem {
    type Model = Self;

    fn model(&self) -> &Self {
        self
    }

    fn state_dim(&self) -> usize {
        2 * self.grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn force_dim(&self) -> usize {
        self.grid
    }

    fn dt(&self) -> f64 {
        self.dt
    }

    #[inline(always)]
    fn forced_step<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let mut per_pivot = PerPoint::new();
        self.eliminate(effects, inputs.continuous(self.dt), &mut per_pivot).solve(inputs.x, next);
        for (next, &x) in zip(next.iter_mut(), inputs.x) {
            *next = *next + *next - x;
        }
    }

    #[inline(always)]
    fn forced_vjp<E: Effect<Self>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let inputs = inputs.continuous(self.dt);
        let mut per_pivot = PerPoint::new();
        let mut a = self.eliminate(effects, inputs, &mut per_pivot);
        let mut wave_bar = PerPoint::new();
        wave_bar.resize(self.grid, [C::null(); 2]);
        let wave_bar = wave_bar.as_flattened_mut();
        let effects_read = effects.state_dependent();
        // Shorter path if neither the control nor the effects need the cotangent of the potential.
        if cotangents.u.is_none() && !effects_read {
            if let Some(x_bar) = cotangents.x {
                a.conjugate();
                a.solve(next_bar, wave_bar);
                for (x_bar, (&w, &next_bar)) in
                    zip(x_bar.iter_mut(), zip(wave_bar.iter(), next_bar))
                {
                    *x_bar += w + w - next_bar;
                }
            }
            return;
        }
        // Recomputes the solution, because the forward pass does not store it.
        let mut y = PerPoint::new();
        y.resize(self.grid, [R::zero(); 2]);
        let y = &mut y[..];
        a.solve(inputs.x, y.as_flattened_mut());
        a.conjugate();
        a.solve(next_bar, wave_bar);
        let with_control = cotangents.u.is_some();
        let mut potential_bar = PerPoint::new();
        let potential_bar = effects_read.then(|| {
            potential_bar.resize(self.grid, C::null());
            &mut potential_bar[..]
        });
        let (control_bar, potential_bar) = match potential_bar {
            Some(bar) => (
                self.reverse_potential(
                    self.dt,
                    y,
                    next_bar,
                    wave_bar,
                    with_control,
                    Some(&mut *bar),
                ),
                &bar[..],
            ),
            None => (
                self.reverse_potential(self.dt, y, next_bar, wave_bar, with_control, None),
                &[][..],
            ),
        };
        if let Some(x_bar) = &mut cotangents.x {
            add(x_bar, wave_bar);
        }
        if let Some(u_bar) = &mut cotangents.u {
            u_bar[0] += control_bar;
        }
        if effects_read {
            effects.vjp(self, inputs, potential_bar, cotangents);
        }
    }
}

system_without_effects!(QuantumSystem);
