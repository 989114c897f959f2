//! [`Schedule`]: stored and recomputed steps of a trajectory.
//!
//! A trajectory is cut into segments. The reverse pass needs the tape of one segment at a time. A
//! segment without a tape is recomputed from the nearest stored state before it, its checkpoint.

mod budget;

pub use budget::MemoryError;

use crate::engine::rollout::UNIT;
use std::ops::Range;

/// Checkpointing schedule: stores the tape of one segment, and the states at the start of some
/// segments.
///
/// All schedules yield bitwise equal gradients.
///
/// With `s` checkpoints over `l` segments, the number of recomputed segments is the optimum of
/// Griewank and Walther, "Algorithm 799: revolve", 2000,
/// [doi:10.1145/347837.347846](https://doi.org/10.1145/347837.347846). The first checkpoint is the
/// initial state. The forward pass leaves the tape of the last segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    horizon: usize,
    segment: usize,
    checkpoints: usize,
}

impl Schedule {
    /// Number of steps in a unit. All segments but the last consist of whole units.
    ///
    /// All schedules sum the parameter gradient over one unit at a time, so their gradients are
    /// bitwise equal. Rollouts of at most one unit are always stored completely.
    pub const UNIT: usize = UNIT;

    /// Creates a schedule with segments of `segment` steps, rounded up to whole units and limited
    /// to the horizon.
    ///
    /// `checkpoints` is an upper bound on the number of checkpoints.
    ///
    /// # Panics
    /// If an argument is 0.
    #[track_caller]
    pub fn new(horizon: usize, segment: usize, checkpoints: usize) -> Self {
        assert!(horizon > 0, "a schedule needs a horizon of at least one step");
        assert!(segment > 0, "a segment needs at least one step");
        assert!(checkpoints > 0, "a schedule needs at least one checkpoint, the initial state");
        let segment =
            if horizon <= segment { horizon } else { horizon.min(segment.div_ceil(UNIT) * UNIT) };
        // The last segment needs no checkpoint: it is never recomputed.
        let useful = horizon.div_ceil(segment) - 1;
        Self { horizon, segment, checkpoints: checkpoints.min(useful) }
    }

    /// Stores everything: one segment, no recomputation.
    ///
    /// # Panics
    /// If `horizon` is 0.
    #[track_caller]
    pub fn store_all(horizon: usize) -> Self {
        Self::new(horizon, horizon, 1)
    }

    /// Uses segments of about √horizon steps, rounded to whole units, and of at least one unit.
    ///
    /// Every segment except the last has a checkpoint and is recomputed once.
    ///
    /// # Panics
    /// If `horizon` is 0.
    #[track_caller]
    pub fn two_level(horizon: usize) -> Self {
        let segment = (horizon as f64).sqrt() / UNIT as f64;
        Self::new(horizon, (segment.round() as usize).max(1) * UNIT, usize::MAX)
    }

    /// Uses the shortest segments and at most `checkpoints` checkpoints, including the initial
    /// state.
    ///
    /// If each step is recomputed at most `r` times, memory grows as the `r`-th root of the
    /// horizon.
    ///
    /// # Panics
    /// If an argument is 0.
    #[track_caller]
    pub fn binomial(horizon: usize, checkpoints: usize) -> Self {
        Self::new(horizon, UNIT, checkpoints)
    }

    /// Number of steps of the rollout.
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// Number of steps of a segment. The last segment may be shorter.
    pub fn segment(&self) -> usize {
        self.segment
    }

    /// Number of states stored per sample in addition to one segment. 0 if there is only one
    /// segment.
    pub fn checkpoints(&self) -> usize {
        self.checkpoints
    }

    /// Number of segments.
    pub fn segments(&self) -> usize {
        self.horizon.div_ceil(self.segment)
    }

    /// Number of steps recomputed in the reverse pass, beyond the `horizon` steps of the forward
    /// pass.
    pub fn recomputed_steps(&self) -> u64 {
        // The last segment is never recomputed. All others have full length.
        let again = again(self.segments() as u64, self.checkpoints as u64);
        again.saturating_mul(self.segment as u64)
    }

    /// Steps of segment `index`.
    pub(crate) fn steps(&self, index: usize) -> Range<usize> {
        index * self.segment..self.horizon.min((index + 1) * self.segment)
    }
}

/// Returns β(s, r) = C(s + r, s), saturating at 2^62.
///
/// β is the largest number of segments that can be reversed with `s` checkpoints, if each segment
/// is recomputed at most `r` times.
fn reach(s: u64, r: u64) -> u64 {
    /// Saturation value.
    const HUGE: u128 = 1 << 62;
    let (few, many) = (s.min(r) as u128, s.max(r) as u128);
    let mut product = 1u128;
    for i in 1..=few {
        product = product * (many + i) / i;
        if product > HUGE {
            return HUGE as u64;
        }
    }
    product as u64
}

/// Returns the smallest `r` with β(s, r) ≥ l.
fn repeats(l: u64, s: u64) -> u64 {
    let (mut r, mut reached) = (0, 1);
    while reached < u128::from(l) {
        r += 1;
        reached = reached * (u128::from(s) + r) / r;
    }
    r as u64
}

/// Returns the smallest number of recomputed segments to reverse `l` segments with `s` checkpoints.
///
/// The result is `r·l - β(s + 1, r - 1)`, theorem 1 of Griewank and Walther 2000.
fn again(l: u64, s: u64) -> u64 {
    match repeats(l, s) {
        0 => 0,
        r => (u128::from(r) * u128::from(l))
            .saturating_sub(reach(s + 1, r - 1).into())
            .try_into()
            .unwrap_or(u64::MAX),
    }
}

/// Returns an optimal number of segments to run before the next checkpoint.
///
/// `l ≥ 2` segments remain. `s ≥ 1` checkpoints are available, including the checkpoint at the
/// start of the remaining segments.
pub(crate) fn split(l: usize, s: usize) -> usize {
    if s == 1 {
        return l - 1;
    }
    let (l, s) = (l as u64, s as u64);
    let r = repeats(l, s);
    // An optimal split leaves at most β(s, r - 1) segments before the next checkpoint, and at least
    // β(s - 1, r - 1) segments after it.
    reach(s, r - 1).min(l - reach(s - 1, r - 1)) as usize
}
