//! [`Sum`]: the sum of two policies.

use super::{Action, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use smallvec::{SmallVec, smallvec};

/// Policy whose control is the sum of the controls of two policies.
///
/// Neither policy has a memory or trained parameters of the system. `θ` holds the parameters of the
/// first policy, then those of the second.
///
/// Examples: an open-loop sequence plus feedback, or a linear regulator plus a network.
#[derive(Clone, Debug, PartialEq)]
pub struct Sum<A, B>(A, B);

impl<A: Policy, B: Policy> Sum<A, B> {
    /// Adds two policies.
    ///
    /// # Panics
    /// If their observations or controls differ in number, or if a policy has a memory or trained
    /// parameters of the system. If there are no observations.
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
            dims[0] > 0,
            "the policies of a sum need at least one observed component; observe one"
        );
        let excluded = first.memory_dim()
            + second.memory_dim()
            + first.trained_params().len()
            + second.trained_params().len();
        assert_eq!(
            excluded, 0,
            "a policy with a memory, or with trained parameters of the system, cannot be part of a sum; use policies without them"
        );
        Self(first, second)
    }

    /// Splits `theta` into the parameters of the first and of the second policy.
    fn split<'a, T>(&self, theta: &'a [T]) -> (&'a [T], &'a [T]) {
        theta.split_at(self.0.param_count())
    }

    /// Buffer sizes of both policies for the columns of a pass.
    fn parts<F: Float>(&self, columns: usize) -> [Sizes; 2] {
        [self.0.sizes::<F>(columns), self.1.sizes::<F>(columns)]
    }

    fn parts_of<F: Float>(&self, pass: &PolicyPass<F>) -> [Sizes; 2] {
        self.parts::<F>(pass.x.len() / self.observation_dim())
    }

    /// The passes of both policies.
    fn passes<'a, F: Float>(
        &self,
        pass: PolicyPass<'a, F>,
        [first, _]: &[Sizes; 2],
    ) -> [PolicyPass<'a, F>; 2] {
        let (a, b) = pass.packed.split_at(first.packed);
        [PolicyPass { packed: a, ..pass }, PolicyPass { packed: b, ..pass }]
    }
}

impl<A: Policy, B: Policy> Policy for Sum<A, B> {
    fn observation_dim(&self) -> usize {
        self.0.observation_dim()
    }

    fn control_dim(&self) -> usize {
        self.0.control_dim()
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
        Action { u, .. }: Action<'_, T>,
    ) {
        let (a, b) = self.split(theta);
        self.0.act(a, observed, Action { u, memory: &mut [] });
        let mut second: SmallVec<[T; 8]> = smallvec![T::zero(); u.len()];
        self.1.act(b, observed, Action { u: &mut second, memory: &mut [] });
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

    /// `tape` ends with the controls of the second policy. `tape_bar` ends with the cotangents of
    /// the inputs of the second policy.
    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        let [a, b] = self.parts::<F>(columns);
        Sizes {
            packed: a.packed + b.packed,
            tape: a.tape + b.tape + columns * self.control_dim(),
            tape_bar: a.tape_bar + b.tape_bar + columns * self.observation_dim(),
            scratch: a.scratch.max(b.scratch),
        }
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        let (a, b) = self.split(theta);
        let (packed_a, packed_b) = packed.split_at_mut(self.0.sizes::<F>(1).packed);
        self.0.pack(a, packed_a);
        self.1.pack(b, packed_b);
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        let sizes = self.parts_of(&pass);
        let [a, b] = self.passes(pass, &sizes);
        let (tape_a, rest) = tape.split_at_mut(sizes[0].tape);
        let (tape_b, second) = rest.split_at_mut(sizes[1].tape);
        self.0.forward(a, tape_a, u);
        self.1.forward(b, tape_b, second);
        add(pass, self.control_dim(), second, u);
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        mut x_bar: Option<&mut [F]>,
    ) {
        let sizes = self.parts_of(&pass);
        let [a, b] = self.passes(pass, &sizes);
        let (tape_a, tape_b) = tape.split_at(sizes[0].tape);
        let (bar_a, rest) = tape_bar.split_at_mut(sizes[0].tape_bar);
        let (bar_b, second) = rest.split_at_mut(sizes[1].tape_bar);
        self.0.backward(a, tape_a, u_bar, bar_a, x_bar.as_deref_mut());
        self.1.backward(
            b,
            &tape_b[..sizes[1].tape],
            u_bar,
            bar_b,
            x_bar.is_some().then_some(&mut *second),
        );
        if let Some(x_bar) = x_bar {
            add(pass, self.observation_dim(), second, x_bar);
        }
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        let sizes = self.parts_of(&pass);
        let [a, b] = self.passes(pass, &sizes);
        let (tape_a, tape_b) = record.tape.split_at(sizes[0].tape);
        let (bar_a, bar_b) = record.tape_bar.split_at(sizes[0].tape_bar);
        let (theta_a, theta_b) = theta_bar.split_at_mut(self.0.param_count());
        let first = PolicyRecord { tape: tape_a, tape_bar: bar_a, ..record };
        let second = PolicyRecord {
            tape: &tape_b[..sizes[1].tape],
            tape_bar: &bar_b[..sizes[1].tape_bar],
            ..record
        };
        self.0.param_gradient(a, first, scratch, theta_a);
        self.1.param_gradient(b, second, scratch, theta_b);
    }
}

/// Adds the columns `pass.at` of `from` to those of `to`. Each column has `n` numbers.
fn add<F: Float>(pass: PolicyPass<F>, n: usize, from: &[F], to: &mut [F]) {
    for c in pass.at.iter() {
        for (to, &from) in to[c * n..][..n].iter_mut().zip(&from[c * n..][..n]) {
            *to += from;
        }
    }
}
