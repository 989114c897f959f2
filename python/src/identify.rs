//! `identify` and `check`: physical numbers from measurements, and checks of derivatives.

use crate::arrays::{any_shape, array, tuple};
use crate::errors::value_error;
use crate::interrupt::interruptible;
use crate::policy::Policy;
use crate::settings::{Settings, value_of};
use crate::task::Task;
use numpy::IntoPyArray;
use physgrad::identify::{IdentifyError, Options, Segment};
use pyo3::exceptions::{PyAssertionError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use toml::{Table, Value};

/// Fits physical numbers to measured trajectories, as `physgrad identify` does, in f64.
///
/// `data` is a list of pairs: measured states, (steps, n), and controls, (steps, m). NaN marks a
/// missing measurement. `params` names the unknown numbers by dotted keys. With a list, as in
/// `["system.pole_mass"]`, the fit starts from their values in the task. A dict has initial values,
/// as in `{"system.pole_mass": 0.2}`, or dicts with "start", "min" and "max". Without `params`, the
/// scene names the numbers in its section `fit`. `noise` has the standard deviation of the
/// measurement noise of each state, (n,). Without `noise`, one standard deviation holds for all
/// states, estimated from the residuals.
///
/// Returns a dict: "values" and "errors" (standard errors) by name, "chi_squared", "converged",
/// "undetermined" and "at_bound". "robust_errors", (K,), and "correlations", (K, K), refer to the K
/// unknown numbers. Raises `ValueError` if no number is unknown, if an argument does not fit the
/// task, or if the simulation with the initial values diverges. Ctrl-C raises `KeyboardInterrupt`.
#[pyfunction]
#[pyo3(signature = (task, data, params=None, noise=None))]
pub fn identify<'py>(
    py: Python<'py>,
    task: &Task,
    data: Vec<(Bound<'py, PyAny>, Bound<'py, PyAny>)>,
    params: Option<&Bound<'py, PyAny>>,
    noise: Option<Vec<f64>>,
) -> PyResult<Bound<'py, PyDict>> {
    let unknowns = params.map_or(Ok(Vec::new()), |params| unknowns(task, params))?;
    let scene = task.scene.with(unknowns).map_err(value_error)?;
    let [n, m, _] = scene.dims();
    let segment = |(i, (x, u)): (usize, &(Bound<'py, PyAny>, Bound<'py, PyAny>))| {
        Ok(Segment { x: rows("states", i, x, n)?, u: rows("controls", i, u, m)?, p: Vec::new() })
    };
    let segments = data.iter().enumerate().map(segment).collect::<PyResult<Vec<_>>>()?;
    let fit = interruptible(py, move |stop| {
        let options = Options { noise, stop: Some(stop.clone()), ..Options::default() };
        scene.identify(&segments, &options)
    })?;
    let fit = fit.map_err(|error| {
        PyValueError::new_err(match error {
            IdentifyError::NothingUnknown => {
                "the task has no unknown numbers; name them in `params`, as in {\"system.pole_mass\": 0.2}".to_owned()
            }
            IdentifyError::MissingParam { name, .. } => {
                format!(
                    "the task has the parameter `{name}`, which has no value here; use `physgrad identify`, or another effect"
                )
            }
            error => error.to_string(),
        })
    })?;
    let (values, errors) = (PyDict::new(py), PyDict::new(py));
    for ((name, value), error) in fit.names.iter().zip(&fit.values).zip(&fit.errors) {
        values.set_item(name, value)?;
        errors.set_item(name, error)?;
    }
    let (count, result) = (fit.names.len(), PyDict::new(py));
    result.set_item("values", values)?;
    result.set_item("errors", errors)?;
    result.set_item("correlations", array(py, fit.correlations.concat(), &[count, count])?)?;
    result.set_item("robust_errors", fit.robust_errors.into_pyarray(py))?;
    result.set_item("chi_squared", fit.chi_squared)?;
    result.set_item("converged", fit.converged)?;
    result.set_item("undetermined", fit.undetermined)?;
    result.set_item("at_bound", fit.at_bound)?;
    Ok(result)
}

/// Settings that make numbers of the task unknown.
fn unknowns(task: &Task, params: &Bound<'_, PyAny>) -> PyResult<Settings> {
    if let Ok(starts) = params.cast::<PyDict>() {
        let unknown = |(key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
            let key: String = key.extract()?;
            let value = value_of(&key, &value)?;
            if value.as_table().is_some_and(|table| !table.contains_key("start")) {
                return Err(PyValueError::new_err(format!("`params`: the dict of `{key}` has no \"start\", the initial value")));
            }
            Ok((key, if value.is_table() { value } else { starting_at(value) }))
        };
        return starts.iter().map(unknown).collect();
    }
    let unknown = |key: String| {
        let setting = key.split('.').try_fold(None, |found: Option<&Value>, part| {
            let table = found.map_or(Some(task.scene.settings()), Value::as_table)?;
            table.get(part).map(Some)
        });
        match setting.flatten() {
            Some(value @ (Value::Float(_) | Value::Integer(_))) => Ok((key, starting_at(value.clone()))),
            Some(value @ Value::Table(table)) if table.contains_key("start") => Ok((key, value.clone())),
            Some(_) => Err(PyValueError::new_err(format!(
                "`{key}` is no single number in the task; give an initial value, as in params={{\"{key}\": 0.2}}"
            ))),
            None => Err(PyValueError::new_err(format!("`{key}` in `params` is no setting of the task; see `task.settings`"))),
        }
    };
    if params.is_instance_of::<PyString>() {
        return Err(PyTypeError::new_err("`params` is a str; allowed: a list of keys, or a dict with initial values"));
    }
    params.extract::<Vec<String>>()?.into_iter().map(unknown).collect()
}

/// Value of a setting that makes its number unknown, with this initial value.
fn starting_at(start: Value) -> Value {
    Value::Table(Table::from_iter([("start".to_owned(), start)]))
}

/// Rows of a matrix.
fn rows(name: &str, segment: usize, object: &Bound<'_, PyAny>, width: usize) -> PyResult<Vec<Vec<f64>>> {
    let name = format!("{name} of segment {segment}");
    let array = any_shape::<f64>(&name, object)?;
    match array.shape() {
        [_, found] if *found == width => Ok(array.slice().chunks(width).map(<[f64]>::to_vec).collect()),
        shape => Err(PyValueError::new_err(format!("the {name} have the shape {}; expected (steps, {width})", tuple(shape)))),
    }
}

/// Checks the derivatives of a task and a policy against dual numbers, as `physgrad check` does.
///
/// Compares the derivatives of the system and of the policy, and the gradients of whole rollouts,
/// in f64. Rollouts have the parameters of `policy`. Without `policy`, the policy is that of the
/// task, with random parameters. Rollouts that amplify rounding errors by about 1e6 fail, although
/// all derivatives are exact.
///
/// Returns a table. If checks fail, raises `AssertionError` with all failures. Raises `ValueError`
/// if the policy does not fit the task.
#[pyfunction]
#[pyo3(signature = (task, policy=None))]
pub fn check(py: Python<'_>, task: &Task, policy: Option<&Policy>) -> PyResult<String> {
    let policy = policy.map(|policy| policy.lock().clone());
    let (table, failures) = py.detach(|| task.scene.check(policy.as_ref())).map_err(value_error)?;
    if failures.is_empty() { Ok(table) } else { Err(PyAssertionError::new_err(failures.join("\n"))) }
}
