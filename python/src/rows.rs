//! [`Rows`]: the inputs of a call on arrays, and its new output arrays.

use crate::arrays::{Argument, Number, PerRow, array, zeros};
use crate::interrupt::in_parts;
use physgrad::Inputs;
use physgrad::engine::rows::CHUNK;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::ops::Range;

/// Inputs of `count` samples.
pub struct Rows<'py, F: Number> {
    pub count: usize,
    pub x: Argument<'py, F>,
    pub u: Option<Argument<'py, F>>,
    pub p: Argument<'py, F>,
    pub t: usize,
}

impl<'py, F: Number> Rows<'py, F> {
    /// A new matrix of this width. `write` writes a range of its rows without the GIL, and receives
    /// the inputs of these rows.
    pub fn matrix(
        &self,
        py: Python<'py>,
        width: usize,
        mut write: impl FnMut(Inputs<'_, F>, &Range<usize>, &mut [F]) + Send,
    ) -> PyResult<Bound<'py, PyAny>> {
        let [numbers] =
            self.written(py, [width], |inputs, rows, [numbers]| write(inputs, rows, numbers))?;
        Ok(array(py, numbers, &[self.count, width])?.into_any())
    }

    /// A new vector with one number per row.
    pub fn vector(
        &self,
        py: Python<'py>,
        mut write: impl FnMut(Inputs<'_, F>, &Range<usize>, &mut [F]) + Send,
    ) -> PyResult<Bound<'py, PyAny>> {
        let [numbers] =
            self.written(py, [1], |inputs, rows, [numbers]| write(inputs, rows, numbers))?;
        Ok(array(py, numbers, &[self.count])?.into_any())
    }

    /// A tuple of new matrices of these widths.
    pub fn matrices<const K: usize>(
        &self,
        py: Python<'py>,
        widths: [usize; K],
        write: impl FnMut(Inputs<'_, F>, &Range<usize>, [&mut [F]; K]) + Send,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let written = self.written(py, widths, write)?;
        let arrays = written
            .into_iter()
            .zip(widths)
            .map(|(numbers, width)| array(py, numbers, &[self.count, width]));
        PyTuple::new(py, arrays.collect::<PyResult<Vec<_>>>()?)
    }

    fn written<const K: usize>(
        &self,
        py: Python<'py>,
        widths: [usize; K],
        mut write: impl FnMut(Inputs<'_, F>, &Range<usize>, [&mut [F]; K]) + Send,
    ) -> PyResult<[Vec<F>; K]> {
        let mut outputs = [const { Vec::new() }; K];
        for (output, width) in outputs.iter_mut().zip(widths) {
            *output = zeros(&[self.count, width])?;
        }
        let (x, p, t) = (self.x.per_row(), self.p.per_row(), self.t);
        let u = self.u.as_ref().map_or(PerRow::NONE, Argument::per_row);
        in_parts(py, self.count, 16 * CHUNK, |rows| {
            let mut parts = outputs.iter_mut().zip(widths);
            let parts = std::array::from_fn(|_| {
                let (output, width) = parts.next().expect("K outputs");
                &mut output[rows.start * width..rows.end * width]
            });
            write(Inputs { x: x.of(&rows), u: u.of(&rows), p: p.of(&rows), t }, &rows, parts);
        })?;
        Ok(outputs)
    }
}
