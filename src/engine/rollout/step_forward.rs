//! Forward step of all samples.

use super::Lane;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::scalar::{Float, Real, Scalar};
use crate::numbers::zip::zip;

/// Forward step of a task for all samples at once.
pub trait StepForward<F: Float> {
    /// Steps all blocks and adds their costs. Returns true if all next states and controls are
    /// finite.
    fn step_forward(&self, x: &[Lane<F>], u: &[Lane<F>], next: &mut [Lane<F>], costs: &mut [Lane<F>]) -> bool;
}

impl<T: Task, F: Float> StepForward<F> for T {
    fn step_forward(&self, x: &[Lane<F>], u: &[Lane<F>], next: &mut [Lane<F>], costs: &mut [Lane<F>]) -> bool {
        let mut finite = true;
        dispatch_lanes(Step { task: self, x, u, next, costs, finite: &mut finite });
        finite
    }
}

struct Step<'a, T, F: Float> {
    task: &'a T,
    x: &'a [Lane<F>],
    u: &'a [Lane<F>],
    next: &'a mut [Lane<F>],
    costs: &'a mut [Lane<F>],
    finite: &'a mut bool,
}

/// Steps one block of samples. Returns the cost and a probe: 0 if the next state and the control
/// are finite, else NaN.
#[inline(always)]
fn advance<T: Task, R: Real>(task: &T, x: &[R], u: &[R], next: &mut [R]) -> (R, R) {
    task.system().step(x, u, next);
    // 0·x is NaN if x is infinite or NaN, else 0.
    let probed = |probe: R, &number: &R| probe + number * R::zero();
    (task.stage_cost(next, u), next.iter().fold(u.iter().fold(R::zero(), probed), probed))
}

impl<T: Task, F: Float> Vectorized for Step<'_, T, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let (n, m) = (self.task.system().state_dim(), self.task.system().control_dim());
        let mut probe = Lane::<F>::zero();
        let blocks = zip(zip(zip(self.x.chunks_exact(n), self.u.chunks_exact(m)), self.next.chunks_exact_mut(n)), self.costs);
        for (((x, u), next), cost) in blocks {
            let (more, seen) = advance(self.task, x, u, next);
            *cost += more;
            probe += seen;
        }
        *self.finite = probe.0.iter().all(|&p| p == F::zero());
    }
}
