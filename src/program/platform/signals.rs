//! Signals that end a training in order: Ctrl-C, SIGTERM, SIGHUP.

use anyhow::{Context, Result};
use signal_hook::consts;
use signal_hook::flag;
use std::sync::Arc;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Number of the first signal, or 0.
static RECEIVED: OnceLock<Arc<AtomicUsize>> = OnceLock::new();

/// The first signal that asked for the end, if there was one.
pub fn received() -> Option<u8> {
    let signal = RECEIVED.get()?.load(Ordering::Relaxed);
    u8::try_from(signal).ok().filter(|&signal| signal != 0)
}

/// Exit status of a process that a signal ended, by the convention of shells.
pub fn exit_status(signal: u8) -> u8 {
    128 + signal
}

/// From now on, the first signal is noted for [`received`], and the second ends the process at once. A signal that the parent
/// process has set to be ignored, as `nohup` does, stays ignored.
pub fn handle() -> Result<()> {
    let received = RECEIVED.get_or_init(Arc::default);
    let again = Arc::new(AtomicBool::new(false));
    for signal in END.into_iter().filter(|&signal| !is_ignored(signal)) {
        let number = usize::try_from(signal).expect("numbers of signals are positive");
        // In this order: the first signal finds `again` unset, and sets it.
        flag::register_conditional_shutdown(signal, 128 + signal, again.clone())
            .and_then(|_| flag::register_usize(signal, received.clone(), number))
            .and_then(|_| flag::register(signal, again.clone()))
            .with_context(|| format!("signal {signal} cannot be handled"))?;
    }
    Ok(())
}

/// Makes a limit on the size of files an error of `write`, and not the end of the process.
pub fn ignore_file_limits() {
    // Without the handler, the limit still ends the process with a status that is not 0.
    #[cfg(unix)]
    let _ = flag::register(consts::SIGXFSZ, Arc::default());
}

#[cfg(unix)]
const END: [i32; 3] = [consts::SIGINT, consts::SIGTERM, consts::SIGHUP];
#[cfg(not(unix))]
const END: [i32; 2] = [consts::SIGINT, consts::SIGTERM];

/// Whether the process was started with this signal ignored.
#[cfg(target_os = "linux")]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

/// Whether the process was started with this signal ignored; unknown here.
#[cfg(not(target_os = "linux"))]
fn is_ignored(_signal: i32) -> bool {
    false
}
