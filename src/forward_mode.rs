//! Jacobians by dual numbers: the default derivatives, and the oracle that checks every hand-written one.

use crate::scalar::{Real, Scalar, Tangents};
use crate::zip::zip;
use smallvec::{SmallVec, smallvec};
use std::ops::Range;

/// Tangents carried through one evaluation. Four doubles fill an AVX register.
pub(crate) const CHUNK: usize = 4;

/// The dual number with [`CHUNK`] tangents that derivatives of `R` run on.
pub(crate) type Dual<R> = <R as Real>::Dual;

/// Outputs and inputs up to here live on the stack.
const STACK: usize = 32;
type Buffer<T> = SmallVec<[T; 2 * STACK]>;

/// Calls `visit(i, column)` with `column[j] = ∂f_j/∂input_i`, for every input `i` in `wrt`.
///
/// `f` maps all `inputs` to `outputs` numbers; the lanes of `R` are differentiated one after the other.
#[inline]
pub(crate) fn jacobian<R: Real>(
    inputs: &[R],
    wrt: Range<usize>,
    outputs: usize,
    f: impl Fn(&[Dual<R>], &mut [Dual<R>]),
    mut visit: impl FnMut(usize, &[R]),
) {
    let constant = Dual::<R>::constant(<R::Real as Scalar>::zero());
    let mut x: Buffer<Dual<R>> = smallvec![constant; inputs.len()];
    let mut y: Buffer<Dual<R>> = smallvec![constant; outputs];
    let mut columns: SmallVec<[R; CHUNK * STACK]> = smallvec![R::zero(); outputs * CHUNK];
    for first in wrt.clone().step_by(CHUNK) {
        let chunk = first..wrt.end.min(first + CHUNK);
        for lane in 0..R::LANES {
            for (i, (x, input)) in zip(x.iter_mut(), inputs).enumerate() {
                let value = input.lane(lane);
                *x = if chunk.contains(&i) { Dual::<R>::variable(value, i - first) } else { Dual::<R>::constant(value) };
            }
            f(&x, &mut y);
            for (j, y) in y.iter().enumerate() {
                for (k, tangent) in y.tangents().into_iter().enumerate() {
                    columns[k * outputs + j].set_lane(lane, tangent);
                }
            }
        }
        for (k, i) in chunk.enumerate() {
            visit(i, &columns[k * outputs..(k + 1) * outputs]);
        }
    }
}

/// The inputs `x` and then `u` in one slice.
#[inline]
pub(crate) fn concat<R: Real>(x: &[R], u: &[R]) -> SmallVec<[R; 16]> {
    x.iter().chain(u).copied().collect()
}
