//! Integrators: derivatives, order, and documented properties.

use physgrad::engine::{Cause, Variable};
use physgrad::integrator::{
    Adaptive, AnyIntegrator, Discretized, ImplicitMidpoint, Integrator, RungeKutta, Sdirk2,
    SemiImplicit, Verlet,
};
use physgrad::rng::{Purpose, stream};
use physgrad::scalar::{Lanes, Single};
use physgrad::tasks::{
    Bumpers, CartDamping, CartPoleEffect, CartPoleModel, CartPoleSystem, CoupledCartPole,
    DryFriction, GuidanceSystem, GustyWind, PoleDamping, SteadyWind,
};
use physgrad::{
    Cotangents, Divergence, Flow, Forced, Inputs, Integrated, Ode, OdeInputs, Real, Scalar,
    Substeps, System, Tangents, check,
};
use rand::RngExt;

/// Integrators of fixed step, with name and order.
const FIXED: [(&str, AnyIntegrator, f64); 8] = [
    ("Euler", AnyIntegrator::RungeKutta(RungeKutta::EULER), 1.0),
    ("semi-implicit", AnyIntegrator::SemiImplicit(SemiImplicit), 1.0),
    ("Verlet", AnyIntegrator::Verlet(Verlet), 2.0),
    ("Heun", AnyIntegrator::RungeKutta(RungeKutta::HEUN), 2.0),
    ("midpoint", AnyIntegrator::ImplicitMidpoint(ImplicitMidpoint { tolerance: 1e-14 }), 2.0),
    ("SDIRK", AnyIntegrator::Sdirk2(Sdirk2 { tolerance: 1e-14 }), 2.0),
    ("RK4", AnyIntegrator::RungeKutta(RungeKutta::RK4), 4.0),
    ("Tsitouras", AnyIntegrator::RungeKutta(RungeKutta::TSIT5), 5.0),
];

fn adaptive(rtol: f64) -> AnyIntegrator {
    AnyIntegrator::Adaptive(Adaptive { rtol, atol: 1e-3 * rtol, most: 1000 })
}

/// Type of every cart-pole of these tests, so that the compiler monomorphizes each check once.
type ForcedCartPole = Forced<CartPoleModel, Vec<CartPoleEffect>>;

fn cart_pole() -> ForcedCartPole {
    let effects = vec![
        PoleDamping::default().into(),
        CartDamping::default().into(),
        SteadyWind::default().into(),
    ];
    Forced { system: CartPoleModel::Uncoupled(poles(2)), effects }
}

fn coupled() -> ForcedCartPole {
    let effects = vec![PoleDamping::default().into(), GustyWind::default().into()];
    Forced { system: CartPoleModel::Coupled(CoupledCartPole(poles(2))), effects }
}

fn poles(poles: usize) -> CartPoleSystem {
    CartPoleSystem { poles, ..CartPoleSystem::default() }
}

fn midpoint(tolerance: f64) -> AnyIntegrator {
    AnyIntegrator::ImplicitMidpoint(ImplicitMidpoint { tolerance })
}

fn integrated<O: Ode, I>(ode: O, integrator: I, dt: f64) -> Integrated<O, I> {
    Integrated { ode, integrator, dt }
}

#[test]
fn derivatives_of_every_integrator_equal_dual_numbers() {
    let all = FIXED
        .map(|(_, integrator, _)| integrator)
        .into_iter()
        .chain([adaptive(1e-6), adaptive(1e-3)]);
    for integrator in all {
        check::system(&integrated(cart_pole(), integrator, 0.05)).unwrap();
        check::system(&integrated(coupled(), integrator, 0.05)).unwrap();
        check::system(&integrated(GuidanceSystem::default().herding(), integrator, 0.05)).unwrap();
        check::system(&integrated(ByDuals, integrator, 0.1)).unwrap();
        check::system(&Discretized { system: cart_pole(), integrator: Some(integrator), dt: 0.05 })
            .unwrap();
    }
    check::system(&Discretized { system: cart_pole(), integrator: None, dt: 0.01 }).unwrap();
}

/// Van der Pol's vector field, with derivatives by dual numbers and without declared velocities.
#[derive(Clone, Debug)]
struct ByDuals;

impl Ode for ByDuals {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        rate[0] = x[1];
        rate[1] = (T::one() - x[0] * x[0]) * x[1] - x[0] + u[0];
    }
}

/// Returns the state after `steps` steps over the time `span`, and the cotangents of initial state
/// and control. Initial state, control and final cotangent are random with a fixed seed.
fn reached<O: Ode + Clone>(
    ode: &O,
    integrator: AnyIntegrator,
    span: f64,
    steps: usize,
) -> (Vec<f64>, Vec<f64>) {
    let (n, m) = (ode.state_dim(), ode.control_dim());
    let mut rng = stream(3, Purpose::Test, 0);
    let x: Vec<f64> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
    let u: Vec<f64> = (0..m).map(|_| rng.random_range(-1.0..1.0)).collect();
    let bar: Vec<f64> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
    let system =
        Substeps { system: integrated(ode.clone(), integrator, span / steps as f64), count: steps };
    let (mut next, mut x_bar, mut u_bar) = (vec![0.0; n], vec![0.0; n], vec![0.0; m]);
    let p = vec![0.4; ode.param_dim()];
    let inputs = Inputs { p: &p, ..Inputs::new(&x, &u) };
    system.step(inputs, &mut next);
    system.vjp(inputs, &bar, Cotangents::of(&mut x_bar, &mut u_bar));
    x_bar.extend(u_bar);
    (next, x_bar)
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert!(a.len() == b.len() && a.iter().chain(b).all(|x| x.is_finite()), "{a:?}, {b:?}");
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Returns the observed orders of state and gradient when the number of steps doubles.
///
/// Uses the doubling whose order is closest to `theory`, because errors of opposite sign may cancel
/// in others.
fn orders<O: Ode + Clone>(ode: &O, integrator: AnyIntegrator, span: f64, theory: f64) -> [f64; 2] {
    let (state, gradient) = reached(ode, AnyIntegrator::RungeKutta(RungeKutta::TSIT5), span, 2000);
    let coarsest = if theory < 3.0 { 128 } else { 32 };
    let errors: Vec<[f64; 2]> = [1, 2, 4, 8]
        .into_iter()
        .map(|finer| coarsest * finer)
        .map(|steps| {
            let found = reached(ode, integrator, span, steps);
            [distance(&found.0, &state), distance(&found.1, &gradient)]
        })
        .collect();
    [0, 1].map(|which| {
        let orders = errors
            .windows(2)
            .filter(|pair| pair[1][which] > 1e-13)
            .map(|pair| (pair[0][which] / pair[1][which]).log2());
        orders
            .min_by(|a, b| (a - theory).abs().total_cmp(&(b - theory).abs()))
            .expect("errors above rounding")
    })
}

#[test]
fn every_integrator_has_its_order_in_state_and_gradient() {
    let smooth: Vec<CartPoleEffect> =
        vec![PoleDamping::default().into(), CartDamping::default().into()];
    for (name, integrator, theory) in FIXED {
        for (task, found) in [
            // Wind drag has a discontinuous second derivative at zero relative speed.
            (
                "cart-pole",
                orders(&Forced { effects: smooth.clone(), ..cart_pole() }, integrator, 1.0, theory),
            ),
            (
                "coupled",
                orders(&Forced { effects: smooth.clone(), ..coupled() }, integrator, 1.0, theory),
            ),
            ("guidance", orders(&GuidanceSystem::default().herding(), integrator, 0.4, theory)),
            ("Van der Pol", orders(&ByDuals, integrator, 2.0, theory)),
        ] {
            println!(
                "{name:<14} {task:<12} order {theory}: state {:.2}, gradient {:.2}",
                found[0], found[1]
            );
            assert!(
                found.iter().all(|order| (order - theory).abs() < 0.3),
                "{name}, {task}: {found:?}"
            );
        }
    }
}

#[test]
fn steps_of_cart_pole_and_guidance_equal_their_integrators() {
    fn step<S: System>(system: &S) -> Vec<f64> {
        let mut rng = stream(0, Purpose::Test, 0);
        let mut numbers =
            |len: usize| (0..len).map(|_| rng.random_range(-1.0..1.0)).collect::<Vec<f64>>();
        let (x, u, mut next) = (
            numbers(system.state_dim()),
            numbers(system.control_dim()),
            numbers(system.state_dim()),
        );
        system.step(Inputs::new(&x, &u), &mut next);
        next
    }
    let own = cart_pole();
    let by = integrated(own.clone(), AnyIntegrator::SemiImplicit(SemiImplicit), poles(2).dt);
    let pair = [step(&own), step(&by)];
    assert!(distance(&pair[0], &pair[1]) < 1e-15, "{pair:?}");
    let own = GuidanceSystem::default().herding();
    let by = integrated(own, RungeKutta::EULER, own.system.dt);
    let pair = [step(&own), step(&by)];
    assert_eq!(pair[0], pair[1]);
}

#[test]
fn adaptive_steps_meet_their_tolerance() {
    let (state, _) = reached(&ByDuals, AnyIntegrator::RungeKutta(RungeKutta::TSIT5), 10.0, 20_000);
    let mut before = f64::INFINITY;
    for rtol in [1e-3, 1e-5, 1e-7, 1e-9] {
        let (found, _) = reached(
            &ByDuals,
            AnyIntegrator::Adaptive(Adaptive { rtol, atol: rtol, most: 10_000 }),
            10.0,
            1,
        );
        let error = distance(&found, &state);
        // The factor 100 allows for the accumulated errors of all substeps.
        assert!(error < 100.0 * rtol && error < before, "rtol {rtol:e}: {error:e}");
        before = error;
    }
}

#[test]
fn adaptive_steps_beyond_the_limit_of_substeps_are_nan() {
    let (found, _) = reached(
        &ByDuals,
        AnyIntegrator::Adaptive(Adaptive { rtol: 1e-9, atol: 1e-9, most: 3 }),
        10.0,
        1,
    );
    assert!(found.iter().all(|x| x.is_nan()), "{found:?}");
}

#[test]
fn adaptive_steps_refuse_negative_and_nan_durations() {
    for dt in [-1.0, f64::NAN] {
        let (found, _) = reached(&ByDuals, AnyIntegrator::Adaptive(Adaptive::default()), dt, 1);
        assert!(found.iter().all(|x| x.is_nan()), "{dt}: {found:?}");
    }
}

/// `dx/dt = rate (u - x) + square x²`. With the square, an implicit step may have no solution.
#[derive(Clone, Debug)]
struct Stiff {
    rate: f64,
    square: f64,
}

impl Ode for Stiff {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        rate[0] = (u[0] - x[0]) * self.rate + x[0] * x[0] * self.square;
    }
}

#[test]
fn the_implicit_midpoint_rule_is_stable_where_rk4_is_not() {
    let ode = Stiff { rate: 1e4, square: 0.0 };
    let (found, _) = reached(&ode, midpoint(ImplicitMidpoint::default().tolerance), 10.0, 100);
    assert!(found[0].abs() < 2.0, "{found:?}");
    let (found, _) = reached(&ode, AnyIntegrator::RungeKutta(RungeKutta::RK4), 10.0, 100);
    assert!(found[0].is_nan() || found[0].abs() > 1e100, "{found:?}");
}

#[test]
fn the_l_stable_method_ends_a_stiff_decay_without_ringing() {
    // h λ = 1e6. One step multiplies the state by (1 + (1 - 2 γ) z) / (1 - γ z)² with z = -h λ and
    // γ = 1 - 1/√2.
    let ode = Stiff { rate: 1e6, square: 0.0 };
    let states = |integrator: AnyIntegrator| {
        let (mut x, mut all) = ([1.0_f64], Vec::new());
        for _ in 0..5 {
            let mut next = [0.0];
            integrated(ode.clone(), integrator, 1.0).step(Inputs::new(&x, &[0.0]), &mut next);
            all.push(next[0]);
            x = next;
        }
        all
    };
    let gamma = 1.0 - 0.5f64.sqrt();
    let (z, found) = (-1e6, states(AnyIntegrator::Sdirk2(Sdirk2::default())));
    let multiplier = (1.0 + (1.0 - 2.0 * gamma) * z) / (1.0 - gamma * z).powi(2);
    for (k, x) in (1..).zip(&found) {
        // Newton's corrections stop at 256 machine epsilons.
        assert!((x - multiplier.powi(k)).abs() < 256.0 * f64::EPSILON, "{found:?}, {multiplier:e}");
    }
    // The midpoint rule rings: one step multiplies the state by (1 + z/2) / (1 - z/2).
    let ringing = states(midpoint(ImplicitMidpoint::default().tolerance));
    assert!(ringing[4] < -0.999 && ringing[3] > 0.999, "{ringing:?}");
}

/// Adiabatic reactor: concentration c and temperature T of `dc/dt = -r`, `dT/dt = 1.5 r` with
/// `r = c exp(15 - 15 / T)`. From c = T = 1, the mixture ignites at about t = 0.06 and ends at
/// c = 0, T = 2.5. `1.5 c + T` is constant.
#[derive(Clone, Debug)]
struct Reactor;

impl Ode for Reactor {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        let reaction = x[0] * (T::from(15.0) - T::from(15.0) / x[1]).exp();
        rate[0] = -reaction;
        rate[1] = reaction * 1.5 + u[0];
    }
}

/// States of the reactor at all times, in steps of `dt` from c = T = 1 to t = 0.1.
fn ignition<R: Real>(integrator: AnyIntegrator, dt: f64) -> Vec<[R; 2]> {
    let system = integrated(Reactor, integrator, dt);
    let mut states = vec![[R::one(), R::one()]];
    for t in 0..(0.1 / dt).round() as usize {
        let mut next = [R::zero(); 2];
        system.step(Inputs { t, ..Inputs::new(&states[t], &[R::zero()]) }, &mut next);
        states.push(next);
    }
    states
}

const IMPLICIT: [(&str, AnyIntegrator); 2] = [
    ("midpoint", AnyIntegrator::ImplicitMidpoint(ImplicitMidpoint { tolerance: 1e-12 })),
    ("SDIRK", AnyIntegrator::Sdirk2(Sdirk2 { tolerance: 1e-12 })),
];

#[test]
fn the_implicit_methods_pass_an_ignition() {
    // c and T by SciPy's Radau method; see `ignition_reference.py`.
    let reference = [
        (20, [0.974080620531, 1.038879069204]),
        (40, [0.919312326674, 1.121031509989]),
        (100, [0.0, 2.5]),
    ];
    for (name, integrator) in IMPLICIT {
        let states = ignition::<f64>(integrator, 1e-3);
        for (t, expected) in reference {
            // The methods have order 2: errors of up to (dt / 0.1)² before the ignition.
            let error = distance(&states[t], &expected);
            assert!(error < 1e-4, "{name}, step {t}: {:?}, error {error:e}", states[t]);
        }
        // Steps that do not resolve the ignition keep the invariant, in both precisions.
        for dt in [0.1, 0.02, 0.01, 0.005, 0.002, 0.001] {
            let double = ignition::<f64>(integrator, dt);
            assert!(
                double.iter().all(|x| (1.5 * x[0] + x[1] - 2.5).abs() < 1e-9),
                "{name}, {dt}: {double:?}"
            );
            let single = ignition::<Single<f32>>(integrator, dt);
            assert!(
                single.iter().all(|x| (1.5 * x[0].0[0] + x[1].0[0] - 2.5).abs() < 1e-3),
                "{name}, {dt}: {single:?}"
            );
            // The L-stable method ends in the burnt state.
            let end = double[double.len() - 1];
            assert!(name == "midpoint" || end[0].abs() < 0.01, "{dt}: {end:?}");
        }
    }
}

#[test]
fn derivatives_and_lanes_of_an_ignition_equal_dual_numbers_and_samples() {
    for (name, integrator) in IMPLICIT {
        for dt in [0.02, 0.005] {
            let system = integrated(Reactor, integrator, dt);
            let states = ignition::<f64>(integrator, dt);
            for x in &states {
                let (tangent, bar) = ([0.7, -0.4], [0.3, 1.1]);
                let (mut next_tan, mut x_bar, mut u_bar) = ([0.0; 2], [-0.0; 2], [-0.0; 1]);
                let tangents =
                    Tangents { x: Some(&tangent), u: Some(&[0.6]), ..Tangents::default() };
                system.jvp(Inputs::new(x, &[0.0]), tangents, &mut next_tan);
                system.vjp(Inputs::new(x, &[0.0]), &bar, Cotangents::of(&mut x_bar, &mut u_bar));
                let [forward, reverse] = [
                    bar[0] * next_tan[0] + bar[1] * next_tan[1],
                    tangent[0] * x_bar[0] + tangent[1] * x_bar[1] + 0.6 * u_bar[0],
                ];
                // The tolerance of the forward pass, times the slopes of up to 1e3 of the rate.
                let size = 1.0 + x_bar[0].abs() + x_bar[1].abs();
                assert!(
                    (forward - reverse).abs() < 1e-8 * size,
                    "{name}, {dt}, {x:?}: {forward}, {reverse}"
                );
            }
            // Before, during and after the ignition.
            let last = states.len() - 2;
            let at = [0, last, last / 2, 0];
            let lanes = [0, 1].map(|i| Lanes(at.map(|t| states[t][i])));
            let mut next = [Lanes([0.0; 4]); 2];
            system.step(Inputs::new(&lanes, &[Lanes([0.0; 4])]), &mut next);
            for (lane, t) in at.into_iter().enumerate() {
                assert_eq!(
                    [next[0].0[lane], next[1].0[lane]],
                    states[t + 1],
                    "{name}, {dt}, step {t}"
                );
            }
        }
    }
}

/// `dx/dt = -sign(x)`. An implicit step that would cross 0 has no solution.
#[derive(Clone, Debug)]
struct Signed;

impl Ode for Signed {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        rate[0] = T::select_lt(T::zero(), x[0], -T::one(), T::one());
    }
}

#[test]
fn a_failing_iteration_of_the_reverse_pass_is_named() {
    // Corrections of 0.02 are below the tolerance of the forward pass only.
    for integrator in [midpoint(0.1), AnyIntegrator::Sdirk2(Sdirk2 { tolerance: 0.1 })] {
        let system = integrated(Signed, integrator, 0.02);
        let (mut next, mut x_bar, mut u_bar) = ([0.0], [-0.0], [-0.0]);
        system.step(Inputs::new(&[1e-3], &[0.0]), &mut next);
        system.vjp(Inputs::new(&[1e-3], &[0.0]), &[1.0], Cotangents::of(&mut x_bar, &mut u_bar));
        assert!(next[0].is_finite() && x_bar[0].is_nan(), "{next:?}, {x_bar:?}");
        let cause = system.diagnose(Inputs::new(&[1e-3], &[0.0]));
        assert!(matches!(cause, Some(Cause::Unsolved(_))), "{cause:?}");
        let place = Divergence::Cotangent {
            flow: Flow::REGULAR,
            variable: Variable::State,
            step: 4,
            sample: 2,
            component: 0,
            cause,
        };
        let said = place.to_string();
        let named = said.contains("did not converge for sample 2 at step 4")
            && said.contains("Use substeps");
        assert!(named && !said.contains("another field"), "{said}");
    }
}

#[test]
fn the_adjoint_of_the_midpoint_rule_does_not_depend_on_the_tolerance_of_newton() {
    let (_, tight) = reached(&cart_pole(), midpoint(1e-14), 0.1, 1);
    for tolerance in [1e-10, 1e-6, 1e-2] {
        let (_, loose) = reached(&cart_pole(), midpoint(tolerance), 0.1, 1);
        assert!(distance(&tight, &loose) < 1e-10, "{tolerance:e}: {:e}", distance(&tight, &loose));
    }
}

#[test]
fn an_unsolved_newton_step_is_nan() {
    // x' = x + h ((x + x') / 2)² has no real solution for h x > 1/2.
    let system = integrated(Stiff { rate: 0.0, square: 1.0 }, ImplicitMidpoint::default(), 10.0);
    let mut next = [0.0_f64];
    system.step(Inputs::new(&[1.0], &[0.0]), &mut next);
    assert!(next[0].is_nan(), "{next:?}");
}

/// One state variable. Control 0 selects a rate with kinks and jumps, control 1 a cubic rate.
#[derive(Clone, Debug)]
struct Kinks;

impl Ode for Kinks {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        let x = x[0];
        let below = |kink: f64| T::select_lt(x, T::from(kink), T::from(kink) - x, T::zero());
        let kinks = T::from(0.991) - below(0.4999) * 2.0 - below(0.495) * 100.0;
        let level = T::select_lt(x, T::from(0.05), T::one(), T::from(0.2));
        let kinks = T::select_lt(x, T::from(0.3), level, kinks);
        rate[0] = T::select_lt(u[0], T::from(0.5), kinks, -x * x * x);
    }
}

#[test]
fn a_lane_of_the_midpoint_rule_does_not_depend_on_the_other_lanes() {
    // From 0, two successive corrections are small. Further iterations would lead to another
    // solution. The cubic rate needs 15 iterations.
    let system = integrated(Kinks, midpoint(1e-2), 1.0);
    let alone = |x: f64, u: f64| {
        let mut next = [0.0];
        system.step(Inputs::new(&[x], &[u]), &mut next);
        next[0]
    };
    let (xs, us) = ([0.0, 2.0, 0.0, 2.0], [0.0, 1.0, 0.0, 1.0]);
    let mut next = [Lanes([0.0; 4])];
    system.step(Inputs::new(&[Lanes(xs)], &[Lanes(us)]), &mut next);
    assert_eq!(next[0].0, [0, 1, 2, 3].map(|lane| alone(xs[lane], us[lane])));
}

/// Two masses on springs without friction. One spring hardens, and the control has no effect.
#[derive(Clone, Debug)]
struct Springs;

impl Ode for Springs {
    fn state_dim(&self) -> usize {
        4
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        (rate[0], rate[2]) = (x[1], x[3]);
        rate[1] = (x[2] - x[0] - x[0]) * 3.0;
        rate[3] = (x[0] - x[2] - x[2] * x[2] * x[2]) * 3.0;
    }
    fn velocity(&self, i: usize) -> Option<usize> {
        i.is_multiple_of(2).then_some(i + 1)
    }
}

#[test]
fn energy_errors_of_symplectic_methods_do_not_grow_and_those_of_heun_do() {
    let energy = |x: &[f64]| {
        let kinetic = 0.5 * (x[1] * x[1] + x[3] * x[3]);
        kinetic + 3.0 * (x[0] * x[0] - x[0] * x[2] + 0.5 * x[2] * x[2] + 0.25 * x[2].powi(4))
    };
    /// Returns the largest energy error in the first and in the last tenth of the trajectory.
    fn drift<I: Integrator>(integrator: I, energy: impl Fn(&[f64]) -> f64) -> [f64; 2] {
        let system = integrated(Springs, integrator, 0.05);
        let mut x = vec![0.5, 0.0, -0.7, 0.1];
        let (start, steps) = (energy(&x), 100_000);
        let mut worst = [0.0_f64; 2];
        for t in 0..steps {
            let mut next = vec![0.0; 4];
            system.step(Inputs::new(&x, &[0.0]), &mut next);
            x = next;
            let error = (energy(&x) - start).abs();
            let error = if error.is_nan() { f64::INFINITY } else { error };
            if t < steps / 10 {
                worst[0] = worst[0].max(error);
            } else if t >= steps / 10 * 9 {
                worst[1] = worst[1].max(error);
            }
        }
        worst
    }
    for (name, [first, last]) in [
        ("semi-implicit", drift(SemiImplicit, energy)),
        ("Verlet", drift(Verlet, energy)),
        ("midpoint", drift(ImplicitMidpoint::default(), energy)),
    ] {
        assert!(last < 1.2 * first, "{name}: {first:e}, then {last:e}");
    }
    let [first, last] = drift(RungeKutta::HEUN, energy);
    assert!(
        last > 3.0 * first,
        "the energy error of Heun's method does not grow: {first:e}, then {last:e}"
    );
}

#[test]
fn derivatives_of_bumpers_and_dry_friction_equal_dual_numbers_in_every_integrator() {
    let effects: Vec<CartPoleEffect> =
        vec![DryFriction::default().into(), Bumpers::default().into()];
    let rough = Forced { system: CartPoleModel::Uncoupled(poles(1)), effects };
    for (_, integrator, _) in FIXED {
        check::system(&integrated(rough.clone(), integrator, 0.01)).unwrap();
    }
}

/// Vector field `dx/dt = exp(x)`. The solution diverges after the time exp(-x) from the state x.
struct Exploding;

impl Ode for Exploding {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        rate[0] = x[0].exp();
    }
}

#[test]
fn an_unsolvable_step_is_nan_and_reports_its_residual() {
    let of = |dt| Integrated { ode: Exploding, integrator: ImplicitMidpoint::default(), dt };
    let mut next = [0.0_f64];
    // x' = h exp(x' / 2) has a solution up to h = 2 / e = 0.7358.
    for (dt, solved) in [(0.5, true), (0.77, false)] {
        of(dt).step(Inputs::new(&[0.0], &[0.0]), &mut next);
        assert_eq!(next[0].is_finite(), solved, "{dt}");
        let residual = of(dt).diagnose(Inputs::new(&[0.0], &[0.0])).map(|cause| match cause {
            Cause::Unsolved(residual) => residual,
            other => panic!("{other:?}"),
        });
        assert_eq!(residual.is_none(), solved, "{dt}: {residual:?}");
        // Wrappers forward the cause.
        let wrapped = Substeps { system: of(dt), count: 1 };
        assert_eq!(wrapped.diagnose(Inputs::new(&[0.0], &[0.0])), residual.map(Cause::Unsolved));
        // The least residual of all states x' is 2 ln(e h / 2).
        assert!(
            residual.is_none_or(|residual| residual > 2.0 * (dt * 0.5 * std::f64::consts::E).ln()),
            "{residual:?}"
        );
    }
}

/// Level h of a vessel with the outflow `dh/dt = -√h`, and a constant second component.
///
/// The solution from `h = 1` is `h = (1 - t/2)²`.
struct Outflow;

impl Ode for Outflow {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        (rate[0], rate[1]) = (-x[0].sqrt(), T::zero());
    }
}

#[test]
fn the_adaptive_method_rejects_a_step_with_one_nan_component() {
    // A stage of a step over the whole time has a negative level, whose root is NaN.
    let system = Integrated { ode: Outflow, integrator: adaptive(1e-9), dt: 1.9 };
    let mut next = [0.0_f64; 2];
    system.step(Inputs::new(&[1.0, 5.0], &[]), &mut next);
    assert!((next[0] - 0.05 * 0.05).abs() < 1e-8, "{next:?}");
    assert_eq!(next[1], 5.0);
}
