//! Guidance by repulsion: gradients, the authors' steps, and coincident or very distant agents.

use physgrad::policy::Mlp;
use physgrad::rng::Purpose;
use physgrad::scalar::{CotangentPack, Single};
use physgrad::tasks::{
    Center, Evade, Flock, Friction, Guidance, GuidanceSystem, Herding, LossMode, Spread,
};
use physgrad::{
    Cotangent, Cotangents, Float, Forced, Inputs, Real, Scalar, System, Tangents, Task, check,
    initial_states,
};
use rand::RngExt;
use serde_json::Value;

fn agents(drivers: usize, evaders: usize) -> GuidanceSystem {
    GuidanceSystem { drivers, evaders, ..GuidanceSystem::default() }
}

fn system(drivers: usize, evaders: usize) -> Herding {
    agents(drivers, evaders).herding()
}

#[test]
fn derivatives_for_2_to_11_agents_equal_dual_numbers() {
    for (drivers, evaders) in [(1, 1), (1, 3), (2, 4), (3, 2), (4, 7)] {
        check::system(&system(drivers, evaders)).unwrap();
    }
}

#[test]
fn derivatives_with_other_constants_equal_dual_numbers() {
    let effects = (
        Friction { drivers: 0.3, evaders: 2.5 },
        Spread { strength: 1.7 },
        Evade { strength: 4.0 },
        Flock { strength: 3.0, distance: 1.5 },
    );
    let system =
        Forced { system: GuidanceSystem { softening: 0.4, dt: 0.2, ..agents(3, 3) }, effects };
    check::system(&system).unwrap();
}

#[test]
fn steps_are_translation_invariant_with_the_mean_as_center() {
    let by_mean = GuidanceSystem { center: Center::Mean, ..agents(2, 3) }.herding();
    check::system(&by_mean).unwrap();
    // With the mean as center, a step is invariant under translation. With the sum, it is not.
    let x: Vec<f64> = (0..20).map(|i| (i as f64 * 0.7).sin()).collect();
    let moved: Vec<f64> =
        x.iter().enumerate().map(|(i, x)| if i % 4 < 2 { x + 3.0 } else { *x }).collect();
    let largest_change = |system: &Herding| {
        let (mut near, mut far) = (vec![0.0; 20], vec![0.0; 20]);
        system.step(Inputs::new(&x, &[0.3, -0.2, 1.1, 0.4]), &mut near);
        system.step(Inputs::new(&moved, &[0.3, -0.2, 1.1, 0.4]), &mut far);
        assert!(near.iter().chain(&far).all(|x| x.is_finite()), "{near:?}, {far:?}");
        let shift = |i: usize| if i % 4 < 2 { 3.0 } else { 0.0 };
        near.iter()
            .zip(&far)
            .enumerate()
            .map(|(i, (a, b))| (b - a - shift(i)).abs())
            .fold(0.0, f64::max)
    };
    assert!(largest_change(&by_mean) < 1e-13);
    assert!(largest_change(&system(2, 3)) > 0.1);
}

#[test]
fn derivatives_at_states_within_1e_minus_6_to_1e3_equal_dual_numbers() {
    for (drivers, evaders) in [(1, 1), (2, 4), (3, 2)] {
        for scale in [1e-6, 1e-2, 1e3] {
            let passed = check::system_at(&system(drivers, evaders), |rng, x, u, _| {
                x.fill_with(|| scale * rng.random_range(-1.0..1.0));
                u.fill_with(|| rng.random_range(-5.0..5.0));
            });
            passed.unwrap_or_else(|mismatch| {
                panic!("{drivers} drivers, {evaders} evaders, within {scale}: {mismatch}")
            });
        }
    }
}

#[test]
fn gradients_of_rollouts_equal_dual_numbers_in_every_flow() {
    for loss in [LossMode::Terminal, LossMode::Running] {
        for (drivers, evaders) in [(2, 4), (1, 1)] {
            let task = Guidance {
                loss,
                regularization: 0.3,
                horizon: 20,
                ..Guidance::new(drivers, evaders)
            };
            check::task(&task, &Mlp::new([4 * (drivers + evaders), 12, 2 * drivers])).unwrap();
        }
    }
}

#[test]
fn drivers_start_on_a_ring_and_evaders_within_a_square_metre() {
    let task = Guidance::new(2, 4);
    let radius = |p: &[f64]| p[0].hypot(p[1]);
    for x in initial_states(&task, 1, Purpose::Train, 200).chunks_exact(24) {
        let agents: Vec<&[f64]> = x.chunks_exact(4).collect();
        assert!(agents.iter().all(|agent| agent[2..] == [0.0, 0.0]));
        assert!(agents[..2].iter().all(|driver| (3.0..4.0).contains(&radius(driver))));
        for a in &agents[2..] {
            assert!(radius(a) < 2.0 + 0.5 * 2f64.sqrt());
            assert!(
                agents[2..].iter().all(|b| (a[0] - b[0]).abs() < 1.0 && (a[1] - b[1]).abs() < 1.0)
            );
        }
    }
}

#[test]
fn costs_are_means_over_time_agents_and_coordinates() {
    let task = Guidance {
        loss: LossMode::Running,
        regularization: 0.5,
        horizon: 10,
        ..Guidance::new(1, 2)
    };
    let x = [9.0, 9.0, 9.0, 9.0, 1.0, 2.0, 9.0, 9.0, 3.0, 4.0, 9.0, 9.0];
    let near = |found: f64, expected: f64| {
        assert!((found - expected).abs() < 1e-14, "{found} is not {expected}")
    };
    near(
        task.running_cost(Inputs::new(&x, &[2.0, 4.0]), &x),
        (30.0 / 4.0 + 0.5 * 20.0 / 2.0) / 10.0,
    );
    near(task.terminal_cost(&x, &[]), 0.0);
    let task = Guidance { loss: LossMode::Terminal, ..task };
    near(task.running_cost(Inputs::new(&x, &[2.0, 4.0]), &x), 0.5 * 20.0 / 2.0 / 10.0);
    near(task.terminal_cost(&x, &[]), 30.0 / 4.0);
}

/// Returns the largest difference, relative to the largest expected component. If all expected
/// components are 0, the result is the absolute difference.
fn error(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    assert!(found.iter().all(|v| v.is_finite()), "not finite: {found:?}");
    let scale = expected.iter().fold(0.0, |scale: f64, e| scale.max(e.abs()));
    let worst = found.iter().zip(expected).map(|(f, e)| (f - e).abs()).fold(0.0, f64::max);
    if scale > 0.0 { worst / scale } else { worst }
}

#[test]
fn steps_and_vjps_equal_the_authors() {
    let text = include_str!("../reference/gbr_2-4_step.json");
    let file: Value = serde_json::from_str(text).expect("JSON");
    let numbers = |key: &str| -> Vec<f64> {
        let data = file[key]["data"].as_array().expect("an array");
        data.iter().map(|v| v.as_f64().expect("a number")).collect()
    };
    let system =
        GuidanceSystem { dt: file["dt"].as_f64().expect("a number"), ..agents(2, 4) }.herding();
    let keys = ["state", "control", "next_state", "cotangent", "vjp_state", "vjp_control"];
    let [state, control, next_state, cotangent, vjp_state, vjp_control] = keys.map(numbers);
    assert_eq!(state.len(), 20 * 24);
    let mut worst = [0.0; 3];
    for case in 0..20 {
        let (x, u) = (&state[24 * case..][..24], &control[4 * case..][..4]);
        let (mut next, mut x_bar, mut u_bar) = ([0.0; 24], [0.0; 24], [0.0; 4]);
        system.step(Inputs::new(x, u), &mut next);
        system.vjp(
            Inputs::new(x, u),
            &cotangent[24 * case..][..24],
            Cotangents::of(&mut x_bar, &mut u_bar),
        );
        let expected = [
            &next_state[24 * case..][..24],
            &vjp_state[24 * case..][..24],
            &vjp_control[4 * case..][..4],
        ];
        for (worst, (found, expected)) in
            worst.iter_mut().zip([&next[..], &x_bar, &u_bar].into_iter().zip(expected))
        {
            *worst = f64::max(*worst, error(found, expected));
        }
    }
    println!("next state, vjp by state, vjp by control: worst errors {worst:?}");
    assert!(worst.iter().all(|&worst| worst <= 1e-12), "{worst:?}");
}

/// System that forwards the step but not the derivatives. The default JVP uses dual numbers.
struct ByDuals(Herding);

impl System for ByDuals {
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        self.0.step(Inputs::new(x, u), next);
    }
}

/// Returns agents at rest, `distance` apart in x. With `diagonal`, every second agent is offset in
/// y.
fn row_of_agents<R: Real>(agents: usize, distance: f64, diagonal: bool) -> Vec<R> {
    let position = |i: usize| {
        [i as f64 * distance, if diagonal { (i % 2) as f64 * 0.75 * distance } else { 0.0 }]
    };
    (0..agents).flat_map(|i| [position(i)[0], position(i)[1], 0.0, 0.0].map(R::from)).collect()
}

/// Checks one step with agents `distance` apart. The next state is finite, and VJP, JVP and dual
/// numbers agree. The control is 0. The check compares all derivatives, and then those with respect
/// to positions alone, so that the derivatives of the forces are not negligible.
fn derivatives_agree<R: Real>(
    drivers: usize,
    evaders: usize,
    distance: f64,
    diagonal: bool,
    allowed: f64,
) {
    let system = system(drivers, evaders);
    let (n, m) = (system.state_dim(), system.control_dim());
    let (x, u): (Vec<R>, _) =
        (row_of_agents(drivers + evaders, distance, diagonal), vec![R::zero(); m]);
    let mut next = vec![R::zero(); n];
    system.step(Inputs::new(&x, &u), &mut next);
    assert!(next.iter().all(|v| v.lane(0).to_f64().is_finite()), "{next:?}");

    let mut columns = vec![vec![R::zero(); n]; n];
    for (k, column) in columns.iter_mut().enumerate() {
        let mut x_tan = vec![R::zero(); n];
        x_tan[k] = R::one();
        system.jvp(
            Inputs::new(&x, &u),
            Tangents { x: Some(&x_tan), ..Tangents::default() },
            column,
        );
    }
    for agent in 0..n / 4 {
        // Cotangent of the velocity of one agent, with components in x and y.
        let mut next_bar = vec![R::zero(); n];
        (next_bar[4 * agent + 2], next_bar[4 * agent + 3]) = (R::one(), R::from(0.5));
        let (mut x_bar, mut u_bar) = (vec![R::zero(); n], vec![R::zero(); m]);
        system.vjp(Inputs::new(&x, &u), &next_bar, Cotangents::of(&mut x_bar, &mut u_bar));
        let jvp = |column: &Vec<R>| column[4 * agent + 2] + column[4 * agent + 3] * R::from(0.5);
        // Uses forward mode, because products of partial derivatives underflow in reverse mode at a
        // distance of 1e120.
        let by_duals = |k: usize, len: usize, of_state: bool| -> R {
            let (mut tangent, mut column) = (vec![R::zero(); len], vec![R::zero(); n]);
            tangent[k] = R::one();
            let mut tangents = Tangents::default();
            *(if of_state { &mut tangents.x } else { &mut tangents.u }) = Some(&tangent);
            ByDuals(system).jvp(Inputs::new(&x, &u), tangents, &mut column);
            jvp(&column)
        };
        let x_dual: Vec<R> = (0..n).map(|k| by_duals(k, n, true)).collect();
        let u_dual: Vec<R> = (0..m).map(|k| by_duals(k, m, false)).collect();
        let x_jvp: Vec<R> = columns.iter().map(jvp).collect();

        // Derivatives near the underflow threshold have few digits left.
        let smallest = if <R::Real as Float>::EPSILON < 1e-10 {
            f64::MIN_POSITIVE
        } else {
            f64::from(f32::MIN_POSITIVE)
        };
        let rounded = |v: f64| if v.abs() < 10.0 * smallest { 0.0 } else { v };
        let every = |v: &[R]| v.iter().map(|v| v.lane(0).to_f64()).collect::<Vec<f64>>();
        let positions = |v: &[R]| {
            (0..n)
                .filter(|k| k % 4 < 2)
                .map(|k| rounded(v[k].lane(0).to_f64()))
                .collect::<Vec<f64>>()
        };
        for (what, error) in [
            ("x_bar by duals", error(&every(&x_dual), &every(&x_bar))),
            ("u_bar by duals", error(&every(&u_dual), &every(&u_bar))),
            ("x_bar by jvp", error(&every(&x_jvp), &every(&x_bar))),
            ("positions of x_bar by duals", error(&positions(&x_dual), &positions(&x_bar))),
            ("positions of x_bar by jvp", error(&positions(&x_jvp), &positions(&x_bar))),
        ] {
            assert!(
                error <= allowed,
                "{}, {distance:e} apart, agent {agent}: {what}: {error:e}",
                <R::Real as Float>::NAME
            );
        }
    }
}

#[test]
fn derivatives_agree_for_coincident_and_very_distant_agents() {
    for diagonal in [false, true] {
        for (drivers, evaders) in [(1, 1), (2, 4), (3, 2)] {
            for distance in [0.0, 1e-300, 1e-150, 1e-20, 1e-3, 1.0, 1e20, 1e120, 1e150] {
                derivatives_agree::<f64>(drivers, evaders, distance, diagonal, 1e-12);
            }
            for distance in [0.0, 1e-38, 1e-30, 1e-20, 1e-3, 1.0, 1e10, 1e20, 1e30] {
                derivatives_agree::<Single<f32>>(drivers, evaders, distance, diagonal, 1e-5);
            }
        }
    }
}

/// Returns the acceleration in x and y of an evader that flees from a driver at `distance`.
fn flight<R: Real>(distance: f64) -> (f64, f64) {
    let system =
        Forced { system: GuidanceSystem { dt: 1.0, ..agents(1, 1) }, effects: Evade::default() };
    let (along, across) = (R::from(0.6 * distance), R::from(0.8 * distance));
    let x = [R::zero(), R::zero(), R::zero(), R::zero(), along, across, R::zero(), R::zero()];
    let mut next = [R::zero(); 8];
    system.step(Inputs::new(&x, &[R::zero(); 2]), &mut next);
    (next[6].lane(0).to_f64(), next[7].lane(0).to_f64())
}

#[test]
fn evasion_has_its_limiting_forces_at_distances_from_1e_minus_300_to_1e300() {
    fn check<R: Real>(distance: f64, force: f64) {
        let (x, y) = flight::<R>(distance);
        let error = (x / (0.6 * force) - 1.0).abs().max((y / (0.8 * force) - 1.0).abs());
        assert!(
            error <= 10.0 * <R::Real as Float>::EPSILON,
            "{} at {distance:e}: {error:e}",
            <R::Real as Float>::NAME
        );
    }
    // The force is 15 |r| / (0.1 + |r|)²: 1500 |r| near, and 15 / |r| far away. Squares of many of
    // these distances overflow or underflow.
    for distance in [1e-300, 1e-200, 1e-150, 1e-50, 1e-20] {
        check::<f64>(distance, 1500.0 * distance);
    }
    for distance in [1e20, 1e150, 1e200, 1e300] {
        check::<f64>(distance, 15.0 / distance);
    }
    for distance in [1e-35, 1e-30, 1e-20, 1e-10] {
        check::<Single<f32>>(distance, 1500.0 * distance);
    }
    for distance in [1e10, 1e20, 1e30, 1e35] {
        check::<Single<f32>>(distance, 15.0 / distance);
    }
    for distance in [1e-4, 0.3, 2.0, 1e5] {
        check::<f64>(distance, 15.0 * distance / (0.1 + distance).powi(2));
    }
}

#[test]
fn lanes_with_distances_from_0_to_1e160_equal_single_samples() {
    // Each lane scales the separation of two agents independently.
    const W: usize = 4;
    let system = system(2, 2);
    let distances = [0.0, 1e-160, 1.0, 1e160];
    let starts: [Vec<f64>; W] = distances.map(|distance| row_of_agents(4, distance, true));
    let x: Vec<physgrad::scalar::Lanes<f64, W>> =
        (0..16).map(|i| physgrad::scalar::Lanes(std::array::from_fn(|l| starts[l][i]))).collect();
    let u = [physgrad::scalar::Lanes([0.3; W]); 4];
    let cotangents: Vec<_> = (0..16)
        .map(|i| CotangentPack([physgrad::scalar::Lanes([f64::from(i) - 7.5; W])]))
        .collect();
    let (mut next, mut x_bar, mut u_bar) =
        (x.clone(), vec![CotangentPack::null(); 16], vec![CotangentPack::null(); 4]);
    system.step(Inputs::new(&x, &u), &mut next);
    system.vjp(Inputs::new(&x, &u), &cotangents, Cotangents::of(&mut x_bar, &mut u_bar));
    for (lane, start) in starts.iter().enumerate() {
        let (mut plain, mut plain_bar, mut plain_u) = ([0.0; 16], [0.0; 16], [0.0; 4]);
        system.step(Inputs::new(start, &[0.3; 4]), &mut plain);
        let bar: Vec<f64> = (0..16).map(|i| f64::from(i) - 7.5).collect();
        system.vjp(
            Inputs::new(start, &[0.3; 4]),
            &bar,
            Cotangents::of(&mut plain_bar, &mut plain_u),
        );
        assert!(next.iter().zip(plain).all(|(a, b)| a.lane(lane) == b));
        assert!(x_bar.iter().zip(plain_bar).all(|(a, b)| a.0[0].lane(lane) == b));
        assert!(u_bar.iter().zip(plain_u).all(|(a, b)| a.0[0].lane(lane) == b));
    }
}
