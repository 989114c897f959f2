//! [`initial_states`]: the initial states and parameters of a data set.

use crate::engine::any::AnyTask;
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::numbers::scalar::Float;
use std::ops::Range;

/// Draws the initial states of samples `0 .. samples`: for each sample, `state_dim` numbers, then
/// its `param_dim` parameters. The task draws both. Then each physical number that varies is drawn.
/// The drawn value replaces the entry of this number in the parameters. A task with
/// [`Noise`](crate::number::Noise) has one more number per sample, the key of its noise.
///
/// Each sample has its own random stream, determined by `seed`, `purpose` and its index. A sample
/// is therefore independent of the number of samples.
/// ```
/// use physgrad::{initial_states, rng::Purpose, tasks::CartPole};
///
/// let starts: Vec<f64> = initial_states(&CartPole::new(1), 0, Purpose::Train, 8);
/// assert_eq!(starts.len(), 8 * 4);
/// ```
pub fn initial_states<F: Float>(
    task: &dyn AnyTask<F>,
    seed: u64,
    purpose: Purpose,
    samples: usize,
) -> Vec<F> {
    let mut all = Vec::with_capacity(samples * task.start_dim());
    append_starts(task, seed, purpose, 0..samples, &mut all);
    all
}

/// Appends the [`initial_states`] of these samples.
#[inline(never)]
pub fn append_starts<F: Float>(
    task: &dyn AnyTask<F>,
    seed: u64,
    purpose: Purpose,
    samples: Range<usize>,
    all: &mut Vec<F>,
) {
    let mut one = vec![0.0; task.start_dim()];
    for sample in samples {
        append_start(task, &mut stream(seed, purpose, sample as u64), &mut one, all);
    }
}

/// Draws one sample from its stream and appends it. `one` is a buffer of `start_dim` numbers.
pub(crate) fn append_start<F: Float>(
    task: &dyn AnyTask<F>,
    rng: &mut Rng,
    one: &mut [f64],
    all: &mut Vec<F>,
) {
    one.fill(0.0);
    task.draw(rng, one);
    all.extend(one.iter().map(|&x| F::from_f64(x)));
}
