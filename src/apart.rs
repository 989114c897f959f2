//! Work that is compiled apart from the loops that need it.

use crate::kernels::{Vectorized, dispatch_lanes};
use crate::scalar::Scalar;

/// Runs it with the instructions of this processor, and is never inlined: what is chosen while the program runs is in
/// every loop of every system, and with all choices inlined such a loop takes minutes to compile.
///
/// Numbers that no rollout runs on take the portable path alone: nobody waits for them.
#[inline(always)]
pub(crate) fn apart<T: Scalar>(work: impl Vectorized) {
    #[inline(never)]
    fn best(work: impl Vectorized) {
        dispatch_lanes(work);
    }
    #[inline(never)]
    fn portable(work: impl Vectorized) {
        work.run::<false>();
    }
    if T::WIDE { best(work) } else { portable(work) }
}
