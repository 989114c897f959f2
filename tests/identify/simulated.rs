//! Identification on simulated data, whose true values are known.

use super::swinging;
use physgrad::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::Arm;
use physgrad::{DynSystem, Inputs, Number, Scalar, System};
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{PI, TAU};

const VARIES: Number = Number::Trained { start: 1.0, min: f64::NEG_INFINITY, max: f64::INFINITY };

/// Returns a pendulum with one arm and p = [center in m, viscous friction in N m s/rad].
fn pendulum() -> DynSystem {
    swinging(vec![Arm { center: VARIES, viscous: VARIES, ..Arm::default() }])
}

const TRUTH: [f64; 2] = [0.12, 4e-4];
const NOISE: [f64; 2] = [0.02, 0.2];

fn unknowns(factor: f64) -> Vec<Unknown> {
    let names = ["center", "viscous"].into_iter().enumerate();
    let unknown = |(index, name): (usize, &str)| Unknown {
        name: name.into(),
        index,
        start: TRUTH[index] * factor,
        min: 0.0,
        max: f64::INFINITY,
    };
    names.map(unknown).collect()
}

fn simulated(
    rng: &mut Rng,
    system: &DynSystem,
    start: [f64; 2],
    steps: usize,
    noise: [f64; 2],
) -> Segment {
    let mut x = vec![start.to_vec()];
    for t in 0..steps {
        let mut next = vec![0.0; 2];
        system.step::<f64>(Inputs { x: &x[t], u: &[0.0], p: &TRUTH, t }, &mut next);
        x.push(next);
    }
    for row in &mut x {
        for (x, noise) in row.iter_mut().zip(noise) {
            let normal: f64 = StandardNormal.sample(rng);
            *x += noise * normal;
        }
    }
    Segment { x, p: TRUTH.to_vec(), ..Segment::default() }
}

fn fit(segments: &[Segment], factor: f64, options: &Options) -> Fit {
    identify(&pendulum(), segments, &unknowns(factor), options).expect("valid data")
}

/// Without noise, the residuals vanish. The fit finds the true values up to rounding errors, which
/// the conditioning of the problem amplifies.
#[test]
fn exact_data_give_the_truth() {
    let rng = &mut stream(0, Purpose::Check, 0);
    let segments = [2.0, 0.5].map(|theta| simulated(rng, &pendulum(), [theta, 0.3], 400, [0.0; 2]));
    for free_starts in [true, false] {
        let found = fit(&segments, 1.3, &Options { free_starts, ..Options::default() });
        assert!(found.converged && found.chi_squared < 1e-18, "{found:?}");
        for (value, truth) in found.values.iter().zip(TRUTH) {
            assert!((value / truth - 1.0).abs() < 1e-8, "{:?}", found.values);
        }
    }
}

/// A gyroscope measures an arm that swings about its upper position, and the fit begins at the lower
/// one. The residuals show that the minimum is wrong, and another initial angle finds the right one.
#[test]
fn residuals_that_are_no_noise_show_a_wrong_minimum_and_guesses_avoid_it() {
    let rng = &mut stream(3, Purpose::Check, 0);
    let segments = [2.6, 2.9].map(|theta| {
        let mut segment = simulated(rng, &pendulum(), [theta, 0.0], 150, [0.0, 0.05]);
        segment.x.iter_mut().for_each(|x| x[0] = f64::NAN);
        segment
    });
    let wrong = fit(&segments, 1.3, &Options::default());
    let found = wrong.correlated(&segments);
    assert!(matches!(found[..], [(1, r)] if r > 0.5), "{found:?} {:?}", wrong.values);
    let guesses = vec![vec![PI, 0.0]];
    let right = fit(&segments, 1.3, &Options { guesses, ..Options::default() });
    assert!(right.converged && right.correlated(&segments).is_empty(), "{:?}", right.values);
    for ((value, truth), error) in right.values.iter().zip(TRUTH).zip(&right.errors) {
        assert!((value - truth).abs() < 4.0 * error, "{:?} {:?}", right.values, right.errors);
    }
}

/// Coverage of the 95 % intervals in 100 repetitions. Each of the four counts is binomial, and
/// below 88 with a probability of 0.15 %.
#[test]
#[ignore = "long: hundreds of fits"]
fn confidence_intervals_have_their_nominal_coverage() {
    let options = [
        Options { noise: Some(NOISE.into()), ..Options::default() },
        Options { noise: None, ..Options::default() },
    ];
    // Without a given noise, the fit assumes equal noise of all components.
    for (options, noise) in options.iter().zip([NOISE, [0.05; 2]]) {
        let mut covered = [0; 2];
        for repetition in 0..100 {
            let rng = &mut stream(1, Purpose::Check, repetition);
            let segments =
                [1.2, 2.5].map(|theta| simulated(rng, &pendulum(), [theta, 0.0], 200, noise));
            let found = fit(&segments, 0.9, options);
            assert!(found.converged, "{repetition}");
            for i in 0..2 {
                covered[i] +=
                    usize::from((found.values[i] - TRUTH[i]).abs() < 1.96 * found.errors[i]);
            }
        }
        assert!(covered.iter().all(|covered| (88..=100).contains(covered)), "{covered:?}");
    }
}

/// Fits of repetitions with noise that has a correlation of 0.95 between successive steps.
fn correlated(segments: u32, repetitions: u64) -> Vec<Fit> {
    let fits = (0..repetitions).map(|repetition| {
        let rng = &mut stream(7, Purpose::Check, repetition);
        let segment = |i: u32| {
            let mut segment = simulated(
                rng,
                &pendulum(),
                [0.8 + 2.0 / f64::from(segments) * f64::from(i), 0.0],
                60,
                [0.0; 2],
            );
            let mut drift =
                NOISE.map(|noise| noise * Distribution::<f64>::sample(&StandardNormal, rng));
            for row in &mut segment.x {
                for ((x, drift), noise) in row.iter_mut().zip(&mut drift).zip(NOISE) {
                    *x += *drift;
                    let normal: f64 = StandardNormal.sample(rng);
                    *drift = 0.95 * *drift + (1.0 - 0.95_f64 * 0.95).sqrt() * noise * normal;
                }
            }
            segment
        };
        let segments: Vec<Segment> = (0..segments).map(segment).collect();
        fit(
            &segments,
            0.9,
            &Options { noise: Some(NOISE.into()), window: None, ..Options::default() },
        )
    });
    fits.collect()
}

/// Fractions of the intervals `value ± quantile * error` that contain the true value.
fn coverage(fits: &[Fit], quantile: f64, errors: fn(&Fit) -> &[f64]) -> [f64; 2] {
    let covers =
        |fit: &&Fit, i: usize| (fit.values[i] - TRUTH[i]).abs() < quantile * errors(fit)[i];
    [0, 1].map(|i| fits.iter().filter(|fit| covers(fit, i)).count() as f64 / fits.len() as f64)
}

#[test]
#[ignore = "long: hundreds of fits"]
fn with_correlated_noise_only_robust_errors_have_their_coverage() {
    let fits = correlated(20, 100);
    let [plain, robust] =
        [coverage(&fits, 1.96, |fit| &fit.errors), coverage(&fits, 1.96, |fit| &fit.robust_errors)];
    assert!(plain.iter().all(|&covered| covered < 0.8), "{plain:?}");
    assert!(robust.iter().all(|&covered| covered >= 0.88), "{robust:?}");
}

/// Three segments, with the quantile 4.303 of Student's t for two degrees of freedom. The
/// uncorrected sandwich covers 90 % for the friction.
#[test]
#[ignore = "long: hundreds of fits"]
fn robust_errors_of_three_segments_have_their_coverage() {
    let robust = coverage(&correlated(3, 400), 4.303, |fit| &fit.robust_errors);
    assert!(robust.iter().all(|&covered| covered >= 0.925), "{robust:?}");
}

/// `x' = x/2 + p_0 + p_1 u`.
struct Driven;

impl System for Driven {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_dim(&self) -> usize {
        2
    }
    fn step<T: Scalar>(&self, Inputs { x, p, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 0.5 + p[0] + p[1] * u[0];
    }
}

/// One of four segments has a control. No scatter between segments shows the error of p_1.
#[test]
fn a_number_that_one_segment_determines_has_no_robust_error() {
    let rng = &mut stream(8, Purpose::Check, 0);
    let segment = |i: u32| {
        let mut x = || vec![Distribution::<f64>::sample(&StandardNormal, rng)];
        Segment {
            x: (0..10).map(|_| x()).collect(),
            u: vec![vec![f64::from(i / 3)]; 10],
            p: vec![0.0; 2],
            ..Segment::default()
        }
    };
    let segments: Vec<Segment> = (0..4).map(segment).collect();
    let unknown = |index| Unknown {
        name: format!("p_{index}"),
        index,
        start: 0.0,
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
    };
    let found = identify(&Driven, &segments, &[0, 1].map(unknown), &Options::default())
        .expect("valid data");
    assert!(found.errors.iter().all(|error| error.is_finite()), "{found:?}");
    assert!(
        found.robust_errors[0].is_finite() && found.robust_errors[1].is_infinite(),
        "{found:?}"
    );
}

/// Heat conduction in a rod, with the Fourier number p of a time step and insulated ends.
struct Rod(usize);

impl System for Rod {
    fn state_dim(&self) -> usize {
        self.0
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        for (i, next) in next.iter_mut().enumerate() {
            let neighbors = x[i.saturating_sub(1)] + x[(i + 1).min(self.0 - 1)];
            *next = x[i] + p[0] * (neighbors - x[i] * 2.0);
        }
    }
}

/// Measures two of 20 temperatures of a rod, with a noise of 0.1 K. The first row contains all
/// temperatures if it is `complete`.
fn rod(complete: bool, options: &Options) -> Fit {
    let rng = &mut stream(9, Purpose::Check, 0);
    let mut x =
        vec![(0..20).map(|i| 20.0 + 30.0 * (f64::from(i) * 0.3).sin()).collect::<Vec<f64>>()];
    for t in 0..200 {
        let mut next = vec![0.0; 20];
        Rod(20).step::<f64>(Inputs { x: &x[t], u: &[], p: &[0.3], t }, &mut next);
        x.push(next);
    }
    for (t, row) in x.iter_mut().enumerate() {
        for (i, x) in row.iter_mut().enumerate() {
            let normal: f64 = StandardNormal.sample(rng);
            *x = if i % 10 == 5 || (complete && t == 0) { *x + 0.1 * normal } else { f64::NAN };
        }
    }
    let unknown = Unknown { name: "p".into(), index: 0, start: 0.2, min: 0.0, max: 0.5 };
    let segment = Segment { x, p: vec![0.0], ..Segment::default() };
    identify(&Rod(20), &[segment], &[unknown], options).expect("valid data")
}

#[test]
fn undetermined_initial_states_are_named() {
    let options = Options { noise: Some(vec![0.1; 20]), ..Options::default() };
    let unmeasured: Vec<usize> = (0..20).filter(|i| i % 10 != 5).collect();
    assert_eq!(rod(false, &options).undetermined_starts, unmeasured);
    let complete = rod(true, &options);
    assert!(complete.converged && complete.undetermined_starts.is_empty(), "{complete:?}");
    // Whole segments converge, but the initial temperatures remain undetermined.
    let whole = rod(false, &Options { window: None, ..options });
    assert!(whole.converged, "{whole:?}");
    assert_eq!(whole.undetermined_starts, unmeasured);
}

/// 20 s of a large swing. Only the angles are measured, and the initial values of the fit are 80 %
/// too large.
#[test]
fn long_swings_are_identified() {
    let rng = &mut stream(2, Purpose::Check, 0);
    let mut segments = [simulated(rng, &pendulum(), [2.8, 6.0], 2000, NOISE)];
    segments[0].x.iter_mut().for_each(|row| row[1] = f64::NAN);
    for window in [None, Options::default().window] {
        let options = Options { noise: Some(NOISE.into()), window, ..Options::default() };
        let found = fit(&segments, 1.8, &options);
        assert!(
            found.converged && (found.values[0] / TRUTH[0] - 1.0).abs() < 1e-3,
            "{:?}",
            found.values
        );
        // χ² per degree of freedom is 1 within five standard deviations.
        let dof = (found.measurements - found.unknowns) as f64;
        assert!(
            (found.chi_squared / dof - 1.0).abs() < 5.0 * (2.0 / dof).sqrt(),
            "{}",
            found.chi_squared / dof
        );
    }
}

#[test]
fn missing_samples_do_not_matter() {
    let rng = &mut stream(3, Purpose::Check, 0);
    let mut segments =
        [2.0, 0.5].map(|theta| simulated(rng, &pendulum(), [theta, 0.3], 300, [0.0; 2]));
    for segment in &mut segments {
        for (t, row) in segment.x.iter_mut().enumerate() {
            // The data lack all rates, and the angles of two of every three steps.
            row[1] = f64::NAN;
            if t % 3 > 0 {
                row[0] = f64::NAN;
            }
        }
    }
    let found = fit(&segments, 1.2, &Options::default());
    assert!(found.converged && (found.values[0] / TRUTH[0] - 1.0).abs() < 1e-7, "{found:?}");
}

/// Without control, the motion does not change if all masses, inertias and frictions double.
#[test]
fn undetermined_combinations_are_named() {
    let arm = Arm { mass: VARIES, inertia: VARIES, viscous: VARIES, ..Arm::default() };
    let system = swinging(vec![arm]);
    let truth = [0.1, 4e-4, 3e-4];
    let mut x = vec![vec![1.5, 0.0]];
    for t in 0..300 {
        let mut next = vec![0.0; 2];
        system.step::<f64>(Inputs { x: &x[t], u: &[0.0], p: &truth, t }, &mut next);
        x.push(next);
    }
    let unknown = |(index, name): (usize, &str)| Unknown {
        name: name.into(),
        index,
        start: truth[index],
        min: 0.0,
        max: f64::INFINITY,
    };
    let unknowns: Vec<Unknown> =
        ["mass", "inertia", "viscous"].into_iter().enumerate().map(unknown).collect();
    let segments = [Segment { x, p: truth.to_vec(), ..Segment::default() }];
    let found = identify(&system, &segments, &unknowns, &Options::default()).expect("valid data");
    assert_eq!(found.undetermined, [["mass", "inertia", "viscous"]]);
    assert!(found.errors.iter().all(|error| error.is_infinite()));
    let two =
        identify(&system, &segments, &unknowns[1..], &Options::default()).expect("valid data");
    assert!(two.undetermined.is_empty() && two.errors.iter().all(|error| error.is_finite()));
}

#[test]
fn parameters_stay_within_their_bounds() {
    let rng = &mut stream(4, Purpose::Check, 0);
    let segments = [simulated(rng, &pendulum(), [1.0, 0.0], 200, [0.0; 2])];
    let mut unknowns = unknowns(1.0);
    (unknowns[1].start, unknowns[1].min) = (8e-4, 6e-4);
    let found =
        identify(&pendulum(), &segments, &unknowns, &Options::default()).expect("valid data");
    assert_eq!((found.values[1], &found.at_bound[..]), (6e-4, &["viscous".to_owned()][..]));
}

fn fit_starts(segment: &Segment) -> Fit {
    identify(&pendulum(), std::slice::from_ref(segment), &[], &Options::default())
        .expect("valid data")
}

#[test]
fn wrong_data_are_refused() {
    let rng = &mut stream(5, Purpose::Check, 0);
    let good = simulated(rng, &pendulum(), [1.0, 0.0], 20, [0.0; 2]);
    let error = |segment: Segment, unknowns: &[Unknown]| {
        identify(&pendulum(), &[segment], unknowns, &Options::default())
            .expect_err("an error")
            .to_string()
    };
    let mut short = good.clone();
    short.x[3].pop();
    assert_eq!(
        error(short, &unknowns(1.0)),
        "segment 0: a measured state has length 1; expected 2"
    );
    let mut short = good.clone();
    short.u = vec![vec![0.0]; 17];
    assert_eq!(
        error(short, &unknowns(1.0)),
        "segment 0: the list of controls has length 17; expected 20"
    );
    let exact = Options { free_starts: false, ..Options::default() };
    let nothing = identify(&pendulum(), std::slice::from_ref(&good), &[], &exact);
    assert_eq!(nothing.expect_err("an error"), IdentifyError::NothingUnknown);
    let no_segment = identify(&pendulum(), &[], &[], &Options::default());
    assert_eq!(no_segment.expect_err("an error"), IdentifyError::NothingUnknown);
    // Without unknown parameters, as in a validation, the fit finds the initial state.
    assert!(fit_starts(&good).chi_squared < 1e-18);
    let mut empty = good.clone();
    empty.x.iter_mut().for_each(|row| row.fill(f64::NAN));
    assert!(error(empty, &unknowns(1.0)).starts_with("0 measurements cannot determine 4 unknowns"));
    let mut wild = good.clone();
    wild.x[0][1] = 1e200;
    assert!(error(wild, &unknowns(1.0)).contains("diverges at step"));

    let with = |segments: &[Segment], options: Options| {
        identify(&pendulum(), segments, &unknowns(1.0), &options).expect_err("an error").to_string()
    };
    let empty = Segment { x: Vec::new(), ..good.clone() };
    assert_eq!(
        with(&[good.clone(), empty], Options::default()),
        "segment 1 has no samples; remove it"
    );
    let mut late = good.clone();
    late.x[0][1] = f64::NAN;
    assert!(
        with(&[late], exact).starts_with("segment 0: component 1 of the first sample is missing")
    );
    let short =
        with(std::slice::from_ref(&good), Options { noise: Some(vec![0.1]), ..Options::default() });
    assert_eq!(
        short,
        "the list of noise levels has 1 numbers; expected 2, one per state component"
    );
    let mut infinite = good.clone();
    infinite.x[1][0] = f64::NEG_INFINITY;
    assert_eq!(
        with(&[infinite], Options::default()),
        "segment 0: a measured state is not finite; allowed: finite numbers"
    );
    // The squares of residuals in units of the last two would overflow, and vanish.
    for noise in [0.0, -0.1, f64::NAN, f64::INFINITY, 1e-200, 1e200] {
        let error = with(
            std::slice::from_ref(&good),
            Options { noise: Some(vec![0.1, noise]), ..Options::default() },
        );
        assert_eq!(
            error,
            format!("the noise of state component 1 is {noise}; allowed: 1e-100 to 1e100")
        );
    }
}

#[test]
fn windows_have_at_least_one_step() {
    let rng = &mut stream(7, Purpose::Check, 0);
    let segment = simulated(rng, &pendulum(), [1.0, 0.0], 50, NOISE);
    let of = |window: usize| {
        fit(
            std::slice::from_ref(&segment),
            1.1,
            &Options { window: Some(window), ..Options::default() },
        )
    };
    assert_eq!(of(0), of(1));
}

/// `x' = x/2 + p_0 + p_1 sin(0.3 t)`, for the number t of the step.
struct Gusts;

impl System for Gusts {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn param_dim(&self) -> usize {
        2
    }
    fn step<T: Scalar>(&self, Inputs { x, p, t, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 0.5 + p[0] + p[1] * (0.3 * t as f64).sin();
    }
}

/// Parts of one recording: the whole, a part without its beginning, and two parts with a pause. The
/// exact data give the true values up to rounding errors.
#[test]
fn every_segment_is_simulated_from_its_own_step() {
    let truth = [0.2, 0.7];
    let mut x = vec![vec![1.0]];
    for t in 0..120 {
        let mut next = vec![0.0];
        Gusts.step::<f64>(Inputs { x: &x[t], u: &[], p: &truth, t }, &mut next);
        x.push(next);
    }
    let unknown = |index| Unknown {
        name: format!("p_{index}"),
        index,
        start: 0.0,
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
    };
    #[expect(clippy::single_range_in_vec_init, reason = "a segment is a range of rows")]
    for parts in [vec![0..121], vec![37..121], vec![5..40, 63..101]] {
        let part = |part: std::ops::Range<usize>| Segment {
            first_step: part.start,
            x: x[part].to_vec(),
            p: vec![0.0; 2],
            ..Segment::default()
        };
        let segments: Vec<Segment> = parts.iter().cloned().map(part).collect();
        for (window, free_starts) in
            [(None, true), (None, false), (Some(10), true), (Some(7), false)]
        {
            let options = Options { window, free_starts, ..Options::default() };
            let found =
                identify(&Gusts, &segments, &[0, 1].map(unknown), &options).expect("valid data");
            let errors = found.values.iter().zip(truth).map(|(value, truth)| (value - truth).abs());
            assert!(errors.fold(0.0, f64::max) < 1e-8, "{parts:?}, {window:?}: {:?}", found.values);
        }
    }
}

/// Swings about hanging and a rotation, with angles in (-π, π] as an encoder delivers them. The
/// fit equals that of the continuous angles up to rounding errors, and its states are continuous.
#[test]
fn angles_that_wrap_give_the_fit_of_continuous_angles() {
    let rng = &mut stream(11, Purpose::Check, 0);
    let starts = [[PI + 0.5, 0.0], [PI - 0.8, 0.3], [2.0, 14.0]];
    let continuous = starts.map(|start| simulated(rng, &pendulum(), start, 200, NOISE));
    let mut wrapped = continuous.clone();
    let angles = wrapped.iter_mut().flat_map(|segment| &mut segment.x);
    angles.for_each(|row| row[0] = PI - (PI - row[0]).rem_euclid(TAU));
    // A gap over several wraps.
    wrapped[2].x[100..120].fill(vec![f64::NAN; 2]);
    let mut with_gap = continuous.clone();
    with_gap[2].x[100..120].fill(vec![f64::NAN; 2]);
    assert!(
        wrapped
            .iter()
            .all(|segment| segment.x.windows(2).any(|pair| (pair[1][0] - pair[0][0]).abs() > PI))
    );
    for window in [None, Some(10)] {
        for free_starts in [true, false] {
            let options =
                Options { noise: Some(NOISE.into()), window, free_starts, ..Options::default() };
            let expected = fit(&with_gap, 1.1, &options);
            let found = fit(&wrapped, 1.1, &Options { angles: vec![0], ..options.clone() });
            assert!(expected.converged && found.converged, "{window:?} {free_starts}");
            // As recorded, the wrapped angles cannot reach this χ². A limit above it changes nothing.
            let give_up = found.chi_squared;
            let recorded = Options { give_up, ..options.clone() };
            let recorded = identify(&pendulum(), &wrapped, &unknowns(1.1), &recorded);
            assert_eq!(recorded, Err(IdentifyError::Worse), "{window:?} {free_starts}");
            let limited = Options { angles: vec![0], give_up: 1.01 * give_up, ..options };
            assert_eq!(fit(&wrapped, 1.1, &limited).values, found.values);
            for i in 0..2 {
                // The iterations end within a small fraction of a standard error.
                assert!(
                    (found.values[i] - expected.values[i]).abs() < 1e-3 * expected.errors[i],
                    "{found:?}\n{expected:?}"
                );
            }
            assert!((found.chi_squared / expected.chi_squared - 1.0).abs() < 1e-6);
            assert!(
                (found.rms(2, 0, &wrapped[2]) / expected.rms(2, 0, &with_gap[2]) - 1.0).abs()
                    < 1e-6
            );
            let steps = found.states.iter().flat_map(|states| states.windows(2));
            assert!(steps.map(|pair| (pair[1][0] - pair[0][0]).abs()).fold(0.0, f64::max) < 0.5);
        }
    }
    // Also for angles that do not fit, the residuals are those of χ².
    let rows = (0..4).map(|t| vec![4.0 * f64::from(t), f64::NAN]);
    let far = Segment { x: rows.collect(), p: TRUTH.to_vec(), ..Segment::default() };
    let options =
        Options { angles: vec![0], max_iterations: 1, window: None, ..Options::default() };
    let found = identify(&pendulum(), std::slice::from_ref(&far), &[], &options);
    let found = found.expect("valid data");
    let (squares, chi_squared) = (4.0 * found.rms(0, 0, &far).powi(2), found.chi_squared);
    assert!(chi_squared > PI && (squares / chi_squared - 1.0).abs() < 1e-12, "{found:?}");
    let error = identify(
        &pendulum(),
        &continuous,
        &unknowns(1.0),
        &Options { angles: vec![2], ..Options::default() },
    );
    assert_eq!(error, Err(IdentifyError::Angle { component: 2, states: 2 }));
}
