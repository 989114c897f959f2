//! Derivative checks: analytic and batched derivatives against dual numbers.
//!
//! Start with [`system`], [`cost`], [`policy`] and [`task`], one line each in a test:
//! `check::system(&system).unwrap()`. They return [`Passed`], or the first [`Failure`], whose
//! message names the compared quantity, the index, the expected and found values, the random case,
//! and what to do. All checks run in double precision. Errors are relative to the largest component
//! of the reference unless stated otherwise.
//!
//! [`system`] draws states from a standard normal distribution, whatever their units. [`task`]
//! therefore checks system and costs in states of rollouts too.
//!
//! Four further checks: [`stability`] detects time steps that are too long for the dynamics.
//! [`plateau`] detects vanishing gradients. [`jumps`] detects losses whose mean R mispredicts.
//! [`kinks`] finds the states of rollouts where the step or a cost has a kink or jumps.
//!
//! No check looks for symmetries that the equations should have, such as equal costs of the
//! quaternions q and -q: only the author knows which ones hold, so compare both in a test.
//!
//! [`slope_by_duals`] returns a reference derivative of the mean loss. `slope` (feature
//! `double-double`) computes the loss and this derivative in double-double arithmetic.

mod costs;
mod failure;
mod jumps;
mod kinks;
mod oracle;
mod plateau;
mod policies;
#[cfg(feature = "double-double")]
mod reference;
mod stability;
mod systems;
mod visited;

pub use costs::cost;
pub use failure::{Failure, Finding, Mismatch};
pub use jumps::{FEWEST, JUMP_PASSES, Jumps, jumps, jumps_in_coordinates};
pub use kinks::{Kink, KinkInput, kinks};
pub use oracle::slope_by_duals;
pub use plateau::{Plateau, plateau};
pub use policies::policy;
#[cfg(feature = "double-double")]
pub use reference::slope;
pub use stability::{DENSE, HARMLESS, Stability, growth_along, jacobian_norm, stability};
pub use visited::{cost_along, system_along};

use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::adjoint::Adjoint;
use crate::engine::any::AnyTask;
use crate::engine::batch::Batch;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::rollout::Rollout;
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::policy::AnyPolicy;
use crate::policy::{Policy, Tensor, Weights};
use rand_distr::{Distribution, StandardNormal};

/// Number of random cases per check of a system or of costs.
const CASES: u64 = 20;
/// Number of random cases per check that evaluates a policy.
const CASES_OF_LONG_CHECKS: u64 = 2;
/// Tolerance for one step of a system, and for one evaluation of a policy, an observation or a
/// cost.
const ONE_STEP: f64 = 1e-12;
/// Tolerance for the loss and the gradients of a whole rollout.
const ROLLOUT: f64 = 1e-10;

/// Summary of a passed check.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Passed {
    /// Number of compared values.
    pub compared: usize,
    /// Largest relative error; absolute for a zero reference. Where the reference is uncertain by
    /// more than the tolerance, the scale includes the uncertainty over the tolerance.
    pub worst: f64,
    /// Tolerance of the relative error.
    pub allowed: f64,
    /// Number of compared values beyond the range of `f64`, which agree if both forms leave it.
    pub infinite: usize,
}

/// Accumulates the comparisons of consecutive random cases.
struct Comparison {
    passed: Passed,
    case: u64,
}

impl Comparison {
    fn new(allowed: f64) -> Self {
        Self { passed: Passed { allowed, ..Passed::default() }, case: 0 }
    }

    fn slices(&mut self, what: &str, found: &[f64], expected: &[f64]) -> Result<(), Mismatch> {
        self.slices_within(what, found, expected, &|_| 0.0)
    }

    /// [`slices`](Self::slices), with the further allowance `uncertainty(index)` of
    /// [`one_within`](Self::one_within).
    fn slices_within(
        &mut self,
        what: &str,
        found: &[f64],
        expected: &[f64],
        uncertainty: &dyn Fn(usize) -> f64,
    ) -> Result<(), Mismatch> {
        let scale = largest(expected);
        let mut pairs = found.iter().zip(expected).enumerate();
        pairs.try_for_each(|(index, (&found, &expected))| {
            self.one_within(what, index, found, expected, scale, &|| uncertainty(index))
        })
    }

    /// Compares two numbers; the error is relative to `scale`, or absolute if `scale` is zero. Numbers
    /// below the smallest normal one have fewer digits, so a difference up to it counts as none. Equal
    /// infinities agree, also with a reference that is then `∞ - ∞`: both leave the range of `f64`.
    fn one(
        &mut self,
        what: &str,
        index: usize,
        found: f64,
        expected: f64,
        scale: f64,
    ) -> Result<(), Mismatch> {
        self.one_within(what, index, found, expected, scale, &|| 0.0)
    }

    /// [`one`](Self::one) that also allows the absolute error `uncertainty()` of the reference,
    /// evaluated only if the relative error exceeds the tolerance.
    fn one_within(
        &mut self,
        what: &str,
        index: usize,
        found: f64,
        expected: f64,
        scale: f64,
        uncertainty: &dyn Fn() -> f64,
    ) -> Result<(), Mismatch> {
        self.passed.compared += 1;
        if found.is_infinite() && (found == expected || expected.is_nan()) {
            self.passed.infinite += 1;
            return Ok(());
        }
        let scale = if scale > 0.0 { scale } else { 1.0 };
        let difference = (found - expected).abs();
        let error = if difference <= f64::MIN_POSITIVE { 0.0 } else { difference / scale };
        let allowed = self.passed.allowed;
        // Relative to a scale with which `allowed` includes the uncertainty. Infinite and NaN
        // uncertainties allow nothing.
        let within = || {
            let uncertainty = uncertainty();
            let error = difference / (scale + uncertainty / allowed);
            (uncertainty.is_finite() && error <= allowed).then_some(error)
        };
        // False for NaN.
        let accepted = if error <= allowed { Some(error) } else { within() };
        self.passed.worst = self.passed.worst.max(accepted.unwrap_or(error));
        if accepted.is_some() {
            Ok(())
        } else {
            Err(Mismatch {
                what: what.into(),
                index,
                expected,
                found,
                error,
                allowed,
                case: self.case,
            })
        }
    }

    /// Compares single components of a gradient, given by their indices, relative to its largest
    /// one. `name(index)` is what a message calls the component, and its index there.
    fn gradient_components(
        &mut self,
        found: &[f64],
        expected: &[(usize, f64)],
        name: &dyn Fn(usize) -> (String, usize),
    ) -> Result<(), Mismatch> {
        let scale = largest(found);
        expected.iter().try_for_each(|&(index, expected)| {
            let (what, i) = name(index);
            self.one(&what, i, found[index], expected, scale.max(largest(&[expected])))
        })
    }

    /// Compares the derivatives along directions with those of a finite gradient, relative to its
    /// norm. Compares nothing if the gradient is not finite.
    fn gradient_directions(
        &mut self,
        gradient: &[f64],
        directions: &[(Vec<f64>, f64)],
    ) -> Result<(), Mismatch> {
        let scale = largest(gradient);
        // Without overflow of the squares.
        let share = |g: &f64| if scale > 0.0 { g / scale } else { 0.0 };
        let norm = scale * gradient.iter().map(|g| share(g).powi(2)).sum::<f64>().sqrt();
        // Sums of infinite components can be NaN.
        if !norm.is_finite() || !gradient.iter().all(|g| g.is_finite()) {
            return Ok(());
        }
        directions.iter().enumerate().try_for_each(|(index, (direction, expected))| {
            let found = direction.iter().zip(gradient).map(|(d, g)| d * g).sum();
            let scale = norm.max(expected.abs());
            self.one("gradient in random direction", index, found, *expected, scale)
        })
    }

    /// Returns an error if a number is non-finite.
    fn finite(&mut self, what: &str, found: &[f64]) -> Result<(), Mismatch> {
        match found.iter().position(|found| !found.is_finite()) {
            Some(index) => Err(Mismatch {
                what: what.into(),
                index,
                expected: f64::NAN,
                found: found[index],
                error: f64::NAN,
                allowed: 0.0,
                case: self.case,
            }),
            None => Ok(()),
        }
    }

    /// Compares numbers without tolerance. Zeros of opposite sign are equal, and so are all NaNs.
    fn equal(&mut self, what: &str, found: &[f64], expected: &[f64]) -> Result<(), Mismatch> {
        match found.iter().zip(expected).position(|(f, e)| f != e && !(f.is_nan() && e.is_nan())) {
            Some(index) => {
                let (found, expected) = (found[index], expected[index]);
                let error = (found - expected).abs();
                Err(Mismatch {
                    what: what.into(),
                    index,
                    expected,
                    found,
                    error,
                    allowed: 0.0,
                    case: self.case,
                })
            }
            None => {
                self.passed.compared += found.len();
                Ok(())
            }
        }
    }
}

/// Largest absolute value of the finite numbers.
fn largest(numbers: &[f64]) -> f64 {
    let finite = numbers.iter().filter(|number| number.is_finite());
    finite.fold(0.0, |largest: f64, number| largest.max(number.abs()))
}

/// Draws standard normal samples.
fn normal(rng: &mut Rng, len: usize) -> Vec<f64> {
    (0..len).map(|_| StandardNormal.sample(rng)).collect()
}

/// Checks a system at states, controls and parameters from a standard normal distribution, and at
/// the state 0. Physical numbers that vary have their own distributions. See [`system_at`].
///
/// # Errors
/// Returns the first [`Mismatch`].
pub fn system<S: System>(system: &S) -> Result<Passed, Failure> {
    let normal = |rng: &mut Rng, x: &mut [f64], u: &mut [f64], p: &mut [f64]| {
        for values in [x, u, p] {
            values.copy_from_slice(&normal(rng, values.len()));
        }
    };
    systems::check(system, &normal, usize::MAX).map_err(|mismatch| {
        Failure::of_system(mismatch).refused_with(
            "This check draws all states from a standard normal distribution. If a task uses the \
             system, `check::task` checks it in the states of rollouts",
        )
    })
}

/// Checks the derivatives of a system at states `x`, controls `u` and parameters `p` drawn by
/// `draw(rng, x, u, p)`. The check then draws the physical numbers that vary, and overwrites their
/// entries of `p`.
///
/// The check requires:
///
/// - [`step`](System::step) writes every component of the next state. All are finite.
/// - [`vjp`](System::vjp) agrees with dual numbers for every combination of requested cotangents,
///   and adds to the cotangents.
/// - [`jvp`](System::jvp) agrees with dual numbers: `⟨λ, J v⟩ = ⟨Jᵀλ, v⟩` for the Jacobian J and
///   random vectors λ and v. Each side is a sum. The error is relative to the sum of the absolute
///   values of the terms, for the side where this sum is larger.
/// - The JVP along all inputs is the sum of the JVPs along x, u and p.
/// - `step` and `vjp` in SIMD lanes have the bits of scalars, except for the signs of zeros.
/// - Both tolerances are 1e-12. Stiff implicit steps have derivatives that change strongly with the
///   state, and their equations are solved to rounding or to a tolerance. An error above 1e-12 is
///   therefore allowed if it is at most 10 times the change of the reference or of the derivative
///   under test when control and parameters change by a relative 1e-12, and the state x by
///   `1e-12 (1 + |x|)`.
/// - All this holds at two further states, 0 without and with a control, unless the step is not
///   finite there or has a kink. The derivative must be finite if it has a limit.
///
/// # Errors
/// Returns the first [`Mismatch`].
pub fn system_at<S: System>(
    system: &S,
    draw: impl Fn(&mut Rng, &mut [f64], &mut [f64], &mut [f64]),
) -> Result<Passed, Failure> {
    systems::check(system, &draw, usize::MAX).map_err(Failure::of_system)
}

/// Checks the system and the costs in states of rollouts ([`system_along`], [`cost_along`]), and then
/// the gradients of whole rollouts for all flows (R, M, N, S).
///
/// The reference is the same rollout in dual numbers, with the paths that the flow omits detached.
/// The check compares the loss, directional derivatives along random directions, and single
/// components. It compares all components of at most 64 parameters, otherwise 16 random ones. This
/// rule also selects components of the gradient with respect to initial states and parameters p.
/// The gradient of a flow computed alone must agree with its gradient computed together with M.
/// Errors of components are relative to the largest component of the gradient. Errors of
/// directional derivatives are relative to the norm of the gradient.
///
/// # Errors
/// Returns the first [`Mismatch`], or [`Finding::Diverged`] if the rollouts or their gradients are
/// non-finite.
pub fn task<T: Task, P: Policy>(task: &T, policy: &P) -> Result<Passed, Failure> {
    let mut sum = Passed::default();
    let mut add = |passed: Passed| {
        sum.compared += passed.compared;
        sum.worst = sum.worst.max(passed.worst);
        sum.allowed = sum.allowed.max(passed.allowed);
        sum.infinite += passed.infinite;
    };
    // First the checks that name the method to correct.
    add(system_along(task, policy, None)?);
    add(cost_along(task, policy, None)?);
    let flows = Flows::new(task, policy, None);
    for flow in Flow::ALL {
        add(flows.check(flow)?);
    }
    Ok(sum)
}

/// Checks the gradients of whole rollouts for one flow; see [`task`]. The policy has the parameters
/// `theta`, or random ones.
///
/// Rollouts that amplify rounding errors by about 1e6 exceed the tolerance of 1e-10, although all
/// derivatives are exact.
///
/// # Errors
/// Returns the first [`Mismatch`], or [`Finding::Diverged`] if the rollouts or their gradients are
/// non-finite.
///
/// # Panics
/// Panics if the length of `theta` is not [`Policy::param_count`], or if the flow has a
/// [`cut`](Flow::cut). The adjoint determines the steps of a cut, and dual numbers do not evaluate
/// the adjoint.
#[track_caller]
#[inline(never)]
pub fn flow<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    flow: Flow,
    theta: Option<&[f64]>,
) -> Result<Passed, Failure> {
    Flows::new(task, policy, theta).check(flow)
}

/// The checks of [`flow`] for several flows. They share the derivatives of steps in dual numbers.
pub struct Flows<'a, T, P> {
    task: &'a T,
    policy: &'a P,
    theta: Option<&'a [f64]>,
    steps: oracle::Steps,
}

impl<'a, T: Task, P: Policy> Flows<'a, T, P> {
    /// Checks with the parameters `theta`, or random ones.
    ///
    /// # Panics
    /// Panics if the length of `theta` is not [`Policy::param_count`].
    #[track_caller]
    pub fn new(task: &'a T, policy: &'a P, theta: Option<&'a [f64]>) -> Self {
        assert!(
            theta.is_none_or(|theta| theta.len() == policy.param_count()),
            "`theta` needs one number per parameter of the policy"
        );
        Self { task, policy, theta, steps: oracle::Steps::default() }
    }

    /// Checks the gradients for one flow.
    ///
    /// # Errors
    /// As [`flow`].
    ///
    /// # Panics
    /// Panics if the flow has a [`cut`](Flow::cut), as [`flow`].
    #[track_caller]
    #[inline(never)]
    pub fn check(&self, flow: Flow) -> Result<Passed, Failure> {
        assert!(flow.cut.is_none(), "dual numbers cannot check `cut`: set `cut` to `None`");
        let Self { task, policy, theta, ref steps } = *self;
        let slope = |theta: &[f64], starts: &[f64], tangent: &dyn Fn(usize) -> f64| {
            steps.slope((task, policy), theta, starts, flow, tangent)
        };
        let start_slope = |theta: &[f64], starts: &[f64], tangent: &dyn Fn(usize) -> f64| {
            steps.start_slope((task, policy), theta, starts, flow, tangent)
        };
        let loss = |theta: &[f64], starts: &[f64]| oracle::loss(task, policy, theta, starts);
        check_flow(task, policy, theta, flow, &loss, [&slope, &start_slope])
            .map_err(|finding| Failure::of_flow(finding, flow))
    }
}

/// Mean loss for parameters and initial states.
type Loss<'a> = &'a dyn Fn(&[f64], &[f64]) -> f64;
/// Directional derivative of the mean loss for parameters, initial states, and a tangent per
/// parameter or per entry of the initial states.
type Slope<'a> = &'a dyn Fn(&[f64], &[f64], &dyn Fn(usize) -> f64) -> f64;

/// Object-safe part of [`flow`]; limits monomorphization.
fn check_flow(
    task: &dyn AnyTask<f64>,
    policy: &dyn AnyPolicy<f64>,
    theta: Option<&[f64]>,
    flow: Flow,
    loss_by_duals: Loss,
    [slope, start_slope]: [Slope; 2],
) -> Result<Passed, Finding> {
    const SAMPLES: usize = 3;
    let (n, len) = (task.state_dim(), task.start_dim());
    let mut c = Comparison::new(ROLLOUT);
    for case in 0..CASES_OF_LONG_CHECKS {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let starts = draw_starts(task, SAMPLES, &mut rng);
        let weights = match theta {
            Some(theta) => Weights::new(policy, theta.to_vec()),
            None => finite_weights(task, policy, None, &starts, case)?,
        };
        let gradient = |flows: &[Flow]| {
            let mut batch = Batch::new(task, policy, SAMPLES, flows, 1);
            let loss = batch.run(task, policy, &weights, &starts);
            loss.map(|loss| (loss, batch.gradients()[flows.len() - 1].to_vec()))
                .map_err(|divergence| Finding::Diverged { case, divergence })
        };
        let (loss, gradient_alone) = gradient(&[flow])?;
        let (_, gradient_beside) = gradient(&[Flow::MODIFIED, flow])?;
        let theta = weights.theta();
        c.slices("loss", &[loss], &[loss_by_duals(theta, &starts)])?;
        c.slices("gradient computed beside M", &gradient_beside, &gradient_alone)?;

        let along = |tangent: &dyn Fn(usize) -> f64| slope(theta, &starts, tangent);
        let components = oracle::some_components(theta.len(), &mut rng, &along);
        c.gradient_components(&gradient_alone, &components, &|index| {
            (format!("gradient by {}: theta_bar", parameter(&policy.tensors(), index)), index)
        })?;
        let directions = oracle::some_directions(theta.len(), &mut rng, &along);
        c.gradient_directions(&gradient_alone, &directions)?;
        let by_starts = start_gradients(task, policy, &weights, &starts, flow);
        let by_starts = by_starts.map_err(|divergence| Finding::Diverged { case, divergence })?;
        let components = oracle::some_components(starts.len(), &mut rng, &|tangent| {
            start_slope(theta, &starts, tangent)
        });
        c.gradient_components(&by_starts, &components, &|index| {
            let (sample, i) = (index / len, index % len);
            let (name, i) = if i < n { ("initial state", i) } else { ("parameters p", i - n) };
            (format!("gradient by the {name} of sample {sample}, component"), i)
        })?;
    }
    Ok(c.passed)
}

/// Draws the initial states and parameters of `samples` samples, concatenated.
fn draw_starts(task: &dyn AnyTask<f64>, samples: usize, rng: &mut Rng) -> Vec<f64> {
    let mut starts = vec![0.0; samples * task.start_dim()];
    for start in starts.chunks_exact_mut(task.start_dim()) {
        task.draw(rng, start);
    }
    starts
}

/// Name of a parameter of θ, for instance `layer1.kernel[3, 7]`.
fn parameter(tensors: &[Tensor], index: usize) -> String {
    let Some(Tensor { name, shape, range }) =
        tensors.iter().find(|tensor| tensor.range.contains(&index))
    else {
        return "a parameter outside of `tensors`".into();
    };
    let mut rest = index - range.start;
    let mut place: Vec<String> =
        shape.iter().rev().map(|&len| (rest % len, rest /= len).0.to_string()).collect();
    place.reverse();
    format!("{name}[{}]", place.join(", "))
}

/// Gradient of the mean loss with respect to the initial states and parameters of all samples,
/// concatenated.
fn start_gradients(
    task: &dyn AnyTask<f64>,
    policy: &dyn AnyPolicy<f64>,
    weights: &Weights<f64>,
    starts: &[f64],
    flow: Flow,
) -> Result<Vec<f64>, Divergence> {
    let samples = starts.len() / task.start_dim();
    let mut rollout = Rollout::new(task, policy, samples);
    rollout.start(starts);
    rollout.run(task, policy, weights)?;
    let mut adjoint = Adjoint::new(task, policy, &rollout, &[flow]).keep_start_gradients();
    adjoint.run(task, policy, weights, &rollout, 1.0 / samples as f64)?;
    // The loss has no derivative with respect to keys of noise.
    let keys = vec![0.0; task.noise().key_dim()];
    let of = |sample| [adjoint.start_gradient(0, sample).to_vec(), keys.clone()].concat();
    Ok((0..samples).flat_map(of).collect())
}

/// Draws parameters with finite rollouts: `theta` or initial parameters, plus noise. Reduces the
/// noise if a rollout diverges, and returns the divergence if it persists without noise.
fn finite_weights(
    task: &dyn AnyTask<f64>,
    policy: &dyn AnyPolicy<f64>,
    theta: Option<&[f64]>,
    starts: &[f64],
    case: u64,
) -> Result<Weights<f64>, Finding> {
    let mut rollout = Rollout::for_evaluation(task, policy, starts.len() / task.start_dim());
    rollout.start(starts);
    let mut found = Ok(());
    for noise in [0.1, 0.01, 0.001, 0.0] {
        let weights = oracle::weights(policy, theta, noise, &mut stream(case, Purpose::Check, 1));
        found = rollout.run(task, policy, &weights);
        if found.is_ok() {
            return Ok(weights);
        }
        rollout.start(starts);
    }
    Err(found.map_or_else(
        |divergence| Finding::Diverged { case, divergence },
        |()| unreachable!("a finite run is returned"),
    ))
}

#[cfg(test)]
mod tests {
    use super::{Comparison, ROLLOUT};

    #[test]
    fn numbers_outside_of_the_normal_range_agree_if_both_forms_leave_it() {
        let mut c = Comparison::new(ROLLOUT);
        let mut compare = |found: &[f64], expected: &[f64]| c.slices("x", found, expected).is_ok();
        // Gradients of a slider and of a cart-pole, with 7 and 10 digits.
        assert!(compare(&[-4.916_649_3e-317], &[-4.916_65e-317]));
        assert!(compare(&[1.204_600_449e-314], &[1.204_600_448_4e-314]));
        assert!(compare(&[2e-323], &[2.5e-323]));
        assert!(!compare(&[1.000_001e-300], &[1e-300]));
        assert!(compare(&[f64::INFINITY, 1.0], &[f64::INFINITY, 1.0]));
        assert!(!compare(&[f64::INFINITY], &[f64::NEG_INFINITY]));
        assert!(!compare(&[f64::INFINITY], &[1e308]) && !compare(&[f64::NAN], &[f64::NAN]));
        // An infinite component does not hide an error of another one.
        assert!(!compare(&[f64::INFINITY, 1.1], &[f64::INFINITY, 1.0]));
        assert_eq!(c.passed.infinite, 2);
    }
}
