//! `identify` and `check`: physical numbers from measurements, and checks of derivatives.

use crate::arrays::{any_shape, array, tuple};
use crate::errors::value_error;
use crate::interrupt::interruptible;
use crate::policy::Policy;
use crate::settings::{Settings, value_of};
use crate::task::Task;
use numpy::IntoPyArray;
use physgrad::identify::{IdentifyError, Options, Segment};
use physgrad_cli::api::Scene;
use pyo3::exceptions::{PyAssertionError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use std::collections::HashMap;
use toml::{Table, Value};

/// Fits physical numbers to measured trajectories, as `physgrad identify` does, in f64.
///
/// `data` is a list of pairs: measured states, (steps, n), and controls, (steps, m). NaN marks a
/// missing measurement. A dict in place of a pair has the states "x", the controls "u", and
/// optionally "t", the time of the first row in s since the start of a rollout (default: 0), and
/// "p", a dict of parameters of the task by name. `t` matters if the physics depends on time, as
/// with gusts. Angles may wrap as those of an encoder do. `params` names the unknown numbers by dotted keys. With a list, as in
/// `["system.pole_mass"]`, the fit starts from their values in the task. A dict has initial values,
/// as in `{"system.pole_mass": 0.2}`, or dicts with "start", "min" and "max". Without `params`, the
/// scene names the numbers in its section `fit`. `noise` has the standard deviation of the
/// measurement noise of each state, (n,). Without `noise`, one standard deviation holds for all
/// states, estimated from the residuals.
///
/// Returns a dict: "values", "errors" (standard errors) and "statuses" by name, "chi_squared",
/// "converged", "undetermined" and "at_bound". A status is "estimated", "at bound",
/// "undetermined", "ran away", "non-finite derivative", "zero derivative" or "not converged". Only
/// estimated numbers have errors; that of a number at a bound is NaN, and others are infinite. "robust_errors", (K,), and "correlations", (K, K), refer to the K
/// unknown numbers. Raises `ValueError` if no number is unknown, if an argument does not fit the
/// task, or if the simulation with the initial values diverges. Ctrl-C raises `KeyboardInterrupt`.
#[pyfunction]
#[pyo3(signature = (task, data, params=None, noise=None))]
pub fn identify<'py>(
    py: Python<'py>,
    task: &Task,
    data: Vec<Bound<'py, PyAny>>,
    params: Option<&Bound<'py, PyAny>>,
    noise: Option<Vec<f64>>,
) -> PyResult<Bound<'py, PyDict>> {
    let unknowns = params.map_or(Ok(Vec::new()), |params| unknowns(task, params))?;
    let scene = task.scene.with(unknowns).map_err(value_error)?;
    let segments = data
        .iter()
        .enumerate()
        .map(|(i, data)| segment(&scene, i, data))
        .collect::<PyResult<Vec<_>>>()?;
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
                    "the task has the parameter `{name}`, which has no value; give a dict for each segment, as in \
                     {{\"x\": x, \"u\": u, \"p\": {{\"{name}\": 0.0}}}}"
                )
            }
            error => error.to_string(),
        })
    })?;
    let (values, errors, statuses) = (PyDict::new(py), PyDict::new(py), PyDict::new(py));
    for (i, name) in fit.names.iter().enumerate() {
        values.set_item(name, fit.values[i])?;
        errors.set_item(name, fit.errors[i])?;
        statuses.set_item(name, fit.statuses[i].name())?;
    }
    let (count, result) = (fit.names.len(), PyDict::new(py));
    result.set_item("values", values)?;
    result.set_item("errors", errors)?;
    result.set_item("statuses", statuses)?;
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
                return Err(PyValueError::new_err(format!(
                    "`params`: the dict of `{key}` has no \"start\", the initial value"
                )));
            }
            Ok((key, if value.is_table() { value } else { starting_at(value) }))
        };
        return starts.iter().map(unknown).collect();
    }
    let settings = task.scene.settings();
    let unknown = |key: String| {
        let setting = key.split('.').try_fold(None, |found: Option<&Value>, part| {
            let table = found.map_or(Some(&settings), Value::as_table)?;
            table.get(part).map(Some)
        });
        match setting.flatten() {
            Some(value @ (Value::Float(_) | Value::Integer(_))) => {
                Ok((key, starting_at(value.clone())))
            }
            Some(value @ Value::Table(table)) if table.contains_key("start") => {
                Ok((key, value.clone()))
            }
            Some(_) => Err(PyValueError::new_err(format!(
                "`{key}` is no single number in the task; give an initial value, as in params={{\"{key}\": 0.2}}"
            ))),
            None => Err(PyValueError::new_err(format!(
                "`{key}` in `params` is no setting of the task; see `task.settings`"
            ))),
        }
    };
    if params.is_instance_of::<PyString>() {
        return Err(PyTypeError::new_err(
            "`params` is a str; allowed: a list of keys, or a dict with initial values",
        ));
    }
    params.extract::<Vec<String>>()?.into_iter().map(unknown).collect()
}

/// Value of a setting that makes its number unknown, with this initial value.
fn starting_at(start: Value) -> Value {
    Value::Table(Table::from_iter([("start".to_owned(), start)]))
}

/// Distance of a time from the nearest step that counts as rounding, relative to the time step.
const OFF_GRID: f64 = 1e-3;

/// A measured segment, from a pair or a dict.
fn segment(scene: &Scene, i: usize, data: &Bound<'_, PyAny>) -> PyResult<Segment> {
    let [n, m, _] = scene.dims();
    let Ok(dict) = data.cast::<PyDict>() else {
        let (x, u): (Bound<'_, PyAny>, Bound<'_, PyAny>) = data.extract()?;
        return Ok(Segment {
            x: rows("states", i, &x, n)?,
            u: rows("controls", i, &u, m)?,
            ..Segment::default()
        });
    };
    for key in dict.keys() {
        let key: String = key.extract()?;
        if !["x", "u", "t", "p"].contains(&&*key) {
            return Err(PyValueError::new_err(format!(
                "segment {i} has the key {key:?}; allowed: \"x\", \"u\", \"t\" and \"p\""
            )));
        }
    }
    let matrix = |key: &str| {
        dict.get_item(key)?
            .ok_or_else(|| PyValueError::new_err(format!("segment {i} has no {key:?}")))
    };
    let (x, u) = (rows("states", i, &matrix("x")?, n)?, rows("controls", i, &matrix("u")?, m)?);
    let names = scene.param_names();
    let mut p = vec![f64::NAN; names.len()];
    for (name, value) in dict
        .get_item("p")?
        .map(|p| p.extract::<HashMap<String, f64>>())
        .transpose()?
        .unwrap_or_default()
    {
        let place = names.iter().position(|known| *known == name).ok_or_else(|| {
            PyValueError::new_err(format!(
                "segment {i}: {name:?} in \"p\" is no parameter of the task; allowed: {}",
                names.join(", ")
            ))
        })?;
        p[place] = value;
    }
    scene
        .check_params(&p)
        .map_err(|error| PyValueError::new_err(format!("segment {i}: {error}")))?;
    let t = dict.get_item("t")?.map_or(Ok(0.0), |t| t.extract::<f64>())?;
    let step = t / scene.dt();
    if !step.is_finite() || step.abs() > 9e15 {
        return Err(PyValueError::new_err(format!(
            "segment {i}: \"t\" is {t}; allowed: finite times in s"
        )));
    }
    let segment = Segment { x, u, p, first_step: step.round().max(0.0) as usize };
    let is_step = (step - step.round()).abs() < OFF_GRID && step.round() >= 0.0;
    if !is_step && scene.depends_on_time(&segment) {
        return Err(PyValueError::new_err(format!(
            "segment {i}: \"t\" is {t} s, but the physics depends on time and has steps of {} s from 0; begin at a step",
            scene.dt()
        )));
    }
    Ok(segment)
}

/// Rows of a matrix.
fn rows(
    name: &str,
    segment: usize,
    object: &Bound<'_, PyAny>,
    width: usize,
) -> PyResult<Vec<Vec<f64>>> {
    let name = format!("{name} of segment {segment}");
    let array = any_shape::<f64>(&name, object)?;
    match array.shape() {
        [_, found] if *found == width => {
            Ok(array.slice().chunks(width).map(<[f64]>::to_vec).collect())
        }
        shape => Err(PyValueError::new_err(format!(
            "the {name} have the shape {}; expected (steps, {width})",
            tuple(shape)
        ))),
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
/// if the policy does not fit the task. Ctrl-C raises `KeyboardInterrupt`; the checks then run to
/// their end on another thread.
#[pyfunction]
#[pyo3(signature = (task, policy=None))]
pub fn check(py: Python<'_>, task: &Task, policy: Option<&Policy>) -> PyResult<String> {
    let policy = policy.map(|policy| policy.lock().clone());
    let scene = task.scene.clone();
    let (table, failures) =
        interruptible(py, move |_| scene.check(policy.as_ref()))?.map_err(value_error)?;
    if failures.is_empty() {
        Ok(table)
    } else {
        Err(PyAssertionError::new_err(failures.join("\n")))
    }
}
