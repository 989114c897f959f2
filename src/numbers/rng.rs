//! Random numbers that are the same on every machine: one PCG stream for every (seed, purpose, index).

use rand::SeedableRng;

/// The generator that [`Task::start`](crate::Task::start) and [`Policy::init`](crate::Policy::init) draw from.
pub type Rng = rand_pcg::Pcg64Mcg;

/// What a stream of random numbers is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Start states to train on.
    Train = 1,
    /// Start states to test on.
    Test = 2,
    /// Initial parameters of the policy.
    Policy = 3,
    /// Order of the mini-batches.
    Shuffle = 4,
    /// Random inputs and directions of gradient checks.
    Check = 5,
}

/// The stream of one (seed, purpose, index): sample 7 is the same whether 8 or 256 samples are drawn.
pub fn stream(seed: u64, purpose: Purpose, index: u64) -> Rng {
    let mut state = seed;
    for word in [purpose as u64, index] {
        state = mix(state ^ mix(word));
    }
    Rng::seed_from_u64(state)
}

/// SplitMix64's output function (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195).
fn mix(word: u64) -> u64 {
    let z = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
