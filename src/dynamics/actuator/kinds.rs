//! Built-in actuators: [`Limit`], [`Lag`], [`Delay`], and [`AnyActuator`], a choice at run time.

use super::{Actuator, OutputCotangents};
use crate::dynamics::inputs::{Cotangents, Inputs, add};
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
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, _next: &mut [T], out: &mut [T]) {
        let bound = T::from(self.bound);
        for (out, &u) in zip(out.iter_mut(), inputs.u) {
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
        inputs: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        let (u, u_bar) = (inputs.u, cotangents.u);
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
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T], out: &mut [T]) {
        let share = T::from(self.share);
        for (((next, out), &state), &u) in zip(zip(zip(next.iter_mut(), out), x), u) {
            *next = state + (u - state) * share;
            *out = *next;
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _inputs: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        let (state_bar, u_bar) = (cotangents.x, cotangents.u);
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
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T], out: &mut [T]) {
        let (oldest, pending) = inputs.x.split_at(inputs.u.len());
        out.copy_from_slice(oldest);
        let (shifted, newest) = next.split_at_mut(pending.len());
        shifted.copy_from_slice(pending);
        newest.copy_from_slice(inputs.u);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        let Cotangents { x: state_bar, u: u_bar, .. } = cotangents;
        let (shifted, newest) = next_bar.state.split_at(inputs.x.len() - inputs.u.len());
        if let Some(state_bar) = state_bar {
            let (oldest, pending) = state_bar.split_at_mut(inputs.u.len());
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

/// Evaluates an expression for the actuator that an [`AnyActuator`] holds.
macro_rules! each {
    ($any:expr, $actuator:ident => $value:expr) => {
        match $any {
            AnyActuator::Limit($actuator) => $value,
            AnyActuator::Delay($actuator) => $value,
            AnyActuator::Lag($actuator) => $value,
        }
    };
}

impl Actuator for AnyActuator {
    fn state_dim(&self, controls: usize) -> usize {
        each!(self, actuator => actuator.state_dim(controls))
    }

    fn range(&self) -> Option<[f64; 2]> {
        each!(self, actuator => actuator.range())
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T], out: &mut [T]) {
        each!(self, actuator => actuator.step(inputs, next, out));
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        each!(self, actuator => actuator.vjp(inputs, next_bar, cotangents));
    }
}
