//! Signals that end a training run after a checkpoint: SIGINT (Ctrl-C), SIGTERM and, on Unix,
//! SIGHUP.

use anyhow::{Context, Result};
use signal_hook::consts;
use signal_hook::flag;
use std::sync::Arc;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Number of the first signal, or 0.
static RECEIVED: OnceLock<Arc<AtomicUsize>> = OnceLock::new();

/// Number of the first signal received, if any.
pub fn received() -> Option<u8> {
    let signal = RECEIVED.get()?.load(Ordering::Relaxed);
    u8::try_from(signal).ok().filter(|&signal| signal != 0)
}

/// Exit status of a process that a signal terminated, as shells define it.
pub fn exit_status(signal: u8) -> u8 {
    128 + signal
}

/// Installs the handlers. [`received`] returns the first signal. A second signal ends the process.
///
/// On Linux, a signal that the parent process ignores, as `nohup` does, stays ignored.
pub fn handle() -> Result<()> {
    let received = RECEIVED.get_or_init(Arc::default);
    let received_before = Arc::new(AtomicBool::new(false));
    for signal in STOPPING.into_iter().filter(|&signal| !is_ignored(signal)) {
        let number = usize::try_from(signal).expect("numbers of signals are positive");
        // Order of the actions: the first signal finds `received_before` unset, then sets it.
        flag::register_conditional_shutdown(signal, 128 + signal, received_before.clone())
            .and_then(|_| flag::register_usize(signal, received.clone(), number))
            .and_then(|_| flag::register(signal, received_before.clone()))
            .with_context(|| format!("cannot install a handler for signal {signal}"))?;
    }
    Ok(())
}

/// Turns the signal of the file size limit into an error of `write`.
pub fn ignore_file_limits() {
    // Ignores errors: without the handler, the signal ends the process with a non-zero status.
    #[cfg(unix)]
    let _ = flag::register(consts::SIGXFSZ, Arc::default());
}

#[cfg(unix)]
const STOPPING: [i32; 3] = [consts::SIGINT, consts::SIGTERM, consts::SIGHUP];
#[cfg(not(unix))]
const STOPPING: [i32; 2] = [consts::SIGINT, consts::SIGTERM];

/// Returns whether the process was started with this signal ignored.
#[cfg(target_os = "linux")]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

/// Always false: the disposition of signals is unknown on this system.
#[cfg(not(target_os = "linux"))]
fn is_ignored(_signal: i32) -> bool {
    false
}
