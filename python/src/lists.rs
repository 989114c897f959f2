//! Lists of a known largest length, and mappings, as arguments.

use crate::errors::{invalid, wrong_type};
use pyo3::exceptions::{PyOverflowError, PyTypeError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyBytes, PyDict, PyMapping, PyString};

/// A list as an argument: its name, and what it may hold.
pub struct List<'a> {
    pub name: &'a str,
    /// Largest number of elements, and what sets it, as in "one number for each state".
    pub most: (usize, &'a str),
    /// What a list holds, as in "numbers".
    pub of: &'a str,
}

impl List<'_> {
    /// Reads a list, a tuple, an array or another sequence. Refuses a length above the limit before
    /// it reserves memory, since a range and a view of an array have any length without memory.
    ///
    /// # Errors
    /// `ValueError` for too many elements, `TypeError` for another type, and the exceptions of
    /// `read` and of signal handlers.
    pub fn read<'py, T>(
        &self,
        object: &Bound<'py, PyAny>,
        mut read: impl FnMut(Bound<'py, PyAny>) -> PyResult<T>,
    ) -> PyResult<Vec<T>> {
        let (py, Self { name, most: (most, why), of }) = (object.py(), self);
        check_order(name, object)?;
        let too_long = |found: &dyn std::fmt::Display| {
            invalid(format!("`{name}` has {found} elements; allowed: at most {most}, {why}"))
        };
        let is_text = object.is_instance_of::<PyString>() || object.is_instance_of::<PyBytes>();
        let count = match object.len() {
            Ok(count) if !is_text && object.cast::<PyMapping>().is_err() => count,
            Err(error) if error.is_instance_of::<PyOverflowError>(py) => {
                return Err(too_long(&"too many"));
            }
            _ => {
                let kind = object.get_type().name()?;
                return Err(wrong_type(format!(
                    "`{name}` is of type {kind}; allowed: a list or tuple of {of}"
                )));
            }
        };
        if count > *most {
            return Err(too_long(&count));
        }
        let mut elements = Vec::new();
        for element in object.try_iter()? {
            if elements.len() == *most {
                return Err(too_long(&format!("more than {most}")));
            }
            let place = elements.len();
            elements.push(read(element?).map_err(|error| element_error(name, place, error))?);
            py.check_signals()?;
        }
        Ok(elements)
    }
}

/// A `TypeError` of the conversion of an element, with its place.
fn element_error(name: &str, place: usize, error: PyErr) -> PyErr {
    Python::attach(|py| match error.is_instance_of::<PyTypeError>(py) {
        true => wrong_type(format!("`{name}[{place}]`: {}", error.value(py))),
        false => error,
    })
}

/// Refuses a set as a list: its order depends on the process. Keys of a dict have an order.
///
/// # Errors
/// `TypeError`.
pub fn check_order(name: &str, object: &Bound<'_, PyAny>) -> PyResult<()> {
    static CLASSES: [PyOnceLock<Py<pyo3::types::PyType>>; 2] = [const { PyOnceLock::new() }; 2];
    let py = object.py();
    let is_a = |i: usize, class: &str| {
        CLASSES[i].import(py, "collections.abc", class).and_then(|class| object.is_instance(class))
    };
    if is_a(0, "Set")? && !is_a(1, "MappingView")? {
        let kind = object.get_type().name()?;
        return Err(wrong_type(format!(
            "`{name}` is of type {kind}, which has no order; give a list or a tuple"
        )));
    }
    Ok(())
}

/// A dict, or another mapping as a dict. None for other objects.
///
/// # Errors
/// `ValueError` for another mapping with more than `most` keys.
pub fn mapping<'py>(
    name: &str,
    value: &Bound<'py, PyAny>,
    most: usize,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    if let Ok(dict) = value.cast::<PyDict>() {
        return Ok(Some(dict.clone()));
    }
    if value.cast::<PyMapping>().is_err() {
        return Ok(None);
    }
    let dict = PyDict::new(value.py());
    for key in value.try_iter()? {
        if dict.len() == most {
            return Err(invalid(format!("`{name}` has more than {most} elements")));
        }
        let key = key?;
        dict.set_item(&key, value.get_item(&key)?)?;
    }
    Ok(Some(dict))
}
