//! Whether the time step is stable in test rollouts, and how many substeps would make it so.

use crate::operations::amplification::{Amplification, Place};
use crate::scenes::source::SceneSource;
use crate::tasks::Scene;
use physgrad::check::{HARMLESS, Stability};
use physgrad::text::growth;
use toml::Value;

/// Largest factor by which [`stability`] increases the number of substeps.
const MAX_REFINEMENT: i64 = 64;

/// Largest multiplier of a substep whose growth counts as that of the physics. Substeps with a larger
/// one do not resolve the motion, and their multipliers may agree by chance.
const RESOLVED: f64 = 1.1;

/// Largest factor between the norms of the derivatives of a step with so many substeps and with twice
/// as many, if the substeps resolve the motion.
const SAME: f64 = 2.0;

/// Describes the stability of the time step, in rollouts with the parameters `theta`. Refines an
/// unstable step until it is stable, or until its multiplier converges and the substeps resolve it,
/// if the scene admits substeps.
pub fn stability(
    scene: &Scene,
    refined: SceneSource,
    theta: &[f64],
    found: &Amplification,
) -> String {
    let Amplification { worst: Place { sample, step, stability }, evaluated, states, .. } = *found;
    let names = scene.state_names();
    let steps = scene.steps();
    let of = if scene.window_steps().is_some() { "window" } else { "rollout" };
    let Stability { multiplier, component, .. } = stability;
    let name = &names[component];
    let all = if evaluated == states { String::new() } else { format!(" of {states}") };
    let place = format!("in test rollout {sample}, step {step}");
    let is_unknown = multiplier.is_nan() && found.divergence.is_none();
    if is_harmless(found) || is_unknown {
        let said = if stability.is_stable() {
            format!(
                "stable: no perturbation grows exponentially. The largest multiplier per step is {}",
                growth(multiplier)
            )
        } else if is_unknown {
            stability.to_string()
        } else {
            format!(
                "harmless: a perturbation grows by {} per step, at most by {:.2} over the {steps} steps of a \
                 {of}",
                growth(multiplier),
                found.growth
            )
        };
        return format!(
            "time step, worst of {evaluated}{all} states, {place}, component {component} ({name}): {said}"
        );
    }
    let unstable = found.growth > HARMLESS;
    let grows = if found.chatter.is_some() {
        let multiplier = growth(multiplier);
        format!(
            "time step: {name} alternates {place}, and the step chatters: between the two states, a perturbation grows by {multiplier} per step"
        )
    } else if unstable {
        let multiplier = growth(multiplier);
        format!("time step: a perturbation of {name} grows by {multiplier} per step {place}")
    } else {
        "time step: the test rollouts diverge".to_owned()
    };
    refinement(scene, refined, theta, found, &grows)
}

/// Returns whether no perturbation grows noticeably over a rollout.
pub fn is_harmless(found: &Amplification) -> bool {
    found.divergence.is_none() && found.growth <= HARMLESS
}

/// Tells whether an unstable step is too long or the physics is unstable, by more substeps. Begins
/// with the description `grows` of the unstable step.
///
/// The growth over a whole step may look harmless although its substeps chatter: they then multiply
/// perturbations by large factors with both signs. So a number of substeps is advised only if the
/// derivatives stay similar with twice as many.
fn refinement(
    scene: &Scene,
    mut refined: SceneSource,
    theta: &[f64],
    found: &Amplification,
    grows: &str,
) -> String {
    let first = Growth::of(Some(found));
    let substeps = scene.integrator.count() as i64;
    let (mut before, mut times) = (first, 1);
    let mut last = None;
    // With this many times the substeps, no perturbation grows.
    let mut harmless: Option<(i64, f64)> = None;
    while times < MAX_REFINEMENT || harmless.is_some() && times == MAX_REFINEMENT {
        let count = substeps * (2 * times);
        let put = refined.put("integrator.substeps", Value::Integer(count), "more substeps");
        let Some(scene) = put.and_then(|()| refined.scene()).ok() else { break };
        times *= 2;
        let next = scene.amplification(theta, found.chatter.as_ref()).ok();
        let now = Growth::of(next.as_ref());
        if let Some(next) = next.filter(is_harmless) {
            if let Some((times, norm)) = harmless
                && (1.0 / SAME..=SAME).contains(&(next.norm / norm))
            {
                return format!(
                    "{grows}, but not with {} as many substeps. Shorten the step: `integrator.substeps = {}`",
                    multiple(times),
                    substeps * times
                );
            }
            harmless = Some((times, next.norm));
        } else {
            harmless = None;
            if is_settled(before.multiplier, now.multiplier, count)
                && now.is_finite == before.is_finite
            {
                return verdict(grows, first, now, times, count);
            }
        }
        (before, last) = (now, Some(now.multiplier));
    }
    match last {
        _ if harmless.is_some() => format!(
            "{grows}. With {times} times as many substeps, no perturbation grows over whole steps, but the derivatives have not \
             converged: the substeps do not resolve the motion. Use an implicit integrator or more damping, or \
             reduce the time step further"
        ),
        Some(last) if last.is_finite() => format!(
            "{grows}, and by {} with {times} times as many substeps. Use an implicit integrator or more damping, or \
             reduce the time step further",
            growth(last)
        ),
        Some(_) => format!(
            "{grows}, and test rollouts diverge with {times} times as many substeps too: the physics or its controls diverge, or a \
             state leaves the domain of a function"
        ),
        None => format!("{grows}. Without substeps, step and physics cannot be distinguished"),
    }
}

/// Growth of a perturbation over a step of test rollouts.
#[derive(Clone, Copy)]
struct Growth {
    /// Infinite if a derivative overflows, or if the first step does.
    multiplier: f64,
    /// Whether perturbations grow noticeably over a rollout.
    is_unstable: bool,
    /// Whether the rollouts are finite.
    is_finite: bool,
}

impl Growth {
    fn of(found: Option<&Amplification>) -> Self {
        let multiplier = found.map_or(f64::NAN, |found| found.worst.stability.multiplier);
        Self {
            multiplier: if multiplier.is_nan() { f64::INFINITY } else { multiplier },
            is_unstable: found.is_some_and(|found| found.growth > HARMLESS),
            is_finite: found.is_some_and(|found| found.divergence.is_none()),
        }
    }
}

/// Compares the growth with that over `count` substeps, `times` as many, which has converged.
fn verdict(grows: &str, first: Growth, now: Growth, times: i64, count: i64) -> String {
    let (more, by) = (multiple(times), growth(now.multiplier));
    if !now.is_finite {
        return format!(
            "{grows}, and test rollouts diverge with {more} as many substeps too: the physics or its controls diverge, or a state \
             leaves the domain of a function"
        );
    }
    let [excess, limit] = [first, now].map(|growth| growth.multiplier - 1.0);
    // Half of the growth of the long step is not physical, or half of the physical growth is
    // missing, or only the long step diverges.
    let is_too_long = excess > 2.0 * limit || limit > 2.0 * excess || !first.is_finite;
    if !is_too_long {
        return format!(
            "{grows}, and by {by} with {more} as many substeps: the physics is unstable, not the step"
        );
    }
    let but = if first.is_unstable {
        format!("but by {by} with {more} as many substeps")
    } else {
        format!("but not with {more} as many substeps, where a perturbation grows by {by} per step")
    };
    format!(
        "{grows}, {but}. The physics is unstable, and the step is too long. Shorten the step: `integrator.substeps = {count}`"
    )
}

fn multiple(times: i64) -> String {
    if times == 2 { "twice".to_owned() } else { format!("{times} times") }
}

/// Returns whether the multiplier of a step has converged: with `count` substeps it is `now`, and
/// `before` with half as many. The length of the whole step is the same, so equal multipliers are
/// equal growth per time.
fn is_settled(before: f64, now: f64, count: i64) -> bool {
    let is_resolved = now.powf(1.0 / count as f64) <= RESOLVED;
    is_resolved && (now - before).abs() < 0.1 * (now - 1.0).abs()
}

#[cfg(test)]
mod tests {
    use super::is_settled;

    #[test]
    fn multipliers_of_steps_that_do_not_resolve_the_motion_do_not_settle() {
        // A pendulum that falls: exp(λ dt).
        assert!(is_settled(1.0404, 1.0408, 2) && !is_settled(1.5, 1.0408, 2));
        // Chattering dry friction, whose multipliers agree by chance.
        assert!(!is_settled(23.92, 22.47, 2) && !is_settled(22.6, 22.47, 4));
        // The physics may grow by any factor over a step, if substeps resolve it.
        assert!(is_settled(22.6, 22.47, 64));
    }
}
