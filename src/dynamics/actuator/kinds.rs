//! Built-in actuators: [`Limit`], [`Lag`], [`Delay`], and [`AnyActuator`], a choice at run time.

use super::{Actuator, OutputCotangents};
use crate::dynamics::inputs::add;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Bounds the magnitude of every control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// Largest magnitude, in the units of the control; positive.
    pub bound: f64,
    /// Shape of the saturation.
    #[serde(default)]
    pub kind: LimitKind,
}

/// Shape of the saturation of a [`Limit`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum LimitKind {
    /// `bound tanh(u / bound)`. The derivative `1 - tanh²(u / bound)` decays smoothly to 0.
    #[default]
    Smooth,
    /// `u`, clipped at ±bound. The derivative is 0 beyond the bound.
    Hard,
}

impl Actuator for Limit {
    /// # Panics
    /// If the bound is not positive, or is infinite with [`LimitKind::Smooth`].
    fn state_dim(&self, _controls: usize) -> usize {
        let is_valid = self.bound > 0.0 && (self.bound.is_finite() || self.kind == LimitKind::Hard);
        assert!(is_valid, "the bound of a limit is a positive number, not {}", self.bound);
        0
    }

    fn range(&self) -> Option<[f64; 2]> {
        Some([-self.bound, self.bound])
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, _state: &[T], u: &[T], _next_state: &mut [T], out: &mut [T]) {
        let bound = T::from(self.bound);
        for (out, &u) in zip(out.iter_mut(), u) {
            *out = match self.kind {
                LimitKind::Smooth => bound * (u * (1.0 / self.bound)).tanh(),
                // `min` and `max` return their argument if an operand is NaN, so NaN propagates.
                LimitKind::Hard => (-bound).max(bound.min(u)),
            };
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _state: &[R],
        u: &[R],
        next_bar: OutputCotangents<'_, C>,
        _state_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        for ((u_bar, &out_bar), &u) in zip(zip(u_bar.into_iter().flatten(), next_bar.out), u) {
            *u_bar += match self.kind {
                LimitKind::Smooth => {
                    let share = (u * R::from(1.0 / self.bound)).tanh();
                    out_bar * (R::one() - share * share)
                }
                LimitKind::Hard => {
                    out_bar * R::select_lt(R::from(self.bound), u.abs(), R::zero(), R::one())
                }
            };
        }
    }
}

/// First-order lag `ḟ = (u - f) / time`, exact for a control `u` that is constant during a step.
///
/// The system's control is `f` at the end of the step. Adds `f` to the state, one component per
/// control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// `1 - exp(-dt/time)`: the fraction of `u - f` covered in one step.
    share: f64,
}

impl Lag {
    /// A lag with time constant `time`, for time steps `dt`; both in s.
    ///
    /// # Panics
    /// If the time constant or the time step is not positive.
    #[track_caller]
    pub fn new(time: f64, dt: f64) -> Self {
        assert!(
            time > 0.0 && dt > 0.0,
            "time constant and time step of a lag are positive, not {time} s and {dt} s"
        );
        Self { share: -(-dt / time).exp_m1() }
    }
}

impl Actuator for Lag {
    fn state_dim(&self, controls: usize) -> usize {
        controls
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, state: &[T], u: &[T], next_state: &mut [T], out: &mut [T]) {
        let share = T::from(self.share);
        for (((next_state, out), &state), &u) in zip(zip(zip(next_state.iter_mut(), out), state), u)
        {
            *next_state = state + (u - state) * share;
            *out = *next_state;
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _state: &[R],
        _u: &[R],
        next_bar: OutputCotangents<'_, C>,
        state_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        let cotangents = || zip(next_bar.state.iter(), next_bar.out);
        let (share, rest) = (R::from(self.share), R::from(1.0 - self.share));
        for (state_bar, (&state, &out)) in zip(state_bar.into_iter().flatten(), cotangents()) {
            *state_bar += (state + out) * rest;
        }
        for (u_bar, (&state, &out)) in zip(u_bar.into_iter().flatten(), cotangents()) {
            *u_bar += (state + out) * share;
        }
    }
}

/// Delays every control by `steps` time steps; the first `steps` controls of the system are 0.
///
/// Adds the pending controls to the state, oldest first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Delay {
    /// Delay in time steps, at least 1.
    pub steps: usize,
}

impl Actuator for Delay {
    /// # Panics
    /// If the number of steps is 0.
    fn state_dim(&self, controls: usize) -> usize {
        assert!(self.steps > 0, "the delay has 0 steps; allowed: 1 or more");
        self.steps * controls
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, state: &[T], u: &[T], next_state: &mut [T], out: &mut [T]) {
        let (oldest, pending) = state.split_at(u.len());
        out.copy_from_slice(oldest);
        let (shifted, newest) = next_state.split_at_mut(pending.len());
        shifted.copy_from_slice(pending);
        newest.copy_from_slice(u);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        state: &[R],
        u: &[R],
        next_bar: OutputCotangents<'_, C>,
        state_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        let (shifted, newest) = next_bar.state.split_at(state.len() - u.len());
        if let Some(state_bar) = state_bar {
            let (oldest, pending) = state_bar.split_at_mut(u.len());
            add(oldest, next_bar.out);
            add(pending, shifted);
        }
        if let Some(u_bar) = u_bar {
            add(u_bar, newest);
        }
    }
}

/// A built-in actuator chosen at run time, for chains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyActuator {
    /// [`Limit`].
    Limit(Limit),
    /// [`Delay`].
    Delay(Delay),
    /// [`Lag`].
    Lag(Lag),
}

impl Actuator for AnyActuator {
    fn state_dim(&self, controls: usize) -> usize {
        match self {
            Self::Limit(limit) => limit.state_dim(controls),
            Self::Delay(delay) => delay.state_dim(controls),
            Self::Lag(lag) => lag.state_dim(controls),
        }
    }

    fn range(&self) -> Option<[f64; 2]> {
        match self {
            Self::Limit(limit) => limit.range(),
            Self::Delay(delay) => delay.range(),
            Self::Lag(lag) => lag.range(),
        }
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, state: &[T], u: &[T], next_state: &mut [T], out: &mut [T]) {
        match self {
            Self::Limit(limit) => limit.step(state, u, next_state, out),
            Self::Delay(delay) => delay.step(state, u, next_state, out),
            Self::Lag(lag) => lag.step(state, u, next_state, out),
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        state: &[R],
        u: &[R],
        next_bar: OutputCotangents<'_, C>,
        state_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        match self {
            Self::Limit(limit) => limit.vjp(state, u, next_bar, state_bar, u_bar),
            Self::Delay(delay) => delay.vjp(state, u, next_bar, state_bar, u_bar),
            Self::Lag(lag) => lag.vjp(state, u, next_bar, state_bar, u_bar),
        }
    }
}
