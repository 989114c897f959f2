//! `picture`: a state of an unfinished rollout as pixels, for environments of reinforcement learning.

use crate::arrays::Argument;
use crate::errors::invalid;
use crate::task::Task;
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;

/// Draws the last of the states, (k+1, n), of an unfinished rollout with these controls, (k, m), and
/// parameters, (k+1, param_dim).
///
/// Returns a uint8 array of shape (height, width, 3), which is the same for all pictures of a task.
#[pyfunction]
pub fn picture<'py>(
    py: Python<'py>,
    task: &Task,
    states: &Bound<'py, PyAny>,
    controls: &Bound<'py, PyAny>,
    params: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let [n, m, width] = task.scene.dims();
    let (states, count) = Argument::<f64>::first("states", states, n)?;
    if count == 0 {
        return Err(invalid("`states` has no rows; expected at least one"));
    }
    let controls = Argument::<f64>::matrix("controls", controls, count - 1, m)?;
    let params = Argument::<f64>::matrix("params", params, count, width)?;
    let rows = |numbers: &Argument<'py, f64>, count: usize| -> Vec<Vec<f64>> {
        let numbers = numbers.per_row();
        (0..count).map(|row| numbers.of(&(row..row + 1)).to_vec()).collect()
    };
    let (states, controls) = (rows(&states, count), rows(&controls, count - 1));
    let params = rows(&params, count);
    let scene = &task.scene;
    let picture = py.detach(|| scene.picture(states, controls, params));
    let shape = [picture.height, picture.width, 3];
    Ok(picture.rgb.into_pyarray(py).reshape(shape)?.into_any())
}
