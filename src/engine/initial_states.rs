//! [`initial_states`]: the initial states and parameters of a data set.

use crate::dynamics::inputs::Start;
use crate::engine::any::AnyTask;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::Float;

/// Draws the initial states of samples `0 .. samples`: for each sample, `state_dim` numbers, then its
/// `param_dim` parameters.
///
/// Each sample has its own random stream, determined by `seed`, `purpose` and its index. Its numbers
/// are therefore independent of the number of samples.
/// ```
/// use physgrad::{initial_states, rng::Purpose, tasks::CartPole};
///
/// let starts: Vec<f64> = initial_states(&CartPole::new(1), 0, Purpose::Train, 8);
/// assert_eq!(starts.len(), 8 * 4);
/// ```
pub fn initial_states<F: Float>(task: &dyn AnyTask<F>, seed: u64, purpose: Purpose, samples: usize) -> Vec<F> {
    let (n, len) = (task.state_dim(), task.start_dim());
    let (mut one, mut all) = (vec![0.0; len], Vec::with_capacity(samples * len));
    for sample in 0..samples {
        one.fill(0.0);
        let (x, p) = one.split_at_mut(n);
        task.start(&mut stream(seed, purpose, sample as u64), Start { x, p });
        all.extend(one.iter().map(|&x| F::lift(x)));
    }
    all
}
