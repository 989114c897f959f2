//! Tangents of [`Dual`] agree with num-dual. Values have the bits of plain numbers, and lanes have
//! the bits of scalars.

use crate::common::operations::{NUMBERS, Operation, compositions, operations};
use num_dual::Dual64;
use physgrad::scalar::{Dual, Lanes, Single};
use physgrad::{Real, Scalar};

const TANGENTS: [[f64; 2]; 2] = [[0.5, -1.25], [-2.0, 0.75]];

/// All functions of a scalar.
fn functions<T: Scalar>() -> impl Iterator<Item = (&'static str, Operation<T>)> {
    operations().into_iter().chain(compositions())
}

fn bits(number: f64) -> u64 {
    if number.is_nan() { f64::NAN } else { number }.to_bits()
}

#[test]
fn values_have_the_bits_of_the_plain_number() {
    for ((name, plain), (_, dual)) in functions::<f64>().zip(functions()) {
        for (a, b) in NUMBERS.into_iter().flat_map(|a| NUMBERS.map(|b| (a, b))) {
            let [x, y] = [(a, TANGENTS[0]), (b, TANGENTS[1])]
                .map(|(value, tangents)| Dual { value, tangents });
            let found: Dual<f64, 2> = dual(x, y);
            assert_eq!(bits(found.value), bits(plain(a, b)), "{name} of {a} and {b}");
        }
    }
}

#[test]
fn tangents_agree_with_num_dual_to_1e_14() {
    let numbers = [0.3, 2.5, 1.0, 7e-3, 12.0];
    for ((name, ours), (_, theirs)) in functions().zip(functions()) {
        for (a, b) in numbers.into_iter().flat_map(|a| numbers.map(|b| (a, b))) {
            let found: Dual<f64, 2> = ours(
                Dual { value: a, tangents: TANGENTS[0] },
                Dual { value: b, tangents: TANGENTS[1] },
            );
            for (k, tangent) in found.tangents.into_iter().enumerate() {
                let slope =
                    theirs(Dual64::new(a, TANGENTS[0][k]), Dual64::new(b, TANGENTS[1][k])).eps;
                let error = (tangent - slope).abs();
                assert!(
                    error <= 1e-14 * (1.0 + slope.abs()),
                    "{name} of {a} and {b}, {k}: {tangent} for {slope}"
                );
            }
        }
    }
}

#[test]
fn derivatives_of_constants_stay_zero() {
    for value in [0.0, 1.0, -0.0] {
        for (name, operation) in functions::<Dual<f64, 2>>() {
            // Avoids division by zero, whose tangents are NaN.
            let divisor = if name.starts_with("div") { 1.0 } else { value };
            let found = operation(Dual::constant(value), Dual::constant(divisor));
            assert_eq!(found.tangents.map(f64::abs), [0.0; 2], "{name} of {value}");
        }
    }
    // For a variable at 0, the derivative of the square root is infinite.
    assert_eq!(Dual::<f64, 1>::variable(0.0, 0).sqrt().tangents, [f64::INFINITY]);
}

#[test]
fn a_saturated_sigmoid_has_derivative_zero() {
    let slope = |x: f32| {
        let sigmoid = |x: Dual<Single<f32>, 1>| Dual::from(1.0) / ((-x).exp() + 1.0);
        sigmoid(Dual { value: Lanes([x]), tangents: [Lanes([1.0])] }).tangents[0].lane(0)
    };
    // exp(100) overflows in f32.
    assert_eq!((slope(-100.0), slope(0.0)), (0.0, 0.25));
    assert!(slope(f32::NAN).is_nan());
}

#[test]
fn second_derivatives_at_stationary_arguments_are_exact() {
    type Second = Dual<Dual<f64, 1>, 1>;
    let second = |f: fn(Second) -> Second, x: f64| {
        f(Dual { value: Dual::variable(x, 0), tangents: [Dual::constant(1.0)] }).tangents[0]
            .tangents[0]
    };
    // At x = 0, the derivatives of the polynomials are 0, but their second derivatives are not. The
    // third function equals x.
    assert_eq!(second(|x| (x * x + 1.0).sqrt(), 0.0), 1.0);
    assert_eq!(second(|x| (x * x + 1.0).ln(), 0.0), 2.0);
    assert_eq!(second(|x| x.sin().atan2(x.cos()), 0.0), 0.0);
    assert_eq!(second(|x| (x * x).atan2(Dual::constant(Dual::constant(1.0))), 0.0), 2.0);
}

#[test]
fn every_lane_has_the_bits_of_a_scalar() {
    let firsts: [f32; 8] = [0.0, -0.5, 1.0, 3.25, -1e-3, 7e6, f32::INFINITY, 0.1];
    let seconds: [f32; 8] = [0.25, -0.5, -1.0, 0.0, 1e3, 2.0, 1.0, 0.1];
    let (first_slopes, second_slopes) = ([0.5, -1.25], [0.0, 0.75]);
    for ((name, all), (_, one)) in functions().zip(functions()) {
        let wide = |value, slopes: [f32; 2]| Dual {
            value: Lanes::<f32, 8>(value),
            tangents: slopes.map(Lanes::splat),
        };
        let found: Dual<Lanes<f32, 8>, 2> =
            all(wide(firsts, first_slopes), wide(seconds, second_slopes));
        for (lane, (a, b)) in firsts.into_iter().zip(seconds).enumerate() {
            let narrow = |value, tangents| Dual { value, tangents };
            let single = |value| Lanes([value]);
            let expected: Dual<Single<f32>, 2> = one(
                narrow(single(a), first_slopes.map(single)),
                narrow(single(b), second_slopes.map(single)),
            );
            let [first, second] = found.tangents;
            for (found, expected) in [
                (found.value, expected.value),
                (first, expected.tangents[0]),
                (second, expected.tangents[1]),
            ] {
                let (found, expected) = (found.lane(lane), expected.lane(0));
                assert!(
                    found.to_bits() == expected.to_bits() || found.is_nan() && expected.is_nan(),
                    "{name}, lane {lane}"
                );
            }
        }
    }
}

#[test]
fn functions_agree_with_the_standard_library() {
    // The bound is relative to the expected number, in units of ε.
    let near = |found: f64, expected: f64, bound: f64| {
        let error = (found - expected).abs() / f64::EPSILON;
        assert!(error <= bound * expected.abs(), "{found}, {expected}: {error}, {bound}");
    };
    let turns = 4.0 * std::f64::consts::PI;
    for x in [-0.97, -0.3, 0.0, 1e-9, 0.4, 0.999] {
        // `tan` divides sine by cosine. The relative errors of sine and cosine add.
        near(Scalar::tan(x), f64::tan(x), 3.0);
        near(Scalar::asin(x), f64::asin(x), 8.0);
        near(Scalar::acos(x), f64::acos(x), 8.0);
        // exp(y ln base) multiplies a relative error of its argument by y ln base.
        let base: f64 = x + 1.0;
        near(Scalar::powf(base, -2.3), base.powf(-2.3), 2.0 + 2.0 * (2.3 * base.ln()).abs());
        near(Scalar::powi(base, -3), base.powi(-3), 3.0);
        // The rounding errors of `turns` and of the sum are proportional to `turns`.
        let error = Scalar::wrap_angle(x + turns) - x;
        assert!(error.abs() <= f64::EPSILON * turns, "{x}: {error}");
        assert_eq!(Scalar::clamp(x, -0.2, 0.5), f64::clamp(x, -0.2, 0.5));
    }
    assert!(Scalar::clamp(f64::NAN, 0.0, 1.0).is_nan());
}
