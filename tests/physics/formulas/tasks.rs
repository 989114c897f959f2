//! Costs, ranges of initial states, defaults.

use super::mechanism::model;
use super::quantum::GRID;
use super::*;

/// Compares running and terminal costs, and their gradients, with formulas.
#[track_caller]
fn costs<T: Task>(
    what: &str,
    task: &T,
    running: impl Fn(&[f64], &[f64]) -> f64,
    terminal: impl Fn(&[f64]) -> f64,
) {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    for (x, u) in states(n, m) {
        near(
            what,
            &[task.running_cost(Inputs::new(&x, &u), &x), task.terminal_cost(&x, &[])],
            &[running(&x, &u), terminal(&x)],
        );
        let (mut x_bar, mut u_bar, mut last_bar) = (vec![0.0; n], vec![0.0; m], vec![0.0; n]);
        task.running_cost_gradient(
            Inputs::new(&x, &u),
            &x,
            Cotangents { u: Some(&mut u_bar), ..Cotangents::default() },
            &mut x_bar,
        );
        task.terminal_cost_gradient(&x, &[], &mut last_bar, None);
        let by_slopes =
            slopes(|xu| vec![running(&xu[..n], &xu[n..])], &[&x[..], &u].concat()).concat();
        near_slopes(what, &[x_bar, u_bar].concat(), &by_slopes);
        near_slopes(what, &last_bar, &slopes(|x| vec![terminal(x)], &x).concat());
    }
}

/// Calls [`costs`], and compares the gradients of whole rollouts with dual numbers.
#[track_caller]
fn costs_of<T: Task>(
    what: &str,
    task: &T,
    running: impl Fn(&[f64], &[f64]) -> f64,
    terminal: impl Fn(&[f64]) -> f64,
) {
    costs(what, task, running, terminal);
    check::task(task, &Linear::new(task.system().state_dim(), task.system().control_dim()))
        .unwrap();
}

#[test]
fn costs_equal_their_formulas() {
    let none = |_: &[f64], _: &[f64]| 0.0;
    let height = |angles: &[f64]| {
        angles.iter().map(|theta| 1.0 - theta.cos()).sum::<f64>() / angles.len() as f64
    };
    let swing = CartPole { horizon: 5, ..CartPole::with_system(model(2)) };
    costs_of("last angles", &swing, none, |x| height(&[x[2], x[4]]));
    let all = CartPole { loss: LossMode::Running, ..swing };
    costs_of("all angles", &all, |x, _| height(&[x[2], x[4]]) / 5.0, |_| 0.0);

    let upright = Upright { horizon: 5, control_weight: 0.3, ..Upright::double_pendulum() };
    costs_of("upright", &upright, |_, u| 0.3 * u[0] * u[0] / 2.0 / 5.0, |x| height(&[x[0], x[2]]));
    let held = Upright { loss: LossMode::Running, ..upright };
    costs_of(
        "held",
        &held,
        |x, u| (height(&[x[0], x[2]]) + 0.3 * u[0] * u[0] / 2.0) / 5.0,
        |_| 0.0,
    );
    let chain = Upright { horizon: 5, ..Upright::pole_chain(2) };
    costs_of("chain", &chain, none, |x| height(&[x[2], x[4]]));

    let herding = Guidance {
        horizon: 5,
        regularization: 0.7,
        loss: LossMode::Terminal,
        ..Guidance::new(2, 3)
    };
    let control_weight = |u: &[f64]| 0.7 * u.iter().map(|u| u * u).sum::<f64>() / 4.0 / 5.0;
    let away = |x: &[f64]| {
        x[8..].chunks_exact(4).map(|agent| agent[0] * agent[0] + agent[1] * agent[1]).sum::<f64>()
            / 6.0
    };
    costs_of("herding", &herding, |_, u| control_weight(u), away);
    let always = Guidance { loss: LossMode::Running, ..herding };
    costs_of("herding always", &always, |x, u| control_weight(u) + away(x) / 5.0, |_| 0.0);

    let quantum = Quantum {
        horizon: 3,
        loss: LossMode::Terminal,
        ..Quantum::with_system(QuantumSystem { grid: GRID, ..Default::default() }, 2)
    };
    let missing = |x: &[f64]| {
        let phi: Vec<f64> = (1..=GRID).map(|j| 0.5 * (2.0 * PI * j as f64 / 8.0).sin()).collect();
        let part = |part: usize| {
            phi.iter().zip(x.chunks_exact(2)).map(|(phi, psi)| phi * psi[part]).sum::<f64>()
        };
        1.0 - part(0).powi(2) - part(1).powi(2)
    };
    costs("infidelity", &quantum, none, missing);
    check::task(&quantum, &Conv::new(GRID, 2)).unwrap();
    let every = Quantum { loss: LossMode::Running, ..quantum };
    costs("infidelity always", &every, |x, _| missing(x), |_| 0.0);
    check::task(&every, &Conv::new(GRID, 2)).unwrap();

    let slider = Slider { speed_weight: 0.3, horizon: 5, ..Slider::default() };
    costs_of("slider", &slider, none, |x| x[0] * x[0] + 0.3 * x[1] * x[1]);
    let bounce = Bounce { target: 1.4, horizon: 5, ..Bounce::default() };
    costs_of("bounce", &bounce, none, |x| (x[0] - 1.4) * (x[0] - 1.4));
    costs_of("push", &Push { horizon: 5, ..Push::default() }, none, |x| x[1] * x[1]);

    let reach = Reach { target: 1.4, ..Reach::default() };
    costs_of("reach", &reach, none, |x| (x[0] - 1.4) * (x[0] - 1.4) / 2.0);
    let bowl = Bowl { curvatures: [1.3, 3.1], angle: 0.4, ..Bowl::default() };
    costs_of("bowl", &bowl, none, |x| {
        let (sin, cos) = 0.4_f64.sin_cos();
        let (along, across) = (cos * x[0] + sin * x[1], cos * x[1] - sin * x[0]);
        (1.3 * along * along + 3.1 * across * across) / 2.0
    });

    // The running cost is (|x|² + u²) dt / 2, where x is the state after the step. The terminal
    // cost is the minimal remaining cost and therefore satisfies Bellman's equation.
    for (mut lqr, dt) in [(Lqr::spring(), 0.1), (Lqr::upright_cart_pole(), 0.01)] {
        let cost = |x: &[f64], u: &[f64]| dt * 0.5 * x.iter().chain(u).map(|x| x * x).sum::<f64>();
        lqr.horizon = 5;
        costs_of("regulator", &lqr, cost, |x| {
            let gain = &lqr.optimum().gain;
            let u = [gain.iter().zip(x).map(|(gain, x)| gain * x).sum::<f64>()];
            let next = step(lqr.system(), x, &u);
            cost(&next, &u) + lqr.terminal_cost(&next, &[])
        });
    }
}

/// Returns minimum and maximum of `of` over many initial states.
fn range<T: Task>(task: &T, of: impl Fn(&[f64]) -> f64) -> [f64; 2] {
    let mut rng = stream(0, Purpose::Train, 0);
    let (n, len) = (task.system().state_dim(), task.system().state_dim() + task.param_dim());
    let mut all = vec![0.0; len];
    (0..4000).fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], _| {
        all.fill(0.0);
        let (x, p) = all.split_at_mut(n);
        task.start(&mut rng, Start { x, p });
        [least.min(of(&all)), most.max(of(&all))]
    })
}

/// Checks that 4000 draws stay within bounds and reach both bounds to within 1 % of the range.
/// Uniform draws do so with a probability of at least 1 - 2 · 0.99⁴⁰⁰⁰.
#[track_caller]
fn starts_within<T: Task>(what: &str, task: &T, low: f64, high: f64, of: impl Fn(&[f64]) -> f64) {
    let ([least, most], near) = (range(task, of), 0.01 * (high - low));
    assert!(least >= low && least < low + near, "the least {what} is {least}, not {low}");
    assert!(most <= high && most > high - near, "the largest {what} is {most}, not {high}");
}

#[test]
fn initial_states_span_the_documented_ranges() {
    let within = FRAC_PI_6;
    let swing = CartPole::new(1);
    for i in [0, 1, 3] {
        starts_within("cart", &swing, -1.0, 1.0, |x| x[i]);
    }
    starts_within("pole", &swing, PI - within, PI + within, |x| x[2]);
    let windy =
        Forced { system: model(1), effects: GustyWind { period: 1.7, ..GustyWind::default() } };
    starts_within("phase of the gusts", &CartPole::with_system(windy), 0.0, 1.7, |x| x[4]);
    starts_within("pendulum", &Upright::double_pendulum(), PI - within, PI + within, |x| x[2]);
    starts_within("rate", &Upright::double_pendulum(), -within, within, |x| x[3]);
    starts_within("held", &Upright::pole_chain(1).held(), -0.05, 0.05, |x| x[2]);
    starts_within("spring", &Lqr::spring(), -1.0, 1.0, |x| x[1]);
    starts_within("slider", &Slider::default(), -1.0, 1.0, |x| x[0]);
    starts_within("slider's speed", &Slider::default(), -2.0, 2.0, |x| x[1]);
    starts_within("ball", &Bounce::default(), 0.5, 1.5, |x| x[0]);
    starts_within("ball's speed", &Bounce::default(), -1.0, 1.0, |x| x[1]);
    starts_within("box", &Push::default(), -1.5, -0.5, |x| x[1]);
    starts_within("pusher's gap", &Push::default(), 0.1, 0.3, |x| x[1] - x[0] - 0.1);
    let herding = Guidance::new(1, 1);
    starts_within("driver", &herding, 3.0, 4.0, |x| x[0].hypot(x[1]));
    starts_within("driver's bearing", &herding, -PI, PI, |x| x[1].atan2(x[0]));
    assert_eq!(range(&Reach { start: 0.7, ..Reach::default() }, |x| x[0]), [0.7, 0.7]);
    // Bearings are uniformly distributed.
    evenly("driver's bearing", &herding, |x| x[1].atan2(x[0]));
    // Evaders are within half a metre of a common center, in x and in y.
    let many = Guidance::new(1, 40);
    let spread = range(&many, |x| {
        let xs: Vec<f64> = x[4..].chunks_exact(4).map(|agent| agent[0]).collect();
        xs.iter().fold(f64::MIN, |most, x| most.max(*x))
            - xs.iter().fold(f64::MAX, |least, x| least.min(*x))
    });
    assert!(spread[1] <= 1.0 && spread[1] > 0.99, "{spread:?}");
    let center = range(&many, |x| {
        let mean =
            |axis: usize| x[4..].chunks_exact(4).map(|agent| agent[axis]).sum::<f64>() / 40.0;
        mean(0).hypot(mean(1))
    });
    // The center is 1 m to 2 m from the origin. The mean of 40 evaders deviates from the center by
    // 0.046 m (standard deviation in x and in y).
    assert!((center[0] - 1.0).abs() < 0.2 && (center[1] - 2.0).abs() < 0.2, "{center:?}");
    // Initial states mix the eigenstates 1 and 2 with any share from 0 to 1.
    let mixture = Quantum::new(3);
    let share = |number: usize, x: &[f64]| {
        let part = |part| {
            mixture
                .system
                .eigenstate(number)
                .zip(x.chunks_exact(2))
                .map(|(phi, psi)| phi * psi[part])
                .sum::<f64>()
        };
        part(0).powi(2) + part(1).powi(2)
    };
    starts_within("ground state", &mixture, 0.0, 1.0, |x| share(1, x));
    let lopsided = Quantum { weighting: [2.0, 0.0], ..mixture };
    assert!(range(&lopsided, |x| share(1, x))[0] > 1.0 - ROUNDING);
    let [least, most] = range(&mixture, |x| share(1, x) + share(2, x));
    near("norm", &[least, most], &[1.0, 1.0]);
    // A negative amplitude shifts the phase by π. Doubling the phase removes this shift.
    evenly("phase", &lopsided, |x| 2.0 * x[1].atan2(x[0]));
}

/// Checks that an angle is uniform. The mean direction of 4000 uniform draws has a norm of about
/// 1/√4000 = 0.016. If the range is 10 % too long, the norm is 0.089.
#[track_caller]
fn evenly<T: Task>(what: &str, task: &T, angle: impl Fn(&[f64]) -> f64) {
    let (mut rng, mut sum) = (stream(0, Purpose::Train, 1), [0.0; 2]);
    for _ in 0..4000 {
        let mut x = vec![0.0; task.system().state_dim()];
        task.start(&mut rng, Start { x: &mut x, p: &mut [] });
        let (sin, cos) = angle(&x).sin_cos();
        sum = [sum[0] + cos, sum[1] + sin];
    }
    let length = sum[0].hypot(sum[1]) / 4000.0;
    assert!(length < 0.06, "{what}: the mean direction has the norm {length}");
}

/// Compares defaults with the documentation, the paper, and the authors' code.
#[test]
fn defaults_equal_the_documented_ones() {
    #[track_caller]
    fn is<T: Default + PartialEq + std::fmt::Debug>(expected: T) {
        assert_eq!(T::default(), expected);
    }
    // Barto, Sutton and Anderson 1983, except for steps of 0.01 s.
    is(CartPoleSystem {
        poles: 1,
        cart_mass: 1.0.into(),
        pole_mass: 0.1.into(),
        half_length: 0.5.into(),
        gravity: 9.8.into(),
        dt: 0.01,
    });
    is(PoleDamping { damping: (2e-3).into() });
    is(CartDamping { damping: 0.1.into() });
    is(DryFriction { force: 0.5.into(), smoothing: 0.05 });
    is(SteadyWind { speed: 3.0.into(), cart_drag: 0.06.into(), pole_drag: 0.013.into() });
    is(GustyWind {
        speed: 3.0.into(),
        gust: 2.0.into(),
        period: 1.0,
        cart_drag: 0.06.into(),
        pole_drag: 0.013.into(),
    });
    is(Bumpers { half_travel: 2.4, stiffness: 1e3.into(), damping: 0.5.into() });
    is(DoublePendulum { masses: [1.0, 1.0], lengths: [1.0, 1.0], gravity: 9.81 });
    // 60 steps in 4 s. Friction, spread, evade and flock have the constants of the authors' code.
    is(GuidanceSystem {
        drivers: 2,
        evaders: 4,
        center: Center::Sum,
        softening: 0.1,
        dt: 4.0 / 60.0,
    });
    is(Friction { drivers: 1.0, evaders: 4.0 });
    is(Spread { strength: 0.2 });
    is(Evade { strength: 15.0 });
    is(Flock { strength: 0.2, distance: 0.5 });
    is(Drive { strength: 0.2 });
    is(Obstacles {
        centers: vec![[1.0, 0.0], [-0.5, 0.85], [-0.5, -0.85]],
        radius: 0.5,
        stiffness: 10.0,
    });
    is(Walls { half_width: 6.0, half_height: 4.0, stiffness: 10.0 });
    // 128 steps in 8 units of time, a box of length 2.
    is(QuantumSystem { grid: 32, length: 2.0, dt: 8.0 / 128.0, control: ControlShape::Tilt });
    is(Harmonic { stiffness: 100.0, center: 0.0 });
    is(Barrier { height: 30.0, width: 0.1, center: 0.0 });
    is(DoubleWell { height: 30.0, separation: 1.2 });
    is(Cubic { strength: 5.0 });
    is(AbsorbingEdges { width: 0.2, strength: 10.0 });
    is(SliderSystem {
        mass: 1.0,
        coefficient: 0.5,
        smoothing: 1e-3,
        dt: 0.01,
        scheme: FrictionScheme::Implicit,
    });
    let slider = Slider::default();
    assert_eq!((slider.speed_weight, slider.horizon), (0.1, 100));
    is(BouncingBall {
        mass: 1.0,
        gravity: 9.81,
        contact: Contact::TimeOfImpact { restitution: 0.8 },
        dt: 0.01,
    });
    assert_eq!((Bounce::default().target, Bounce::default().horizon), (1.0, 100));
    let restitution = |restitution: f64| Contact::TimeOfImpact { restitution };
    assert_eq!(
        TwoBodies::balls(),
        TwoBodies {
            masses: [1.0, 1.0],
            contact_distance: 0.1,
            contact: restitution(1.0),
            dt: 0.01
        }
    );
    assert_eq!(
        TwoBodies::pusher(),
        TwoBodies {
            masses: [1.0, 2.0],
            contact_distance: 0.1,
            contact: restitution(0.0),
            dt: 0.01
        }
    );
    is(Reach { system: Accumulator { dim: 1 }, start: -0.3, target: 2.0, horizon: 4 });
    is(Bowl { system: Accumulator { dim: 2 }, curvatures: [1.0, 4.0], angle: FRAC_PI_6 });
    let (swing, chain) = (Upright::double_pendulum(), Upright::pole_chain(2));
    assert_eq!(
        (swing.system.dt, swing.control_weight, chain.system.dt, chain.system.ode.0.poles),
        (0.01, 0.0, 0.01, 2)
    );
    assert_eq!(swing.held().control_weight, 1e-3);
    assert_eq!((Guidance::new(1, 1).regularization, Quantum::new(3).weighting), (1.0, [1.0, 1.0]));
}
