//! [`Decay`]: the learning rate as a function of the update number.

use crate::numbers::scalar::Float;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Decay of the learning rate: a factor that falls from 1 to `end` between the warm-up and the end
/// of a training, or remains 1.
///
/// In the formulas, s is the completed fraction of the updates that follow the warm-up; see
/// [`factor`](Decay::factor).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Decay {
    /// The factor is 1.
    Constant,
    /// Half a period of a cosine: `end + (1 - end) (1 + cos π s) / 2`.
    Cosine {
        /// Factor after the last update, 0 to 1.
        end: f64,
    },
    /// `end^s`.
    Exponential {
        /// Factor after the last update, positive and at most 1.
        end: f64,
    },
}

impl Decay {
    /// Factor of the learning rate in update number `update` of `total`. Both numbers include
    /// skipped updates. `update` counts from 0.
    ///
    /// The first `warm_up` updates have the factors `1 / (warm_up + 1)`, `2 / (warm_up + 1)`, and
    /// so on. Then `s = (update - warm_up) / (total - warm_up)`, at most 1.
    /// ```
    /// use physgrad::train::Decay;
    ///
    /// let decay = Decay::Cosine { end: 0.0 };
    /// assert_eq!([0, 1].map(|update| decay.factor(1, update, 5)), [0.5, 1.0]);
    /// assert!((decay.factor(1, 3, 5) - 0.5).abs() < 1e-15);
    /// ```
    pub fn factor(self, warm_up: usize, update: usize, total: usize) -> f64 {
        if update < warm_up {
            return (update as f64 + 1.0) / (warm_up as f64 + 1.0);
        }
        let s = ((update - warm_up) as f64 / total.saturating_sub(warm_up).max(1) as f64).min(1.0);
        match self {
            Self::Constant => 1.0,
            Self::Cosine { end } => 1.0 - (1.0 - end) * (0.5 - 0.5 * Float::sin_cos(PI * s).1),
            Self::Exponential { end } => end.powf(s),
        }
    }

    /// Describes an invalid `end` and the allowed values. `None` for a valid decay.
    pub(super) fn problem(self) -> Option<String> {
        match self {
            Self::Cosine { end } if !(0.0..=1.0).contains(&end) => {
                Some(format!("ends at {end}; allowed: 0 to 1"))
            }
            Self::Exponential { end } if !(end > 0.0 && end <= 1.0) => {
                Some(format!("ends at {end}; allowed: a positive number up to 1"))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Decay;

    /// Values of the formulas at quarters of the decay, by hand: cos 45° = √½, and fourth roots of
    /// 1/16.
    #[test]
    fn factors_at_quarters_of_the_decay_equal_the_formulas() {
        let factors = |decay: Decay| [0, 4, 8, 12, 16].map(|update| decay.factor(0, update, 16));
        let root = 0.5f64.sqrt();
        for (decay, expected) in [
            (Decay::Constant, [1.0; 5]),
            (Decay::Cosine { end: 0.0 }, [1.0, 0.5 + 0.5 * root, 0.5, 0.5 - 0.5 * root, 0.0]),
            (Decay::Cosine { end: 0.2 }, [1.0, 0.6 + 0.4 * root, 0.6, 0.6 - 0.4 * root, 0.2]),
            (Decay::Exponential { end: 0.0625 }, [1.0, 0.5, 0.25, 0.125, 0.0625]),
        ] {
            for (found, expected) in factors(decay).into_iter().zip(expected) {
                // Allows for a few roundings of numbers up to 1.
                assert!(
                    (found - expected).abs() < 1e-15,
                    "{decay:?}: {found} instead of {expected}"
                );
            }
            assert_eq!(
                decay.factor(0, 99, 16),
                decay.factor(0, 16, 16),
                "{decay:?}: the factor changes after the end"
            );
        }
    }

    #[test]
    fn three_warm_up_updates_have_factors_of_1_2_and_3_quarters_before_the_decay() {
        for decay in [Decay::Constant, Decay::Cosine { end: 0.1 }, Decay::Exponential { end: 0.1 }]
        {
            assert_eq!(
                [0, 1, 2, 3].map(|update| decay.factor(3, update, 19)),
                [0.25, 0.5, 0.75, 1.0]
            );
            for update in 0..16 {
                assert_eq!(decay.factor(3, update + 3, 19), decay.factor(0, update, 16));
            }
            // The warm-up may be longer than the training.
            assert_eq!(decay.factor(9, 4, 5), 0.5);
        }
    }
}
