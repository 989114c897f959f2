//! [`Rows`]: the inputs of a call on arrays, and its new output arrays.

use crate::arrays::{Argument, Number, array, zeros};
use physgrad::Inputs;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Inputs of `count` samples.
pub struct Rows<'py, F: Number> {
    pub count: usize,
    pub x: Argument<'py, F>,
    pub u: Option<Argument<'py, F>>,
    pub p: Argument<'py, F>,
    pub t: usize,
}

impl<'py, F: Number> Rows<'py, F> {
    /// A new matrix of this width, written by `write` without the GIL.
    pub fn matrix(
        &self,
        py: Python<'py>,
        width: usize,
        write: impl FnOnce(Inputs<'_, F>, &mut [F]) + Send,
    ) -> PyResult<Bound<'py, PyAny>> {
        let [numbers] = self.written(py, [width], |inputs, [numbers]| write(inputs, numbers));
        Ok(array(py, numbers, &[self.count, width])?.into_any())
    }

    /// A new vector with one number per row.
    pub fn vector(&self, py: Python<'py>, write: impl FnOnce(Inputs<'_, F>, &mut [F]) + Send) -> PyResult<Bound<'py, PyAny>> {
        let [numbers] = self.written(py, [1], |inputs, [numbers]| write(inputs, numbers));
        Ok(array(py, numbers, &[self.count])?.into_any())
    }

    /// A tuple of new matrices of these widths.
    pub fn matrices<const K: usize>(
        &self,
        py: Python<'py>,
        widths: [usize; K],
        write: impl FnOnce(Inputs<'_, F>, [&mut [F]; K]) + Send,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let written = self.written(py, widths, write);
        let arrays = written.into_iter().zip(widths).map(|(numbers, width)| array(py, numbers, &[self.count, width]));
        PyTuple::new(py, arrays.collect::<PyResult<Vec<_>>>()?)
    }

    fn written<const K: usize>(
        &self,
        py: Python<'py>,
        widths: [usize; K],
        write: impl FnOnce(Inputs<'_, F>, [&mut [F]; K]) + Send,
    ) -> [Vec<F>; K] {
        let mut outputs = widths.map(|width| zeros(&[self.count, width]));
        let (x, u, p, t) = (self.x.slice(), self.u.as_ref().map_or(&[][..], Argument::slice), self.p.slice(), self.t);
        py.detach(|| write(Inputs { x, u, p, t }, outputs.each_mut().map(Vec::as_mut_slice)));
        outputs
    }
}
