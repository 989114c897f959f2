//! `read_table`: measured segments from CSV files and data frames, by the rules of `physgrad
//! identify`.

use crate::arrays::array;
use crate::errors::{check_regular, value_error, wrong_type};
use crate::identify::unknowns;
use crate::task::Task;
use numpy::PyReadonlyArray1;
use physgrad::identify::Segment;
use physgrad_cli::api::{Cells, Kind, Reading, Recordings};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::collections::HashMap;
use std::path::PathBuf;

/// Segments of a table as dicts with "x", "u", "t" and "p", notes about them, and the names of all
/// columns.
///
/// `table` is the path of a CSV file, or the name of a data frame, its header, and a function of the
/// index of a column. The function returns the numbers of the column as an array of f64, or with
/// True as a second argument, its cells as texts. `params` are those of `identify`, `time` is the
/// name of the column of the times, and `factors` converts columns to the units of the task.
#[pyfunction]
#[pyo3(signature = (task, params, table, time, factors))]
pub fn read_table<'py>(
    py: Python<'py>,
    task: &Task,
    params: Option<&Bound<'py, PyAny>>,
    table: &Bound<'py, PyAny>,
    time: Option<String>,
    factors: HashMap<String, f64>,
) -> PyResult<(Bound<'py, PyList>, Vec<String>, Vec<String>)> {
    let unknowns = params.map_or(Ok(Vec::new()), |params| unknowns(task, params))?;
    let scene = task.scene.with(unknowns).map_err(value_error)?;
    let reading = Reading { time, factors };
    let recordings = if let Ok(path) = table.extract::<PathBuf>() {
        check_regular(&path)?;
        py.detach(|| scene.read_file(&path, &reading))
    } else {
        let (name, header, column): (String, Vec<String>, Bound<'_, PyAny>) = table.extract()?;
        let columns = scene.columns(&name, header, &reading).map_err(value_error)?;
        let kinds = columns.kinds().into_iter().enumerate();
        let cells = kinds.map(|(i, kind)| cells(&column, i, kind)).collect::<PyResult<_>>()?;
        py.detach(|| scene.read_columns(name, columns, cells))
    };
    let Recordings { segments, notes, columns } = recordings.map_err(value_error)?;
    let names = scene.param_names();
    let dicts = segments.into_iter().map(|(segment, t)| dict_of(py, segment, t, &names));
    Ok((PyList::new(py, dicts.collect::<PyResult<Vec<_>>>()?)?, notes, columns))
}

/// Cells of a column of a data frame.
fn cells(column: &Bound<'_, PyAny>, i: usize, kind: Kind) -> PyResult<Cells> {
    Ok(match kind {
        Kind::Ignored => Cells::Ignored,
        Kind::Texts => Cells::Texts(column.call1((i, true))?.extract()?),
        Kind::Numbers => {
            let numbers = column.call1((i, false))?;
            let Ok(numbers) = numbers.extract::<PyReadonlyArray1<'_, f64>>() else {
                return Err(wrong_type(format!("column {i} is no vector of numbers")));
            };
            Cells::Numbers(numbers.as_array().to_vec())
        }
    })
}

/// A segment that begins at the time `t`, with the parameters that have a value.
fn dict_of<'py>(
    py: Python<'py>,
    segment: Segment,
    t: f64,
    names: &[String],
) -> PyResult<Bound<'py, PyDict>> {
    let Segment { x, u, p, .. } = segment;
    let (dict, params) = (PyDict::new(py), PyDict::new(py));
    for (name, value) in names.iter().zip(p).filter(|(_, value)| !value.is_nan()) {
        params.set_item(name, value)?;
    }
    for (key, rows) in [("x", x), ("u", u)] {
        let shape = [rows.len(), rows.first().map_or(0, Vec::len)];
        dict.set_item(key, array(py, rows.concat(), &shape)?)?;
    }
    dict.set_item("t", t)?;
    dict.set_item("p", params)?;
    Ok(dict)
}
