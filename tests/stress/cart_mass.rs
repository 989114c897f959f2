//! Stress case: very light carts.

use super::steps::larger;
use super::{Case, Finding};
use physgrad::Inputs;
use physgrad::Integrated;
use physgrad::Ode;
use physgrad::check;
use physgrad::integrator::SemiImplicit;
use physgrad::rng::{Purpose, stream};
use physgrad::scalar::Single;
use physgrad::tasks::{CartPoleSystem, CoupledCartPole, MassError, PoleChain};
use physgrad::{Float, Real};
use rand::RngExt;
use std::f64::consts::PI;

pub(super) const CASES: &[Case] = &[Case {
    name: "cart_mass",
    about: "carts of 1 kg down to 1e-12 kg with up to 20 poles of 0.1 kg, side by side and end to end",
    criterion: "down to 1e-8 kg, accelerations satisfy each equation of motion to 1e-10 of its largest term, and \
                derivatives agree with dual numbers to 1e-10. Carts of 1e-12 kg and unphysical masses are typed errors",
    explanation: "Mass matrices become singular where a light body carries heavy ones, and a solver without pivoting \
                may continue silently. The poles here are uniform and have inertia about their middle, so the equations \
                remain solvable for any positive cart mass. Below 1e-9 of the mass of all poles, rounding of the total \
                mass changes the cart mass noticeably. Scenes and the `check` methods of the systems then return a \
                typed error with a remedy. Limits: in f32, a chain of 20 poles on a cart of 1e-8 kg retains four digits",
    run: cart_mass,
}];

const MASSES: [f64; 5] = [1.0, 1e-2, 1e-4, 1e-6, 1e-8];

fn model(poles: usize, cart_mass: f64) -> CartPoleSystem {
    CartPoleSystem { poles, cart_mass: cart_mass.into(), ..CartPoleSystem::default() }
}

fn cart_mass() -> Vec<Finding> {
    let uncoupled =
        |model: CartPoleSystem| worst::<f64, _>(&model, &model, in_the_authors_equations);
    let coupled = |model: CartPoleSystem| {
        worst::<f64, _>(&CoupledCartPole(model), &model, |model, x, rate, u| {
            dalembert(model, false, x, rate, u)
        })
    };
    let chained = |model: &CartPoleSystem, x: &[f64], rate: &[f64], u: f64| {
        dalembert(model, true, x, rate, u)
    };
    let chain = |model: CartPoleSystem| worst::<f64, _>(&PoleChain(model), &model, chained);
    let mut findings = Vec::new();
    for (name, poles, residual) in [
        ("the authors' model", &[1, 20][..], &uncoupled as &dyn Fn(CartPoleSystem) -> f64),
        ("poles side by side", &[1, 2, 5, 20], &coupled),
        ("poles end to end", &[1, 2, 5, 10, 20], &chain),
    ] {
        let of_all =
            |mass: f64| poles.iter().map(|&poles| residual(model(poles, mass))).fold(0.0, larger);
        let worst = MASSES.iter().map(|&mass| of_all(mass)).fold(0.0, larger);
        findings.push(Finding::at_most(format!("{name}: residual down to 1e-8 kg"), worst, 1e-10));
        findings.push(Finding::info(
            format!("{name}: residual at 1e-12 kg, unchecked"),
            format!("{:.1e}", of_all(1e-12)),
        ));
    }
    let single = worst::<Single<f32>, _>(&PoleChain(model(20, 1e-8)), &model(20, 1e-8), chained);
    findings.push(Finding::info(
        "20 poles end to end on 1e-8 kg, in f32: residual",
        format!("{single:.1e}"),
    ));
    findings.extend(derivatives());
    findings.extend(rejected());
    let broken = |model: &CartPoleSystem, x: &[f64], rate: &[f64], u: f64| {
        let mut rate = rate.to_vec();
        rate[3] *= 1.0 + 1e-8;
        dalembert(model, true, x, &rate, u)
    };
    let fault = worst::<f64, _>(&PoleChain(model(5, 1e-8)), &model(5, 1e-8), broken);
    findings.push(Finding::at_least(
        "residual of an acceleration with a relative error of 1e-8",
        fault,
        1e-10,
    ));
    findings
}

/// Compares the VJPs of both exact models, on a cart of 1e-8 kg, with dual numbers.
fn derivatives() -> [Finding; 2] {
    // The check stops at the first mismatch, which may be smaller than a later one.
    let error = |checked: Result<check::Passed, check::Failure>| {
        checked.map_or(f64::INFINITY, |passed| passed.worst)
    };
    let (coupled, chain) = (CoupledCartPole(model(20, 1e-8)), PoleChain(model(20, 1e-8)));
    let chain = Integrated { ode: chain, integrator: SemiImplicit, dt: 0.01 };
    [("side by side", error(check::system(&coupled))), ("end to end", error(check::system(&chain)))]
        .map(|(name, error)| {
            Finding::at_most(
                format!("20 poles {name} on 1e-8 kg: VJP against dual numbers"),
                error,
                1e-10,
            )
        })
}

fn rejected() -> Vec<Finding> {
    let checks = |model: CartPoleSystem| {
        [model.check(), CoupledCartPole(model).check(), PoleChain(model).check()]
    };
    let taken =
        MASSES.iter().flat_map(|&mass| [1, 20].map(|poles| model(poles, mass))).flat_map(checks);
    let (good, all) =
        taken.fold((0, 0), |(good, all), check| (good + usize::from(check.is_ok()), all + 1));
    let count = |wrong: &[CartPoleSystem], is: fn(&MassError) -> bool| {
        let found = wrong
            .iter()
            .flat_map(|&model| checks(model))
            .filter(|check| check.as_ref().is_err_and(is))
            .count();
        (found, 3 * wrong.len())
    };
    let light = [1, 20].map(|poles| model(poles, 1e-12));
    let (lights, all_lights) =
        count(&light, |error| matches!(error, MassError::CartTooLight { .. }));
    // The equations of both exact models are singular for a massless pole. They are also singular
    // for an upright pole on a cart of −1/4 of the pole mass. For the other finite masses in this
    // list, they have unique solutions.
    let split = |cart_mass: f64, pole_mass: f64| CartPoleSystem {
        cart_mass: cart_mass.into(),
        pole_mass: pole_mass.into(),
        ..CartPoleSystem::default()
    };
    let unphysical = [
        split(0.0, 0.1),
        split(-0.01, 0.1),
        split(-0.025, 0.1),
        split(1.2, -0.1),
        split(1.0, 0.0),
        split(f64::NAN, 0.1),
    ];
    let (splits, all_splits) =
        count(&unphysical, |error| matches!(error, MassError::NotPositive { .. }));
    vec![
        Finding::all("carts down to 1e-8 kg accepted", good, all),
        Finding::all("carts of 1e-12 kg rejected as too light", lights, all_lights),
        Finding::all("unphysical masses rejected", splits, all_splits),
    ]
}

/// Largest residual at random states for accelerations in the precision of `R`. Angles are
/// arbitrary, rates within ±5 and forces within ±10.
fn worst<R: Real, O: Ode>(
    ode: &O,
    model: &CartPoleSystem,
    residual: impl Fn(&CartPoleSystem, &[f64], &[f64], f64) -> f64,
) -> f64 {
    let mut rng = stream(0, Purpose::Check, 0);
    let n = ode.state_dim();
    let plain = |v: &[R]| v.iter().map(|v| v.lane(0).to_f64()).collect::<Vec<f64>>();
    let residuals = (0..20).map(|_| {
        let draw = |i: usize| {
            R::from(rng.random_range(-1.0..1.0) * if i.is_multiple_of(2) { PI } else { 5.0 })
        };
        let x: Vec<R> = (0..n).map(draw).collect();
        let u = R::from(rng.random_range(-10.0..10.0));
        let mut rate = vec![R::zero(); n];
        ode.rate(Inputs::new(&x, &[u]).continuous(0.0), &mut rate);
        residual(model, &plain(&x), &plain(&rate), u.lane(0).to_f64())
    });
    residuals.fold(0.0, larger)
}

/// Residual of an equation: absolute value of the sum of its terms, relative to the largest term.
fn relative_residual(terms: &[f64]) -> f64 {
    terms.iter().sum::<f64>().abs()
        / terms.iter().fold(f64::MIN_POSITIVE, |largest, term| larger(largest, term.abs()))
}

/// Largest relative residual of the equations of motion by d'Alembert's principle, from the
/// accelerations of the pole centers. Uses no mass matrix.
///
/// Center i has the position `p_i` and the acceleration `a_i`. Pole k has the mass m, the length
/// 2 l, the angle `θ_k` and the angular acceleration `α_k`. The cart has the mass `M_c` and the
/// position x. The force on the cart is u, the gravitational acceleration is g, and `e_y` is the
/// upward unit vector.
///
/// ```text
/// M_c ẍ + Σ_i m a_i,x = u
/// Σ_i m (∂p_i/∂θ_k) · (a_i + g e_y) + (m l²/3) α_k = 0
/// ```
fn dalembert(model: &CartPoleSystem, chained: bool, x: &[f64], rate: &[f64], u: f64) -> f64 {
    let ([cart_mass, m, l, gravity], n) = (model.nominal(), model.poles);
    // Length along pole k between the cart and the center of pole i.
    let arm = |i: usize, k: usize| {
        if i == k {
            l
        } else if chained && k < i {
            2.0 * l
        } else {
            0.0
        }
    };
    let pole = |k: usize| {
        let (sin, cos) = x[2 + 2 * k].sin_cos();
        (sin, cos, x[3 + 2 * k] * x[3 + 2 * k], rate[3 + 2 * k])
    };
    let middles: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            (0..n).fold([rate[1], 0.0], |[across, up], k| {
                let (sin, cos, spin, alpha) = pole(k);
                [
                    across + arm(i, k) * (cos * alpha - sin * spin),
                    up - arm(i, k) * (sin * alpha + cos * spin),
                ]
            })
        })
        .collect();
    let mut terms = vec![cart_mass * rate[1], -u];
    terms.extend(middles.iter().map(|[across, _]| m * across));
    let mut worst = relative_residual(&terms);
    for k in 0..n {
        let (sin, cos, _, alpha) = pole(k);
        let mut terms = vec![m * l * l / 3.0 * alpha];
        for (i, [across, up]) in middles.iter().enumerate() {
            terms.extend([m * arm(i, k) * cos * across, -m * arm(i, k) * sin * (up + gravity)]);
        }
        worst = larger(worst, relative_residual(&terms));
    }
    worst
}

/// Largest relative residual of the equations of the authors' model, as documented at
/// [`CartPoleSystem`].
fn in_the_authors_equations(model: &CartPoleSystem, x: &[f64], rate: &[f64], u: f64) -> f64 {
    let [cart_mass, m, l, gravity] = model.nominal();
    let mass = cart_mass + m;
    let (mut worst, mut terms) = (0.0, vec![mass * rate[1], -u]);
    for k in 0..model.poles {
        let ((sin, cos), omega, alpha) = (x[2 + 2 * k].sin_cos(), x[3 + 2 * k], rate[3 + 2 * k]);
        let thrust = (u + m * l * sin * omega * omega) / mass;
        let of_pole = [
            4.0 / 3.0 * l * alpha,
            -(m * l * cos * cos / mass * alpha),
            -(gravity * sin),
            cos * thrust,
        ];
        worst = larger(worst, relative_residual(&of_pole));
        terms.extend([-(m * l * sin * omega * omega), m * l * alpha * cos]);
    }
    larger(worst, relative_residual(&terms))
}
