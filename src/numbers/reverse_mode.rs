//! Reverse-mode Jacobian products by a tape: the default derivatives of large functions.

use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::pool::lend;
use crate::numbers::scalar::{Cotangent, Over, Real, Reverse};
use crate::numbers::tape::Tape;
use crate::numbers::zip::zip;
use std::mem::swap;

/// Number of inputs above which default derivatives use reverse mode. Forward mode evaluates the
/// function once per four inputs, reverse mode once.
///
/// `cargo bench --bench defaults` compares both. Forward mode allocates nothing for up to 16 inputs
/// and 64 outputs.
pub(crate) const REVERSE_ABOVE: usize = 16;

/// Recorded evaluation of a function, with reusable buffers.
#[derive(Debug)]
pub(crate) struct Recording<R> {
    inputs: Vec<Reverse<R>>,
    outputs: Vec<Reverse<R>>,
    tape: Tape<R>,
}

impl<R> Default for Recording<R> {
    fn default() -> Self {
        Self { inputs: Vec::new(), outputs: Vec::new(), tape: Tape::default() }
    }
}

impl<R: Real> Recording<R> {
    /// Removes all inputs and all recorded operations.
    #[inline(always)]
    pub(crate) fn clear(&mut self) {
        self.inputs.clear();
        self.tape.reset();
    }

    /// Appends inputs. [`pull`](Self::pull) computes their cotangents only if `requested`.
    #[inline(always)]
    pub(crate) fn extend(&mut self, inputs: impl Iterator<Item = R>, requested: bool) {
        for value in inputs {
            self.inputs.push(if requested {
                Reverse::variable(value, self.tape.variable())
            } else {
                Reverse::constant(value)
            });
        }
    }

    /// Evaluates `f(inputs, outputs)` and records it.
    #[inline(always)]
    pub(crate) fn record(
        &mut self,
        outputs: usize,
        f: impl FnOnce(&[Reverse<R>], &mut [Reverse<R>]),
    ) {
        self.outputs.clear();
        self.outputs.resize(outputs, Reverse::constant(R::zero()));
        // An evaluation within `f` swaps in a tape of its own.
        swap(&mut *R::tape().borrow_mut(), &mut self.tape);
        f(&self.inputs, &mut self.outputs);
        swap(&mut *R::tape().borrow_mut(), &mut self.tape);
    }

    /// Calls `finish` with the cotangents of the requested inputs, in order, for given cotangents
    /// of the outputs.
    #[inline(never)]
    pub(crate) fn pull<C: Cotangent<R>>(&self, output_bars: &[C], finish: &mut dyn FnMut(&[C])) {
        struct Sweep<'a, R, C> {
            tape: &'a Tape<R>,
            cotangents: &'a mut [C],
            guarded: bool,
        }
        impl<R: Real, C: Cotangent<R>> Vectorized for Sweep<'_, R, C> {
            #[inline(always)]
            fn run<const FMA: bool>(self) {
                match self.guarded {
                    false => self.tape.sweep(self.cotangents),
                    true => self.tape.sweep_guarded(self.cotangents),
                }
            }
        }
        let variables = self.tape.inputs();
        let sweep = |cotangents: &mut Vec<C>, guarded: bool| {
            cotangents.clear();
            cotangents.resize(self.tape.numbers(), C::null());
            for (output, &bar) in zip(&self.outputs, output_bars) {
                if let Some(i) = output.index() {
                    cotangents[i] += bar;
                    if guarded {
                        // 0.0: a path reaches the output, also if its cotangent is -0.0.
                        cotangents[i] += C::null() * R::from(-1.0);
                    }
                }
            }
            let work = Sweep { tape: &self.tape, cotangents: cotangents.as_mut_slice(), guarded };
            if R::VECTORIZED { dispatch_lanes(work) } else { work.run::<false>() }
        };
        lend(|[cotangents, plain]: &mut [Vec<C>; 2]| {
            sweep(cotangents, false);
            if !cotangents[..variables].iter().all(C::all_finite) {
                std::mem::swap(cotangents, plain);
                sweep(cotangents, true);
                // Numbers that were finite keep their bits, in which signs of zeros may differ.
                for (cotangent, &plain) in zip(cotangents.iter_mut().take(variables), plain.iter())
                {
                    *cotangent = plain.finite_or(*cotangent);
                }
            }
            finish(&cotangents[..variables]);
        });
    }
}
