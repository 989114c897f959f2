//! Double pendulum, chain of poles, linear plants, friction and impacts.

use super::mechanism::*;
use super::*;

/// Compares rates and energy of an [`Ode`] with a mechanism. Compares the derivatives of a
/// semi-implicit step with dual numbers. Positions and speeds alternate in the state.
#[track_caller]
fn moves_as<O: Ode + Clone>(
    what: &str,
    ode: O,
    energy: impl Fn(&[f64]) -> f64,
    mechanism: &Mechanism,
) {
    for (x, u) in states(ode.state_dim(), 1) {
        let mut applied = vec![0.0; x.len() / 2];
        applied[0] = u[0];
        let expected: Vec<f64> = mechanism
            .accelerations(&x, &applied)
            .iter()
            .zip(x.chunks_exact(2))
            .flat_map(|(a, pair)| [pair[1], *a])
            .collect();
        let mut rate = vec![f64::NAN; x.len()];
        ode.rate(Inputs::new(&x, &u).continuous(0.0), &mut rate);
        near(what, &rate, &expected);
        near(&format!("energy of a {what}"), &[energy(&x)], &[mechanism.energy(&x)]);
    }
    let passed = check::system(&physgrad::Integrated {
        ode,
        integrator: physgrad::integrator::SemiImplicit,
        dt: 0.02,
    });
    passed.unwrap_or_else(|mismatch| panic!("{what}: {mismatch}"));
}

#[test]
fn a_double_pendulum_moves_as_two_point_masses() {
    let pendulum = DoublePendulum { masses: [1.3, 0.4], lengths: [0.7, 1.1], gravity: 9.1 };
    let points =
        vec![Point { mass: 1.3, arms: vec![0.7, 0.0] }, Point { mass: 0.4, arms: vec![0.7, 1.1] }];
    let mechanism = Mechanism { points, cart: false, gravity: 9.1 };
    moves_as("double pendulum", pendulum, |x| pendulum.energy(x), &mechanism);
}

/// Returns rigid arms with the given joint friction `[viscous, dry, quadratic]`, and equivalent
/// point masses without friction.
///
/// Each arm corresponds to two points, at `center ± sqrt(inertia / mass)`. Each point has half of
/// the mass of the arm.
fn rigid_arms(friction: [f64; 3]) -> (MultiPendulum, Mechanism) {
    let sizes = [[1.3, 0.4, 0.7, 0.05], [0.6, 0.5, 0.9, 0.11], [0.8, 0.3, 0.2, 0.02]];
    let [viscous, dry, quadratic] = friction.map(PhysicalNumber::from);
    let arm = |[mass, center, length, inertia]: [f64; 4]| {
        let [mass, center, length, inertia] =
            [mass, center, length, inertia].map(PhysicalNumber::from);
        Arm { mass, center, length, inertia, viscous, dry, quadratic }
    };
    let points = sizes.into_iter().enumerate().flat_map(|(i, [mass, center, _, inertia])| {
        [-1.0, 1.0].map(|side| {
            let mut arms: Vec<f64> = sizes.iter().map(|size| size[2]).collect();
            arms[i] = center + side * (inertia / mass).sqrt();
            arms[i + 1..].fill(0.0);
            Point { mass: 0.5 * mass, arms }
        })
    });
    let mechanism = Mechanism { points: points.collect(), cart: false, gravity: 9.1 };
    (MultiPendulum { arms: sizes.map(arm).into(), gravity: 9.1.into() }, mechanism)
}

#[test]
fn a_pendulum_of_rigid_arms_moves_as_pairs_of_point_masses() {
    let (pendulum, mechanism) = rigid_arms([0.0; 3]);
    moves_as("pendulum", pendulum.clone(), |x| pendulum.energy(x), &mechanism);
}

#[test]
fn friction_of_a_joint_acts_on_both_arms() {
    let (pendulum, mechanism) = rigid_arms([0.2, 0.3, 0.4]);
    for (x, u) in states(6, 1) {
        let speeds: Vec<f64> = x.chunks_exact(2).map(|pair| pair[1]).collect();
        // The support does not turn. The library smooths dry friction below 0.01 rad/s.
        let torque = |r: f64| -(0.2 * r + 0.3 * (r / 0.01).tanh() + 0.4 * r * r.abs());
        let joints =
            [torque(speeds[0]), torque(speeds[1] - speeds[0]), torque(speeds[2] - speeds[1])];
        let applied = [u[0] + joints[0] - joints[1], joints[1] - joints[2], joints[2]];
        let accelerations = mechanism.accelerations(&x, &applied);
        let expected: Vec<f64> =
            speeds.iter().zip(accelerations).flat_map(|(&speed, a)| [speed, a]).collect();
        let mut rate = vec![f64::NAN; 6];
        pendulum.rate(Inputs::new(&x, &u).continuous(0.0), &mut rate);
        near("pendulum with friction", &rate, &expected);
    }
}

#[test]
fn a_chain_of_poles_moves_as_uniform_rods_end_to_end() {
    for poles in [1, 2, 4] {
        let chain = PoleChain(model(poles));
        moves_as("chain", chain, |x| chain.energy(x), &on_cart(&model(poles), true));
    }
}

#[test]
fn linear_plants_equal_a_damped_spring_and_a_linearized_pole() {
    // Mass 1 kg, stiffness 1 N/m, damping 0.4 N s/m, steps of 0.1 s.
    let spring = Lqr::spring();
    steps_as("spring", spring.system(), |x, u| semi_implicit(x, &[u[0] - x[0] - 0.4 * x[1]], 0.1));
    // Equations linearized in θ, ω, F about 0.
    let [cart_mass, pole_mass, l, gravity] = CartPoleSystem::default().nominal();
    let dt = CartPoleSystem::default().dt;
    let (mass, moment, inertia) =
        (cart_mass + pole_mass, pole_mass * l, 4.0 / 3.0 * pole_mass * l * l);
    steps_as("upright pole", Lqr::upright_cart_pole().system(), |x, u| {
        let right = vec![u[0], moment * gravity * x[2]];
        semi_implicit(x, &solve(vec![vec![mass, moment], vec![moment, inertia]], right), dt)
    });
}

#[test]
fn a_block_slides_with_smoothed_coulomb_friction() {
    let slider = SliderSystem {
        mass: 1.7,
        coefficient: 0.6,
        smoothing: 0.8,
        dt: 0.05,
        scheme: FrictionScheme::Explicit,
    };
    // Newton's law with friction μ m g tanh(v / ε).
    let friction = |v: f64| 0.6 * 1.7 * 9.81 * (v / 0.8).tanh();
    steps_as("explicit", &slider, |x, u| semi_implicit(x, &[(u[0] - friction(x[1])) / 1.7], 0.05));
    let implicit = SliderSystem { scheme: FrictionScheme::Implicit, ..slider };
    steps_as("implicit", &implicit, |x, u| {
        // Friction acts at the new speed. Bisection of an increasing function finds this speed.
        let missing = |v: f64| v - x[1] - 0.05 * (u[0] - friction(v)) / 1.7;
        let (mut low, mut high) = (-100.0, 100.0);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if missing(middle) < 0.0 { low = middle } else { high = middle }
        }
        vec![x[0] + 0.05 * low, low]
    });
}

/// Returns position and speed of a body under constant acceleration.
fn fall(place: f64, speed: f64, acceleration: f64, time: f64) -> [f64; 2] {
    [place + speed * time + 0.5 * acceleration * time * time, speed + acceleration * time]
}

/// Returns the time after which a body at `height` > 0 reaches the height 0. The result is NaN,
/// negative or infinite if the body never reaches it.
fn landing(height: f64, speed: f64, acceleration: f64) -> f64 {
    2.0 * height / ((speed * speed - 2.0 * acceleration * height).sqrt() - speed)
}

#[test]
fn steps_of_a_ball_equal_formulas_of_fall_impact_and_spring() {
    let (mass, gravity, dt) = (0.7, 9.3, 0.1);
    let ball = |contact| BouncingBall { mass, gravity, contact, dt };
    let bouncing = ball(Contact::TimeOfImpact { restitution: 0.6 });
    let springy = ball(Contact::Penalty { stiffness: 30.0, damping: 0.2 });
    let mut landed = 0;
    for (x, u) in states(2, 1) {
        let acceleration = u[0] / mass - gravity;
        let height = 0.1 * x[0].abs();
        let time = landing(height, x[1], acceleration);
        let expected = if time < dt {
            landed += 1;
            let speed = -0.6 * (x[1] + acceleration * time);
            // Holds if the ball does not land again. Otherwise, the height is negative, and the
            // test skips the case.
            fall(0.0, speed, acceleration, dt - time)
        } else {
            fall(height, x[1], acceleration, dt)
        };
        if expected[0] >= 0.0 {
            near("bounce", &step(&bouncing, &[height, x[1]], &u), &expected);
        }
        // The force of the floor enters as in semi-implicit Euler. The acceleration by gravity and
        // control is constant.
        let kick = dt / mass * 30.0 * (-x[0]).max(0.0) * (1.0 - 0.2 * x[1]).max(0.0);
        let [place, speed] = fall(x[0], x[1], acceleration, dt);
        near("spring", &step(&springy, &x, &u), &[place + dt * kick, speed + kick]);
    }
    assert!(landed > 20, "{landed}");
}

#[test]
fn steps_of_two_bodies_equal_formulas_of_impact_and_spring() {
    let ([m1, m2], dt) = ([1.2, 0.5], 0.1);
    let pair = |contact| TwoBodies { masses: [m1, m2], contact_distance: 0.3, contact, dt };
    let elastic = pair(Contact::TimeOfImpact { restitution: 0.6 });
    let springy = pair(Contact::Penalty { stiffness: 30.0, damping: 0.2 });
    let mut hits = 0;
    for (x, u) in states(4, 1) {
        let push = u[0] / m1;
        let x = [x[0], x[0] + 0.3 + x[1].abs() * 0.2, x[2], x[3]];
        let (gap, speed) = (x[1] - x[0] - 0.3, x[3] - x[2]);
        let time = landing(gap, speed, -push);
        let [a, va] = fall(x[0], x[2], push, dt);
        let mut expected = [a, x[1] + dt * x[3], va, x[3]];
        if time > 0.0 && time < dt {
            hits += 1;
            let ([a, va], b) = (fall(x[0], x[2], push, time), x[1] + time * x[3]);
            // Momentum is conserved, and the bodies separate with 0.6 of their approach speed.
            let (center, separation) = ((m1 * va + m2 * x[3]) / (m1 + m2), 0.6 * (va - x[3]));
            let (after, other) =
                (center - m2 / (m1 + m2) * separation, center + m1 / (m1 + m2) * separation);
            let [a, va] = fall(a, after, push, dt - time);
            expected = [a, b + (dt - time) * other, va, other];
        }
        // Skips pairs that collide twice.
        if expected[1] - expected[0] >= 0.3 {
            near("hit", &step(&elastic, &x, &u), &expected);
        }
        let x = [x[0], x[0] + 0.1, x[2], x[3]];
        let force = 30.0 * 0.2 * (1.0 - 0.2 * (x[3] - x[2])).max(0.0);
        let [a, va] = fall(x[0], x[2], push, dt);
        let (back, on) = (dt * force / m1, dt * force / m2);
        near(
            "spring",
            &step(&springy, &x, &u),
            &[a - dt * back, x[1] + dt * x[3] + dt * on, va - back, x[3] + on],
        );
    }
    assert!(hits > 5, "{hits}");
}
