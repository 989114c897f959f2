//! Reproducible random numbers: one PCG stream per (seed, purpose, index), equal on all machines.

use rand::SeedableRng;

/// Generator for [`Task::start`](crate::Task::start) and [`Policy::init`](crate::Policy::init).
pub type Rng = rand_pcg::Pcg64Mcg;

/// Purpose of a random stream. Streams of different purposes are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Initial states and parameters of training samples.
    Train = 1,
    /// Initial states and parameters of the test set.
    Test = 2,
    /// Initial parameters of the policy.
    Policy = 3,
    /// Order of the training samples.
    Shuffle = 4,
    /// Random inputs, parameters and directions of checks, and damaged inputs of tests.
    Check = 5,
    /// Initial states and parameters of an evaluation. No training draws from these streams.
    Evaluate = 6,
    /// Resamples of a bootstrap interval.
    Bootstrap = 8,
    /// Perturbations of the parameters in updates with smoothing.
    Perturb = 9,
    /// Noise in the steps of rollouts.
    Noise = 10,
    /// Initial parameters of a value function, and the order of its samples.
    Value = 11,
}

/// Returns the stream of one (seed, purpose, index).
///
/// A stream per sample makes the draws of a sample independent of the number of samples.
pub fn stream(seed: u64, purpose: Purpose, index: u64) -> Rng {
    let mut state = seed;
    for word in [purpose as u64, index] {
        state = mix(state ^ mix(word));
    }
    Rng::seed_from_u64(state)
}

/// Output function of SplitMix64 (Steele, Lea and Flood 2014, doi:10.1145/2660193.2660195).
fn mix(word: u64) -> u64 {
    let z = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
