//! [`Schedule`]: what is kept of a trajectory for the reverse pass, and what is run again.
//!
//! A trajectory is cut into segments. The reverse pass needs the tape of one segment at a time; a segment whose tape is
//! gone is run again from the nearest state before it that was kept, a checkpoint.

mod budget;

pub use budget::MemoryError;

use crate::engine::rollout::UNIT;
use std::ops::Range;

/// What is kept of a trajectory: the tape of one segment, and the states at the start of some segments.
///
/// Gradients have the same bits with every schedule.
///
/// With `s` checkpoints over `l` segments, as many steps are run again as the optimum of Griewank and Walther, "Algorithm
/// 799: revolve", 2000, [doi:10.1145/347837.347846](https://doi.org/10.1145/347837.347846). The first checkpoint is the
/// start state, and the last segment's tape is there when the forward pass ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    horizon: usize,
    segment: usize,
    checkpoints: usize,
}

impl Schedule {
    /// Steps of which segments are whole multiples: parameter gradients are summed over so many steps at a time,
    /// whatever the schedule. Rollouts that are no longer are always kept as a whole.
    pub const UNIT: usize = UNIT;

    /// Segments of so many steps, rounded up to whole units, with at most so many checkpoints.
    ///
    /// # Panics
    /// If a number is 0.
    #[track_caller]
    pub fn new(horizon: usize, segment: usize, checkpoints: usize) -> Self {
        assert!(horizon > 0, "a schedule needs a horizon of at least one step");
        assert!(segment > 0, "a segment needs at least one step");
        assert!(checkpoints > 0, "the start state is a checkpoint: at least 1 is needed");
        let segment = if horizon <= segment { horizon } else { horizon.min(segment.div_ceil(UNIT) * UNIT) };
        // The last segment needs none: it is run but once.
        let useful = horizon.div_ceil(segment) - 1;
        Self { horizon, segment, checkpoints: checkpoints.min(useful) }
    }

    /// Everything: one segment, and nothing is run again.
    #[track_caller]
    pub fn store_all(horizon: usize) -> Self {
        Self::new(horizon, horizon, 1)
    }

    /// Segments of about √horizon steps with a checkpoint each: all but the last are run twice.
    #[track_caller]
    pub fn two_level(horizon: usize) -> Self {
        let segment = (horizon as f64).sqrt() / UNIT as f64;
        Self::new(horizon, (segment.round() as usize).max(1) * UNIT, usize::MAX)
    }

    /// The shortest segments, with so many checkpoints, the start state among them: memory for a given number of repeats
    /// grows slower than any power of the horizon.
    #[track_caller]
    pub fn binomial(horizon: usize, checkpoints: usize) -> Self {
        Self::new(horizon, UNIT, checkpoints)
    }

    /// Steps of the rollout.
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// Steps of a segment; the last may have fewer.
    pub fn segment(&self) -> usize {
        self.segment
    }

    /// States that are kept, of every sample, beside those of one segment; none if that is all there is.
    pub fn checkpoints(&self) -> usize {
        self.checkpoints
    }

    /// Number of segments.
    pub fn segments(&self) -> usize {
        self.horizon.div_ceil(self.segment)
    }

    /// Steps that are run again in a reverse pass, beyond the `horizon` steps of the forward pass.
    pub fn recomputed_steps(&self) -> u64 {
        // The last segment, the only one that may be shorter, is not among them.
        let again = again(self.segments() as u64, self.checkpoints as u64);
        again.saturating_mul(self.segment as u64)
    }

    /// The steps of segment number `index`.
    pub(crate) fn steps(&self, index: usize) -> Range<usize> {
        index * self.segment..self.horizon.min((index + 1) * self.segment)
    }
}

/// β(s, r) = C(s + r, s): the most segments that can be reversed with `s` checkpoints if none is run more than `r` times
/// before its tape is made. Huge ones are cut off.
fn reach(s: u64, r: u64) -> u64 {
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

/// The smallest `r` with β(s, r) ≥ l.
fn repeats(l: u64, s: u64) -> u64 {
    let (mut r, mut reached) = (0, 1);
    while reached < u128::from(l) {
        r += 1;
        reached = reached * (u128::from(s) + r) / r;
    }
    r as u64
}

/// The fewest segments that are run without need of their tape, to reverse `l` of them with `s` checkpoints: as many as
/// are run again in all. `r·l - β(s + 1, r - 1)`, theorem 1 there.
fn again(l: u64, s: u64) -> u64 {
    match repeats(l, s) {
        0 => 0,
        r => (u128::from(r) * u128::from(l)).saturating_sub(reach(s + 1, r - 1).into()).try_into().unwrap_or(u64::MAX),
    }
}

/// How many of `l ≥ 2` segments to run before the next checkpoint, where there is room for `s ≥ 1`, the one at the start of
/// these segments included: any of the best.
pub(crate) fn split(l: usize, s: usize) -> usize {
    if s == 1 {
        return l - 1;
    }
    let (l, s) = (l as u64, s as u64);
    let r = repeats(l, s);
    // What comes first can be run once more than what comes after, which has a checkpoint less.
    reach(s, r - 1).min(l - reach(s - 1, r - 1)) as usize
}
