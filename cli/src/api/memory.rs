//! [`fits`]: whether an array fits into memory, before its allocation.

use crate::platform::memory::of_this_machine;

/// An array that does not fit into the memory of this machine.
#[derive(Debug, thiserror::Error)]
#[error(
    "{what} would take {:.1} GB, but this machine has {:.1} GB, or its limit for this process is lower; pass fewer rows, or \
     choose a shorter horizon",
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
    if bytes <= SMALL {
        return Ok(());
    }
    let most = of_this_machine();
    // A limit of the process can be lower than the memory of the machine. An allocation beyond it
    // would end the process.
    let is_granted = bytes <= most && Vec::<u8>::new().try_reserve_exact(bytes as usize).is_ok();
    if is_granted { Ok(()) } else { Err(TooLarge { what, bytes, most }) }
}
