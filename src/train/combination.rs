//! [`Combination`]: rules that combine the gradients of two flows, usually M and R.

use crate::numbers::kernels::{SimdLevel, elementwise};
use crate::numbers::scalar::Float;
use crate::train::field::GradientCombiner;

/// Rule that combines two gradients of the same mini-batch. In the formulas, m is the first
/// gradient and r the second. [`Field`](crate::Field) has one constructor per rule for M and R.
///
/// All rules but [`ConflictFree`](Self::ConflictFree) ignore the size of r, so r may be 10^1000
/// times as large as m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Combination {
    /// C: `m_i` where `m_i` and `r_i` have equal signs, else 0. Source: "Stabilizing
    /// Backpropagation Through Time to Learn Complex Physics", ICLR 2024.
    #[default]
    SignAgreement,
    /// P: m without its component along r, if that component opposes r: `m - min(0, m·r) r / ‖r‖²`.
    /// Source: the projection of PCGrad, arXiv:2001.06782, applied to m only.
    Projection,
    /// F: `(‖m‖ + ‖r‖) / 2 · (m / ‖m‖ + r / ‖r‖)`, a direction of equal angles to m and r. Source:
    /// ConFIG for two gradients, arXiv:2408.11104.
    ///
    /// A gradient that is 1e38 (f32) or 1e308 (f64) times smaller than the other one is lost.
    ConflictFree,
    /// MR: the absolute values of m with the signs of r. 0 where `r_i` is 0.
    SignsOfSecond,
    /// RM: r with the norm of m: `r ‖m‖ / ‖r‖`.
    NormOfFirst,
}

impl Combination {
    /// All rules.
    pub const ALL: [Self; 5] =
        [Self::SignAgreement, Self::Projection, Self::ConflictFree, Self::SignsOfSecond, Self::NormOfFirst];

    /// Letters of the field that combines M and R by this rule.
    pub const fn letter(self) -> &'static str {
        match self {
            Self::SignAgreement => "C",
            Self::Projection => "P",
            Self::ConflictFree => "F",
            Self::SignsOfSecond => "MR",
            Self::NormOfFirst => "RM",
        }
    }
}

impl GradientCombiner for Combination {
    fn name(&self) -> &str {
        match self {
            Self::SignAgreement => "combined",
            Self::Projection => "projected",
            Self::ConflictFree => "conflict_free",
            Self::SignsOfSecond => "modified_signed",
            Self::NormOfFirst => "regular_scaled",
        }
    }

    fn combine<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]) {
        match self {
            // `signum` would give 0 a sign.
            Self::SignAgreement => each(first, second, out, |m, r| {
                let zero = F::zero();
                if (m > zero && r > zero) || (m < zero && r < zero) { m } else { zero }
            }),
            Self::SignsOfSecond => each(first, second, out, |m, r| {
                let (zero, size) = (F::zero(), if m < F::zero() { -m } else { m });
                match (r > zero, r < zero) {
                    (true, _) => size,
                    (_, true) => -size,
                    _ => zero,
                }
            }),
            Self::Projection => {
                let (dot, _, square) = elementwise::moments(SimdLevel::best(), first, second);
                weighted(first, second, [1.0, -ratio(dot.min(0.0), square)], out);
            }
            Self::NormOfFirst => {
                let (_, first_square, second_square) = elementwise::moments(SimdLevel::best(), first, second);
                weighted(first, second, [0.0, ratio(first_square.sqrt(), second_square.sqrt())], out);
            }
            Self::ConflictFree => {
                let (_, first_square, second_square) = elementwise::moments(SimdLevel::best(), first, second);
                let (m, r) = (first_square.sqrt(), second_square.sqrt());
                let mean = (m + r) / 2.0;
                weighted(first, second, [ratio(mean, m), ratio(mean, r)], out);
            }
        }
    }

    fn ignores_size_of_second(&self) -> bool {
        *self != Self::ConflictFree
    }
}

/// Writes `f(m_i, r_i)` into `out`.
fn each<F: Float>(first: &[F], second: &[F], out: &mut [F], f: impl Fn(F, F) -> F) {
    for ((out, &m), &r) in out.iter_mut().zip(first).zip(second) {
        *out = f(m, r);
    }
}

/// Writes the linear combination with these weights into `out`.
fn weighted<F: Float>(first: &[F], second: &[F], weights: [f64; 2], out: &mut [F]) {
    let [a, b] = weights;
    each(first, second, out, |m, r| F::from_f64(a * m.as_() + b * r.as_()));
}

/// Quotient; 0 if the denominator is 0.
fn ratio(numerator: f64, denominator: f64) -> f64 {
    if denominator == 0.0 { 0.0 } else { numerator / denominator }
}
