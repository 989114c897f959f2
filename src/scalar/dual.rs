//! Forward mode: num-dual's numbers as [`Scalar`]s.
//!
//! Arithmetic is num-dual's. The elementary functions are chain rules over the plain number's own function, so that a
//! dual's value has that number's bits; num-dual's `tanh` would overflow (sinh/cosh), and its `sqrt` and `ln` would make
//! a NaN of the zero tangent of a constant 0.

use super::{Float, Scalar};
use nalgebra::{Const, SVector, U1};
use num_dual::{Derivative, Dual32, Dual64, DualSVec32, DualSVec64};

/// A dual number with `N` tangents, taken apart and put together.
pub trait Tangents<const N: usize>: Scalar {
    /// `value` with the given tangents.
    fn seeded(value: Self::Real, tangents: [Self::Real; N]) -> Self;
    /// A constant.
    fn constant(value: Self::Real) -> Self;
    /// The value.
    fn value(&self) -> Self::Real;
    /// The tangents; zeros for a constant.
    fn tangents(&self) -> [Self::Real; N];
    /// `value`, the `index`-th variable of `N`.
    fn variable(value: Self::Real, index: usize) -> Self {
        let mut tangents = [<Self::Real as Scalar>::zero(); N];
        tangents[index] = <Self::Real as Scalar>::one();
        Self::seeded(value, tangents)
    }
}

macro_rules! scalar_for_dual {
    ($float:ty, $dual:ty $(, $n:ident)?) => {
        impl $(<const $n: usize>)? Scalar for $dual {
            type Real = $float;
            #[inline]
            fn lift(value: f64) -> Self {
                Self::from_re(value as $float)
            }
            #[inline]
            fn detach(self) -> Self {
                Self::from_re(self.re)
            }
            #[inline]
            fn sqrt(self) -> Self {
                // A constant stays one: num-dual's rule would make 0·∞ = NaN of its tangent at 0.
                let root = Scalar::sqrt(self.re);
                self.chain(root, 0.5 / root)
            }
            #[inline]
            fn exp(self) -> Self {
                let e = Scalar::exp(self.re);
                self.chain(e, e)
            }
            #[inline]
            fn ln(self) -> Self {
                self.chain(Scalar::ln(self.re), 1.0 / self.re)
            }
            #[inline]
            fn sin_cos(self) -> (Self, Self) {
                let (sin, cos) = Scalar::sin_cos(self.re);
                (self.chain(sin, cos), self.chain(cos, -sin))
            }
            #[inline]
            fn tanh(self) -> Self {
                let t = Scalar::tanh(self.re);
                self.chain(t, 1.0 - t * t)
            }
            #[inline]
            fn atan2(self, x: Self) -> Self {
                let square = self.re * self.re + x.re * x.re;
                self.chain(Scalar::atan2(self.re, x.re), x.re / square) + x.chain(0.0, -self.re / square)
            }
            #[inline]
            fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
                if a.re < b.re { yes } else { no }
            }
            #[inline]
            fn any_lt(a: Self, b: Self) -> bool {
                a.re < b.re
            }
        }
    };
}

/// Chain rule with a known value and slope. A zero tangent stays zero even where the slope is infinite: a constant has
/// no derivative to blow up.
trait Chain<F> {
    fn chain(&self, value: F, slope: F) -> Self;
}

fn times<F: Float>(tangent: F, slope: F) -> F {
    let zero = <F as Scalar>::zero();
    if tangent == zero { zero } else { tangent * slope }
}

macro_rules! dual {
    ($float:ty, $dual:ident, $vector:ident) => {
        impl Chain<$float> for $dual {
            #[inline]
            fn chain(&self, value: $float, slope: $float) -> Self {
                Self::new(value, times(self.eps, slope))
            }
        }
        impl<const N: usize> Chain<$float> for $vector<N> {
            #[inline]
            fn chain(&self, value: $float, slope: $float) -> Self {
                Self::new(value, Derivative::new(self.eps.0.map(|eps| eps.map(|eps| times(eps, slope)))))
            }
        }
        scalar_for_dual!($float, $dual);
        scalar_for_dual!($float, $vector<N>, N);

        impl<const N: usize> Tangents<N> for $vector<N> {
            #[inline]
            fn seeded(value: $float, tangents: [$float; N]) -> Self {
                Self::new(value, Derivative::some(SVector::from(tangents)))
            }
            #[inline]
            fn constant(value: $float) -> Self {
                Self::from_re(value)
            }
            #[inline]
            fn value(&self) -> $float {
                self.re
            }
            #[inline]
            fn tangents(&self) -> [$float; N] {
                self.eps.unwrap_generic(Const::<N>, U1).into()
            }
        }
    };
}

dual!(f32, Dual32, DualSVec32);
dual!(f64, Dual64, DualSVec64);
