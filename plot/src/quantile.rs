//! Quantiles of numbers.

/// Quantile `q` in [0, 1] of ascending numbers, by linear interpolation (Hyndman and Fan, type 7).
///
/// NaN stands for the loss of a failed run and ranks above every number, as [`sorted`] orders it.
/// Returns NaN for an empty list.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    if sorted.is_empty() {
        return f64::NAN;
    }
    let at = q * (sorted.len() - 1) as f64;
    let (below, above) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    // The difference of equal infinities is NaN.
    if at.fract() == 0.0 || below == above { below } else { below + at.fract() * (above - below) }
}

/// Sorts in ascending order. NaN of either sign comes last.
pub fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.map(|x| if x.is_nan() { f64::NAN } else { x }).collect();
    values.sort_by(f64::total_cmp);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_linearly() {
        let numbers = sorted([4.0, 1.0, 2.0].into_iter());
        assert_eq!(
            [0.0, 0.25, 0.5, 0.75, 1.0].map(|q| quantile(&numbers, q)),
            [1.0, 1.5, 2.0, 3.0, 4.0]
        );
        assert_eq!(quantile(&[1.0, f64::INFINITY, f64::INFINITY], 0.75), f64::INFINITY);
        assert_eq!(quantile(&[7.0], 0.75), 7.0);
        assert_eq!(quantile(&sorted([1.0, 2.0].into_iter()), 0.5), 1.5);
    }

    #[test]
    fn nan_of_either_sign_ranks_above_every_number() {
        let numbers = sorted([-f64::NAN, 1.0, 2.0].into_iter());
        assert_eq!(quantile(&numbers, 0.5), 2.0);
        assert!(quantile(&numbers, 0.75).is_nan());
    }
}
