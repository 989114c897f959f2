//! [`Gru`]: gated recurrent unit.

use super::affine::Affine;
use super::{Cell, Shape};
use crate::numbers::scalar::{Float, Real, Scalar};
use crate::numbers::zip::zip;

/// Gated recurrent unit with a linear output. σ is the logistic function, and ⊙ is the elementwise
/// product:
///
/// ```text
/// z = σ(W_z (y, m) + b_z)               update gate
/// r = σ(W_r (y, m) + b_r)               reset gate
/// n = tanh(W_n (y, r ⊙ m) + b_n)        candidate
/// m' = (1 - z) ⊙ m + z ⊙ n,    u = V m' + c
/// ```
///
/// y is the observation, m the memory, m' the next memory, and u the control.
///
/// K. Cho et al., EMNLP 2014, doi:10.3115/v1/D14-1179, with z and 1 - z exchanged. Initial weights
/// are Glorot-uniform, initial biases 0. The memory is 0 at the start of a rollout.
///
/// ```
/// use physgrad::{check, policy::Gru};
///
/// // From two observed components to one control, with a memory of eight units.
/// check::policy(&Gru::new(2, 8, 1)).unwrap();
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gru(pub(super) Shape);

impl Gru {
    /// A network with `observations` inputs, a memory of `units` numbers and `controls` outputs.
    ///
    /// # Panics
    /// If `units` is 0.
    #[track_caller]
    pub fn new(observations: usize, units: usize, controls: usize) -> Self {
        Self(Shape::new(observations, units, controls))
    }

    /// The maps to the update gate, the reset gate, the candidate and the control.
    pub(super) fn maps(&self) -> [Affine; 4] {
        let Shape { observations, units, controls } = self.0;
        let update = Affine { first: 0, inputs: observations + units, outputs: units };
        let reset = update.then(observations + units, units);
        let candidate = reset.then(observations + units, units);
        [update, reset, candidate, candidate.then(units, controls)]
    }
}

impl Cell for Gru {
    /// The numbers z, r, n and m'.
    const STORED: usize = 4;
    /// Cotangents of the arguments of σ in z, of σ in r, and of tanh in n.
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
        mut x_bar: Option<(&mut [R], &mut [R])>,
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
            if let Some((_, memory_bar)) = &mut x_bar {
                memory_bar[i] += next_bar[i] * (R::one() - z[i]) + kept_bar * r[i];
            }
        }
        let Some((y_bar, memory_bar)) = x_bar else { return };
        for (i, bar) in y_bar.iter_mut().enumerate() {
            *bar += to_candidate.input_bar(theta, i, n_bar);
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

/// Mutable [`parts`].
fn parts_mut<T, const K: usize>(column: &mut [T]) -> [&mut [T]; K] {
    let mut parts = column.chunks_exact_mut(column.len() / K);
    std::array::from_fn(|_| parts.next().unwrap_or_default())
}

/// Logistic function `1 / (1 + exp(-z))`, without overflow.
#[inline(always)]
fn logistic<T: Scalar>(z: T) -> T {
    (z * 0.5).tanh() * 0.5 + 0.5
}
