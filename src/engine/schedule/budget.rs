//! Choice of a [`Schedule`] within a memory limit.

use super::Schedule;
use crate::engine::rollout::UNIT;

/// Error: no schedule fits the memory limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{budget} bytes are not enough for the gradients: at least {smallest} are needed, and {everything} to recompute no step. \
     Raise the budget, use fewer threads, or choose a shorter horizon, a smaller mini-batch or a smaller policy"
)]
pub struct MemoryError {
    /// Memory limit in bytes.
    pub budget: u64,
    /// Smallest sufficient limit in bytes.
    pub smallest: u64,
    /// Smallest limit in bytes without recomputation.
    pub everything: u64,
}

/// Tolerance on recomputed steps: the horizon divided by this number.
///
/// Within the tolerance, the schedule with the smaller tape is faster: the tape stays in the cache.
const TOLERANCE: u64 = 100;

impl Schedule {
    /// Finds a schedule with few recomputed steps within `budget` bytes.
    ///
    /// Stores all steps if they fit. Otherwise, considers each segment length with as many
    /// checkpoints as fit. Returns the smallest of these schedules whose recomputed steps exceed
    /// the minimum within the budget by at most 1 % of the horizon. `bytes` returns the size of a
    /// schedule.
    pub(crate) fn within(
        horizon: usize,
        budget: u64,
        bytes: impl Fn(&Self) -> usize,
    ) -> Result<Self, MemoryError> {
        let bytes = |schedule: &Self| bytes(schedule) as u64;
        let all = Self::store_all(horizon);
        if bytes(&all) <= budget {
            return Ok(all);
        }
        // Sizes increase with the segment length, and linearly with the number of checkpoints.
        let fitting = (1..horizon.div_ceil(UNIT))
            .map(|units| Self::new(horizon, units * UNIT, 1))
            .map(|schedule| (schedule, bytes(&schedule)))
            .take_while(|&(_, least)| least <= budget)
            .map(|(schedule, least)| {
                let one_more =
                    bytes(&Self { checkpoints: schedule.checkpoints + 1, ..schedule }) - least;
                let more = ((budget - least) / one_more).min(schedule.segments() as u64);
                Self::new(horizon, schedule.segment, schedule.checkpoints + more as usize)
            });
        let fitting: Vec<_> =
            fitting.map(|schedule| (schedule.recomputed_steps(), schedule)).collect();
        let fewest = fitting.iter().map(|&(again, _)| again).min().unwrap_or(0);
        let hardly_more = fitting
            .iter()
            .filter(|&&(again, _)| again <= fewest.saturating_add(horizon as u64 / TOLERANCE));
        let best = hardly_more.min_by_key(|(again, schedule)| (bytes(schedule), *again));
        best.map(|&(_, schedule)| schedule).ok_or_else(|| {
            let smallest = bytes(&Self::binomial(horizon, 1)).min(bytes(&all));
            MemoryError { budget, smallest, everything: bytes(&all) }
        })
    }
}
