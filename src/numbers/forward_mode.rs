//! Forward-mode Jacobians by dual numbers: the default derivatives of small functions.

use crate::numbers::scalar::{Dual, Real};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};
use std::ops::Range;

/// Number of tangent directions per evaluation.
pub(crate) const CHUNK: usize = 4;

/// Dual number over `R` with [`CHUNK`] tangents.
pub(crate) type Chunk<R> = Dual<R, CHUNK>;

/// Stack capacity of a [`Buffer`], in numbers.
const STACK: usize = 64;
type Buffer<T> = SmallVec<[T; STACK]>;

/// Calls `visit(i, column)` with `column[j] = ∂f_j/∂input_i`, in order, for all inputs `i` in
/// `wrt`.
///
/// `f` maps all `inputs` to `outputs` numbers. Each evaluation yields up to [`CHUNK`] columns.
#[inline(always)]
pub(crate) fn jacobian<R: Real>(
    inputs: &[R],
    wrt: Range<usize>,
    outputs: usize,
    f: impl Fn(&[Chunk<R>], &mut [Chunk<R>]),
    mut visit: impl FnMut(usize, &[R]),
) {
    let constant = Chunk::constant(R::zero());
    let mut x: Buffer<Chunk<R>> = smallvec![constant; inputs.len()];
    let mut y: Buffer<Chunk<R>> = smallvec![constant; outputs];
    let mut column: Buffer<R> = smallvec![R::zero(); outputs];
    for first in wrt.clone().step_by(CHUNK) {
        let chunk = first..wrt.end.min(first + CHUNK);
        for (i, (x, &input)) in zip(x.iter_mut(), inputs).enumerate() {
            *x = if chunk.contains(&i) {
                Chunk::variable(input, i - first)
            } else {
                Chunk::constant(input)
            };
        }
        f(&x, &mut y);
        for (k, i) in chunk.enumerate() {
            for (column, y) in zip(column.iter_mut(), &y) {
                *column = y.tangents[k];
            }
            visit(i, &column);
        }
    }
}

/// Concatenates `x` and `u`. Allocates beyond 16 numbers.
#[inline(always)]
pub(crate) fn concat<R: Real>(x: &[R], u: &[R]) -> SmallVec<[R; 16]> {
    x.iter().chain(u).copied().collect()
}
