//! [`Float`]: the floating-point types `f32` and `f64`, with their constants and kernels.

use crate::numbers::kernels::gemm::{self, Product};
use crate::numbers::kernels::{SimdLevel, tanh, trig};
use crate::numbers::tape::{Place, Tapes, content};
use num_traits::AsPrimitive;
use serde::{Serialize, de::DeserializeOwned};
use std::fmt::{Debug, Display};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A floating-point type: `f32` or `f64`.
pub trait Float:
    Copy
    + Debug
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
    + AsPrimitive<f64>
    + PartialOrd
    + Display
    + Default
    + Serialize
    + DeserializeOwned
{
    /// Name in settings and files: `f32` or `f64`.
    const NAME: &'static str;
    /// Machine epsilon: the distance from 1 to the next larger number.
    const EPSILON: f64;
    /// Largest finite number.
    const MAX: f64;

    /// Rounds a number to this type.
    fn from_f64(value: f64) -> Self;
    /// Converts to `f64`, exactly.
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self.as_()
    }
    /// The constant 0.
    fn zero() -> Self;
    /// The constant 1.
    fn one() -> Self;
    #[doc(hidden)]
    fn abs(self) -> Self;
    #[doc(hidden)]
    fn sqrt(self) -> Self;
    #[doc(hidden)]
    fn exp(self) -> Self;
    #[doc(hidden)]
    fn ln(self) -> Self;
    #[doc(hidden)]
    fn sin_cos(self) -> (Self, Self);
    #[doc(hidden)]
    fn tanh(self) -> Self;
    #[doc(hidden)]
    fn atan2(self, x: Self) -> Self;
    #[doc(hidden)]
    fn powf(self, exponent: f64) -> Self;

    /// Entries per cache line.
    #[doc(hidden)]
    const PAD: usize;
    /// Entries per register. Row counts of matrix products are multiples of it.
    #[doc(hidden)]
    fn lanes(level: SimdLevel) -> usize;
    /// Matrix product with the instruction set `level`.
    #[doc(hidden)]
    fn product(level: SimdLevel, product: Product<'_, Self>);
    /// `a·b + c`, fused if `FMA`. Set `FMA` if the instruction set has fused multiply-add.
    #[doc(hidden)]
    fn plus_product<const FMA: bool>(c: Self, a: Self, b: Self) -> Self;
    /// Branch-free tanh for policy layers.
    #[doc(hidden)]
    fn layer_tanh<const FMA: bool>(self) -> Self;
    /// Branch-free sine and cosine for |x| ≤ 1e6.
    #[doc(hidden)]
    fn sin_cos_near(self) -> (Self, Self);
    #[doc(hidden)]
    fn to_le_bytes(self) -> impl AsRef<[u8]>;
    #[doc(hidden)]
    fn from_le_bytes(bytes: &[u8]) -> Self;
    /// Tapes of the current thread for lanes of this type.
    #[doc(hidden)]
    fn tapes() -> &'static Tapes<Self>;
}

macro_rules! float {
    ($float:ident, $gemm:ident, $sin_cos:ident, $tanh:ident) => {
        impl Float for $float {
            const NAME: &'static str = stringify!($float);
            const EPSILON: f64 = $float::EPSILON as f64;
            const MAX: f64 = $float::MAX as f64;

            const PAD: usize = gemm::$gemm::PAD;

            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as $float
            }
            #[inline(always)]
            fn zero() -> Self {
                0.0
            }
            #[inline(always)]
            fn one() -> Self {
                1.0
            }
            #[inline(always)]
            fn abs(self) -> Self {
                $float::abs(self)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $float::sqrt(self)
            }
            #[inline(always)]
            fn exp(self) -> Self {
                $float::exp(self)
            }
            #[inline(always)]
            fn ln(self) -> Self {
                $float::ln(self)
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                if $float::abs(self) > trig::REACH as $float {
                    $float::sin_cos(self)
                } else {
                    trig::$sin_cos(self)
                }
            }
            #[inline(always)]
            fn tanh(self) -> Self {
                tanh::$tanh::<false>(self)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                $float::atan2(self, x)
            }
            #[inline(always)]
            fn powf(self, exponent: f64) -> Self {
                $float::powf(self, exponent as $float)
            }

            #[inline]
            fn product(level: SimdLevel, product: Product<'_, Self>) {
                gemm::$gemm::product(level, product);
            }

            #[inline]
            fn lanes(level: SimdLevel) -> usize {
                gemm::$gemm::lanes(level)
            }

            #[inline(always)]
            fn plus_product<const FMA: bool>(c: Self, a: Self, b: Self) -> Self {
                if FMA { a.mul_add(b, c) } else { a * b + c }
            }

            #[inline(always)]
            fn layer_tanh<const FMA: bool>(self) -> Self {
                tanh::$tanh::<FMA>(self)
            }

            #[inline(always)]
            fn sin_cos_near(self) -> (Self, Self) {
                trig::$sin_cos(self)
            }

            fn to_le_bytes(self) -> impl AsRef<[u8]> {
                $float::to_le_bytes(self)
            }

            fn from_le_bytes(bytes: &[u8]) -> Self {
                $float::from_le_bytes(bytes.try_into().expect("`bytes` has the width of the type"))
            }

            #[inline(always)]
            fn tapes() -> &'static Tapes<Self> {
                thread_local! {
                    static TAPES: Place<Tapes<$float>> = const { Place::new(None) };
                }
                content(&TAPES)
            }
        }
    };
}

float!(f32, single, sin_cos_32, tanh_32);
float!(f64, double, sin_cos_64, tanh_64);
