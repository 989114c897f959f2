//! Work on several threads, of which there is one piece of code whatever the work is.

/// `work(i, item)` for every item; in parallel where that is compiled in and there is more than one.
pub(crate) fn for_each<W: Send>(items: &mut [W], work: &(dyn Fn(usize, &mut W) + Sync)) {
    #[cfg(feature = "parallel")]
    if items.len() > 1 {
        use rayon::prelude::*;
        return items.par_iter_mut().enumerate().for_each(|(i, item)| work(i, item));
    }
    items.iter_mut().enumerate().for_each(|(i, item)| work(i, item));
}

/// Does it on one of the threads that [`for_each`] has rather than waiting for them: half the work then starts without waking
/// anybody.
#[cfg(feature = "parallel")]
pub(crate) fn among_workers(work: &mut (dyn FnMut() + Send)) {
    rayon::scope(|_| work());
}
