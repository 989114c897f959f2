//! [`Recorded`]: a [`Scalar`] that appends its operations to a graph of the current thread.

use super::op::{Graph, Id, Op};
use crate::numbers::scalar::Scalar;
use std::cell::RefCell;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

thread_local! {
    static ACTIVE: RefCell<Recording> = RefCell::default();
}

#[derive(Default)]
struct Recording {
    graph: Graph,
    /// Whether the code asked for a comparison of values, which are unknown.
    branches: bool,
}

/// A number of the graph that the current thread records.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Recorded(pub(super) Id);

/// The recorded code branches on values.
#[derive(Debug)]
pub(super) struct Branches;

/// Appends the operations of `work` to the graph. `work` receives the inputs of the graph.
pub(super) fn record<Out>(
    graph: &mut Graph,
    work: impl FnOnce(&[Recorded]) -> Out,
) -> Result<Out, Branches> {
    let inputs: Vec<Recorded> = (0..graph.inputs() as Id).map(Recorded).collect();
    let outer = ACTIVE.replace(Recording { graph: std::mem::take(graph), branches: false });
    let out = work(&inputs);
    let recording = ACTIVE.replace(outer);
    *graph = recording.graph;
    if recording.branches { Err(Branches) } else { Ok(out) }
}

fn push(op: Op) -> Recorded {
    Recorded(ACTIVE.with_borrow_mut(|recording| recording.graph.add(op)))
}

impl From<f64> for Recorded {
    fn from(value: f64) -> Self {
        Self(ACTIVE.with_borrow_mut(|recording| recording.graph.constant(value)))
    }
}

macro_rules! operators {
    ($($trait:ident $method:ident $assign_trait:ident $assign:ident),+) => {$(
        impl $trait for Recorded {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                push(Op::$trait(self.0, other.0))
            }
        }
        impl $trait<f64> for Recorded {
            type Output = Self;
            fn $method(self, other: f64) -> Self {
                self.$method(Self::from(other))
            }
        }
        impl $assign_trait for Recorded {
            fn $assign(&mut self, other: Self) {
                *self = self.$method(other);
            }
        }
        impl $assign_trait<f64> for Recorded {
            fn $assign(&mut self, other: f64) {
                *self = self.$method(other);
            }
        }
    )+};
}
operators!(Add add AddAssign add_assign, Sub sub SubAssign sub_assign);
operators!(Mul mul MulAssign mul_assign, Div div DivAssign div_assign);

impl Neg for Recorded {
    type Output = Self;
    fn neg(self) -> Self {
        push(Op::Neg(self.0))
    }
}

impl Sum for Recorded {
    /// Starts at -0.0, as the sums of all scalars do.
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Self::from(-0.0), |sum, value| sum + value)
    }
}

impl Scalar for Recorded {
    type Real = f64;

    fn detach(self) -> Self {
        push(Op::Detach(self.0))
    }
    fn sqrt(self) -> Self {
        push(Op::Sqrt(self.0))
    }
    fn exp(self) -> Self {
        push(Op::Exp(self.0))
    }
    fn ln(self) -> Self {
        push(Op::Ln(self.0))
    }
    fn sin_cos(self) -> (Self, Self) {
        (self.sin(), self.cos())
    }
    fn sin(self) -> Self {
        push(Op::Sin(self.0))
    }
    fn cos(self) -> Self {
        push(Op::Cos(self.0))
    }
    fn tanh(self) -> Self {
        push(Op::Tanh(self.0))
    }
    fn atan2(self, x: Self) -> Self {
        push(Op::Atan2(self.0, x.0))
    }
    fn asin(self) -> Self {
        push(Op::Asin(self.0))
    }
    fn acos(self) -> Self {
        push(Op::Acos(self.0))
    }
    fn hypot(self, other: Self) -> Self {
        push(Op::Hypot(self.0, other.0))
    }
    fn powf(self, exponent: f64) -> Self {
        push(Op::Powf(self.0, Self::from(exponent).0))
    }
    fn abs(self) -> Self {
        push(Op::Abs(self.0))
    }
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        push(Op::Select(a.0, b.0, yes.0, no.0))
    }
    fn any_lt(_: Self, _: Self) -> bool {
        ACTIVE.with_borrow_mut(|recording| recording.branches = true);
        false
    }
}
