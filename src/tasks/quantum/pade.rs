//! [`Pade`]: Schrödinger's equation to fourth order in the time step.

use super::QuantumSystem;
use super::elimination::{Elimination, Pivots, Rows};
use super::system::{Pair, PerPoint};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs, add};
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// [`QuantumSystem`] with the diagonal Padé approximant of fourth order. With `z = dt H`:
///
/// ```text
/// exp(-iz) ≈ (1 - i z/2 - z²/12) (1 + i z/2 - z²/12)⁻¹ = C(z - √3) C(z + √3)
/// C(y) = (1 - i y/3) (1 + i y/3)⁻¹
/// A∓ = I + i dt/3 (H ∓ √3/dt)
/// χ = 2 A₋⁻¹ ψ - ψ,  ψ' = 2 A₊⁻¹ χ - χ
/// ```
///
/// The zeros of the denominator are `z = 3i ± √3`. Their real parts shift the energy. The constant
/// factor 4/3 of numerator and denominator cancels. A step thus consists of two Crank-Nicolson
/// steps of 2/3 dt each, with the potentials `V ∓ √3/dt`. The cost is two tridiagonal solves,
/// O(grid). As in [`QuantumSystem`], both steps are unitary for any potential. Elimination needs no
/// pivoting, because the real part of each pivot is at least 1.
///
/// H and grid are those of [`QuantumSystem`], so only the error in time differs. In each step, the
/// phase of an eigenstate of energy E advances by `E dt (1 - (E dt)⁴/720 + …)`. With
/// Crank-Nicolson, it advances by `E dt (1 - (E dt)²/12 + …)`. For energies beyond 3/dt, the phase
/// advances too slowly by more than 6 %. The advance is at most one turn per step.
///
/// The order in dt is four for potentials that are constant during a step. Effects use the state
/// and the time at the beginning of the step, as in [`QuantumSystem`]. With effects that depend on
/// either, such as [`Cubic`](super::Cubic), the order is one.
///
/// Sources: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.3; for this equation,
/// van Dijk and Toyama 2007 (doi:10.1103/PhysRevE.75.036707).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pade(
    /// Model with its parameters, including dt. Steps do not use the Crank-Nicolson step of the
    /// model.
    pub QuantumSystem,
);

impl Pade {
    /// Returns the time step of each of the two Crank-Nicolson steps, `2/3 dt`.
    #[inline(always)]
    fn factor_dt(&self) -> f64 {
        self.0.dt * (2.0 / 3.0)
    }

    /// Returns the eliminations of A₋ and A₊.
    #[inline(always)]
    fn eliminate<'a, E: Effect<QuantumSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        minus: &'a mut PerPoint<Pair<T>>,
        plus: &'a mut PerPoint<Pair<T>>,
    ) -> (Elimination<'a, T>, Elimination<'a, T>) {
        let (dt, dx, shift) = (self.factor_dt(), self.0.spacing(), f64::sqrt(3.0) / self.0.dt);
        let mut minus = Rows::new(Pivots::new(dt, dx, -shift), self.0.grid, minus);
        let mut plus = Rows::new(Pivots::new(dt, dx, shift), self.0.grid, plus);
        let mut potential = PerPoint::new();
        // Two interleaved chains of divisions take little longer than one chain.
        for &v in self.0.potential(effects, inputs, &mut potential) {
            minus.push(v);
            plus.push(v);
        }
        (minus.elimination(), plus.elimination())
    }
}

/// Computes `y ← 2 y - x`.
#[inline(always)]
fn reflect<V: Copy + std::ops::Add<Output = V> + std::ops::Sub<Output = V>>(x: &[V], y: &mut [V]) {
    let n = y.len();
    let x = &x[..n];
    for i in 0..n {
        y[i] = y[i] + y[i] - x[i];
    }
}

impl ForcedSystem for Pade {
    type Model = QuantumSystem;

    fn model(&self) -> &QuantumSystem {
        &self.0
    }

    fn state_dim(&self) -> usize {
        2 * self.0.grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn force_dim(&self) -> usize {
        self.0.grid
    }

    fn dt(&self) -> f64 {
        self.0.dt
    }

    #[inline(always)]
    fn forced_step<E: Effect<QuantumSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let x = inputs.x;
        let (mut minus, mut plus, mut chi) = (PerPoint::new(), PerPoint::new(), PerPoint::new());
        let (minus, plus) =
            self.eliminate(effects, inputs.continuous(self.0.dt), &mut minus, &mut plus);
        chi.resize(self.0.grid, [T::zero(); 2]);
        let chi = chi.as_flattened_mut();
        minus.solve(x, chi);
        reflect(x, chi);
        plus.solve(chi, next);
        reflect(chi, next);
    }

    #[inline(always)]
    fn forced_vjp<E: Effect<QuantumSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let (model, dt) = (&self.0, self.factor_dt());
        let (x, inputs) = (inputs.x, inputs.continuous(model.dt));
        let (mut minus, mut plus) = (PerPoint::new(), PerPoint::new());
        let (mut minus, mut plus) = self.eliminate(effects, inputs, &mut minus, &mut plus);
        let (mut chi_bar, mut wave_bar) = (PerPoint::new(), PerPoint::new());
        chi_bar.resize(model.grid, [C::null(); 2]);
        wave_bar.resize(model.grid, [C::null(); 2]);
        let (chi_bar, wave_bar) = (chi_bar.as_flattened_mut(), wave_bar.as_flattened_mut());
        let effects_read = effects.state_dependent();
        // Shorter path if neither the control nor the effects need the cotangent of the potential.
        if cotangents.u.is_none() && !effects_read {
            if let Some(x_bar) = cotangents.x {
                plus.conjugate();
                plus.solve(next_bar, chi_bar);
                reflect(next_bar, chi_bar);
                minus.conjugate();
                minus.solve(chi_bar, wave_bar);
                reflect(chi_bar, wave_bar);
                add(x_bar, wave_bar);
            }
            return;
        }
        // Recomputes the solutions, because the forward pass does not store them.
        let (mut y_minus, mut chi, mut y_plus) =
            (PerPoint::new(), PerPoint::new(), PerPoint::new());
        y_minus.resize(model.grid, [R::zero(); 2]);
        let y_minus = &mut y_minus[..];
        minus.solve(x, y_minus.as_flattened_mut());
        chi.resize(model.grid, [R::zero(); 2]);
        let chi = &mut chi[..];
        for j in 0..model.grid {
            let y = y_minus[j];
            chi[j] = [y[0] + y[0] - x[2 * j], y[1] + y[1] - x[2 * j + 1]];
        }
        y_plus.resize(model.grid, [R::zero(); 2]);
        let y_plus = &mut y_plus[..];
        plus.solve(chi.as_flattened(), y_plus.as_flattened_mut());
        minus.conjugate();
        plus.conjugate();
        let with_control = cotangents.u.is_some();
        plus.solve(next_bar, chi_bar);
        let (mut first, mut second) = (PerPoint::new(), PerPoint::new());
        let control_bar = if effects_read {
            first.resize(model.grid, C::null());
            second.resize(model.grid, C::null());
            let plus_bar = model.reverse_potential(
                dt,
                y_plus,
                next_bar,
                chi_bar,
                with_control,
                Some(&mut *first),
            );
            minus.solve(chi_bar, wave_bar);
            let minus_bar = model.reverse_potential(
                dt,
                y_minus,
                chi_bar,
                wave_bar,
                with_control,
                Some(&mut *second),
            );
            add(&mut first, &second);
            plus_bar + minus_bar
        } else {
            let plus_bar =
                model.reverse_potential(dt, y_plus, next_bar, chi_bar, with_control, None);
            minus.solve(chi_bar, wave_bar);
            plus_bar + model.reverse_potential(dt, y_minus, chi_bar, wave_bar, with_control, None)
        };
        if let Some(x_bar) = &mut cotangents.x {
            add(x_bar, wave_bar);
        }
        if let Some(u_bar) = &mut cotangents.u {
            u_bar[0] += control_bar;
        }
        if effects_read {
            effects.vjp(model, inputs, &first, cotangents);
        }
    }
}

system_without_effects!(Pade);
