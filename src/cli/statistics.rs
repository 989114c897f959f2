//! What is said of several numbers.

/// The quantile `q` (0 to 1) of numbers in increasing order, by straight lines between them (Hyndman and Fan's type 7).
/// A NaN, which stands for a run that broke off, is worse than any number, as `total_cmp` sorts it.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let at = q * (sorted.len() - 1) as f64;
    let (below, above) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    if at.fract() == 0.0 { below } else { below + at.fract() * (above - below) }
}

/// The numbers in increasing order; NaN, whatever its sign, comes last.
pub fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.map(|x| if x.is_nan() { f64::NAN } else { x }).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The mean of each number and up to `window - 1` before it.
pub fn trailing_mean(values: &[f64], window: usize) -> Vec<f64> {
    let mean = |end: usize| {
        let window = &values[(end + 1).saturating_sub(window)..=end];
        window.iter().sum::<f64>() / window.len() as f64
    };
    (0..values.len()).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_on_straight_lines_between_the_numbers() {
        let numbers = sorted([4.0, 1.0, 2.0].into_iter());
        assert_eq!([0.0, 0.25, 0.5, 0.75, 1.0].map(|q| quantile(&numbers, q)), [1.0, 1.5, 2.0, 3.0, 4.0]);
        assert_eq!(quantile(&[7.0], 0.75), 7.0);
        assert_eq!(quantile(&sorted([1.0, 2.0].into_iter()), 0.5), 1.5);
    }

    #[test]
    fn what_is_not_a_number_counts_as_the_worst() {
        let numbers = sorted([-f64::NAN, 1.0, 2.0].into_iter());
        assert_eq!(quantile(&numbers, 0.5), 2.0);
        assert!(quantile(&numbers, 0.75).is_nan());
    }

    #[test]
    fn a_trailing_mean_looks_back_only() {
        assert_eq!(trailing_mean(&[1.0, 3.0, 5.0, 7.0], 2), [1.0, 2.0, 4.0, 6.0]);
        assert_eq!(trailing_mean(&[1.0, 3.0], 30), [1.0, 2.0]);
    }
}
