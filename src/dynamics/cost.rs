//! [`Cost`]: what a system's step and its derivatives cost, in operations.

use crate::dynamics::system::System;
use crate::numbers::scalar::{Counted, Counts};

/// The operations of one step of one sample and of its reverse, for one adjoint.
///
/// Exact, and the same on every machine: the step is run on numbers that count. What is worked out of a system's constants,
/// in plain numbers, is not seen. Systems have no `if` on values, so that
/// the counts are those of every state.
///
/// ```
/// use physgrad::tasks::{CartDamping, CartPoleSystem};
/// use physgrad::{Cost, With};
///
/// let system = CartPoleSystem::default();
/// let alone = Cost::of(&system);
/// let damped = Cost::of(&With { system, effects: CartDamping::default() });
/// assert_eq!(Cost::of(&With { system, effects: () }), alone);
/// assert_eq!((damped.step - alone.step).to_string(), "1 add, 1 multiply");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// The step.
    pub step: Counts,
    /// Its reverse, to state and control: what R and M ask for.
    pub vjp: Counts,
    /// Its reverse to the control alone: what N and S ask for.
    pub vjp_control: Counts,
}

impl Cost {
    /// Counts the operations of a system.
    pub fn of<S: System>(system: &S) -> Self {
        let (n, m) = (system.state_dim(), system.control_dim());
        // Numbers of ordinary size; which ones does not matter.
        let numbers = |len: usize| (0..len).map(|i| Counted(0.1 + 0.01 * i as f64)).collect::<Vec<_>>();
        let (x, u, next_bar) = (numbers(n), numbers(m), numbers(n));
        let (mut next, mut x_bar, mut u_bar) = (numbers(n), numbers(n), numbers(m));
        Self {
            step: Counts::of(|| system.step(&x, &u, &mut next)).0,
            vjp: Counts::of(|| system.vjp(&x, &u, &next_bar, &mut x_bar, &mut u_bar)).0,
            vjp_control: Counts::of(|| system.vjp_control(&x, &u, &next_bar, &mut u_bar)).0,
        }
    }
}
