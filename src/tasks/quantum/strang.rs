//! Schrödinger's equation, kinetic and potential energy taking turns.

use super::QuantumSystem;
use super::elimination::Vector;
use super::propagator::Propagator;
use super::system::{Pair, PerPoint, STACK, place};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::numbers::kernels::scratch::Scratch;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// A [`QuantumSystem`] that steps by the symmetric splitting of Strang:
///
/// ```text
/// a = exp(-i dt/2 V(ψ)) ψ,  b = exp(i dt D₂) a,  ψ' = exp(-i dt/2 V(b)) b
/// ```
///
/// Each part is exact to rounding: phases at the grid points, and the exponential of the second difference, worked out
/// once by [`new`](Strang::new). So the step is unitary whatever the potential, and without potential it is exact, whatever
/// dt. With one, it is of the second order, with errors from the commutators of D₂ and V. A step must be short for the
/// potential, not for the kinetic energy; but where energies differ by 2π/dt, they are the same to it, and a potential may
/// couple what in continuous time it would not.
///
/// H is that of [`QuantumSystem`], on the same grid. A step is a product with two complex matrices of half the grid's size,
/// and a sine and cosine for each grid point, two where the potential depends on the state: O(grid²), for small grids. The
/// matrices take 12 grid² bytes, in both precisions.
///
/// The potential of the second half is at the state after the motion, and |ψ| is not changed by the first half: with
/// [`Cubic`](super::Cubic), both halves are exact and the step is of the second order too. (The other schemes take the
/// state in which the step begins, and are of the first.) Time, for effects with a clock, is when the step begins in both.
///
/// Strang 1968 (doi:10.1137/0705041); Feit, Fleck and Steiger 1982 (doi:10.1016/0021-9991(82)90091-2).
#[derive(Clone, Debug, PartialEq)]
pub struct Strang {
    system: QuantumSystem,
    kinetic: Propagator,
}

/// `out_j ← psi_j exp(∓i dt/2 V_j)`, the sign of the `ADJOINT` being the upper one's opposite.
#[inline(always)]
fn turn<T: Scalar, V: Vector<T>, const ADJOINT: bool>(phases: &[Pair<T>], psi: &[V], out: &mut [V]) {
    let n = phases.len();
    let (psi, out) = (&psi.as_chunks::<2>().0[..n], &mut out.as_chunks_mut::<2>().0[..n]);
    for j in 0..n {
        let ((cos, sin), [re, im]) = (phases[j], psi[j]);
        out[j] = if ADJOINT { [re * cos - im * sin, im * cos + re * sin] } else { [re * cos + im * sin, im * cos - re * sin] };
    }
}

/// A wave, and what effects have appended to the state.
type State<T> = Scratch<T, { 2 * STACK + 1 }>;

impl Strang {
    /// Works out the motion in a step: O(grid²), in double precision.
    pub fn new(system: QuantumSystem) -> Self {
        Self { kinetic: Propagator::new(&system), system }
    }

    /// The physics. Its own step is not used.
    pub fn system(&self) -> &QuantumSystem {
        &self.system
    }

    /// `exp(-i dt/2 V)` at the state `x`, as cosine and sine.
    #[inline(always)]
    fn phases<'a, E: Effect<QuantumSystem>, T: Scalar>(
        &self,
        effects: &E,
        x: &[T],
        u: &[T],
        phases: &'a mut PerPoint<Pair<T>>,
    ) -> &'a [Pair<T>] {
        let half_dt = T::lift(0.5 * self.system.dt);
        let mut potential = PerPoint::new();
        let potential = self.system.potential(effects, x, u, &mut potential);
        phases.collect(potential.iter().map(|&v| {
            let (sin, cos) = (v * half_dt).sin_cos();
            (cos, sin)
        }))
    }

    /// The control's cotangent from one half step, if it is with_control for; writes the potential's to `potential_bar`, if there is
    /// one. Both `psi` and its cotangent are of before the half step, or of after it: both turn alike.
    ///
    /// ```text
    /// dψ_j/dV_j = -i dt/2 ψ_j,  V_bar_j = dt/2 Im(ψ̄_bar_j ψ_j)
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
        let (half_dt, dx, origin, n) = (R::lift(0.5 * model.dt), model.spacing(), model.control_origin(), model.grid);
        let (psi, psi_bar) = (&psi.as_chunks::<2>().0[..n], &psi_bar.as_chunks::<2>().0[..n]);
        let mut control_bar = C::null();
        for j in 0..n {
            let bar = (psi_bar[j][0] * psi[j][1] - psi_bar[j][1] * psi[j][0]) * half_dt;
            if with_control {
                control_bar += bar * R::lift((place(j) - origin) * dx);
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
    fn forced_step<E: Effect<QuantumSystem>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], next: &mut [T]) {
        let n = 2 * self.system.grid;
        let (mut phases, mut state) = (PerPoint::new(), State::new());
        let turning = self.phases(effects, x, u, &mut phases);
        // With what effects have appended: they look at all of it.
        let state = state.collect(x.iter().copied());
        turn::<T, T, false>(turning, x, state);
        self.kinetic.apply::<T, T, false>(state, next);
        state[..n].copy_from_slice(next);
        let turning = if effects.state_dependent() { self.phases(effects, state, u, &mut phases) } else { phases.all() };
        turn::<T, T, false>(turning, state, next);
    }

    #[inline(always)]
    fn reverse<E: Effect<QuantumSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        next_bar: &[C],
        x_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        let (model, reads) = (&self.system, effects.state_dependent());
        let mut phases = PerPoint::new();
        let before = self.phases(effects, x, u, &mut phases);
        let mut a_bar = PerPoint::new();
        let a_bar = a_bar.fill([C::null(); 2], model.grid).as_flattened_mut();
        // What only the state's cotangent needs ends here.
        if u_bar.is_none() && !reads {
            if let Some(x_bar) = x_bar {
                turn::<R, C, true>(before, next_bar, x_bar);
                self.kinetic.apply::<R, C, true>(x_bar, a_bar);
                turn::<R, C, true>(before, a_bar, x_bar);
            }
            return;
        }
        // Worked out again rather than kept by the forward pass.
        let (mut a, mut b) = (PerPoint::new(), State::new());
        let a = a.fill([R::zero(); 2], model.grid).as_flattened_mut();
        turn::<R, R, false>(before, x, a);
        let b = b.collect(x.iter().copied());
        self.kinetic.apply::<R, R, false>(a, b);
        let mut scratch = State::new();
        let x_bar = match x_bar {
            Some(x_bar) => x_bar,
            None => scratch.fill(C::null(), x.len()),
        };
        let with_control = u_bar.is_some();
        let mut control_bar;
        if reads {
            let (mut potential_bar, mut phases) = (PerPoint::new(), PerPoint::new());
            let potential_bar = potential_bar.fill(C::null(), model.grid);
            let after = self.phases(effects, b, u, &mut phases);
            turn::<R, C, true>(after, next_bar, x_bar);
            control_bar = self.reverse_half(b, x_bar, with_control, Some(&mut *potential_bar));
            effects.vjp(model, b, potential_bar, x_bar);
            self.kinetic.apply::<R, C, true>(x_bar, a_bar);
            control_bar += self.reverse_half(a, a_bar, with_control, Some(&mut *potential_bar));
            turn::<R, C, true>(before, a_bar, x_bar);
            effects.vjp(model, x, potential_bar, x_bar);
        } else {
            turn::<R, C, true>(before, next_bar, x_bar);
            control_bar = self.reverse_half(b, x_bar, with_control, None);
            self.kinetic.apply::<R, C, true>(x_bar, a_bar);
            control_bar += self.reverse_half(a, a_bar, with_control, None);
            turn::<R, C, true>(before, a_bar, x_bar);
        }
        if let Some(u_bar) = u_bar {
            u_bar[0] = control_bar;
        }
    }
}

system_without_effects!(Strang);
