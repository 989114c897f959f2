//! Poles on a cart that act on each other through it: the exact model.

use super::system::{CartPoleSystem, Forces, PerPole};
use crate::effect::{Effect, Host, system_without_effects};
use crate::scalar::{Cotangent, Real, Scalar};

/// The physics of rigid, uniform poles on joints side by side on one cart: semi-implicit Euler, velocities first.
///
/// State, control, parameters and forces are those of [`CartPoleSystem`], but M is the mass of the cart and of all the
/// poles. Lagrange's equations, with J = 4/3 m l² the inertia of a pole about its joint:
///
/// ```text
/// M ẍ + m l Σ_i (α_i cos θ_i - ω_i² sin θ_i) = F
/// J α_i + m l ẍ cos θ_i                      = τ_i,    τ_i = m g l sin θ_i alone
/// ```
///
/// The mass matrix is an arrow, and is solved in O(poles): the α_i are eliminated, which leaves one equation for ẍ. Its
/// factor, M - Σ (m l cos θ_i)² / J, is at least the cart's mass plus a quarter of the poles'. With one pole these are
/// the equations of [`CartPoleSystem`] written differently.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CoupledCartPole(pub CartPoleSystem);

/// Its constants as numbers of one kind.
struct Constants<T> {
    dt: T,
    /// m l.
    moment: T,
    /// m g l.
    weight: T,
    /// M.
    mass: T,
    /// 1 / J.
    per_inertia: T,
}

impl CoupledCartPole {
    #[inline(always)]
    fn constants<T: Scalar>(&self) -> Constants<T> {
        let body = &self.0;
        let moment = body.moment();
        Constants {
            dt: T::lift(body.dt),
            moment: T::lift(moment),
            weight: T::lift(moment * body.gravity),
            mass: T::lift(body.cart_mass + body.poles as f64 * body.pole_mass),
            per_inertia: T::lift(1.0 / (4.0 / 3.0 * moment * body.half_length)),
        }
    }
}

impl Host for CoupledCartPole {
    type Body = CartPoleSystem;

    fn body(&self) -> &CartPoleSystem {
        &self.0
    }

    fn state_dim(&self) -> usize {
        Host::state_dim(&self.0)
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn dt(&self) -> f64 {
        self.0.dt
    }

    #[inline(always)]
    fn step_with<E: Effect<CartPoleSystem>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], next: &mut [T]) {
        let k = self.constants::<T>();
        let mut forces = Forces::new();
        self.0.own_forces(x, u, &mut next[2..], &mut forces);
        effects.act_knowing(&self.0, x, &next[2..], &mut forces);
        let (mut push, mut mass) = (forces[0], k.mass);
        for ((pole, next), &torque) in self.0.poles_of(x).zip(next[2..].chunks_exact_mut(2)).zip(&forces[1..]) {
            let (sin, lever) = (next[0], k.moment * next[1]);
            let lever_per_inertia = lever * k.per_inertia;
            push += k.moment * sin * pole[1] * pole[1] - lever_per_inertia * torque;
            mass -= lever_per_inertia * lever;
        }
        let a = push / mass;
        for ((pole, next), &torque) in self.0.poles_of(x).zip(next[2..].chunks_exact_mut(2)).zip(&forces[1..]) {
            let alpha = (torque - k.moment * next[1] * a) * k.per_inertia;
            next[1] = pole[1] + k.dt * alpha;
            next[0] = pole[0] + k.dt * next[1];
        }
        next[1] = x[1] + k.dt * a;
        next[0] = x[0] + k.dt * next[1];
    }

    #[inline(always)]
    fn reverse<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        next_bar: &[C],
        mut x_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        let k = self.constants::<R>();
        let (mut trig, mut forces, mut forces_bar) = (PerPole::new(), Forces::new(), Forces::new());
        self.0.own_forces_again(x, u, &mut trig, &mut forces);
        effects.act_knowing(&self.0, x, trig.as_flattened(), &mut forces);
        let (mut push, mut mass) = (forces[0], k.mass);
        let speed_bar = next_bar[1] + next_bar[0] * k.dt;
        // From ẋ' and from every α_i = (τ_i - m l cos θ_i ẍ) / J.
        let mut a_bar = speed_bar * k.dt;
        let poles = self.0.poles_of(x).zip(&trig).zip(next_bar[2..].chunks_exact(2)).zip(&forces[1..]);
        for (((pole, &[sin, cos]), next_bar), &torque) in poles.clone() {
            let lever = k.moment * cos;
            let lever_per_inertia = lever * k.per_inertia;
            push += k.moment * sin * pole[1] * pole[1] - lever_per_inertia * torque;
            mass -= lever_per_inertia * lever;
            a_bar -= (next_bar[1] + next_bar[0] * k.dt) * (k.dt * lever_per_inertia);
        }
        let per_mass = R::one() / mass;
        let a = push * per_mass;
        let push_bar = a_bar * per_mass;
        forces_bar.push(push_bar);
        if let Some(x_bar) = &mut x_bar {
            (x_bar[0], x_bar[1]) = (next_bar[0], speed_bar);
        }
        for (i, (((pole, &[sin, cos]), next_bar), &torque)) in poles.enumerate() {
            let omega = pole[1];
            let lever = k.moment * cos;
            let omega_bar = next_bar[1] + next_bar[0] * k.dt;
            let alpha_bar = omega_bar * (k.dt * k.per_inertia);
            let torque_bar = alpha_bar - push_bar * (lever * k.per_inertia);
            forces_bar.push(torque_bar);
            if let Some(x_bar) = &mut x_bar {
                let sin_bar = torque_bar * k.weight + push_bar * (k.moment * omega * omega);
                // In α, in the push, and twice in the mass, whose cotangent is -ẍ times that of the push.
                let in_push = (R::lift(2.0) * lever * a - torque) * k.per_inertia;
                let cos_bar = (push_bar * in_push - alpha_bar * a) * k.moment;
                x_bar[2 + 2 * i] = next_bar[0] + sin_bar * cos - cos_bar * sin;
                x_bar[3 + 2 * i] = omega_bar + push_bar * (R::lift(2.0) * k.moment * sin * omega);
            }
        }
        if let Some(u_bar) = u_bar {
            u_bar[0] = forces_bar[0];
        }
        if let Some(x_bar) = x_bar {
            effects.vjp_knowing(&self.0, x, trig.as_flattened(), &forces_bar, x_bar);
        }
    }
}

system_without_effects!(CoupledCartPole);
