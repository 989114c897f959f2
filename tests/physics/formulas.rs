//! Physics compared with independent formulas: steps, energies, costs, ranges of initial states,
//! defaults.
//!
//! The expected values use none of the library's equations, except for the terminal cost of the
//! regulator, which has to satisfy Bellman's equation. Tests of mechanics use d'Alembert's
//! principle for point masses. Tests of quantum mechanics use dense matrices. The tests therefore
//! detect constants that are wrong in both forward and reverse pass. `tests/mutations/README.md`
//! lists the exceptions.

mod actuators;
mod cart_pole;
mod guidance;
mod mechanics;
mod mechanism;
mod quantum;
mod tasks;

use physgrad::actuator::{Actuator, AnyActuator, Delay, Lag, Limit, LimitKind};
use physgrad::effect::ForcedSystem;
use physgrad::policy::{Conv, Linear};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::*;
use physgrad::{
    Actuated, Cotangent, Cotangents, Effect, Forced, Inputs, Number as PhysicalNumber, Ode, Real,
    Scalar, Start, System, Task, check,
};
use rand::RngExt;
use std::f64::consts::{FRAC_PI_6, PI, TAU};
use std::ops::{Add, Mul, Sub};

/// Bound on the rounding error of numbers of magnitude 1, after the few hundred operations of a
/// step.
const ROUNDING: f64 = 1e-11;

/// Checks that numbers agree to [`ROUNDING`], relative to the larger of 1 and the expected number.
#[track_caller]
fn near(what: &str, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!(
            (found - expected).abs() <= ROUNDING * expected.abs().max(1.0),
            "{what}, {i}: {found} is not {expected}"
        );
    }
}

/// Returns a hundred random pairs of a state with `n` components and a control with `m`, within ±3.
fn states(n: usize, m: usize) -> impl Iterator<Item = (Vec<f64>, Vec<f64>)> {
    let mut rng = stream(0, Purpose::Test, 0);
    let mut draw =
        move |len: usize| (0..len).map(|_| rng.random_range(-3.0..3.0)).collect::<Vec<f64>>();
    (0..100).map(move |_| (draw(n), draw(m)))
}

/// Returns the next state after step number [`STEP`], with all parameters equal to [`PHASE`].
fn step<S: System>(system: &S, x: &[f64], u: &[f64]) -> Vec<f64> {
    let mut next = vec![f64::NAN; x.len()];
    system.step(at(x, u, &vec![PHASE; system.param_dim()]), &mut next);
    next
}

/// Number of the step in the inputs of [`at`].
const STEP: usize = 3;

/// Value of every parameter.
const PHASE: f64 = 0.37;

fn at<'a>(x: &'a [f64], u: &'a [f64], p: &'a [f64]) -> Inputs<'a, f64> {
    Inputs { x, u, p, t: STEP }
}

/// Returns the Jacobian of a function at `at` by central differences: `out[i]` is the derivative
/// with respect to component `i`.
fn slopes(of: impl Fn(&[f64]) -> Vec<f64>, at: &[f64]) -> Vec<Vec<f64>> {
    const WIDTH: f64 = 1e-5;
    let beside = |i: usize, by: f64| {
        let mut at = at.to_vec();
        at[i] += by;
        of(&at)
    };
    let slope = |i: usize| {
        let (after, before) = (beside(i, WIDTH), beside(i, -WIDTH));
        after.iter().zip(before).map(|(after, before)| (after - before) / (2.0 * WIDTH)).collect()
    };
    (0..at.len()).map(slope).collect()
}

/// Checks that derivatives agree with central differences. The tolerance covers the error of the
/// differences for third derivatives of up to 1e5.
#[track_caller]
fn near_slopes(what: &str, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!(
            (found - expected).abs() <= 1e-5 * expected.abs().max(1.0),
            "{what}, slope {i}: {found} is not {expected}"
        );
    }
}

/// Compares the step with `expected`. Compares the VJP with slopes of `expected` and with dual
/// numbers of the step.
#[track_caller]
fn steps_as<S: System>(what: &str, system: &S, expected: impl Fn(&[f64], &[f64]) -> Vec<f64>) {
    let (n, m) = (system.state_dim(), system.control_dim());
    for (x, u) in states(n, m) {
        near(what, &step(system, &x, &u), &expected(&x, &u));
    }
    for (x, u) in states(n, m).take(8) {
        let bar: Vec<f64> = (0..n).map(|i| 0.3 + 0.1 * i as f64).collect();
        let (mut x_bar, mut u_bar) = (vec![0.0; n], vec![0.0; m]);
        system.vjp(
            at(&x, &u, &vec![PHASE; system.param_dim()]),
            &bar,
            Cotangents::of(&mut x_bar, &mut u_bar),
        );
        let pulled =
            |next: Vec<f64>| vec![next.iter().zip(&bar).map(|(next, bar)| next * bar).sum()];
        let by_slopes =
            slopes(|xu| pulled(expected(&xu[..n], &xu[n..])), &[x, u].concat()).concat();
        near_slopes(what, &[x_bar, u_bar].concat(), &by_slopes);
    }
    let draw = |rng: &mut Rng, x: &mut [f64], u: &mut [f64], p: &mut [f64]| {
        x.iter_mut().chain(u).chain(p).for_each(|x| *x = rng.random_range(-3.0..3.0));
    };
    check::system_at(system, draw).unwrap_or_else(|mismatch| panic!("{what}: {mismatch}"));
}

/// Solves `a x = b` by Gaussian elimination with partial pivoting.
fn solve<T: Number>(mut a: Vec<Vec<T>>, mut b: Vec<T>) -> Vec<T> {
    let n = b.len();
    for i in 0..n {
        let pivot =
            (i..n).max_by(|&j, &k| a[j][i].size().total_cmp(&a[k][i].size())).expect("a row");
        a.swap(i, pivot);
        b.swap(i, pivot);
        let row = a[i].clone();
        for j in i + 1..n {
            let share = a[j][i] * row[i].inverse();
            for (entry, &above) in a[j][i..].iter_mut().zip(&row[i..]) {
                *entry = *entry - share * above;
            }
            b[j] = b[j] - share * b[i];
        }
    }
    for i in (0..n).rev() {
        let rest = (i + 1..n).fold(b[i], |rest, k| rest - a[i][k] * b[k]);
        b[i] = rest * a[i][i].inverse();
    }
    b
}

/// Real or complex number.
trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    fn size(self) -> f64;
    fn inverse(self) -> Self;
}

impl Number for f64 {
    fn size(self) -> f64 {
        self.abs()
    }
    fn inverse(self) -> f64 {
        1.0 / self
    }
}
