//! Warnings of a training: skipped updates, non-finite losses, unreliable gradients, and numbers
//! that training does not determine.

use super::epoch::State;
use super::record::{Record, Skip};
use super::smoothing::Estimator;
use crate::engine::divergence::{Divergence, InTraining};
use crate::numbers::scalar::Float;
use crate::policy::TrainedParam;
use std::fmt;

/// Warning about an epoch. The text consists of the epoch and the cause.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// Number of the epoch, from 1.
    pub epoch: usize,
    /// Kind of the cause. Epochs may have causes of one kind with different texts.
    pub kind: &'static str,
    /// Name of the trained number, if the kind has one warning per number.
    pub number: Option<String>,
    /// Cause, and remedy if known.
    pub cause: String,
    /// Place of the number that is not finite, if there is one.
    pub divergence: Option<Divergence>,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "epoch {}: {}", self.epoch, self.cause)
    }
}

/// Kinds of warnings, in the order of their reports.
const KINDS: [&str; 14] = [
    "some skipped",
    "all skipped",
    "training loss",
    "test loss",
    "growth of R",
    "growth of M",
    "field of 0",
    "no first order",
    "number ran away",
    "number at its bound",
    "number acts by comparison",
    "number without effect",
    "short episodes",
    "saturated controls",
];

/// Share of controls at a bound above which training can hardly change the policy.
const SATURATED: f64 = 0.95;

/// A trained number with a meaning of its own: of the system, or of the policy, for example a gain.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedNumber {
    /// Name in warnings.
    pub name: String,
    /// Index in `θ`.
    pub index: usize,
    /// Map from the entry of `θ` to the number. Its own index has no meaning here.
    pub map: TrainedParam,
}

impl<F: Float> State<F> {
    /// Warnings about the last epoch, without the kinds that an earlier call returned.
    #[inline(never)]
    pub(super) fn new_warnings(
        &mut self,
        horizon: usize,
        numbers: &[TrainedNumber],
    ) -> Vec<Warning> {
        let mut warnings = self.warnings(horizon, numbers);
        warnings.retain(|warning| !self.warned.contains(&warning.kind));
        self.warned.extend(warnings.iter().map(|warning| warning.kind));
        warnings
    }

    /// All warnings about the last epoch.
    #[inline(never)]
    pub(super) fn warnings(&self, horizon: usize, numbers: &[TrainedNumber]) -> Vec<Warning> {
        let updates = self.updates_per_epoch();
        let Some(record) = self.records.last().filter(|_| self.epoch.is_none()) else {
            return Vec::new();
        };
        let first = self.skips.iter().find(|skip| skip.epoch == record.epoch);
        let [some_skipped, all_skipped] = skipped(record.skipped, updates, first, &|divergence| {
            self.number_at(divergence, numbers)
        });
        let [train, test] = self.diverged;
        let skip = first.map(|skip| skip.divergence);
        let loss = |set, divergence: Divergence| {
            format!("the {set} loss is not finite ({})", InTraining(&divergence))
        };
        // Without parameters, there is no gradient to warn of.
        let [regular, modified, zero] = if self.weights.theta().is_empty() {
            [None, None, None]
        } else {
            record.gradient_warnings(horizon, F::EPSILON)
        };
        let causes: [Option<String>; KINDS.len()] = [
            some_skipped,
            all_skipped,
            train.map(|divergence| loss("training", divergence)),
            test.map(|divergence| loss("test", divergence)),
            regular,
            modified,
            zero,
            self.without_first_order(record),
            self.run_away(numbers),
            self.at_bound(numbers),
            self.without_slope(numbers, true).map(|names| {
                format!(
                    "the slope of the loss with respect to {names} is exactly 0, but other values change the loss. The number acts \
                     only through comparisons, so training cannot change it, and other numbers adapt to its start. Replace the \
                     comparison by a smooth transition, or search over fixed values of the number"
                )
            }),
            self.without_slope(numbers, false).map(|names| {
                format!(
                    "the loss does not depend on {names}, so training cannot change it. Use a fixed value, or add a cost or initial \
                     states that depend on it"
                )
            }),
            self.short_episodes(record, horizon),
            self.saturated_controls(),
        ];
        let places = [skip, skip, train, test].into_iter().chain(std::iter::repeat(None));
        let warning = |((kind, cause), divergence): ((&'static str, Option<String>), _)| {
            Some(Warning { epoch: record.epoch, kind, number: None, cause: cause?, divergence })
        };
        KINDS.into_iter().zip(causes).zip(places).filter_map(warning).collect()
    }

    /// Warning about numbers that are far from their start, or not finite.
    fn run_away(&self, numbers: &[TrainedNumber]) -> Option<String> {
        let lost = self.values_of(numbers, TrainedParam::has_run_away)?;
        Some(format!(
            "training runs away: {lost}, more than a factor of a million from the start. The number is not determined, or the \
             learning rate is too large. Give it bounds, reduce the learning rate, or use a fixed value"
        ))
    }

    /// Warning about numbers at a bound.
    fn at_bound(&self, numbers: &[TrainedNumber]) -> Option<String> {
        let bounded = self.values_of(numbers, TrainedParam::is_near_bound)?;
        Some(format!(
            "a trained number is at its bound, or within 1 % of it: {bounded}. The loss may be lower beyond the bound, or the \
             learning rate too large. Check the bounds, reduce the learning rate, or use a fixed value"
        ))
    }

    /// Warning about test episodes that end at once, or that the policy learned to end.
    fn short_episodes(&self, record: &Record, horizon: usize) -> Option<String> {
        let first = &self.records[0];
        let (now, before) = (record.length?, self.untrained_length.or(first.length)?);
        let is_new = self.untrained_length.is_some();
        if now <= 1.0 && horizon > 1 {
            return Some(
                "all test episodes end in their first step. Check whether the condition of the end holds in the initial states"
                    .into(),
            );
        }
        let is_better = is_new || record.test_loss < first.test_loss;
        (2.0 * now < before && is_better).then(|| {
            format!(
                "test episodes last {} steps, and lasted {} {}: the policy learns to end them. If the end is not the goal, \
                 reward each step by a constant in the running cost, or make the end expensive by `ended` in the terminal cost",
                now.round(),
                before.round(),
                if is_new { "before the training" } else { "after the first epoch, with a higher loss" }
            )
        })
    }

    /// Warning about controls that training can hardly change.
    fn saturated_controls(&self) -> Option<String> {
        let share = self.saturated.filter(|&share| share >= SATURATED)?;
        Some(format!(
            "{:.0} % of the controls of the test set are at their bounds, where the slope of the bound is less than a hundredth, \
             so training can hardly change them. If the task does not call for this, begin anew with a smaller learning rate, a \
             cost of the controls, wider bounds, or observations and costs of size 1",
            100.0 * share
        ))
    }

    /// Names and values of the numbers whose entry r of `θ` is `selected`. `None` without such
    /// numbers.
    fn values_of(
        &self,
        numbers: &[TrainedNumber],
        selected: fn(&TrainedParam, f64) -> bool,
    ) -> Option<String> {
        let theta = self.weights.theta();
        let value = |TrainedNumber { name, index, map }: &TrainedNumber| {
            let r: f64 = theta[*index].as_();
            selected(map, r).then(|| format!("{name} = {:.3e}", map.value(r)))
        };
        list(numbers.iter().filter_map(value).collect())
    }

    /// Names of the numbers without a slope in all updates of the last epoch. `changes` selects those
    /// that change the loss nevertheless, or those that do not. Omits numbers at a bound, where the
    /// slope rounds to 0.
    fn without_slope(&self, numbers: &[TrainedNumber], changes: bool) -> Option<String> {
        let theta = self.weights.theta();
        let is_selected = |TrainedNumber { index, map, .. }: &&TrainedNumber| {
            self.without_slope.contains(&(*index, changes)) && !map.is_at_bound(theta[*index].as_())
        };
        let selected = numbers.iter().filter(is_selected);
        list(selected.map(|number| number.name.clone()).collect())
    }

    /// Text that names the trained number of a gradient that is not finite, or "".
    fn number_at(&self, divergence: &Divergence, numbers: &[TrainedNumber]) -> String {
        let (Divergence::Gradient { parameter, .. } | Divergence::Field { parameter, .. }) =
            divergence
        else {
            return String::new();
        };
        let number = numbers.iter().find(|number| number.index == *parameter);
        number
            .map(|number| format!("; component {parameter} is the trained number {}", number.name))
            .unwrap_or_default()
    }

    /// Warning about an epoch in which [`Estimator::AlphaOrder`] ignored the first-order estimate.
    fn without_first_order(&self, record: &Record) -> Option<String> {
        let Estimator::AlphaOrder { tolerance } = self.training.smoothing?.estimator else {
            return None;
        };
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
/// `more` adds to the text of a divergence.
fn skipped(
    count: usize,
    updates: usize,
    known: Option<&Skip>,
    more: &dyn Fn(&Divergence) -> String,
) -> [Option<String>; 2] {
    let cause = known
        .map(|skip| format!(" ({}{})", InTraining(&skip.divergence), more(&skip.divergence)))
        .unwrap_or_default();
    let place =
        known.map(|skip| format!(", for example update {}", skip.update)).unwrap_or_default();
    match count {
        0 => [None, None],
        _ if count == updates => [
            None,
            Some(format!(
                "all {updates} update(s) skipped, so the parameters did not change{cause}"
            )),
        ],
        _ => [Some(format!("{count} of {updates} updates skipped{place}{cause}")), None],
    }
}

/// Joins names by commas. `None` for an empty list.
fn list(names: Vec<String>) -> Option<String> {
    (!names.is_empty()).then(|| names.join(", "))
}
