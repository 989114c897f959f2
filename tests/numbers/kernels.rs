//! Kernels on all instruction sets of this processor. Compares matrix products of many shapes with
//! nalgebra, and sine, cosine and tanh with double-double.

use nalgebra::DMatrix;
use physgrad::engine::kernels::gemm::{self, Product};
use physgrad::engine::kernels::{SimdLevel, Vectorized, dispatch, elementwise, tanh, trig};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::scalar::{DoubleDouble, Lanes};
use physgrad::{Float, Scalar};
use rand::RngExt;

/// Shapes (rows, depth, columns): depth 1, fewer and more columns than a tile, several remainders.
/// Miri uses only the first five.
const SHAPES: [(usize, usize, usize); 12] = [
    (1, 1, 1),
    (5, 3, 2),
    (16, 16, 16),
    (17, 1, 9),
    (33, 7, 3),
    (48, 40, 8),
    (64, 13, 13),
    (65, 31, 7),
    (100, 101, 8),
    (101, 64, 101),
    (130, 37, 21),
    (10, 100, 4),
];

macro_rules! products {
    ($name:ident, $float:ty, $module:ident, $tolerance:expr) => {
        #[test]
        fn $name() {
            let mut rng = stream(0, Purpose::Check, 0);
            for (m, k, n) in SHAPES.into_iter().take(if cfg!(miri) { 5 } else { SHAPES.len() }) {
                let pad = gemm::$module::PAD;
                let ldc = m.next_multiple_of(pad);
                let (lda, ldb) = (ldc + pad, k + 3);
                let mut random = |len: usize| -> Vec<$float> {
                    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
                };
                let (a, b, start) = (random(lda * k), random(ldb * n), random(ldc * n));
                let a_matrix = DMatrix::from_fn(m, k, |i, p| a[i + p * lda]);
                let b_matrix = DMatrix::from_fn(k, n, |p, j| b[p + j * ldb]);
                // Row-major copy of B.
                let b_rows: Vec<$float> = (0..k)
                    .flat_map(|p| (0..n).map(move |j| (p, j)))
                    .map(|(p, j)| b[p + j * ldb])
                    .collect();
                for accumulate in [false, true] {
                    let mut first: Option<Vec<$float>> = None;
                    for level in SimdLevel::available() {
                        let rows = m.next_multiple_of(gemm::$module::lanes(level));
                        for (b, b_row, b_col) in [(&b, 1, ldb), (&b_rows, n, 1)] {
                            let mut c = start.clone();
                            let product = Product {
                                rows,
                                depth: k,
                                cols: n,
                                a: &a,
                                lda,
                                b,
                                b_row,
                                b_col,
                                c: &mut c,
                                ldc,
                                accumulate,
                            };
                            gemm::$module::product(level, product);
                            let expected = &a_matrix * &b_matrix;
                            for (i, j) in (0..n).flat_map(|j| (0..m).map(move |i| (i, j))) {
                                let base = if accumulate { start[i + j * ldc] } else { 0.0 };
                                let error = (c[i + j * ldc] - base - expected[(i, j)]).abs();
                                assert!(
                                    error <= $tolerance * (1.0 + k as $float),
                                    "{level:?} {m}x{k}x{n} [{i}, {j}]: {error:e}"
                                );
                            }
                            for (c, start) in c.chunks(ldc).zip(start.chunks(ldc)) {
                                assert_eq!(c[rows..], start[rows..], "{level:?} {m}x{k}x{n}");
                            }
                            if level != SimdLevel::Portable {
                                // All fused levels sum in the same order.
                                let c: Vec<$float> =
                                    c.chunks(ldc).flat_map(|c| c[..m].to_vec()).collect();
                                assert_eq!(
                                    *first.get_or_insert_with(|| c.clone()),
                                    c,
                                    "{level:?} {m}x{k}x{n}"
                                );
                            }
                        }
                    }
                }
            }
        }
    };
}
products!(single_products_agree_with_nalgebra, f32, single, f32::EPSILON);
products!(double_products_agree_with_nalgebra, f64, double, f64::EPSILON);

#[test]
fn columns_do_not_depend_on_how_many_are_computed_together() {
    let (rows, depth, cols) = (112, 101, 13);
    let mut rng = stream(1, Purpose::Check, 0);
    let mut random =
        |len: usize| -> Vec<f32> { (0..len).map(|_| rng.random_range(-1.0..1.0)).collect() };
    let (a, b) = (random(rows * depth), random(depth * cols));
    for level in SimdLevel::available() {
        let run = |b: &[f32], cols: usize| {
            let mut c = vec![0.0; rows * cols];
            let c_ref = &mut c;
            let product = Product {
                rows,
                depth,
                cols,
                a: &a,
                lda: rows,
                b,
                b_row: 1,
                b_col: depth,
                c: c_ref,
                ldc: rows,
                accumulate: false,
            };
            gemm::single::product(level, product);
            c
        };
        let together = run(&b, cols);
        for j in 0..cols {
            assert_eq!(
                run(&b[j * depth..(j + 1) * depth], 1),
                together[j * rows..(j + 1) * rows],
                "{level:?} column {j}"
            );
        }
    }
}

#[test]
#[should_panic(expected = "product: B")]
fn a_product_with_too_short_a_slice_is_refused() {
    let (a, b, mut c) = (vec![0.0f32; 32], vec![0.0; 1], vec![0.0; 16]);
    let product = Product {
        rows: 16,
        depth: 2,
        cols: 1,
        a: &a,
        lda: 16,
        b: &b,
        b_row: 1,
        b_col: 2,
        c: &mut c,
        ldc: 16,
        accumulate: false,
    };
    gemm::single::product(SimdLevel::Portable, product);
}

#[test]
#[should_panic(expected = "product: A")]
fn a_product_whose_size_overflows_is_refused() {
    let (a, b, mut c) = (vec![0.0f32; 64], vec![0.0; 64], vec![0.0; 64]);
    let lda = 1 << 61;
    let product = Product {
        rows: 16,
        depth: 9,
        cols: 1,
        a: &a,
        lda,
        b: &b,
        b_row: 1,
        b_col: 9,
        c: &mut c,
        ldc: 16,
        accumulate: false,
    };
    gemm::single::product(SimdLevel::Portable, product);
}

/// Number of rounds of a search.
const ROUNDS: usize = if cfg!(miri) { 1 } else { 4 };
/// Number of random arguments per round.
const ARGUMENTS: usize = if cfg!(miri) { 64 } else { 20_000 };

/// Number format with the error bounds of its kernels in units in the last place (ulps).
trait Format: Float {
    /// Error bound of sine and cosine, ulps.
    const SIN_COS: f64;
    /// Error bound of tanh with fused multiply-add, ulps.
    const TANH_FUSED: f64;
    /// Error bound of tanh without fused multiply-add, ulps.
    const TANH_UNFUSED: f64;
    /// Exponent of the smallest normal number.
    const SMALLEST: i32;
    /// Returns the representable number `by` steps further from 0.
    fn further(self, by: i64) -> Self;

    /// Returns the error in units in the last place of the exact value.
    fn ulps(self, exact: DoubleDouble) -> f64 {
        // Below a power of two, the unit is that of the lower binade.
        let size = exact.to_f64().abs();
        let below = exact.parts()[1] * exact.parts()[0] < 0.0 && size.to_bits() << 12 == 0;
        let exponent = (size.to_bits() >> 52) as i32 - 1023 - i32::from(below);
        let unit = Self::EPSILON * 2f64.powi(exponent.max(Self::SMALLEST));
        (DoubleDouble::from(self.as_()) - exact).to_f64().abs() / unit
    }
}

impl Format for f32 {
    const SIN_COS: f64 = 1.6;
    const TANH_FUSED: f64 = 6.0;
    const TANH_UNFUSED: f64 = 8.0;
    const SMALLEST: i32 = -126;

    fn further(self, by: i64) -> Self {
        Self::from_bits(self.to_bits().wrapping_add_signed(by as i32))
    }
}

impl Format for f64 {
    const SIN_COS: f64 = 2.6;
    const TANH_FUSED: f64 = 3.0;
    const TANH_UNFUSED: f64 = 3.0;
    const SMALLEST: i32 = -1022;

    fn further(self, by: i64) -> Self {
        Self::from_bits(self.to_bits().wrapping_add_signed(by))
    }
}

/// Computes sin and cos with a small relative error even near the multiples of π/2.
fn exact_sin_cos(x: f64) -> (DoubleDouble, DoubleDouble) {
    /// π/2 in three parts.
    const PARTS: [f64; 3] =
        [std::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17, -1.497_384_904_859_169_8e-33];
    let n = (x / PARTS[0]).round();
    let mut rest = DoubleDouble::from(x);
    for part in PARTS {
        // Subtracts the product as two exact parts.
        let product = n * part;
        for piece in [product, n.mul_add(part, -product)] {
            rest -= DoubleDouble::from(piece);
        }
    }
    let (sin, cos) = Scalar::sin_cos(rest);
    [(sin, cos), (cos, -sin), (-sin, -cos), (-cos, sin)][n.rem_euclid(4.0) as usize]
}

fn exact_tanh(x: f64) -> DoubleDouble {
    Scalar::tanh(DoubleDouble::from(x))
}

/// Computation of sines and cosines, compiled once per instruction set.
struct SinCos<'a, F>(&'a [F], &'a mut [(F, F)]);

impl<F: Format> Vectorized for SinCos<'_, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        for (to, &x) in self.1.iter_mut().zip(self.0) {
            *to = x.sin_cos_near();
        }
    }
}

fn sin_cos_at<F: Format>(level: SimdLevel, x: &[F]) -> Vec<(F, F)> {
    let mut all = vec![(F::zero(), F::zero()); x.len()];
    dispatch(level, SinCos(x, &mut all));
    all
}

fn tanh_at<F: Format>(level: SimdLevel, x: &[F]) -> Vec<F> {
    let mut all = x.to_vec();
    elementwise::tanh(
        level,
        &mut all,
        elementwise::Strided { first: 0, step: x.len(), count: 1, len: x.len() },
    );
    all
}

/// Returns the worst error and its argument. Tests the `known` arguments and their negatives. Each
/// round then tests arguments from `draw`, and the neighbours of the worst argument so far.
fn search<F: Format>(
    known: &[f64],
    mut draw: impl FnMut(&mut Rng) -> f64,
    errors: impl Fn(&[F]) -> Vec<f64>,
) -> (f64, F) {
    let mut rng = stream(2, Purpose::Check, 0);
    let mut worst = (0.0, F::zero());
    let mut look = |x: Vec<F>| {
        for (error, &x) in errors(&x).into_iter().zip(&x) {
            assert!(!error.is_nan(), "the error at {x:?} is NaN");
            if error > worst.0 {
                worst = (error, x);
            }
        }
        worst.1
    };
    look(known.iter().flat_map(|&x| [F::from_f64(x), F::from_f64(-x)]).collect());
    for _ in 0..ROUNDS {
        let at = look((0..ARGUMENTS).map(|_| F::from_f64(draw(&mut rng))).collect());
        let reach = ARGUMENTS as i64 / 4;
        look((-reach..reach).map(|by| at.further(by)).collect());
    }
    worst
}

fn assert_sin_cos_within_bound<F: Format>(known: &[f64]) {
    let errors = |x: &[F]| -> Vec<f64> {
        let alone: Vec<(F, F)> = x.iter().map(|x| x.sin_cos_near()).collect();
        for level in SimdLevel::available() {
            assert!(sin_cos_at(level, x) == alone, "{level:?} has other bits");
        }
        let error = |(&x, (sin, cos)): (&F, (F, F))| {
            let exact = exact_sin_cos(x.as_());
            sin.ulps(exact.0).max(cos.ulps(exact.1))
        };
        x.iter().zip(alone).map(error).collect()
    };
    let draw = |rng: &mut Rng| {
        let turns = f64::from(rng.random_range(0..636_000)) * std::f64::consts::FRAC_PI_2;
        let sign = if rng.random_range(0.0..1.0) < 0.5 { -1.0 } else { 1.0 };
        match rng.random_range(0..4) {
            // A remainder just above a power of two has a sine just below this power. The unit is
            // half as large there, so the error of the reduction counts twice.
            0 => {
                let power = 0.5f64.powi(rng.random_range(1..8));
                turns + sign * power * (1.0 + rng.random_range(0.0..0.2) * power * power)
            }
            // Next to a multiple of π/2.
            1 => turns + sign * 10f64.powf(rng.random_range(-11.0..-6.0)),
            2 => sign * rng.random_range(0.0..1e6),
            _ => sign * 10f64.powf(rng.random_range(-6.0..6.0)),
        }
    };
    let (worst, at) = search(known, draw, errors);
    println!("sin, cos in {}: worst {worst:.3} ulps, at {at:?}", F::NAME);
    assert!(worst <= F::SIN_COS, "{worst} ulps at {at:?}");
}

fn assert_tanh_within_bound<F: Format>(known: &[f64]) {
    for level in SimdLevel::available() {
        let fused = level != SimdLevel::Portable;
        let errors = |x: &[F]| -> Vec<f64> {
            let layer = tanh_at(level, x);
            let error = |(&x, got): (&F, F)| {
                let alone = if fused { x.layer_tanh::<true>() } else { x.layer_tanh::<false>() };
                assert!(got == alone, "{level:?} has other bits at {x:?}");
                got.ulps(exact_tanh(x.as_()))
            };
            x.iter().zip(layer).map(error).collect()
        };
        let draw = |rng: &mut Rng| {
            let sign = if rng.random_range(0.0..1.0) < 0.5 { -1.0 } else { 1.0 };
            match rng.random_range(0..4) {
                0 => sign * rng.random_range(5.0..8.0),
                1 => sign * rng.random_range(0.2..0.25),
                2 => sign * rng.random_range(0.0..20.0),
                _ => sign * 10f64.powf(rng.random_range(-12.0..1.5)),
            }
        };
        let (worst, at) = search(known, draw, errors);
        println!("tanh in {}, {level:?}: worst {worst:.3} ulps, at {at:?}", F::NAME);
        let claim = if fused { F::TANH_FUSED } else { F::TANH_UNFUSED };
        assert!(worst <= claim, "{level:?}: {worst} ulps at {at:?}");
    }
}

#[test]
fn errors_are_counted_in_units_in_the_last_place() {
    let one = DoubleDouble::from(1.0);
    let small = DoubleDouble::from(1e-20);
    // Units in the last place below 1 are half as large as above 1.
    assert_eq!((1.0 + f64::EPSILON).ulps(one), 1.0);
    assert_eq!((1.0 + f64::EPSILON).ulps(one - small).round(), 2.0);
    assert_eq!((1.0 - f64::EPSILON).ulps(one - DoubleDouble::from(f64::EPSILON / 2.0)), 1.0);
    assert_eq!((1.0f32 + f32::EPSILON).ulps(one), 1.0);
    assert_eq!(f32::from_bits(3).ulps(DoubleDouble::from(f64::from(f32::from_bits(1)))), 2.0);
    // Known arguments with large errors.
    let (sin, _) = trig::sin_cos_64(527_498.664_482_847_6);
    assert!((sin.ulps(exact_sin_cos(527_498.664_482_847_6).0) - 2.36).abs() < 0.01);
    let x = -5.746_696f32;
    assert!((tanh::tanh_32::<true>(x).ulps(exact_tanh(f64::from(x))) - 5.16).abs() < 0.01);
}

#[test]
fn errors_of_sine_and_cosine_are_within_1_6_ulps_in_f32_and_2_6_in_f64() {
    assert_sin_cos_within_bound::<f32>(&[2_100.902_1, 130_659.61]);
    assert_sin_cos_within_bound::<f64>(&[
        873_180.420_139_821_6,
        226_252.915_719_264_07,
        527_498.664_482_847_6,
    ]);
}

#[test]
fn errors_of_tanh_are_within_8_ulps_in_f32_and_3_in_f64() {
    assert_tanh_within_bound::<f32>(&[5.981_79, 5.952_199, 5.746_696]);
    assert_tanh_within_bound::<f64>(&[0.221_084_473_376_383_07, 0.221_397_272_859_856_75]);
}

/// Below this magnitude, sin and tanh in single precision equal their argument to within a unit in
/// the last place.
const SMALL: f32 = 1.0 / 8192.0;

/// Returns the largest `error` over all f32 from [`SMALL`] to `reach`, and its argument. Results at
/// negative arguments differ at most in the sign bit.
fn worst_of_all(reach: f32, error: impl Fn(f32) -> f64) -> (f64, f32) {
    let all = (SMALL.to_bits()..=reach.to_bits()).map(f32::from_bits);
    all.map(|x| (error(x), x)).fold((0.0, 0.0), |worst, next| {
        assert!(!next.0.is_nan(), "the error at {:?} is NaN", next.1);
        if next.0 > worst.0 { next } else { worst }
    })
}

#[test]
#[ignore = "every f32: minutes"]
fn every_sine_and_cosine_in_f32_is_within_1_6_ulps() {
    let (worst, at) = worst_of_all(1e6, |x| {
        let ((sin, cos), exact) = (trig::sin_cos_32(x), f64::from(x).sin_cos());
        sin.ulps(DoubleDouble::from(exact.0)).max(cos.ulps(DoubleDouble::from(exact.1)))
    });
    println!("sin, cos in f32: worst {worst:.4} ulps, at {at:?}");
    assert!(worst <= f32::SIN_COS, "{worst} ulps at {at:?}");
}

#[test]
#[ignore = "every f32: minutes"]
fn every_tanh_in_f32_is_within_6_ulps_fused_and_8_unfused() {
    for (claim, kernel) in [
        (f32::TANH_UNFUSED, tanh::tanh_32::<false> as fn(f32) -> f32),
        (f32::TANH_FUSED, tanh::tanh_32::<true>),
    ] {
        let (worst, at) =
            worst_of_all(10.0, |x| kernel(x).ulps(DoubleDouble::from(f64::from(x).tanh())));
        println!("tanh in f32: worst {worst:.4} ulps, at {at:?}");
        let (largest, at) = worst_of_all(10.0, |x| f64::from(kernel(x).abs()));
        assert!(largest <= 1.0, "{largest} at {at:?}");
        assert!(worst <= claim, "{worst} ulps at {at:?}");
    }
}

#[test]
fn tanh_saturates_at_one_and_passes_nan_on() {
    for x in [9.0f32, 20.0, 1e6, 1e30, f32::INFINITY] {
        for got in [tanh::tanh_32::<false>(x), tanh::tanh_32::<true>(x)] {
            assert_eq!(got, 1.0);
        }
        assert_eq!(tanh::tanh_32::<true>(-x), -1.0);
    }
    // At these arguments, the rational approximation without FMA rounds to 1.0000001.
    for x in [7.965_428f32, 7.986_736_3, 7.988_250_7, 7.995_427_6, 7.997_832, 7.998_746] {
        assert_eq!([tanh::tanh_32::<false>(x), tanh::tanh_32::<false>(-x)], [1.0, -1.0]);
    }
    for x in [9.0f32, 20.0, 1e6, 1e30, f32::INFINITY] {
        assert_eq!(tanh::tanh_64::<true>(f64::from(x) * 3.0), 1.0);
    }
    assert!(tanh::tanh_32::<true>(f32::NAN).is_nan() && tanh::tanh_64::<false>(f64::NAN).is_nan());
    assert_eq!(tanh::tanh_64::<false>(-0.0).to_bits(), (-0.0f64).to_bits());
    // Tests a whole layer on every instruction set.
    for level in SimdLevel::available() {
        let mut values = vec![0.0f32, 0.5, -0.5, 100.0, f32::NAN, -f32::INFINITY, 1e-30, 3.0];
        let all = elementwise::Strided { first: 0, step: 8, count: 1, len: 8 };
        elementwise::tanh(level, &mut values, all);
        assert!(values[4].is_nan());
        assert_eq!((values[0], values[3], values[5], values[6]), (0.0, 1.0, -1.0, 1e-30));
    }
}

#[test]
fn lanes_have_the_bits_of_plain_numbers_up_to_1e300_infinity_and_nan() {
    for x in [0.3, 1e5, 2e6, 1e300, f64::INFINITY, f64::NAN] {
        let lanes = Lanes([0.1, x, -x, 7.0]);
        let (sin, cos) = lanes.sin_cos();
        for i in 0..4 {
            let (s, c) = Scalar::sin_cos(lanes.0[i]);
            assert_eq!(
                (sin.0[i].to_bits(), cos.0[i].to_bits()),
                (s.to_bits(), c.to_bits()),
                "{}",
                lanes.0[i]
            );
        }
        let th = Scalar::tanh(lanes);
        assert!((0..4).all(|i| th.0[i].to_bits() == Scalar::tanh(lanes.0[i]).to_bits()));
    }
}
