//! Stress case: close approaches that the time step does not resolve.

use super::step;
use super::steps::finite;
use super::{Case, Finding};
use physgrad::Forced;
use physgrad::Inputs;
use physgrad::Integrated;
use physgrad::Substeps;
use physgrad::System;
use physgrad::check::{self, Stability};
use physgrad::integrator::{AnyIntegrator, ImplicitMidpoint, SemiImplicit};
use physgrad::tasks::{GuidanceEffect, GuidanceSystem, Spread, Walls};

pub(super) const CASES: &[Case] = &[Case {
    name: "guidance_close_approach",
    about: "two agents in a walled field without friction, with repulsion or attraction of stiffness k, so strong \
                that dt² k = 4.4 at distance 0",
    criterion: "with explicit Euler, `check::stability` reports instability. The multiplier is 1 + dt sqrt(2k) for \
                repulsion and sqrt(1 + 2 dt² k) for attraction, to 1 %. All 1000 states are finite. The energy at \
                least doubles. With 128 substeps of semi-implicit Euler, or 16 of the implicit midpoint rule, the \
                energy changes by at most 10 % over 10,000 steps. With attraction, semi-implicit quarter steps and \
                full implicit steps are reported as stable, full semi-implicit steps as unstable",
    explanation: "A spring that the steps do not resolve gains energy at every approach, and \
                gradients include this error. `check::stability` returns the spectral radius of a \
                step at a state. The report names remedies. Limits: training does not call \
                `check::stability`",
    run: guidance_close_approach,
}];

/// Time step of the ICLR 2024 paper, s.
const DT: f64 = 4.0 / 60.0;
/// Strength of the pair force, m²/s².
const STRENGTH: f64 = 10.0;
/// Stiffness per mass of the pair force at distance 0, 1/s²: the strength over the squared
/// softening length of 0.1 m.
const STIFFNESS: f64 = STRENGTH / 0.01;

type Walled = Forced<GuidanceSystem, Vec<GuidanceEffect>>;
type Split = Substeps<Integrated<Walled, AnyIntegrator>>;

/// Two drivers that repel each other, or attract each other for negative `strength`.
fn walled(strength: f64) -> Walled {
    let system = GuidanceSystem { drivers: 2, evaders: 0, dt: DT, ..GuidanceSystem::default() };
    let walls = Walls { half_width: 3.0, half_height: 3.0, stiffness: 10.0 };
    Forced { system, effects: vec![Spread { strength }.into(), walls.into()] }
}

fn split(strength: f64, integrator: AnyIntegrator, count: usize) -> Split {
    Substeps {
        system: Integrated { ode: walled(strength), integrator, dt: DT / count as f64 },
        count,
    }
}

/// Energy per mass: kinetic, walls and pair. The pair term is zero at distance 0 for attraction and
/// at 10 m for repulsion.
fn energy(strength: f64, x: &[f64]) -> f64 {
    let pair = |r: f64| strength * (-(0.1 + r).ln() - 0.1 / (0.1 + r));
    let least = pair(if strength > 0.0 { 10.0 } else { 0.0 });
    let moving = [x[2], x[3], x[6], x[7]].map(|v| 0.5 * v * v).iter().sum::<f64>();
    let walls = [x[0], x[1], x[4], x[5]]
        .map(|p| 5.0 * (p.abs() - 3.0).max(0.0).powi(2))
        .iter()
        .sum::<f64>();
    moving + walls + pair((x[4] - x[0]).hypot(x[5] - x[1])) - least
}

/// Initial state. Repelling agents pass each other at a small offset. Attracting agents start close
/// together.
fn start(strength: f64) -> [f64; 8] {
    if strength > 0.0 {
        [-2.0, 0.05, 8.0, 0.0, 2.0, -0.05, -8.0, 0.0]
    } else {
        [-0.2, 0.0, 0.0, 1.0, 0.2, 0.0, 0.0, -1.0]
    }
}

/// Returns whether all states are finite, and the lowest and highest energy relative to the initial
/// one.
fn energies(system: &impl System, strength: f64, steps: usize) -> (bool, f64, f64) {
    // All controls are zero.
    let (mut x, mut next) = (start(strength), [0.0; 8]);
    let first = energy(strength, &x);
    let (mut all, mut lowest, mut highest) = (true, f64::INFINITY, 0.0f64);
    for _ in 0..steps {
        step(system, Inputs::new(&x, &[0.0; 4]), &mut next);
        x = next;
        all &= finite(&x);
        let share = energy(strength, &x) / first;
        (lowest, highest) = (lowest.min(share), highest.max(share));
    }
    (all, lowest, highest)
}

/// Stability of a step at rest and at a distance of 1 µm.
fn close(system: &impl System) -> Stability {
    check::stability(system, Inputs::new(&[0.0, 0.0, 0.0, 0.0, 1e-6, 0.0, 0.0, 0.0], &[0.0; 4]))
}

fn guidance_close_approach() -> Vec<Finding> {
    let semi_implicit = AnyIntegrator::SemiImplicit(SemiImplicit);
    let midpoint = AnyIntegrator::ImplicitMidpoint(ImplicitMidpoint::default());
    let mut findings = Vec::new();
    for (what, strength, expected) in [
        ("repulsion", STRENGTH, 1.0 + DT * (2.0 * STIFFNESS).sqrt()),
        ("attraction", -STRENGTH, (1.0 + 2.0 * DT * DT * STIFFNESS).sqrt()),
    ] {
        let explicit = walled(strength);
        let report = close(&explicit);
        findings.push(Finding::near(
            format!("{what}: multiplier of explicit steps"),
            report.multiplier,
            expected,
            0.01,
        ));
        let said = report.to_string();
        let named = said.starts_with("unstable")
            && said.contains("Substeps")
            && said.contains("ImplicitMidpoint");
        findings.push(Finding::holds(
            format!("{what}: stability report"),
            "unstable, with remedies",
            named,
            said,
        ));
        let (all, _, highest) = energies(&explicit, strength, 1000);
        findings.push(Finding::holds(
            format!("{what}: 1000 explicit states"),
            "finite",
            all,
            if all { "finite" } else { "non-finite" },
        ));
        findings.push(Finding::at_least(
            format!("{what}: largest energy with explicit steps, relative to the initial energy"),
            highest,
            2.0,
        ));
        findings.push(bounded(
            what,
            "semi-implicit",
            strength,
            &split(strength, semi_implicit, 128),
        ));
        findings.push(bounded(what, "implicit midpoint", strength, &split(strength, midpoint, 16)));
    }
    for (how, report, stable) in [
        ("semi-implicit in 4 substeps", close(&split(-STRENGTH, semi_implicit, 4)), true),
        ("semi-implicit, full step", close(&split(-STRENGTH, semi_implicit, 1)), false),
        ("implicit midpoint, full step", close(&split(-STRENGTH, midpoint, 1)), true),
    ] {
        let measured = format!("multiplier {:.6}", report.multiplier);
        let required = if stable { "stable" } else { "unstable" };
        findings.push(Finding::holds(
            format!("attraction, {how}"),
            required,
            report.is_stable() == stable,
            measured,
        ));
    }
    findings
}

fn bounded(what: &str, how: &str, strength: f64, system: &impl System) -> Finding {
    let (all, lowest, highest) = energies(system, strength, 10_000);
    let off = if all { (highest - 1.0).max(1.0 - lowest) } else { f64::INFINITY };
    Finding::at_most(
        format!("{what}, {how}: largest relative change of energy in 10,000 steps"),
        off,
        0.1,
    )
}
