//! Handwritten step and VJP of the cart-pole with friction and wind.

use arrayvec::ArrayVec;
use physgrad::effect::HasModel;
use physgrad::rng::Rng;
use physgrad::tasks::{CartDamping, CartPoleSystem, PoleDamping, SteadyWind};
use physgrad::{Cotangent, Cotangents, Inputs, Real, Scalar, Start, System};

/// Physics of [`CartPoleSystem`] for at most 16 poles. The const generics enable friction and wind.
#[derive(Clone)]
pub struct ByHand<const FRICTION: bool, const WIND: bool> {
    pub system: CartPoleSystem,
    pub pole: PoleDamping,
    pub cart: CartDamping,
    pub wind: SteadyWind,
}

/// One value per pole.
type PerPole<T> = ArrayVec<T, 16>;

impl<const FRICTION: bool, const WIND: bool> System for ByHand<FRICTION, WIND> {
    fn state_dim(&self) -> usize {
        2 + 2 * self.system.poles
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let s = &self.system;
        let mass = s.cart_mass.nominal() + s.pole_mass.nominal();
        let (dt, per_mass) = (T::from(s.dt), T::from(1.0 / mass));
        let (ml, l) = (
            T::from(s.pole_mass.nominal() * s.half_length.nominal()),
            T::from(s.half_length.nominal()),
        );
        let weight = T::from(s.pole_mass.nominal() * s.half_length.nominal() * s.gravity.nominal());
        let inertia = T::from(
            4.0 / 3.0 * s.pole_mass.nominal() * s.half_length.nominal() * s.half_length.nominal(),
        );
        let coupling = T::from((s.pole_mass.nominal() * s.half_length.nominal()).powi(2) / mass);
        let (pole_drag, damping) =
            (T::from(self.wind.pole_drag.nominal()), T::from(self.pole.damping.nominal()));
        let headwind = if WIND { T::from(self.wind.speed.nominal()) - x[1] } else { T::zero() };

        // Drag on one pole pushes the cart, which accelerates every pole. The step therefore sums
        // all forces before it computes accelerations.
        let mut force = u[0];
        if FRICTION {
            force -= x[1] * self.cart.damping.nominal();
        }
        if WIND {
            force += headwind.abs() * self.wind.cart_drag.nominal() * headwind;
        }
        let mut drags = PerPole::new();
        for (pole, next) in x[2..].chunks_exact(2).zip(next[2..].chunks_exact_mut(2)) {
            (next[0], next[1]) = pole[0].sin_cos();
            if WIND {
                let across = headwind * next[1] - l * pole[1];
                let drag = pole_drag * across.abs() * across;
                force += drag * next[1];
                drags.push(drag);
            }
        }
        let mut push = force;
        for (i, (pole, next)) in
            x[2..].chunks_exact(2).zip(next[2..].chunks_exact_mut(2)).enumerate()
        {
            let (sin, cos, omega) = (next[0], next[1], pole[1]);
            let mut torque = weight * sin;
            if FRICTION {
                torque -= damping * omega;
            }
            if WIND {
                torque += drags[i] * l;
            }
            let lever = ml * cos;
            let centrifugal = ml * sin * omega * omega;
            let a = (force + centrifugal) * per_mass;
            let alpha = (torque - lever * a) / (inertia - coupling * cos * cos);
            push += centrifugal - lever * alpha;
            next[1] = omega + dt * alpha;
            next[0] = pole[0] + dt * next[1];
        }
        next[1] = x[1] + dt * push * per_mass;
        next[0] = x[0] + dt * next[1];
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, u, .. }: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        // Scratch for cotangents that are not requested.
        let (mut x_scratch, mut u_scratch) = (ArrayVec::<C, 130>::new(), ArrayVec::<C, 64>::new());
        let x_bar = cotangents.x.unwrap_or_else(|| {
            x_scratch.extend(x.iter().map(|_| C::null()));
            &mut x_scratch[..]
        });
        let u_bar = cotangents.u.unwrap_or_else(|| {
            u_scratch.extend(u.iter().map(|_| C::null()));
            &mut u_scratch[..]
        });
        let s = &self.system;
        let mass = s.cart_mass.nominal() + s.pole_mass.nominal();
        let (dt, per_mass) = (R::from(s.dt), R::from(1.0 / mass));
        let (ml, l) = (
            R::from(s.pole_mass.nominal() * s.half_length.nominal()),
            R::from(s.half_length.nominal()),
        );
        let weight = R::from(s.pole_mass.nominal() * s.half_length.nominal() * s.gravity.nominal());
        let inertia = R::from(
            4.0 / 3.0 * s.pole_mass.nominal() * s.half_length.nominal() * s.half_length.nominal(),
        );
        let coupling = R::from((s.pole_mass.nominal() * s.half_length.nominal()).powi(2) / mass);
        let (pole_drag, damping) =
            (R::from(self.wind.pole_drag.nominal()), R::from(self.pole.damping.nominal()));
        let headwind = if WIND { R::from(self.wind.speed.nominal()) - x[1] } else { R::zero() };

        let mut force = u[0];
        if FRICTION {
            force -= R::from(self.cart.damping.nominal()) * x[1];
        }
        if WIND {
            force += R::from(self.wind.cart_drag.nominal()) * headwind.abs() * headwind;
        }
        let (mut trig, mut air, mut torques_bar) = (PerPole::new(), PerPole::new(), PerPole::new());
        for pole in x[2..].chunks_exact(2) {
            let (sin, cos) = pole[0].sin_cos();
            trig.push((sin, cos));
            if WIND {
                let across = headwind * cos - l * pole[1];
                let strength = pole_drag * across.abs();
                let drag = strength * across;
                force += drag * cos;
                air.push((strength, drag));
            }
        }
        let speed_bar = next_bar[1] + next_bar[0] * dt;
        let push_bar = speed_bar * (dt * per_mass);
        let mut force_bar = push_bar;
        for (i, (pole, &(sin, cos))) in x[2..].chunks_exact(2).zip(&trig).enumerate() {
            let omega = pole[1];
            let mut torque = weight * sin;
            if FRICTION {
                torque -= damping * omega;
            }
            if WIND {
                torque += air[i].1 * l;
            }
            let (lever, spin) = (ml * cos, omega * omega);
            let a = (force + ml * sin * spin) * per_mass;
            let per_inertia = R::one() / (inertia - coupling * cos * cos);
            let alpha = (torque - lever * a) * per_inertia;
            let mut omega_bar = next_bar[3 + 2 * i] + next_bar[2 + 2 * i] * dt;
            let alpha_bar = omega_bar * dt - push_bar * lever;
            let torque_bar = alpha_bar * per_inertia;
            let thrust_bar = -(torque_bar * (lever * per_mass));
            force_bar += thrust_bar;
            let centrifugal_bar = push_bar + thrust_bar;
            let sin_bar = torque_bar * weight + centrifugal_bar * (ml * spin);
            let cos_bar = torque_bar * (R::from(2.0) * coupling * cos * alpha - ml * a)
                - push_bar * (ml * alpha);
            omega_bar += centrifugal_bar * (R::from(2.0) * ml * sin * omega);
            if FRICTION {
                omega_bar -= torque_bar * damping;
            }
            x_bar[2 + 2 * i] += next_bar[2 + 2 * i] + sin_bar * cos - cos_bar * sin;
            x_bar[3 + 2 * i] += omega_bar;
            if WIND {
                torques_bar.push(torque_bar);
            }
        }
        let mut speed_bar = speed_bar;
        if WIND {
            // Separate loop: the cotangent of the force is complete only after the loop over the
            // poles.
            for (i, (&(sin, cos), &(strength, drag))) in trig.iter().zip(&air).enumerate() {
                let across_bar = (force_bar * cos + torques_bar[i] * l) * (strength + strength);
                speed_bar -= across_bar * cos;
                x_bar[2 + 2 * i] -= (force_bar * drag + across_bar * headwind) * sin;
                x_bar[3 + 2 * i] -= across_bar * l;
            }
            speed_bar -=
                force_bar * (R::from(2.0 * self.wind.cart_drag.nominal()) * headwind.abs());
        }
        if FRICTION {
            speed_bar -= force_bar * R::from(self.cart.damping.nominal());
        }
        x_bar[0] += next_bar[0];
        x_bar[1] += speed_bar;
        u_bar[0] += force_bar;
    }
}

impl<const FRICTION: bool, const WIND: bool> HasModel<CartPoleSystem> for ByHand<FRICTION, WIND> {
    #[inline(always)]
    fn model(&self) -> &CartPoleSystem {
        &self.system
    }

    fn start_extra(&self, _rng: &mut Rng, _start: Start<'_>) {}
}
