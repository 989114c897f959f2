//! Row-major numpy arrays: arguments, results and their shapes.

use crate::errors::{fits, invalid, wrong_type};
use numpy::{Element, IntoPyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods};
use numpy::{PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods, dtype};
use physgrad::Float;
use pyo3::exceptions::{PyException, PyMemoryError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyMapping, PySequence, PyTuple};
use std::ops::Range;

/// Number type of arrays: `f32` or `f64`.
pub trait Number: Float + Element {}
impl<F: Float + Element> Number for F {}

/// Evaluates `$body` with `$F` = `f32` if `$is_f32`, and `f64` otherwise.
macro_rules! with_precision {
    ($is_f32:expr, $F:ident => $body:expr) => {
        if $is_f32 {
            type $F = f32;
            $body
        } else {
            type $F = f64;
            $body
        }
    };
}
pub(crate) use with_precision;

/// Returns true if all arguments are arrays of float32. As in NumPy, one array of another dtype, or
/// a list, makes the result float64.
pub fn is_f32<'a, 'py: 'a>(arguments: impl IntoIterator<Item = &'a Bound<'py, PyAny>>) -> bool {
    let is_f32 = |argument: &Bound<'py, PyAny>| {
        let py = argument.py();
        argument
            .cast::<PyUntypedArray>()
            .is_ok_and(|array| array.dtype().is_equiv_to(&dtype::<f32>(py)))
    };
    arguments.into_iter().all(is_f32)
}

/// Returns whether the object is a masked array, a subclass of `numpy.ndarray` whose mask a
/// conversion drops.
fn is_masked(object: &Bound<'_, PyAny>) -> PyResult<bool> {
    let is_subclass =
        object.cast::<PyUntypedArray>().is_ok() && !object.is_exact_instance_of::<PyUntypedArray>();
    Ok(is_subclass && object.hasattr("mask")?)
}

/// Refuses a sequence, such as a range, whose elements do not fit into memory, and a mapping: NumPy
/// reads all elements before it knows the shape.
fn check_elements(name: &str, object: &Bound<'_, PyAny>) -> PyResult<()> {
    /// A reference, and the number.
    const ELEMENT: usize = 40;
    check_kind(name, object)?;
    match object.len() {
        Ok(count) if object.cast::<PySequence>().is_ok() => {
            fits("the elements of an argument", &[count], ELEMENT)
        }
        _ => Ok(()),
    }
}

/// Refuses a list or tuple with a masked array or a mapping, of which NumPy reads the masked values
/// or the keys.
fn check_list(name: &str, object: &Bound<'_, PyAny>) -> PyResult<()> {
    if !object.is_instance_of::<PyList>() && !object.is_instance_of::<PyTuple>() {
        return Ok(());
    }
    for (i, element) in object.try_iter()?.enumerate() {
        let element = element?;
        if is_masked(&element)? {
            return Err(invalid(format!(
                "`{name}` is a list with a masked array, element {i}; fill it, as in `row.filled(numpy.nan)`"
            )));
        }
        check_kind(&format!("{name}[{i}]"), &element)?;
    }
    Ok(())
}

/// Refuses a mapping, which is no array.
fn check_kind(name: &str, object: &Bound<'_, PyAny>) -> PyResult<()> {
    if object.cast::<PyMapping>().is_ok() && object.cast::<PySequence>().is_err() {
        let kind = object.get_type().name()?;
        return Err(wrong_type(format!("`{name}` is of type {kind}; allowed: an array")));
    }
    Ok(())
}

/// Refuses complex numbers, whose imaginary part a conversion drops, text, dates and masks.
fn check_numbers(name: &str, array: &Bound<'_, PyUntypedArray>) -> PyResult<()> {
    let dtype = array.dtype();
    if matches!(dtype.kind(), b'b' | b'c' | b'S' | b'U' | b'M' | b'm') {
        return Err(wrong_type(format!("`{name}` is an array of {dtype}; allowed: real numbers")));
    }
    Ok(())
}

/// Refuses tensors of PyTorch and traced arrays of JAX, whose derivatives a conversion loses.
fn check_library(name: &str, object: &Bound<'_, PyAny>) -> PyResult<()> {
    if object.cast::<PyUntypedArray>().is_ok() {
        return Ok(());
    }
    let kind = object.get_type();
    let module = kind.module()?.to_string();
    match module.split('.').next() {
        Some("torch") => Err(wrong_type(format!(
            "`{name}` is a tensor of PyTorch; `physgrad.torch` has differentiable functions of tensors, and \
             `{name}.detach().cpu().numpy()` is an array"
        ))),
        Some("jax" | "jaxlib") if kind.name()?.to_string().ends_with("Tracer") => {
            Err(wrong_type(format!(
                "`{name}` is traced by JAX; use the functions of `physgrad.jax` inside of `jit`, `grad`, `vmap` and `scan`"
            )))
        }
        _ => Ok(()),
    }
}

/// Contiguous argument of the number type `F`. Copies the given array only if its layout or type
/// differs.
pub struct Argument<'py, F: Number>(PyReadonlyArrayDyn<'py, F>);

impl<'py, F: Number> Argument<'py, F> {
    /// Reads an argument whose shape passes `check`. Checks before it copies.
    pub fn read(
        name: &str,
        object: &Bound<'py, PyAny>,
        check: &dyn Fn(&[usize]) -> Result<(), String>,
    ) -> PyResult<Self> {
        let py = object.py();
        if is_masked(object)? {
            return Err(invalid(format!(
                "`{name}` is a masked array; fill it, as in `{name}.filled(numpy.nan)`"
            )));
        }
        check_library(name, object)?;
        check_list(name, object)?;
        let numpy = || py.import("numpy");
        let given = match object.cast::<PyUntypedArray>() {
            Ok(array) => array.clone(),
            Err(_) => {
                check_elements(name, object)?;
                let converted = numpy()?.call_method1("asarray", (object,));
                converted.map_err(|error| named(py, name, error))?.cast_into::<PyUntypedArray>()?
            }
        };
        check_numbers(name, &given)?;
        check(given.shape()).map_err(invalid)?;
        let array = match given.cast::<PyArrayDyn<F>>() {
            Ok(array) if array.is_c_contiguous() && array.is_aligned() => array.clone(),
            _ => {
                fits("the copy of an argument", given.shape(), size_of::<F>())?;
                let converted =
                    numpy()?.call_method1("require", (&given, dtype::<F>(py), ["C", "A"]));
                converted.map_err(|error| named(py, name, error))?.cast_into::<PyArrayDyn<F>>()?
            }
        };
        array
            .try_readonly()
            .map(Self)
            .map_err(|error| invalid(format!("`{name}` cannot be read: {error}")))
    }

    /// Reads the first argument, which sets the number of rows.
    pub fn first(name: &str, object: &Bound<'py, PyAny>, width: usize) -> PyResult<(Self, usize)> {
        let array = Self::read(name, object, &|shape| match *shape {
            [_, found] if found == width => Ok(()),
            _ => Err(format!(
                "`{name}` has the shape {}; expected (B, {width}): one row per sample",
                tuple(shape)
            )),
        })?;
        let rows = array.shape()[0];
        Ok((array, rows))
    }

    /// Reads a matrix with a known number of rows.
    pub fn matrix(
        name: &str,
        object: &Bound<'py, PyAny>,
        rows: usize,
        width: usize,
    ) -> PyResult<Self> {
        Self::shaped(name, object, &[rows, width])
    }

    /// Reads one number per row.
    pub fn vector(name: &str, object: &Bound<'py, PyAny>, rows: usize) -> PyResult<Self> {
        Self::shaped(name, object, &[rows])
    }

    fn shaped(name: &str, object: &Bound<'py, PyAny>, expected: &[usize]) -> PyResult<Self> {
        Self::read(name, object, &|shape| match shape == expected {
            true => Ok(()),
            false => Err(format!(
                "`{name}` has the shape {}; expected {}",
                tuple(shape),
                tuple(expected)
            )),
        })
    }

    /// A copy of the numbers, for a computation on another thread.
    pub fn to_vec(&self) -> PyResult<Vec<F>> {
        fits("the copy of an argument", self.shape(), size_of::<F>())?;
        Ok(self.slice().to_vec())
    }

    /// The numbers of each row.
    pub fn per_row(&self) -> PerRow<'_, F> {
        PerRow { numbers: self.slice(), width: self.shape()[1..].iter().product() }
    }

    /// Shape of the array.
    pub fn shape(&self) -> &[usize] {
        self.0.shape()
    }

    /// The numbers, row by row.
    pub fn slice(&self) -> &[F] {
        self.0.as_slice().expect("the array is contiguous")
    }
}

/// Reads an argument of any shape with this number of elements.
pub fn any_shape<'py, F: Number>(
    name: &str,
    object: &Bound<'py, PyAny>,
    count: usize,
) -> PyResult<Argument<'py, F>> {
    Argument::read(name, object, &|shape| {
        let found = shape.iter().try_fold(1_usize, |product, &size| product.checked_mul(size));
        match found {
            Some(found) if found == count => Ok(()),
            found => {
                let found = found.map_or_else(|| tuple(shape), |found| found.to_string());
                Err(format!("`{name}` has {found} numbers; expected {count}"))
            }
        }
    })
}

/// Numbers of an argument, the same number for each row.
#[derive(Clone, Copy)]
pub struct PerRow<'a, F> {
    numbers: &'a [F],
    width: usize,
}

impl<'a, F> PerRow<'a, F> {
    /// No numbers.
    pub const NONE: Self = Self { numbers: &[], width: 0 };

    /// The numbers of these rows.
    pub fn of(&self, rows: &Range<usize>) -> &'a [F] {
        &self.numbers[rows.start * self.width..rows.end * self.width]
    }
}

/// The error of NumPy for the argument of this name, as `MemoryError`, `TypeError` or `ValueError`.
fn named(py: Python<'_>, name: &str, error: PyErr) -> PyErr {
    if !error.is_instance_of::<PyException>(py) {
        return error;
    }
    let text = error.value(py).to_string();
    let own = if error.is_instance_of::<PyMemoryError>(py) {
        PyMemoryError::new_err(format!("`{name}`: {text}"))
    } else if error.is_instance_of::<PyTypeError>(py) {
        PyTypeError::new_err(format!("`{name}` is no array of numbers: {text}"))
    } else {
        invalid(format!("`{name}` is no array of numbers: {text}"))
    };
    own.set_cause(py, Some(error));
    own
}

/// A shape as Python prints it.
pub fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        shape => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// A buffer of zeros for an array of this shape.
///
/// # Errors
/// `MemoryError`, if the array does not fit into memory.
pub fn zeros<F: Number>(shape: &[usize]) -> PyResult<Vec<F>> {
    fits("the result", shape, size_of::<F>())?;
    Ok(vec![F::zero(); shape.iter().product()])
}

/// The array, which refuses assignments to its elements.
pub fn read_only<'py, T>(array: Bound<'py, T>) -> PyResult<Bound<'py, T>> {
    let flags = PyDict::new(array.py());
    flags.set_item("write", false)?;
    array.as_any().call_method("setflags", (), Some(&flags))?;
    Ok(array)
}

/// An array of these numbers with this shape, without a copy.
pub fn array<'py, F: Number>(
    py: Python<'py>,
    numbers: Vec<F>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<F>>> {
    numbers.into_pyarray(py).reshape(shape.to_vec())
}

/// A dict of float64 vectors that refuse assignments.
pub fn dict_of_vectors<'py>(
    py: Python<'py>,
    columns: impl IntoIterator<Item = (String, Vec<f64>)>,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, numbers) in columns {
        dict.set_item(name, read_only(numbers.into_pyarray(py))?)?;
    }
    Ok(dict)
}
