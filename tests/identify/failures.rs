//! Fits without a result: numbers that run away, derivatives that are not finite or 0, and windows
//! that lead to a wrong minimum.

use physgrad::identify::{Fit, Options, Segment, Status, Unknown, identify};
use physgrad::rng::{Purpose, stream};
use physgrad::{Inputs, Scalar, System};
use rand_distr::{Distribution, StandardNormal};

const DT: f64 = 0.05;

#[derive(Clone, Copy, Debug)]
enum Model {
    /// A speed with the thrust p_0 until the time p_1 in s.
    Switched,
    /// A concentration that decays at the rate p_0 c / (p_1 + c).
    Enzyme,
    /// `x' = x/2 + 1/p_0`.
    Reciprocal,
    /// `x' = x/2 + √p_0`.
    Root,
    /// `x' = √x / 2 + p_0`.
    RootOfState,
    /// `x' = x/2 + p_0 + p_1`.
    Sum,
    /// `x' = x/2 + p_0`.
    Offset,
    /// `x' = x/2 + 0.3 + |p_0 - 0.7|`.
    Kink,
    /// `x' = x/2 + y + p_0` with an unmeasured constant y.
    Hidden,
    /// `x' = x/2 + sin(1e25 p_0) / 1000`: rounding of p_0 changes the phase by a billion rad.
    Steep,
}

impl System for Model {
    fn state_dim(&self) -> usize {
        if matches!(self, Self::Hidden) { 2 } else { 1 }
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn param_dim(&self) -> usize {
        2
    }
    fn step<T: Scalar>(&self, Inputs { x, p, t, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = match self {
            Self::Switched => {
                x[0] * 0.95 + T::select_lt(T::from(t as f64 * DT), p[1], p[0], T::zero()) * DT
            }
            Self::Enzyme => x[0] - p[0] * x[0] / (p[1] + x[0]) * DT,
            Self::Reciprocal => x[0] * 0.5 + p[0].recip(),
            Self::Root => x[0] * 0.5 + p[0].sqrt(),
            Self::RootOfState => x[0].sqrt() * 0.5 + p[0],
            Self::Sum => x[0] * 0.5 + p[0] + p[1],
            Self::Offset => x[0] * 0.5 + p[0],
            Self::Kink => x[0] * 0.5 + (p[0] - 0.7).abs() + 0.3,
            Self::Hidden => x[0] * 0.5 + x[1] + p[0],
            Self::Steep => x[0] * 0.5 + (p[0] * 1e25).sin() * 1e-3,
        };
        if let [_, constant] = next {
            *constant = x[1];
        }
    }
}

/// 60 samples of the first state with a noise of 0.01, from one initial value.
fn measured(start: f64, noise: f64, next: impl Fn(usize, f64) -> f64) -> Segment {
    let rng = &mut stream(11, Purpose::Check, 0);
    let mut state = start;
    let mut row = |t: usize| {
        let normal: f64 = StandardNormal.sample(rng);
        let row = vec![state + noise * normal];
        state = next(t, state);
        row
    };
    Segment { x: (0..60).map(&mut row).collect(), u: Vec::new(), p: vec![0.0; 2], first_step: 0 }
}

fn unknowns(starts: &[f64], min: f64) -> Vec<Unknown> {
    let unknown = |(index, &start): (usize, &f64)| Unknown {
        name: format!("p_{index}"),
        index,
        start,
        min,
        max: f64::INFINITY,
    };
    starts.iter().enumerate().map(unknown).collect()
}

fn fit(model: Model, mut data: Segment, starts: &[f64], min: f64) -> Fit {
    data.x.iter_mut().for_each(|row| row.resize(model.state_dim(), f64::NAN));
    identify(&model, &[data], &unknowns(starts, min), &Options::default()).expect("valid data")
}

/// Numbers without a result have no error, and a fit that contains one has not converged. A fit
/// whose numbers the data do not determine has.
#[test]
fn numbers_without_a_result_are_told_apart() {
    use Status::{Estimated, NoSlope, NonFinite, NotConverged, RanAway, Undetermined};
    let offset = |value: f64| move |_: usize, x: f64| 0.5 * x + value;
    let thrust = |t: usize, x: f64| 0.95 * x + if (t as f64) * DT < 1.0 { 22.0 * DT } else { 0.0 };
    // The rate grows faster than c, so no finite constant of saturation is the best one.
    let faster = |_: usize, c: f64| c - c * (0.3 + 0.2 * c) * DT;
    let unlimited = f64::NEG_INFINITY;
    for (model, data, starts, min, expected) in [
        (
            Model::Switched,
            measured(0.0, 0.01, thrust),
            &[10.0, 0.5][..],
            0.0,
            &[NotConverged, NoSlope][..],
        ),
        (Model::Enzyme, measured(2.0, 0.01, faster), &[1.0, 1.0], 0.0, &[RanAway, RanAway]),
        (Model::Reciprocal, measured(1.0, 0.01, offset(-0.1)), &[1.0], 0.0, &[RanAway]),
        (Model::Reciprocal, measured(1.0, 0.01, offset(0.2)), &[1.0], 0.0, &[Estimated]),
        (Model::Root, measured(1.0, 0.01, offset(0.3)), &[0.0], 0.0, &[NonFinite]),
        (
            Model::RootOfState,
            measured(0.0, 0.0, |_, x| 0.5 * x.sqrt()),
            &[0.1],
            0.0,
            &[NotConverged],
        ),
        // χ² is least at the kink, where its slope is not 0.
        (Model::Kink, measured(1.0, 0.01, offset(0.2)), &[1.0], 0.0, &[NotConverged]),
        (
            Model::Sum,
            measured(1.0, 0.01, offset(0.3)),
            &[0.5, 0.5],
            unlimited,
            &[Undetermined, Undetermined],
        ),
        (
            Model::Offset,
            measured(1.0, 0.01, offset(0.3)),
            &[0.5, 0.5],
            unlimited,
            &[Estimated, Undetermined],
        ),
        (Model::Hidden, measured(1.0, 0.01, offset(0.3)), &[0.5], unlimited, &[Undetermined]),
    ] {
        let start_of = data.x[0].clone();
        let found = fit(model, data, starts, min);
        assert_eq!(found.statuses, expected, "{model:?}, {start_of:?}: {found:?}");
        let is_open = expected.iter().any(|status| !matches!(status, Estimated | Undetermined));
        assert_eq!(found.converged, !is_open, "{model:?}: {found:?}");
        assert_eq!(
            found.undetermined.is_empty(),
            !expected.contains(&Undetermined),
            "{model:?}: {found:?}"
        );
        for (status, error) in expected.iter().zip(&found.errors) {
            assert_eq!(error.is_finite(), *status == Estimated, "{model:?}: {found:?}");
        }
        let starts = usize::from(matches!(model, Model::RootOfState));
        assert_eq!(found.non_finite_starts.len(), starts, "{model:?}: {found:?}");
    }
}

/// A stirred reactor. A fast heat balance follows the concentration:
/// `dc/dt = q (1 - c) - k c e^{gT/(1+T)}`, `ε dT/dt = h k c e^{gT/(1+T)} - T`.
struct Reactor {
    g: f64,
    h: f64,
    fast: f64,
}

/// Time step of the reactor.
const STEP: f64 = 0.01;

impl System for Reactor {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        let at = |h: f64, k: [T; 2]| [x[0] + k[0] * h, x[1] + k[1] * h];
        let rate = |[c, heat]: [T; 2]| {
            let reaction = p[0] * c * (heat * self.g / (heat + 1.0)).exp();
            [u[0] * (-c + 1.0) - reaction, (reaction * self.h - heat) * (1.0 / self.fast)]
        };
        let first = rate([x[0], x[1]]);
        let second = rate(at(0.5 * STEP, first));
        let third = rate(at(0.5 * STEP, second));
        let fourth = rate(at(STEP, third));
        for i in 0..2 {
            next[i] = x[i] + (first[i] + (second[i] + third[i]) * 2.0 + fourth[i]) * (STEP / 6.0);
        }
    }
}

/// The temperature is unmeasured, with a noise of 1 as for the command. Windows of ten steps fit
/// the first reactor. In the second one, they end at k = 0.49.
#[test]
fn windows_with_fast_unmeasured_states_do_not_end_in_a_wrong_minimum() {
    for (reactor, start, noise, steps, window) in [
        (Reactor { g: 2.0, h: 0.3, fast: 0.02 }, 0.5, 0.01, 400, Some(10)),
        (Reactor { g: 5.0, h: 0.2, fast: 0.02 }, 2.0, 5e-4, 1000, None),
    ] {
        let rng = &mut stream(12, Purpose::Check, 0);
        let u: Vec<Vec<f64>> =
            (0..steps).map(|t| vec![if t / 50 % 2 == 0 { 2.0 } else { 0.5 }]).collect();
        let (mut state, mut x) = (vec![0.9, 0.2], Vec::new());
        for (t, u) in u.iter().enumerate() {
            let normal: f64 = StandardNormal.sample(rng);
            x.push(vec![state[0] + noise * normal, f64::NAN]);
            let mut next = vec![0.0; 2];
            reactor.step::<f64>(Inputs { x: &state, u, p: &[1.13], t }, &mut next);
            state = next;
        }
        let segment = Segment { x, u, p: vec![0.0], first_step: 0 };
        let unknown = Unknown { name: "k".into(), index: 0, start, min: 0.0, max: f64::INFINITY };
        let options = Options { noise: Some(vec![noise, 1.0]), ..Options::default() };
        let found = identify(&reactor, &[segment], &[unknown], &options).expect("valid data");
        let (value, error) = (found.values[0], found.errors[0]);
        let reduced = found.chi_squared / found.freedom() as f64;
        assert!(
            found.converged && (value - 1.13).abs() < 4.0 * error && error < 3e-3,
            "{value} ± {error}"
        );
        // Five standard deviations.
        assert!((reduced - 1.0).abs() < 5.0 * (2.0 / found.freedom() as f64).sqrt(), "{reduced}");
        assert_eq!(found.window, window);
    }
}

/// A number with a standard error below its own rounding error: its values that a computer has lie
/// in different minima.
#[test]
fn an_error_below_the_rounding_of_the_number_is_no_error() {
    let rng = &mut stream(2, Purpose::Check, 0);
    let mut normal = || Distribution::<f64>::sample(&StandardNormal, rng);
    let x = (0..40).map(|_| vec![normal()]).collect();
    let segment = Segment { x, p: vec![1.0, 0.0], ..Segment::default() };
    let unknown = Unknown {
        name: "p_0".into(),
        index: 0,
        start: 1.0,
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
    };
    for noise in [None, Some(vec![1.0])] {
        let options = Options { noise, window: None, ..Options::default() };
        let found = identify(
            &Model::Steep,
            std::slice::from_ref(&segment),
            std::slice::from_ref(&unknown),
            &options,
        );
        let found = found.expect("valid data");
        assert!(!found.converged && found.errors[0].is_infinite(), "{found:?}");
        assert_eq!(found.statuses, [Status::NotConverged]);
    }
}
