//! Wind along the rail, steady or in gusts.

use super::CartPoleSystem;
use crate::effect::Effect;
use crate::scalar::{Cotangent, Real, Scalar};
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

impl Effect<CartPoleSystem> for SteadyWind {
    #[inline(always)]
    fn act<T: Scalar>(&self, body: &CartPoleSystem, x: &[T], forces: &mut [T]) {
        Drag { cart: self.cart_drag, pole: self.pole_drag }.act(body, T::lift(self.speed), x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, body: &CartPoleSystem, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        Drag { cart: self.cart_drag, pole: self.pole_drag }.vjp(body, R::lift(self.speed), x, forces_bar, x_bar);
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
    /// The phase of the wind: the time is the last component of the state.
    #[inline(always)]
    fn phase<T: Scalar>(&self, x: &[T]) -> T {
        x[x.len() - 1] * T::lift(TAU / self.period)
    }
}

impl Effect<CartPoleSystem> for GustyWind {
    #[inline(always)]
    fn act<T: Scalar>(&self, body: &CartPoleSystem, x: &[T], forces: &mut [T]) {
        let wind = T::lift(self.speed) + T::lift(self.gust) * self.phase(x).sin();
        Drag { cart: self.cart_drag, pole: self.pole_drag }.act(body, wind, x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, body: &CartPoleSystem, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        let (sin, cos) = self.phase(x).sin_cos();
        let wind = R::lift(self.speed) + R::lift(self.gust) * sin;
        let wind_bar = Drag { cart: self.cart_drag, pole: self.pole_drag }.vjp(body, wind, x, forces_bar, x_bar);
        x_bar[x.len() - 1] += wind_bar * (R::lift(self.gust * TAU / self.period) * cos);
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
    fn act<T: Scalar>(self, body: &CartPoleSystem, wind: T, x: &[T], forces: &mut [T]) {
        let (pole_drag, l) = (T::lift(self.pole), T::lift(body.half_length));
        let headwind = wind - x[1];
        forces[0] += T::lift(self.cart) * headwind.abs() * headwind;
        for (i, pole) in body.poles_of(x).enumerate() {
            let cos = pole[0].cos();
            let across = headwind * cos - l * pole[1];
            let drag = pole_drag * across.abs() * across;
            forces[0] += drag * cos;
            forces[1 + i] += drag * l;
        }
    }

    /// Returns the cotangent of the wind. |v| v has the derivative 2 |v|, at 0 as well.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(self, body: &CartPoleSystem, wind: R, x: &[R], forces_bar: &[C], x_bar: &mut [C]) -> C {
        let (pole_drag, l) = (R::lift(self.pole), R::lift(body.half_length));
        let headwind = wind - x[1];
        let mut headwind_bar = forces_bar[0] * (R::lift(2.0 * self.cart) * headwind.abs());
        for (i, pole) in body.poles_of(x).enumerate() {
            let (sin, cos) = pole[0].sin_cos();
            let across = headwind * cos - l * pole[1];
            let strength = pole_drag * across.abs();
            let drag_bar = forces_bar[0] * cos + forces_bar[1 + i] * l;
            let across_bar = drag_bar * (strength + strength);
            headwind_bar += across_bar * cos;
            let cos_bar = forces_bar[0] * (strength * across) + across_bar * headwind;
            x_bar[2 + 2 * i] -= cos_bar * sin;
            x_bar[3 + 2 * i] -= across_bar * l;
        }
        x_bar[1] -= headwind_bar;
        headwind_bar
    }
}
