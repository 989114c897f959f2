//! [`Activation`]: functions of hidden layers.

use crate::numbers::kernels::elementwise::Strided;
use crate::numbers::kernels::{SimdLevel, Vectorized, dispatch};
use crate::numbers::scalar::{Float, Scalar};
use serde::Serialize;

/// Activation of the hidden layers of an [`Mlp`](super::Mlp).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// `tanh z`, as in the paper.
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

impl Activation {
    /// `√(2/π)` and the coefficient of z³ in [`Activation::Gelu`].
    pub(crate) const GELU: (f64, f64) = (0.797_884_560_802_865_4, 0.044_715);

    /// Value at `z`.
    #[inline(always)]
    pub(crate) fn value<T: Scalar>(self, z: T) -> T {
        match self {
            Self::Tanh => z.tanh(),
            Self::Relu => z.max(0.0),
            Self::Silu => z * ((z * 0.5).tanh() * 0.5 + 0.5),
            Self::Gelu => z * 0.5 * (((z + z * z * z * Self::GELU.1) * Self::GELU.0).tanh() + 1.0),
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
            Self::Relu => (if z <= F::zero() { F::zero() } else { z }, if z <= F::zero() { F::zero() } else { one }),
            Self::Silu => {
                let sigma = (z * half).layer_tanh::<FMA>() * half + half;
                let h = z * sigma;
                (h, sigma + h * (one - sigma))
            }
            Self::Gelu => {
                let (c, cube) = (F::from_f64(Self::GELU.0), F::from_f64(Self::GELU.1));
                let t = ((z + z * z * z * cube) * c).layer_tanh::<FMA>();
                let inner = c * (one + F::from_f64(3.0) * cube * z * z);
                (z * half * (t + one), half * (t + one) + half * z * (one - t * t) * inner)
            }
        }
    }
}

/// `(v, slopes) ← (f(v), f'(v))` elementwise in the given columns of `values` and `slopes`.
pub(super) fn activate<F: Float>(level: SimdLevel, f: Activation, values: &mut [F], slopes: &mut [F], columns: Strided) {
    struct Work<'a, F>(Activation, &'a mut [F], &'a mut [F], Strided);
    impl<F: Float> Vectorized for Work<'_, F> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            for start in self.3.starts() {
                let (values, slopes) = (&mut self.1[start..][..self.3.len], &mut self.2[start..][..self.3.len]);
                for i in 0..values.len() {
                    (values[i], slopes[i]) = self.0.with_slope::<F, FMA>(values[i]);
                }
            }
        }
    }
    dispatch(level, Work(f, values, slopes, columns));
}
