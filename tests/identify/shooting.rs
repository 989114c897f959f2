//! Multiple shooting: trajectories that single shooting cannot fit.

use super::swinging;
use physgrad::identify::{Fit, Options, Segment, Unknown, identify};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::Arm;
use physgrad::{DynSystem, Inputs, Number, Scalar, System};
use rand_distr::{Distribution, StandardNormal};

const VARIES: Number = Number::Trained { start: 1.0, min: 0.0, max: f64::INFINITY };
/// Standard deviations of the noise, rad and rad/s. Rates are not measured.
const NOISE: [f64; 2] = [0.01, 0.1];

fn simulate(system: &DynSystem, start: &[f64], p: &[f64], steps: usize) -> Vec<Vec<f64>> {
    let mut x = vec![start.to_vec()];
    for t in 0..steps {
        let mut next = vec![0.0; start.len()];
        system.step::<f64>(Inputs { x: &x[t], u: &[0.0], p, t }, &mut next);
        x.push(next);
    }
    x
}

/// Returns a segment with the noisy angles of a simulation, without rates.
fn measured(mut x: Vec<Vec<f64>>, p: &[f64]) -> Segment {
    let rng = &mut stream(6, Purpose::Check, 0);
    for pair in x.iter_mut().flat_map(|row| row.chunks_exact_mut(2)) {
        let normal: f64 = StandardNormal.sample(rng);
        pair[0] += NOISE[0] * normal;
        pair[1] = f64::NAN;
    }
    Segment { x, p: p.to_vec(), ..Segment::default() }
}

/// Fits from initial values that are alternately 1.3 times the true values and the true values
/// divided by 1.3.
fn fit(system: &DynSystem, segment: &Segment, window: Option<usize>) -> Fit {
    let start = |i: usize, truth: f64| if i.is_multiple_of(2) { truth * 1.3 } else { truth / 1.3 };
    let unknown = |(index, &truth): (usize, &f64)| Unknown {
        name: format!("p{index}"),
        index,
        start: start(index, truth),
        min: 0.0,
        max: f64::INFINITY,
    };
    let unknowns: Vec<Unknown> = segment.p.iter().enumerate().map(unknown).collect();
    let options =
        Options { noise: Some(NOISE.repeat(segment.x[0].len() / 2)), window, ..Options::default() };
    identify(system, std::slice::from_ref(segment), &unknowns, &options).expect("valid data")
}

/// χ² per degree of freedom.
fn reduced(fit: &Fit) -> f64 {
    fit.chi_squared / (fit.measurements - fit.unknowns) as f64
}

/// Returns the largest difference between a state of the fit and a step of the system from the
/// previous state, in units of the noise.
fn largest_jump(system: &DynSystem, fit: &Fit, p: &[f64]) -> f64 {
    let of_step = |t: usize| {
        let next = &simulate(system, &fit.states[0][t], p, 1)[1];
        let jumps = next
            .iter()
            .zip(&fit.states[0][t + 1])
            .enumerate()
            .map(|(i, (a, b))| (a - b).abs() / NOISE[i % 2]);
        jumps.fold(0.0, f64::max)
    };
    (0..fit.states[0].len() - 1).map(of_step).fold(0.0, f64::max)
}

/// Checks that multiple shooting finds the true values within four standard errors, with standard
/// errors below 3 %, and determines the initial state. Checks that the fitted states follow the
/// steps of the system, and that single shooting does not fit the data.
fn check(system: &DynSystem, segment: &Segment) {
    let found = fit(system, segment, Options::default().window);
    let single = fit(system, segment, None);
    assert!(found.converged && (reduced(&found) - 1.0).abs() < 0.2, "{}", reduced(&found));
    for ((value, error), truth) in found.values.iter().zip(&found.errors).zip(&segment.p) {
        assert!(
            (value - truth).abs() < 4.0 * error && *error < 3e-2 * truth,
            "{value} ± {error}, {truth}"
        );
    }
    assert!(found.undetermined_starts.is_empty(), "{:?}", found.undetermined_starts);
    let jump = largest_jump(system, &found, &found.values);
    assert!(jump < 1e-6 && found.jump < 1e-6, "{jump} {}", found.jump);
    assert!(reduced(&single) > 100.0, "{}", reduced(&single));
}

/// 20 s of a double pendulum. In the first 10 s, a small change of the initial state grows by more
/// than 1e9.
#[test]
fn a_chaotic_swing_is_identified() {
    let arm = Arm { center: VARIES, length: VARIES, viscous: VARIES, ..Arm::default() };
    let last = Arm { center: VARIES, ..Arm::default() };
    let system = swinging(vec![arm, last]);
    let p = [0.1, 0.2, 1e-4, 0.11];
    let simulated = |theta: f64| simulate(&system, &[theta, 0.0, -0.5, 0.0], &p, 2000);
    let (x, near) = (simulated(0.5), simulated(0.5 + 1e-9));
    assert!((x[1000][0] - near[1000][0]).abs() > 1.0);
    check(&system, &measured(x, &p));
}

/// The unit of the data changes only the units of the results, even if the noise is unknown.
#[test]
fn a_fit_with_unknown_noise_does_not_depend_on_the_unit_of_the_data() {
    #[derive(Clone)]
    struct Decay;
    impl System for Decay {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn param_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = x[0] * p[0];
        }
    }
    let rng = &mut stream(7, Purpose::Check, 0);
    let noise: Vec<f64> = (0..40).map(|_| StandardNormal.sample(rng)).collect();
    let fit = |unit: f64| {
        let x = noise
            .iter()
            .enumerate()
            .map(|(t, noise)| vec![unit * (10.0 * 0.95_f64.powi(t as i32) + noise)])
            .collect();
        let segment = Segment { x, p: vec![0.0], ..Segment::default() };
        let unknown = Unknown {
            name: "rate".into(),
            index: 0,
            start: 0.8,
            min: f64::NEG_INFINITY,
            max: f64::INFINITY,
        };
        let options = Options { window: Some(1), ..Options::default() };
        identify(&Decay, &[segment], &[unknown], &options).expect("valid data")
    };
    let expected = fit(1.0);
    assert!(
        expected.jump < 1e-6 && (expected.values[0] - 0.95).abs() < 4.0 * expected.errors[0],
        "{expected:?}"
    );
    for unit in [1e-6, 1e6] {
        let found = fit(unit);
        assert!(found.jump < 1e-6, "{unit}: {}", found.jump);
        for (found, expected) in
            [(found.values[0], expected.values[0]), (found.errors[0], expected.errors[0])]
        {
            assert!((found - expected).abs() < 1e-6 * expected, "{unit}: {found}, {expected}");
        }
    }
}

/// An arm that is thrown up, balances upright for 3 s, and falls. Upright, it is unstable with a
/// time constant of 0.12 s.
#[test]
fn an_unstable_balance_is_identified() {
    let arm = Arm { inertia: VARIES, viscous: VARIES, ..Arm::default() };
    let system = swinging(vec![arm]);
    let p = [4e-4, 5e-4];
    // Bisects the initial rate between falling back and falling over.
    let (mut low, mut high) = (0.0, 20.0);
    for _ in 0..60 {
        let rate = 0.5 * (low + high);
        let x = simulate(&system, &[-1.0, rate], &p, 1000);
        if x.iter().any(|x| x[0] > 0.5) {
            high = rate;
        } else {
            low = rate;
        }
    }
    let x = simulate(&system, &[-1.0, high], &p, 800);
    assert!(x[50..=350].iter().all(|x| x[0].abs() < 0.02) && x[500][0] > 3.0);
    check(&system, &measured(x, &p));
}
