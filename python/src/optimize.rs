//! `optimize`: controls that minimize the loss from one initial state.

use crate::arrays::{any_shape, array};
use crate::errors::invalid;
use crate::interrupt::interruptible;
use crate::lists::List;
use crate::task::Task;
use crate::whole;
use numpy::IntoPyArray;
use physgrad::optimize::{Initial, Options, optimize as minimize};
use physgrad_cli::api;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ffi::CString;

/// Optimizes the controls from one initial state `start`, (start_dim,), as `physgrad optimize`
/// does, in f64. Noise has its mean.
///
/// `bounds` has the low and high bound of each control, (m, 2). `iterations` is the largest number
/// of iterations, 200 by default, up to 1,000,000. The search starts at controls of 0.
///
/// Returns a dict: controls "u", (T, m), states "x", (T+1, n), "cost", "iterations",
/// "gradient_norm", "converged" and "stop". "gains", (T, m, n), are those of the feedback
/// u_t + K_t (x - x_t). "costs" holds the initial cost, then the cost after each iteration.
/// "warnings" has sentences about a search that may have ended far from a minimum, each also a
/// `UserWarning`. Raises `ValueError` if an argument is invalid, or if the initial trajectory, the initial cost or a
/// derivative is not finite. Ctrl-C raises `KeyboardInterrupt`.
#[pyfunction]
#[pyo3(signature = (task, start, bounds=None, iterations=None))]
pub fn optimize<'py>(
    py: Python<'py>,
    task: &Task,
    start: &Bound<'py, PyAny>,
    bounds: Option<&Bound<'py, PyAny>>,
    #[pyo3(from_py_with = whole::iterations)] iterations: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let [n, m, params] = task.scene.dims();
    let start = any_shape::<f64>("start", start, task.width)?;
    task.check_starts(start.slice())?;
    let pairs = List {
        name: "bounds",
        most: (m, "one pair of a low and a high bound for each control"),
        of: "pairs of numbers",
    };
    let pair = |pair: Bound<'py, PyAny>| pair.extract::<[f64; 2]>();
    let bounds = bounds.map(|bounds| pairs.read(bounds, pair)).transpose()?;
    let mut options = Options { bounds, ..Options::default() };
    options.max_iterations = iterations.unwrap_or(options.max_iterations);
    let (problem, start) = (task.scene.task(), start.slice().to_vec());
    let plan = interruptible(py, move |stop| {
        let options = Options { stop: Some(stop.clone()), ..options };
        minimize(&problem, &start[..n], &start[n..n + params], Initial::Zeros, &options)
    })?;
    let plan = plan.map_err(|error| invalid(error.to_string()))?;
    let (horizon, result) = (plan.horizon(), PyDict::new(py));
    result.set_item("cost", plan.cost)?;
    result.set_item("iterations", plan.iterations())?;
    result.set_item("gradient_norm", plan.gradient_norm())?;
    result.set_item("converged", plan.converged())?;
    result.set_item("stop", plan.stop.to_string())?;
    for warning in plan.warnings() {
        let text = CString::new(&*api::plain(warning)).unwrap_or_default();
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)?;
    }
    result.set_item("warnings", plan.warnings())?;
    result.set_item("costs", plan.costs.into_pyarray(py))?;
    result.set_item("u", array(py, plan.u, &[horizon, m])?)?;
    result.set_item("x", array(py, plan.x, &[horizon + 1, n])?)?;
    result.set_item("gains", array(py, plan.gains, &[horizon, m, n])?)?;
    Ok(result)
}
