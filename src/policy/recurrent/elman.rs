//! [`Elman`] network.

use super::affine::Affine;
use super::{Cell, Shape};
use crate::numbers::scalar::{Float, Real, Scalar};
use crate::numbers::zip::zip;

/// Elman network: `m' = tanh(W (y, m) + b)`, `u = V m' + c`.
///
/// y is the observation, m the memory, m' the next memory, and u the control.
///
/// J. L. Elman, "Finding Structure in Time", Cognitive Science 14 (1990). Initial weights are
/// Glorot-uniform, initial biases 0. The memory is 0 at the start of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Elman(pub(super) Shape);

impl Elman {
    /// A network with `observations` inputs, `units` hidden units and `controls` outputs.
    ///
    /// # Panics
    /// If `units` is 0.
    #[track_caller]
    pub fn new(observations: usize, units: usize, controls: usize) -> Self {
        Self(Shape::new(observations, units, controls))
    }

    /// The maps to the next memory and to the control.
    pub(super) fn maps(&self) -> [Affine; 2] {
        let Shape { observations, units, controls } = self.0;
        let memory = Affine { first: 0, inputs: observations + units, outputs: units };
        [memory, memory.then(units, controls)]
    }
}

impl Cell for Elman {
    const STORED: usize = 1;
    const BARS: usize = 1;

    fn shape(&self) -> Shape {
        self.0
    }

    #[inline(always)]
    fn evaluate<W: Copy, T: Scalar>(
        &self,
        theta: &[W],
        splat: impl Fn(W) -> T + Copy,
        (y, memory): (&[T], &[T]),
        next: &mut [T],
        u: &mut [T],
    ) {
        let [to_memory, to_control] = self.maps();
        to_memory.evaluate(theta, splat, y.iter().chain(memory), next);
        next.iter_mut().for_each(|m| *m = m.tanh());
        to_control.evaluate(theta, splat, next.iter(), u);
    }

    #[inline(always)]
    fn reverse<R: Real>(
        &self,
        theta: &[R::Real],
        _memory: &[R],
        next: &[R],
        next_bar: &[R],
        cotangents: &mut [R],
        x_bar: Option<(&mut [R], &mut [R])>,
    ) {
        let [to_memory, _] = self.maps();
        for (bar, (&m, &m_bar)) in zip(cotangents.iter_mut(), zip(next.iter(), next_bar)) {
            *bar = m_bar * (R::one() - m * m);
        }
        if let Some((y_bar, memory_bar)) = x_bar {
            for (i, bar) in y_bar.iter_mut().chain(memory_bar).enumerate() {
                *bar += to_memory.input_bar(theta, i, cotangents);
            }
        }
    }

    fn add_gradient<F: Float>(
        &self,
        (y, memory): (&[F], &[F]),
        next: &[F],
        cotangents: &[F],
        u_bar: &[F],
        factor: F,
        theta_bar: &mut [F],
    ) {
        let [to_memory, to_control] = self.maps();
        to_memory.add_gradient(y.iter().chain(memory).copied(), cotangents, factor, theta_bar);
        to_control.add_gradient(next.iter().copied(), u_bar, factor, theta_bar);
    }

    fn to_control(&self) -> Affine {
        self.maps()[1]
    }
}
