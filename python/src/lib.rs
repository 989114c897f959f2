//! Python bindings of physgrad: the module `physgrad._core`, also with tasks of a user.
//!
//! Classes and functions convert arguments and call `physgrad_cli::api`, `physgrad::engine::rows`,
//! `physgrad::optimize` and `physgrad::identify`. `physgrad/__init__.py` names the public ones.

mod accuracy;
mod arrays;
mod errors;
mod identify;
mod interrupt;
mod lists;
mod operations;
mod optimize;
mod picture;
mod policy;
mod recordings;
mod rows;
mod run;
mod settings;
mod task;
mod threads;
mod timing;
mod whole;
mod xla;

use physgrad::engine::kernels;
use physgrad_cli::Program;
use pyo3::exceptions::PyImportError;
use pyo3::prelude::*;

#[doc(hidden)]
pub use pyo3;

/// Defines the module `physgrad._core` with the tasks, effects and policies of a program:
///
/// ```ignore
/// physgrad_python::module!(physgrad_cli::program().task::<Slide>());
/// ```
///
/// `physgrad new --python NAME` writes a crate that builds a wheel of the package `physgrad` with this
/// module.
#[macro_export]
macro_rules! module {
    ($program:expr) => {
        #[$crate::pyo3::pymodule(crate = "::physgrad_python::pyo3")]
        fn _core(
            module: &$crate::pyo3::Bound<'_, $crate::pyo3::types::PyModule>,
        ) -> $crate::pyo3::PyResult<()> {
            $crate::register($program)?;
            $crate::add_to(module)
        }
    };
}

#[cfg(feature = "module")]
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    add_to(module)
}

/// Adds the tasks, effects and policies of a program to the built-in ones. Part of [`module!`].
///
/// # Errors
/// `ImportError`: two have equal names, or this process has registered others.
pub fn register(program: Program) -> PyResult<()> {
    program.register().map_err(|error| PyImportError::new_err(error.to_string()))
}

/// Adds all classes and functions to the module. Part of [`module!`].
///
/// # Errors
/// `ImportError`: the processor lacks instructions.
pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    kernels::check_processor().map_err(PyImportError::new_err)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Divergence", module.py().get_type::<errors::Divergence>())?;
    module.add_class::<task::Task>()?;
    module.add_function(wrap_pyfunction!(task::task_names, module)?)?;
    module.add_function(wrap_pyfunction!(task::presets, module)?)?;
    module.add_class::<policy::Policy>()?;
    module.add_class::<run::Run>()?;
    module.add_function(wrap_pyfunction!(identify::identify, module)?)?;
    module.add_function(wrap_pyfunction!(recordings::read_table, module)?)?;
    module.add_function(wrap_pyfunction!(accuracy::accuracy, module)?)?;
    module.add_function(wrap_pyfunction!(identify::check, module)?)?;
    module.add_function(wrap_pyfunction!(optimize::optimize, module)?)?;
    module.add_function(wrap_pyfunction!(picture::picture, module)?)?;
    module.add_function(wrap_pyfunction!(policy::rollout, module)?)?;
    module.add_function(wrap_pyfunction!(policy::losses, module)?)?;
    module.add_function(wrap_pyfunction!(policy::gradients, module)?)?;
    module.add_function(wrap_pyfunction!(operations::handle, module)?)?;
    module.add_function(wrap_pyfunction!(operations::operation, module)?)?;
    module.add_function(wrap_pyfunction!(operations::operation_names, module)?)?;
    module.add("xla_handler", xla::address())?;
    module.add_function(wrap_pyfunction!(timing::step_seconds, module)?)?;
    Ok(())
}
