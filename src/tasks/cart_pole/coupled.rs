//! [`CoupledCartPole`]: the exact model, in which poles act on each other through the cart.

use super::motion::{moved, moved_bar, rate_of, rate_of_bar, velocity_of};
use super::system::{CartPoleSystem, Forces, PerPole};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::number::Numbers;
use crate::dynamics::ode::ForcedOde;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;

/// Cart with rigid, uniform poles on joints side by side: semi-implicit Euler, velocities first.
///
/// State, control, parameters and forces are those of [`CartPoleSystem`], but M is the mass of the
/// cart and all poles. With the inertia of a pole about its joint, J = 4/3 m l², Lagrange's
/// equations are:
///
/// ```text
/// M ẍ + m l Σ_i (α_i cos θ_i - ω_i² sin θ_i) = F
/// J α_i + m l ẍ cos θ_i                      = τ_i,    τ_i = m g l sin θ_i without effects
/// ```
///
/// The mass matrix is an arrowhead matrix, solved in O(poles): eliminating the α_i leaves one
/// equation for ẍ. The factor of ẍ, M - Σ (m l cos θ_i)² / J, is at least the cart's mass plus a
/// quarter of the poles'. With one pole, the equations are equivalent to those of
/// [`CartPoleSystem`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CoupledCartPole(pub CartPoleSystem);

/// Constants of the model in one scalar type.
struct Constants<T> {
    dt: T,
    /// m l, kg m.
    moment: T,
    /// m g l, N m.
    weight: T,
    /// M, kg.
    mass: T,
    /// 1 / J, 1/(kg m²).
    per_inertia: T,
}

impl CoupledCartPole {
    /// Returns kinetic plus potential energy of a state, in joules. The energy is 0 at rest with
    /// all poles horizontal. Without control and effects, the equations conserve the energy.
    /// Numbers that vary have their nominal values.
    ///
    /// ```text
    /// M ẋ²/2 + Σ_i (J ω_i²/2 + m l ẋ ω_i cos θ_i + m g l cos θ_i)
    /// ```
    pub fn energy(&self, x: &[f64]) -> f64 {
        let [moment, weight, mass, per_inertia] = self.derived(self.0.nominal());
        let of_pole = |pole: &[f64]| {
            0.5 * pole[1] * pole[1] / per_inertia
                + (moment * x[1] * pole[1] + weight) * pole[0].cos()
        };
        0.5 * mass * x[1] * x[1] + self.0.poles_of(x).map(of_pole).sum::<f64>()
    }

    /// Constants of the equations, computed in f64 if all numbers are fixed, otherwise in `T`.
    #[inline(always)]
    fn constants<T: Scalar>(&self, p: &[T]) -> Constants<T> {
        let numbers = self.0.numbers();
        let [moment, weight, mass, per_inertia] = if numbers.varied() == 0 {
            self.derived(numbers.of::<f64, 4>(&[])).map(T::from)
        } else {
            self.derived(numbers.last_of(p))
        };
        Constants { dt: T::from(self.0.dt), moment, weight, mass, per_inertia }
    }

    #[inline(always)]
    fn derived<T: Scalar>(&self, [cart_mass, pole_mass, half_length, gravity]: [T; 4]) -> [T; 4] {
        let moment = pole_mass * half_length;
        let mass = cart_mass + pole_mass * self.0.poles as f64;
        [moment, moment * gravity, mass, T::one() / (moment * (4.0 / 3.0) * half_length)]
    }
}

impl ForcedSystem for CoupledCartPole {
    type Model = CartPoleSystem;

    fn model(&self) -> &CartPoleSystem {
        &self.0
    }

    fn state_dim(&self) -> usize {
        ForcedSystem::state_dim(&self.0)
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn force_dim(&self) -> usize {
        1 + self.0.poles
    }

    fn dt(&self) -> f64 {
        self.0.dt
    }

    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        self.0.numbers()
    }

    #[inline(always)]
    fn forced_step<E: Effect<CartPoleSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let (k, x) = (self.constants(inputs.p), inputs.x);
        let a =
            self.accelerate(&k, effects, inputs.continuous(self.0.dt), &mut next[2..], moved(k.dt));
        next[1] = x[1] + k.dt * a;
        next[0] = x[0] + k.dt * next[1];
    }

    #[inline(always)]
    fn forced_vjp<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let k = self.constants(inputs.p);
        let speed_bar = next_bar[1] + next_bar[0] * k.dt;
        if let Some(x_bar) = &mut cotangents.x {
            x_bar[0] += next_bar[0];
            x_bar[1] += speed_bar;
        }
        let inputs = inputs.continuous(self.0.dt);
        self.accelerate_reverse(
            effects,
            inputs,
            speed_bar * k.dt,
            moved_bar(next_bar, k.dt),
            cotangents,
        );
    }
}

impl CoupledCartPole {
    /// Writes `of_pole(pole, α_i)` for each pole to `poles`, and returns ẍ.
    #[inline(always)]
    fn accelerate<E: Effect<CartPoleSystem>, T: Scalar>(
        &self,
        k: &Constants<T>,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        poles: &mut [T],
        of_pole: impl Fn(&[T], T) -> [T; 2],
    ) -> T {
        let (x, mut trig, mut forces) = (inputs.x, PerPole::new(), Forces::new());
        self.0.forces(effects, k.weight, inputs, &mut trig, &mut forces);
        let (mut push, mut mass) = (forces[0], k.mass);
        for ((pole, &[sin, cos]), &torque) in zip(zip(self.0.poles_of(x), &trig), &forces[1..]) {
            let lever = k.moment * cos;
            let lever_per_inertia = lever * k.per_inertia;
            push += k.moment * sin * pole[1] * pole[1] - lever_per_inertia * torque;
            mass -= lever_per_inertia * lever;
        }
        let a = push / mass;
        let moments = zip(&trig, &forces[1..]);
        for ((pole, out), (&[_, cos], &torque)) in
            zip(zip(self.0.poles_of(x), poles.chunks_exact_mut(2)), moments)
        {
            [out[0], out[1]] = of_pole(pole, (torque - k.moment * cos * a) * k.per_inertia);
        }
        a
    }

    /// Reverse of [`accelerate`](Self::accelerate). Adds to the requested cotangents of poles and
    /// control. Effects add to all requested cotangents.
    ///
    /// `pole_bar(i)` returns the cotangents of angle and rate of pole `i` that do not pass through
    /// α_i, and the cotangent of α_i.
    #[inline(always)]
    fn accelerate_reverse<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, R>,
        mut a_bar: C,
        pole_bar: impl Fn(usize) -> ([C; 2], C),
        mut cotangents: Cotangents<'_, C>,
    ) {
        let (k, x) = (self.constants(inputs.p), inputs.x);
        let (mut trig, mut forces, mut forces_bar) = (PerPole::new(), Forces::new(), Forces::new());
        self.0.forces(effects, k.weight, inputs, &mut trig, &mut forces);
        let (mut push, mut mass) = (forces[0], k.mass);
        // Adds to the cotangent of ẍ the terms that pass through α_i, with
        // α_i = (τ_i - m l cos θ_i ẍ) / J.
        let poles = zip(zip(self.0.poles_of(x), &trig), &forces[1..]);
        for (i, ((pole, &[sin, cos]), &torque)) in poles.clone().enumerate() {
            let lever = k.moment * cos;
            let lever_per_inertia = lever * k.per_inertia;
            push += k.moment * sin * pole[1] * pole[1] - lever_per_inertia * torque;
            mass -= lever_per_inertia * lever;
            a_bar -= pole_bar(i).1 * lever_per_inertia;
        }
        let per_mass = R::one() / mass;
        let a = push * per_mass;
        let push_bar = a_bar * per_mass;
        forces_bar.push(push_bar);
        for (i, ((pole, &[sin, cos]), &torque)) in poles.enumerate() {
            let omega = pole[1];
            let lever = k.moment * cos;
            let ([theta_bar, omega_bar], alpha_bar) = pole_bar(i);
            let alpha_bar = alpha_bar * k.per_inertia;
            let torque_bar = alpha_bar - push_bar * (lever * k.per_inertia);
            forces_bar.push(torque_bar);
            if let Some(x_bar) = &mut cotangents.x {
                let sin_bar = torque_bar * k.weight + push_bar * (k.moment * omega * omega);
                // The cosine enters α_i and `push` linearly, and `mass`, the factor of ẍ,
                // quadratically. The cotangent of `mass` is -ẍ times that of `push`.
                let in_push = (R::from(2.0) * lever * a - torque) * k.per_inertia;
                let cos_bar = (push_bar * in_push - alpha_bar * a) * k.moment;
                x_bar[2 + 2 * i] += theta_bar;
                x_bar[2 + 2 * i] += sin_bar * cos;
                x_bar[2 + 2 * i] -= cos_bar * sin;
                x_bar[3 + 2 * i] += omega_bar;
                x_bar[3 + 2 * i] += push_bar * (R::from(2.0) * k.moment * sin * omega);
            }
        }
        if let Some(u_bar) = &mut cotangents.u {
            u_bar[0] += push_bar;
        }
        effects.vjp(&self.0, inputs, &forces_bar, cotangents);
    }
}

impl ForcedOde for CoupledCartPole {
    #[inline(always)]
    fn forced_rate<E: Effect<CartPoleSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        rate: &mut [T],
    ) {
        rate[1] =
            self.accelerate(&self.constants(inputs.p), effects, inputs, &mut rate[2..], rate_of);
        rate[0] = inputs.x[1];
    }

    #[inline(always)]
    fn forced_rate_vjp<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        if let Some(x_bar) = &mut cotangents.x {
            for i in (0..rate_bar.len()).step_by(2) {
                x_bar[i + 1] += rate_bar[i];
            }
        }
        self.accelerate_reverse(effects, inputs, rate_bar[1], rate_of_bar(rate_bar), cotangents);
    }

    fn velocity_of(&self, i: usize) -> Option<usize> {
        velocity_of(i)
    }
}

system_without_effects!(CoupledCartPole);
