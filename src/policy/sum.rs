//! [`Sum`]: the sum of two policies.

use super::{
    Action, Observed, Policy, PolicyColumns, PolicyPass, PolicyRecord, Sizes, Tensor, dims,
};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use smallvec::{SmallVec, smallvec};

/// Policy whose control is the sum of the controls of two policies.
///
/// `θ` holds the parameters of the first policy, then those of the second, and the memory likewise.
/// Neither policy has trained parameters of the system.
///
/// Examples: an open-loop sequence plus feedback, or a linear regulator plus a network.
#[derive(Clone, Debug, PartialEq)]
pub struct Sum<A, B>(A, B);

impl<A: Policy, B: Policy> Sum<A, B> {
    /// Adds two policies.
    ///
    /// # Panics
    /// If their observations or controls differ in number, or if a policy has trained parameters of
    /// the system. If there are neither observations nor a memory.
    #[track_caller]
    pub fn new(first: A, second: B) -> Self {
        let dims = [first.observation_dim(), first.control_dim()];
        let other = [second.observation_dim(), second.control_dim()];
        assert!(
            dims == other,
            "the first policy of a sum has {} observations and {} controls, but the second has {} and {}; use policies with as many",
            dims[0],
            dims[1],
            other[0],
            other[1]
        );
        assert!(
            dims[0] + first.memory_dim() + second.memory_dim() > 0,
            "the policies of a sum need at least one observed component; observe one"
        );
        let trained = first.trained_params().len() + second.trained_params().len();
        assert_eq!(
            trained, 0,
            "a policy with trained parameters of the system cannot be part of a sum; pass them to `WithParams` with the sum"
        );
        Self(first, second)
    }

    /// Splits `theta` into the parameters of the first and of the second policy.
    fn split<'a, T>(&self, theta: &'a [T]) -> (&'a [T], &'a [T]) {
        theta.split_at(self.0.param_count())
    }

    /// Places of the inputs and of the outputs of each policy.
    fn places(&self) -> [[Place; 2]; 2] {
        let (inputs, outputs) = dims(self);
        let of = |shared, whole, memory, before| Place { whole, shared, memory, before };
        let (a, b) = (self.0.memory_dim(), self.1.memory_dim());
        let both = |memory, before| {
            [
                of(self.observation_dim(), inputs, memory, before),
                of(self.control_dim(), outputs, memory, before),
            ]
        };
        [both(a, 0), both(b, a)]
    }

    /// Buffers of both policies for the columns of a pass.
    fn buffers<F: Float>(&self, pass: &PolicyPass<F>) -> [Buffers; 2] {
        self.buffers_of::<F>(pass.x.len() / dims(self).0)
    }

    fn buffers_of<F: Float>(&self, columns: usize) -> [Buffers; 2] {
        let sizes = [self.0.sizes::<F>(columns), self.1.sizes::<F>(columns)];
        let of = |(sizes, [inputs, outputs]): (Sizes, [Place; 2])| Buffers {
            sizes,
            inputs: columns * inputs.width(),
            outputs: columns * outputs.width(),
        };
        let [a, b] = self.places();
        [of((sizes[0], a)), of((sizes[1], b))]
    }
}

/// Place of the columns of one policy within the columns of the sum: numbers that both policies
/// share, then its memory.
#[derive(Clone, Copy)]
struct Place {
    /// Length of a column of the sum.
    whole: usize,
    /// Observations, or controls.
    shared: usize,
    /// Memory of this policy.
    memory: usize,
    /// Memory of the policies before this one.
    before: usize,
}

impl Place {
    /// Length of a column of the policy.
    fn width(self) -> usize {
        self.shared + self.memory
    }

    /// Copies the columns `at` of the sum to those of the policy.
    fn take<F: Copy>(self, at: PolicyColumns, whole: &[F], own: &mut [F]) {
        for c in at.iter() {
            let from = &whole[c * self.whole..][..self.whole];
            let (shared, memory) =
                own[c * self.width()..][..self.width()].split_at_mut(self.shared);
            shared.copy_from_slice(&from[..self.shared]);
            memory.copy_from_slice(&from[self.shared + self.before..][..self.memory]);
        }
    }

    /// Writes the columns `at` of the policy to those of the sum. Adds shared numbers if there is a
    /// policy before this one.
    fn give<F: Float>(self, add: bool, at: PolicyColumns, own: &[F], whole: &mut [F]) {
        for c in at.iter() {
            let to = &mut whole[c * self.whole..][..self.whole];
            let (shared, memory) = own[c * self.width()..][..self.width()].split_at(self.shared);
            for (to, &from) in to[..self.shared].iter_mut().zip(shared) {
                *to = if add { *to + from } else { from };
            }
            to[self.shared + self.before..][..self.memory].copy_from_slice(memory);
        }
    }
}

/// Sizes of the buffers of one policy, and lengths of its inputs and outputs in all columns.
#[derive(Clone, Copy)]
struct Buffers {
    sizes: Sizes,
    inputs: usize,
    outputs: usize,
}

impl Buffers {
    /// Splits the tape of the sum after the part of this policy: its tape, inputs and outputs.
    fn tape<F>(self, tape: &mut [F]) -> ([&mut [F]; 3], &mut [F]) {
        split(tape, [self.sizes.tape, self.inputs, self.outputs])
    }

    /// Splits `tape_bar` of the sum after the part of this policy: its `tape_bar`, and the
    /// cotangents of its outputs and inputs.
    fn tape_bar<F>(self, tape_bar: &mut [F]) -> ([&mut [F]; 3], &mut [F]) {
        split(tape_bar, [self.sizes.tape_bar, self.outputs, self.inputs])
    }

    fn len_of_tape(self) -> usize {
        self.sizes.tape + self.inputs + self.outputs
    }

    fn len_of_tape_bar(self) -> usize {
        self.sizes.tape_bar + self.inputs + self.outputs
    }
}

fn split<F>(all: &mut [F], lengths: [usize; 3]) -> ([&mut [F]; 3], &mut [F]) {
    let mut rest = all;
    let parts = lengths.map(|length| {
        let (part, after) = std::mem::take(&mut rest).split_at_mut(length);
        rest = after;
        part
    });
    (parts, rest)
}

/// [`Policy::forward`] of one policy. `add` adds its controls to those of the policy before.
fn forward<P: Policy, F: Float>(
    policy: &P,
    pass: PolicyPass<F>,
    [inputs, outputs]: [Place; 2],
    add: bool,
    [tape, x, own]: [&mut [F]; 3],
    u: &mut [F],
) {
    inputs.take(pass.at, pass.x, x);
    policy.forward(PolicyPass { x, ..pass }, tape, own);
    outputs.give(add, pass.at, own, u);
}

/// Cotangents of the outputs and of the inputs of a sum.
type Bars<'a, F> = (&'a [F], Option<&'a mut [F]>);

/// [`Policy::backward`] of one policy. `tape` begins with its part of the tape.
fn backward<P: Policy, F: Float>(
    policy: &P,
    pass: PolicyPass<F>,
    [inputs, outputs]: [Place; 2],
    add: bool,
    (tape, buffers): (&[F], Buffers),
    [tape_bar, own_bar, x_own]: [&mut [F]; 3],
    (u_bar, x_bar): Bars<F>,
) {
    outputs.take(pass.at, u_bar, own_bar);
    let (tape, x) = tape.split_at(buffers.sizes.tape);
    let pass = PolicyPass { x: &x[..buffers.inputs], ..pass };
    let requested = x_bar.is_some().then_some(&mut *x_own);
    policy.backward(pass, tape, own_bar, tape_bar, requested);
    if let Some(x_bar) = x_bar {
        inputs.give(add, pass.at, x_own, x_bar);
    }
}

/// [`Policy::param_gradient`] of one policy. The tapes of `record` begin with its parts.
fn param_gradient<P: Policy, F: Float>(
    policy: &P,
    pass: PolicyPass<F>,
    record: PolicyRecord<F>,
    buffers: Buffers,
    scratch: &mut [F],
    theta_bar: &mut [F],
) {
    let (tape, x) = record.tape.split_at(buffers.sizes.tape);
    let (tape_bar, u_bar) = record.tape_bar.split_at(buffers.sizes.tape_bar);
    let record = PolicyRecord { tape, u_bar: &u_bar[..buffers.outputs], tape_bar, ..record };
    let pass = PolicyPass { x: &x[..buffers.inputs], ..pass };
    policy.param_gradient(pass, record, scratch, theta_bar);
}

impl<A: Policy, B: Policy> Policy for Sum<A, B> {
    fn observation_dim(&self) -> usize {
        self.0.observation_dim()
    }

    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }

    fn memory_dim(&self) -> usize {
        self.0.memory_dim() + self.1.memory_dim()
    }

    fn param_count(&self) -> usize {
        self.0.param_count() + self.1.param_count()
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        let (a, b) = theta.split_at_mut(self.0.param_count());
        self.0.init(rng, a);
        self.1.init(rng, b);
    }

    fn act<T: Scalar>(
        &self,
        theta: &[T],
        observed: Observed<'_, T>,
        Action { u, memory }: Action<'_, T>,
    ) {
        let (a, b) = self.split(theta);
        let (memory_a, memory_b) = observed.memory.split_at(self.0.memory_dim());
        let (next_a, next_b) = memory.split_at_mut(self.0.memory_dim());
        self.0.act(a, Observed { memory: memory_a, ..observed }, Action { u, memory: next_a });
        let mut second: SmallVec<[T; 8]> = smallvec![T::zero(); u.len()];
        let action = Action { u: &mut second, memory: next_b };
        self.1.act(b, Observed { memory: memory_b, ..observed }, action);
        for (u, &second) in u.iter_mut().zip(&second) {
            *u += second;
        }
    }

    fn tensors(&self) -> Vec<Tensor> {
        let shift = self.0.param_count();
        let named = |prefix: &str, shift: usize, tensors: Vec<Tensor>| -> Vec<Tensor> {
            let renamed = |Tensor { name, shape, range }: Tensor| Tensor {
                name: format!("{prefix}.{name}"),
                shape,
                range: range.start + shift..range.end + shift,
            };
            tensors.into_iter().map(renamed).collect()
        };
        [named("first", 0, self.0.tensors()), named("second", shift, self.1.tensors())].concat()
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        let [a, b] = self.buffers_of::<F>(columns);
        Sizes {
            packed: a.sizes.packed + b.sizes.packed,
            tape: a.len_of_tape() + b.len_of_tape(),
            tape_bar: a.len_of_tape_bar() + b.len_of_tape_bar(),
            scratch: a.sizes.scratch.max(b.sizes.scratch),
        }
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        let (a, b) = self.split(theta);
        let (packed_a, packed_b) = packed.split_at_mut(self.0.sizes::<F>(1).packed);
        self.0.pack(a, packed_a);
        self.1.pack(b, packed_b);
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        let ([a, b], [of_a, of_b]) = (self.buffers(&pass), self.places());
        let (packed_a, packed_b) = pass.packed.split_at(a.sizes.packed);
        let (first, rest) = a.tape(tape);
        let (second, _) = b.tape(rest);
        forward(&self.0, PolicyPass { packed: packed_a, ..pass }, of_a, false, first, u);
        forward(&self.1, PolicyPass { packed: packed_b, ..pass }, of_b, true, second, u);
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        mut x_bar: Option<&mut [F]>,
    ) {
        let ([a, b], [of_a, of_b]) = (self.buffers(&pass), self.places());
        let (packed_a, packed_b) = pass.packed.split_at(a.sizes.packed);
        let (tape_a, tape_b) = tape.split_at(a.len_of_tape());
        let (first, rest) = a.tape_bar(tape_bar);
        let (second, _) = b.tape_bar(rest);
        let (pass_a, pass_b) =
            (PolicyPass { packed: packed_a, ..pass }, PolicyPass { packed: packed_b, ..pass });
        let bars = (u_bar, x_bar.as_deref_mut());
        backward(&self.0, pass_a, of_a, false, (tape_a, a), first, bars);
        backward(&self.1, pass_b, of_b, true, (tape_b, b), second, (u_bar, x_bar));
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        let [a, b] = self.buffers(&pass);
        let (packed_a, packed_b) = pass.packed.split_at(a.sizes.packed);
        let (tape_a, tape_b) = record.tape.split_at(a.len_of_tape());
        let (bar_a, bar_b) = record.tape_bar.split_at(a.len_of_tape_bar());
        let (theta_a, theta_b) = theta_bar.split_at_mut(self.0.param_count());
        let first = PolicyRecord { tape: tape_a, tape_bar: bar_a, ..record };
        let second = PolicyRecord { tape: tape_b, tape_bar: bar_b, ..record };
        let (pass_a, pass_b) =
            (PolicyPass { packed: packed_a, ..pass }, PolicyPass { packed: packed_b, ..pass });
        param_gradient(&self.0, pass_a, first, a, scratch, theta_a);
        param_gradient(&self.1, pass_b, second, b, scratch, theta_b);
    }
}
