//! [`Activation`]: functions of hidden layers.

use crate::numbers::kernels::elementwise::Strided;
use crate::numbers::kernels::{SimdLevel, Vectorized, dispatch};
use crate::numbers::scalar::{Float, Scalar};
use serde::{Deserialize, Serialize};

/// Activation of the hidden layers of an [`Mlp`](super::Mlp).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// `tanh z`, the activation of the source paper (ICLR 2024).
    #[default]
    Tanh,
    /// `max(z, 0)`. The derivative at 0 is 0.
    Relu,
    /// `z σ(z)` with the logistic function σ (Hendrycks and Gimpel 2016, arXiv:1606.08415).
    Silu,
    /// `z/2 (1 + tanh(√(2/π) (z + 0.044715 z³)))`: an approximation to the Gaussian error linear
    /// unit (arXiv:1606.08415).
    Gelu,
}

/// Bound on |z| in the tanh of [`Activation::Gelu`]. Beyond it, the tanh is ±1 in f64, and z² and
/// z³ may overflow.
const GELU_SATURATED: f64 = 100.0;

impl Activation {
    /// `√(2/π)` and the coefficient of z³ in [`Activation::Gelu`].
    pub const GELU: (f64, f64) = (0.797_884_560_802_865_4, 0.044_715);

    /// Value at `z`.
    #[inline(always)]
    pub(crate) fn value<T: Scalar>(self, z: T) -> T {
        match self {
            Self::Tanh => z.tanh(),
            // For NaN, `select_lt` returns its last argument; `max` alone would return 0.
            Self::Relu => T::select_lt(z, T::from(f64::INFINITY), z.max(0.0), z),
            Self::Silu => z * ((z * 0.5).tanh() * 0.5 + 0.5),
            Self::Gelu => {
                let inner = z.clamp(-GELU_SATURATED, GELU_SATURATED);
                z * 0.5
                    * (((inner + inner * inner * inner * Self::GELU.1) * Self::GELU.0).tanh() + 1.0)
            }
        }
    }

    /// Value and derivative at `z`, with the vectorized tanh of layers.
    #[inline(always)]
    pub(crate) fn with_slope<F: Float, const FMA: bool>(self, z: F) -> (F, F) {
        let (half, one) = (F::from_f64(0.5), F::one());
        match self {
            Self::Tanh => {
                let h = z.layer_tanh::<FMA>();
                (h, one - h * h)
            }
            // NaN propagates, since `NaN <= 0` is false.
            Self::Relu => (
                if z <= F::zero() { F::zero() } else { z },
                if z <= F::zero() { F::zero() } else { one },
            ),
            Self::Silu => {
                let sigma = (z * half).layer_tanh::<FMA>() * half + half;
                let h = z * sigma;
                (h, sigma + h * (one - sigma))
            }
            Self::Gelu => {
                let (c, cube, end) = (
                    F::from_f64(Self::GELU.0),
                    F::from_f64(Self::GELU.1),
                    F::from_f64(GELU_SATURATED),
                );
                // NaN propagates, since comparisons with NaN are false.
                let x = if z < -end { -end } else { z };
                let x = if x > end { end } else { x };
                let t = ((x + x * x * x * cube) * c).layer_tanh::<FMA>();
                let inner = c * (one + F::from_f64(3.0) * cube * x * x);
                (z * half * (t + one), half * (t + one) + half * x * (one - t * t) * inner)
            }
        }
    }
}

/// `(values, slopes) ← (f(values), f'(values))` elementwise, in the given columns of both slices.
pub(super) fn activate<F: Float>(
    level: SimdLevel,
    f: Activation,
    values: &mut [F],
    slopes: &mut [F],
    columns: Strided,
) {
    struct Work<'a, F>(Activation, &'a mut [F], &'a mut [F], Strided);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            for start in self.3.starts() {
                let (values, slopes) =
                    (&mut self.1[start..][..self.3.len], &mut self.2[start..][..self.3.len]);
                for i in 0..values.len() {
                    (values[i], slopes[i]) = self.0.with_slope::<F, FMA>(values[i]);
                }
            }
        }
    }
    dispatch(level, Work(f, values, slopes, columns));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numbers::scalar::Dual;

    const ALL: [Activation; 4] =
        [Activation::Tanh, Activation::Relu, Activation::Silu, Activation::Gelu];

    #[test]
    fn values_and_slopes_of_layers_are_those_of_single_units() {
        for f in ALL {
            for z in [-1e200, -150.0, -100.0, -3.0, -0.5, -0.0, 0.0, 0.5, 3.0, 100.0, 150.0, 1e200]
            {
                let unit = f.value(Dual::<f64, 1>::variable(z, 0));
                for (value, slope) in [f.with_slope::<f64, true>(z), f.with_slope::<f64, false>(z)]
                {
                    let near = |found: f64, expected: f64| {
                        (found - expected).abs() <= 1e-14 * expected.abs().max(1.0)
                    };
                    assert!(
                        near(value, unit.value) && near(value, f.value(z)),
                        "{f:?} of {z}: {value}, {unit:?}"
                    );
                    assert!(
                        near(slope, unit.tangents[0]),
                        "slope of {f:?} at {z}: {slope}, {unit:?}"
                    );
                }
                let (value, slope) =
                    f.with_slope::<f32, true>((z as f32).clamp(f32::MIN, f32::MAX));
                assert!(
                    value.is_finite() && slope.is_finite(),
                    "{f:?} of {z} in f32: {value}, {slope}"
                );
            }
        }
    }

    #[test]
    fn nan_stays_nan_on_every_path() {
        for f in ALL {
            let unit = f.value(Dual::<f64, 1>::variable(f64::NAN, 0));
            assert!(f.value(f64::NAN).is_nan() && unit.value.is_nan(), "{f:?}: {unit:?}");
            assert!(
                f.with_slope::<f64, true>(f64::NAN).0.is_nan()
                    && f.with_slope::<f64, false>(f64::NAN).0.is_nan(),
                "{f:?}"
            );
            assert!(
                f.with_slope::<f32, true>(f32::NAN).0.is_nan()
                    && f.with_slope::<f32, false>(f32::NAN).0.is_nan(),
                "{f:?}"
            );
        }
    }
}
