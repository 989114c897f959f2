//! Parallel map. Limits monomorphization: only a non-generic function calls rayon.

use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Maps the items in parallel. Starts them in their order, and returns the results in that order.
pub fn map<I: Sync, R: Send>(items: &[I], work: impl Fn(&I) -> R + Sync) -> Vec<R> {
    let results: Vec<Mutex<Option<R>>> = items.iter().map(|_| Mutex::new(None)).collect();
    for_each(items.len(), &|i| *results[i].lock().unwrap_or_else(PoisonError::into_inner) = Some(work(&items[i])));
    let into_inner = |result: Mutex<Option<R>>| result.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.into_iter().map(|result| into_inner(result).expect("every item has a result")).collect()
}

fn for_each(count: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..count).par_bridge().for_each(work);
}
