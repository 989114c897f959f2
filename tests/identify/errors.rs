//! A fit without finite derivatives does not converge. Unknowns are distinct entries of p. A flag
//! stops an identification.

use physgrad::identify::{Fit, IdentifyError, Options, Segment, Unknown, identify};
use physgrad::{Inputs, Scalar, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// `x' = x/2 + √p`.
struct Root;

impl System for Root {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 0.5 + p[0].sqrt();
    }
}

/// Fits p to 20 states of a simulation with p = 0.09.
fn fit(unknowns: &[Unknown]) -> Result<Fit, IdentifyError> {
    let states = std::iter::successors(Some(1.0), |x| Some(0.5 * x + 0.3));
    let segment = Segment {
        x: states.map(|x| vec![x]).take(20).collect(),
        p: vec![0.0],
        ..Segment::default()
    };
    identify(&Root, &[segment], unknowns, &Options::default())
}

fn unknown(start: f64) -> Unknown {
    Unknown { name: "p".into(), index: 0, start, min: 0.0, max: 1.0 }
}

/// The derivative of √p at p = 0 is infinite, so no step is possible.
#[test]
fn a_fit_without_finite_derivatives_has_not_converged() {
    let stuck = fit(&[unknown(0.0)]).expect("finite simulations");
    assert!(!stuck.converged && stuck.values == [0.0], "{stuck:?}");
    let found = fit(&[unknown(0.12)]).expect("valid data");
    assert!(found.converged && (found.values[0] - 0.09).abs() < 1e-6, "{found:?}");
}

#[test]
fn an_entry_of_p_is_unknown_once() {
    let twice = [unknown(0.5), Unknown { name: "q".into(), ..unknown(0.2) }];
    let error = fit(&twice).expect_err("one entry with two names");
    assert_eq!(error, IdentifyError::Twice { names: ["p".into(), "q".into()], index: 0 });
}

/// `x' = x/2 + p`. Sets the flag of the options at step number `at`, counted from 0.
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
        0
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        if self.steps.fetch_add(1, Ordering::Relaxed) == self.at {
            self.stop.store(true, Ordering::Relaxed);
        }
        next[0] = x[0] * 0.5 + p[0];
    }
}

#[test]
fn a_flag_stops_an_identification_before_the_next_window() {
    let states: Vec<Vec<f64>> = std::iter::successors(Some(1.0), |x| Some(0.5 * x + 0.3))
        .map(|x| vec![x])
        .take(400)
        .collect();
    let run = |at: usize| {
        let system = Stopping { at, ..Stopping::default() };
        let options = Options { stop: Some(system.stop.clone()), ..Options::default() };
        let segment = Segment { x: states.clone(), p: vec![0.0], ..Segment::default() };
        let fit = identify(&system, &[segment], &[unknown(0.5)], &options);
        (fit, system.steps.into_inner())
    };
    let (whole, steps) = run(usize::MAX);
    assert!(whole.expect("valid data").converged);
    // Each thread finishes the window of ten steps that it began. Each of these steps is evaluated
    // at most twice: once for the state and once for its derivatives.
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = std::env::var("RAYON_NUM_THREADS")
        .ok()
        .and_then(|threads| threads.parse::<usize>().ok())
        .unwrap_or(0);
    let windows = 2 * 10 * cores.max(threads);
    for at in (0..8).map(|part| steps * part / 8) {
        let (stopped, taken) = run(at);
        assert_eq!(stopped, Err(IdentifyError::Stopped));
        assert!(taken <= at + windows + 1, "{taken} steps after a stop at {at} of {steps}");
    }
}
