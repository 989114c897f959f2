//! [`Combination`]: rules that combine the gradients of two flows, usually M and R.
//!
//! R is the gradient of the loss. M omits the path of the adjoint through the observation.
//! [`Flow`](crate::Flow) defines both, and [`Field`](crate::Field) lists all fields.

use crate::engine::gradient::Gradient;
use crate::numbers::extended::times_power_of_two;
use crate::numbers::kernels::{SimdLevel, elementwise};
use crate::numbers::scalar::Float;
use crate::train::field::{GradientCombiner, common_exponent};

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
    ConflictFree,
    /// MR: the absolute values of m with the signs of r. 0 where `r_i` is 0.
    SignsOfSecond,
    /// RM: r with the norm of m: `r ‖m‖ / ‖r‖`.
    NormOfFirst,
}

impl Combination {
    /// All rules.
    pub const ALL: [Self; 5] = [
        Self::SignAgreement,
        Self::Projection,
        Self::ConflictFree,
        Self::SignsOfSecond,
        Self::NormOfFirst,
    ];

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
                let (_, first_square, second_square) =
                    elementwise::moments(SimdLevel::best(), first, second);
                weighted(
                    first,
                    second,
                    [0.0, ratio(first_square.sqrt(), second_square.sqrt())],
                    out,
                );
            }
            Self::ConflictFree => conflict_free(first, second, [0, 0], out),
        }
    }

    fn combine_gradients<F: Float>(
        &self,
        first: &Gradient<F>,
        second: &Gradient<F>,
        out: &mut Gradient<F>,
    ) {
        if *self != Self::ConflictFree {
            // The exponent of the second gradient has no effect.
            return self.combine(first.values(), second.values(), out.values_mut(first.exponent()));
        }
        let exponent = common_exponent(first, second);
        let relative = [first, second].map(|gradient| gradient.exponent() - exponent);
        conflict_free(first.values(), second.values(), relative, out.values_mut(exponent));
    }

    fn ignores_size_of_second(&self) -> bool {
        *self != Self::ConflictFree
    }
}

/// Writes the conflict-free combination of `m·2^e_m` and `r·2^e_r` into `out`. `exponents` is
/// `[e_m, e_r]`. The directions of m and r do not depend on the exponents.
fn conflict_free<F: Float>(first: &[F], second: &[F], exponents: [i32; 2], out: &mut [F]) {
    let (_, first_square, second_square) = elementwise::moments(SimdLevel::best(), first, second);
    let (m, r) = (first_square.sqrt(), second_square.sqrt());
    let mean = (times_power_of_two(m, exponents[0]) + times_power_of_two(r, exponents[1])) / 2.0;
    weighted(first, second, [ratio(mean, m), ratio(mean, r)], out);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conflict_free_keeps_the_direction_of_a_far_smaller_gradient() {
        let gradient = |values: [f32; 2], exponent| {
            let mut gradient = Gradient::zeros(2);
            gradient.values_mut(exponent).copy_from_slice(&values);
            gradient
        };
        let combined = |first, second| {
            let mut out = Gradient::zeros(2);
            Combination::ConflictFree.combine_gradients(&first, &second, &mut out);
            (out.values().to_vec(), out.exponent())
        };
        // (3, 4) has the direction (0.6, 0.8). Half of the norm of r is 2^299.
        assert_eq!(
            combined(gradient([3.0, 4.0], 0), gradient([1.0, 0.0], 300)),
            (vec![0.8, 0.4], 300)
        );
        // The exponent of a zero gradient has no meaning.
        assert_eq!(
            combined(gradient([3.0, 4.0], -400), gradient([0.0, 0.0], 0)),
            (vec![1.5, 2.0], -400)
        );
    }

    #[test]
    fn signs_without_sizes_are_no_update() {
        let mut gradient = Gradient::<f32>::zeros(3);
        gradient.values_mut(3000).copy_from_slice(&[0.0, f32::from_bits(1), -f32::from_bits(1)]);
        gradient.drop_signs();
        assert_eq!((gradient.values(), gradient.exponent()), (&[0.0; 3][..], 0));
    }
}
