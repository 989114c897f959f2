//! Forward step of all samples.

use super::{Lane, WIDTH};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::kernels::{Vectorized, dispatch_narrow, in_lanes};
use crate::numbers::scalar::{Float, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};

/// Stack capacity, in numbers, for the scalar fallback. Larger samples allocate.
pub(crate) const FEW: usize = 512;

/// Copies one lane of a block to `one`.
pub(crate) fn read_lane<F: Float>(block: &[Lane<F>], lane: usize, one: &mut [F]) {
    zip(one, block).for_each(|(one, lanes)| *one = lanes.0[lane]);
}

/// Forward step of a task for all samples at once.
pub trait StepForward<F: Float> {
    /// Steps all blocks and adds their costs. Returns true if all states and controls are finite.
    fn step_forward(&self, x: &[Lane<F>], u: &[Lane<F>], next: &mut [Lane<F>], costs: &mut [Lane<F>]) -> bool;
}

impl<T: Task, F: Float> StepForward<F> for T {
    fn step_forward(&self, x: &[Lane<F>], u: &[Lane<F>], next: &mut [Lane<F>], costs: &mut [Lane<F>]) -> bool {
        let mut finite = true;
        dispatch_narrow(Step { task: self, x, u, next, costs, finite: &mut finite });
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

/// Steps one block of samples, or one sample. Returns the cost and a probe: 0 if all numbers are
/// finite, else NaN.
#[inline(always)]
fn advance<T: Task, R: Real>(task: &T, x: &[R], u: &[R], next: &mut [R]) -> (R, R) {
    task.system().step(x, u, next);
    // 0·x is NaN if x is infinite or NaN, else 0.
    let probed = |probe: R, &number: &R| probe + number * R::zero();
    (task.stage_cost(next, u), next.iter().fold(u.iter().fold(R::zero(), probed), probed))
}

impl<T: Task, F: Float> Step<'_, T, F> {
    #[inline(always)]
    fn in_lanes(self) {
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

    fn one_by_one(self) {
        let Self { task, x, u, next, costs, finite } = self;
        let sizes = [task.system().state_dim(), task.system().control_dim()];
        *finite = one_by_one(&|x, u, next| advance(task, x, u, next), sizes, x, u, next, costs);
    }
}

/// Forward step of one sample. Returns cost and probe as [`advance`] does.
type Advance<'a, F> = &'a dyn Fn(&[F], &[F], &mut [F]) -> (F, F);

/// Steps the samples one at a time, for processors without AVX2.
///
/// Takes the step as a trait object, so it is compiled once for all tasks.
#[inline(never)]
fn one_by_one<F: Float>(
    advance: Advance<F>,
    [n, m]: [usize; 2],
    x: &[Lane<F>],
    u: &[Lane<F>],
    next: &mut [Lane<F>],
    costs: &mut [Lane<F>],
) -> bool {
    let mut numbers: SmallVec<[F; FEW]> = smallvec![F::zero(); 2 * n + m];
    let (one, rest) = numbers.split_at_mut(n);
    let (one_next, one_u) = rest.split_at_mut(n);
    let mut finite = true;
    for sample in 0..x.len() / n * WIDTH {
        let (block, lane) = (sample / WIDTH, sample % WIDTH);
        read_lane(&x[block * n..], lane, one);
        read_lane(&u[block * m..], lane, one_u);
        let (more, seen) = advance(one, one_u, one_next);
        costs[block].0[lane] += more;
        finite &= seen == F::zero();
        zip(&mut next[block * n..], &*one_next).for_each(|(lanes, &one)| lanes.0[lane] = one);
    }
    finite
}

impl<T: Task, F: Float> Vectorized for Step<'_, T, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        if in_lanes::<FMA>() { self.in_lanes() } else { self.one_by_one() }
    }
}
