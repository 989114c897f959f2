//! Python bindings of physgrad: the module `physgrad._core`.
//!
//! Classes and functions convert arguments and call `physgrad::program::api` and `physgrad::rows`.
//! `physgrad/__init__.py` names the public ones.

mod arrays;
mod errors;
mod settings;
mod task;
mod timing;

use pyo3::prelude::*;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Divergence", module.py().get_type::<errors::Divergence>())?;
    module.add_class::<task::Task>()?;
    module.add_function(wrap_pyfunction!(timing::step_seconds, module)?)?;
    Ok(())
}
