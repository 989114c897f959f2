//! Stress case: stiff dry friction, nearly a step function of the speed.

use super::steps::{derivative, finite, larger, states};
use super::{Case, Finding};
use physgrad::Inputs;
use physgrad::check;
use physgrad::tasks::{FrictionScheme, SliderSystem};

pub(super) const CASES: &[Case] = &[Case {
    name: "dry_friction",
    about: "sliding block stopped by friction, smoothed over ε = 1e-1 to 1e-6 m/s, from v₀ = 1 m/s, with steps \
                of 0.01 s",
    criterion: "implicit steps are stable and never reverse the block. At 1e-6 m/s, the distance is \
                v₀²/(2 μ g) to 1 %, after adding the error dt v₀/2 of Euler's method. The expected \
                time to rest is v₀/(μ g) plus the delay by smoothing. The time to rest differs from \
                the expected one by at most 1 + ε/(dt μ g) steps. The derivative of the distance by \
                v₀ is finite, and within 2 % of v₀/(μ g) at 1e-3 m/s and below. Explicit steps \
                oscillate exactly where `check::stability` reports instability, with the multiplier \
                |1 - dt μ g/ε| to 1e-6",
    explanation: "Sharply smoothed dry friction is stiff: an explicit step overshoots rest and oscillates \
                indefinitely, and its derivative alternates and grows. The implicit step solves for the speed after \
                the step, and its derivative is that of the solution. Limits: smoothed friction creeps where real \
                friction sticks",
    run: dry_friction,
}];

/// Initial position, m, and speed, m/s.
const START: [f64; 2] = [0.0, 1.0];
/// Number of steps of 0.01 s.
const STEPS: usize = 400;

fn slider(smoothing: f64, scheme: FrictionScheme) -> SliderSystem {
    SliderSystem { smoothing, scheme, ..SliderSystem::default() }
}

/// Deceleration μ g, m/s².
fn deceleration(system: &SliderSystem) -> f64 {
    system.grip() / system.dt
}

fn dry_friction() -> Vec<Finding> {
    let mut findings = Vec::new();
    for exponent in 1..=6 {
        let smoothing = 10f64.powi(-exponent);
        findings.extend(implicit(smoothing));
        findings.extend(explicit(smoothing));
    }
    findings
}

fn implicit(smoothing: f64) -> Vec<Finding> {
    let system = slider(smoothing, FrictionScheme::Implicit);
    let states = states(&system, &START, 0.0, STEPS);
    let speeds = || states.iter().map(|x| x[1]);
    let largest = speeds()
        .map(|v| check::stability(&system, Inputs::new(&[0.0, v], &[0.0])).multiplier)
        .fold(0.0, larger);
    // Position is neutrally stable: its multiplier is 1.
    let mut findings = vec![Finding::at_most(
        format!("ε = {smoothing:.0e}: multiplier of implicit steps"),
        largest,
        1.0 + 1e-6,
    )];
    let turned = speeds().filter(|&v| v < 0.0).count();
    findings.push(Finding::at_most(
        format!("ε = {smoothing:.0e}: implicit states with a speed below 0"),
        turned as f64,
        0.0,
    ));

    // v̇ = -a tanh(v/ε): sinh(v/ε) decays as exp(-a t/ε). "At rest" means below 1 % of the initial
    // speed and below 3 ε.
    let (a, rest) = (deceleration(&system), f64::min(0.01, 3.0 * smoothing));
    let ln_sinh =
        |v: f64| v / smoothing + (-(-2.0 * v / smoothing).exp()).ln_1p() - std::f64::consts::LN_2;
    let expected = smoothing / a * (ln_sinh(1.0) - ln_sinh(rest));
    let stopped =
        speeds().position(|v| v < rest).map_or(f64::INFINITY, |step| step as f64 * system.dt);
    let late = format!(
        "ε = {smoothing:.0e}: stops after {stopped:.2} s (without smoothing {:.4} s); difference in steps from {expected:.4} s",
        1.0 / a
    );
    findings.push(Finding::at_most(
        late,
        (stopped - expected).abs() / system.dt,
        late_steps(smoothing, &system),
    ));

    let (by_start, _) = derivative(&system, &states, 0.0, 0);
    let slope = by_start[1] * a;
    let what =
        format!("ε = {smoothing:.0e}: derivative of the distance by v₀, relative to v₀/(μ g)");
    findings.push(match smoothing {
        s if s < 5e-3 => Finding::near(what, slope, 1.0, 0.02),
        _ => Finding::holds(what, "finite", finite(&by_start), format!("{slope:.4}")),
    });
    if smoothing < 5e-6 {
        let distance = (states[STEPS][0] + 0.5 * system.dt) * 2.0 * a;
        findings.push(Finding::near(
            format!("ε = {smoothing:.0e}: distance, relative to v₀²/(2 μ g)"),
            distance,
            1.0,
            0.01,
        ));
    }
    findings
}

/// Tolerance of the stopping time, in steps: one step, plus the time constant ε/(μ g) of the decay.
/// The second term allows for the delay of backward Euler.
fn late_steps(smoothing: f64, system: &SliderSystem) -> f64 {
    1.0 + smoothing / system.grip()
}

fn explicit(smoothing: f64) -> Vec<Finding> {
    let system = slider(smoothing, FrictionScheme::Explicit);
    let expected = f64::max(1.0, (1.0 - system.grip() / smoothing).abs());
    let report = check::stability(&system, Inputs::new(&[0.0, 0.0], &[0.0]));
    let states = states(&system, &START, 0.0, STEPS);
    let last: Vec<f64> = states[STEPS - 49..].iter().map(|x| x[1]).collect();
    let turns = last.windows(2).filter(|v| v[0] * v[1] < 0.0).count();
    let left = last.iter().fold(0.0, |most, v| larger(most, v.abs()));
    // Oscillation: most of the last steps reverse the speed, at more than a tenth of the largest
    // speed change by friction in one step.
    let chatters = turns > 40 && left > 0.1 * system.grip();
    let measured = format!("{report}; {turns} of 49 steps reverse, at up to {left:.1e} m/s");
    vec![
        Finding::at_most(
            format!(
                "ε = {smoothing:.0e}: multiplier of explicit steps at rest, {expected:.4}: relative error"
            ),
            (report.multiplier / expected - 1.0).abs(),
            1e-6,
        ),
        Finding::holds(
            format!("ε = {smoothing:.0e}: explicit steps"),
            if expected > 1.0 {
                "oscillate, and are reported as unstable"
            } else {
                "come to rest, and are reported as stable"
            },
            chatters == (expected > 1.0)
                && report.is_stable() != chatters
                && (chatters || left < smoothing),
            measured,
        ),
    ]
}
