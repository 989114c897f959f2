//! [`Actuator`]: maps the control of the policy to the control of the system.
//!
//! [`Limit`], [`Lag`] and [`Delay`] are built in. Pairs and `Vec`s compose actuators. [`Actuated`]
//! combines a system and an actuator.

mod chain;
mod kinds;

pub use kinds::{AnyActuator, Delay, Lag, Limit, LimitKind};

use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::forward::forward;
use crate::dynamics::inputs::{Cotangents, Inputs, Start, Tangents, add};
use crate::dynamics::system::{System, along};
use crate::numbers::forward_mode::{concat, jacobian};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};

/// Number of controls up to which steps do not allocate. VJPs have two further limits, four times
/// as large: one for the state components of an actuator, one for the total inputs of a chain.
const STACK: usize = 8;
type Controls<T> = SmallVec<[T; STACK]>;

/// A map from the policy's control `u` to the system's control `out`: a limit, a lag, a delay.
///
/// `()` is the identity. A pair applies its first actuator, then its second. A `Vec` is a chain
/// chosen at run time.
///
/// An actuator may have a `state`, initially 0. Required: [`state_dim`](Actuator::state_dim)
/// and [`step`](Actuator::step).
///
/// # Shapes
/// `inputs.u` is the control of the policy. It and `out` have one entry per control of the system.
/// `inputs.x` is the state of the actuator. It and `next` have [`state_dim`](Actuator::state_dim)
/// entries. `inputs.p` is empty, and `inputs.t` is 0.
pub trait Actuator: Clone + Send + Sync {
    /// Number of state components for a system with `controls` controls.
    fn state_dim(&self, controls: usize) -> usize;

    /// Writes the actuator's next state and the system's control.
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T], out: &mut [T]);

    /// Range to which the actuator limits every control, in the units of the control. Default:
    /// `None`, no limit.
    fn range(&self) -> Option<[f64; 2]> {
        None
    }

    /// Returns true for the identity. [`Actuated`] then skips the actuator.
    #[doc(hidden)]
    #[inline(always)]
    fn is_identity(&self) -> bool {
        false
    }

    /// VJP of [`step`](Actuator::step). Adds to the requested cotangents.
    ///
    /// Defaults to exact derivatives by dual numbers. Override it with an analytic derivative for
    /// speed.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        reverse_by_duals(self, inputs, next_bar, cotangents);
    }
}

/// Cotangents of the outputs of [`Actuator::step`].
#[derive(Clone, Copy, Debug)]
pub struct OutputCotangents<'a, C> {
    /// Cotangent of the actuator's next state.
    pub state: &'a [C],
    /// Cotangent of the system's control.
    pub out: &'a [C],
}

/// Default [`Actuator::vjp`]: exact, by dual numbers through [`Actuator::step`].
#[inline]
fn reverse_by_duals<A: Actuator, R: Real, C: Cotangent<R>>(
    actuator: &A,
    Inputs { x: state, u, .. }: Inputs<'_, R>,
    next_bar: OutputCotangents<'_, C>,
    cotangents: Cotangents<'_, C>,
) {
    let (n, m) = (state.len(), u.len());
    let Cotangents { x: mut state_bar, u: mut u_bar, .. } = cotangents;
    let wrt = if state_bar.is_some() { 0 } else { n }..if u_bar.is_some() { n + m } else { n };
    let step = |x: &[_], next: &mut [_]| {
        let (next, out) = next.split_at_mut(n);
        actuator.step(Inputs::new(&x[..n], &x[n..]), next, out);
    };
    jacobian(&concat(state, u), wrt, n + m, step, |i, column: &[R]| {
        let mut bar = C::null();
        for (&next_bar, &slope) in zip(next_bar.state.iter().chain(next_bar.out), column) {
            bar += next_bar * slope;
        }
        // `wrt` contains only inputs whose cotangent is given.
        let side = if i < n { state_bar.as_deref_mut() } else { u_bar.as_deref_mut() };
        side.into_iter().for_each(|side| side[if i < n { i } else { i - n }] += bar);
    });
}

/// The identity: the system's control is the policy's.
impl Actuator for () {
    fn state_dim(&self, _controls: usize) -> usize {
        0
    }

    #[inline(always)]
    fn is_identity(&self) -> bool {
        true
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, _next: &mut [T], out: &mut [T]) {
        out.copy_from_slice(inputs.u);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _inputs: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        if let Some(u_bar) = cotangents.u {
            add(u_bar, next_bar.out);
        }
    }
}

/// Composition: the first actuator, then the second.
impl<A: Actuator, B: Actuator> Actuator for (A, B) {
    fn state_dim(&self, controls: usize) -> usize {
        self.0.state_dim(controls) + self.1.state_dim(controls)
    }

    fn range(&self) -> Option<[f64; 2]> {
        self.0.range().or_else(|| self.1.range())
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T], out: &mut [T]) {
        let (first, second) = inputs.x.split_at(self.0.state_dim(inputs.u.len()));
        let (next_first, next_second) = next.split_at_mut(first.len());
        let mut between: Controls<T> = SmallVec::from_slice(inputs.u);
        self.0.step(Inputs::new(first, inputs.u), next_first, &mut between);
        self.1.step(Inputs::new(second, &between), next_second, out);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x: state, u, .. }: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        let n = self.0.state_dim(u.len());
        let mut between: Controls<R> = SmallVec::from_slice(u);
        let mut next_state: SmallVec<[R; 4 * STACK]> = smallvec![R::zero(); n];
        self.0.step(Inputs::new(&state[..n], u), &mut next_state, &mut between);
        let mut between_bar: Controls<C> = smallvec![C::null(); u.len()];
        let (first, second) = cotangents.x.map(|bar| bar.split_at_mut(n)).unzip();
        let (first_bar, second_bar) = next_bar.state.split_at(n);
        self.1.vjp(
            Inputs::new(&state[n..], &between),
            OutputCotangents { state: second_bar, out: next_bar.out },
            Cotangents { x: second, u: Some(&mut between_bar), p: None },
        );
        self.0.vjp(
            Inputs::new(&state[..n], u),
            OutputCotangents { state: first_bar, out: &between_bar },
            Cotangents { x: first, u: cotangents.u, p: None },
        );
    }
}

/// A system with an actuator on its control.
///
/// State: the system's components, then the actuator's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Actuated<S, A> {
    /// The controlled system.
    pub system: S,
    /// The actuator: `()` for none, a pair for two in sequence, a `Vec` for a choice at run time.
    pub actuator: A,
}

impl<S: System, A: Actuator> Actuated<S, A> {
    /// Returns the system's control for the policy's control `u`.
    #[inline(always)]
    fn control<R: Real>(&self, state: &[R], u: &[R]) -> Controls<R> {
        let mut out: Controls<R> = SmallVec::from_slice(u);
        let mut next_state: SmallVec<[R; 4 * STACK]> = SmallVec::from_slice(state);
        self.actuator.step(Inputs::new(state, u), &mut next_state, &mut out);
        out
    }
}

impl<S: System, A: Actuator> System for Actuated<S, A> {
    fn state_dim(&self) -> usize {
        self.system.state_dim() + self.actuator.state_dim(self.system.control_dim())
    }

    forward!(System of system: control_dim, param_dim, varied);

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        if self.actuator.is_identity() {
            return self.system.step(inputs, next);
        }
        let (x, state) = inputs.x.split_at(self.system.state_dim());
        let mut out: Controls<T> = SmallVec::from_slice(inputs.u);
        let (next, next_state) = next.split_at_mut(x.len());
        self.actuator.step(Inputs::new(state, inputs.u), next_state, &mut out);
        self.system.step(inputs.with_x(x).with_u(&out), next);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        if self.actuator.is_identity() {
            return self.system.vjp(inputs, next_bar, cotangents);
        }
        let (x, state) = inputs.x.split_at(self.system.state_dim());
        let (next_bar, next_state_bar) = next_bar.split_at(x.len());
        let (x_bar, state_bar) = cotangents.x.map(|bar| bar.split_at_mut(x.len())).unzip();
        let out = self.control(state, inputs.u);
        // Only the cotangents of `u` and of the actuator's state need the actuator's VJP.
        let through_control = cotangents.u.is_some() || !state.is_empty() && state_bar.is_some();
        let mut out_bar: Controls<C> = smallvec![C::null(); inputs.u.len()];
        let system_bars = Cotangents {
            x: x_bar,
            u: through_control.then_some(&mut out_bar[..]),
            p: cotangents.p,
        };
        self.system.vjp(inputs.with_x(x).with_u(&out), next_bar, system_bars);
        if through_control {
            self.actuator.vjp(
                Inputs::new(state, inputs.u),
                OutputCotangents { state: next_state_bar, out: &out_bar },
                Cotangents { x: state_bar, u: cotangents.u, p: None },
            );
        }
    }

    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        if self.actuator.is_identity() {
            return self.system.jvp(inputs, tangents, next_tan);
        }
        let (x, state) = inputs.x.split_at(self.system.state_dim());
        let (x_tan, state_tan) = tangents.x.map(|tangents| tangents.split_at(x.len())).unzip();
        let (next_tan, next_state_tan) = next_tan.split_at_mut(x.len());
        let (state, u) = (along(state, state_tan), along(inputs.u, tangents.u));
        let (mut next_state, mut out) = (state.clone(), u.clone());
        self.actuator.step(Inputs::new(&state, &u), &mut next_state, &mut out);
        for (tan, next) in zip(next_state_tan.iter_mut(), &next_state) {
            *tan = next.tangents[0];
        }
        let (out, out_tan): (Controls<R>, Controls<R>) =
            out.iter().map(|out| (out.value, out.tangents[0])).unzip();
        self.system.jvp(
            inputs.with_x(x).with_u(&out),
            Tangents { x: x_tan, u: Some(&out_tan), p: tangents.p },
            next_tan,
        );
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        let (x, state) = inputs.x.split_at(self.system.state_dim());
        self.system.diagnose(inputs.with_x(x).with_u(&self.control(state, inputs.u)))
    }
}

impl<B, S: HasModel<B>, A: Actuator> HasModel<B> for Actuated<S, A> {
    #[inline(always)]
    fn model(&self) -> &B {
        self.system.model()
    }

    /// Draws the extra values of the controlled system. Sets the actuator's state to 0.
    fn start_extra(&self, rng: &mut Rng, start: Start<'_>) {
        let (x, state) = start.x.split_at_mut(self.system.state_dim());
        self.system.start_extra(rng, Start { x, p: start.p });
        state.fill(0.0);
    }
}
