//! Rollouts with given controls, one sequence for each sample: [`states`] and [`states_vjp`].
//!
//! `starts` has the layout of [`initial_states`](crate::initial_states). States and controls have
//! the layout `[sample][step][component]`, with one state more than controls.
//! ```
//! use physgrad::{engine::open_loop, initial_states, rng::Purpose, tasks::CartPole};
//!
//! let task = CartPole::new(1);
//! let starts: Vec<f64> = initial_states(&task, 0, Purpose::Train, 3);
//! let controls = [0.5; 3 * 10];
//! let states = open_loop::states(&task, &starts, &controls, 10);
//! // The gradient of the sum of the last positions of the cart.
//! let mut states_bar = vec![0.0; states.len()];
//! states_bar.chunks_mut(11 * 4).for_each(|sample| sample[10 * 4] = 1.0);
//! let [starts_bar, controls_bar] = open_loop::states_vjp(&task, &starts, &controls, &states, &states_bar);
//! assert_eq!([starts_bar.len(), controls_bar.len()], [starts.len(), controls.len()]);
//! ```

use crate::dynamics::inputs::Inputs;
use crate::dynamics::number::NoiseNumbers;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::rows;
use crate::numbers::scalar::Float;

/// States of rollouts of `steps` steps from `starts`, with these controls. Numbers that are not
/// finite stay in the result.
///
/// # Panics
/// If `starts` is not a whole number of initial states, or `controls` are not those of its samples.
#[track_caller]
#[inline(never)]
pub fn states<F: Float, T: Task>(task: &T, starts: &[F], controls: &[F], steps: usize) -> Vec<F> {
    let sizes = Sizes::new(task, starts);
    let Sizes { samples, n, m, .. } = sizes;
    assert_eq!(controls.len(), samples * steps * m, "the number of controls");
    let (all, played) = (Steps::new(n, steps + 1), Steps::new(m, steps));
    let mut states = vec![F::zero(); samples * (steps + 1) * n];
    let [mut x, mut next] = [vec![F::zero(); samples * n], vec![F::zero(); samples * n]];
    let mut u = vec![F::zero(); samples * m];
    let mut p = vec![F::zero(); samples * sizes.params];
    Steps::new(sizes.width, 1).read(starts, 0, n, &mut x);
    all.write(&x, 0, &mut states);
    for t in 0..steps {
        played.read(controls, t, m, &mut u);
        sizes.write_params(starts, t, &mut p);
        rows::step(task, Inputs { x: &x, u: &u, p: &p, t }, &mut next);
        all.write(&next, t + 1, &mut states);
        std::mem::swap(&mut x, &mut next);
    }
    states
}

/// The products of `states_bar` with the transposed Jacobian of [`states`]: cotangents of `starts`
/// and of `controls`. `states` is the result of these arguments. Noise and its keys have
/// the cotangent 0.
///
/// # Panics
/// As [`states`], or if `states` and `states_bar` are not those of its samples.
#[track_caller]
#[inline(never)]
pub fn states_vjp<F: Float, T: Task>(
    task: &T,
    starts: &[F],
    controls: &[F],
    states: &[F],
    states_bar: &[F],
) -> [Vec<F>; 2] {
    let sizes = Sizes::new(task, starts);
    let Sizes { samples, n, m, params, width, .. } = sizes;
    let mut starts_bar = vec![F::zero(); starts.len()];
    let mut controls_bar = vec![F::zero(); controls.len()];
    let steps = (states.len() / (samples * n).max(1)).saturating_sub(1);
    assert_eq!(states.len(), states_bar.len(), "the number of cotangents");
    assert_eq!(controls.len(), samples * steps * m, "the number of controls");
    let (all, played) = (Steps::new(n, steps + 1), Steps::new(m, steps));
    let zeros = |width: usize| vec![F::zero(); samples * width];
    let [mut x, mut lambda, mut x_bar, mut more] = [n; 4].map(zeros);
    let ([mut u, mut u_bar], [mut p, mut p_bar, mut p_sum]) =
        ([m; 2].map(zeros), [params; 3].map(zeros));
    all.read(states_bar, steps, n, &mut lambda);
    for t in (0..steps).rev() {
        all.read(states, t, n, &mut x);
        played.read(controls, t, m, &mut u);
        sizes.write_params(starts, t, &mut p);
        let inputs = Inputs { x: &x, u: &u, p: &p, t };
        rows::step_vjp(task, inputs, &lambda, [&mut x_bar, &mut u_bar, &mut p_bar]);
        played.write(&u_bar, t, &mut controls_bar);
        p_sum.iter_mut().zip(&p_bar).for_each(|(sum, &bar)| *sum += bar);
        all.read(states_bar, t, n, &mut more);
        for ((lambda, &bar), &more) in lambda.iter_mut().zip(&x_bar).zip(&more) {
            *lambda = bar + more;
        }
    }
    for (sample, start) in starts_bar.chunks_exact_mut(width).enumerate() {
        start[..n].copy_from_slice(&lambda[sample * n..][..n]);
        start[n..][..params].copy_from_slice(&p_sum[sample * params..][..params]);
        // The rollout replaces these numbers.
        sizes.noise.at(0.0, 0, |i, _| start[n + i] = F::zero());
    }
    [starts_bar, controls_bar]
}

/// Sizes of the initial states of a task.
struct Sizes {
    samples: usize,
    n: usize,
    m: usize,
    params: usize,
    /// Numbers of one initial state.
    width: usize,
    noise: NoiseNumbers,
}

impl Sizes {
    #[track_caller]
    fn new<F>(task: &impl Task, starts: &[F]) -> Self {
        let (n, m, params) =
            (task.system().state_dim(), task.system().control_dim(), task.param_dim());
        let noise = NoiseNumbers::of(&task.system().varied(params));
        let width = n + params + noise.key_dim();
        let samples = starts.len() / width;
        assert_eq!(starts.len(), samples * width, "the number of numbers in `starts`");
        Self { samples, n, m, params, width, noise }
    }

    /// Writes the parameters of all samples at step `t`.
    fn write_params<F: Float>(&self, starts: &[F], t: usize, p: &mut [F]) {
        if self.params == 0 {
            return;
        }
        for (start, p) in starts.chunks_exact(self.width).zip(p.chunks_exact_mut(self.params)) {
            p.copy_from_slice(&start[self.n..][..self.params]);
            if !self.noise.is_empty() {
                self.noise.at(start[self.width - 1].as_(), t, |i, value| p[i] = F::from_f64(value));
            }
        }
    }
}

/// Layout of an array `[sample][step][component]`.
struct Steps {
    width: usize,
    each: usize,
}

impl Steps {
    fn new(width: usize, steps: usize) -> Self {
        Self { width, each: width * steps }
    }

    /// Copies the first `count` components of step `t` of all samples.
    fn read<F: Copy>(&self, array: &[F], t: usize, count: usize, rows: &mut [F]) {
        if count > 0 {
            let samples = array.chunks_exact(self.each);
            for (row, sample) in rows.chunks_exact_mut(count).zip(samples) {
                row.copy_from_slice(&sample[t * self.width..][..count]);
            }
        }
    }

    /// Writes step `t` of all samples.
    fn write<F: Copy>(&self, rows: &[F], t: usize, array: &mut [F]) {
        if self.width > 0 {
            let samples = array.chunks_exact_mut(self.each);
            for (row, sample) in rows.chunks_exact(self.width).zip(samples) {
                sample[t * self.width..][..self.width].copy_from_slice(row);
            }
        }
    }
}
