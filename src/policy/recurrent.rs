//! [`Gru`] and [`Elman`]: recurrent policies with a linear output.
//!
//! Both consist of affine maps `z = W v + b`. `θ` holds for each map the weights (inputs × outputs,
//! row-major), then the bias. [`Cell`] states the equations of one column. The batched passes apply
//! them to blocks of columns in lanes.

use super::blocks::{Lane, gather, scatter};
use super::{Action, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor};
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::pool::lend;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Real, Scalar};
use crate::numbers::zip::zip;
use rand::RngExt;
use smallvec::SmallVec;

/// Dimensions of a recurrent policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    observations: usize,
    units: usize,
    controls: usize,
}

/// Affine map with its parameters from index `first` of `θ`.
#[derive(Clone, Copy)]
struct Affine {
    first: usize,
    inputs: usize,
    outputs: usize,
}

impl Affine {
    fn end(self) -> usize {
        self.first + (self.inputs + 1) * self.outputs
    }

    /// The map whose parameters follow those of this one.
    fn then(self, inputs: usize, outputs: usize) -> Self {
        Self { first: self.end(), inputs, outputs }
    }

    /// Row `i` of the weights. The row after the last one is the bias.
    #[inline(always)]
    fn row<W>(self, theta: &[W], i: usize) -> &[W] {
        &theta[self.first + i * self.outputs..][..self.outputs]
    }

    /// Writes `z = W v + b`. Converts parameters by `splat`.
    #[inline(always)]
    fn evaluate<'a, W: Copy, T: Scalar>(self, theta: &[W], splat: impl Fn(W) -> T, v: impl Iterator<Item = &'a T>, z: &mut [T]) {
        for (z, &bias) in zip(z.iter_mut(), self.row(theta, self.inputs)) {
            *z = splat(bias);
        }
        for (i, &v) in v.enumerate() {
            for (z, &weight) in zip(z.iter_mut(), self.row(theta, i)) {
                *z += v * splat(weight);
            }
        }
    }

    /// Component `i` of `Wᵀ z_bar`.
    #[inline(always)]
    fn input_bar<R: Real>(self, theta: &[R::Real], i: usize, z_bar: &[R]) -> R {
        zip(self.row(theta, i).iter(), z_bar).fold(R::zero(), |sum, (&weight, &bar)| sum + R::splat(weight) * bar)
    }

    /// Adds `factor·v z_barᵀ` to the gradient of the weights, and `factor·z_bar` to that of the
    /// bias.
    fn add_gradient<F: Float>(self, v: impl Iterator<Item = F>, z_bar: &[F], factor: F, theta_bar: &mut [F]) {
        let rows = theta_bar[self.first..self.end()].chunks_exact_mut(self.outputs);
        for (v, row) in v.chain([F::one()]).zip(rows) {
            let scaled = factor * v;
            for (sum, &bar) in zip(row.iter_mut(), z_bar) {
                *sum += scaled * bar;
            }
        }
    }

    /// Draws Glorot-uniform weights and sets the bias to 0 (Glorot and Bengio 2010).
    fn init(self, rng: &mut Rng, theta: &mut [f64]) {
        let limit = (6.0 / (self.inputs + self.outputs) as f64).sqrt();
        let (weights, bias) = theta[self.first..self.end()].split_at_mut(self.inputs * self.outputs);
        weights.fill_with(|| rng.random_range(-limit..limit));
        bias.fill(0.0);
    }

    fn tensors(self, name: &str) -> [Tensor; 2] {
        let bias = self.first + self.inputs * self.outputs;
        [
            Tensor { name: format!("{name}.kernel"), shape: vec![self.inputs, self.outputs], range: self.first..bias },
            Tensor { name: format!("{name}.bias"), shape: vec![self.outputs], range: bias..self.end() },
        ]
    }
}

/// Logistic function `1 / (1 + exp(-z))`, without overflow.
#[inline(always)]
fn logistic<T: Scalar>(z: T) -> T {
    (z * 0.5).tanh() * 0.5 + 0.5
}

/// Elman network: `m' = tanh(W (y, m) + b)`, `u = V m' + c`.
///
/// J. L. Elman, "Finding Structure in Time", Cognitive Science 14 (1990). Initial weights are
/// Glorot-uniform, initial biases 0. The memory is 0 at the start of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Elman(Shape);

/// Gated recurrent unit with a linear output:
///
/// ```text
/// z = σ(W_z (y, m) + b_z)               update gate
/// r = σ(W_r (y, m) + b_r)               reset gate
/// n = tanh(W_n (y, r ⊙ m) + b_n)        candidate
/// m' = (1 - z) ⊙ m + z ⊙ n,    u = V m' + c
/// ```
///
/// K. Cho et al., EMNLP 2014, doi:10.3115/v1/D14-1179, with z and 1 - z exchanged. Initial weights
/// are Glorot-uniform, initial biases 0. The memory is 0 at the start of a rollout.
///
/// ```
/// use physgrad::{check, policy::Gru};
///
/// // From two observed components to one control, with a memory of eight units.
/// check::policy(&Gru::new(2, 8, 1));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gru(Shape);

impl Elman {
    /// A network with `observations` inputs, `units` hidden units and `controls` outputs.
    pub fn new(observations: usize, units: usize, controls: usize) -> Self {
        Self(Shape { observations, units, controls })
    }

    /// The maps to the memory and to the control.
    fn maps(&self) -> [Affine; 2] {
        let Shape { observations, units, controls } = self.0;
        let memory = Affine { first: 0, inputs: observations + units, outputs: units };
        [memory, memory.then(units, controls)]
    }
}

impl Gru {
    /// A network with `observations` inputs, a memory of `units` numbers and `controls` outputs.
    pub fn new(observations: usize, units: usize, controls: usize) -> Self {
        Self(Shape { observations, units, controls })
    }

    /// The maps to the update gate, the reset gate, the candidate and the control.
    fn maps(&self) -> [Affine; 4] {
        let Shape { observations, units, controls } = self.0;
        let update = Affine { first: 0, inputs: observations + units, outputs: units };
        let reset = update.then(observations + units, units);
        let candidate = reset.then(observations + units, units);
        [update, reset, candidate, candidate.then(units, controls)]
    }
}

/// Equations of a recurrent policy for one column, or for one block of columns in lanes.
trait Cell {
    /// Numbers per unit that the forward pass stores. The next memory is the last one.
    const STORED: usize;
    /// Cotangents per unit that the backward pass stores.
    const BARS: usize;

    fn shape(&self) -> Shape;

    /// Writes the stored numbers, `[number][unit]`, and the control.
    fn evaluate<W: Copy, T: Scalar>(
        &self,
        theta: &[W],
        splat: impl Fn(W) -> T + Copy,
        x: (&[T], &[T]),
        stored: &mut [T],
        u: &mut [T],
    );

    /// Writes to `cotangents` the cotangents of the outputs of all affine maps but the last,
    /// `[map][unit]`. Adds those of the observation and the memory to `x_bar`.
    ///
    /// `next_bar` contains the cotangents of the next memory.
    fn reverse<R: Real>(
        &self,
        theta: &[R::Real],
        memory: &[R],
        stored: &[R],
        next_bar: &[R],
        cotangents: &mut [R],
        x_bar: Option<(&mut [R], &mut [R])>,
    );

    /// Adds the parameter gradient of one column.
    fn add_gradient<F: Float>(
        &self,
        x: (&[F], &[F]),
        stored: &[F],
        cotangents: &[F],
        u_bar: &[F],
        factor: F,
        theta_bar: &mut [F],
    );

    /// The map from the next memory to the control.
    fn to_control(&self) -> Affine;
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

impl Cell for Gru {
    /// z, r, n and m'.
    const STORED: usize = 4;
    /// Cotangents of the arguments of z, r and n.
    const BARS: usize = 3;

    fn shape(&self) -> Shape {
        self.0
    }

    #[inline(always)]
    fn evaluate<W: Copy, T: Scalar>(
        &self,
        theta: &[W],
        splat: impl Fn(W) -> T + Copy,
        (y, memory): (&[T], &[T]),
        stored: &mut [T],
        u: &mut [T],
    ) {
        let [to_update, to_reset, to_candidate, to_control] = self.maps();
        let [z, r, n, next] = parts_mut(stored);
        to_update.evaluate(theta, splat, y.iter().chain(memory), z);
        z.iter_mut().for_each(|z| *z = logistic(*z));
        to_reset.evaluate(theta, splat, y.iter().chain(memory), r);
        r.iter_mut().for_each(|r| *r = logistic(*r));
        // The next memory serves as a buffer for r ⊙ m.
        for (kept, (&r, &m)) in zip(next.iter_mut(), zip(r.iter(), memory)) {
            *kept = r * m;
        }
        to_candidate.evaluate(theta, splat, y.iter().chain(&*next), n);
        n.iter_mut().for_each(|n| *n = n.tanh());
        for (next, ((&z, &n), &m)) in zip(next.iter_mut(), zip(zip(z.iter(), &*n), memory)) {
            *next = m + z * (n - m);
        }
        to_control.evaluate(theta, splat, next.iter(), u);
    }

    #[inline(always)]
    fn reverse<R: Real>(
        &self,
        theta: &[R::Real],
        memory: &[R],
        stored: &[R],
        next_bar: &[R],
        cotangents: &mut [R],
        x_bar: Option<(&mut [R], &mut [R])>,
    ) {
        let [to_update, to_reset, to_candidate, _] = self.maps();
        let ([z, r, n, _], observations) = (parts(stored), self.0.observations);
        let [z_bar, r_bar, n_bar] = parts_mut(cotangents);
        for i in 0..memory.len() {
            z_bar[i] = next_bar[i] * (n[i] - memory[i]) * z[i] * (R::one() - z[i]);
            n_bar[i] = next_bar[i] * z[i] * (R::one() - n[i] * n[i]);
        }
        for i in 0..memory.len() {
            let kept_bar = to_candidate.input_bar(theta, observations + i, n_bar);
            r_bar[i] = kept_bar * memory[i] * r[i] * (R::one() - r[i]);
        }
        let Some((y_bar, memory_bar)) = x_bar else { return };
        for (i, bar) in y_bar.iter_mut().enumerate() {
            *bar += to_candidate.input_bar(theta, i, n_bar);
        }
        for (i, bar) in memory_bar.iter_mut().enumerate() {
            *bar += next_bar[i] * (R::one() - z[i]) + to_candidate.input_bar(theta, observations + i, n_bar) * r[i];
        }
        for (i, bar) in y_bar.iter_mut().chain(memory_bar).enumerate() {
            *bar += to_update.input_bar(theta, i, z_bar) + to_reset.input_bar(theta, i, r_bar);
        }
    }

    fn add_gradient<F: Float>(
        &self,
        (y, memory): (&[F], &[F]),
        stored: &[F],
        cotangents: &[F],
        u_bar: &[F],
        factor: F,
        theta_bar: &mut [F],
    ) {
        let [to_update, to_reset, to_candidate, to_control] = self.maps();
        let ([_, r, _, next], [z_bar, r_bar, n_bar]) = (parts(stored), parts(cotangents));
        to_update.add_gradient(y.iter().chain(memory).copied(), z_bar, factor, theta_bar);
        to_reset.add_gradient(y.iter().chain(memory).copied(), r_bar, factor, theta_bar);
        let kept = zip(r.iter(), memory).map(|(&r, &m)| r * m);
        to_candidate.add_gradient(y.iter().copied().chain(kept), n_bar, factor, theta_bar);
        to_control.add_gradient(next.iter().copied(), u_bar, factor, theta_bar);
    }

    fn to_control(&self) -> Affine {
        self.maps()[3]
    }
}

/// Splits a column into `K` parts of equal length.
fn parts<T, const K: usize>(column: &[T]) -> [&[T]; K] {
    let units = column.len() / K;
    std::array::from_fn(|i| &column[i * units..][..units])
}

/// As [`parts`], mutable.
fn parts_mut<T, const K: usize>(column: &mut [T]) -> [&mut [T]; K] {
    let mut parts = column.chunks_exact_mut(column.len() / K);
    std::array::from_fn(|_| parts.next().unwrap_or_default())
}

/// Forward pass of [`Policy::forward`].
struct Forward<'a, C, F> {
    cell: &'a C,
    pass: PolicyPass<'a, F>,
    tape: &'a mut [F],
    u: &'a mut [F],
    buffers: &'a mut [Vec<Lane<F>>; 3],
}

impl<C: Cell, F: Float> Vectorized for Forward<'_, C, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { cell, pass, tape, u, buffers: [x, stored, outputs] } = self;
        let Shape { observations, units, controls } = cell.shape();
        stored.resize(units * C::STORED, Lane::zero());
        outputs.resize(controls + units, Lane::zero());
        for (_, at) in pass.blocks() {
            gather(pass.x, observations + units, at, x);
            cell.evaluate(pass.packed, Real::splat, x.split_at(observations), stored, &mut outputs[..controls]);
            outputs[controls..].copy_from_slice(&stored[units * (C::STORED - 1)..]);
            scatter(stored, at, tape);
            scatter(outputs, at, u);
        }
    }
}

/// Backward pass of [`Policy::backward`].
struct Backward<'a, C, F> {
    cell: &'a C,
    pass: PolicyPass<'a, F>,
    tape: &'a [F],
    u_bar: &'a [F],
    tape_bar: &'a mut [F],
    x_bar: Option<&'a mut [F]>,
    buffers: &'a mut [Vec<Lane<F>>; 5],
}

impl<C: Cell, F: Float> Vectorized for Backward<'_, C, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { cell, pass, tape, u_bar, tape_bar, mut x_bar, buffers } = self;
        let Shape { observations, units, controls } = cell.shape();
        let (inputs, to_control) = (observations + units, cell.to_control());
        let [x, stored, outputs_bar, cotangents, inputs_bar] = buffers;
        cotangents.resize(units * C::BARS, Lane::zero());
        inputs_bar.resize(inputs, Lane::zero());
        for (_, at) in pass.blocks() {
            gather(pass.x, inputs, at, x);
            gather(tape, units * C::STORED, at, stored);
            gather(u_bar, controls + units, at, outputs_bar);
            let (u_bar, next_bar) = outputs_bar.split_at_mut(controls);
            for (i, bar) in next_bar.iter_mut().enumerate() {
                *bar += to_control.input_bar(pass.packed, i, u_bar);
            }
            inputs_bar.fill(Lane::zero());
            let requested = x_bar.is_some().then(|| inputs_bar.split_at_mut(observations));
            cell.reverse(pass.packed, &x[observations..], stored, next_bar, cotangents, requested);
            scatter(cotangents, at, tape_bar);
            if let Some(x_bar) = &mut x_bar {
                scatter(inputs_bar, at, x_bar);
            }
        }
    }
}

/// Implements [`Policy`] by a [`Cell`], with the names of its affine maps.
macro_rules! recurrent {
    ($cell:ty, $names:expr) => {
        impl Policy for $cell {
            fn observation_dim(&self) -> usize {
                self.0.observations
            }

            fn control_dim(&self) -> usize {
                self.0.controls
            }

            fn memory_dim(&self) -> usize {
                self.0.units
            }

            fn param_count(&self) -> usize {
                self.to_control().end()
            }

            fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
                self.maps().into_iter().for_each(|map| map.init(rng, theta));
            }

            fn act<T: Scalar>(&self, theta: &[T], Observed { y, memory, .. }: Observed<'_, T>, action: Action<'_, T>) {
                let units = self.0.units;
                let mut stored: SmallVec<[T; 32]> = SmallVec::from_elem(T::zero(), units * Self::STORED);
                self.evaluate(theta, |theta| theta, (y, memory), &mut stored, action.u);
                action.memory.copy_from_slice(&stored[units * (Self::STORED - 1)..]);
            }

            fn tensors(&self) -> Vec<Tensor> {
                self.maps().into_iter().zip($names).flat_map(|(map, name)| map.tensors(name)).collect()
            }

            fn sizes<F: Float>(&self, columns: usize) -> Sizes {
                let tape = columns * self.0.units;
                Sizes { packed: self.param_count(), tape: tape * Self::STORED, tape_bar: tape * Self::BARS, scratch: 0 }
            }

            fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
                lend(|buffers| dispatch_lanes(Forward { cell: self, pass, tape, u, buffers }));
            }

            fn backward<F: Float>(
                &self,
                pass: PolicyPass<F>,
                tape: &[F],
                u_bar: &[F],
                tape_bar: &mut [F],
                x_bar: Option<&mut [F]>,
            ) {
                lend(|buffers| dispatch_lanes(Backward { cell: self, pass, tape, u_bar, tape_bar, x_bar, buffers }));
            }

            fn param_gradient<F: Float>(
                &self,
                pass: PolicyPass<F>,
                record: PolicyRecord<F>,
                _scratch: &mut [F],
                theta_bar: &mut [F],
            ) {
                let Shape { observations, units, controls } = self.0;
                for c in pass.at.iter() {
                    let x = &pass.x[c * (observations + units)..][..observations + units];
                    let stored = &record.tape[c * units * Self::STORED..][..units * Self::STORED];
                    let cotangents = &record.tape_bar[c * units * Self::BARS..][..units * Self::BARS];
                    let u_bar = &record.u_bar[c * (controls + units)..][..controls];
                    let factor = record.weight.map_or(F::one(), |weight| weight[c]);
                    self.add_gradient(x.split_at(observations), stored, cotangents, u_bar, factor, theta_bar);
                }
            }
        }
    };
}

recurrent!(Elman, ["memory", "output"]);
recurrent!(Gru, ["update", "reset", "candidate", "output"]);
