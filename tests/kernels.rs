//! The kernels at odd shapes and on every instruction set of this processor, against nalgebra and the standard library.

use nalgebra::DMatrix;
use physgrad::kernels::gemm::{self, Product};
use physgrad::kernels::{Level, elementwise, tanh, trig};
use physgrad::rng::{Purpose, stream};
use physgrad::{Lanes, Scalar};
use rand::RngExt;

/// Depth 1, fewer columns than a tile, more than a tile, every remainder.
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
            for (m, k, n) in SHAPES {
                let pad = gemm::$module::PAD;
                let rows = m.div_ceil(pad) * pad;
                let (lda, ldc, ldb) = (rows + pad, rows, k + 3);
                let mut random = |len: usize| -> Vec<$float> { (0..len).map(|_| rng.random_range(-1.0..1.0)).collect() };
                let (a, b, start) = (random(lda * k), random(ldb * n), random(ldc * n));
                let a_matrix = DMatrix::from_fn(m, k, |i, p| a[i + p * lda]);
                let b_matrix = DMatrix::from_fn(k, n, |p, j| b[p + j * ldb]);
                // The same matrix, row by row.
                let b_rows: Vec<$float> = (0..k).flat_map(|p| (0..n).map(move |j| (p, j))).map(|(p, j)| b[p + j * ldb]).collect();
                for accumulate in [false, true] {
                    let mut first: Option<Vec<$float>> = None;
                    for level in Level::available() {
                        for (b, b_row, b_col) in [(&b, 1, ldb), (&b_rows, n, 1)] {
                            let mut c = start.clone();
                            let product =
                                Product { rows, depth: k, cols: n, a: &a, lda, b, b_row, b_col, c: &mut c, ldc, accumulate };
                            gemm::$module::product(level, product);
                            let expected = &a_matrix * &b_matrix;
                            for (i, j) in (0..n).flat_map(|j| (0..m).map(move |i| (i, j))) {
                                let base = if accumulate { start[i + j * ldc] } else { 0.0 };
                                let error = (c[i + j * ldc] - base - expected[(i, j)]).abs();
                                assert!(error <= $tolerance * (1.0 + k as $float), "{level:?} {m}x{k}x{n} [{i}, {j}]: {error:e}");
                            }
                            if level != Level::Portable {
                                // Every fused level sums in the same order.
                                assert_eq!(*first.get_or_insert_with(|| c.clone()), c, "{level:?} {m}x{k}x{n}");
                            }
                        }
                    }
                }
            }
        }
    };
}
products!(single_products_are_nalgebras, f32, single, f32::EPSILON);
products!(double_products_are_nalgebras, f64, double, f64::EPSILON);

#[test]
fn columns_do_not_depend_on_how_many_are_computed_together() {
    let (rows, depth, cols) = (112, 101, 13);
    let mut rng = stream(1, Purpose::Check, 0);
    let mut random = |len: usize| -> Vec<f32> { (0..len).map(|_| rng.random_range(-1.0..1.0)).collect() };
    let (a, b) = (random(rows * depth), random(depth * cols));
    for level in Level::available() {
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
            assert_eq!(run(&b[j * depth..(j + 1) * depth], 1), together[j * rows..(j + 1) * rows], "{level:?} column {j}");
        }
    }
}

#[test]
#[should_panic(expected = "product: B")]
fn a_product_checks_its_slices() {
    let (a, b, mut c) = (vec![0.0f32; 32], vec![0.0; 1], vec![0.0; 16]);
    let product =
        Product { rows: 16, depth: 2, cols: 1, a: &a, lda: 16, b: &b, b_row: 1, b_col: 2, c: &mut c, ldc: 16, accumulate: false };
    gemm::single::product(Level::Portable, product);
}

#[test]
#[should_panic(expected = "product: A")]
fn a_product_whose_size_overflows_is_refused() {
    let (a, b, mut c) = (vec![0.0f32; 64], vec![0.0; 64], vec![0.0; 64]);
    let lda = 1 << 61;
    let product =
        Product { rows: 16, depth: 9, cols: 1, a: &a, lda, b: &b, b_row: 1, b_col: 9, c: &mut c, ldc: 16, accumulate: false };
    gemm::single::product(Level::Portable, product);
}

/// Arguments of both signs, small ones dense.
fn arguments(reach: f64) -> impl Iterator<Item = f64> {
    let mut rng = stream(2, Purpose::Check, 0);
    let even = (-2000..=2000).map(move |i| f64::from(i) * reach / 2000.0);
    even.chain((0..20_000).map(move |_| {
        let exponent: f64 = rng.random_range(-12.0..0.0);
        reach * 10f64.powf(exponent) * if rng.random_range(0.0..1.0) < 0.5 { -1.0 } else { 1.0 }
    }))
}

#[test]
fn tanh_is_within_its_claim() {
    let (mut worst32, mut worst64) = (0.0f64, 0.0f64);
    for x in arguments(30.0) {
        let x32 = x as f32;
        let exact = f64::from(x32).tanh();
        for got in [tanh::tanh_32::<false>(x32), tanh::tanh_32::<true>(x32)] {
            worst32 = worst32.max((f64::from(got) - exact).abs() / (exact.abs() * f64::from(f32::EPSILON)).max(1e-45));
        }
        for got in [tanh::tanh_64::<false>(x), tanh::tanh_64::<true>(x)] {
            worst64 = worst64.max((got - x.tanh()).abs() / (x.tanh().abs() * f64::EPSILON).max(1e-300));
        }
    }
    println!("tanh: worst {worst32:.2} ε in f32, {worst64:.2} ε in f64");
    assert!(worst32 <= 8.0 && worst64 <= 4.0, "{worst32} {worst64}");
}

#[test]
fn tanh_saturates_at_one_and_passes_nan_on() {
    for x in [9.0f32, 20.0, 1e6, 1e30, f32::INFINITY] {
        for got in [tanh::tanh_32::<false>(x), tanh::tanh_32::<true>(x)] {
            assert_eq!(got, 1.0);
        }
        assert_eq!(tanh::tanh_32::<true>(-x), -1.0);
        assert_eq!(tanh::tanh_64::<true>(f64::from(x) * 3.0), 1.0);
    }
    assert!(tanh::tanh_32::<true>(f32::NAN).is_nan() && tanh::tanh_64::<false>(f64::NAN).is_nan());
    assert_eq!(tanh::tanh_64::<false>(-0.0).to_bits(), (-0.0f64).to_bits());
    // A whole layer, on every level.
    for level in Level::available() {
        let mut values = vec![0.0f32, 0.5, -0.5, 100.0, f32::NAN, -f32::INFINITY, 1e-30, 3.0];
        let all = elementwise::Strided { first: 0, step: 8, count: 1, len: 8 };
        elementwise::tanh(level, &mut values, all);
        assert!(values[4].is_nan());
        assert_eq!((values[0], values[3], values[5], values[6]), (0.0, 1.0, -1.0, 1e-30));
    }
}

#[test]
fn sine_and_cosine_are_within_their_claim() {
    let mut worst = [0.0f64; 2];
    for x in arguments(1e6) {
        let (sin, cos) = trig::sin_cos_64(x);
        // Relative to the larger of the result and what one rounding of the argument moves it by.
        for (got, exact) in [(sin, x.sin()), (cos, x.cos())] {
            worst[0] = worst[0].max((got - exact).abs() / (exact.abs() * f64::EPSILON).max(1e-300));
        }
        let x = x as f32;
        let (sin, cos) = trig::sin_cos_32(x);
        for (got, exact) in [(sin, f64::from(x).sin()), (cos, f64::from(x).cos())] {
            worst[1] = worst[1].max((f64::from(got) - exact).abs() / (exact.abs() * f64::from(f32::EPSILON)).max(1e-45));
        }
    }
    println!("sin, cos: worst {:.2} ε in f64, {:.2} ε in f32", worst[0], worst[1]);
    assert!(worst[0] <= 1.6 && worst[1] <= 1.6, "{worst:?}");
}

#[test]
fn lanes_have_the_bits_of_plain_numbers_also_far_out() {
    for x in [0.3, 1e5, 2e6, 1e300, f64::INFINITY, f64::NAN] {
        let lanes = Lanes([0.1, x, -x, 7.0]);
        let (sin, cos) = lanes.sin_cos();
        for i in 0..4 {
            let (s, c) = Scalar::sin_cos(lanes.0[i]);
            assert_eq!((sin.0[i].to_bits(), cos.0[i].to_bits()), (s.to_bits(), c.to_bits()), "{}", lanes.0[i]);
        }
        let th = Scalar::tanh(lanes);
        assert!((0..4).all(|i| th.0[i].to_bits() == Scalar::tanh(lanes.0[i]).to_bits()));
    }
}
