//! [`Strang`]: Schrödinger's equation by splitting kinetic and potential energy.

use super::QuantumSystem;
use super::elimination::Vector;
use super::propagator::Propagator;
use super::system::{Pair, PerPoint, Wave, place};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs, add};
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// [`QuantumSystem`] with Strang's symmetric splitting:
///
/// ```text
/// a = exp(-i dt/2 V(ψ)) ψ,  b = exp(i dt D₂) a,  ψ' = exp(-i dt/2 V(b)) b
/// ```
///
/// Each part is exact to rounding: phases at the grid points, and the exponential of the second
/// difference, which [`new`](Strang::new) computes once. The step is therefore unitary for any
/// potential, and exact without potential for any dt.
///
/// With a potential that depends on neither time nor state, the order is two, with errors from the
/// commutators of D₂ and V. The potential limits the time step; the kinetic energy does not.
/// Energies that differ by 2π/dt are indistinguishable, so the potential may couple states that are
/// uncoupled in continuous time.
///
/// H and grid are those of [`QuantumSystem`]. A step costs O(grid²), which suits small grids. It
/// multiplies by two complex matrices with half as many rows as grid points. It evaluates one sine
/// and cosine per grid point, or two if an effect is
/// [state-dependent](Effect::state_dependent). The matrices take about 12 grid² bytes, in both
/// precisions together.
///
/// The second half step evaluates the potential at the state after the kinetic step. The first half
/// step does not change |ψ|. With [`Cubic`](super::Cubic), both halves are therefore exact, and the
/// order remains two. The other schemes use the state at the beginning of the step, which gives
/// first order. Both halves use the time at the beginning of the step, so the order is one for
/// potentials that depend on time.
///
/// Sources: Strang 1968 (doi:10.1137/0705041); Feit, Fleck and Steiger 1982
/// (doi:10.1016/0021-9991(82)90091-2).
#[derive(Clone, Debug, PartialEq)]
pub struct Strang {
    system: QuantumSystem,
    kinetic: Propagator,
}

/// Computes `out_j ← psi_j exp(-i dt/2 V_j)`. With `ADJOINT`, the sign in the exponent is opposite.
#[inline(always)]
fn turn<T: Scalar, V: Vector<T>, const ADJOINT: bool>(
    phases: &[Pair<T>],
    psi: &[V],
    out: &mut [V],
) {
    let n = phases.len();
    let (psi, out) = (&psi.as_chunks::<2>().0[..n], &mut out.as_chunks_mut::<2>().0[..n]);
    for j in 0..n {
        let ((cos, sin), [re, im]) = (phases[j], psi[j]);
        out[j] = if ADJOINT {
            [re * cos - im * sin, im * cos + re * sin]
        } else {
            [re * cos + im * sin, im * cos - re * sin]
        };
    }
}

impl Strang {
    /// Creates the scheme. Computes the propagator of a step in O(grid²), in double precision.
    pub fn new(system: QuantumSystem) -> Self {
        Self { kinetic: Propagator::new(&system), system }
    }

    /// Returns the model. Steps use its parameters, including dt, but not its Crank-Nicolson step.
    pub fn system(&self) -> &QuantumSystem {
        &self.system
    }

    /// Returns cosine and sine of `dt/2 V` at the state of `inputs`.
    #[inline(always)]
    fn phases<'a, E: Effect<QuantumSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        phases: &'a mut PerPoint<Pair<T>>,
    ) -> &'a [Pair<T>] {
        let half_dt = T::from(0.5 * self.system.dt);
        let mut potential = PerPoint::new();
        let potential = self.system.potential(effects, inputs, &mut potential);
        phases.clear();
        phases.extend(potential.iter().map(|&v| {
            let (sin, cos) = (v * half_dt).sin_cos();
            (cos, sin)
        }));
        phases
    }

    /// Returns the cotangent of the control from one half step if `with_control`, else 0. Writes
    /// the cotangent of the potential to `potential_bar`, if given. `psi` and its cotangent are
    /// both before or both after the half step, which rotates both by the same phase.
    ///
    /// ```text
    /// dψ_j/dV_j = -i dt/2 ψ_j,  V_bar_j = dt/2 Im(conj(psi_bar_j) ψ_j)
    /// ```
    #[inline(always)]
    fn reverse_half<R: Real, C: Cotangent<R>>(
        &self,
        psi: &[R],
        psi_bar: &[C],
        with_control: bool,
        mut potential_bar: Option<&mut [C]>,
    ) -> C {
        let model = &self.system;
        let (half_dt, dx, origin, n) =
            (R::from(0.5 * model.dt), model.spacing(), model.control_origin(), model.grid);
        let (psi, psi_bar) = (&psi.as_chunks::<2>().0[..n], &psi_bar.as_chunks::<2>().0[..n]);
        let mut control_bar = C::null();
        for j in 0..n {
            let bar = (psi_bar[j][0] * psi[j][1] - psi_bar[j][1] * psi[j][0]) * half_dt;
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

impl ForcedSystem for Strang {
    type Model = QuantumSystem;

    fn model(&self) -> &QuantumSystem {
        &self.system
    }

    fn state_dim(&self) -> usize {
        2 * self.system.grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn force_dim(&self) -> usize {
        self.system.grid
    }

    fn dt(&self) -> f64 {
        self.system.dt
    }

    #[inline(always)]
    fn forced_step<E: Effect<QuantumSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let inputs = inputs.continuous(self.system.dt);
        let (mut phases, mut state) = (PerPoint::new(), Wave::from_slice(inputs.x));
        let turning = self.phases(effects, inputs, &mut phases);
        let state = &mut state[..];
        turn::<T, T, false>(turning, inputs.x, state);
        self.kinetic.apply::<T, T, false>(state, next);
        state.copy_from_slice(next);
        let turning = if effects.state_dependent() {
            self.phases(effects, inputs.with_x(state), &mut phases)
        } else {
            &phases[..]
        };
        turn::<T, T, false>(turning, state, next);
    }

    #[inline(always)]
    fn forced_vjp<E: Effect<QuantumSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let (model, reads) = (&self.system, effects.state_dependent());
        let (x, inputs) = (inputs.x, inputs.continuous(model.dt));
        let mut phases = PerPoint::new();
        let before = self.phases(effects, inputs, &mut phases);
        let (mut a_bar, mut wave_bar) = (PerPoint::new(), PerPoint::new());
        a_bar.resize(model.grid, [C::null(); 2]);
        wave_bar.resize(model.grid, [C::null(); 2]);
        let (a_bar, wave_bar) = (a_bar.as_flattened_mut(), wave_bar.as_flattened_mut());
        // Shorter path if neither the control nor the effects need the cotangent of the potential.
        if cotangents.u.is_none() && !reads {
            if let Some(x_bar) = cotangents.x {
                turn::<R, C, true>(before, next_bar, wave_bar);
                self.kinetic.apply::<R, C, true>(wave_bar, a_bar);
                turn::<R, C, true>(before, a_bar, wave_bar);
                add(x_bar, wave_bar);
            }
            return;
        }
        // Recomputes the intermediate waves a and b, because the forward pass does not store them.
        let (mut a, mut b) = (PerPoint::new(), PerPoint::new());
        a.resize(model.grid, [R::zero(); 2]);
        b.resize(model.grid, [R::zero(); 2]);
        let (a, b) = (a.as_flattened_mut(), b.as_flattened_mut());
        turn::<R, R, false>(before, x, a);
        self.kinetic.apply::<R, R, false>(a, b);
        let with_control = cotangents.u.is_some();
        let mut control_bar;
        let mut potential_bar = PerPoint::new();
        if reads {
            let mut phases = PerPoint::new();
            potential_bar.resize(model.grid, C::null());
            let potential_bar = &mut potential_bar[..];
            let after = self.phases(effects, inputs.with_x(b), &mut phases);
            turn::<R, C, true>(after, next_bar, wave_bar);
            control_bar = self.reverse_half(b, wave_bar, with_control, Some(&mut *potential_bar));
            let mut half_bars = cotangents.reborrow();
            half_bars.x = Some(&mut *wave_bar);
            effects.vjp(model, inputs.with_x(b), potential_bar, half_bars);
            self.kinetic.apply::<R, C, true>(wave_bar, a_bar);
            control_bar += self.reverse_half(a, a_bar, with_control, Some(&mut *potential_bar));
        } else {
            turn::<R, C, true>(before, next_bar, wave_bar);
            control_bar = self.reverse_half(b, wave_bar, with_control, None);
            self.kinetic.apply::<R, C, true>(wave_bar, a_bar);
            control_bar += self.reverse_half(a, a_bar, with_control, None);
        }
        if let Some(x_bar) = &mut cotangents.x {
            turn::<R, C, true>(before, a_bar, wave_bar);
            add(x_bar, wave_bar);
        }
        if let Some(u_bar) = &mut cotangents.u {
            u_bar[0] += control_bar;
        }
        if reads {
            effects.vjp(model, inputs, &potential_bar, cotangents);
        }
    }
}

system_without_effects!(Strang);
