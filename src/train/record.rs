//! [`Record`]: results of one epoch. [`Skip`]: a skipped update.

use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::growth::Growth;
use crate::numbers::extended::ExtendedF64;
use serde::{Deserialize, Serialize};

/// Results of one epoch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Number of the epoch, from 1.
    pub epoch: usize,
    /// Mean over the applied updates of the batch loss before each update; NaN if none. With
    /// [`Training::smoothing`](crate::Training::smoothing), this is the mean loss at the perturbed
    /// parameters.
    pub loss: f64,
    /// Loss of the whole training set after the epoch; NaN if it diverged. In a training by
    /// [windows](crate::episode::Windows), the mean costs of the episodes during the epoch.
    pub train_loss: f64,
    /// Loss of the whole test set after the epoch; NaN if it diverged.
    pub test_loss: f64,
    /// Mean over the applied updates of the norm of the field before clipping. With smoothing, this
    /// is the norm of the estimate.
    pub grad_norm: ExtendedF64,
    /// Mean over the applied updates of the cosine between the gradients of a field of two flows.
    pub cosine: Option<f64>,
    /// Mean over the applied updates of the fraction of non-zero components of a field of two
    /// flows.
    pub kept: Option<f64>,
    /// Mean over the applied updates of the weight of the first-order estimate, with
    /// [`Training::smoothing`](crate::Training::smoothing).
    pub first_order: Option<f64>,
    /// Mean number of steps of the episodes of the test set, if they can end.
    pub length: Option<f64>,
    /// Error of the value function before it learned from a window: root of the mean square over the
    /// visited states and the windows, in the unit of the costs.
    pub value_error: Option<f64>,
    /// Part of the variance of its targets within windows that the value function explained.
    pub explained: Option<f64>,
    /// Number of updates skipped because of a [`Divergence`].
    pub skipped: usize,
    /// Growth of the adjoint of R in the first applied update, if the field contains R.
    pub regular_growth: Option<Growth>,
    /// Growth of the adjoint of M in the first applied update, if the field contains M.
    pub modified_growth: Option<Growth>,
    /// Wall time of the epoch in seconds, updates and evaluation.
    pub seconds: f64,
}

impl Record {
    /// Checks a restored record of epoch `number` with `updates` updates per epoch.
    ///
    /// # Errors
    /// Describes the fault.
    pub(super) fn validate(&self, number: usize, updates: usize) -> Result<(), String> {
        let Self { epoch, skipped, seconds, .. } = *self;
        if epoch != number || skipped > updates || !(seconds >= 0.0 && seconds.is_finite()) {
            return Err(format!(
                "the record of epoch {number} has number {epoch}, {skipped} of {updates} skipped updates, and time {seconds} s"
            ));
        }
        Ok(())
    }

    /// Returns warnings about the gradients of the epoch, as text.
    ///
    /// `horizon` is the number of steps of a rollout, `epsilon` the machine epsilon of its
    /// precision.
    pub fn warnings(&self, horizon: usize, epsilon: f64) -> Vec<String> {
        self.gradient_warnings(horizon, epsilon).into_iter().flatten().collect()
    }

    /// [`warnings`](Self::warnings) by kind: growth of R, growth of M, a field of 0.
    pub(super) fn gradient_warnings(&self, horizon: usize, epsilon: f64) -> [Option<String>; 3] {
        let regular =
            self.regular_growth.and_then(|growth| growth.warning(Flow::REGULAR, horizon, epsilon));
        let modified = self
            .modified_growth
            .and_then(|growth| growth.warning(Flow::MODIFIED, horizon, epsilon));
        let plateau = (self.grad_norm == ExtendedF64::default()).then(|| {
            let disagreement = if self.cosine.is_some() { ", or the combination of the two gradients is 0" } else { "" };
            format!(
                "the field is exactly 0: along its paths, the loss does not depend on the parameters here, or has its \
                 minimum{disagreement}. `check` tells which. On a plateau, try another seed, or initialize the output layer with \
                 nonzero weights"
            )
        });
        [regular, modified, plateau]
    }
}

/// An update skipped because of a [`Divergence`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skip {
    /// Number of the epoch, from 1.
    pub epoch: usize,
    /// Index of the update in its epoch, from 0.
    pub update: usize,
    /// Place of the number that is non-finite or too large. Samples are counted within the
    /// mini-batch.
    pub divergence: Divergence,
}

/// Results of one update, or of one evaluation of a mini-batch.
#[derive(Default)]
pub(super) struct UpdateStep {
    pub loss: f64,
    pub norm: ExtendedF64,
    pub cosine: Option<f64>,
    pub kept: Option<f64>,
    /// Weight of the first-order estimate.
    pub first_order: Option<f64>,
}

/// Sums over the applied updates of an epoch, or over the evaluations of an update with smoothing.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Means {
    updates: usize,
    loss: f64,
    norm: ExtendedF64,
    cosine: Option<f64>,
    kept: Option<f64>,
    first_order: Option<f64>,
    /// Growth of R and M in the first applied update.
    pub growths: [Option<Growth>; 2],
}

impl Means {
    /// Number of summed updates or evaluations.
    pub fn updates(&self) -> usize {
        self.updates
    }

    pub fn is_empty(&self) -> bool {
        self.updates == 0
    }

    pub fn add(&mut self, step: &UpdateStep) {
        self.updates += 1;
        self.loss += step.loss;
        self.norm = self.norm + step.norm;
        self.cosine = step.cosine.map(|c| c + self.cosine.unwrap_or(0.0));
        self.kept = step.kept.map(|k| k + self.kept.unwrap_or(0.0));
        self.first_order = step.first_order.map(|w| w + self.first_order.unwrap_or(0.0));
    }

    /// Means over the updates or evaluations.
    pub fn step(&self) -> UpdateStep {
        // NaN without applied updates.
        let mean = |sum: f64| sum / self.updates as f64;
        UpdateStep {
            loss: mean(self.loss),
            norm: self.norm / self.updates as f64,
            cosine: self.cosine.map(mean),
            kept: self.kept.map(mean),
            first_order: self.first_order.map(mean),
        }
    }

    pub fn record(
        &self,
        epoch: usize,
        train_loss: f64,
        test_loss: f64,
        skipped: usize,
        seconds: f64,
    ) -> Record {
        let UpdateStep { loss, norm, cosine, kept, first_order } = self.step();
        Record {
            epoch,
            loss,
            train_loss,
            test_loss,
            grad_norm: norm,
            cosine,
            kept,
            first_order,
            length: None,
            value_error: None,
            explained: None,
            skipped,
            regular_growth: self.growths[0],
            modified_growth: self.growths[1],
            seconds,
        }
    }
}
