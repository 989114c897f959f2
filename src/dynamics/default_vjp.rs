//! [`default_vjp`]: exact transposed Jacobian products of any [`Function`].
//!
//! Up to [`REVERSE_ABOVE`] inputs, dual numbers give columns of the Jacobian. For more inputs, one
//! recorded evaluation gives the product itself.

use crate::dynamics::outline;
use crate::numbers::forward_mode::jacobian;
use crate::numbers::kernels::Vectorized;
use crate::numbers::pool::lend;
use crate::numbers::reverse_mode::{REVERSE_ABOVE, Recording};
use crate::numbers::scalar::{Cotangent, Over, Real};
use crate::numbers::zip::zip;
use smallvec::SmallVec;

/// A function of `N` lists of numbers, for every scalar with derivatives over `R`.
pub(crate) trait Function<R, const N: usize> {
    /// Writes the value of the function at `inputs` to `outputs`.
    fn eval<T: Over<R>>(&self, inputs: [&[T]; N], outputs: &mut [T]);
}

/// Adds the transposed Jacobian product of a function to the requested cotangents.
///
/// In forward mode, `visit(bar, column)` adds the product of `output_bars` and `column` to `bar`.
/// Here, `bar` is the cotangent of one input, and `column` is the Jacobian column of that input.
/// Reverse mode does not call `visit`.
#[inline(always)]
pub(crate) fn default_vjp<R: Real, C: Cotangent<R>, const N: usize>(
    function: &impl Function<R, N>,
    inputs: [&[R]; N],
    output_bars: &[C],
    cotangents: [Option<&mut [C]>; N],
    visit: impl FnMut(&mut C, &[R]),
) {
    if cotangents.iter().all(Option::is_none) {
        return;
    }
    if inputs.iter().map(|inputs| inputs.len()).sum::<usize>() > REVERSE_ABOVE {
        reverse(function, inputs, output_bars, cotangents);
    } else {
        each_column(function, inputs, output_bars.len(), cotangents, visit);
    }
}

/// Returns a `visit` for [`default_vjp`] that adds the inner product of `output_bars` and a column
/// of the Jacobian.
#[inline(always)]
pub(crate) fn add_product<R: Real, C: Cotangent<R>>(output_bars: &[C]) -> impl Fn(&mut C, &[R]) {
    move |bar, column| {
        let mut sum = C::null();
        for (&output_bar, &slope) in zip(output_bars, column) {
            sum += output_bar * slope;
        }
        *bar += sum;
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

/// Calls `visit` with each requested cotangent and its column of the Jacobian, by dual numbers.
#[inline(always)]
fn each_column<R: Real, C, const N: usize>(
    function: &impl Function<R, N>,
    inputs: [&[R]; N],
    outputs: usize,
    mut cotangents: [Option<&mut [C]>; N],
    mut visit: impl FnMut(&mut C, &[R]),
) {
    let lengths = inputs.map(<[R]>::len);
    let all: SmallVec<[R; REVERSE_ABOVE]> = inputs.into_iter().flatten().copied().collect();
    // Differentiates with respect to all lists from the first to the last requested list.
    let requested = |k: &usize| cotangents[*k].is_some();
    let first = (0..N).find(requested).unwrap_or(N);
    let last = (0..N).rfind(requested).map_or(first, |k| k + 1);
    let before = |list: usize| lengths[..list].iter().sum::<usize>();
    let wrt = before(first)..before(last);
    jacobian(
        &all,
        wrt,
        outputs,
        |all, outputs| function.eval(split(all, lengths), outputs),
        |mut i, column| {
            for (length, cotangents) in zip(lengths, &mut cotangents) {
                if i < length {
                    if let Some(cotangents) = cotangents {
                        visit(&mut cotangents[i], column);
                    }
                    return;
                }
                i -= length;
            }
        },
    );
}

/// Adds the transposed Jacobian product by one recorded evaluation.
///
/// Reuses buffers of the current thread.
#[inline(never)]
fn reverse<R: Real, C: Cotangent<R>, const N: usize>(
    function: &impl Function<R, N>,
    inputs: [&[R]; N],
    output_bars: &[C],
    cotangents: [Option<&mut [C]>; N],
) {
    let requested = std::array::from_fn(|k| cotangents[k].is_some());
    lend(|recording: &mut Recording<R>| {
        record(function, inputs, requested, output_bars.len(), recording);
        recording.pull(output_bars, |pulled| {
            for (cotangent, &part) in zip(cotangents.into_iter().flatten().flatten(), pulled) {
                *cotangent += part;
            }
        });
    });
}

/// Records a function. Outlined; monomorphized once per function and scalar type.
#[inline(never)]
fn record<R: Real, const N: usize>(
    function: &impl Function<R, N>,
    inputs: [&[R]; N],
    requested: [bool; N],
    outputs: usize,
    recording: &mut Recording<R>,
) {
    struct Work<'a, F, R, const N: usize> {
        function: &'a F,
        inputs: [&'a [R]; N],
        requested: [bool; N],
        outputs: usize,
        recording: &'a mut Recording<R>,
    }
    impl<F: Function<R, N>, R: Real, const N: usize> Vectorized for Work<'_, F, R, N> {
        #[inline(always)]
        fn run<const FMA: bool>(self) {
            let Self { function, inputs, requested, outputs, recording } = self;
            let lengths = inputs.map(<[R]>::len);
            recording.clear();
            for (inputs, requested) in zip(inputs, requested) {
                recording.extend(inputs.iter().copied(), requested);
            }
            recording.record(outputs, |all, outputs| function.eval(split(all, lengths), outputs));
        }
    }
    outline::outline::<R>(Work { function, inputs, requested, outputs, recording });
}
