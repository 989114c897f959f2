//! Standard errors, against linear regression and fits without the numbers at their bounds.

use nalgebra::{DMatrix, DVector};
use physgrad::identify::{Fit, Options, Segment, Status, Unknown, identify};
use physgrad::rng::{Purpose, stream};
use physgrad::{Inputs, Scalar, System};
use rand_distr::{Distribution, StandardNormal};

/// `x' = x + p_0 + p_1 u + p_2 t/10`, which is linear in all unknowns.
struct Line;

impl System for Line {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_dim(&self) -> usize {
        3
    }
    fn step<T: Scalar>(&self, Inputs { x, p, u, t }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + p[0] + p[1] * u[0] + p[2] * (0.1 * t as f64);
    }
}

const TRUTH: [f64; 3] = [0.5, -1.0, 0.3];
const STEPS: usize = 7;

/// Five segments of seven samples with unit noise.
fn segments() -> Vec<Segment> {
    let rng = &mut stream(13, Purpose::Check, 0);
    let mut normal = || Distribution::<f64>::sample(&StandardNormal, rng);
    let mut segment = || {
        let mut data = Segment { p: TRUTH.to_vec(), ..Segment::default() };
        let mut state = 2.0;
        for t in 0..STEPS {
            let mut next = [0.0];
            let u = vec![normal()];
            data.x.push(vec![state + normal()]);
            Line.step::<f64>(Inputs { x: &[state], u: &u, p: &TRUTH, t }, &mut next);
            (state, _) = (next[0], data.u.push(u));
        }
        data
    };
    (0..5).map(|_| segment()).collect()
}

fn unknown(index: usize, start: f64, [min, max]: [f64; 2]) -> Unknown {
    Unknown { name: format!("p_{index}"), index, start, min, max }
}

const FREE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

fn fit(unknowns: &[Unknown], fixed: f64, noise: Option<f64>) -> Fit {
    let segments: Vec<Segment> = segments()
        .into_iter()
        .map(|segment| Segment { p: vec![0.0, 0.0, fixed], ..segment })
        .collect();
    let options =
        Options { noise: noise.map(|noise| vec![noise]), window: None, ..Options::default() };
    identify(&Line, &segments, unknowns, &options).expect("valid data")
}

/// Ordinary least squares of the initial states and all numbers: values and inverse normal matrix,
/// numbers last, sum of squared residuals, and degrees of freedom.
fn regression(segments: &[Segment]) -> (DVector<f64>, DMatrix<f64>, f64, f64) {
    let (count, columns) = (segments.len() * STEPS, segments.len() + 3);
    let (mut matrix, mut right) = (DMatrix::zeros(count, columns), DVector::zeros(count));
    for (i, segment) in segments.iter().enumerate() {
        let mut sums = [0.0; 3];
        for t in 0..STEPS {
            let row = i * STEPS + t;
            (matrix[(row, i)], right[row]) = (1.0, segment.x[t][0]);
            (0..3).for_each(|k| matrix[(row, segments.len() + k)] = sums[k]);
            sums = [sums[0] + 1.0, sums[1] + segment.u[t][0], sums[2] + 0.1 * t as f64];
        }
    }
    let inverse = (matrix.transpose() * &matrix).try_inverse().expect("determined numbers");
    let values = &inverse * matrix.transpose() * &right;
    let squares = (right - matrix * &values).norm_squared();
    (values, inverse, squares, (count - columns) as f64)
}

fn assert_close(found: f64, expected: f64, what: &str) {
    assert!((found / expected - 1.0).abs() < 1e-6, "{what}: {found}, expected {expected}");
}

/// The noise is that of N - k degrees of freedom. Robust errors are those of fits that leave out
/// one segment each.
#[test]
fn errors_are_those_of_linear_regression_and_of_fits_without_a_segment() {
    let segments = segments();
    let all: Vec<Unknown> = (0..3).map(|i| unknown(i, 0.0, FREE)).collect();
    let [free, known] = [fit(&all, 0.0, None), fit(&all, 0.0, Some(2.0))];
    let (values, inverse, squares, freedom) = regression(&segments);
    let without: Vec<DVector<f64>> =
        (0..5).map(|i| regression(&[&segments[..i], &segments[i + 1..]].concat()).0).collect();
    assert_eq!((free.freedom() as f64, free.unknowns), (freedom, 8));
    for i in 0..3 {
        let variance = inverse[(5 + i, 5 + i)];
        let scatter: f64 =
            without.iter().map(|without| (without[4 + i] - values[5 + i]).powi(2)).sum();
        assert_close(free.values[i], values[5 + i], "value");
        assert_close(free.errors[i], (variance * squares / freedom).sqrt(), "error");
        assert_close(known.errors[i], 2.0 * variance.sqrt(), "error with known noise");
        for fit in [&free, &known] {
            assert_close(fit.robust_errors[i], (0.8 * scatter).sqrt(), "robust error");
            let correlation = inverse[(5, 5 + i)] / (inverse[(5, 5)] * variance).sqrt();
            assert_close(fit.correlations[0][i], correlation, "correlation");
        }
    }
}

/// A segment whose only sample determines its initial state adds nothing to the scatter between
/// segments, whether or not it has rows without samples.
#[test]
fn segments_without_information_do_not_count_in_robust_errors() {
    let all: Vec<Unknown> = (0..3).map(|i| unknown(i, 0.0, FREE)).collect();
    for (kept, window) in [(5, None), (5, Some(3)), (3, None), (3, Some(3))] {
        let options = Options { window, ..Options::default() };
        let mut segments = segments()[..kept].to_vec();
        let expected = identify(&Line, &segments, &all, &options).expect("valid data");
        for (first, rows) in [(1.0, STEPS), (f64::NAN, STEPS), (1.0, 1)] {
            let mut empty = segments[0].clone();
            empty.x = vec![vec![f64::NAN]; rows];
            empty.x[0][0] = first;
            segments.push(empty);
        }
        let found = identify(&Line, &segments, &all, &options).expect("valid data");
        for i in 0..3 {
            assert_close(found.errors[i], expected.errors[i], "error");
            let [found, expected] = [&found, &expected].map(|fit| fit.robust_errors[i]);
            assert!(
                found == expected || (found / expected - 1.0).abs() < 1e-6,
                "{window:?}: {found}"
            );
            assert_eq!(expected.is_infinite(), kept == 3);
        }
    }
}

/// A number at a bound that χ² pushes it beyond, or with equal bounds, is known in the statistics
/// of the others. The reference is a fit in which this number is not unknown.
#[test]
fn numbers_at_a_bound_are_known_in_all_statistics() {
    let both = [unknown(0, 0.0, FREE), unknown(1, 0.0, FREE)];
    for (start, bounds) in [
        // The truth is 0.3: above the upper bounds, and below the lower ones.
        (-4.0, [f64::NEG_INFINITY, -2.0]),
        (-2.0, [-3.0, -2.0]),
        (4.0, [2.0, f64::INFINITY]),
        (2.0, [2.0, 3.0]),
        (2.0, [2.0, 2.0]),
    ] {
        let bound = if start < 0.0 { -2.0 } else { 2.0 };
        for noise in [None, Some(1.0)] {
            let expected = fit(&both, bound, noise);
            let found = fit(&[&both[..], &[unknown(2, start, bounds)]].concat(), 0.0, noise);
            assert_eq!(
                found.statuses,
                [Status::Estimated, Status::Estimated, Status::AtBound],
                "{start}"
            );
            assert_eq!((found.values[2], &found.at_bound[..]), (bound, &["p_2".to_owned()][..]));
            assert_eq!((found.unknowns, found.freedom()), (expected.unknowns, expected.freedom()));
            assert!(found.converged && found.undetermined.is_empty());
            assert_close(found.bic(), expected.bic(), "BIC");
            for i in 0..2 {
                assert_close(found.values[i], expected.values[i], "value");
                assert_close(found.errors[i], expected.errors[i], "error");
                assert_close(found.robust_errors[i], expected.robust_errors[i], "robust error");
                assert_close(found.correlations[0][i], expected.correlations[0][i], "correlation");
                assert!(found.correlations[i][2].is_nan() && found.correlations[2][i].is_nan());
            }
            assert!(found.errors[2].is_nan() && found.robust_errors[2].is_nan());
        }
    }
}

/// [`Line`] beside a second component that no measurement depends on, with the sum of `p_0` and
/// `p_3` in place of `p_0`.
struct Beside;

impl System for Beside {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_dim(&self) -> usize {
        4
    }
    fn step<T: Scalar>(&self, Inputs { x, p, u, t }: Inputs<'_, T>, next: &mut [T]) {
        let p_line = [p[0] + p[3], p[1], p[2]];
        Line.step(Inputs { x: &x[..1], p: &p_line, u, t }, &mut next[..1]);
        next[1] = x[1] * 0.9 + x[0];
    }
}

/// The degrees of freedom count what the data determine: neither the initial values of an unmeasured
/// state without influence, nor two numbers of which only the sum has an influence.
#[test]
fn undetermined_unknowns_take_no_degree_of_freedom() {
    let beside = |segment: Segment| Segment {
        x: segment.x.iter().map(|row| vec![row[0], f64::NAN]).collect(),
        p: vec![0.0; 4],
        ..segment
    };
    let wide: Vec<Segment> = segments().into_iter().map(beside).collect();
    let all: Vec<Unknown> = (0..3).map(|i| unknown(i, 0.0, FREE)).collect();
    for window in [None, Some(3)] {
        let options = Options { window, ..Options::default() };
        let expected = identify(&Line, &segments(), &all, &options).expect("valid data");
        let found = identify(&Beside, &wide, &all, &options).expect("valid data");
        assert_eq!((found.unknowns, found.freedom()), (8, expected.freedom()), "{window:?}");
        assert_close(found.bic(), expected.bic(), "BIC");
        for i in 0..3 {
            assert_close(found.values[i], expected.values[i], "value");
            assert_close(found.errors[i], expected.errors[i], "error");
        }
        let twice = [&all[..], &[unknown(3, 0.1, FREE)]].concat();
        let found = identify(&Beside, &wide, &twice, &options).expect("valid data");
        assert_eq!(found.undetermined, [["p_0", "p_3"]]);
        assert_eq!((found.unknowns, found.freedom()), (8, expected.freedom()), "{window:?}");
        assert_close(found.errors[1], expected.errors[1], "error");
    }
    // Four measurements determine one initial value and three numbers, but three do not.
    let short = |rows: usize| {
        let x = wide[0].x[..rows].to_vec();
        let segment = Segment { x, ..wide[0].clone() };
        identify(&Beside, &[segment], &all, &Options::default())
    };
    assert_eq!(short(4).expect("enough data").freedom(), 0);
    assert_eq!(
        short(3).expect_err("too few data").to_string(),
        "3 measurements cannot determine 4 unknowns; use more samples or fewer unknowns"
    );
}

/// A number that starts at a bound leaves it if χ² decreases within the bounds.
#[test]
fn a_number_leaves_a_bound_towards_the_minimum() {
    let all: Vec<Unknown> = (0..3).map(|i| unknown(i, 0.0, FREE)).collect();
    let expected = fit(&all, 0.0, None);
    for (start, bounds) in [(3.0, [-3.0, 3.0]), (-3.0, [-3.0, 3.0])] {
        let found = fit(&[&all[..2], &[unknown(2, start, bounds)]].concat(), 0.0, None);
        assert!(found.converged && found.at_bound.is_empty(), "{start}: {found:?}");
        for i in 0..3 {
            assert_close(found.values[i], expected.values[i], "value");
            assert_close(found.errors[i], expected.errors[i], "error");
        }
    }
}
