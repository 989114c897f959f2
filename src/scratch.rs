//! [`Scratch`]: room for the intermediate numbers of a step.

use arrayvec::ArrayVec;
use std::hint::black_box;

/// Room on the stack for `FEW` numbers; more of them allocate.
///
/// It is filled where it is, and with no more than is asked for: a vector that is returned may be copied with all there
/// is room for, and a call to fill it may be compiled without the processor's wide registers.
pub(crate) struct Scratch<T, const FEW: usize> {
    few: ArrayVec<T, FEW>,
    many: Vec<T>,
}

/// A [`Scratch`] that is filled number by number, from the middle of a loop that has other work as well.
pub(crate) struct Filling<'a, T, const FEW: usize> {
    few: &'a mut ArrayVec<T, FEW>,
    many: &'a mut [T],
}

impl<'a, T: Copy, const FEW: usize> Filling<'a, T, FEW> {
    /// Sets number `i`, those before being set. Never calls anything: a call would cost the numbers in registers.
    #[inline(always)]
    pub(crate) fn set(&mut self, i: usize, value: T) {
        match self.many.get_mut(i) {
            Some(place) => *place = value,
            None => self.few.push(value),
        }
    }

    /// What has been set.
    #[inline(always)]
    pub(crate) fn all(self) -> &'a mut [T] {
        one_place(if self.many.is_empty() { self.few } else { self.many })
    }
}

/// The numbers, wherever they are: what is read first would be read from either place, number by number, and one of the
/// two chosen.
#[inline(always)]
fn one_place<T>(numbers: &mut [T]) -> &mut [T] {
    black_box(numbers)
}

impl<T: Copy, const FEW: usize> Scratch<T, FEW> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { few: ArrayVec::new(), many: Vec::new() }
    }

    /// Room for `len` numbers, which are [`set`](Filling::set) one after another; a filler is any number.
    #[inline(always)]
    pub(crate) fn filling(&mut self, len: usize, filler: T) -> Filling<'_, T, FEW> {
        self.few.clear();
        self.many.clear();
        if len > FEW {
            self.many.resize(len, filler);
        }
        Filling { few: &mut self.few, many: &mut self.many }
    }

    /// What there is.
    #[inline(always)]
    pub(crate) fn all(&mut self) -> &mut [T] {
        one_place(if self.many.is_empty() { &mut self.few } else { &mut self.many })
    }

    /// `len` times this, in place of what there was.
    #[inline(always)]
    pub(crate) fn fill(&mut self, value: T, len: usize) -> &mut [T] {
        self.collect((0..len).map(|_| value))
    }

    /// These values, in place of what there was. What works them out should be short: it is there twice.
    #[inline(always)]
    pub(crate) fn collect(&mut self, values: impl ExactSizeIterator<Item = T>) -> &mut [T] {
        if values.len() <= FEW {
            self.few.clear();
            for value in values {
                self.few.push(value);
            }
            one_place(&mut self.few)
        } else {
            self.many.clear();
            self.many.extend(values);
            &mut self.many
        }
    }
}
