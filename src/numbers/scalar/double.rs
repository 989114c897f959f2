//! `f64` as a [`Scalar`].

use super::{Float, Real, Scalar};
use crate::numbers::tape::{Place, Tape, content};
use std::cell::RefCell;

impl Scalar for f64 {
    type Real = Self;
    #[inline(always)]
    fn detach(self) -> Self {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn exp(self) -> Self {
        f64::exp(self)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        f64::ln(self)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        Float::sin_cos(self)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        Float::tanh(self)
    }
    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        f64::atan2(self, x)
    }
    #[inline(always)]
    fn powf(self, exponent: f64) -> Self {
        f64::powf(self, exponent)
    }
    #[inline(always)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        if a < b { yes } else { no }
    }
    #[inline(always)]
    fn any_lt(a: Self, b: Self) -> bool {
        a < b
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
}

thread_local! {
    static TAPE: Place<RefCell<Tape<f64>>> = const { Place::new(None) };
}

impl Real for f64 {
    const LANES: usize = 1;
    #[inline(always)]
    fn lane(&self, _: usize) -> Self {
        *self
    }
    #[inline(always)]
    fn set_lane(&mut self, _: usize, value: Self) {
        *self = value;
    }
    #[inline(always)]
    fn tape() -> &'static RefCell<Tape<Self>> {
        content(&TAPE)
    }
}
