//! Whole numbers as arguments, with their names in the errors: conversions for `from_py_with`.

use crate::errors::{invalid, wrong_type};
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;
use pyo3::types::PyBool;

/// A whole number, 0 or more, as the argument `name`.
///
/// # Errors
/// `TypeError` for another type, also bool, and `ValueError` for a number out of range.
fn whole(name: &str, object: &Bound<'_, PyAny>) -> PyResult<u64> {
    if !object.is_instance_of::<PyBool>() {
        match object.extract::<u64>() {
            Ok(number) => return Ok(number),
            Err(error) if error.is_instance_of::<PyOverflowError>(object.py()) => {
                let allowed = if object.lt(0)? { "that is not negative" } else { "below 2^64" };
                return Err(invalid(format!(
                    "`{name}` is {object}; allowed: a whole number {allowed}"
                )));
            }
            Err(_) => {}
        }
    }
    let kind = object.get_type().name()?;
    Err(wrong_type(format!("`{name}` is of type {kind}; allowed: a whole number")))
}

macro_rules! required {
    ($($name:ident: $number:ty),*) => {$(
        pub fn $name(object: &Bound<'_, PyAny>) -> PyResult<$number> {
            whole(stringify!($name), object).map(|number| number as $number)
        }
    )*};
}
macro_rules! optional {
    ($($name:ident: $number:ty),*) => {$(
        pub fn $name(object: &Bound<'_, PyAny>) -> PyResult<Option<$number>> {
            if object.is_none() {
                return Ok(None);
            }
            whole(stringify!($name), object).map(|number| Some(number as $number))
        }
    )*};
}
required!(count: usize, rounds: usize, seed: u64, t: usize);
optional!(epochs: u64, iterations: usize, threads: usize);
