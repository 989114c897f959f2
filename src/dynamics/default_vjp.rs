//! [`default_vjp`]: exact transposed Jacobian products of any [`Function`].
//!
//! Up to [`REVERSE_ABOVE`] inputs, dual numbers give columns of the Jacobian. For more inputs, one
//! recorded evaluation gives the product itself. Both are compiled once per scalar type: they call
//! the function through [`AnyFunction`].

use crate::dynamics::outline::outline;
use crate::numbers::forward_mode::{Chunk, jacobian};
use crate::numbers::kernels::Vectorized;
use crate::numbers::pool::lend;
use crate::numbers::reverse_mode::{REVERSE_ABOVE, Recording};
use crate::numbers::scalar::{Cotangent, Over, Real, Reverse};
use crate::numbers::zip::zip;
use smallvec::SmallVec;
use std::marker::PhantomData;

/// A function of `N` lists of numbers, for every scalar with derivatives over `R`.
pub(crate) trait Function<R, const N: usize> {
    /// Writes the value of the function at `inputs` to `outputs`.
    fn eval<T: Over<R>>(&self, inputs: [&[T]; N], outputs: &mut [T]);
}

/// Object-safe [`Function`], outlined.
trait AnyFunction<R: Real, const N: usize> {
    /// [`Function::eval`] in dual numbers.
    fn duals(&self, inputs: [&[Chunk<R>]; N], outputs: &mut [Chunk<R>]);
    /// [`Function::eval`] recorded on the active tape.
    fn recorded(&self, inputs: [&[Reverse<R>]; N], outputs: &mut [Reverse<R>]);
}

impl<F: Function<R, N>, R: Real, const N: usize> AnyFunction<R, N> for F {
    fn duals(&self, inputs: [&[Chunk<R>]; N], outputs: &mut [Chunk<R>]) {
        outline::<R>(Eval { function: self, inputs, outputs, real: PhantomData::<R> });
    }

    fn recorded(&self, inputs: [&[Reverse<R>]; N], outputs: &mut [Reverse<R>]) {
        outline::<R>(Eval { function: self, inputs, outputs, real: PhantomData::<R> });
    }
}

struct Eval<'a, F, R, T, const N: usize> {
    function: &'a F,
    inputs: [&'a [T]; N],
    outputs: &'a mut [T],
    real: PhantomData<R>,
}

impl<F: Function<R, N>, R: Real, T: Over<R>, const N: usize> Vectorized for Eval<'_, F, R, T, N> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.function.eval(self.inputs, self.outputs);
    }
}

/// Order of additions in the product of a column of the Jacobian and the cotangents of the outputs.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Add {
    /// Adds the inner product to the cotangent of the input.
    Sum,
    /// Adds the products to the cotangent one after the other.
    Each,
}

/// Adds the transposed Jacobian product of a function to the requested cotangents. `add` applies to
/// forward mode.
#[inline(always)]
pub(crate) fn default_vjp<R: Real, C: Cotangent<R>, const N: usize>(
    function: &impl Function<R, N>,
    inputs: [&[R]; N],
    output_bars: &[C],
    cotangents: [Option<&mut [C]>; N],
    add: Add,
) {
    if cotangents.iter().all(Option::is_none) {
        return;
    }
    if inputs.iter().map(|inputs| inputs.len()).sum::<usize>() > REVERSE_ABOVE {
        reverse(function, inputs, output_bars, cotangents);
    } else {
        forward(function, inputs, output_bars, cotangents, add);
    }
}

/// Splits `all` into consecutive lists of the given lengths.
#[inline(always)]
fn split<T, const N: usize>(mut all: &[T], lengths: [usize; N]) -> [&[T]; N] {
    lengths.map(|length| {
        let (first, rest) = all.split_at(length);
        all = rest;
        first
    })
}

/// Adds the transposed Jacobian product by dual numbers.
#[inline(never)]
fn forward<R: Real, C: Cotangent<R>, const N: usize>(
    function: &dyn AnyFunction<R, N>,
    inputs: [&[R]; N],
    output_bars: &[C],
    cotangents: [Option<&mut [C]>; N],
    add: Add,
) {
    struct Work<'a, R, C, const N: usize> {
        function: &'a dyn AnyFunction<R, N>,
        inputs: [&'a [R]; N],
        output_bars: &'a [C],
        cotangents: [Option<&'a mut [C]>; N],
        add: Add,
    }
    impl<R: Real, C: Cotangent<R>, const N: usize> Vectorized for Work<'_, R, C, N> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Self { function, inputs, output_bars, mut cotangents, add } = self;
            let lengths = inputs.map(<[R]>::len);
            let all: SmallVec<[R; REVERSE_ABOVE]> = inputs.into_iter().flatten().copied().collect();
            // Differentiates with respect to all lists from the first to the last requested list.
            let requested = |k: &usize| cotangents[*k].is_some();
            let first = (0..N).find(requested).unwrap_or(N);
            let last = (0..N).rfind(requested).map_or(first, |k| k + 1);
            let before = |list: usize| lengths[..list].iter().sum::<usize>();
            let wrt = before(first)..before(last);
            let eval = |all: &[_], outputs: &mut [_]| function.duals(split(all, lengths), outputs);
            jacobian(&all, wrt, output_bars.len(), eval, |mut i, column| {
                for (length, cotangents) in zip(lengths, &mut cotangents) {
                    if i < length {
                        if let Some(cotangents) = cotangents {
                            add_product(&mut cotangents[i], output_bars, column, add);
                        }
                        return;
                    }
                    i -= length;
                }
            });
        }
    }
    outline::<R>(Work { function, inputs, output_bars, cotangents, add });
}

/// Adds the inner product of `output_bars` and a column of the Jacobian to `bar`.
#[inline(always)]
fn add_product<R: Real, C: Cotangent<R>>(bar: &mut C, output_bars: &[C], column: &[R], add: Add) {
    let mut sum = if add == Add::Each { *bar } else { C::null() };
    for (&output_bar, &slope) in zip(output_bars, column) {
        sum += output_bar * slope;
    }
    match add {
        Add::Each => *bar = sum,
        Add::Sum => *bar += sum,
    }
}

/// Adds the transposed Jacobian product by one recorded evaluation.
///
/// Reuses buffers of the current thread.
#[inline(never)]
fn reverse<R: Real, C: Cotangent<R>, const N: usize>(
    function: &dyn AnyFunction<R, N>,
    inputs: [&[R]; N],
    output_bars: &[C],
    mut cotangents: [Option<&mut [C]>; N],
) {
    let lengths = inputs.map(<[R]>::len);
    lend(|recording: &mut Recording<R>| {
        recording.clear();
        for (inputs, cotangents) in zip(inputs, &cotangents) {
            recording.extend(inputs.iter().copied(), cotangents.is_some());
        }
        recording.record(output_bars.len(), |all, outputs| {
            function.recorded(split(all, lengths), outputs);
        });
        recording.pull(output_bars, &mut |pulled| {
            let requested = cotangents.iter_mut().flatten().flat_map(|list| list.iter_mut());
            for (cotangent, &part) in zip(requested, pulled) {
                *cotangent += part;
            }
        });
    });
}
