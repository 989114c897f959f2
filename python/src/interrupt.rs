//! Ctrl-C during long computations.

use crate::errors::caught;
use crate::threads;
use pyo3::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Time between two checks for signals.
pub const POLL: Duration = Duration::from_millis(100);

/// Flag that asks a computation to stop.
pub type Stop = Arc<AtomicBool>;

/// Computes on another thread without the GIL, and checks for signals meanwhile.
///
/// # Errors
/// Returns the exception that a signal handler raises, for example `KeyboardInterrupt`. Also sets
/// the flag; the thread ends when `work` reads it. A panic of `work` becomes `RuntimeError`.
pub fn interruptible<R: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> R + Send + 'static,
) -> PyResult<R> {
    threads::ready()?;
    let stop = Stop::default();
    let (sender, receiver) = channel();
    let work = Arc::new(Mutex::new(Some(work)));
    let take = |work: &Mutex<Option<_>>| {
        work.lock().unwrap_or_else(PoisonError::into_inner).take().expect("called once")
    };
    let worker = thread::Builder::new().spawn({
        let (work, stop) = (work.clone(), stop.clone());
        // The receiver is gone if the call was interrupted.
        move || drop(sender.send(caught(|| take(&work)(&stop))))
    });
    if worker.is_err() {
        // Without another thread, the computation does not react to signals.
        return py.detach(|| caught(|| take(&work)(&stop)));
    }
    py.detach(move || {
        loop {
            match receiver.recv_timeout(POLL) {
                Err(RecvTimeoutError::Timeout) => {
                    let signals = Python::attach(|py| py.check_signals());
                    signals.inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
                }
                result => return result.expect("`caught` sends a result"),
            }
        }
    })
}

/// Computes rows `0..count` in consecutive parts without the GIL, and checks for signals in between.
/// The first part has `size` rows, and later ones more if a part takes little time.
///
/// # Errors
/// Returns the exception that a signal handler raises. A panic of `work` becomes `RuntimeError`.
pub fn in_parts(
    py: Python<'_>,
    count: usize,
    mut size: usize,
    mut work: impl FnMut(Range<usize>) + Send,
) -> PyResult<()> {
    if count > physgrad::engine::rows::CHUNK {
        threads::ready()?;
    }
    let mut first = 0;
    while first < count {
        let (begin, end) = (Instant::now(), count.min(first.saturating_add(size)));
        py.detach(|| caught(|| work(first..end)))?;
        if begin.elapsed() < POLL / 4 {
            size *= 2;
        }
        first = end;
        py.check_signals()?;
    }
    Ok(())
}
