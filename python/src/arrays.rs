//! Row-major numpy arrays: arguments, results and their shapes.

use numpy::{Element, IntoPyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods};
use numpy::{PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods, dtype};
use physgrad::Float;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

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

/// Returns true for arrays of float32. Callers read all other arrays, and lists, as float64.
pub fn is_f32(array: &Bound<'_, PyAny>) -> bool {
    let py = array.py();
    array.cast::<PyUntypedArray>().is_ok_and(|array| array.dtype().is_equiv_to(&dtype::<f32>(py)))
}

/// Contiguous argument of the number type `F`. Copies the given array only if its layout or type
/// differs.
pub struct Argument<'py, F: Number>(PyReadonlyArrayDyn<'py, F>);

impl<'py, F: Number> Argument<'py, F> {
    /// Reads an argument of any shape.
    fn read(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Self> {
        let py = object.py();
        // A masked array is a subclass of `numpy.ndarray`.
        let is_subclass = object.cast::<PyUntypedArray>().is_ok() && !object.is_exact_instance_of::<PyUntypedArray>();
        if is_subclass && object.hasattr("mask")? {
            return Err(PyValueError::new_err(format!("`{name}` is a masked array; fill it, as in `{name}.filled(numpy.nan)`")));
        }
        let array = match object.cast::<PyArrayDyn<F>>() {
            Ok(array) if array.is_c_contiguous() && array.is_aligned() => array.clone(),
            _ => {
                let converted = py.import("numpy")?.call_method1("require", (object, dtype::<F>(py), ["C", "A"]));
                converted.map_err(|error| named(py, name, error))?.cast_into::<PyArrayDyn<F>>()?
            }
        };
        array.try_readonly().map(Self).map_err(|error| PyValueError::new_err(format!("`{name}` cannot be read: {error}")))
    }

    /// Reads the first argument, which sets the number of rows.
    pub fn first(name: &str, object: &Bound<'py, PyAny>, width: usize) -> PyResult<(Self, usize)> {
        let array = Self::read(name, object)?;
        match *array.0.shape() {
            [rows, found] if found == width => Ok((array, rows)),
            ref shape => Err(PyValueError::new_err(format!(
                "`{name}` has the shape {}; expected (B, {width}): one row per sample",
                tuple(shape)
            ))),
        }
    }

    /// Reads a matrix with a known number of rows.
    pub fn matrix(name: &str, object: &Bound<'py, PyAny>, rows: usize, width: usize) -> PyResult<Self> {
        Self::shaped(name, object, &[rows, width])
    }

    /// Reads one number per row.
    pub fn vector(name: &str, object: &Bound<'py, PyAny>, rows: usize) -> PyResult<Self> {
        Self::shaped(name, object, &[rows])
    }

    fn shaped(name: &str, object: &Bound<'py, PyAny>, shape: &[usize]) -> PyResult<Self> {
        let array = Self::read(name, object)?;
        if array.0.shape() != shape {
            let found = tuple(array.0.shape());
            return Err(PyValueError::new_err(format!("`{name}` has the shape {found}; expected {}", tuple(shape))));
        }
        Ok(array)
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

/// Reads an argument of any shape.
pub fn any_shape<'py, F: Number>(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Argument<'py, F>> {
    Argument::read(name, object)
}

fn named(py: Python<'_>, name: &str, error: PyErr) -> PyErr {
    let kind = error.get_type(py);
    PyErr::from_type(kind, format!("`{name}` is no array of numbers: {}", error.value(py)))
}

/// A shape as Python prints it.
pub fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        shape => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// A buffer of zeros for an array of this shape.
pub fn zeros<F: Number>(shape: &[usize]) -> Vec<F> {
    vec![F::zero(); shape.iter().product()]
}

/// An array of these numbers with this shape, without a copy.
pub fn array<'py, F: Number>(py: Python<'py>, numbers: Vec<F>, shape: &[usize]) -> PyResult<Bound<'py, PyArrayDyn<F>>> {
    numbers.into_pyarray(py).reshape(shape.to_vec())
}

/// A dict of float64 vectors.
pub fn dict_of_vectors<'py>(
    py: Python<'py>,
    columns: impl IntoIterator<Item = (String, Vec<f64>)>,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, numbers) in columns {
        dict.set_item(name, numbers.into_pyarray(py))?;
    }
    Ok(dict)
}
