//! Wind along the rail, steady or in gusts.

use super::CartPoleSystem;
use crate::dynamics::effect::Effect;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Drag of the air on cart and poles; in still air (`speed = 0`) it slows them down.
///
/// ```text
/// cart:   F   = cart_drag |w - ẋ| (w - ẋ)
/// pole i: D_i = pole_drag |v_i| v_i,   v_i = (w - ẋ) cos θ_i - l ω_i,   F += D_i cos θ_i,   τ_i = l D_i
/// ```
///
/// w is the speed of the wind and v_i that of the air across the pole, at its middle: what blows along a slender rod
/// hardly moves it (the cross-flow principle; Hoerner, Fluid-Dynamic Drag, 1965, ch. 3). The coefficients are half the
/// density of air times the drag coefficient times the area seen by the wind.
///
/// Strip theory adds up the drag along the pole, where the air crosses it at the speed `W - s ω`, `W = (w - ẋ) cos θ_i`, at
/// the distance s from the joint:
///
/// ```text
/// D = c/2l ∫ |W - s ω| (W - s ω) ds,   τ = c/2l ∫ s |W - s ω| (W - s ω) ds,   s from 0 to 2l, c = pole_drag
///
///                        strips                                 here
/// no spin, ω = 0 :       D = c |W| W,          τ = l D          the same
/// no wind, W = 0 :       D = -4/3 c l² |ω| ω,  τ = -2 c l³ |ω| ω    D = -c l² |ω| ω,  τ = -c l³ |ω| ω
/// slow spin, l ω « W :   dτ/dω = -8/3 c l² |W|                  dτ/dω = -2 c l² |W|
/// ```
///
/// The speed at the middle is the mean of the speeds, and not that of their squares. In still air the torque on a spinning
/// pole is half, and the force three quarters, of that of strips. In a wind that is fast beside `l ω`, the damping of the spin
/// is three quarters. With the defaults, 5 rad/s in still air and l = 0.5 m, the torque is 0.04 N m here and 0.08 N m by
/// strips, beside 0.49 N m of a pole's weight. Where a spinning pole is to be slowed by air alone, the difference matters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SteadyWind {
    /// w, m/s; positive blows towards positive x.
    pub speed: f64,
    /// N s²/m², not negative. The default is that of a board of a tenth of a square metre.
    pub cart_drag: f64,
    /// N s²/m², not negative. The default is that of a rod, 1 m long and 2 cm thick.
    pub pole_drag: f64,
}

impl Default for SteadyWind {
    fn default() -> Self {
        Self { speed: 3.0, cart_drag: 0.06, pole_drag: 0.013 }
    }
}

impl SteadyWind {
    fn drag(&self) -> Drag {
        Drag { cart: self.cart_drag, pole: self.pole_drag }
    }
}

impl Effect<CartPoleSystem> for SteadyWind {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, model: &CartPoleSystem, x: &[T], forces: &mut [T]) {
        self.drag().add_forces(model, T::lift(self.speed), x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &CartPoleSystem, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        self.drag().vjp(model, R::lift(self.speed), x, forces_bar, x_bar);
    }
}

/// [`SteadyWind`] whose speed swings about its mean: `w = speed + gust sin(2π t / period)`.
///
/// It appends the time to the state. Rollouts start at a random time of a period, and the policy sees it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct GustyWind {
    /// Mean of w, m/s; positive blows towards positive x.
    pub speed: f64,
    /// By how much w swings to either side, m/s.
    pub gust: f64,
    /// Time from gust to gust, s, positive.
    pub period: f64,
    /// N s²/m², not negative. The default is that of a board of a tenth of a square metre.
    pub cart_drag: f64,
    /// N s²/m², not negative. The default is that of a rod, 1 m long and 2 cm thick.
    pub pole_drag: f64,
}

impl Default for GustyWind {
    fn default() -> Self {
        let SteadyWind { speed, cart_drag, pole_drag } = SteadyWind::default();
        Self { speed, gust: 2.0, period: 1.0, cart_drag, pole_drag }
    }
}

impl GustyWind {
    fn drag(&self) -> Drag {
        Drag { cart: self.cart_drag, pole: self.pole_drag }
    }

    /// The wind and its slope in time: the time is the last component of the state.
    #[inline(always)]
    fn wind<T: Scalar>(&self, x: &[T]) -> (T, T) {
        let rate = TAU / self.period;
        let (sin, cos) = (x[x.len() - 1] * T::lift(rate)).sin_cos();
        (T::lift(self.speed) + T::lift(self.gust) * sin, T::lift(self.gust * rate) * cos)
    }
}

impl Effect<CartPoleSystem> for GustyWind {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, model: &CartPoleSystem, x: &[T], forces: &mut [T]) {
        self.drag().add_forces(model, self.wind(x).0, x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &CartPoleSystem, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        let (wind, slope) = self.wind(x);
        let wind_bar = self.drag().vjp(model, wind, x, forces_bar, x_bar);
        x_bar[x.len() - 1] += wind_bar * slope;
    }

    #[inline(always)]
    fn clock(&self) -> Option<f64> {
        Some(self.period)
    }
}

/// The drag of [`SteadyWind`], at any speed of the wind.
struct Drag {
    cart: f64,
    pole: f64,
}

impl Drag {
    #[inline(always)]
    fn add_forces<T: Scalar>(self, model: &CartPoleSystem, wind: T, x: &[T], forces: &mut [T]) {
        let (pole_drag, l) = (T::lift(self.pole), T::lift(model.half_length));
        let headwind = wind - x[1];
        let mut push = forces[0] + T::lift(self.cart) * headwind.abs() * headwind;
        for (pole, torque) in zip(model.poles_of(x), &mut forces[1..]) {
            let cos = pole[0].cos();
            let across = headwind * cos - l * pole[1];
            let drag = pole_drag * across.abs() * across;
            push += drag * cos;
            *torque += drag * l;
        }
        forces[0] = push;
    }

    /// Returns the cotangent of the wind. |v| v has the derivative 2 |v|, at 0 as well.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(self, model: &CartPoleSystem, wind: R, x: &[R], forces_bar: &[C], x_bar: &mut [C]) -> C {
        let (pole_drag, l) = (R::lift(self.pole), R::lift(model.half_length));
        let headwind = wind - x[1];
        let push_bar = forces_bar[0];
        let mut headwind_bar = push_bar * (R::lift(2.0 * self.cart) * headwind.abs());
        let bars = zip(x_bar[2..].chunks_exact_mut(2), &forces_bar[1..]);
        for (pole, (bar, &torque_bar)) in zip(model.poles_of(x), bars) {
            let (sin, cos) = pole[0].sin_cos();
            let across = headwind * cos - l * pole[1];
            let strength = pole_drag * across.abs();
            let across_bar = (push_bar * cos + torque_bar * l) * (strength + strength);
            headwind_bar += across_bar * cos;
            bar[0] -= (push_bar * (strength * across) + across_bar * headwind) * sin;
            bar[1] -= across_bar * l;
        }
        x_bar[1] -= headwind_bar;
        headwind_bar
    }
}
