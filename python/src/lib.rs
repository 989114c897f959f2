//! Python bindings of physgrad: the module `physgrad._core`.
//!
//! Classes and functions convert arguments and call `physgrad_cli::api`, `physgrad::engine::rows`,
//! `physgrad::optimize` and `physgrad::identify`. `physgrad/__init__.py` names the public ones.

mod accuracy;
mod arrays;
mod errors;
mod identify;
mod interrupt;
mod lists;
mod optimize;
mod picture;
mod policy;
mod rows;
mod run;
mod settings;
mod task;
mod threads;
mod timing;

use physgrad::engine::kernels;
use pyo3::exceptions::PyImportError;
use pyo3::prelude::*;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    kernels::check_processor().map_err(PyImportError::new_err)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Divergence", module.py().get_type::<errors::Divergence>())?;
    module.add_class::<task::Task>()?;
    module.add_function(wrap_pyfunction!(task::task_names, module)?)?;
    module.add_class::<policy::Policy>()?;
    module.add_class::<run::Run>()?;
    module.add_function(wrap_pyfunction!(identify::identify, module)?)?;
    module.add_function(wrap_pyfunction!(accuracy::accuracy, module)?)?;
    module.add_function(wrap_pyfunction!(identify::check, module)?)?;
    module.add_function(wrap_pyfunction!(optimize::optimize, module)?)?;
    module.add_function(wrap_pyfunction!(picture::picture, module)?)?;
    module.add_function(wrap_pyfunction!(policy::rollout, module)?)?;
    module.add_function(wrap_pyfunction!(policy::losses, module)?)?;
    module.add_function(wrap_pyfunction!(policy::gradients, module)?)?;

    module.add_function(wrap_pyfunction!(timing::step_seconds, module)?)?;
    Ok(())
}
