//! Effects of cart-pole, its coupled model, and actuators: derivatives, and the documented physics.

use physgrad::actuator::{AnyActuator, Delay, Lag, Limit, LimitKind};
use physgrad::effect::{ForcedSystem, HasModel};
use physgrad::policy::Linear;
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{
    Bumpers, CartDamping, CartPole, CartPoleEffect, CartPoleModel, CartPoleSystem, CoupledCartPole,
    DryFriction, GustyWind, PoleDamping, SteadyWind,
};
use physgrad::{
    Actuated, Cotangents, Effect, Forced, Inputs, OdeInputs, Scalar, Substeps, System, check,
};
use rand::RngExt;

fn poles(poles: usize) -> CartPoleSystem {
    CartPoleSystem { poles, ..CartPoleSystem::default() }
}

fn every_effect() -> Vec<CartPoleEffect> {
    vec![
        PoleDamping::default().into(),
        CartDamping::default().into(),
        DryFriction::default().into(),
        SteadyWind::default().into(),
        GustyWind::default().into(),
        // Bumpers at ±0.4 m act on most of the drawn states, which reach ±3 m.
        Bumpers { half_travel: 0.4, ..Bumpers::default() }.into(),
    ]
}

/// Draws components within ±3 (SI units), so that no term is negligible.
fn draw_large(rng: &mut Rng, x: &mut [f64], u: &mut [f64], p: &mut [f64]) {
    x.iter_mut().chain(u).chain(p).for_each(|x| *x = rng.random_range(-3.0..3.0));
}

fn check_large<S: System>(system: &S) {
    check::system_at(system, draw_large).unwrap_or_else(|mismatch| panic!("{mismatch}"));
}

#[test]
fn derivatives_of_every_effect_equal_dual_numbers() {
    for effect in every_effect() {
        for n in [1, 3] {
            check_large(&Forced { system: poles(n), effects: vec![effect.clone()] });
            check_large(&Forced {
                system: CoupledCartPole(poles(n)),
                effects: vec![effect.clone()],
            });
        }
    }
    check_large(&Forced { system: poles(2), effects: every_effect() });
    check_large(&CoupledCartPole(poles(3)));
}

#[test]
fn a_wrong_derivative_of_an_effect_is_found() {
    /// Spring whose derivative has the wrong sign.
    #[derive(Clone, Debug)]
    struct Spring;
    impl Effect<CartPoleSystem> for Spring {
        fn add_forces<T: Scalar>(
            &self,
            _model: &CartPoleSystem,
            OdeInputs { x, .. }: OdeInputs<'_, T>,
            forces: &mut [T],
        ) {
            forces[0] -= x[0];
        }
        fn vjp<R: physgrad::Real, C: physgrad::Cotangent<R>>(
            &self,
            _model: &CartPoleSystem,
            _inputs: OdeInputs<'_, R>,
            forces_bar: &[C],
            cotangents: Cotangents<'_, C>,
        ) {
            if let Some(x_bar) = cotangents.x {
                x_bar[0] += forces_bar[0];
            }
        }
    }
    let failure = check::system(&Forced { system: poles(1), effects: Spring })
        .expect_err("the derivative is wrong");
    let mismatch = failure.mismatch().expect("a finite step");
    assert_eq!((mismatch.what.as_str(), mismatch.index), ("vjp: x_bar", 0));
}

#[test]
fn derivatives_with_actuators_and_substeps_equal_dual_numbers() {
    let system = || Forced { system: poles(2), effects: every_effect() };
    let dt = system().system.dt;
    let [smooth, hard] = [LimitKind::Smooth, LimitKind::Hard]
        .map(|kind| AnyActuator::Limit(Limit { bound: 1.5, kind }));
    let (lag, delay) =
        (AnyActuator::Lag(Lag::new(0.03, dt)), AnyActuator::Delay(Delay { steps: 3 }));
    // All lists have one type, so the compiler monomorphizes the check once.
    for actuator in [
        vec![smooth],
        vec![hard],
        vec![lag],
        vec![delay],
        vec![smooth, lag],
        vec![smooth, delay, lag],
    ] {
        check_large(&Actuated { system: system(), actuator });
    }
    for count in [1, 3] {
        check_large(&Substeps { system: system(), count });
    }
    // Whole rollouts in all flows, with the parameter of the gusts and the states of the delay.
    let full = Actuated {
        system: Forced { system: CoupledCartPole(poles(2)), effects: every_effect() },
        actuator: Delay { steps: 2 },
    };
    let n = full.state_dim();
    assert_eq!((n, full.param_dim()), (6 + 2, 1));
    check::task(&CartPole { horizon: 20, ..CartPole::with_system(full) }, &Linear::with_bias(n, 1))
        .unwrap();
}

fn step<S: System>(system: &S, x: &[f64], u: f64) -> Vec<f64> {
    let mut next = vec![0.0; x.len()];
    system.step(Inputs::new(x, &[u]), &mut next);
    next
}

#[test]
fn with_one_pole_the_coupled_equals_the_uncoupled_model() {
    let mut rng = physgrad::rng::stream(0, physgrad::rng::Purpose::Check, 0);
    for _ in 0..100 {
        let (mut x, mut u) = ([0.0; 4], [0.0]);
        draw_large(&mut rng, &mut x, &mut u, &mut []);
        let effects = (PoleDamping::default(), SteadyWind::default());
        let simple = step(&Forced { system: poles(1), effects }, &x, u[0]);
        let exact = step(&Forced { system: CoupledCartPole(poles(1)), effects }, &x, u[0]);
        for (a, b) in simple.iter().zip(&exact) {
            assert!((a - b).abs() <= 1e-14 * (1.0 + a.abs()), "{a} and {b}");
        }
    }
}

/// Returns kinetic plus potential energy of the coupled model, J.
fn energy(model: &CartPoleSystem, x: &[f64]) -> f64 {
    let (m, l, v) = (model.pole_mass.nominal(), model.half_length.nominal(), x[1]);
    let pole = |pole: &[f64]| {
        let (theta, omega) = (pole[0], pole[1]);
        // The middle of the pole moves with the cart and about the joint. The inertia about the
        // middle is m l² / 3.
        let (vx, vy) = (v + l * omega * theta.cos(), -l * omega * theta.sin());
        0.5 * m * (vx * vx + vy * vy)
            + 0.5 * (m * l * l / 3.0) * omega * omega
            + m * model.gravity.nominal() * l * theta.cos()
    };
    0.5 * model.cart_mass.nominal() * v * v + x[2..].chunks_exact(2).map(pole).sum::<f64>()
}

/// Returns the absolute change of energy after 1 s without control, J.
fn drift<H: ForcedSystem<Model = CartPoleSystem>>(system: impl Fn(f64) -> H, dt: f64) -> f64 {
    let system = Forced { system: system(dt), effects: () };
    let mut x = vec![0.0, 0.3, 3.0, 0.5, 2.0, -1.0, 1.0, 0.2];
    let start = energy(system.model(), &x);
    let library = CoupledCartPole(*system.model()).energy(&x);
    assert!((library - start).abs() < 1e-12, "{library} and {start}");
    for _ in 0..(1.0 / dt).round() as usize {
        x = step(&system, &x, 0.0);
    }
    (energy(system.model(), &x) - start).abs()
}

#[test]
fn the_coupled_model_conserves_energy_and_the_uncoupled_model_does_not() {
    let exact = |dt| CoupledCartPole(CartPoleSystem { dt, ..poles(3) });
    let simple = |dt| CartPoleSystem { dt, ..poles(3) };
    // The method is of first order: a tenth of the step gives a tenth of the drift.
    let (coarse, fine) = (drift(exact, 1e-3), drift(exact, 1e-4));
    assert!(fine < 1e-3 && (8.0..12.0).contains(&(coarse / fine)), "{coarse:e}, {fine:e}");
    assert!(
        drift(simple, 1e-4) > 20.0 * fine,
        "the energy of the uncoupled model drifts by at most 20 times that of the coupled model"
    );
}

#[test]
fn friction_and_still_air_dissipate_energy() {
    let still = SteadyWind { speed: 0.0.into(), ..SteadyWind::default() };
    let effects: [CartPoleEffect; 4] = [
        PoleDamping::default().into(),
        CartDamping::default().into(),
        DryFriction::default().into(),
        still.into(),
    ];
    let model = poles(2);
    let mut rng = physgrad::rng::stream(1, physgrad::rng::Purpose::Check, 0);
    for effect in effects {
        for _ in 0..100 {
            let (mut x, mut forces) = ([0.0; 6], [0.0; 3]);
            draw_large(&mut rng, &mut x, &mut [], &mut []);
            effect.add_forces(&model, Inputs::new(&x, &[]).continuous(0.0), &mut forces);
            let power = forces[0] * x[1] + forces[1] * x[3] + forces[2] * x[5];
            assert!(power < 0.0, "{effect:?} does work: {power} W at {x:?}");
        }
    }
}

#[test]
fn bumpers_push_and_never_pull() {
    let (bumpers, model) =
        (Bumpers { half_travel: 1.0, damping: 2.0.into(), stiffness: 10.0.into() }, poles(1));
    let force = |x: f64, v: f64| {
        let mut forces = [0.0; 2];
        bumpers.add_forces(
            &model,
            Inputs::new(&[x, v, 0.0, 0.0], &[]).continuous(0.0),
            &mut forces,
        );
        forces[0]
    };
    assert_eq!(force(0.99, 5.0), 0.0);
    assert_eq!(force(1.5, 0.0), -5.0);
    assert_eq!(force(-1.5, 0.0), 5.0);
    assert!(
        force(1.5, 1.0) < force(1.5, 0.0),
        "damping does not increase the force during compression"
    );
    assert_eq!(force(1.5, -1.0), 0.0, "the bumper pulls during a fast release");
    assert_eq!(force(-1.5, 1.0), 0.0);
}

#[test]
fn gusty_wind_with_gusts_of_0_equals_steady_wind() {
    let SteadyWind { speed, cart_drag, pole_drag } = SteadyWind::default();
    let gusty = GustyWind { speed, cart_drag, pole_drag, gust: 0.0.into(), period: 1.0 };
    let steady = Forced { system: poles(2), effects: SteadyWind::default() };
    let gusty = Forced { system: poles(2), effects: gusty };
    let x = [0.1, -0.2, 3.0, 0.4, 2.8, -0.5];
    let mut after = [0.0; 6];
    gusty.step(Inputs { p: &[7.0], ..Inputs::new(&x, &[1.5]) }, &mut after);
    assert_eq!(after[..], step(&steady, &x, 1.5));
}

#[test]
fn wind_on_an_upright_pole_at_rest_has_the_documented_force_and_torque() {
    let x = step(&Forced { system: poles(1), effects: SteadyWind::default() }, &[0.0; 4], 0.0);
    // Upright pole at rest, with the wind speed w: F = (cart_drag + pole_drag) w² and
    // τ = half_length pole_drag w².
    assert!(x[1] > 0.0);
    let mut forces = [0.0; 2];
    SteadyWind::default().add_forces(
        &poles(1),
        Inputs::new(&[0.0; 4], &[]).continuous(0.0),
        &mut forces,
    );
    assert!(
        (forces[0] - 0.073 * 9.0).abs() < 1e-12 && (forces[1] - 0.5 * 0.013 * 9.0).abs() < 1e-12,
        "{forces:?}"
    );
}

#[test]
fn actuators_follow_their_formulas() {
    // The control is constant, and the cart starts at rest. The pole has negligible mass. The force
    // is therefore M / dt times the change of the cart's speed, with the cart mass M = 1 kg.
    let model = CartPoleSystem { pole_mass: (1e-12).into(), dt: 0.1, ..poles(1) };
    fn applied<A: physgrad::actuator::Actuator>(
        model: CartPoleSystem,
        actuator: A,
        u: f64,
        steps: usize,
    ) -> Vec<f64> {
        let system = Actuated { system: model, actuator };
        let mut x = vec![0.0; system.state_dim()];
        (0..steps)
            .map(|_| {
                let before = x[1];
                x = step(&system, &x, u);
                (x[1] - before) / 0.1
            })
            .collect()
    }
    let close = |found: Vec<f64>, expected: &[f64]| {
        assert_eq!(found.len(), expected.len());
        for (f, e) in found.iter().zip(expected) {
            assert!((f - e).abs() < 1e-9, "{found:?}, expected {expected:?}");
        }
    };
    close(applied(model, Delay { steps: 2 }, 1.0, 4), &[0.0, 0.0, 1.0, 1.0]);
    let share = 1.0 - (-0.1f64 / 0.2).exp();
    close(applied(model, Lag::new(0.2, 0.1), 1.0, 2), &[share, share + (1.0 - share) * share]);
    close(applied(model, Limit { bound: 0.5, kind: LimitKind::Hard }, 3.0, 1), &[0.5]);
    close(
        applied(model, Limit { bound: 0.5, kind: LimitKind::Smooth }, 0.3, 1),
        &[0.5 * 0.6f64.tanh()],
    );
    close(
        applied(model, (Limit { bound: 0.5, kind: LimitKind::Hard }, Delay { steps: 1 }), 3.0, 2),
        &[0.0, 0.5],
    );
}

#[test]
fn four_substeps_equal_four_steps() {
    let small = CartPoleSystem { dt: 0.0025, ..poles(2) };
    let x = [0.1, -0.2, 3.0, 0.4, 2.8, -0.5];
    let mut expected = x.to_vec();
    for _ in 0..4 {
        expected = step(&small, &expected, 1.5);
    }
    assert_eq!(step(&Substeps { system: small, count: 4 }, &x, 1.5), expected);
}

/// Returns the next state and the cotangents of state and control under all effects, at a random
/// state.
fn step_and_cotangents<H: ForcedSystem<Model = CartPoleSystem>>(system: H) -> Vec<f64> {
    let system = Forced { system, effects: every_effect() };
    let n = system.state_dim();
    let (mut x, mut u, mut p) = (vec![0.0; n], [0.0], [0.0]);
    draw_large(&mut stream(0, Purpose::Check, 0), &mut x, &mut u, &mut p);
    let inputs = Inputs { p: &p, ..Inputs::new(&x, &u) };
    let bar: Vec<f64> = (0..n).map(|i| 0.3 + i as f64).collect();
    let (mut next, mut x_bar, mut u_bar) = (vec![0.0; n], vec![0.0; n], [0.0]);
    system.step(inputs, &mut next);
    system.vjp(inputs, &bar, Cotangents::of(&mut x_bar, &mut u_bar));
    [&next[..], &x_bar, &u_bar].concat()
}

#[test]
fn a_model_chosen_at_run_time_equals_the_typed_model() {
    let (model, coupled) = (poles(3), CoupledCartPole(poles(3)));
    assert_eq!(step_and_cotangents(CartPoleModel::Uncoupled(model)), step_and_cotangents(model));
    assert_eq!(step_and_cotangents(CartPoleModel::Coupled(coupled)), step_and_cotangents(coupled));
    assert_ne!(step_and_cotangents(coupled), step_and_cotangents(model));
}
