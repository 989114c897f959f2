//! [`Noise`]: a number that is drawn anew during a rollout, and [`NoiseNumbers`], those of a task.

use super::{Number, Varied};
use crate::numbers::rng::{Purpose, Rng, stream};
use rand::RngExt as _;
use rand_distr::{Distribution as _, StandardNormal};

/// Normal noise: a number that is drawn anew every `hold` steps, for each sample.
///
/// Values depend only on the key of the sample and on the step, so every pass through a rollout sees
/// the same values. They are independent of each other, and not truncated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
    /// Number of successive steps with the same value, at least 1.
    pub hold: usize,
}

impl Noise {
    /// Value at step `t` of the sample with this key, for the noise at this index of `p`.
    fn value(&self, key: u32, index: usize, t: usize) -> f64 {
        let draw = ((index as u64) << 40) | (t / self.hold.max(1)) as u64;
        let normal: f64 = StandardNormal.sample(&mut stream(key.into(), Purpose::Noise, draw));
        self.mean + self.deviation * normal
    }
}

/// Noise of a task, with the entries of `p` that hold its values.
///
/// An initial state of a task with noise ends with a key, a whole number below 2²⁴, which `f32` and
/// `f64` represent exactly. The entries of noise among its parameters are the means.
#[derive(Clone, Debug, Default)]
pub struct NoiseNumbers(Vec<(usize, Noise)>);

impl NoiseNumbers {
    /// The noise among these numbers.
    pub fn of(varied: &[Varied]) -> Self {
        let noise = |varied: &Varied| match varied.number {
            Number::Noise(noise) => Some((varied.index, noise)),
            _ => None,
        };
        Self(varied.iter().filter_map(noise).collect())
    }

    /// Returns whether there is no noise.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Count of numbers that the noise adds to an initial state: its key, if there is noise.
    pub fn key_dim(&self) -> usize {
        usize::from(!self.is_empty())
    }

    /// Calls `set` with the index in `p` and the value at step `t` of each noise, for the sample
    /// with this key.
    pub fn at(&self, key: f64, t: usize, mut set: impl FnMut(usize, f64)) {
        for &(index, noise) in &self.0 {
            set(index, noise.value(key as u32, index, t));
        }
    }

    /// Bytes on the heap.
    pub(crate) fn stored_bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }
}

/// Draws a key.
pub(crate) fn draw_key(rng: &mut Rng) -> f64 {
    f64::from(rng.random::<u32>() >> 8)
}

/// Key of the same sample in another epoch.
pub(crate) fn key_of_epoch(key: f64, epoch: u64) -> f64 {
    draw_key(&mut stream(key as u64, Purpose::Noise, !epoch))
}
