//! Effects of guidance: derivatives, and documented physics.

use physgrad::actuator::{AnyActuator, Delay, Lag, Limit, LimitKind};
use physgrad::policy::Linear;
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::scalar::{Lanes, Single};
use physgrad::tasks::{
    Center, Drive, Evade, Flock, Friction, Guidance, GuidanceEffect, GuidanceSystem, Obstacles,
    Spread, Walls,
};
use physgrad::{
    Actuated, Cotangent, Cotangents, Effect, Forced, Inputs, Real, Substeps, System, check,
};
use rand::RngExt;

fn agents(drivers: usize, evaders: usize) -> GuidanceSystem {
    GuidanceSystem { drivers, evaders, ..GuidanceSystem::default() }
}

/// Returns obstacles that act on some of the states of [`draw_large`].
fn obstacles() -> Obstacles {
    Obstacles { centers: vec![[0.5, -0.3], [-1.5, 1.0]], radius: 1.2, stiffness: 9.0 }
}

fn walls() -> Walls {
    Walls { half_width: 1.5, half_height: 0.8, stiffness: 7.0 }
}

fn every_effect() -> Vec<GuidanceEffect> {
    vec![
        Friction::default().into(),
        Spread::default().into(),
        Evade::default().into(),
        Flock::default().into(),
        Drive { strength: 2.0 }.into(),
        obstacles().into(),
        walls().into(),
    ]
}

/// Draws components within ±2.5: agents inside and outside of obstacles and walls.
fn draw_large(rng: &mut Rng, x: &mut [f64], u: &mut [f64], _p: &mut [f64]) {
    x.iter_mut().chain(u).for_each(|x| *x = rng.random_range(-2.5..2.5));
}

fn check_large<S: System>(system: &S) {
    check::system_at(system, draw_large).unwrap_or_else(|mismatch| panic!("{mismatch}"));
}

/// Returns a hundred random states of a herd.
fn states(model: &GuidanceSystem) -> Vec<Vec<f64>> {
    let mut rng = stream(0, Purpose::Check, 0);
    let state = |_| {
        let mut x = vec![0.0; System::state_dim(model)];
        draw_large(&mut rng, &mut x, &mut [], &mut []);
        x
    };
    (0..100).map(state).collect()
}

fn forces<E: Effect<GuidanceSystem>>(
    effect: &E,
    model: &GuidanceSystem,
    x: &[f64],
) -> Vec<[f64; 2]> {
    let mut forces = vec![0.0; 2 * (model.drivers + model.evaders)];
    effect.add_forces(model, Inputs::new(x, &[]).continuous(0.0), &mut forces);
    forces.chunks_exact(2).map(|force| [force[0], force[1]]).collect()
}

fn step<S: System>(system: &S, x: &[f64], u: &[f64]) -> Vec<f64> {
    let mut next = vec![f64::NAN; x.len()];
    system.step(Inputs::new(x, u), &mut next);
    next
}

/// Returns the next state, followed by the cotangents of state and control.
fn step_and_vjp<S: System>(system: &S, x: &[f64], u: &[f64]) -> Vec<f64> {
    let cotangents: Vec<f64> = (0..x.len()).map(|i| (i as f64 * 1.3).cos()).collect();
    let (mut x_bar, mut u_bar) = (vec![0.0; x.len()], vec![0.0; u.len()]);
    system.vjp(Inputs::new(x, u), &cotangents, Cotangents::of(&mut x_bar, &mut u_bar));
    [step(system, x, u), x_bar, u_bar].concat()
}

#[test]
fn derivatives_of_every_effect_equal_dual_numbers() {
    for (drivers, evaders) in [(1, 1), (2, 4), (3, 2)] {
        let system = agents(drivers, evaders);
        check_large(&system);
        for effect in every_effect() {
            check_large(&Forced { system, effects: vec![effect] });
        }
        check_large(&Forced { system, effects: every_effect() });
    }
    let effects =
        (Obstacles { centers: vec![], ..obstacles() }, Flock { strength: -2.0, distance: 1.5 });
    check_large(&Forced {
        system: GuidanceSystem { softening: 0.4, dt: 0.2, ..agents(3, 3) },
        effects,
    });
}

#[test]
fn derivatives_with_actuators_and_substeps_equal_dual_numbers() {
    let system = || Forced { system: agents(2, 3), effects: every_effect() };
    let smooth = AnyActuator::Limit(Limit { bound: 1.5, kind: LimitKind::Smooth });
    for actuator in [vec![smooth], vec![AnyActuator::Lag(Lag::new(0.2, system().system.dt))]] {
        check_large(&Actuated { system: system(), actuator });
    }
    check_large(&Substeps { system: agents(2, 3).herding(), count: 3 });
    let full =
        Actuated { system: system(), actuator: vec![AnyActuator::Delay(Delay { steps: 2 })] };
    let (n, m) = (full.state_dim(), full.control_dim());
    assert_eq!((n, m), (4 * 5 + 2 * 4, 4));
    check::task(&Guidance { horizon: 20, ..Guidance::with_system(full) }, &Linear::with_bias(n, m))
        .unwrap();
}

#[test]
fn without_effects_only_drivers_with_control_accelerate() {
    let system = GuidanceSystem { dt: 0.5, ..agents(1, 2) };
    let x = [1.0, 2.0, 0.3, 0.4, 3.0, 1.0, -0.5, 0.5, 1.0, -2.0, 0.0, 1.0];
    // The driver is at q = (1, 2) - (4, -1) = (-3, 3) from the sum of the evaders' positions.
    let expected = [
        1.15,
        2.2,
        0.3 + 0.5 * (-6.0 - 3.0),
        0.4 + 0.5 * (6.0 - 3.0),
        2.75,
        1.25,
        -0.5,
        0.5,
        1.0,
        -1.5,
        0.0,
        1.0,
    ];
    for (found, expected) in step(&system, &x, &[2.0, 1.0]).iter().zip(expected) {
        assert!((found - expected).abs() < 1e-15, "{found} is not {expected}");
    }
    assert_eq!(
        step(&Forced { system, effects: () }, &x, &[2.0, 1.0]),
        step(&system, &x, &[2.0, 1.0])
    );
}

#[test]
fn a_tuple_and_a_list_agree_bit_for_bit() {
    let system = agents(2, 4);
    let effects = (
        Friction::default(),
        Spread::default(),
        Evade::default(),
        Flock::default(),
        Drive { strength: 2.0 },
        obstacles(),
    );
    let tuple = Forced { system, effects };
    let list = Forced { system, effects: every_effect()[..6].to_vec() };
    for x in states(&system) {
        let u = [0.3, -0.2, 1.1, 0.4];
        assert_eq!(step_and_vjp(&tuple, &x, &u), step_and_vjp(&list, &x, &u));
    }
}

#[test]
fn reversing_the_order_of_effects_changes_results_by_rounding_only() {
    let system = agents(2, 4);
    let reversed: Vec<_> = every_effect().into_iter().rev().collect();
    let (one, other) =
        (Forced { system, effects: every_effect() }, Forced { system, effects: reversed });
    for x in states(&system) {
        let u = [0.3, -0.2, 1.1, 0.4];
        let (a, b) = (step_and_vjp(&one, &x, &u), step_and_vjp(&other, &x, &u));
        let scale = a.iter().fold(0.0, |scale: f64, a| scale.max(a.abs()));
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 1e-13 * scale), "{a:?} and {b:?}");
    }
}

#[test]
fn forces_of_a_list_are_the_sum_over_its_effects() {
    let model = agents(2, 3);
    for x in states(&model) {
        let mut sum = vec![[0.0; 2]; 5];
        for effect in every_effect() {
            for (sum, force) in sum.iter_mut().zip(forces(&effect, &model, &x)) {
                *sum = [sum[0] + force[0], sum[1] + force[1]];
            }
        }
        for (sum, all) in
            sum.into_iter().flatten().zip(forces(&every_effect(), &model, &x).into_iter().flatten())
        {
            assert!((sum - all).abs() < 1e-11 * (1.0 + sum.abs()), "{sum} and {all}");
        }
    }
}

#[test]
fn friction_reduces_energy_and_is_proportional_to_velocity() {
    let model = agents(2, 3);
    for x in states(&model) {
        for (force, agent) in forces(&Friction::default(), &model, &x).iter().zip(x.chunks_exact(4))
        {
            assert!(force[0] * agent[2] + force[1] * agent[3] < 0.0);
        }
    }
    let [driver, evader] = forces(
        &Friction::default(),
        &agents(1, 1),
        &[5.0, 5.0, 2.0, -1.0, 5.0, 5.0, 2.0, -1.0],
    )[..] else {
        panic!("two agents")
    };
    assert_eq!((driver, evader), ([-2.0, 1.0], [-8.0, 4.0]));
}

/// Returns the norm of the sum of forces, and the sum of their norms.
fn momentum(forces: &[[f64; 2]]) -> (f64, f64) {
    let sum = |axis: usize| forces.iter().map(|force| force[axis]).sum::<f64>();
    (sum(0).hypot(sum(1)), forces.iter().map(|force| force[0].hypot(force[1])).sum())
}

#[test]
fn effects_act_on_the_documented_agents() {
    let model = agents(3, 4);
    for x in states(&model) {
        let (spread, flock) =
            (forces(&Spread::default(), &model, &x), forces(&Flock::default(), &model, &x));
        let (evade, drive) =
            (forces(&Evade::default(), &model, &x), forces(&Drive::default(), &model, &x));
        // Action equals reaction, and no force acts on other agents.
        for (within, beyond) in [(&spread[..3], &spread[3..]), (&flock[3..], &flock[..3])] {
            let (sum, size) = momentum(within);
            assert!(size > 0.0 && sum <= 1e-14 * size, "{sum} of {size}");
            assert_eq!(momentum(beyond).1, 0.0);
        }
        assert!(
            evade[..3].iter().all(|force| *force == [0.0; 2])
                && evade[3..].iter().all(|force| *force != [0.0; 2])
        );
        assert!(
            drive[3..].iter().all(|force| *force == [0.0; 2])
                && drive[..3].iter().all(|force| *force != [0.0; 2])
        );
        // Evade and drive follow the same law with different strengths.
        let total =
            |forces: &[[f64; 2]], axis: usize| forces.iter().map(|force| force[axis]).sum::<f64>();
        for axis in 0..2 {
            let (flight, pull) = (total(&evade, axis) / 15.0, total(&drive, axis) / 0.2);
            assert!((flight - pull).abs() < 1e-12 * (1.0 + pull.abs()), "{flight} and {pull}");
        }
    }
}

#[test]
fn pair_forces_have_the_documented_values_and_directions() {
    let along = |effect: GuidanceEffect, drivers, evaders, distance: f64| {
        let x = [0.0, 0.0, 0.0, 0.0, distance, 0.0, 0.0, 0.0];
        let forces = forces(&effect, &agents(drivers, evaders), &x);
        (forces[0][0], forces[1][0])
    };
    let near = |found: (f64, f64), expected: (f64, f64)| {
        assert!(
            (found.0 - expected.0).abs() < 1e-14 && (found.1 - expected.1).abs() < 1e-14,
            "{found:?}, {expected:?}"
        );
    };
    // At a distance of 0.9, the softened distance is 1.
    near(along(Evade::default().into(), 1, 1, 0.9), (0.0, 15.0 * 0.9));
    near(along(Drive::default().into(), 1, 1, 0.9), (0.2 * 0.9, 0.0));
    near(along(Spread::default().into(), 2, 0, 0.9), (-0.2 * 0.9, 0.2 * 0.9));
    near(along(Flock::default().into(), 0, 2, 0.9), (-0.2 * 0.5 * 0.9, 0.2 * 0.5 * 0.9));
    near(along(Flock::default().into(), 0, 2, 0.4), (0.0, 0.0));
    let (left, right) = along(Flock::default().into(), 0, 2, 0.2);
    assert!(
        left > 0.0 && right == -left,
        "evaders at 0.2, below the distance 0.5 of the effect, do not attract each other"
    );
}

#[test]
fn obstacles_push_outwards_only_within_their_radius() {
    let (obstacles, model) =
        (Obstacles { centers: vec![[1.0, -2.0]], radius: 0.5, stiffness: 10.0 }, agents(1, 1));
    let push = |r: [f64; 2]| {
        let at = [1.0 + r[0], -2.0 + r[1], 3.0, 3.0];
        let forces = forces(&obstacles, &model, &[at, at].concat());
        assert_eq!(forces[0], forces[1], "the forces on drivers and evaders differ");
        forces[0]
    };
    for angle in 0..12 {
        let (sin, cos) = f64::from(angle).sin_cos();
        for length in [0.5 + 1e-12, 0.6, 3.0, 1e10, 1e200] {
            assert_eq!(push([length * cos, length * sin]), [0.0; 2]);
        }
        for length in [0.01, 0.25, 0.49] {
            let [x, y] = push([length * cos, length * sin]);
            let expected = 10.0 * (0.5 - length) * length / (0.1 + length);
            assert!(
                (x - expected * cos).abs() < 1e-13 && (y - expected * sin).abs() < 1e-13,
                "{x}, {y}: {expected}"
            );
        }
    }
    assert_eq!(push([0.0; 2]), [0.0; 2]);
}

#[test]
fn obstacles_have_finite_derivatives_at_distances_from_0_to_1e308() {
    fn check<R: Real>(r: f64, finite: impl Fn(R) -> bool) {
        let model = agents(1, 0);
        let obstacles = Obstacles { centers: vec![[0.0; 2]], radius: 0.5, stiffness: 10.0 };
        let x = [R::from(0.6 * r), R::from(0.8 * r), R::zero(), R::zero()];
        let mut bar = [R::null(); 4];
        let cotangents = Cotangents { x: Some(&mut bar), ..Cotangents::default() };
        obstacles.vjp(
            &model,
            Inputs::new(&x, &[]).continuous(0.0),
            &[R::one(), R::from(-2.0)],
            cotangents,
        );
        assert!(bar.iter().all(|&b| finite(b)), "{bar:?} at {r:e}");
    }
    for r in [0.0, 1e-300, 1e-40, 1e-20, 1e20, 1e38, 1e200, 1e308] {
        check::<f64>(r, f64::is_finite);
        check::<Lanes<f64, 4>>(r, |b| (0..4).all(|lane| b.lane(lane).is_finite()));
        if r <= 1e38 {
            check::<Single<f32>>(r, |b| b.is_finite());
        }
    }
    // Compares with dual numbers at the center of an obstacle, and within about 0.01 m of it.
    let system =
        Forced { system: GuidanceSystem { dt: 0.5, ..agents(2, 2) }, effects: obstacles() };
    for scale in [0.0, 1e-200, 1e-20, 1e-6, 1e-2] {
        let passed = check::system_at(&system, |rng, x, u, p| {
            draw_large(rng, x, u, p);
            for agent in x.chunks_exact_mut(4) {
                let [a, b] = [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)];
                (agent[0], agent[1]) = (0.5 + scale * a, -0.3 + scale * b);
            }
        });
        passed.unwrap_or_else(|mismatch| panic!("within {scale:e}: {mismatch}"));
    }
}

#[test]
fn walls_push_inwards_only_beyond_their_position() {
    let (walls, model) =
        (Walls { half_width: 3.0, half_height: 2.0, stiffness: 10.0 }, agents(1, 1));
    let push = |x: f64, y: f64| {
        let at = [x, y, 3.0, 3.0];
        let forces = forces(&walls, &model, &[at, at].concat());
        assert_eq!(forces[0], forces[1], "the forces on drivers and evaders differ");
        forces[0]
    };
    for (x, y) in [(0.0, 0.0), (3.0, 2.0), (-3.0, -2.0), (2.5, -1.5)] {
        assert_eq!(push(x, y), [0.0; 2]);
    }
    assert_eq!(push(3.5, 1.0), [-5.0, 0.0]);
    assert_eq!(push(-3.5, 1.0), [5.0, 0.0]);
    assert_eq!(push(1.0, 2.5), [0.0, -5.0]);
    assert_eq!(push(-5.0, -4.0), [20.0, 20.0]);
}

/// Returns the speed with which a driver leaves a wall that it hits at 1 m/s.
fn bounce(stiffness: f64) -> f64 {
    let effects = (Friction::default(), Walls { half_width: 1.0, half_height: 1.0, stiffness });
    let system = Forced { system: agents(1, 0), effects };
    let mut x = vec![1.0, 0.0, 1.0, 0.0];
    for _ in 0..1000 {
        x = step(&system, &x, &[0.0; 2]);
        if x[0] < 1.0 {
            return -x[2];
        }
    }
    panic!("the driver has not left the wall after 1000 steps")
}

#[test]
fn walls_reduce_speed_below_the_limit_of_stiffness_and_raise_it_above() {
    // The limit of the stiffness is `friction / dt`, which is 15 for drivers. The default
    // stiffnesses are below this limit.
    assert!(Walls::default().stiffness < 15.0 && Obstacles::default().stiffness < 15.0);
    assert!(bounce(10.0) < 1.0, "{}", bounce(10.0));
    assert!(bounce(60.0) > 1.0, "{}", bounce(60.0));
}

#[test]
fn pair_forces_are_translation_invariant() {
    let model = GuidanceSystem { center: Center::Mean, ..agents(2, 3) };
    let effects = (
        Friction::default(),
        Spread::default(),
        Evade::default(),
        Flock::default(),
        Drive::default(),
    );
    let system = Forced { system: model, effects };
    for x in states(&model) {
        let moved: Vec<f64> =
            x.iter().enumerate().map(|(i, x)| x + [3.0, -4.0, 0.0, 0.0][i % 4]).collect();
        let u = [0.3, -0.2, 1.1, 0.4];
        let (near, far) = (step(&system, &x, &u), step(&system, &moved, &u));
        for (i, (near, far)) in near.iter().zip(&far).enumerate() {
            let shift = [3.0, -4.0, 0.0, 0.0][i % 4];
            assert!((far - near - shift).abs() < 1e-11 * (1.0 + near.abs()), "{i}: {near}, {far}");
        }
    }
}
