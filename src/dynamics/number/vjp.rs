//! [`param_vjp`]: cotangents of parameters, by dual numbers.

use crate::numbers::forward_mode::{CHUNK, Chunk};
use crate::numbers::scalar::{Cotangent, Dual, Float, Real};

/// Scalar of [`param_vjp`].
pub(crate) type ParamDual = Chunk<f64>;

/// State, control and parameters to outputs.
type Differentiable<'a> = &'a dyn Fn([&[ParamDual]; 3], &mut [ParamDual]);

/// Adds the product of `output_bars` and the derivative of `function` by its parameters to `p_bar`.
///
/// `inputs` are state, control and parameters. The derivatives are computed in f64, one sample at a
/// time, so that a system compiles for one more scalar only.
#[inline(never)]
pub(crate) fn param_vjp<R: Real, C: Cotangent<R>>(
    function: Differentiable<'_>,
    inputs: [&[R]; 3],
    output_bars: &[C],
    p_bar: Option<&mut [C]>,
) {
    let Some(p_bar) = p_bar else { return };
    let params = inputs[2].len();
    let mut slopes = vec![R::zero(); params * output_bars.len()];
    let mut outputs = vec![ParamDual::constant(0.0); output_bars.len()];
    for lane in 0..R::LANES {
        let [x, u, mut p] =
            inputs.map(|list| list.iter().map(|value| ParamDual::constant(value.lane(lane).to_f64())).collect::<Vec<_>>());
        for first in (0..params).step_by(CHUNK) {
            let chunk = first..params.min(first + CHUNK);
            for i in chunk.clone() {
                p[i] = Dual::variable(p[i].value, i - first);
            }
            function([&x, &u, &p], &mut outputs);
            for i in chunk {
                p[i] = Dual::constant(p[i].value);
                for (slope, output) in slopes[i * output_bars.len()..].iter_mut().zip(&outputs) {
                    slope.set_lane(lane, R::Real::lift(output.tangents[i - first]));
                }
            }
        }
    }
    for (bar, column) in p_bar.iter_mut().zip(slopes.chunks_exact(output_bars.len())) {
        for (&output_bar, &slope) in output_bars.iter().zip(column) {
            *bar += output_bar * slope;
        }
    }
}
