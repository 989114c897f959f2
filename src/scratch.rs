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

impl<T: Copy, const FEW: usize> Scratch<T, FEW> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { few: ArrayVec::new(), many: Vec::new() }
    }

    /// Makes room for `len` numbers, to be [`set`](Self::set) in order; a filler is any number.
    #[inline(always)]
    pub(crate) fn reserve(&mut self, len: usize, filler: T) {
        self.few.clear();
        self.many.clear();
        if len > FEW {
            self.many.resize(len, filler);
        }
    }

    /// Sets number `i`, those before being set. Never calls anything: a call would cost the numbers in registers.
    #[inline(always)]
    pub(crate) fn set(&mut self, i: usize, value: T) {
        debug_assert!(i == self.few.len() || i < self.many.len());
        if self.many.is_empty() { self.few.push(value) } else { self.many[i] = value }
    }

    /// What has been set.
    #[inline(always)]
    pub(crate) fn all(&mut self) -> &mut [T] {
        if self.many.is_empty() { &mut self.few } else { &mut self.many }
    }

    /// `len` times this, in place of what there was.
    #[inline(always)]
    pub(crate) fn fill(&mut self, value: T, len: usize) -> &mut [T] {
        // Zeros that are known to be zeros become a call of memset, which costs more than a short loop.
        let value = black_box(value);
        self.collect((0..len).map(|_| value))
    }

    /// These values, in place of what there was. What works them out should be short: it is there twice.
    #[inline(always)]
    pub(crate) fn collect(&mut self, values: impl ExactSizeIterator<Item = T>) -> &mut [T] {
        if values.len() <= FEW {
            self.few.clear();
            self.few.extend(values);
            &mut self.few
        } else {
            self.many.clear();
            self.many.extend(values);
            &mut self.many
        }
    }
}
