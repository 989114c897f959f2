//! Threads of the calls: their number, and their start in this process.

use crate::errors::invalid;
use physgrad_cli::api::threads::{is_prepared, prepare};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::thread::available_parallelism;

/// Largest number of threads, unless the machine has more cores.
const MAX: usize = 256;

fn cores() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// Checks a number of threads from the source of this name.
pub fn checked(source: &str, threads: usize) -> PyResult<usize> {
    let max = cores().max(MAX);
    if (1..=max).contains(&threads) {
        return Ok(threads);
    }
    Err(invalid(format!("{source} is {threads}; allowed: 1 to {max}")))
}

/// Number of threads by default: that of the variable `RAYON_NUM_THREADS`, else that of the cores.
pub fn number() -> PyResult<usize> {
    const SOURCE: &str = "RAYON_NUM_THREADS";
    let Some(text) = std::env::var_os(SOURCE).filter(|text| !text.is_empty()) else {
        return Ok(cores());
    };
    match text.to_str().and_then(|text| text.trim().parse().ok()) {
        // As in Rayon.
        Some(0) => Ok(cores()),
        Some(threads) => checked(SOURCE, threads),
        None => Err(invalid(format!("{SOURCE} is {}; allowed: a whole number", text.display()))),
    }
}

/// Starts the threads of this process, unless they run. A forked process starts its own.
///
/// Called with the GIL, before each call that may use several threads.
pub fn ready() -> PyResult<()> {
    if is_prepared() {
        return Ok(());
    }
    let threads = number()?;
    prepare(threads).map_err(|error| {
        PyRuntimeError::new_err(format!(
            "the system does not start {threads} threads ({error}); set the environment variable RAYON_NUM_THREADS to a smaller \
             number, or to 1 for none"
        ))
    })
}
