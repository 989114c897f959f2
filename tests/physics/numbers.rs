//! Physical numbers that vary between samples or are trained.

use physgrad::count::OpCount;
use physgrad::integrator::Adaptive;
use physgrad::number::Choice;
use physgrad::policy::Constant;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    Bumpers, CartDamping, CartPole, CartPoleEffect, CartPoleModel, CartPoleSystem, CoupledCartPole,
    DryFriction, GustyWind, PoleDamping, SteadyWind,
};
use physgrad::{
    Adjoint, Cotangents, Flow, Forced, Inputs, Integrated, Number, Numbers, Rollout, Scalar,
    System, Weights, check, initial_states,
};
use std::borrow::Cow;

const RANGE: Number = Number::Uniform { low: 0.5, high: 1.5 };

fn varied(poles: usize) -> CartPoleSystem {
    CartPoleSystem {
        poles,
        cart_mass: RANGE,
        pole_mass: RANGE,
        half_length: RANGE,
        gravity: RANGE,
        ..CartPoleSystem::default()
    }
}

/// Returns every effect of cart-pole. `of` converts a value to a [`Number`].
fn effects(of: impl Fn(f64) -> Number) -> Vec<CartPoleEffect> {
    let [speed, cart_drag, pole_drag, gust] = [2.0, 0.1, 0.05, 1.5].map(&of);
    vec![
        PoleDamping { damping: of(0.1) }.into(),
        CartDamping { damping: of(0.2) }.into(),
        DryFriction { force: of(0.7), smoothing: 0.5 }.into(),
        SteadyWind { speed, cart_drag, pole_drag }.into(),
        GustyWind { speed, gust, cart_drag, pole_drag, period: 1.3 }.into(),
        Bumpers { half_travel: 0.3, stiffness: of(20.0), damping: of(0.4) }.into(),
    ]
}

#[test]
fn derivatives_with_respect_to_varied_numbers_equal_dual_numbers() {
    let every = |value: f64| Number::LogUniform { low: 0.5 * value, high: 2.0 * value };
    check::system(&varied(2)).unwrap();
    check::system(&CoupledCartPole(varied(2))).unwrap();
    for effect in effects(every) {
        check::system(&Forced { system: varied(2), effects: effect.clone() }).unwrap();
        check::system(&Forced { system: CartPoleSystem::default(), effects: effect }).unwrap();
    }
    let all = Forced {
        system: CartPoleModel::Coupled(CoupledCartPole(varied(2))),
        effects: effects(every),
    };
    // Numbers of the model, numbers of the effects, and t₀ of the gusts.
    assert_eq!(all.param_dim(), 4 + 12 + 1);
    check::system(&all).unwrap();
}

/// Checks derivatives with respect to the parameters by central differences, without dual numbers.
///
/// The relative change h is 1e-5. Relative to the derivative, the truncation error is about h², or
/// 1e-10, and the rounding error is about 1e-16 / h, or 1e-11.
fn assert_agrees_with_differences(system: &impl System, x: &[f64]) {
    let n = system.state_dim();
    let mut p = vec![0.4; system.param_dim()];
    system.varied(p.len()).iter().for_each(|varied| p[varied.index] = varied.number.nominal());
    let step = |p: &[f64]| {
        let mut next = vec![0.0; n];
        system.step::<f64>(Inputs { x, u: &[0.8], p, t: 3 }, &mut next);
        next
    };
    for i in 0..n {
        let mut by_p = vec![-0.0; p.len()];
        let mut next_bar = vec![0.0; n];
        next_bar[i] = 1.0;
        let inputs = Inputs { x, u: &[0.8], p: &p, t: 3 };
        system.vjp::<f64, f64>(
            inputs,
            &next_bar,
            Cotangents { p: Some(&mut by_p), ..Cotangents::default() },
        );
        for k in 0..p.len() {
            let h = 1e-5 * p[k];
            let at = |value: f64| step(&[&p[..k], &[value], &p[k + 1..]].concat())[i];
            let difference = (at(p[k] + h) - at(p[k] - h)) / (2.0 * h);
            let error = (difference - by_p[k]).abs();
            assert!(
                error < 1e-8 * difference.abs().max(1.0),
                "component {i} by p[{k}]: {} and {difference}",
                by_p[k]
            );
        }
    }
}

#[test]
fn derivatives_by_numbers_agree_with_differences() {
    let x = [0.4, -0.3, 0.5, 1.1, -0.7, 0.6];
    assert_agrees_with_differences(&CoupledCartPole(varied(2)), &x);
    let wind =
        GustyWind { speed: RANGE, gust: RANGE, cart_drag: RANGE, pole_drag: RANGE, period: 1.3 };
    assert_agrees_with_differences(
        &Forced { system: CartPoleSystem::default(), effects: wind },
        &x[..4],
    );
}

/// Samples take adaptive steps of different sizes, so they evaluate the gusts at different times.
#[test]
fn derivatives_by_numbers_of_adaptive_steps_are_independent_of_other_samples() {
    let effects =
        GustyWind { speed: Number::Uniform { low: 5.0, high: 15.0 }, ..GustyWind::default() };
    let ode = Forced { system: CartPoleSystem::default(), effects };
    let integrator = Adaptive { rtol: 1e-9, atol: 1e-9, ..Adaptive::default() };
    let task =
        CartPole { horizon: 4, ..CartPole::with_system(Integrated { ode, integrator, dt: 0.5 }) };
    let mut starts: Vec<f64> = initial_states(&task, 0, Purpose::Train, 8);
    let each = starts.len() / 8;
    // Poles that spin faster need smaller steps.
    starts
        .chunks_exact_mut(each)
        .enumerate()
        .for_each(|(sample, start)| start[3] = 3.0 * sample as f64);
    let policy = Constant::new(4, 1);
    let weights = Weights::new(&policy, vec![0.0]);
    let gradients = |starts: &[f64]| -> Vec<Vec<f64>> {
        let samples = starts.len() / each;
        let mut rollout = Rollout::new(&task, &policy, samples);
        rollout.start(starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        let mut adjoint =
            Adjoint::new(&task, &policy, &rollout, &[Flow::REGULAR]).keep_start_gradients();
        adjoint.run(&task, &policy, &weights, &rollout, 1.0).expect("finite");
        (0..samples).map(|sample| adjoint.start_gradient(0, sample).to_vec()).collect()
    };
    let together = gradients(&starts);
    for (alone, together) in starts.chunks_exact(each).zip(together) {
        assert_eq!(gradients(alone), [together]);
    }
}

/// Compares a system whose numbers are parameters with one whose numbers are fixed.
#[test]
fn steps_with_numbers_as_parameters_equal_steps_with_fixed_numbers() {
    let x = [0.4, -0.3, 0.5, 1.1, -0.7, 0.6];
    let fixed = |value: f64| Number::Fixed(1.1 * value);
    let trained = |value: f64| Number::Trained { start: 1.1 * value, min: 0.0, max: f64::INFINITY };
    let model = |of: &dyn Fn(f64) -> Number| CartPoleSystem {
        poles: 2,
        cart_mass: of(1.0),
        pole_mass: of(0.1),
        half_length: of(0.5),
        gravity: of(9.8),
        dt: 0.02,
    };
    for kind in [CartPoleModel::Uncoupled, |model| CartPoleModel::Coupled(CoupledCartPole(model))] {
        let expected = Forced { system: kind(model(&fixed)), effects: effects(fixed) };
        let system = Forced { system: kind(model(&trained)), effects: effects(trained) };
        // The only parameter of the fixed system is t₀ of the gusts.
        let mut p = vec![0.37; system.param_dim()];
        for varied in system.varied(p.len()) {
            p[varied.index] = varied.number.nominal();
        }
        let (mut next, mut expected_next) = ([0.0; 6], [0.0; 6]);
        system.step::<f64>(Inputs { x: &x, u: &[0.8], p: &p, t: 3 }, &mut next);
        expected.step::<f64>(Inputs { x: &x, u: &[0.8], p: &[0.37], t: 3 }, &mut expected_next);
        // The order of multiplications differs, so numbers of magnitude up to 10 round differently.
        for (next, expected) in next.into_iter().zip(expected_next) {
            assert!((next - expected).abs() < 1e-14, "{next} {expected}");
        }
    }
}

#[test]
fn fixed_and_varied_numbers_cost_the_same_operations() {
    let fixed =
        Forced { system: CartPoleSystem::default(), effects: PoleDamping { damping: 0.1.into() } };
    let cost = OpCount::of(&fixed);
    let plain = OpCount::of(&CartPoleSystem::default());
    assert_eq!(
        cost.step.total() - plain.step.total(),
        2,
        "operations of the friction of one pole: a product and a difference"
    );
    let half = Forced { effects: PoleDamping { damping: RANGE }, ..fixed };
    assert_eq!(
        OpCount::of(&half).step,
        cost.step,
        "a parameter costs other operations than a constant"
    );
}

/// Compares the share of draws below a threshold with its expected value, and checks the range of
/// the draws.
///
/// The number of draws below the threshold is binomial. The tolerance is five standard deviations.
#[test]
fn draws_have_the_range_and_share_below_a_threshold_of_their_distribution() {
    let rng = &mut stream(0, Purpose::Check, 7);
    let choice = Choice::new(&[1.0, 2.0, 3.0]).expect("three values");
    let cases = [
        (Number::Uniform { low: -1.0, high: 3.0 }, 1.0, (-1.0, 3.0)),
        (Number::Normal { mean: 2.0, deviation: 0.5 }, 2.0, (0.5, 3.5)),
        (Number::LogUniform { low: 0.01, high: 100.0 }, 1.0, (0.01, 100.0)),
        (Number::Choice(choice), 1.5, (1.0, 3.0)),
    ];
    for (number, threshold, (low, high)) in cases {
        let draws: Vec<f64> = (0..10_000).map(|_| number.draw(rng)).collect();
        let below = draws.iter().filter(|&&draw| draw < threshold).count() as f64 / 1e4;
        let share = if matches!(number, Number::Choice(_)) { 1.0 / 3.0 } else { 0.5 };
        assert!(
            (below - share).abs() < 5.0 * (share * (1.0 - share) / 1e4_f64).sqrt(),
            "{number:?}: {below}"
        );
        assert!(draws.iter().all(|draw| (low..=high).contains(draw)), "{number:?}");
    }
    assert_eq!(Choice::new(&[]), None);
    let many: Vec<f64> = (0..100).map(f64::from).collect();
    let [one, same] = [0; 2].map(|_| Choice::new(&many).expect("values"));
    assert_eq!((one.values(), one), (&many[..], same));
    assert!(std::ptr::eq(one.values(), same.values()), "equal lists share their memory");
}

/// A point with twenty springs, each second one drawn.
struct Springs(Vec<(Cow<'static, str>, Number)>);

impl System for Springs {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn numbers(&self) -> Numbers<'_> {
        Numbers::all(&self.0)
    }
    fn step<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        let stiffness: [T; 20] = self.numbers().last_of(p);
        next[0] = x[0];
        for (i, stiffness) in stiffness.into_iter().enumerate() {
            next[0] -= (x[0] - T::from(i as f64)) * stiffness * 1e-3;
        }
    }
}

#[test]
fn a_system_has_any_number_of_varied_numbers() {
    let number = |i: usize| if i.is_multiple_of(2) { RANGE } else { Number::Fixed(i as f64) };
    let springs = Springs((0..20).map(|i| (format!("spring_{i}").into(), number(i))).collect());
    assert_eq!(springs.param_dim(), 10);
    let varied = springs.varied(12);
    assert_eq!((varied[9].index, varied[9].name.as_str()), (11, "spring_18"));
    check::system(&springs).unwrap();
    let mut next = [0.0];
    springs.step(Inputs { x: &[2.0], u: &[], p: &[1.0; 10], t: 0 }, &mut next);
    let stiffness = |i: usize| if i.is_multiple_of(2) { 1.0 } else { i as f64 };
    let expected = (0..20).fold(2.0, |x, i| x - (2.0 - i as f64) * stiffness(i) * 1e-3);
    assert!((next[0] - expected).abs() < 1e-14);
}

#[test]
fn drawn_numbers_leave_initial_states_unchanged() {
    let states = |system: CartPoleSystem, len: usize| -> Vec<f64> {
        let starts: Vec<f64> = initial_states(&CartPole::with_system(system), 3, Purpose::Train, 5);
        starts.chunks(len).flat_map(|start| start[..4].to_vec()).collect()
    };
    assert_eq!(states(CartPoleSystem::default(), 4), states(varied(1), 8));
}
