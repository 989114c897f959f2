//! Ctrl-C during long computations.

use pyo3::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

/// Time between two checks for signals.
pub const POLL: Duration = Duration::from_millis(100);

/// Flag that asks a computation to stop.
pub type Stop = Arc<AtomicBool>;

/// Computes on another thread without the GIL, and checks for signals meanwhile.
///
/// # Errors
/// Returns the exception that a signal handler raises, for example `KeyboardInterrupt`. Also sets
/// the flag; the thread ends when `work` reads it.
///
/// # Panics
/// Resumes a panic of `work`.
pub fn interruptible<R: Send + 'static>(py: Python<'_>, work: impl FnOnce(&Stop) -> R + Send + 'static) -> PyResult<R> {
    let stop = Stop::default();
    let (sender, receiver) = channel();
    let worker = thread::spawn({
        let stop = stop.clone();
        // The receiver is gone if the call was interrupted.
        move || drop(sender.send(work(&stop)))
    });
    py.detach(move || {
        loop {
            match receiver.recv_timeout(POLL) {
                Ok(result) => return Ok(result),
                Err(RecvTimeoutError::Timeout) => {
                    let signals = Python::attach(|py| py.check_signals());
                    signals.inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
                }
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        // The thread ended without a result.
        std::panic::resume_unwind(worker.join().expect_err("a panic"))
    })
}
