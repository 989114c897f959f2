//! Settings of a scene as Python objects.

use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use toml::{Table, Value};

/// Sections whose values are sections.
const NESTED: [&str; 2] = ["effects", "actuator"];
/// Sections of a scene that keyword arguments may name.
const SECTIONS: [&str; 7] = ["system", "effects", "actuator", "integrator", "loss", "policy", "training"];

/// A list of dotted keys and values.
pub type Settings = Vec<(String, Value)>;

/// Settings from keyword arguments. The argument `settings` is a dict. Each key of this dict is
/// dotted, or names a setting outside of sections, or names a section whose value is a dict. Other
/// arguments are sections, settings in `top`, or settings of `section`.
pub fn keywords(kwargs: Option<&Bound<'_, PyDict>>, section: &str, top: &[&str]) -> PyResult<Settings> {
    let mut settings = Vec::new();
    for (key, value) in kwargs.into_iter().flatten() {
        let key: String = key.extract()?;
        if key == "settings" {
            for (key, value) in value.cast::<PyDict>()? {
                add(&mut settings, key.extract()?, &value)?;
            }
        } else if SECTIONS.contains(&&*key) || top.contains(&&*key) {
            add(&mut settings, key, &value)?;
        } else {
            settings.push((format!("{section}.{key}"), value_of(&key, &value)?));
        }
    }
    Ok(settings)
}

/// Adds one setting, or all settings of a section.
fn add(settings: &mut Settings, key: String, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let is_section = SECTIONS.contains(&&*key) || NESTED.iter().any(|section| key.strip_prefix(section).is_some_and(is_part));
    match value.cast::<PyDict>() {
        Ok(section) if is_section && !(section.is_empty() && key.contains('.')) => {
            for (inner, value) in section {
                add(settings, format!("{key}.{}", inner.extract::<String>()?), &value)?;
            }
            Ok(())
        }
        _ => {
            let value = value_of(&key, value)?;
            settings.push((key, value));
            Ok(())
        }
    }
}

/// Returns whether the rest of a key names one effect or one part of an actuator.
fn is_part(rest: &str) -> bool {
    rest.strip_prefix('.').is_some_and(|name| !name.contains('.'))
}

/// The value of a setting. Accepts numbers of numpy.
pub fn value_of(key: &str, value: &Bound<'_, PyAny>) -> PyResult<Value> {
    if let Ok(flag) = value.extract::<bool>() {
        return Ok(Value::Boolean(flag));
    }
    if let Ok(table) = value.cast::<PyDict>() {
        let entry =
            |(inner, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| Ok((inner.extract::<String>()?, value_of(key, &value)?));
        return Ok(Value::Table(table.iter().map(entry).collect::<PyResult<Table>>()?));
    }
    if let Ok(text) = value.extract::<String>() {
        return Ok(Value::String(text));
    }
    if let Ok(number) = value.extract::<i64>() {
        return Ok(Value::Integer(number));
    }
    if let Ok(number) = value.extract::<f64>() {
        return Ok(Value::Float(number));
    }
    if let Ok(elements) = value.try_iter() {
        return Ok(Value::Array(elements.map(|element| value_of(key, &element?)).collect::<PyResult<_>>()?));
    }
    let kind = value.get_type().name()?;
    Err(PyTypeError::new_err(format!("`{key}` is of type {kind}; allowed: bool, int, float, str, list and dict of these")))
}

/// The value of a setting as a Python object. A table becomes a nested dict.
pub fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match value {
        Value::String(text) => text.into_bound_py_any(py),
        Value::Integer(number) => number.into_bound_py_any(py),
        Value::Float(number) => number.into_bound_py_any(py),
        Value::Boolean(flag) => flag.into_bound_py_any(py),
        Value::Datetime(date) => date.to_string().into_bound_py_any(py),
        Value::Array(list) => list.iter().map(|value| to_python(py, value)).collect::<PyResult<Vec<_>>>()?.into_bound_py_any(py),
        Value::Table(table) => table_to_python(py, table).map(Bound::into_any),
    }
}

/// A table as a dict.
pub fn table_to_python<'py>(py: Python<'py>, table: &Table) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (key, value) in table {
        dict.set_item(key, to_python(py, value)?)?;
    }
    Ok(dict)
}
