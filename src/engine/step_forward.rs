//! Forward step of all samples.

use crate::dynamics::inputs::Inputs;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::scalar::{Float, Lane, Real, Scalar};

/// Forward step of a task for all samples at once.
pub trait StepForward<F: Float> {
    /// Steps all blocks and adds their costs. Returns true if all next states and controls are
    /// finite.
    fn step_forward(
        &self,
        inputs: Inputs<'_, Lane<F>>,
        next: &mut [Lane<F>],
        costs: &mut [Lane<F>],
    ) -> bool;
}

impl<T: Task, F: Float> StepForward<F> for T {
    #[inline(never)]
    fn step_forward(
        &self,
        inputs: Inputs<'_, Lane<F>>,
        next: &mut [Lane<F>],
        costs: &mut [Lane<F>],
    ) -> bool {
        let mut finite = true;
        dispatch_lanes(ForwardStep { task: self, inputs, next, costs, finite: &mut finite });
        finite
    }
}

struct ForwardStep<'a, T, F: Float> {
    task: &'a T,
    /// Inputs of all blocks, concatenated.
    inputs: Inputs<'a, Lane<F>>,
    next: &'a mut [Lane<F>],
    costs: &'a mut [Lane<F>],
    finite: &'a mut bool,
}

/// Steps one block of samples. Returns the cost and a probe: 0 if the next state and the control
/// are finite, else NaN.
#[inline(always)]
fn advance<T: Task, R: Real>(task: &T, inputs: Inputs<'_, R>, next: &mut [R]) -> (R, R) {
    task.system().step(inputs, next);
    // 0·x is NaN if x is infinite or NaN, else 0.
    let probed = |probe: R, &number: &R| probe + number * R::zero();
    (
        task.running_cost(inputs, next),
        next.iter().fold(inputs.u.iter().fold(R::zero(), probed), probed),
    )
}

impl<T: Task, F: Float> Vectorized for ForwardStep<'_, T, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { task, inputs: Inputs { x, u, p, t }, next, costs, finite } = self;
        let (n, m, params) =
            (task.system().state_dim(), task.system().control_dim(), task.param_dim());
        let mut probe = Lane::<F>::zero();
        for (block, next) in next.chunks_exact_mut(n).enumerate() {
            let inputs = Inputs {
                x: &x[block * n..][..n],
                u: &u[block * m..][..m],
                p: &p[block * params..][..params],
                t,
            };
            let (more, seen) = advance(task, inputs, next);
            costs[block] += more;
            probe += seen;
        }
        *finite = probe.0.iter().all(|&p| p == F::zero());
    }
}
