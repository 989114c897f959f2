//! [`OpCount`]: operation counts of a system's step and of its transposed Jacobian products.

use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::system::System;
use crate::numbers::scalar::{Counted, Ops};

/// Operation counts of one step of one sample, and of its VJPs with one cotangent.
///
/// Exact and independent of the machine: the step is evaluated on [`Counted`] numbers. Operations
/// on the `f64` constants of a system are not counted.
///
/// Systems do not branch on values, so the counts are independent of the state. Exceptions are
/// systems that iterate ([`Adaptive`](crate::Adaptive),
/// [`ImplicitMidpoint`](crate::ImplicitMidpoint)): their counts are those of one fixed state.
///
/// ```
/// use physgrad::tasks::{CartDamping, CartPoleSystem};
/// use physgrad::{OpCount, Forced};
///
/// let system = CartPoleSystem::default();
/// let alone = OpCount::of(&system);
/// let damped = OpCount::of(&Forced { system, effects: CartDamping::default() });
/// assert_eq!(OpCount::of(&Forced { system, effects: () }), alone);
/// assert_eq!((damped.step - alone.step).to_string(), "1 add, 1 multiply");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpCount {
    /// [`System::step`].
    pub step: Ops,
    /// [`System::vjp`], to state and control. Evaluated by the flows R and M, and by any two flows
    /// together.
    pub vjp: Ops,
    /// [`System::vjp`], to the control alone. Evaluated by a single flow N or S.
    pub vjp_control: Ops,
}

impl OpCount {
    /// Counts the operations of `system`.
    pub fn of<S: System>(system: &S) -> Self {
        let (n, m) = (system.state_dim(), system.control_dim());
        // Arbitrary values of moderate size.
        let numbers = |len: usize| (0..len).map(|i| Counted(0.1 + 0.01 * i as f64)).collect::<Vec<_>>();
        let (x, u, next_bar) = (numbers(n), numbers(m), numbers(n));
        let p = numbers(system.param_dim());
        let inputs = Inputs { x: &x, u: &u, p: &p, t: 0 };
        let (mut next, mut x_bar, mut u_bar) = (numbers(n), numbers(n), numbers(m));
        let vjp = |bars: Cotangents<'_, Counted>| Ops::of(|| system.vjp(inputs, &next_bar, bars)).0;
        Self {
            step: Ops::of(|| system.step(inputs, &mut next)).0,
            vjp: vjp(Cotangents::of(&mut x_bar, &mut u_bar)),
            vjp_control: vjp(Cotangents { u: Some(&mut u_bar), ..Cotangents::default() }),
        }
    }
}
