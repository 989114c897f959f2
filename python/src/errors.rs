//! Errors of the library as Python exceptions.

use physgrad::TrainError;
use physgrad::engine::Variable;
use physgrad_cli::api;
use pyo3::create_exception;
use pyo3::exceptions::{
    PyArithmeticError, PyMemoryError, PyRuntimeError, PyTypeError, PyValueError,
};
use pyo3::prelude::*;
use std::io;
use std::path::Path;

create_exception!(
    physgrad,
    Divergence,
    PyArithmeticError,
    "A number is not finite.\n\nAttributes: `step`, `sample`, `component` (ints or None) and `variable` (\"state\", \"control\",\n\
     \"memory\", \"cost\" or \"gradient\"). For \"gradient\", `component` is the index of the parameter."
);

/// `ValueError` with this text. Text of foreign files in it has escapes in place of characters that
/// a terminal obeys.
pub fn invalid(text: impl AsRef<str>) -> PyErr {
    PyValueError::new_err(api::plain(text.as_ref()).into_owned())
}

/// `TypeError` with this text, as [`invalid`].
pub fn wrong_type(text: impl AsRef<str>) -> PyErr {
    PyTypeError::new_err(api::plain(text.as_ref()).into_owned())
}

/// Converts an error in settings or arguments. A divergence becomes `Divergence`, an error of the
/// file system `OSError`, too large an array `MemoryError`, and every other error `ValueError`.
pub fn value_error(error: anyhow::Error) -> PyErr {
    convert(error, PyValueError::new_err)
}

/// Converts an error during a computation. A divergence becomes `Divergence`, an error of the file
/// system `OSError`, and every other error `RuntimeError`.
pub fn runtime_error(error: anyhow::Error) -> PyErr {
    convert(error, PyRuntimeError::new_err)
}

/// Returns the result of `work`. A panic becomes `RuntimeError`, which `except Exception` catches.
pub fn caught<R>(work: impl FnOnce() -> R) -> PyResult<R> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied());
        PyRuntimeError::new_err(format!(
            "internal error of physgrad, please report it: {}",
            api::plain(text.unwrap_or("a panic"))
        ))
    })
}

/// Returns `ValueError` if something that is no file has this path, for example a pipe. Reading it
/// could wait forever.
pub fn check_regular(path: &Path) -> PyResult<()> {
    match std::fs::metadata(path) {
        Ok(found) if !found.is_file() => Err(invalid(format!("{} is not a file", path.display()))),
        _ => Ok(()),
    }
}

/// Returns `MemoryError` if an array with these dimensions does not fit into memory.
pub fn fits(what: &'static str, dims: &[usize], size: usize) -> PyResult<()> {
    api::fits(what, dims, size).map_err(|error| PyMemoryError::new_err(error.to_string()))
}

fn convert(error: anyhow::Error, other: fn(String) -> PyErr) -> PyErr {
    let text = api::plain(&format!("{error:#}")).into_owned();
    let diverged = error.chain().find_map(|cause| match cause.downcast_ref::<TrainError>() {
        Some(TrainError::Diverged { last, .. }) => Some(last.divergence),
        _ => cause.downcast_ref::<physgrad::Divergence>().copied(),
    });
    if let Some(diverged) = diverged {
        return divergence(diverged, text);
    }
    if error.chain().any(|cause| cause.is::<api::TooLarge>() || cause.is::<api::TooLong>()) {
        return PyMemoryError::new_err(text);
    }
    // An error of the file system has the class of its kind, such as `FileNotFoundError`.
    if let Some(cause) = error.chain().find_map(|cause| cause.downcast_ref::<io::Error>()) {
        return io::Error::new(cause.kind(), text).into();
    }
    other(text)
}

/// The exception `Divergence`, with the place as attributes.
pub fn divergence(diverged: physgrad::Divergence, text: String) -> PyErr {
    use physgrad::Divergence as Place;
    let name = |variable| match variable {
        Variable::State => "state",
        Variable::Control => "control",
        Variable::Memory => "memory",
        Variable::Parameter => "parameter",
    };
    let (step, sample, component, variable) = match diverged {
        Place::Forward { variable, step, sample, component, .. }
        | Place::Cotangent { variable, step, sample, component, .. } => {
            (Some(step), Some(sample), Some(component), name(variable))
        }
        Place::Cost { sample } => (None, Some(sample), None, "cost"),
        Place::Gradient { parameter, .. } | Place::Field { parameter, .. } => {
            (None, None, Some(parameter), "gradient")
        }
    };
    Python::attach(|py| {
        let error = Divergence::new_err(text);
        let value = error.value(py);
        let set = || -> PyResult<()> {
            value.setattr("step", step)?;
            value.setattr("sample", sample)?;
            value.setattr("component", component)?;
            value.setattr("variable", variable)
        };
        set().map_or_else(|failed| failed, |()| error)
    })
}
