//! The threads that share the work of a parallel call.
//!
//! By default, those of the global pool of Rayon. A program that forks, such as Python, calls
//! [`prepare`] before its calls: a forked process has none of the threads of its parent, and would
//! wait for them forever.

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Pool of one process. None if it has one thread, the calling one.
struct Own {
    process: u32,
    pool: Option<&'static ThreadPool>,
}

static OWN: Mutex<Option<Own>> = Mutex::new(None);

fn own() -> MutexGuard<'static, Option<Own>> {
    OWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns whether [`prepare`] was called in this process. False after a fork.
pub fn is_prepared() -> bool {
    own().as_ref().is_some_and(|own| own.process == std::process::id())
}

/// Gives this process threads of its own, in place of the global pool of Rayon. With one thread,
/// parallel calls run on the calling thread.
///
/// # Errors
/// The system does not create the threads.
pub fn prepare(threads: usize) -> Result<(), ThreadPoolBuildError> {
    let pool = match threads {
        0 | 1 => None,
        _ => Some(ThreadPoolBuilder::new().num_threads(threads).build()?),
    };
    // The pool of a parent process is never dropped: its threads do not exist here.
    let pool = pool.map(|pool| &*Box::leak(Box::new(pool)));
    *own() = Some(Own { process: std::process::id(), pool });
    Ok(())
}

/// Number of threads that share the work of a parallel call.
pub fn number() -> usize {
    match own().as_ref().filter(|own| own.process == std::process::id()) {
        Some(own) => own.pool.map_or(1, ThreadPool::current_num_threads),
        None => rayon::current_num_threads(),
    }
}

/// Runs `work` on one of the threads, so that calls of Rayon within it share them. Returns false,
/// without a call of `work`, if the calling thread is the only one.
pub fn run(work: &mut (dyn FnMut() + Send)) -> bool {
    let own = match rayon::current_thread_index() {
        Some(_) => None,
        None => own().as_ref().map(|own| own.pool.filter(|_| own.process == std::process::id())),
    };
    match own {
        None => rayon::scope(|_| work()),
        Some(Some(pool)) => pool.install(work),
        Some(None) => return false,
    }
    true
}
