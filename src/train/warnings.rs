//! Warnings of a training: skipped updates, non-finite losses, unreliable gradients.

use super::epoch::State;
use super::record::{Record, Skip};
use super::smoothing::Estimator;
use crate::numbers::scalar::Float;
use std::fmt;

/// Warning about an epoch. The text consists of the epoch and the cause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Number of the epoch, from 1.
    pub epoch: usize,
    /// Kind of the cause. Epochs may have causes of one kind with different texts.
    pub kind: &'static str,
    /// Cause, and remedy if known.
    pub cause: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "epoch {}: {}", self.epoch, self.cause)
    }
}

/// Kinds of warnings, in the order of their reports.
const KINDS: [&str; 8] =
    ["some skipped", "all skipped", "training loss", "test loss", "growth of R", "growth of M", "field of 0", "no first order"];

impl<F: Float> State<F> {
    /// Warnings about the last epoch, without the kinds that an earlier call returned.
    pub(super) fn new_warnings(&mut self, horizon: usize) -> Vec<Warning> {
        let mut warnings = self.warnings(horizon);
        warnings.retain(|warning| !self.warned.contains(&warning.kind));
        self.warned.extend(warnings.iter().map(|warning| warning.kind));
        warnings
    }

    /// All warnings about the last epoch.
    pub(super) fn warnings(&self, horizon: usize) -> Vec<Warning> {
        let updates = self.updates_per_epoch();
        let Some(record) = self.records.last().filter(|_| self.epoch.is_none()) else { return Vec::new() };
        let first = self.skips.iter().find(|skip| skip.epoch == record.epoch);
        let [some_skipped, all_skipped] = skipped(record.skipped, updates, first);
        let [train, test] = self.diverged;
        let loss = |set, divergence| format!("the {set} loss is not finite ({divergence})");
        let [regular, modified, zero] = record.gradient_warnings(horizon, F::EPSILON);
        let causes: [Option<String>; KINDS.len()] = [
            some_skipped,
            all_skipped,
            train.map(|divergence| loss("training", divergence)),
            test.map(|divergence| loss("test", divergence)),
            regular,
            modified,
            zero,
            self.without_first_order(record),
        ];
        let warning = |(kind, cause): (&'static str, Option<String>)| Some(Warning { epoch: record.epoch, kind, cause: cause? });
        KINDS.into_iter().zip(causes).filter_map(warning).collect()
    }

    /// Warning about an epoch in which [`Estimator::AlphaOrder`] ignored the first-order estimate.
    fn without_first_order(&self, record: &Record) -> Option<String> {
        let Estimator::AlphaOrder { tolerance } = self.training.smoothing?.estimator else { return None };
        (record.first_order == Some(0.0)).then(|| {
            format!(
                "the estimator alpha_order used only the zeroth-order estimate, whose error exceeds the tolerance of {tolerance}. \
                 Raise the tolerance or the number of pairs"
            )
        })
    }
}

/// Returns the warning about some skipped updates, and the warning that all updates were skipped.
/// At most one is present. The epoch skipped `count` of `updates` updates. `known` is one of the
/// skipped updates, if any is recorded. A restored session has no record of the updates that were
/// skipped before its checkpoint.
fn skipped(count: usize, updates: usize, known: Option<&Skip>) -> [Option<String>; 2] {
    let cause = known.map(|skip| format!(" ({})", skip.divergence)).unwrap_or_default();
    let place = known.map(|skip| format!(", for example update {}", skip.update)).unwrap_or_default();
    match count {
        0 => [None, None],
        _ if count == updates => {
            [None, Some(format!("all {updates} update(s) skipped, so the parameters did not change{cause}"))]
        }
        _ => [Some(format!("{count} of {updates} updates skipped{place}{cause}")), None],
    }
}
