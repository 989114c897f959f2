//! The schedule that a number of bytes allows.

use super::Schedule;
use crate::engine::rollout::UNIT;

/// No schedule needs as little memory as was allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{budget} bytes are not enough for the gradients: at least {smallest} are needed, and {everything} to run no step twice. \
     Smaller mini-batches and a smaller policy need less"
)]
pub struct MemoryError {
    /// The bytes that were allowed.
    pub budget: u64,
    /// The smallest budget that would do.
    pub smallest: u64,
    /// The smallest budget with which no step is run twice.
    pub everything: u64,
}

/// A tape that stays in the cache is worth a few steps more: of schedules whose steps differ by less than one part in so
/// many of the horizon, the smaller is the faster.
const SAME: u64 = 100;

impl Schedule {
    /// The schedule that runs the fewest steps again among those that take at most `budget` bytes; of those that run hardly
    /// more, the one that takes the least. `bytes` says what a schedule takes.
    pub(crate) fn within(horizon: usize, budget: u64, bytes: impl Fn(&Self) -> usize) -> Result<Self, MemoryError> {
        let bytes = |schedule: &Self| bytes(schedule) as u64;
        let all = Self::store_all(horizon);
        if bytes(&all) <= budget {
            return Ok(all);
        }
        // Longer segments take more, and every checkpoint takes the same.
        let fitting = (1..horizon.div_ceil(UNIT))
            .map(|units| Self::new(horizon, units * UNIT, 1))
            .map(|schedule| (schedule, bytes(&schedule)))
            .take_while(|&(_, least)| least <= budget)
            .map(|(schedule, least)| {
                let one_more = bytes(&Self { checkpoints: schedule.checkpoints + 1, ..schedule }) - least;
                let more = ((budget - least) / one_more).min(schedule.segments() as u64);
                Self::new(horizon, schedule.segment, schedule.checkpoints + more as usize)
            });
        let fitting: Vec<_> = fitting.map(|schedule| (schedule.recomputed_steps(), schedule)).collect();
        let fewest = fitting.iter().map(|&(again, _)| again).min().unwrap_or(0);
        let hardly_more = fitting.iter().filter(|&&(again, _)| again <= fewest.saturating_add(horizon as u64 / SAME));
        let best = hardly_more.min_by_key(|(again, schedule)| (bytes(schedule), *again));
        best.map(|&(_, schedule)| schedule).ok_or_else(|| {
            let smallest = bytes(&Self::binomial(horizon, 1)).min(bytes(&all));
            MemoryError { budget, smallest, everything: bytes(&all) }
        })
    }
}
