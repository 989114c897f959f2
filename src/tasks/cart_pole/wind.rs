//! Wind along the rail, steady or gusty.

use super::CartPoleSystem;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::number::{Number, Numbers};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Air drag on cart and poles. In still air (`speed = 0`), drag slows cart and poles down.
///
/// ```text
/// cart:   F   = cart_drag |w - ẋ| (w - ẋ)
/// pole i: D_i = pole_drag |v_i| v_i,   v_i = (w - ẋ) cos θ_i - l ω_i
///         F  += D_i cos θ_i,           τ_i = l D_i
/// ```
///
/// w is the wind speed. v_i is the speed of the air across the pole, at its middle. Flow along a
/// slender rod exerts hardly any force (the cross-flow principle; Hoerner, Fluid-Dynamic Drag,
/// 1965, ch. 3). Each coefficient is half the air density times the drag coefficient times the
/// frontal area.
///
/// Strip theory integrates the drag along the pole. At distance s from the joint, the air crosses
/// the pole at the speed `W - s ω`, with `W = (w - ẋ) cos θ_i`:
///
/// ```text
/// D = c/2l ∫ |W - s ω| (W - s ω) ds,   τ = c/2l ∫ s |W - s ω| (W - s ω) ds
/// with s from 0 to 2l, c = pole_drag
///
///                       strips                                here
/// no spin, ω = 0 :      D = c |W| W,          τ = l D             the same
/// no wind, W = 0 :      D = -4/3 c l² |ω| ω,  τ = -2 c l³ |ω| ω   D = -c l² |ω| ω, τ = -c l³ |ω| ω
/// slow spin, l ω « W :  dτ/dω = -8/3 c l² |W|                     dτ/dω = -2 c l² |W|
/// ```
///
/// The two differ because the mean of squared speeds is not the square of the mean speed. For a
/// spinning pole in still air, the torque is half that of strip theory, and the force three
/// quarters. In a wind that is fast compared with `l ω`, the damping of the spin is also three
/// quarters of that of strip theory.
///
/// Example: the defaults, 5 rad/s in still air, and l = 0.5 m. The torque is 0.04 N m here, and
/// 0.08 N m by strip theory. The torque of gravity is at most 0.49 N m. The difference matters
/// where air alone slows a spinning pole.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SteadyWind {
    /// Wind speed w, m/s, positive towards positive x.
    pub speed: Number,
    /// Drag coefficient of the cart, N s²/m², not negative. The default is that of a board of 0.1
    /// m².
    pub cart_drag: Number,
    /// Drag coefficient of a pole, N s²/m², not negative. The default is that of a rod, 1 m long
    /// and 2 cm thick.
    pub pole_drag: Number,
}

impl Default for SteadyWind {
    fn default() -> Self {
        Self { speed: 3.0.into(), cart_drag: 0.06.into(), pole_drag: 0.013.into() }
    }
}

impl SteadyWind {
    /// Wind speed, m/s. `p` contains the numbers of the effect that vary.
    pub fn speed_at(&self, p: &[f64]) -> f64 {
        let [speed, _, _] = Effect::<CartPoleSystem>::numbers(self).of(p);
        speed
    }

    /// Wind speed, m/s, and drag.
    #[inline(always)]
    fn values<T: Scalar>(&self, model: &CartPoleSystem, p: &[T]) -> (T, Drag<T>) {
        let [speed, cart, pole] = Effect::<CartPoleSystem>::numbers(self).of(p);
        (speed, Drag { cart, pole, half_length: model.half_length(p) })
    }
}

impl Effect<CartPoleSystem> for SteadyWind {
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([
            ("speed", &self.speed),
            ("cart_drag", &self.cart_drag),
            ("pole_drag", &self.pole_drag),
        ])
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let (speed, drag) = self.values(model, p);
        drag.add_forces(model, speed, x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        if cotangents.x.is_some() {
            let (speed, drag) = self.values(model, p);
            drag.vjp(model, speed, x, forces_bar, cotangents.x);
        }
    }
}

/// [`SteadyWind`] with a speed that oscillates about its mean:
/// `w = speed + gust sin(2π (t + t₀) / period)`.
///
/// Parameter: `t₀` in s, drawn uniformly from 0 to `period`. The policy does not observe it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct GustyWind {
    /// Mean wind speed, m/s, positive towards positive x.
    pub speed: Number,
    /// Amplitude of the wind speed, m/s.
    pub gust: Number,
    /// Period of the gusts, s, positive.
    pub period: f64,
    /// Drag coefficient of the cart, N s²/m², not negative. The default is that of a board of 0.1
    /// m².
    pub cart_drag: Number,
    /// Drag coefficient of a pole, N s²/m², not negative. The default is that of a rod, 1 m long
    /// and 2 cm thick.
    pub pole_drag: Number,
}

impl Default for GustyWind {
    fn default() -> Self {
        let SteadyWind { speed, cart_drag, pole_drag } = SteadyWind::default();
        Self { speed, gust: 2.0.into(), period: 1.0, cart_drag, pole_drag }
    }
}

impl GustyWind {
    /// Wind speed, m/s, and its derivative with respect to time, m/s², at the time `t` in s. `p`
    /// contains t₀ and the numbers of the effect that vary.
    #[inline(always)]
    pub fn speed_at<T: Scalar>(&self, p: &[T], t: T) -> [T; 2] {
        let [speed, gust, _, _] = Effect::<CartPoleSystem>::numbers(self).of(&p[1..]);
        let rate = TAU / self.period;
        let (sin, cos) = ((t + p[0]) * rate).sin_cos();
        [speed + gust * sin, gust * rate * cos]
    }

    /// Wind speed, m/s, its derivative with respect to time, m/s², and drag.
    #[inline(always)]
    fn values<T: Scalar>(
        &self,
        model: &CartPoleSystem,
        OdeInputs { p, t, .. }: OdeInputs<'_, T>,
    ) -> (T, T, Drag<T>) {
        let [_, _, cart, pole] = Effect::<CartPoleSystem>::numbers(self).of(&p[1..]);
        let [speed, slope] = self.speed_at(p, t);
        (speed, slope, Drag { cart, pole, half_length: model.half_length(p) })
    }
}

impl Effect<CartPoleSystem> for GustyWind {
    #[inline(always)]
    fn param_dim(&self) -> usize {
        1 + Effect::<CartPoleSystem>::numbers(self).varied()
    }

    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        let Self { speed, gust, period: _, cart_drag, pole_drag } = self;
        Numbers::new([
            ("speed", speed),
            ("gust", gust),
            ("cart_drag", cart_drag),
            ("pole_drag", pole_drag),
        ])
    }

    fn draw_params(&self, rng: &mut Rng, p: &mut [f64]) {
        p[0] = rng.random_range(0.0..=self.period);
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &CartPoleSystem,
        inputs: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let (wind, _, drag) = self.values(model, inputs);
        drag.add_forces(model, wind, inputs.x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &CartPoleSystem,
        inputs: OdeInputs<'_, R>,
        forces_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        if cotangents.x.is_none() && cotangents.p.is_none() {
            return;
        }
        let (wind, slope, drag) = self.values(model, inputs);
        let wind_bar = drag.vjp(model, wind, inputs.x, forces_bar, cotangents.x.take());
        if let Some(p_bar) = cotangents.p {
            p_bar[0] += wind_bar * slope;
        }
    }
}

/// Drag of [`SteadyWind`], for any wind speed.
struct Drag<T> {
    cart: T,
    pole: T,
    half_length: T,
}

impl<T: Scalar> Drag<T> {
    #[inline(always)]
    fn add_forces(self, model: &CartPoleSystem, wind: T, x: &[T], forces: &mut [T]) {
        let (pole_drag, l) = (self.pole, self.half_length);
        let headwind = wind - x[1];
        let mut push = forces[0] + self.cart * headwind.abs() * headwind;
        for (pole, torque) in zip(model.poles_of(x), &mut forces[1..]) {
            let cos = pole[0].cos();
            let across = headwind * cos - l * pole[1];
            let drag = pole_drag * across.abs() * across;
            push += drag * cos;
            *torque += drag * l;
        }
        forces[0] = push;
    }
}

impl<R: Real> Drag<R> {
    /// Adds the cotangents of the state, if requested, and returns the cotangent of the wind speed.
    /// The derivative of `|v| v` is `2 |v|`, also at `v = 0`.
    #[inline(always)]
    fn vjp<C: Cotangent<R>>(
        self,
        model: &CartPoleSystem,
        wind: R,
        x: &[R],
        forces_bar: &[C],
        mut x_bar: Option<&mut [C]>,
    ) -> C {
        let (pole_drag, l) = (self.pole, self.half_length);
        let headwind = wind - x[1];
        let push_bar = forces_bar[0];
        let mut headwind_bar = push_bar * (self.cart * 2.0 * headwind.abs());
        for (i, (pole, &torque_bar)) in zip(model.poles_of(x), &forces_bar[1..]).enumerate() {
            let (sin, cos) = pole[0].sin_cos();
            let across = headwind * cos - l * pole[1];
            let strength = pole_drag * across.abs();
            let across_bar = (push_bar * cos + torque_bar * l) * (strength + strength);
            headwind_bar += across_bar * cos;
            if let Some(x_bar) = &mut x_bar {
                x_bar[2 + 2 * i] -= (push_bar * (strength * across) + across_bar * headwind) * sin;
                x_bar[3 + 2 * i] -= across_bar * l;
            }
        }
        if let Some(x_bar) = x_bar {
            x_bar[1] -= headwind_bar;
        }
        headwind_bar
    }
}
