//! [`Counted`]: an `f64` that counts its operations.

use super::{Real, Scalar};
use crate::numbers::tape::{Place, Tape, content};
use std::cell::{Cell, RefCell};
use std::fmt;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// Number of operations of each kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ops {
    /// Additions and subtractions.
    pub add: u64,
    /// Negations.
    pub negate: u64,
    /// Multiplications. [`powi`](Scalar::powi) counts the absolute value of its exponent, and one
    /// division if the exponent is negative.
    pub multiply: u64,
    /// Divisions.
    pub divide: u64,
    /// Square roots.
    pub sqrt: u64,
    /// `exp`, `ln`, `powf`, `tanh`, `atan2`, `sin`, `cos` and `sin_cos`, one each.
    pub transcendental: u64,
    /// Comparisons by [`select_lt`](Scalar::select_lt), [`any_lt`](Scalar::any_lt),
    /// [`min`](Scalar::min), [`max`](Scalar::max) and [`abs`](Scalar::abs), and two by
    /// [`clamp`](Scalar::clamp). `abs` also counts one negation.
    pub compare: u64,
}

thread_local! {
    static DONE: Cell<Ops> = const { Cell::new(Ops::NONE) };
}

impl Ops {
    const NONE: Self =
        Self { add: 0, negate: 0, multiply: 0, divide: 0, sqrt: 0, transcendental: 0, compare: 0 };

    /// Runs `work`; returns its operations on [`Counted`] numbers and its result.
    ///
    /// Counts only the operations of the current thread. Calls may be nested; the outer counts
    /// include the inner ones.
    pub fn of<T>(work: impl FnOnce() -> T) -> (Self, T) {
        let before = DONE.get();
        let result = work();
        (DONE.get() - before, result)
    }

    /// Total number of operations.
    pub fn total(&self) -> u64 {
        self.each().iter().map(|(count, _)| count).sum()
    }

    fn each(&self) -> [(u64, &'static str); 7] {
        [
            (self.add, "add"),
            (self.negate, "negate"),
            (self.multiply, "multiply"),
            (self.divide, "divide"),
            (self.sqrt, "sqrt"),
            (self.transcendental, "transcendental"),
            (self.compare, "compare"),
        ]
    }

    fn map2(self, other: Self, f: impl Fn(u64, u64) -> u64) -> Self {
        Self {
            add: f(self.add, other.add),
            negate: f(self.negate, other.negate),
            multiply: f(self.multiply, other.multiply),
            divide: f(self.divide, other.divide),
            sqrt: f(self.sqrt, other.sqrt),
            transcendental: f(self.transcendental, other.transcendental),
            compare: f(self.compare, other.compare),
        }
    }

    /// Adds to the counter of the current thread.
    fn note(self) {
        DONE.set(DONE.get() + self);
    }
}

impl Add for Ops {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.map2(other, |a, b| a + b)
    }
}

impl Sub for Ops {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.map2(other, |a, b| a - b)
    }
}

impl AddAssign for Ops {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// Lists the nonzero counts, for instance `3 add, 2 multiply`. Writes `nothing` if all are 0.
impl fmt::Display for Ops {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let some = self.each().into_iter().filter(|&(count, _)| count > 0);
        let words: Vec<String> = some.map(|(count, kind)| format!("{count} {kind}")).collect();
        if words.is_empty() { f.write_str("nothing") } else { f.write_str(&words.join(", ")) }
    }
}

/// An `f64` that counts its operations: a machine-independent measure of a step or a derivative.
///
/// Values are bit-identical to `f64`. [`Ops`] defines the kinds of operations; [`Ops::of`] counts
/// them. The counts exclude constants (`from`), copies, [`detach`](Scalar::detach) and arithmetic
/// between plain `f64` numbers.
///
/// For default VJPs in forward mode, the counts include the operations on the value and on all four
/// tangents of each dual number. In reverse mode, they include the operations on the value, on the
/// slopes and on the cotangents.
///
/// ```
/// use physgrad::{Scalar, count::{Counted, Ops}};
///
/// let (counts, y) = Ops::of(|| Counted(2.0) * Counted(3.0) + Counted(0.5).sqrt());
/// assert_eq!(y, Counted(6.0 + 0.5_f64.sqrt()));
/// assert_eq!(counts.to_string(), "1 add, 1 multiply, 1 sqrt");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counted(pub f64);

// The operators are outlined: inlining slows compilation, and counts are not performance-critical.

macro_rules! operators {
    ($($trait:ident $method:ident $assign_trait:ident $assign:ident $kind:ident),+) => {$(
        impl $trait for Counted {
            type Output = Self;
            #[inline(never)]
            fn $method(self, other: Self) -> Self {
                Ops { $kind: 1, ..Ops::NONE }.note();
                Self(self.0.$method(other.0))
            }
        }
        impl $assign_trait for Counted {
            #[inline]
            fn $assign(&mut self, other: Self) {
                *self = self.$method(other);
            }
        }
        impl $trait<f64> for Counted {
            type Output = Self;
            #[inline]
            fn $method(self, other: f64) -> Self {
                self.$method(Self(other))
            }
        }
        impl $assign_trait<f64> for Counted {
            #[inline]
            fn $assign(&mut self, other: f64) {
                *self = self.$method(other);
            }
        }
    )+};
}
operators!(Add add AddAssign add_assign add, Sub sub SubAssign sub_assign add,
    Mul mul MulAssign mul_assign multiply, Div div DivAssign div_assign divide);

impl From<f64> for Counted {
    #[inline]
    fn from(value: f64) -> Self {
        Self(value)
    }
}

impl Sum for Counted {
    #[inline]
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Self(-0.0), |sum, value| sum + value)
    }
}

impl Neg for Counted {
    type Output = Self;
    #[inline(never)]
    fn neg(self) -> Self {
        Ops { negate: 1, ..Ops::NONE }.note();
        Self(-self.0)
    }
}

/// Count of one transcendental function.
const FUNCTION: Ops = Ops { transcendental: 1, ..Ops::NONE };

impl Scalar for Counted {
    type Real = f64;
    #[inline]
    fn detach(self) -> Self {
        self
    }
    #[inline(never)]
    fn sqrt(self) -> Self {
        Ops { sqrt: 1, ..Ops::NONE }.note();
        Self(Scalar::sqrt(self.0))
    }
    #[inline(never)]
    fn exp(self) -> Self {
        FUNCTION.note();
        Self(Scalar::exp(self.0))
    }
    #[inline(never)]
    fn ln(self) -> Self {
        FUNCTION.note();
        Self(Scalar::ln(self.0))
    }
    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        FUNCTION.note();
        let (sin, cos) = Scalar::sin_cos(self.0);
        (Self(sin), Self(cos))
    }
    #[inline(never)]
    fn tanh(self) -> Self {
        FUNCTION.note();
        Self(Scalar::tanh(self.0))
    }
    #[inline(never)]
    fn atan2(self, x: Self) -> Self {
        FUNCTION.note();
        Self(Scalar::atan2(self.0, x.0))
    }
    #[inline(never)]
    fn powf(self, exponent: f64) -> Self {
        FUNCTION.note();
        Self(Scalar::powf(self.0, exponent))
    }
    #[inline(never)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        Ops { compare: 1, ..Ops::NONE }.note();
        if a.0 < b.0 { yes } else { no }
    }
    #[inline(never)]
    fn abs(self) -> Self {
        Ops { compare: 1, negate: 1, ..Ops::NONE }.note();
        Self(self.0.abs())
    }
    #[inline(never)]
    fn any_lt(a: Self, b: Self) -> bool {
        Ops { compare: 1, ..Ops::NONE }.note();
        a.0 < b.0
    }
}

thread_local! {
    static TAPE: Place<RefCell<Tape<Counted>>> = const { Place::new(None) };
}

impl Real for Counted {
    const LANES: usize = 1;
    #[inline]
    fn lane(&self, _: usize) -> f64 {
        self.0
    }
    #[inline]
    fn set_lane(&mut self, _: usize, value: f64) {
        self.0 = value;
    }
    #[inline]
    fn tape() -> &'static RefCell<Tape<Self>> {
        content(&TAPE)
    }
}
