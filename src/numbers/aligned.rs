//! [`Aligned`]: a buffer aligned to a cache line.

use crate::numbers::scalar::Float;
use std::ops::{Deref, DerefMut};

/// Bytes of a cache line and of the widest vector register.
const LINE: usize = 64;

/// A fixed-size buffer aligned to a cache line.
///
/// Vector loads that cross a cache line are slower. Matrices padded to whole lines avoid such
/// loads.
#[derive(Debug)]
pub(crate) struct Aligned<F> {
    /// Allocation that contains the numbers at `begin .. begin + len`.
    storage: Vec<F>,
    begin: usize,
    len: usize,
}

impl<F> Aligned<F> {
    pub(crate) fn zeros(len: usize) -> Self
    where
        F: Float,
    {
        let storage = vec![F::zero(); Self::padded_len(len)];
        Self { begin: Self::line(&storage, len), storage, len }
    }

    /// Offset of the first aligned entry of `storage`, limited to leave `len` entries.
    ///
    /// `align_offset` may find no aligned entry. No result depends on the alignment.
    fn line(storage: &[F], len: usize) -> usize {
        storage.as_ptr().align_offset(LINE).min(storage.len() - len)
    }

    /// Number of bytes on the heap.
    pub(crate) fn stored_bytes(&self) -> usize {
        size_of_val(&self.storage[..])
    }

    /// The [`stored_bytes`](Aligned::stored_bytes) of a buffer of `len` numbers.
    pub(crate) fn bytes_of(len: usize) -> usize {
        Self::padded_len(len) * size_of::<F>()
    }

    fn padded_len(len: usize) -> usize {
        if len == 0 { 0 } else { len + LINE / size_of::<F>() - 1 }
    }
}

impl<F: Clone> Clone for Aligned<F> {
    fn clone(&self) -> Self {
        // Moves the numbers to the first aligned entry, because the copy may have another
        // alignment.
        let (mut storage, len) = (self.storage.clone(), self.len);
        let begin = Self::line(&storage, len);
        if begin >= self.begin {
            storage.rotate_right(begin - self.begin);
        } else {
            storage.rotate_left(self.begin - begin);
        }
        Self { storage, begin, len }
    }
}

impl<F> Deref for Aligned<F> {
    type Target = [F];

    fn deref(&self) -> &[F] {
        &self.storage[self.begin..self.begin + self.len]
    }
}

impl<F> DerefMut for Aligned<F> {
    fn deref_mut(&mut self) -> &mut [F] {
        &mut self.storage[self.begin..self.begin + self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forty_clones_of_five_numbers_are_equal_and_aligned_to_64_bytes() {
        let mut numbers = Aligned::<f64>::zeros(5);
        numbers.copy_from_slice(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        // Stores all clones, so that their addresses differ.
        let clones: Vec<(Aligned<f64>, Vec<u8>)> =
            (0..40).map(|i| (numbers.clone(), vec![0; 16 * i])).collect();
        for (clone, _) in &clones {
            assert_eq!(clone[..], [1.0, 2.0, 3.0, 4.0, 5.0]);
            assert!(clone.as_ptr().addr().is_multiple_of(LINE));
        }
        assert!(Aligned::<f32>::zeros(0).is_empty());
    }
}
