//! Errors name the invalid argument, or the variable or cost with a non-finite value or derivative.
//! Further tests cover a system without controls, and the flag that stops an optimization.

use super::problems::{Coupled, Explosive};
use physgrad::optimize::{Initial, OptimizeError, Options, optimize};
use physgrad::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

#[test]
fn divergence_error_names_variable_step_and_component() {
    // x grows as 3^(2^t): 3^512 is finite, 3^1024 is not.
    let result = optimize(&Explosive, &[3.0], &[], Initial::Zeros, &Options::default());
    assert_eq!(result, Err(OptimizeError::Diverged { variable: "state", step: 10, component: 0 }));
    assert!(result.unwrap_err().to_string().contains("component 0 of the state at step 10"));
    let result = optimize(&Explosive, &[f64::NAN], &[], Initial::Zeros, &Options::default());
    assert_eq!(result, Err(OptimizeError::NotFinite { argument: "x0", index: 0 }));
    let feedback = |t: usize, _: &[f64], u: &mut [f64]| u[0] = if t == 4 { f64::NAN } else { 0.0 };
    for options in [Options::default(), Options::default().bounded(1, 1.0)] {
        let result = optimize(&Explosive, &[0.5], &[], Initial::Feedback(&feedback), &options);
        assert_eq!(
            result,
            Err(OptimizeError::Diverged { variable: "control", step: 4, component: 0 })
        );
    }
}

#[test]
fn wrong_lengths_of_arguments_are_refused() {
    let run = |x0: &[f64], p: &[f64], u: &[f64], options: &Options| {
        let error =
            optimize(&Coupled, x0, p, Initial::Controls(u), options).expect_err("a wrong length");
        let OptimizeError::Length { argument, expected, found, .. } = error else {
            panic!("{error}")
        };
        (argument, expected, found)
    };
    let (options, u) = (Options::default(), vec![0.0; 24]);
    assert_eq!(run(&[0.0], &[0.0], &u, &options), ("x0", 2, 1));
    assert_eq!(run(&[0.0; 2], &[], &u, &options), ("p", 1, 0));
    assert_eq!(run(&[0.0; 2], &[0.0], &u[1..], &options), ("the initial controls", 24, 23));
    assert_eq!(run(&[0.0; 2], &[0.0], &u, &options.bounded(3, 1.0)), ("options.bounds", 2, 3));
}

#[test]
fn bounds_without_a_finite_control_are_refused() {
    for [low, high] in
        [[1.0, 0.5], [f64::NAN, 1.0], [0.0, f64::NAN], [f64::INFINITY; 2], [f64::NEG_INFINITY; 2]]
    {
        let options = Options { bounds: Some(vec![[0.0, 1.0], [low, high]]), ..Options::default() };
        let error = optimize(&Coupled, &[0.0; 2], &[0.0], Initial::Zeros, &options)
            .expect_err("no control is allowed");
        assert!(matches!(error, OptimizeError::Bounds { control: 1, .. }), "{error}");
    }
}

/// Task in which one cost is non-finite at the state 0, or has an infinite derivative there.
struct Broken {
    /// Selects the terminal cost instead of the running cost of step 3.
    terminal: bool,
    /// Selects the infinite derivative of the root instead of the infinite value of the logarithm.
    root: bool,
}

impl System for Broken {
    fn state_dim(&self) -> usize {
        1
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + u[0];
    }
}

impl Broken {
    /// Returns `√x`, whose derivative is infinite at 0, or `ln x`, which is -∞ at 0.
    fn at_zero<T: Scalar>(&self, x: T) -> T {
        if self.root { x.sqrt() } else { x.ln() }
    }
}

impl Task for Broken {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    fn horizon(&self) -> usize {
        5
    }

    fn start(&self, _: &mut Rng, _: Start<'_>) {}

    fn running_cost<T: Scalar>(&self, Inputs { x, t, .. }: Inputs<'_, T>, _next: &[T]) -> T {
        if t == 3 && !self.terminal { self.at_zero(x[0]) } else { x[0] * x[0] }
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        if self.terminal { self.at_zero(x[0]) } else { x[0] }
    }
}

#[test]
fn errors_name_the_cost_with_a_non_finite_value_or_derivative() {
    for terminal in [false, true] {
        let step = (!terminal).then_some(3);
        let run = |root: bool| {
            optimize(&Broken { terminal, root }, &[0.0], &[], Initial::Zeros, &Options::default())
        };
        assert_eq!(run(false), Err(OptimizeError::Cost { step }));
        assert_eq!(run(true), Err(OptimizeError::Derivative { step }));
        let place = if terminal { "terminal cost" } else { "running cost of step 3" };
        assert!(run(true).unwrap_err().to_string().contains(place));
    }
}

/// `x' = x/2` without controls, over five steps.
struct Uncontrolled;

impl System for Uncontrolled {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 0.5;
    }
}

impl Task for Uncontrolled {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        5
    }
    fn start(&self, _: &mut Rng, _: Start<'_>) {}
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * x[0]
    }
}

#[test]
fn the_plan_of_a_system_without_controls_is_its_rollout() {
    let plan = optimize(&Uncontrolled, &[1.0], &[], Initial::Zeros, &Options::default())
        .expect("a finite rollout");
    assert_eq!((plan.horizon(), plan.state(5), plan.cost), (5, &[1.0 / 32.0][..], 1.0 / 1024.0));
    assert!(plan.converged() && plan.u.is_empty() && plan.control(4).is_empty());
}

/// `x' = x + sin u`, over 30 steps. The running cost is `u²/100 + (x - 1)⁴`, the terminal cost
/// `(x - 1)²`. The call of `step` with the number `at` sets the flag `stop`. Numbers count from 0
/// over all calls, in rollouts and for derivatives.
#[derive(Default)]
struct Stopping {
    steps: AtomicUsize,
    at: usize,
    stop: Arc<AtomicBool>,
}

impl System for Stopping {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        if self.steps.fetch_add(1, Ordering::Relaxed) == self.at {
            self.stop.store(true, Ordering::Relaxed);
        }
        next[0] = x[0] + u[0].sin();
    }
}

impl Task for Stopping {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        30
    }
    fn start(&self, _: &mut Rng, _: Start<'_>) {}
    fn running_cost<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, _next: &[T]) -> T {
        let square = (x[0] - 1.0) * (x[0] - 1.0);
        u[0] * u[0] * 0.01 + square * square
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        (x[0] - 1.0) * (x[0] - 1.0)
    }
}

#[test]
fn a_flag_stops_an_optimization_before_the_next_step() {
    let run = |at: usize| {
        let task = Stopping { at, ..Stopping::default() };
        let options = Options { stop: Some(task.stop.clone()), ..Options::default() };
        let plan = optimize(&task, &[0.0], &[], Initial::Zeros, &options);
        (plan, task.steps.into_inner())
    };
    let (whole, steps) = run(usize::MAX);
    assert!(whole.expect("a finite rollout").iterations() > 3);
    for at in (0..steps - 1).step_by(7) {
        let (stopped, taken) = run(at);
        assert_eq!((stopped, taken), (Err(OptimizeError::Stopped), at + 1));
    }
}

#[test]
fn the_number_of_iterations_has_a_limit() {
    let options = |max_iterations| Options { max_iterations, ..Options::default() };
    let run = |most| optimize(&Coupled, &[0.0; 2], &[0.0], Initial::Zeros, &options(most));
    let found = Options::MOST_ITERATIONS + 1;
    assert_eq!(run(found).expect_err("too many"), OptimizeError::Iterations { found });
    run(Options::MOST_ITERATIONS).expect("the limit is allowed");
}
