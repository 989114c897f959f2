//! [`initial_states`]: the initial states of a data set.

use crate::engine::any::AnyTask;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::Float;

/// Draws the initial states of samples `0 .. samples`, `state_dim` numbers each.
///
/// Each sample has its own random stream, determined by `seed`, `purpose` and its index. The
/// initial state of a sample is therefore independent of the number of samples.
/// ```
/// use physgrad::{initial_states, rng::Purpose, tasks::CartPole};
///
/// let starts: Vec<f64> = initial_states(&CartPole::new(1), 0, Purpose::Train, 8);
/// assert_eq!(starts.len(), 8 * 4);
/// ```
pub fn initial_states<F: Float>(task: &dyn AnyTask<F>, seed: u64, purpose: Purpose, samples: usize) -> Vec<F> {
    let mut x = vec![0.0; task.state_dim()];
    let mut all = Vec::with_capacity(samples * x.len());
    for sample in 0..samples {
        x.fill(0.0);
        task.start(&mut stream(seed, purpose, sample as u64), &mut x);
        all.extend(x.iter().map(|&x| F::lift(x)));
    }
    all
}
