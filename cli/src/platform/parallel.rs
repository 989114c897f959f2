//! Threads, and a parallel map. Limits monomorphization: only a non-generic function calls rayon.

use anyhow::{Result, anyhow, bail};
use physgrad::engine::threads;
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Largest number of threads, unless the machine has more cores.
const MAX_THREADS: usize = 256;

/// Environment variable with the number of threads.
const VARIABLE: &str = "RAYON_NUM_THREADS";

/// Number of threads: `requested`, else the number in `RAYON_NUM_THREADS`, else one per core. As
/// for rayon, 0 in the variable stands for one per core.
///
/// # Errors
/// The number is above the limit, or `requested` is 0, or the variable is not a whole number.
pub fn threads(requested: Option<usize>) -> Result<usize> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let max = cores.max(MAX_THREADS);
    if let Some(threads) = requested {
        return match threads {
            threads if (1..=max).contains(&threads) => Ok(threads),
            threads => bail!("--threads is {threads}; allowed: 1 to {max}"),
        };
    }
    let Some(text) = std::env::var_os(VARIABLE).filter(|text| !text.is_empty()) else {
        return Ok(cores);
    };
    match text.to_str().and_then(|text| text.parse().ok()) {
        Some(0) => Ok(cores),
        Some(threads) if threads <= max => Ok(threads),
        _ => bail!(
            "{VARIABLE} is {}; allowed: 1 to {max}, or 0 for one thread per core",
            text.display()
        ),
    }
}

/// Starts the threads of all parallel computations.
///
/// # Errors
/// The system refuses to create them. Without this call, the first parallel computation would
/// panic.
pub fn start(threads: usize) -> Result<()> {
    ThreadPoolBuilder::new().num_threads(threads).build_global().map_err(|error| {
        anyhow!(
            "cannot start {threads} threads ({error}); choose fewer with --threads or {VARIABLE}, or raise the limits of this process on \
             threads and memory (`ulimit -u`, `ulimit -v`)"
        )
    })
}

/// Maps the items in parallel. Starts them in their order, and returns the results in that order.
pub fn map<I: Sync, R: Send>(items: &[I], work: impl Fn(&I) -> R + Sync) -> Vec<R> {
    let results: Vec<Mutex<Option<R>>> = items.iter().map(|_| Mutex::new(None)).collect();
    for_each(items.len(), &|i| {
        *results[i].lock().unwrap_or_else(PoisonError::into_inner) = Some(work(&items[i]))
    });
    let into_inner =
        |result: Mutex<Option<R>>| result.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.into_iter().map(|result| into_inner(result).expect("every item has a result")).collect()
}

fn for_each(count: usize, work: &(dyn Fn(usize) + Sync)) {
    if !threads::run(&mut || (0..count).par_bridge().for_each(work)) {
        (0..count).for_each(work);
    }
}
