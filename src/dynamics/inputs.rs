//! Arguments of a step ([`Inputs`]) and of its derivatives ([`Cotangents`], [`Tangents`]), and the
//! [`Start`] of a sample.

use crate::numbers::scalar::{Cotangent, Scalar};

/// Arguments of one step: state, control, parameters and time.
///
/// Implementations destructure the fields that they use:
/// `fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T])`.
///
/// # Time
/// `t` is the number of the step, a `usize` that is equal for all samples, so that it can index a
/// table. Vector fields and effects receive [`OdeInputs`], with the time in place of the step
/// number.
///
/// # Parameters
/// `p` has one value per parameter and sample, constant during a rollout: a goal, a mass that
/// differs between samples, the phase of a wind. First come the parameters of the system that are
/// not physical [`Number`](crate::Number)s, then those of its effects, then those of the task.
/// Physical numbers of the system that vary are the last entries.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a, T, Time = usize> {
    /// State.
    pub x: &'a [T],
    /// Control.
    pub u: &'a [T],
    /// Parameters.
    pub p: &'a [T],
    /// Number of the step, from 0. In [`OdeInputs`], the time since the start of the rollout.
    pub t: Time,
}

/// Arguments of a vector field or an effect. `t` is the time since the start of the rollout, in the
/// unit of time of the system: s, except for quantum systems.
pub type OdeInputs<'a, T> = Inputs<'a, T, T>;

impl<'a, T> Inputs<'a, T> {
    /// State and control at step 0, without parameters.
    #[inline(always)]
    pub fn new(x: &'a [T], u: &'a [T]) -> Self {
        Self { x, u, p: &[], t: 0 }
    }
}

impl<'a, T: Copy, Time: Copy> Inputs<'a, T, Time> {
    /// Replaces the state.
    #[inline(always)]
    pub fn with_x<'b>(self, x: &'b [T]) -> Inputs<'b, T, Time>
    where
        'a: 'b,
    {
        Inputs { x, ..self }
    }

    /// Replaces the control.
    #[inline(always)]
    pub fn with_u<'b>(self, u: &'b [T]) -> Inputs<'b, T, Time>
    where
        'a: 'b,
    {
        Inputs { u, ..self }
    }

    /// State, control and parameters.
    #[inline(always)]
    pub(crate) fn lists(self) -> [&'a [T]; 3] {
        [self.x, self.u, self.p]
    }

    /// Omits the first `count` parameters.
    #[inline(always)]
    pub fn skip_params(self, count: usize) -> Self {
        Inputs { p: &self.p[count..], ..self }
    }

    /// Replaces the time.
    #[inline(always)]
    pub fn at<New>(self, t: New) -> Inputs<'a, T, New> {
        let Self { x, u, p, t: _ } = self;
        Inputs { x, u, p, t }
    }
}

impl<'a, T: Scalar> Inputs<'a, T> {
    /// Arguments of a vector field or an effect at the beginning of a step of duration `dt`.
    #[inline(always)]
    pub fn continuous(self, dt: f64) -> OdeInputs<'a, T> {
        self.at(T::from(self.t as f64 * dt))
    }
}

/// Cotangents of the inputs. VJPs add to the requested cotangents; `None` requests no cotangent.
///
/// Reverse passes initialize each buffer with [`Cotangent::null`].
#[derive(Debug)]
pub struct Cotangents<'a, C> {
    /// Cotangent of the state.
    pub x: Option<&'a mut [C]>,
    /// Cotangent of the control.
    pub u: Option<&'a mut [C]>,
    /// Cotangent of the parameters.
    pub p: Option<&'a mut [C]>,
}

impl<C> Default for Cotangents<'_, C> {
    /// Requests nothing.
    #[inline(always)]
    fn default() -> Self {
        Self { x: None, u: None, p: None }
    }
}

impl<'a, C> Cotangents<'a, C> {
    /// Requests the cotangents of state and control.
    #[inline(always)]
    pub fn of(x: &'a mut [C], u: &'a mut [C]) -> Self {
        Self { x: Some(x), u: Some(u), p: None }
    }

    /// Borrows the same buffers for a shorter time, for several calls in sequence.
    #[inline(always)]
    pub fn reborrow(&mut self) -> Cotangents<'_, C> {
        Cotangents { x: self.x.as_deref_mut(), u: self.u.as_deref_mut(), p: self.p.as_deref_mut() }
    }

    /// Omits the first `count` parameters.
    #[inline(always)]
    pub fn skip_params(self, count: usize) -> Self {
        Self { p: self.p.map(|p| &mut p[count..]), ..self }
    }

    /// Cotangents of state, control and parameters.
    #[inline(always)]
    pub(crate) fn lists(self) -> [Option<&'a mut [C]>; 3] {
        [self.x, self.u, self.p]
    }

    /// Returns whether no cotangent is requested.
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.x.is_none() && self.u.is_none() && self.p.is_none()
    }
}

/// Tangents of the inputs: the direction of a forward-mode derivative. `None` is a zero tangent.
#[derive(Clone, Copy, Debug)]
pub struct Tangents<'a, T> {
    /// Tangent of the state.
    pub x: Option<&'a [T]>,
    /// Tangent of the control.
    pub u: Option<&'a [T]>,
    /// Tangent of the parameters.
    pub p: Option<&'a [T]>,
}

impl<T> Default for Tangents<'_, T> {
    /// All tangents are 0.
    fn default() -> Self {
        Self { x: None, u: None, p: None }
    }
}

/// Initial state and parameters of one sample, both 0 before a task draws them.
#[derive(Debug)]
pub struct Start<'a> {
    /// State `x_0`.
    pub x: &'a mut [f64],
    /// Parameters.
    pub p: &'a mut [f64],
}

impl Start<'_> {
    /// Borrows the same values for a shorter time.
    pub fn reborrow(&mut self) -> Start<'_> {
        Start { x: self.x, p: self.p }
    }
}

/// Adds `values` to `cotangents` elementwise.
#[inline(always)]
pub(crate) fn add<R, C: Cotangent<R>>(cotangents: &mut [C], values: &[C]) {
    for (bar, &value) in crate::numbers::zip::zip(cotangents.iter_mut(), values) {
        *bar += value;
    }
}
