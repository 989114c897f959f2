//! [`Scratch`]: a workspace for the intermediate values of a step.

use std::hint::black_box;
use std::mem::MaybeUninit;

/// A workspace with stack capacity for `FEW` numbers; larger sizes allocate.
///
/// Used in place of `SmallVec` in performance-critical loops:
///
/// - It is filled in place. A returned vector may be copied with its whole capacity.
/// - All methods are inlined. A call may be compiled without the wide registers of the caller.
pub(crate) struct Scratch<T, const FEW: usize> {
    few: [MaybeUninit<T>; FEW],
    many: Box<[MaybeUninit<T>]>,
    /// Number of initialized entries.
    len: usize,
}

/// A [`Scratch`] during initialization, number by number, within a loop of the caller.
pub(crate) struct Filling<'a, T> {
    room: &'a mut [MaybeUninit<T>],
    set: usize,
    len: &'a mut usize,
}

impl<'a, T: Copy> Filling<'a, T> {
    /// Writes the next number. Calls nothing except to panic: a call would spill registers.
    ///
    /// # Panics
    /// If all numbers are written.
    #[inline(always)]
    pub(crate) fn push(&mut self, value: T) {
        self.room[self.set].write(value);
        self.set += 1;
    }

    /// Returns all numbers.
    ///
    /// # Panics
    /// If some numbers have not been written.
    #[inline(always)]
    pub(crate) fn all(self) -> &'a mut [T] {
        assert!(self.set == self.room.len(), "some numbers have not been set");
        *self.len = self.set;
        // SAFETY: `push` has written the first `set` entries, which is all of them.
        unsafe { written(self.room) }
    }
}

/// Views the entries as initialized.
///
/// The `black_box` hides which storage is used, stack or heap. Otherwise the compiler may load each
/// number from both and select one.
///
/// # Safety
/// All entries of `room` must have been written.
#[inline(always)]
unsafe fn written<T: Copy>(room: &mut [MaybeUninit<T>]) -> &mut [T] {
    let numbers = std::ptr::from_mut(room) as *mut [T];
    // SAFETY: the layouts are equal, and the caller guarantees initialization.
    black_box(unsafe { &mut *numbers })
}

impl<T: Copy, const FEW: usize> Scratch<T, FEW> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { few: [const { MaybeUninit::uninit() }; FEW], many: Box::default(), len: 0 }
    }

    /// Discards the contents and begins the initialization of `len` numbers.
    #[inline(always)]
    pub(crate) fn filling(&mut self, len: usize) -> Filling<'_, T> {
        self.len = 0;
        if len > FEW && self.many.len() < len {
            self.many = Box::new_uninit_slice(len);
        }
        let room = if len <= FEW { &mut self.few[..len] } else { &mut self.many[..len] };
        Filling { room, set: 0, len: &mut self.len }
    }

    /// Returns the current contents.
    #[inline(always)]
    pub(crate) fn all(&mut self) -> &mut [T] {
        let len = self.len;
        let room = if len <= FEW { &mut self.few[..len] } else { &mut self.many[..len] };
        // SAFETY: `len` is set only after `len` entries of this storage have been written.
        unsafe { written(room) }
    }

    /// Replaces the contents by `len` copies of `value`.
    #[inline(always)]
    pub(crate) fn fill(&mut self, value: T, len: usize) -> &mut [T] {
        self.collect((0..len).map(|_| value))
    }

    /// Replaces the contents by `values`.
    #[inline(always)]
    pub(crate) fn collect(&mut self, values: impl ExactSizeIterator<Item = T>) -> &mut [T] {
        let mut filling = self.filling(values.len());
        for value in values {
            filling.push(value);
        }
        filling.all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_that_were_set_last_in_either_place() {
        let mut scratch = Scratch::<u8, 4>::new();
        assert!(scratch.all().is_empty());
        for len in [3, 9, 4, 5, 9, 10, 0, 1] {
            let numbers: Vec<u8> = (0..len).map(|i| len + i).collect();
            assert_eq!(scratch.collect(numbers.iter().copied()), numbers);
            assert_eq!(scratch.all(), numbers);
        }
        assert_eq!(scratch.fill(7, 6), [7; 6]);
    }

    #[test]
    #[should_panic(expected = "some numbers have not been set")]
    fn numbers_that_have_not_been_set_are_not_read() {
        let mut scratch = Scratch::<u8, 4>::new();
        let mut filling = scratch.filling(3);
        filling.push(1);
        filling.all();
    }

    #[test]
    fn a_filling_that_was_dropped_leaves_nothing() {
        let mut scratch = Scratch::<u8, 4>::new();
        scratch.fill(1, 3);
        scratch.filling(6).push(1);
        assert!(scratch.all().is_empty());
    }
}
