//! `accuracy`: errors and costs of integrators, step sizes and precisions.

use crate::errors::{invalid, value_error};
use crate::interrupt::interruptible;
use crate::task::Task;
use crate::whole;
use numpy::IntoPyArray;
use physgrad_cli::api::{Cheapest, Errors, Measured, Metric, Row};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::atomic::Ordering;

/// Error measures and their names in Python.
const METRICS: [(&str, Metric); 4] = [
    ("trajectory", Metric::Trajectory),
    ("loss", Metric::Loss),
    ("R", Metric::R),
    ("M", Metric::M),
];

/// Errors and costs of all settings. `physgrad.accuracy` documents arguments and result, of which
/// this dict has the attributes.
#[pyfunction]
#[pyo3(signature = (task, target=None, metric="trajectory", rounds=5))]
pub fn accuracy<'py>(
    py: Python<'py>,
    task: &Task,
    target: Option<f64>,
    metric: &str,
    #[pyo3(from_py_with = whole::rounds)] rounds: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let Some(&(_, measure)) = METRICS.iter().find(|(name, _)| *name == metric) else {
        let names = METRICS.map(|(name, _)| format!("\"{name}\"")).join(", ");
        return Err(invalid(format!("`metric` is \"{metric}\"; allowed: {names}")));
    };
    if let Some(target) = target.filter(|target| target.is_nan() || *target <= 0.0) {
        return Err(invalid(format!(
            "`target` is {target}; allowed: a positive error, for example 1e-4"
        )));
    }
    if !(1..=1000).contains(&rounds) {
        return Err(invalid(format!("`rounds` is {rounds}; allowed: an integer from 1 to 1000")));
    }
    let scene = task.scene.clone();
    let measured = interruptible(py, move |stop| {
        scene.accuracy(rounds, &mut |_| {
            if stop.load(Ordering::Relaxed) { anyhow::bail!("stopped") } else { Ok(()) }
        })
    })?;
    let measured = measured.map_err(value_error)?;
    let result = PyDict::new(py);
    result.set_item("settings", columns(py, &measured)?)?;
    let reference = PyDict::new(py);
    for (name, metric) in METRICS {
        reference.set_item(name, metric.read(&measured.reference))?;
    }
    result.set_item("reference", reference)?;
    let cheapest = target.and_then(|target| measured.cheapest(measure, target));
    let cheapest = cheapest.map(|Cheapest { row, error, .. }| {
        let found = PyDict::new(py);
        found.set_item("method", row.setting.method)?;
        found.set_item("substeps", row.setting.substeps)?;
        found.set_item("precision", row.setting.precision.name())?;
        found.set_item("error", error)?;
        found.set_item("seconds", measure.time(row))?;
        found.set_item(
            "task",
            Task::new(task.scene.with_setting(&row.setting).map_err(value_error)?),
        )?;
        PyResult::Ok(found)
    });
    result.set_item("cheapest", cheapest.transpose()?)?;
    Ok(result)
}

/// Columns of all settings.
fn columns<'py>(py: Python<'py>, Measured { rows, .. }: &Measured) -> PyResult<Bound<'py, PyDict>> {
    let columns = PyDict::new(py);
    let numbers = |number: &dyn Fn(&Row) -> f64| {
        rows.iter().map(number).collect::<Vec<f64>>().into_pyarray(py)
    };
    let counts =
        |count: fn(&Row) -> i64| rows.iter().map(count).collect::<Vec<i64>>().into_pyarray(py);
    columns.set_item("method", rows.iter().map(|row| row.setting.method).collect::<Vec<_>>())?;
    columns.set_item("substeps", counts(|row| row.setting.substeps as i64))?;
    columns.set_item(
        "precision",
        rows.iter().map(|row| row.setting.precision.name()).collect::<Vec<_>>(),
    )?;
    for (name, metric) in METRICS {
        let error = |errors: &Errors| metric.read(errors);
        columns.set_item(name, numbers(&|row| row.errors.as_ref().map_or(f64::NAN, error)))?;
    }
    columns.set_item("operations", counts(|row| row.operations as i64))?;
    columns.set_item("bytes", numbers(&|row| row.bytes))?;
    for (pass, name) in ["forward_seconds", "gradient_seconds"].into_iter().enumerate() {
        columns.set_item(name, numbers(&|row| row.seconds[pass][1]))?;
    }
    Ok(columns)
}
