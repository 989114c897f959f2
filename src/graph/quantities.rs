//! [`Quantities`]: numbers that a task computes from a state, with names for expressions.

use super::record::Recorded;
use crate::numbers::scalar::Scalar;

/// Numbers that a task computes from a state and the parameters of a sample, for example the
/// position of a body. Expressions know them by name; `next.NAME` is that of the next state.
///
/// The code is recorded once, so it must not branch on values.
pub trait Quantities {
    /// The names.
    fn names(&self) -> Vec<String>;
    /// The numbers, in the order of the names.
    fn of<T: Scalar>(&self, x: &[T], p: &[T]) -> Vec<T>;
}

/// No quantities.
impl Quantities for () {
    fn names(&self) -> Vec<String> {
        Vec::new()
    }

    fn of<T: Scalar>(&self, _x: &[T], _p: &[T]) -> Vec<T> {
        Vec::new()
    }
}

/// Object-safe [`Quantities`].
pub(super) trait RecordedQuantities {
    fn all_names(&self) -> Vec<String>;
    fn record(&self, x: &[Recorded], p: &[Recorded]) -> Vec<Recorded>;
}

impl<Q: Quantities> RecordedQuantities for Q {
    fn all_names(&self) -> Vec<String> {
        self.names()
    }

    fn record(&self, x: &[Recorded], p: &[Recorded]) -> Vec<Recorded> {
        self.of(x, p)
    }
}
