//! [`step_seconds`]: the time of a step in Rust, for `examples/speed.py`.

use crate::arrays::{Argument, Number, is_f32, with_precision, zeros};
use crate::errors::invalid;
use crate::task::Task;
use crate::threads;
use physgrad::engine::rows;
use physgrad::{DynTask, Inputs};
use pyo3::prelude::*;
use std::hint::black_box;
use std::time::Instant;

/// Seconds in Rust for one step of all B rows of `x`, (B, n), and `u`, (B, m): the shortest of
/// `repeats` measurements. Raises `ValueError` if the task has parameters.
#[pyfunction]
pub fn step_seconds(
    py: Python<'_>,
    task: &Task,
    x: &Bound<'_, PyAny>,
    u: &Bound<'_, PyAny>,
    repeats: usize,
) -> PyResult<f64> {
    let [n, m, params] = task.scene.dims();
    if params > 0 {
        return Err(invalid("the task has parameters; time a task without drawn numbers"));
    }
    let step = task.scene.task();
    with_precision!(is_f32([x, u]), F => {
        let (x, b) = Argument::<F>::first("x", x, n)?;
        let u = Argument::<F>::matrix("u", u, b, m)?;
        let (x, u) = (x.slice(), u.slice());
        fastest(py, &step, x, u, repeats)
    })
}

fn fastest<F: Number>(
    py: Python<'_>,
    task: &DynTask,
    x: &[F],
    u: &[F],
    repeats: usize,
) -> PyResult<f64> {
    threads::ready()?;
    let mut next = zeros(&[x.len()])?;
    let mut least = f64::INFINITY;
    for _ in 0..repeats {
        let seconds = py.detach(|| {
            let begin = Instant::now();
            rows::step(task, Inputs { x: black_box(x), u: black_box(u), p: &[], t: 0 }, &mut next);
            black_box(&mut next);
            begin.elapsed().as_secs_f64()
        });
        least = least.min(seconds);
        py.check_signals()?;
    }
    Ok(least)
}
