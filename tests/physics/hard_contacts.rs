//! Dry friction and impacts: gradients, and the documented properties.

use physgrad::policy::Mlp;
use physgrad::scalar::Single;
use physgrad::tasks::{
    Bounce, BouncingBall, Contact, FrictionScheme, Push, Slider, SliderSystem, TwoBodies,
};
use physgrad::{Cotangents, Float, Inputs, Real, Scalar, System, check};
use rand::RngExt;

/// Spring with a stiffness of 1000 N/m and a damping of 0.3 s/m.
const SPRING: Contact = Contact::Penalty { stiffness: 1e3, damping: 0.3 };

fn step<S: System, R: Scalar>(system: &S, x: &[R], u: R) -> Vec<R> {
    let mut next = vec![R::from(f64::NAN); x.len()];
    system.step(Inputs::new(x, &[u]), &mut next);
    next
}

fn run<S: System>(system: &S, x: &[f64], u: f64, steps: usize) -> Vec<f64> {
    (0..steps).fold(x.to_vec(), |x, _| step(system, &x, u))
}

/// Returns the Jacobian ∂S_i/∂x_j of the step S, with ∂S_i/∂u in the last column.
fn jacobian<S: System>(system: &S, x: &[f64], u: f64) -> Vec<Vec<f64>> {
    let row = |i: usize| {
        let (mut bar, mut x_bar, mut u_bar) = (vec![0.0; x.len()], vec![0.0; x.len()], [0.0]);
        bar[i] = 1.0;
        system.vjp(Inputs::new(x, &[u]), &bar, Cotangents::of(&mut x_bar, &mut u_bar));
        x_bar.push(u_bar[0]);
        x_bar
    };
    (0..x.len()).map(row).collect()
}

/// Returns the matrix of [`jacobian`] by central differences at ±`by`.
fn differences<S: System>(system: &S, x: &[f64], u: f64, by: f64) -> Vec<Vec<f64>> {
    let mut rows = vec![vec![0.0; x.len() + 1]; x.len()];
    for j in 0..=x.len() {
        let at = |by: f64| {
            let mut xu = [x, &[u]].concat();
            xu[j] += by;
            step(system, &xu[..x.len()], xu[x.len()])
        };
        for (row, (after, before)) in rows.iter_mut().zip(at(by).iter().zip(at(-by))) {
            row[j] = (after - before) / (2.0 * by);
        }
    }
    rows
}

#[track_caller]
fn near(found: &[Vec<f64>], expected: &[Vec<f64>], allowed: f64) {
    let (found, expected) = (found.concat(), expected.concat());
    assert!(
        found.len() == expected.len() && found.iter().chain(&expected).all(|x| x.is_finite()),
        "{found:?}, {expected:?}"
    );
    for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
        assert!(
            (found - expected).abs() <= allowed * expected.abs().max(1.0),
            "{i}: {found} is not {expected}"
        );
    }
}

fn sliders() -> impl Iterator<Item = SliderSystem> {
    let schemes = [FrictionScheme::Explicit, FrictionScheme::Implicit];
    (1..=6).flat_map(move |exponent| {
        schemes.map(|scheme| SliderSystem {
            smoothing: 10f64.powi(-exponent),
            scheme,
            mass: 1.7,
            ..SliderSystem::default()
        })
    })
}

#[test]
fn derivatives_of_sliders_equal_dual_numbers_at_every_smoothing() {
    for slider in sliders() {
        check::system(&slider).unwrap();
        let passed = check::system_at(&slider, |rng, x, u, _| {
            x[0] = rng.random_range(-1.0..1.0);
            x[1] = 10f64.powf(rng.random_range(-9.0..1.0)) * if rng.random() { 1.0 } else { -1.0 };
            u[0] = rng.random_range(-20.0..20.0);
        });
        passed.unwrap_or_else(|mismatch| panic!("{slider:?}: {mismatch}"));
    }
}

/// Returns `|v' - v - dt u/m + dt μ g tanh(v'/ε)|`, the residual of the implicit step, relative to
/// a bound on its rounding error.
fn residual<R: Real>(slider: &SliderSystem, v: f64, u: f64) -> f64 {
    let next = step(slider, &[R::zero(), R::from(v)], R::from(u))[1].lane(0).to_f64();
    let [v, u] = [v, u].map(|number| R::from(number).lane(0).to_f64());
    let b = slider.grip();
    let y = next / slider.smoothing;
    let off = next - v - slider.dt * u / slider.mass + b * Scalar::tanh(y);
    // Bound on the rounding of v', v + dt u/m and tanh.
    let rounding = <R::Real as Float>::EPSILON
        * (v.abs() + (slider.dt * u / slider.mass).abs() + b + b * y.abs().min(1.0));
    off.abs() / rounding
}

#[test]
fn implicit_friction_solves_its_equation() {
    let sharp = [1e-8, 1e-9].map(|smoothing| SliderSystem { smoothing, ..SliderSystem::default() });
    for slider in sliders().filter(|slider| slider.scheme == FrictionScheme::Implicit).chain(sharp)
    {
        let b = slider.grip();
        // Initial speeds for sliding, creeping and rest. Then speeds next to b, the largest change
        // of speed by friction in one step.
        let starts = [10.0, 1.0, 3.0 * b, b, 0.5 * b, 1e-3, 1e-6, 1e-12, 0.0].into_iter();
        let edges = [-1e-3, -1e-6, -1e-12, 1e-12, 1e-6, 1e-3].map(|off| b * (1.0 + off));
        for v in starts.chain(edges).flat_map(|v| [v, -v]) {
            for u in [0.0, 3.0, -40.0] {
                let (double, single) =
                    (residual::<f64>(&slider, v, u), residual::<Single<f32>>(&slider, v, u));
                assert!(
                    double < 8.0 && single < 8.0,
                    "{slider:?} at {v}, {u}: {double} and {single} roundings"
                );
            }
            let forward = step(&slider, &[0.0, v], 3.0)[1];
            assert_eq!(
                forward,
                -step(&slider, &[0.0, -v], -3.0)[1],
                "the step is not odd in speed and force"
            );
        }
    }
}

#[test]
fn derivatives_of_implicit_friction_equal_finite_differences() {
    for smoothing in [1e-1, 1e-2, 1e-3] {
        let slider = SliderSystem { smoothing, ..SliderSystem::default() };
        for v in [0.0, 1e-3, slider.grip(), 0.06, 1.0] {
            near(
                &jacobian(&slider, &[0.2, v], 0.4),
                &differences(&slider, &[0.2, v], 0.4, 1e-3 * smoothing),
                1e-5,
            );
        }
    }
}

#[test]
fn explicit_and_implicit_friction_converge_to_each_other_with_order_1() {
    let after = |scheme, dt: f64| {
        let slider = SliderSystem { smoothing: 0.1, dt, scheme, ..SliderSystem::default() };
        run(&slider, &[0.0, 1.0], 0.5, (0.3 / dt).round() as usize)
    };
    let difference = |dt| {
        (after(FrictionScheme::Explicit, dt)[0] - after(FrictionScheme::Implicit, dt)[0]).abs()
    };
    let (coarse, fine) = (difference(1e-3), difference(1e-4));
    assert!(fine < 1e-4 && (9.0..11.0).contains(&(coarse / fine)), "{coarse:e}, {fine:e}");
}

#[test]
fn a_push_below_the_friction_does_not_move_a_block() {
    let slider = SliderSystem { smoothing: 1e-6, ..SliderSystem::default() };
    let hold = slider.mass * slider.grip() / slider.dt;
    assert!(run(&slider, &[0.0, 0.0], 0.99 * hold, 100)[0] < 1e-5);
    assert!(run(&slider, &[0.0, 0.0], 1.01 * hold, 100)[0] > 0.02);
}

fn balls() -> [BouncingBall; 4] {
    let ball = BouncingBall { mass: 0.7, ..BouncingBall::default() };
    [0.0, 0.8, 1.0]
        .map(|restitution| Contact::TimeOfImpact { restitution })
        .into_iter()
        .chain([SPRING])
        .map(|contact| BouncingBall { contact, ..ball })
        .collect::<Vec<_>>()
        .try_into()
        .expect("four")
}

fn pairs() -> [TwoBodies; 4] {
    [
        TwoBodies::balls(),
        TwoBodies::pusher(),
        TwoBodies { contact: SPRING, ..TwoBodies::balls() },
        TwoBodies { contact: Contact::TimeOfImpact { restitution: 0.5 }, ..TwoBodies::pusher() },
    ]
}

#[test]
fn derivatives_of_contacts_of_every_kind_equal_dual_numbers() {
    for ball in balls() {
        check::system(&ball).unwrap();
        let passed = check::system_at(&ball, |rng, x, u, _| {
            x[0] = rng.random_range(0.0..0.02);
            x[1] = rng.random_range(-3.0..0.5);
            u[0] = rng.random_range(-5.0..5.0);
        });
        passed.unwrap_or_else(|mismatch| panic!("{ball:?}: {mismatch}"));
    }
    for pair in pairs() {
        check::system(&pair).unwrap();
        let passed = check::system_at(&pair, |rng, x, u, _| {
            x[0] = rng.random_range(-1.0..1.0);
            x[1] = x[0] + pair.contact_distance + rng.random_range(0.0..0.02);
            x[2] = rng.random_range(0.0..3.0);
            x[3] = rng.random_range(-3.0..0.0);
            u[0] = rng.random_range(-5.0..5.0);
        });
        passed.unwrap_or_else(|mismatch| panic!("{pair:?}: {mismatch}"));
    }
}

#[test]
fn gradients_of_rollouts_equal_dual_numbers_in_every_flow() {
    for scheme in [FrictionScheme::Explicit, FrictionScheme::Implicit] {
        let system = SliderSystem { scheme, smoothing: 0.03, ..SliderSystem::default() };
        check::task(&Slider { system, horizon: 40, ..Slider::default() }, &Mlp::new([2, 8, 1]))
            .unwrap();
    }
    for system in balls() {
        check::task(&Bounce { system, horizon: 60, ..Bounce::default() }, &Mlp::new([2, 8, 1]))
            .unwrap();
    }
    for system in pairs() {
        check::task(&Push { system, horizon: 60 }, &Mlp::new([4, 8, 1])).unwrap();
    }
}

#[test]
fn bounces_in_steps_of_0_4_s_and_0_0125_s_agree_to_1e_12() {
    for restitution in [0.5, 0.8, 1.0] {
        let after = |dt: f64| {
            let ball = BouncingBall {
                contact: Contact::TimeOfImpact { restitution },
                dt,
                ..BouncingBall::default()
            };
            run(&ball, &[1.0, -0.5], 2.0, (1.2 / dt).round() as usize)
        };
        let [long, short] = [0.4, 0.0125].map(after);
        assert!(
            (long[0] - short[0]).abs() < 1e-12 && (long[1] - short[1]).abs() < 1e-12,
            "{long:?}, {short:?}"
        );
    }
}

#[test]
fn an_elastic_ball_keeps_its_energy_for_1e5_steps() {
    let ball = BouncingBall {
        contact: Contact::TimeOfImpact { restitution: 1.0 },
        ..BouncingBall::default()
    };
    let energy = |x: &[f64]| 9.81 * x[0] + 0.5 * x[1] * x[1];
    let after = run(&ball, &[1.0, 0.3], 0.0, 100_000);
    assert!((energy(&after) / energy(&[1.0, 0.3]) - 1.0).abs() < 1e-10, "{after:?}");
}

#[test]
fn a_ball_comes_to_rest_after_infinitely_many_bounces() {
    let ball = BouncingBall {
        contact: Contact::TimeOfImpact { restitution: 0.5 },
        ..BouncingBall::default()
    };
    // Falls for sqrt(2 h/g), then bounces for 2 e/(1 - e) times as long.
    let rest = f64::sqrt(2.0 / 9.81) * (1.0 + 2.0 * 0.5 / (1.0 - 0.5));
    let steps = (rest / ball.dt) as usize;
    assert!(run(&ball, &[1.0, 0.0], 0.0, steps - 4)[0] > 0.0, "the ball is at rest too early");
    assert_eq!(run(&ball, &[1.0, 0.0], 0.0, steps + 1), [0.0, 0.0]);
    // At rest without force, the derivatives with respect to state and force are 0. With a force of
    // 15 N, which exceeds the weight of 9.81 N, the derivatives are those of free motion.
    near(&jacobian(&ball, &[0.0, 0.0], 0.0), &[vec![0.0; 3], vec![0.0; 3]], 0.0);
    near(
        &jacobian(&ball, &[0.0, 0.0], 15.0),
        &[vec![1.0, 0.01, 5e-5], vec![0.0, 1.0, 0.01]],
        1e-14,
    );
}

#[test]
fn derivatives_of_steps_with_0_to_4_impacts_equal_finite_differences() {
    // Initial height and velocity, and the number of impacts.
    let impacts = [(1.0, 0.0, 0), (0.2, 0.0, 1), (0.06, 0.0, 2), (0.03, -0.2, 3), (0.02, 0.0, 4)];
    for (h, v, count) in impacts {
        let ball = BouncingBall {
            contact: Contact::TimeOfImpact { restitution: 0.8 },
            dt: 0.33,
            ..BouncingBall::default()
        };
        let fall = f64::sqrt(v * v + 2.0 * 9.81 * h);
        let times = (0..).scan(((v + fall) / 9.81, fall), |(time, speed), _| {
            let now = *time;
            *speed *= 0.8;
            *time += 2.0 * *speed / 9.81;
            Some(now)
        });
        assert_eq!(times.take_while(|&time| time < ball.dt).count(), count, "from {h} m");
        near(&jacobian(&ball, &[h, v], 0.0), &differences(&ball, &[h, v], 0.0, 1e-7), 1e-5);
    }
}

#[test]
fn a_ball_within_rounding_of_the_floor_has_the_derivative_of_an_impact() {
    let ball = BouncingBall::default();
    for h in [1e-17, 0.0, -1e-17] {
        let by_height = jacobian(&ball, &[h, -2.0], 0.0)[0][0];
        // ∂h'/∂h = e (g dt / s - 1) + g dt / s for an impact at the speed s, with the whole step dt
        // remaining.
        let expected = 0.8 * (0.0981 / 2.0 - 1.0) + 0.0981 / 2.0;
        assert!((by_height - expected).abs() < 1e-12, "{h:e}: {by_height} is not {expected}");
    }
}

#[test]
fn nan_in_state_or_force_gives_nan() {
    for ball in balls() {
        for x in [[f64::NAN, 0.0], [0.5, f64::NAN], [0.0, f64::NAN]] {
            assert!(step(&ball, &x, 0.0).iter().any(|x| x.is_nan()), "{ball:?} at {x:?}");
        }
        assert!(step(&ball, &[0.0, 0.0], f64::NAN).iter().any(|x| x.is_nan()), "{ball:?}");
    }
    for slider in sliders() {
        assert!(
            step(&slider, &[0.0, f64::NAN], 0.0)[1].is_nan()
                && step(&slider, &[0.0, 0.0], f64::NAN)[1].is_nan()
        );
    }
}

#[test]
fn momentum_changes_only_by_the_force_and_equal_balls_exchange_speeds() {
    for pair in pairs() {
        let momentum = |x: &[f64]| pair.masses[0] * x[2] + pair.masses[1] * x[3];
        let after = run(&pair, &[0.0, 0.3, 2.0, -0.5], 0.7, 80);
        let expected = momentum(&[0.0, 0.3, 2.0, -0.5]) + 0.7 * 0.8;
        assert!((momentum(&after) - expected).abs() < 1e-12, "{pair:?}");
        assert!(
            after[1] - after[0] > pair.contact_distance - 0.1 && after[3] > 0.0,
            "{pair:?}: {after:?}"
        );
    }
    let after = run(&TwoBodies::balls(), &[0.0, 0.3, 2.0, -0.5], 0.0, 50);
    assert!((after[2] + 0.5).abs() < 1e-13 && (after[3] - 2.0).abs() < 1e-13, "{after:?}");
}

#[test]
fn a_pusher_pushes_a_box_and_does_not_pull_it() {
    let pair = TwoBodies::pusher();
    let pushed = run(&pair, &[0.0, 0.2, 0.0, 0.0], 6.0, 60);
    assert!(
        (pushed[1] - pushed[0] - pair.contact_distance).abs() < 1e-13
            && (pushed[3] - pushed[2]).abs() < 1e-13
    );
    let pulled = run(&pair, &pushed, -6.0, 30);
    assert!(
        pulled[1] - pulled[0] > pair.contact_distance + 0.1
            && (pulled[3] - pushed[3]).abs() < 1e-13
    );
    // The pushed pair moves as one body of 3 kg.
    let slopes = jacobian(&pair, &pushed, 6.0);
    assert!((slopes[3][4] - 0.01 / 3.0).abs() < 1e-15 && (slopes[3][2] - 1.0 / 3.0).abs() < 1e-15);
}
