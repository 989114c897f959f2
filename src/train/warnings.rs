//! Warnings of a training: skipped updates, non-finite losses, unreliable gradients.

use super::progress::Progress;
use super::record::Skip;
use crate::numbers::scalar::Float;
use std::mem::replace;

/// Number of kinds of warnings.
pub(super) const KINDS: usize = 7;

impl<F: Float> Progress<F> {
    /// Returns the warnings about the last epoch of kinds that no earlier call returned. Warnings
    /// contain numbers that differ between epochs, so their texts cannot be compared.
    pub(super) fn warnings(&mut self, horizon: usize) -> Vec<String> {
        let updates = self.updates_per_epoch();
        let Some(record) = self.records.last().filter(|_| self.epoch.is_none()) else { return Vec::new() };
        let [some_skipped, all_skipped] = skipped(&self.skips, updates);
        let [train, test] = self.diverged;
        let loss = |set, divergence| format!("the {set} loss is not finite ({divergence})");
        let [regular, modified, zero] = record.gradient_warnings(horizon, F::EPSILON);
        let texts: [Option<String>; KINDS] = [
            some_skipped,
            all_skipped,
            train.map(|divergence| loss("training", divergence)),
            test.map(|divergence| loss("test", divergence)),
            regular,
            modified,
            zero,
        ];
        let new = texts.into_iter().zip(&mut self.warned).filter_map(|(text, warned)| text.filter(|_| !replace(warned, true)));
        new.map(|text| format!("epoch {}: {text}", record.epoch)).collect()
    }
}

/// Warns about an epoch of `updates` updates of which some, or all, were skipped.
fn skipped(skips: &[Skip], updates: usize) -> [Option<String>; 2] {
    match skips {
        [] => [None, None],
        [Skip { divergence, .. }, ..] if skips.len() == updates => {
            [None, Some(format!("all {updates} update(s) skipped, so the parameters did not change ({divergence})"))]
        }
        [Skip { update, divergence, .. }, ..] => {
            let count = skips.len();
            [Some(format!("{count} of {updates} updates skipped, first update {update} ({divergence})")), None]
        }
    }
}
