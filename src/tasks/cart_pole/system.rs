//! [`CartPoleSystem`]: the model of the paper's authors, in which poles do not act on each other.

use super::motion::{moved, moved_bar, rate_of, rate_of_bar, velocity_of};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::number::{Number, Numbers};
use crate::dynamics::ode::ForcedOde;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use arrayvec::ArrayVec;
use serde::{Deserialize, Serialize};

/// One value per pole.
pub(super) type PerPole<T> = ArrayVec<T, { CartPoleSystem::MAX_POLES }>;
/// Force on the cart, followed by the torque on each pole.
pub(super) type Forces<T> = ArrayVec<T, { CartPoleSystem::MAX_POLES + 1 }>;

/// Cart with poles that do not act on each other: semi-implicit Euler, velocities first.
///
/// State `[x, ẋ, θ₁, ω₁, θ₂, ω₂, …]` in m, m/s, rad, rad/s, with θ = 0 upright. Control `[u]` in N.
///
/// ```text
/// A_i = (F + m l sin θ_i ω_i²) / M
/// α_i = (τ_i / (m l) - cos θ_i A_i) / (l (4/3 - m cos² θ_i / M))
/// ẍ   = (F + m l Σ_i (sin θ_i ω_i² - α_i cos θ_i)) / M
/// ```
///
/// Forces, to which effects add: `[F, τ₁, τ₂, …]`. F is the force on the cart in N, τ_i the torque
/// on each pole about its joint in N m. Without effects, F is the control, and τ_i = m g l sin θ_i
/// is due to gravity. Friction of cart and joints enters as in Barto, Sutton and Anderson.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CartPoleSystem {
    /// Number of poles, 1 to 64.
    pub poles: usize,
    /// Mass of the cart, kg. M is the sum of this mass and `pole_mass`.
    pub cart_mass: Number,
    /// Mass m of a pole, kg.
    pub pole_mass: Number,
    /// Half length l of a pole, m.
    pub half_length: Number,
    /// Gravitational acceleration g, m/s².
    pub gravity: Number,
    /// Time step, s.
    pub dt: f64,
}

impl Default for CartPoleSystem {
    fn default() -> Self {
        Self {
            poles: 1,
            cart_mass: 1.0.into(),
            pole_mass: 0.1.into(),
            half_length: 0.5.into(),
            gravity: 9.8.into(),
            dt: 0.01,
        }
    }
}

impl CartPoleSystem {
    /// Returns the pole components of a state: angle and rate of each.
    #[inline(always)]
    pub(crate) fn poles_of<'a, T>(&self, x: &'a [T]) -> std::slice::ChunksExact<'a, T> {
        x[2..2 + 2 * self.poles].chunks_exact(2)
    }

    /// Cart mass, pole mass, half length and gravity.
    #[inline(always)]
    pub(crate) fn numbers(&self) -> Numbers<'_> {
        let Self { cart_mass, pole_mass, half_length, gravity, .. } = self;
        Numbers::new([
            ("cart_mass", cart_mass),
            ("pole_mass", pole_mass),
            ("half_length", half_length),
            ("gravity", gravity),
        ])
    }

    /// Nominal cart mass and pole mass in kg, half length in m, and gravity in m/s².
    pub fn nominal(&self) -> [f64; 4] {
        [self.cart_mass, self.pole_mass, self.half_length, self.gravity]
            .map(|number| number.nominal())
    }

    /// Half the length of a pole, m.
    #[inline(always)]
    pub(super) fn half_length<T: Scalar>(&self, p: &[T]) -> T {
        let [_, _, half_length, _] = self.numbers().last_of(p);
        half_length
    }

    /// Largest number of poles. Buffers of a step are on the stack.
    pub const MAX_POLES: usize = 64;

    /// Appends sine and cosine of every angle to `trig`, and the forces with `effects` to
    /// `forces`. `weight` is m g l in N m.
    ///
    /// Both buffers must be empty on entry. Returning them would copy their whole capacity.
    #[inline(always)]
    pub(super) fn forces<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        weight: T,
        inputs: OdeInputs<'_, T>,
        trig: &mut PerPole<[T; 2]>,
        forces: &mut Forces<T>,
    ) {
        forces.push(inputs.u[0]);
        for pole in self.poles_of(inputs.x) {
            let (sin, cos) = pole[0].sin_cos();
            trig.push([sin, cos]);
            forces.push(weight * sin);
        }
        effects.add_forces(self, inputs, forces);
    }
}

/// Constants of [`CartPoleSystem`] in one scalar type.
struct Constants<T> {
    dt: T,
    /// m l, kg m.
    moment: T,
    /// m g l, N m.
    weight: T,
    /// 1 / M, 1/kg.
    per_mass: T,
    /// 4 m l² / 3, kg m².
    inertia: T,
    /// (m l)² / M, kg m².
    coupling: T,
}

impl CartPoleSystem {
    /// Constants of the equations, computed in f64 if all numbers are fixed, otherwise in `T`.
    #[inline(always)]
    fn constants<T: Scalar>(&self, p: &[T]) -> Constants<T> {
        let numbers = self.numbers();
        let [moment, weight, per_mass, inertia, coupling] = if numbers.varied() == 0 {
            Self::derived(numbers.of::<f64, 4>(&[])).map(T::from)
        } else {
            Self::derived(numbers.last_of(p))
        };
        Constants { dt: T::from(self.dt), moment, weight, per_mass, inertia, coupling }
    }

    #[inline(always)]
    fn derived<T: Scalar>([cart_mass, pole_mass, half_length, gravity]: [T; 4]) -> [T; 5] {
        let (mass, moment) = (cart_mass + pole_mass, pole_mass * half_length);
        [
            moment,
            moment * gravity,
            T::one() / mass,
            moment * (4.0 / 3.0) * half_length,
            moment * moment / mass,
        ]
    }
}

impl ForcedSystem for CartPoleSystem {
    type Model = Self;

    fn model(&self) -> &Self {
        self
    }

    fn state_dim(&self) -> usize {
        2 + 2 * self.poles
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn force_dim(&self) -> usize {
        1 + self.poles
    }

    fn dt(&self) -> f64 {
        self.dt
    }

    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Self::numbers(self)
    }

    #[inline(always)]
    fn forced_step<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let (k, x) = (self.constants(inputs.p), inputs.x);
        let push =
            self.accelerate(&k, effects, inputs.continuous(self.dt), &mut next[2..], moved(k.dt));
        next[1] = x[1] + k.dt * push * k.per_mass;
        next[0] = x[0] + k.dt * next[1];
    }

    #[inline(always)]
    fn forced_vjp<E: Effect<Self>, R: Real, C: Cotangent<R>>(
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
        let inputs = inputs.continuous(self.dt);
        self.accelerate_reverse(
            effects,
            inputs,
            speed_bar * (k.dt * k.per_mass),
            moved_bar(next_bar, k.dt),
            cotangents,
        );
    }
}

impl CartPoleSystem {
    /// Writes `of_pole(pole, α_i)` for each pole to `poles`, and returns M ẍ.
    #[inline(always)]
    fn accelerate<E: Effect<Self>, T: Scalar>(
        &self,
        k: &Constants<T>,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        poles: &mut [T],
        of_pole: impl Fn(&[T], T) -> [T; 2],
    ) -> T {
        let (x, mut trig, mut forces) = (inputs.x, PerPole::new(), Forces::new());
        self.forces(effects, k.weight, inputs, &mut trig, &mut forces);
        let force = forces[0];
        let mut push = force;
        let moments = zip(&trig, &forces[1..]);
        for ((pole, out), (&[sin, cos], &torque)) in
            zip(zip(self.poles_of(x), poles.chunks_exact_mut(2)), moments)
        {
            let omega = pole[1];
            let lever = k.moment * cos;
            let centrifugal = k.moment * sin * omega * omega;
            let a = (force + centrifugal) * k.per_mass;
            let alpha = (torque - lever * a) / (k.inertia - k.coupling * cos * cos);
            push += centrifugal - lever * alpha;
            [out[0], out[1]] = of_pole(pole, alpha);
        }
        push
    }

    /// Reverse of [`accelerate`](Self::accelerate). Adds to the requested cotangents of poles and
    /// control. Effects add to all requested cotangents.
    ///
    /// `pole_bar(i)` returns the cotangents of angle and rate of pole `i` that do not pass through
    /// α_i, and the cotangent of α_i.
    #[inline(always)]
    fn accelerate_reverse<E: Effect<Self>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, R>,
        push_bar: C,
        pole_bar: impl Fn(usize) -> ([C; 2], C),
        mut cotangents: Cotangents<'_, C>,
    ) {
        let (k, x) = (self.constants(inputs.p), inputs.x);
        let (mut trig, mut forces, mut forces_bar) = (PerPole::new(), Forces::new(), Forces::new());
        self.forces(effects, k.weight, inputs, &mut trig, &mut forces);
        let force = forces[0];

        let mut force_bar = push_bar;
        forces_bar.push(push_bar);
        for (i, ((pole, &[sin, cos]), &torque)) in
            zip(zip(self.poles_of(x), &trig), &forces[1..]).enumerate()
        {
            let omega = pole[1];
            let (lever, spin) = (k.moment * cos, omega * omega);
            let a = (force + k.moment * sin * spin) * k.per_mass;
            let per_inertia = R::one() / (k.inertia - k.coupling * cos * cos);
            let alpha = (torque - lever * a) * per_inertia;

            let ([theta_bar, omega_bar], alpha_bar) = pole_bar(i);
            let alpha_bar = alpha_bar - push_bar * lever;
            // α = (τ - m l cos θ A) / (4 m l²/3 - (m l cos θ)²/M). `thrust_bar` is the cotangent of
            // M A = F + m l sin θ ω².
            let torque_bar = alpha_bar * per_inertia;
            let thrust_bar = -(torque_bar * (lever * k.per_mass));
            force_bar += thrust_bar;
            forces_bar.push(torque_bar);
            if let Some(x_bar) = &mut cotangents.x {
                let centrifugal_bar = push_bar + thrust_bar;
                let sin_bar = torque_bar * k.weight + centrifugal_bar * (k.moment * spin);
                let cos_bar = torque_bar * (R::from(2.0) * k.coupling * cos * alpha - k.moment * a)
                    - push_bar * (k.moment * alpha);
                x_bar[2 + 2 * i] += theta_bar;
                x_bar[2 + 2 * i] += sin_bar * cos;
                x_bar[2 + 2 * i] -= cos_bar * sin;
                x_bar[3 + 2 * i] += omega_bar;
                x_bar[3 + 2 * i] += centrifugal_bar * (R::from(2.0) * k.moment * sin * omega);
            }
        }
        if let Some(u_bar) = &mut cotangents.u {
            u_bar[0] += force_bar;
        }
        forces_bar[0] = force_bar;
        effects.vjp(self, inputs, &forces_bar, cotangents);
    }
}

impl ForcedOde for CartPoleSystem {
    #[inline(always)]
    fn forced_rate<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        rate: &mut [T],
    ) {
        let k = self.constants(inputs.p);
        rate[1] = self.accelerate(&k, effects, inputs, &mut rate[2..], rate_of) * k.per_mass;
        rate[0] = inputs.x[1];
    }

    #[inline(always)]
    fn forced_rate_vjp<E: Effect<Self>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let k = self.constants(inputs.p);
        if let Some(x_bar) = &mut cotangents.x {
            for i in (0..rate_bar.len()).step_by(2) {
                x_bar[i + 1] += rate_bar[i];
            }
        }
        self.accelerate_reverse(
            effects,
            inputs,
            rate_bar[1] * k.per_mass,
            rate_of_bar(rate_bar),
            cotangents,
        );
    }

    fn velocity_of(&self, i: usize) -> Option<usize> {
        velocity_of(i)
    }
}

system_without_effects!(CartPoleSystem);
