//! Settings of a scene as Python objects.

use crate::errors::{invalid, wrong_type};
use crate::lists::{check_order, mapping};
use physgrad_cli::api::Change;
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::collections::HashMap;
use toml::{Table, Value};

/// Sections whose values are sections.
const NESTED: [&str; 3] = ["effects", "actuator", "sensor"];
/// Sections of a scene that keyword arguments may name.
const SECTIONS: [&str; 10] = [
    "system",
    "effects",
    "actuator",
    "sensor",
    "integrator",
    "loss",
    "window",
    "equations",
    "policy",
    "training",
];

/// A list of dotted keys and values. None removes an effect or a part of the actuator.
pub type Settings = Vec<Change>;

/// Settings from keyword arguments. The argument `settings` is a dict. Each key of this dict is
/// dotted, or names a setting outside of sections, or names a section whose value is a dict. `vary` and
/// `fit` are dicts of numbers that are drawn or trained. Other arguments are sections, dotted keys in sections, settings in `top`, or settings of `section`.
///
/// # Errors
/// `ValueError` if a setting has two different values.
pub fn keywords(
    kwargs: Option<&Bound<'_, PyDict>>,
    section: &str,
    top: &[&str],
) -> PyResult<Settings> {
    let mut settings = Vec::new();
    for (key, value) in kwargs.into_iter().flatten() {
        let key: String = key.extract()?;
        if key == "settings" {
            for (key, value) in
                mapping(&key, &value, MAX_ELEMENTS)?.ok_or_else(|| no_dict(&key, &value))?
            {
                add(&mut settings, name("settings", &key)?, &value)?;
            }
        } else if key == "vary" || key == "fit" {
            numbers(&mut settings, &key, &value)?;
        } else if SECTIONS.contains(&key.split('.').next().unwrap_or_default())
            || top.contains(&&*key)
        {
            add(&mut settings, key, &value)?;
        } else {
            add(&mut settings, format!("{section}.{key}"), &value)?;
        }
    }
    let mut seen = HashMap::new();
    let text =
        |value: &Option<Value>| value.as_ref().map_or_else(|| "None".to_owned(), Value::to_string);
    for (key, value) in &settings {
        let differs = |before: &&Option<Value>| match (before, value) {
            (Some(before), Some(value)) => !is_same(before, value),
            (before, value) => before.is_some() || value.is_some(),
        };
        if let Some(before) = seen.insert(key, value).filter(differs) {
            let (before, value) = (text(before), text(value));
            return Err(invalid(format!("`{key}` is {before} and {value}; give one value")));
        }
    }
    Ok(settings)
}

fn no_dict(key: &str, value: &Bound<'_, PyAny>) -> PyErr {
    match value.get_type().name() {
        Ok(kind) => wrong_type(format!("`{key}` is of type {kind}; allowed: a dict")),
        Err(error) => error,
    }
}

/// A key of the dict `of`.
fn name(of: &str, key: &Bound<'_, PyAny>) -> PyResult<String> {
    let Ok(name) = key.extract() else {
        let kind = key.get_type().name()?;
        return Err(wrong_type(format!("`{of}` has a key of type {kind}, {key}; allowed: text")));
    };
    Ok(name)
}

/// Adds the numbers of the section `vary` or `fit`: distributions, or initial values and bounds, by
/// key. Keys without a dot are those of the section `system`.
fn numbers(settings: &mut Settings, section: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let numbers = mapping(section, value, MAX_ELEMENTS)?.ok_or_else(|| no_dict(section, value))?;
    for (key, value) in numbers {
        let name = name(section, &key)?;
        let key = if name.contains('.') { name } else { format!("system.{name}") };
        check_key(&key)?;
        let is_initial = |table: &Table| table.contains_key("start");
        let value = value_of(&key, &value)?;
        let number = match (section, value) {
            ("fit", Value::Table(table)) if is_initial(&table) => Value::Table(table),
            ("fit", start @ (Value::Integer(_) | Value::Float(_))) => starting_at(start),
            ("vary", Value::Table(table)) if !is_initial(&table) => Value::Table(table),
            (_, value) => {
                let allowed = match section {
                    "fit" => "an initial value, or a dict with \"start\", \"min\" and \"max\"",
                    _ => "a distribution, as in `physgrad.uniform(1, 2)`",
                };
                return Err(invalid(format!(
                    "`{section}`: `{key}` is {value}; allowed: {allowed}"
                )));
            }
        };
        settings.push((key, Some(number)));
    }
    Ok(())
}

/// Value of a setting that makes its number unknown, with this initial value.
pub fn starting_at(start: Value) -> Value {
    Value::Table(Table::from_iter([("start".to_owned(), start)]))
}

/// Returns whether two values of a setting are equal. Integers are also numbers, as 1 and 1.0.
pub fn is_same(a: &Value, b: &Value) -> bool {
    let number = |value: &Value| value.as_float().or(value.as_integer().map(|value| value as f64));
    match (number(a), number(b)) {
        (Some(a), Some(b)) => a == b,
        _ => a == b,
    }
}

/// Adds one setting, or all settings of a section.
fn add(settings: &mut Settings, key: String, value: &Bound<'_, PyAny>) -> PyResult<()> {
    check_key(&key)?;
    let is_section = SECTIONS.contains(&&*key)
        || NESTED.iter().any(|section| key.strip_prefix(section).is_some_and(is_part));
    match mapping(&key, value, MAX_ELEMENTS)? {
        Some(section) if is_section && !section.is_empty() => {
            for (inner, value) in section {
                add(settings, format!("{key}.{}", name(&key, &inner)?), &value)?;
            }
            Ok(())
        }
        _ => {
            let value = if value.is_none() { None } else { Some(value_of(&key, value)?) };
            settings.push((key, value));
            Ok(())
        }
    }
}

/// Refuses a key that is too long or has an empty part.
fn check_key(key: &str) -> PyResult<()> {
    if key.len() > MAX_KEY {
        let begin: String = key.chars().take(40).collect();
        return Err(invalid(format!(
            "the key that begins with `{begin}` has more than {MAX_KEY} bytes"
        )));
    }
    if key.split('.').any(str::is_empty) {
        return Err(invalid(format!("`{key}` is no key; a key is text such as `system.poles`")));
    }
    Ok(())
}

/// Returns whether the rest of a key names one effect or one part of an actuator.
fn is_part(rest: &str) -> bool {
    rest.strip_prefix('.').is_some_and(|name| !name.contains('.'))
}

/// Largest number of bytes of a key.
const MAX_KEY: usize = 1000;
/// Largest depth of the value of a setting: a number in a list has the depth 1.
const MAX_DEPTH: usize = 16;
/// Largest number of elements of the value of a setting, nested ones included.
const MAX_ELEMENTS: usize = 100_000;

/// The value of a setting. Accepts numbers of numpy.
///
/// # Errors
/// `TypeError` for another type, and `ValueError` for too deep or too large a value, for example a
/// list that contains itself.
pub fn value_of(key: &str, value: &Bound<'_, PyAny>) -> PyResult<Value> {
    Reader { key, elements: 0 }.value(value, 0)
}

/// Reads the value of a setting.
struct Reader<'a> {
    key: &'a str,
    /// Number of elements so far.
    elements: usize,
}

impl Reader<'_> {
    fn value(&mut self, value: &Bound<'_, PyAny>, depth: usize) -> PyResult<Value> {
        let key = self.key;
        self.elements += 1;
        if self.elements > MAX_ELEMENTS {
            return Err(invalid(format!("`{key}` has more than {MAX_ELEMENTS} elements")));
        }
        if depth > MAX_DEPTH {
            return Err(invalid(format!(
                "`{key}` is nested more than {MAX_DEPTH} times, or contains itself"
            )));
        }
        if let Ok(flag) = value.extract::<bool>() {
            return Ok(Value::Boolean(flag));
        }
        if let Some(table) = mapping(key, value, MAX_ELEMENTS)? {
            let mut entry = |(inner, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
                Ok((name(key, &inner)?, self.value(&value, depth + 1)?))
            };
            return Ok(Value::Table(table.iter().map(&mut entry).collect::<PyResult<Table>>()?));
        }
        if let Ok(text) = value.extract::<String>() {
            return Ok(Value::String(text));
        }
        if let Ok(number) = value.extract::<i64>() {
            return Ok(Value::Integer(number));
        }
        match value.extract::<f64>() {
            Ok(number) => return Ok(Value::Float(number)),
            Err(error) if error.is_instance_of::<PyOverflowError>(value.py()) => {
                return Err(invalid(format!("`{key}` is too large an integer")));
            }
            Err(_) => {}
        }
        check_order(key, value)?;
        if let Ok(elements) = value.try_iter() {
            return Ok(Value::Array(
                elements
                    .map(|element| self.value(&element?, depth + 1))
                    .collect::<PyResult<_>>()?,
            ));
        }
        let kind = value.get_type().name()?;
        Err(wrong_type(format!(
            "`{key}` is of type {kind}; allowed: bool, int, float, str, list and dict of these"
        )))
    }
}

/// The value of a setting as a Python object that refuses changes.
pub fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match value {
        Value::String(text) => text.into_bound_py_any(py),
        Value::Integer(number) => number.into_bound_py_any(py),
        Value::Float(number) => number.into_bound_py_any(py),
        Value::Boolean(flag) => flag.into_bound_py_any(py),
        Value::Datetime(date) => date.to_string().into_bound_py_any(py),
        Value::Array(list) => list
            .iter()
            .map(|value| to_python(py, value))
            .collect::<PyResult<Vec<_>>>()
            .and_then(|list| Ok(PyTuple::new(py, list)?.into_any())),
        Value::Table(table) => table_to_python(py, table),
    }
}

/// A table as a dict that refuses changes.
pub fn table_to_python<'py>(py: Python<'py>, table: &Table) -> PyResult<Bound<'py, PyAny>> {
    let dict = PyDict::new(py);
    for (key, value) in table {
        dict.set_item(key, to_python(py, value)?)?;
    }
    py.import("physgrad._settings")?.call_method1("Settings", (dict,))
}
