//! Linear plants with a known optimum, the double pendulum, and the chain of poles: derivatives,
//! optimal gains, energies, and refused masses.

use physgrad::engine::Evaluation;
use physgrad::integrator::{ImplicitMidpoint, RungeKutta, SemiImplicit, Verlet};
use physgrad::policy::Linear;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    CartPoleSystem, CoupledCartPole, DoublePendulum, LinearPlant, LossMode, Lqr, MassError,
    NoOptimum, PoleChain, Upright,
};
use physgrad::{Inputs, Integrated, Ode, Substeps, System, Task, Weights, check};
use rand::RngExt;

fn chain(poles: usize) -> PoleChain {
    PoleChain(CartPoleSystem { poles, ..CartPoleSystem::default() })
}

fn unequal() -> DoublePendulum {
    DoublePendulum { masses: [1.3, 0.4], lengths: [0.7, 1.1], gravity: 9.81 }
}

/// Returns `len` random components within ±1.
fn random(len: usize, case: u64) -> Vec<f64> {
    let mut rng = stream(case, Purpose::Test, 0);
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

#[test]
fn derivatives_of_linear_plants_equal_dual_numbers() {
    let plant = LinearPlant::new(3, random(9, 0), random(6, 1));
    assert_eq!((plant.state_dim(), plant.control_dim()), (3, 2));
    check::system(&plant).unwrap();
    check::system(Lqr::upright_cart_pole().system()).unwrap();
    let mut cost = vec![0.0; 9];
    (0..3).for_each(|i| cost[4 * i] = 1.0 + i as f64);
    (cost[1], cost[3]) = (0.3, 0.3);
    let lqr = Lqr::new(plant, cost, vec![1.0, 0.2, 0.2, 0.5]).expect("a stabilizable plant");
    check::task(&lqr, &Linear::new(3, 2)).unwrap();
    check::task(&Lqr::spring(), &Linear::with_bias(2, 1)).unwrap();
}

#[test]
fn derivatives_of_pendulums_and_chains_equal_dual_numbers() {
    let dt = 0.01;
    check::system(&Integrated { ode: unequal(), integrator: RungeKutta::RK4, dt }).unwrap();
    check::system(&Integrated { ode: DoublePendulum::default(), integrator: SemiImplicit, dt })
        .unwrap();
    for poles in [1, 2, 3, 6, 20] {
        check::system(&Integrated { ode: chain(poles), integrator: SemiImplicit, dt }).unwrap();
    }
    check::system(&Integrated { ode: chain(3), integrator: RungeKutta::RK4, dt }).unwrap();
    check::system(&Integrated { ode: chain(2), integrator: ImplicitMidpoint::default(), dt })
        .unwrap();
    for task in [Upright::pole_chain(3), Upright::pole_chain(2).held()] {
        check::task(&task, &Linear::new(task.system.state_dim(), 1)).unwrap();
    }
    let swing = Upright::double_pendulum();
    check::task(&swing, &Linear::with_bias(4, 1)).unwrap();
    check::task(
        &Upright { loss: LossMode::Running, control_weight: 0.3, ..swing }.held(),
        &Linear::new(4, 1),
    )
    .unwrap();
}

#[test]
fn error_of_a_linearized_plant_is_cubic_in_state_and_control() {
    let system = CartPoleSystem::default();
    let plant = LinearPlant::linearized(&system, Inputs::new(&[0.0; 4], &[0.0]));
    let (mut next, mut linear) = ([0.0; 4], [0.0; 4]);
    let error = |scale: f64| {
        let x: Vec<f64> = random(4, 3).iter().map(|x| x * scale).collect();
        system.step(Inputs::new(&x, &[scale]), &mut next);
        plant.step(Inputs::new(&x, &[scale]), &mut linear);
        next.iter().zip(&linear).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let [near, nearer] = [1e-2, 1e-3].map({
        let mut error = error;
        move |scale| error(scale)
    });
    // The system is an odd function of state and control. The neglected terms are therefore cubic.
    assert!((near / nearer / 1e3 - 1.0).abs() < 0.01, "{near:e} and {nearer:e}");
}

/// Returns the mean loss of a linear policy over 8 initial states, and the minimal loss.
fn losses(lqr: &Lqr, gain: Vec<f64>) -> [f64; 2] {
    let (n, m) = (lqr.system().state_dim(), lqr.system().control_dim());
    let policy = Linear::new(n, m);
    let starts = random(8 * n, 5);
    let weights = Weights::new(&policy, gain);
    let loss =
        Evaluation::new(lqr, &policy, 1).run(lqr, &policy, &weights, &starts).expect("finite");
    [loss, lqr.least_loss(&starts)]
}

#[test]
fn riccati_gain_is_optimal_at_horizons_1_7_and_100() {
    for mut lqr in [Lqr::spring(), Lqr::upright_cart_pole()] {
        for horizon in [1, 7, 100] {
            lqr.horizon = horizon;
            let best = &lqr.optimum().gain;
            let [loss, least] = losses(&lqr, best.clone());
            assert!((loss / least - 1.0).abs() < 1e-11, "T = {horizon}: {loss} and {least}");
            for i in 0..best.len() {
                for by in [-1e-3, 1e-3] {
                    let mut gain = best.clone();
                    gain[i] *= 1.0 + by;
                    let [worse, _] = losses(&lqr, gain);
                    assert!(
                        worse > least,
                        "T = {horizon}: gain {i} times 1 + {by} gives the loss {worse}, not more than {least}"
                    );
                }
            }
        }
    }
}

#[test]
fn optimal_gains_stabilize_a_stable_and_an_unstable_plant() {
    for (lqr, stable) in [(Lqr::spring(), true), (Lqr::upright_cart_pole(), false)] {
        assert_eq!(lqr.system().spectral_radius() < 1.0, stable);
        assert!(lqr.system().closed_by(&lqr.optimum().gain).spectral_radius() < 1.0);
    }
}

#[test]
fn plants_and_costs_without_optimum_are_reported() {
    // The control does not affect the growing component.
    let plant = LinearPlant::new(2, vec![0.5, 0.0, 0.0, 1.5], vec![1.0, 0.0]);
    let identity = vec![1.0, 0.0, 0.0, 1.0];
    let unstabilizable = Lqr::new(plant.clone(), identity.clone(), vec![1.0]);
    assert!(matches!(unstabilizable, Err(NoOptimum::NotConverged { .. })), "{unstabilizable:?}");
    assert!(matches!(Lqr::new(plant, identity.clone(), vec![-1.0]), Err(NoOptimum::ControlCost)));
    // In these plants, the control does not reach the motions with the eigenvalues 2, 1.1 and 1,
    // respectively. The motion with the eigenvalue 1 neither grows nor decays.
    let coupled = [
        (vec![2.0, 1.0, 0.0, 3.0], vec![1.0, 1.0], 1.0),
        (vec![1.1, 0.5, 0.0, 0.5], vec![0.5, -0.6], 1.0),
        (vec![1.0, 1.0, 0.0, 0.5], vec![1.0, -0.5], 100.0),
    ];
    for (a, b, r) in coupled {
        let found = Lqr::new(LinearPlant::new(2, a, b), identity.clone(), vec![r]);
        assert!(
            matches!(found, Err(NoOptimum::Unstabilizable | NoOptimum::NotConverged { .. })),
            "{found:?}"
        );
    }
    // The iteration for Riccati's equation W = q + a² W / (1 + W) converges to W near -9.7, so
    // 1 + W is negative.
    let rewarded = Lqr::new(LinearPlant::new(1, vec![0.5], vec![1.0]), vec![-10.0], vec![1.0]);
    assert!(matches!(rewarded, Err(NoOptimum::StateCost)), "{rewarded:?}");
    // Single steps of this iteration give W = 0 after an even number of steps, but -2 after an odd
    // number.
    let oscillating = Lqr::new(LinearPlant::new(1, vec![1.0], vec![1.0]), vec![-2.0], vec![1.0]);
    assert!(matches!(oscillating, Err(NoOptimum::StateCost)), "{oscillating:?}");
}

#[test]
fn with_one_pole_the_chain_equals_the_coupled_model() {
    let (one, coupled) = (chain(1), CoupledCartPole::default());
    for case in 0..20 {
        let (x, u) =
            (random(4, case).iter().map(|x| 3.0 * x).collect::<Vec<_>>(), random(1, 100 + case));
        let (mut found, mut expected) = ([0.0; 4], [0.0; 4]);
        Ode::rate(&one, Inputs::new(&x, &u).continuous(0.0), &mut found);
        Ode::rate(&coupled, Inputs::new(&x, &u).continuous(0.0), &mut expected);
        for (found, expected) in found.iter().zip(expected) {
            assert!(
                (found - expected).abs() <= 1e-13 * (1.0 + expected.abs()),
                "{found} and {expected}"
            );
        }
        assert!((one.energy(&x) - coupled.energy(&x)).abs() < 1e-13);
    }
}

/// Returns `|dE/dt - power| / (r (1 + |E|))`, where r is the largest rate, at least 1.
///
/// dE/dt comes from central differences of the energy along the motion.
fn power_missing<O: Ode>(
    ode: &O,
    energy: impl Fn(&[f64]) -> f64,
    power: impl Fn(&[f64], f64) -> f64,
    case: u64,
) -> f64 {
    let (x, u) = (random(ode.state_dim(), case), random(1, 50 + case));
    let mut rate = vec![0.0; x.len()];
    ode.rate(Inputs::new(&x, &u).continuous(0.0), &mut rate);
    let speed = rate.iter().fold(1.0, |largest: f64, rate| largest.max(rate.abs()));
    let width = 1e-4 / speed;
    let at =
        |h: f64| energy(&x.iter().zip(&rate).map(|(x, rate)| x + h * rate).collect::<Vec<_>>());
    let change = (at(width) - at(-width)) / (2.0 * width);
    (change - power(&x, u[0])).abs() / (speed * (1.0 + at(0.0).abs()))
}

#[test]
fn energy_changes_by_the_power_of_the_control() {
    for case in 0..10 {
        for pendulum in [DoublePendulum::default(), unequal()] {
            let missing = power_missing(&pendulum, |x| pendulum.energy(x), |x, u| u * x[1], case);
            assert!(missing < 1e-7, "double pendulum: {missing:e}");
        }
        for poles in [1, 2, 5, 20] {
            let chain = chain(poles);
            let missing = power_missing(&chain, |x| chain.energy(x), |x, u| u * x[1], case);
            assert!(missing < 1e-7, "{poles} poles: {missing:e}");
        }
    }
}

/// Returns the absolute change of energy over `steps` steps of free motion.
fn drift<S: System>(system: &S, steps: usize, energy: impl Fn(&[f64]) -> f64) -> f64 {
    let mut x = random(system.state_dim(), 7);
    let before = energy(&x);
    for _ in 0..steps {
        let from = x.clone();
        system.step(Inputs::new(&from, &[0.0]), &mut x);
    }
    (energy(&x) - before).abs()
}

#[test]
fn energy_drifts_with_order_4_by_rk4_and_order_2_by_verlet() {
    let (pendulum, chain) = (unequal(), chain(3));
    let order = |drift: &dyn Fn(usize) -> f64| (drift(40) / drift(80)).log2();
    let rk4 = RungeKutta::RK4;
    // In the first 0.3 s, the chain falls and its drift is monotonic. Later, the drift changes sign
    // repeatedly.
    let dt = |steps: usize| 0.3 / steps as f64;
    let of_pendulum = order(&|n| {
        drift(&Integrated { ode: pendulum, integrator: rk4, dt: dt(n) }, n, |x| pendulum.energy(x))
    });
    let of_chain = order(&|n| {
        drift(&Integrated { ode: chain, integrator: rk4, dt: dt(n) }, n, |x| chain.energy(x))
    });
    let by_verlet = order(&|n| {
        drift(&Integrated { ode: chain, integrator: Verlet, dt: dt(n) }, n, |x| chain.energy(x))
    });
    for (what, found, expected) in [
        ("pendulum, RK4", of_pendulum, 4.0),
        ("chain, RK4", of_chain, 4.0),
        ("chain, Verlet", by_verlet, 2.0),
    ] {
        assert!((found - expected).abs() < 0.1, "{what}: order {found}");
    }
    // RK4 with steps of 1e-4 s conserves the energy of a chain almost to rounding for 1 s.
    let substeps =
        Substeps { system: Integrated { ode: chain, integrator: rk4, dt: 1e-4 }, count: 100 };
    let left = drift(&substeps, 100, |x| chain.energy(x));
    assert!(left < 1e-11, "{left:e}");
}

#[test]
fn non_physical_masses_are_refused() {
    let model = |cart_mass: f64, pole_mass: f64| CartPoleSystem {
        poles: 3,
        cart_mass: cart_mass.into(),
        pole_mass: pole_mass.into(),
        ..CartPoleSystem::default()
    };
    for good in [model(1.0, 0.1), model(1e-8, 0.1), model(1e6, 1e-6)] {
        assert_eq!(
            (good.check(), CoupledCartPole(good).check(), PoleChain(good).check()),
            (Ok(()), Ok(()), Ok(()))
        );
    }
    let positive =
        |wrong: CartPoleSystem| matches!(wrong.check(), Err(MassError::NotPositive { .. }));
    assert!(
        [
            model(0.0, 0.1),
            model(-0.02, 0.1),
            model(1.0, 0.0),
            model(f64::NAN, 0.1),
            model(1.0, f64::INFINITY)
        ]
        .map(positive)
            == [true; 5]
    );
    assert!(matches!(model(1e-12, 0.1).check(), Err(MassError::CartTooLight { .. })));
    let message = model(1e-12, 0.1).check().expect_err("too light").to_string();
    assert!(message.contains("1.0e-12") && message.contains("3.0e-10"), "{message}");
    let long = CartPoleSystem { poles: 21, ..CartPoleSystem::default() };
    assert_eq!(
        (long.check(), PoleChain(long).check()),
        (Ok(()), Err(MassError::Poles { poles: 21, most: 20 }))
    );
}
