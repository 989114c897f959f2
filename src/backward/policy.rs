//! The policy's side of the reverse pass: what it keeps, and its cotangents.

use super::{Flow, Pass};
use crate::policy::{Policy, PolicyColumns, PolicyPass};
use crate::scalar::Float;

/// The policy's side of the reverse pass.
#[derive(Debug)]
pub(super) struct PolicyAdjoint<F> {
    /// Control cotangents `h`, per flow, as the policy's columns.
    pub(super) controls_bar: Vec<Vec<F>>,
    /// What the policy's backward pass keeps: per flow, or once for all if `unit`.
    pub(super) tape_bar: Vec<Vec<F>>,
    /// `(∂N/∂x)ᵀ h` of one step, or `∂N/∂x` of all, as the policy's columns; nothing where no flow goes through it.
    pub(super) inputs_bar: Vec<F>,
    /// The policy is linearized for all steps of a unit at once.
    pub(super) unit: bool,
    /// With `unit`: ones, the cotangent of the only control.
    pub(super) ones: Vec<F>,
    pub(super) scratch: Vec<F>,
}

/// How long the vectors of a policy's side are.
pub(super) struct PolicyRoom {
    flows: usize,
    controls_bar: usize,
    tapes: usize,
    tape_bar: usize,
    inputs_bar: usize,
    unit: bool,
    ones: usize,
    scratch: usize,
}

impl PolicyRoom {
    pub(super) fn new<P: Policy, F: Float>(policy: &P, columns: usize, flows: &[Flow]) -> Self {
        let (n, m) = (policy.state_dim(), policy.control_dim());
        let sizes = policy.sizes::<F>(columns);
        // With one control, ∂N/∂x and every layer's cotangent are known up to the factor h before the loop starts, and
        // one linearization in large products serves every flow. With more controls it would take one each.
        let through_inputs = flows.iter().any(|flow| flow.control);
        let unit = m == 1 && through_inputs;
        Self {
            flows: flows.len(),
            controls_bar: columns * m,
            tapes: if unit { 1 } else { flows.len() },
            tape_bar: sizes.tape_bar,
            inputs_bar: if through_inputs { columns * n } else { 0 },
            unit,
            ones: if unit { columns } else { 0 },
            scratch: sizes.scratch,
        }
    }

    pub(super) fn bytes<F>(&self) -> usize {
        let numbers = self.flows * self.controls_bar + self.tapes * self.tape_bar + self.inputs_bar + self.ones + self.scratch;
        numbers * size_of::<F>() + (self.flows + self.tapes) * size_of::<Vec<F>>()
    }
}

impl<F: Float> PolicyAdjoint<F> {
    pub(super) fn new(room: &PolicyRoom) -> Self {
        let zeros = |len: usize| vec![F::zero(); len];
        Self {
            controls_bar: (0..room.flows).map(|_| zeros(room.controls_bar)).collect(),
            tape_bar: (0..room.tapes).map(|_| zeros(room.tape_bar)).collect(),
            inputs_bar: zeros(room.inputs_bar),
            unit: room.unit,
            ones: vec![F::one(); room.ones],
            scratch: zeros(room.scratch),
        }
    }

    pub(super) fn stored_bytes(&self) -> usize {
        let flat = size_of_val(&self.inputs_bar[..]) + size_of_val(&self.ones[..]) + size_of_val(&self.scratch[..]);
        flat + nested_bytes(&self.controls_bar) + nested_bytes(&self.tape_bar)
    }

    /// The policy's cotangents of flow `k` in the columns `at`; `∂N/∂x` only if `through_inputs`.
    pub(super) fn backward<T, P: Policy>(&mut self, pass: &Pass<'_, T, P, F>, k: usize, at: PolicyColumns, through_inputs: bool) {
        let columns = PolicyPass { packed: pass.weights.packed(), at, x: pass.rollout.inputs() };
        let u_bar = if self.unit { &self.ones } else { &self.controls_bar[k] };
        let x_bar = through_inputs.then_some(&mut self.inputs_bar[..]);
        pass.policy.backward(columns, &pass.rollout.tape, u_bar, &mut self.tape_bar[k], x_bar);
    }
}

/// Bytes of a vector of vectors on the heap, if none has room to spare.
pub(super) fn nested_bytes<T>(rows: &[Vec<T>]) -> usize {
    size_of_val(rows) + rows.iter().map(|row| size_of_val(&row[..])).sum::<usize>()
}
