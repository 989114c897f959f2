//! Rayon wrappers that take the work as a trait object, which limits monomorphization.

/// Calls `work(i, item)` for each item.
///
/// Runs in parallel with the feature `parallel` and at least two items.
pub(crate) fn for_each<W: Send>(items: &mut [W], work: &(dyn Fn(usize, &mut W) + Sync)) {
    #[cfg(feature = "parallel")]
    if items.len() > 1 {
        use rayon::prelude::*;
        return items.par_iter_mut().enumerate().for_each(|(i, item)| work(i, item));
    }
    items.iter_mut().enumerate().for_each(|(i, item)| work(i, item));
}

/// Runs `work` on a thread of the pool of [`for_each`].
///
/// Parallel calls within `work` then start their first half on the calling thread, without waking
/// another one.
#[cfg(feature = "parallel")]
pub(crate) fn among_workers(work: &mut (dyn FnMut() + Send)) {
    rayon::scope(|_| work());
}
