//! `identify` and `check`: physical numbers from measurements, and checks of derivatives.

use crate::arrays::{any_shape, array};
use crate::task::Task;
use numpy::IntoPyArray;
use physgrad::identify::{Options, Segment};
use pyo3::exceptions::{PyAssertionError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Fits physical numbers to measured trajectories, as `physgrad identify` does, in f64.
///
/// `data` is a list of pairs: measured states, (steps, n), and controls, (steps, m). NaN marks a
/// missing measurement. `params` maps dotted keys to initial values, as in
/// `{"system.pole_mass": 0.2}`; without it, the scene names the numbers in its section `fit`.
/// `noise` has the standard deviation of each state, (n,). Returns a dict: "values", "errors"
/// (standard errors) and "correlations" by name, "chi_squared", "converged", "undetermined" and
/// "at_bound". Raises `ValueError` if no number is unknown, or the data do not fit the task.
#[pyfunction]
#[pyo3(signature = (task, data, params=None, noise=None))]
pub fn identify<'py>(
    py: Python<'py>,
    task: &Task,
    data: Vec<(Bound<'py, PyAny>, Bound<'py, PyAny>)>,
    params: Option<std::collections::BTreeMap<String, f64>>,
    noise: Option<Vec<f64>>,
) -> PyResult<Bound<'py, PyDict>> {
    let unknown = |(key, start): (String, f64)| {
        let start = toml::Table::from_iter([("start".to_owned(), toml::Value::Float(start))]);
        (key, toml::Value::Table(start))
    };
    let scene = task.scene.with(params.into_iter().flatten().map(unknown)).map_err(crate::errors::value_error)?;
    let [n, m, _] = scene.dims();
    let segment = |(x, u): &(Bound<'py, PyAny>, Bound<'py, PyAny>)| {
        Ok(Segment { x: rows("states", x, n)?, u: rows("controls", u, m)?, p: Vec::new() })
    };
    let segments = data.iter().map(segment).collect::<PyResult<Vec<_>>>()?;
    let options = Options { noise, ..Options::default() };
    let fit = py.detach(|| scene.identify(&segments, &options)).map_err(|error| PyValueError::new_err(error.to_string()))?;
    if fit.names.is_empty() {
        return Err(PyValueError::new_err(
            "the task has no unknown numbers; name them in `params`, as in {\"system.pole_mass\": 0.2}",
        ));
    }
    let by_name = |values: &[f64]| fit.names.iter().cloned().zip(values.iter().copied()).collect::<Vec<_>>();
    let (values, errors) = (PyDict::new(py), PyDict::new(py));
    for ((name, value), (_, error)) in by_name(&fit.values).into_iter().zip(by_name(&fit.errors)) {
        values.set_item(&name, value)?;
        errors.set_item(&name, error)?;
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

/// Rows of a matrix.
fn rows(name: &str, object: &Bound<'_, PyAny>, width: usize) -> PyResult<Vec<Vec<f64>>> {
    let array = any_shape::<f64>(name, object)?;
    match array.shape() {
        [_, found] if *found == width => Ok(array.slice().chunks(width).map(<[f64]>::to_vec).collect()),
        shape => {
            Err(PyValueError::new_err(format!("the {name} of a segment have the shape {shape:?}; expected (steps, {width})")))
        }
    }
}

/// Checks the derivatives of the task and of its policy against dual numbers, as `physgrad check`
/// does. Returns a table. Raises `AssertionError` with all failures.
#[pyfunction]
pub fn check(py: Python<'_>, task: &Task) -> PyResult<String> {
    let (table, failures) = py.detach(|| task.scene.check());
    if failures.is_empty() { Ok(table) } else { Err(PyAssertionError::new_err(failures.join("\n"))) }
}
