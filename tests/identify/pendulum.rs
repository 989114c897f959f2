//! The pendulum of several arms.

use physgrad::integrator::RungeKutta;
use physgrad::tasks::{Arm, MultiPendulum};
use physgrad::{Integrated, Number, Ode, OdeInputs, System, check};

/// Returns an arm without symmetry, with all numbers proportional to `scale`. If `varied`, each
/// number is uniform within 20 % of its value.
fn arm(scale: f64, varied: bool) -> Arm {
    let number = |value: f64| {
        let value = scale * value;
        if varied {
            Number::Uniform { low: 0.8 * value, high: 1.2 * value }
        } else {
            Number::Fixed(value)
        }
    };
    Arm {
        mass: number(0.3),
        center: number(0.11),
        length: number(0.25),
        inertia: number(2e-3),
        viscous: number(1e-3),
        dry: number(2e-3),
        quadratic: number(3e-4),
    }
}

#[test]
fn derivatives_are_exact_also_by_all_numbers() {
    for arms in 1..=3 {
        let arms: Vec<Arm> = (0..arms).map(|i| arm(1.0 + 0.2 * f64::from(i), true)).collect();
        let ode = MultiPendulum { arms, gravity: Number::Uniform { low: 9.0, high: 10.0 } };
        check::system(&Integrated { ode, integrator: RungeKutta::RK4, dt: 0.01 }).unwrap();
    }
}

/// θ'' = (m g a sin θ - friction + u) / (I + m a²). The center of mass is at the distance a from
/// the joint, and I is the moment of inertia about this center.
#[test]
fn one_arm_is_a_physical_pendulum() {
    let ode = MultiPendulum { arms: vec![arm(1.0, false)], gravity: 9.7.into() };
    let (x, u) = ([0.7, 1.3], [0.02]);
    let mut rate = [0.0; 2];
    ode.rate::<f64>(OdeInputs { x: &x, u: &u, p: &[], t: 0.0 }, &mut rate);
    let friction = 1e-3 * 1.3 + 2e-3 * (1.3_f64 / 0.01).tanh() + 3e-4 * 1.3 * 1.3;
    let expected =
        (0.3 * 9.7 * 0.11 * 0.7_f64.sin() - friction + 0.02) / (2e-3 + 0.3 * 0.11 * 0.11);
    assert_eq!(rate[0], 1.3);
    assert!((rate[1] - expected).abs() < 1e-13 * expected.abs(), "{} {expected}", rate[1]);
}

/// Principle of d'Alembert: the virtual power of inertia and gravity is 0 for each angle. The
/// accelerations are second time derivatives of the positions.
#[test]
fn three_arms_satisfy_the_principle_of_dalembert() {
    let mut arms: Vec<Arm> = [1.0, 1.3, 0.8].map(|scale| arm(scale, false)).into();
    arms.iter_mut().for_each(|arm| {
        (arm.viscous, arm.dry, arm.quadratic) = (0.0.into(), 0.0.into(), 0.0.into())
    });
    let ode = MultiPendulum { arms: arms.clone(), gravity: 9.81.into() };
    let x = [0.4, 1.7, -1.1, -2.1, 2.3, 0.9];
    let mut rate = [0.0; 6];
    ode.rate::<f64>(OdeInputs { x: &x, u: &[0.0], p: &[], t: 0.0 }, &mut rate);
    // Acceleration of the center of arm k, minus that of gravity, from r = Σ l (sin θ, cos θ).
    let length = |k: usize, j: usize| {
        if j < k { arms[j].length.nominal() } else { arms[j].center.nominal() }
    };
    for i in 0..3 {
        let mut power = arms[i].inertia.nominal() * rate[2 * i + 1];
        for (k, arm) in arms.iter().enumerate().skip(i) {
            let acceleration = (0..=k).fold([0.0, 9.81], |[across, up], j| {
                let ((sin, cos), l) = (x[2 * j].sin_cos(), length(k, j));
                let (alpha, spin) = (rate[2 * j + 1], x[2 * j + 1] * x[2 * j + 1]);
                [across + l * (cos * alpha - sin * spin), up - l * (sin * alpha + cos * spin)]
            });
            let (sin, cos) = x[2 * i].sin_cos();
            power +=
                arm.mass.nominal() * length(k, i) * (cos * acceleration[0] - sin * acceleration[1]);
        }
        assert!(power.abs() < 1e-14, "arm {i}: {power}");
    }
}

/// RK4 conserves the energy up to its order: a quarter of the step divides the drift by 256 or
/// more.
#[test]
fn energy_is_conserved_without_friction() {
    let mut arms: Vec<Arm> = [1.0, 1.3, 0.8].map(|scale| arm(scale, false)).into();
    arms.iter_mut().for_each(|arm| {
        (arm.viscous, arm.dry, arm.quadratic) = (0.0.into(), 0.0.into(), 0.0.into())
    });
    let ode = MultiPendulum { arms, gravity: 9.81.into() };
    let drift = |dt: f64| {
        let system = Integrated { ode: ode.clone(), integrator: RungeKutta::RK4, dt };
        let mut x = vec![1.0, 0.0, 1.5, 0.0, 2.0, 0.0];
        let energy = ode.energy(&x);
        for t in 0..(0.5 / dt).round() as usize {
            let mut next = x.clone();
            system.step::<f64>(physgrad::Inputs { x: &x, u: &[0.0], p: &[], t }, &mut next);
            x = next;
        }
        (ode.energy(&x) - energy).abs()
    };
    let (coarse, fine) = (drift(0.008), drift(0.002));
    assert!(coarse < 1e-4 && fine < coarse / 256.0, "{coarse} {fine}");
}
