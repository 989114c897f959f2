//! Gradient checks, one line each: hand-written and batched derivatives against dual numbers.
//!
//! [`system`], [`policy`] and [`task`] panic with what was compared, the index, what was expected, what was found, and
//! the seed of the case. The `try_` forms return the same as a value. Everything is checked in double precision; errors are relative to
//! the largest component of what they are compared with.
//!
//! Derivatives may be right and useless: [`stability`] tells whether steps are too long for what they step through, and
//! [`plateau`] whether there is a gradient to follow at all.

mod oracle;
mod plateau;
mod policies;
#[cfg(feature = "double-double")]
mod reference;
mod stability;

pub use oracle::slope_by_duals;
pub(crate) use oracle::step_vjp;
pub use plateau::{Plateau, plateau};
pub use policies::{policy, try_policy};
#[cfg(feature = "double-double")]
pub use reference::slope;
pub use stability::{Stability, stability};

use crate::apart::{step, vjp};
use crate::backward::Flow;
use crate::batch::Batch;
use crate::divergence::Divergence;
use crate::kernels::has_lanes;
use crate::policy::{Policy, Weights};
use crate::rng::{Purpose, Rng, stream};
use crate::rollout::{Rollout, WIDTH};
use crate::scalar::{Columns, Lanes, Real, Scalar};
use crate::system::System;
use crate::task::Task;
use rand_distr::{Distribution, StandardNormal};
use std::fmt;

/// Random cases that each check tries.
const CASES: u64 = 20;
/// Random cases of the checks that evaluate a policy.
const CASES_OF_LONG_CHECKS: u64 = 2;
/// Allowed for one step of a system and for one evaluation of a policy.
const ONE_STEP: f64 = 1e-12;
/// Allowed for the gradient of a whole rollout.
const ROLLOUT: f64 = 1e-10;

/// What a check that passed has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Passed {
    /// Numbers compared.
    pub compared: usize,
    /// The largest relative error among them.
    pub worst: f64,
    /// The largest that would have passed.
    pub allowed: f64,
}

/// What a check found wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Mismatch {
    /// What was compared, for instance `vjp: x_bar`.
    pub what: String,
    /// Index of the first wrong number.
    pub index: usize,
    /// By dual numbers, or by the reference form.
    pub expected: f64,
    /// By the form under test.
    pub found: f64,
    /// Relative error.
    pub error: f64,
    /// The largest that would have passed.
    pub allowed: f64,
    /// Number of the random case: its inputs are drawn from `stream(case, Purpose::Check, 0)`.
    pub case: u64,
}

/// Why a check of whole rollouts did not pass.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Failure {
    /// A wrong number.
    #[error(transparent)]
    Mismatch(#[from] Mismatch),
    /// There was nothing to compare.
    #[error("case {case} cannot be checked: {divergence}")]
    Diverged {
        /// Number of the random case.
        case: u64,
        /// Where a number was not finite.
        divergence: Divergence,
    },
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, index, expected, found, error, allowed, case } = self;
        write!(
            f,
            "{what}[{index}] is {found:e}, expected {expected:e}: relative error {error:.1e}, allowed {allowed:.0e} (case {case})"
        )
    }
}

impl std::error::Error for Mismatch {}

/// Collects comparisons of one random case after the other.
struct Comparison {
    passed: Passed,
    case: u64,
}

impl Comparison {
    fn new(allowed: f64) -> Self {
        Self { passed: Passed { allowed, ..Passed::default() }, case: 0 }
    }

    fn slices(&mut self, what: &str, found: &[f64], expected: &[f64]) -> Result<(), Mismatch> {
        let scale = expected.iter().fold(0.0, |scale: f64, e| scale.max(e.abs()));
        let mut pairs = found.iter().zip(expected).enumerate();
        pairs.try_for_each(|(index, (&found, &expected))| self.one(what, index, found, expected, scale))
    }

    /// With the error relative to `scale`.
    fn one(&mut self, what: &str, index: usize, found: f64, expected: f64, scale: f64) -> Result<(), Mismatch> {
        let error = (found - expected).abs() / if scale > 0.0 { scale } else { 1.0 };
        let allowed = self.passed.allowed;
        self.passed.compared += 1;
        self.passed.worst = self.passed.worst.max(error);
        // A NaN is not at most anything.
        if error <= allowed {
            Ok(())
        } else {
            Err(Mismatch { what: what.into(), index, expected, found, error, allowed, case: self.case })
        }
    }

    /// The same bits.
    fn equal(&mut self, what: &str, found: &[f64], expected: &[f64]) -> Result<(), Mismatch> {
        match found.iter().zip(expected).position(|(f, e)| f.to_bits() != e.to_bits() && f != e) {
            Some(index) => {
                let (found, expected) = (found[index], expected[index]);
                let error = (found - expected).abs();
                Err(Mismatch { what: what.into(), index, expected, found, error, allowed: 0.0, case: self.case })
            }
            None => {
                self.passed.compared += found.len();
                Ok(())
            }
        }
    }
}

/// Normally distributed numbers.
fn normal(rng: &mut Rng, len: usize) -> Vec<f64> {
    (0..len).map(|_| StandardNormal.sample(rng)).collect()
}

/// Checks a system at states and controls drawn from a standard normal distribution. See [`try_system_at`].
///
/// # Panics
/// With the [`Mismatch`].
#[track_caller]
pub fn system<S: System>(system: &S) -> Passed {
    self::try_system(system).unwrap_or_else(|mismatch| panic!("the system's derivatives are wrong: {mismatch}"))
}

/// As [`system`], as a value.
///
/// # Errors
/// The first [`Mismatch`].
pub fn try_system<S: System>(system: &S) -> Result<Passed, Mismatch> {
    try_system_at(system, |rng, x, u| {
        x.copy_from_slice(&normal(rng, x.len()));
        u.copy_from_slice(&normal(rng, u.len()));
    })
}

/// Checks a system at states and controls that `draw` makes: its [`vjp`](System::vjp), `vjp_state` and `vjp_control`
/// against duals, both directions against each other (`⟨λ, J v⟩ = ⟨Jᵀλ, v⟩`), and lanes against plain numbers, bit for
/// bit.
///
/// # Errors
/// The first [`Mismatch`].
pub fn try_system_at<S: System>(system: &S, draw: impl Fn(&mut Rng, &mut [f64], &mut [f64])) -> Result<Passed, Mismatch> {
    try_system_drawn(system, &draw)
}

/// Draws a state and a control.
type Draw<'a> = &'a dyn Fn(&mut Rng, &mut [f64], &mut [f64]);

/// The same, compiled once for each system.
fn try_system_drawn<S: System>(system: &S, draw: Draw) -> Result<Passed, Mismatch> {
    let (n, m) = (system.state_dim(), system.control_dim());
    let mut c = Comparison::new(ONE_STEP);
    for case in 0..CASES {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let (mut x, mut u) = (vec![0.0; n], vec![0.0; m]);
        draw(&mut rng, &mut x, &mut u);
        let next_bar = normal(&mut rng, n);

        let (x_dual, u_dual) = step_vjp(system, &x, &u, &next_bar);
        let (mut x_bar, mut u_bar) = (vec![f64::NAN; n], vec![f64::NAN; m]);
        vjp(system, &x, &u, &next_bar, &mut x_bar, &mut u_bar);
        c.slices("vjp: x_bar", &x_bar, &x_dual)?;
        c.slices("vjp: u_bar", &u_bar, &u_dual)?;
        let next_bars: Vec<_> = next_bar.iter().map(|&bar| Columns([bar])).collect();
        let (mut x_only, mut u_only) = (vec![Columns([f64::NAN]); n], vec![Columns([f64::NAN]); m]);
        system.vjp_state(&x, &u, &next_bars, &mut x_only);
        system.vjp_control(&x, &u, &next_bars, &mut u_only);
        let plain = |bars: &[Columns<f64, 1>]| bars.iter().map(|bar| bar.0[0]).collect::<Vec<_>>();
        c.slices("vjp_state: x_bar", &plain(&x_only), &x_dual)?;
        c.slices("vjp_control: u_bar", &plain(&u_only), &u_dual)?;

        let (x_tan, u_tan) = (normal(&mut rng, n), normal(&mut rng, m));
        let (mut by_x, mut by_u) = (vec![0.0; n], vec![0.0; n]);
        system.jvp_state(&x, &u, &x_tan, &mut by_x);
        system.jvp_control(&x, &u, &u_tan, &mut by_u);
        for (what, next_tan, bar, tan) in [("jvp_state", by_x, &x_dual, &x_tan), ("jvp_control", by_u, &u_dual, &u_tan)] {
            let terms = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a * b).abs()).sum::<f64>();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let scale = terms(&next_bar, &next_tan).max(terms(bar, tan));
            c.one(what, 0, dot(&next_bar, &next_tan), dot(bar, tan), scale)?;
        }
        // Elsewhere rollouts have no lanes.
        if has_lanes() {
            lanes(system, &x, &u, &next_bar, &mut c)?;
        }
    }
    Ok(c.passed)
}

/// Two columns of lanes, as many as rollouts have, each lane another input, against the same on plain numbers: the same
/// bits.
fn lanes<S: System>(system: &S, x: &[f64], u: &[f64], next_bar: &[f64], c: &mut Comparison) -> Result<(), Mismatch> {
    const W: usize = WIDTH;
    let vary = |v: &[f64], lane: usize| v.iter().map(|v| v * (1.0 + lane as f64 / 64.0)).collect::<Vec<f64>>();
    let pack = |v: &[f64]| -> Vec<Lanes<f64, W>> {
        let lanes: [Vec<f64>; W] = std::array::from_fn(|lane| vary(v, lane));
        (0..v.len()).map(|i| Lanes(std::array::from_fn(|lane| lanes[lane][i]))).collect()
    };
    let (n, m) = (x.len(), u.len());
    let (x_lanes, u_lanes) = (pack(x), pack(u));
    let mut next = vec![Lanes::zero(); n];
    step(system, &x_lanes, &u_lanes, &mut next);
    let column = |v: Lanes<f64, W>| Columns([v, -v]);
    let next_bars: Vec<_> = pack(next_bar).into_iter().map(column).collect();
    let (mut x_bars, mut u_bars) = (vec![column(Lanes::zero()); n], vec![column(Lanes::zero()); m]);
    system.vjp(&x_lanes, &u_lanes, &next_bars, &mut x_bars, &mut u_bars);
    for lane in 0..W {
        let (x, u, next_bar) = (vary(x, lane), vary(u, lane), vary(next_bar, lane));
        let (mut plain, mut x_bar, mut u_bar) = (vec![0.0; n], vec![0.0; n], vec![0.0; m]);
        step(system, &x, &u, &mut plain);
        vjp(system, &x, &u, &next_bar, &mut x_bar, &mut u_bar);
        c.equal("step in lanes", &next.iter().map(|v| v.lane(lane)).collect::<Vec<_>>(), &plain)?;
        let first = |v: &[Columns<Lanes<f64, W>, 2>]| v.iter().map(|v| v.0[0].lane(lane)).collect::<Vec<_>>();
        c.equal("vjp in lanes: x_bar", &first(&x_bars), &x_bar)?;
        c.equal("vjp in lanes: u_bar", &first(&u_bars), &u_bar)?;
    }
    Ok(())
}

/// Checks the gradients of whole rollouts for every flow (R, M, N, S) against duals of the same rollout in which what
/// the flow leaves out is detached. Random directions over all parameters are compared, and single parameters: all of
/// few, some of many.
///
/// # Panics
/// With the [`Mismatch`].
#[track_caller]
pub fn task<T: Task, P: Policy>(task: &T, policy: &P) -> Passed {
    let all = Flow::ALL.map(|flow| {
        try_flow(task, policy, flow).unwrap_or_else(|failure| panic!("the gradient of flow {flow} is wrong: {failure}"))
    });
    all.into_iter().fold(Passed::default(), |sum, p| Passed {
        compared: sum.compared + p.compared,
        worst: sum.worst.max(p.worst),
        allowed: p.allowed,
    })
}

/// As [`task`], for one flow, as a value.
///
/// # Errors
/// The first [`Mismatch`], or rollouts that diverge whatever the parameters.
pub fn try_flow<T: Task, P: Policy>(task: &T, policy: &P, flow: Flow) -> Result<Passed, Failure> {
    const SAMPLES: usize = 3;
    let n = task.system().state_dim();
    let mut c = Comparison::new(ROLLOUT);
    for case in 0..CASES_OF_LONG_CHECKS {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let mut starts = vec![0.0; SAMPLES * n];
        starts.chunks_exact_mut(n).for_each(|x| task.start(&mut rng, x));
        let weights = finite_weights(task, policy, &starts, case)?;
        let gradient = |flows: &[Flow]| {
            let mut batch = Batch::new(task, policy, SAMPLES, flows, 1);
            let loss = batch.run(task, policy, &weights, &starts);
            loss.map(|loss| (loss, batch.gradients()[flows.len() - 1].plain()))
                .map_err(|divergence| Failure::Diverged { case, divergence })
        };
        let (loss, gradient_alone) = gradient(&[flow])?;
        let (_, gradient_beside) = gradient(&[Flow::MODIFIED, flow])?;
        let theta = weights.theta();
        c.slices("loss", &[loss], &[oracle::loss(task, policy, theta, &starts)])?;
        c.slices("gradient computed beside M", &gradient_beside, &gradient_alone)?;

        let largest = gradient_alone.iter().fold(0.0, |s: f64, g| s.max(g.abs()));
        for (index, expected) in oracle::some_components(task, policy, theta, &starts, flow, &mut rng) {
            c.one("gradient", index, gradient_alone[index], expected, largest.max(expected.abs()))?;
        }
        let length = gradient_alone.iter().map(|g| g * g).sum::<f64>().sqrt();
        let directions = oracle::some_directions(task, policy, theta, &starts, flow, &mut rng);
        for (index, (direction, expected)) in directions.into_iter().enumerate() {
            let found = direction.iter().zip(&gradient_alone).map(|(d, g)| d * g).sum();
            c.one("gradient in random direction", index, found, expected, length.max(expected.abs()))?;
        }
    }
    Ok(c.passed)
}

/// Random parameters with which the rollouts are finite: initial ones with noise, less of it if need be.
fn finite_weights<T: Task, P: Policy>(task: &T, policy: &P, starts: &[f64], case: u64) -> Result<Weights<f64>, Failure> {
    let mut rollout = Rollout::for_evaluation(task, policy, starts.len() / task.system().state_dim());
    rollout.start(starts);
    let mut found = Ok(());
    for noise in [0.1, 0.01, 0.001] {
        let weights = oracle::weights(policy, noise, &mut stream(case, Purpose::Check, 1));
        found = rollout.run(task, policy, &weights);
        if found.is_ok() {
            return Ok(weights);
        }
        rollout.start(starts);
    }
    Err(found.map_or_else(|divergence| Failure::Diverged { case, divergence }, |()| unreachable!("a finite run is returned")))
}
