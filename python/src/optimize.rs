//! `optimize`: controls that minimize the loss from one initial state.

use crate::arrays::{Argument, any_shape, array};
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

/// Optimizes the controls. `physgrad.optimize` documents arguments and result, of which this dict
/// has the attributes.
#[pyfunction]
#[pyo3(signature = (task, start, bounds=None, iterations=None, initial=None))]
pub fn optimize<'py>(
    py: Python<'py>,
    task: &Task,
    start: &Bound<'py, PyAny>,
    bounds: Option<&Bound<'py, PyAny>>,
    #[pyo3(from_py_with = whole::iterations)] iterations: Option<usize>,
    initial: Option<&Bound<'py, PyAny>>,
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
    let horizon = task.scene.horizon();
    let controls = |u| Argument::<f64>::matrix("initial", u, horizon, m)?.to_vec();
    let initial = initial.map(controls).transpose()?;
    let (problem, start) = (task.scene.task(), start.slice().to_vec());
    let plan = interruptible(py, move |stop| {
        let options = Options { stop: Some(stop.clone()), ..options };
        let initial = initial.as_deref().map_or(Initial::Zeros, Initial::Controls);
        minimize(&problem, &start[..n], &start[n..n + params], initial, &options)
    })?;
    let plan = plan.map_err(|error| invalid(error.to_string()))?;
    let result = PyDict::new(py);
    result.set_item("cost", plan.cost)?;
    result.set_item("iterations", plan.iterations())?;
    result.set_item("gradient_norm", plan.gradient_norm())?;
    result.set_item("converged", plan.converged())?;
    result.set_item("stop", plan.stop.to_string())?;
    for warning in plan.warnings() {
        let text = CString::new(&*api::plain(warning)).unwrap_or_default();
        // The place of the warning is the call of the Python function.
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)?;
    }
    result.set_item("warnings", plan.warnings())?;
    result.set_item("costs", plan.costs.into_pyarray(py))?;
    result.set_item("u", array(py, plan.u, &[horizon, m])?)?;
    result.set_item("x", array(py, plan.x, &[horizon + 1, n])?)?;
    result.set_item("gains", array(py, plan.gains, &[horizon, m, n])?)?;
    Ok(result)
}
