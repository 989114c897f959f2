//! [`param_vjp`]: cotangents of parameters, by dual numbers.

use crate::numbers::scalar::{Cotangent, Float, Real};
use num_dual::Dual64;

/// Scalar of [`param_vjp`].
pub(crate) type ParamDual = Dual64;

/// Function of one lane. Takes the index of the lane, its `[state, control, parameters]`, and the
/// outputs to write.
type Differentiable<'a> = &'a dyn Fn(usize, [&[ParamDual]; 3], &mut [ParamDual]);

/// Adds `(∂f/∂p)ᵀ output_bars` to `p_bar`, for the `function` f of state, control and parameters p.
///
/// `inputs` are state, control and parameters. Derivatives are evaluated in f64, for one sample and
/// one parameter at a time. [`ParamDual`] is also the scalar of the checks, so systems are compiled
/// for no further scalar.
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
    let mut outputs = vec![ParamDual::from_re(0.0); output_bars.len()];
    for lane in 0..R::LANES {
        let [x, u, mut p] = inputs.map(|list| {
            list.iter()
                .map(|value| ParamDual::from_re(value.lane(lane).to_f64()))
                .collect::<Vec<_>>()
        });
        for i in 0..params {
            p[i].eps = 1.0;
            function(lane, [&x, &u, &p], &mut outputs);
            p[i].eps = 0.0;
            for (slope, output) in slopes[i * output_bars.len()..].iter_mut().zip(&outputs) {
                slope.set_lane(lane, R::Real::from_f64(output.eps));
            }
        }
    }
    for (bar, column) in p_bar.iter_mut().zip(slopes.chunks_exact(output_bars.len())) {
        for (&output_bar, &slope) in output_bars.iter().zip(column) {
            *bar += output_bar * slope;
        }
    }
}
