//! Numbers in messages and tables.

/// A number with four significant digits, for losses and other results.
pub fn short(x: f64) -> String {
    digits(x, 4)
}

/// A number with two significant digits, for errors and other magnitudes.
pub fn rough(x: f64) -> String {
    digits(x, 2)
}

/// The growth of a perturbation per step, with four decimals, so that 1.0002 differs from 1. From
/// 1000 on, it has four significant digits.
pub fn growth(x: f64) -> String {
    if x.abs() < 1e3 { format!("{x:.4}") } else { short(x) }
}

/// A number with `count` significant digits, rounded to nearest.
///
/// The rounded absolute value selects the format. Below 1e-3 and from 1e5 on, the number has an
/// exponent. In between, the integer part keeps all its digits. 0 is `0`, and non-finite numbers
/// are `NaN`, `inf` and `-inf`.
pub fn digits(x: f64, count: usize) -> String {
    if x == 0.0 {
        return "0".into();
    }
    if !x.is_finite() {
        return x.to_string();
    }
    let scientific = format!("{x:.*e}", count - 1);
    // Reads the exponent after rounding: 0.00099996 becomes 0.001000.
    let exponent =
        scientific.split_once('e').and_then(|(_, exponent)| exponent.parse::<i32>().ok());
    match exponent {
        Some(exponent) if (-3..5).contains(&exponent) => {
            format!("{x:.*}", usize::try_from(count as i32 - 1 - exponent).unwrap_or(0))
        }
        _ => scientific,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_plain_from_1e_minus_3_to_1e5_and_scientific_elsewhere() {
        let plain = [0.001, 0.5322, 1.507, -12.34, 99_949.0].map(short);
        assert_eq!(plain, ["0.001000", "0.5322", "1.507", "-12.34", "99949"]);
        assert_eq!(
            [0.000_999_4, 1e5, -3e-7, 1.5e14].map(short),
            ["9.994e-4", "1.000e5", "-3.000e-7", "1.500e14"]
        );
        assert_eq!([0.0054, 0.0996, 999.6].map(rough), ["0.0054", "0.10", "1000"]);
    }

    #[test]
    fn rounding_to_the_next_decade_keeps_the_number_of_digits() {
        assert_eq!(
            [0.000_999_96, 0.099_999, 9.9999, 99_999.6].map(short),
            ["0.001000", "0.1000", "10.00", "1.000e5"]
        );
    }

    #[test]
    fn growths_have_four_decimals_or_four_digits() {
        assert_eq!(
            [1.0002, -12.5, 4321.0, -7e200, f64::NAN].map(growth),
            ["1.0002", "-12.5000", "4321", "-7.000e200", "NaN"]
        );
    }

    #[test]
    fn zero_and_non_finite_numbers_have_no_digits() {
        assert_eq!(
            [0.0, -0.0, f64::NAN, f64::INFINITY, -f64::INFINITY].map(short),
            ["0", "0", "NaN", "inf", "-inf"]
        );
    }
}
