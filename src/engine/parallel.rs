//! Rayon wrappers that take the work as a trait object, which limits monomorphization.

#[cfg(feature = "parallel")]
use crate::numbers::threads;

/// Calls `work(i, item)` for each item.
///
/// Runs in parallel with the feature `parallel` and at least two items.
pub(crate) fn for_each<W: Send>(items: &mut [W], work: &(dyn Fn(usize, &mut W) + Sync)) {
    #[cfg(feature = "parallel")]
    if items.len() > 1 {
        use rayon::prelude::*;
        if threads::run(&mut || {
            items.par_iter_mut().enumerate().for_each(|(i, item)| work(i, item))
        }) {
            return;
        }
    }
    items.iter_mut().enumerate().for_each(|(i, item)| work(i, item));
}

/// Runs `work` on a thread of the pool of [`for_each`].
///
/// A parallel call within `work` runs its first items on the same thread at once. Outside the pool,
/// the call would first wake a thread.
#[cfg(feature = "parallel")]
pub(crate) fn among_workers(work: &mut (dyn FnMut() + Send)) {
    if !threads::run(&mut *work) {
        work();
    }
}
