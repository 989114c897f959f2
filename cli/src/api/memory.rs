//! [`fits`]: whether an array fits into memory, before its allocation.

use crate::platform::memory::of_this_machine;

/// An array that does not fit into the memory of this machine.
#[derive(Debug, thiserror::Error)]
#[error(
    "{what} would take {:.1} GB, but this machine has {:.1} GB; pass fewer rows, or choose a shorter horizon",
    bytes / 1e9,
    most / 1e9
)]
pub struct TooLarge {
    what: &'static str,
    bytes: f64,
    most: f64,
}

/// Bytes that fit into every machine, without a look at its memory.
const SMALL: f64 = 5e7;

/// Checks that an array with these dimensions fits into memory. `size` is the number of bytes of an
/// element.
///
/// # Errors
/// The array is larger than the memory of this machine, or than the limit of this process.
pub fn fits(what: &'static str, dims: &[usize], size: usize) -> Result<(), TooLarge> {
    let bytes = dims.iter().fold(size as f64, |bytes, &dim| bytes * dim as f64);
    let most = if bytes > SMALL { of_this_machine() } else { SMALL };
    if bytes > most { Err(TooLarge { what, bytes, most }) } else { Ok(()) }
}
