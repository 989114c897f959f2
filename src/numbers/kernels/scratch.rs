//! [`Scratch`]: room for the intermediate numbers of a step.

use std::hint::black_box;
use std::mem::MaybeUninit;

/// Room on the stack for `FEW` numbers; more of them allocate.
///
/// It is filled where it is, and with no more than is asked for: a vector that is returned may be copied with all there
/// is room for, and a call to fill it may be compiled without the processor's wide registers. Those of the vectors with room on
/// the stack that were tried call something, unless they are optimized across code units.
pub(crate) struct Scratch<T, const FEW: usize> {
    few: [MaybeUninit<T>; FEW],
    many: Box<[MaybeUninit<T>]>,
    /// How many numbers there are, all of them set.
    len: usize,
}

/// A [`Scratch`] that is filled number by number, from the middle of a loop that has other work as well.
pub(crate) struct Filling<'a, T> {
    room: &'a mut [MaybeUninit<T>],
    set: usize,
    len: &'a mut usize,
}

impl<'a, T: Copy> Filling<'a, T> {
    /// Sets the next number. Never calls anything: a call would cost the numbers in registers.
    #[inline(always)]
    pub(crate) fn push(&mut self, value: T) {
        self.room[self.set].write(value);
        self.set += 1;
    }

    /// All numbers, once they have been set.
    #[inline(always)]
    pub(crate) fn all(self) -> &'a mut [T] {
        assert!(self.set == self.room.len(), "some numbers have not been set");
        *self.len = self.set;
        // SAFETY: so many have been written, one after another.
        unsafe { written(self.room) }
    }
}

/// The numbers, wherever they are: what is read first would be read from either place, number by number, and one of the two
/// chosen.
///
/// # Safety
/// They must have been written.
#[inline(always)]
unsafe fn written<T: Copy>(room: &mut [MaybeUninit<T>]) -> &mut [T] {
    let numbers = std::ptr::from_mut(room) as *mut [T];
    // SAFETY: the layout is the same, and the caller has written them.
    black_box(unsafe { &mut *numbers })
}

impl<T: Copy, const FEW: usize> Scratch<T, FEW> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { few: [const { MaybeUninit::uninit() }; FEW], many: Box::default(), len: 0 }
    }

    /// Room for `len` numbers, in place of what there was.
    #[inline(always)]
    pub(crate) fn filling(&mut self, len: usize) -> Filling<'_, T> {
        self.len = 0;
        if len > FEW && self.many.len() < len {
            self.many = Box::new_uninit_slice(len);
        }
        let room = if len <= FEW { &mut self.few[..len] } else { &mut self.many[..len] };
        Filling { room, set: 0, len: &mut self.len }
    }

    /// What there is.
    #[inline(always)]
    pub(crate) fn all(&mut self) -> &mut [T] {
        let len = self.len;
        let room = if len <= FEW { &mut self.few[..len] } else { &mut self.many[..len] };
        // SAFETY: of so many numbers, which go to this place, all have been written.
        unsafe { written(room) }
    }

    /// `len` times this, in place of what there was.
    #[inline(always)]
    pub(crate) fn fill(&mut self, value: T, len: usize) -> &mut [T] {
        self.collect((0..len).map(|_| value))
    }

    /// These values, in place of what there was.
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
