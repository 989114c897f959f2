//! Checkpoints: serialization of a [`Session`](crate::train::Session).
//!
//! A checkpoint consists of a magic number, a format number, a CRC-32C of the contents, and the
//! contents in the format of the crate postcard. A label in the contents identifies the run. To
//! restore a checkpoint, the caller passes an equal label.

use super::Record;
use super::episodes::{Episodes, EpisodesState};
use super::epoch::{Best, Epoch, Snapshot, State};
use crate::numbers::scalar::Float;
use crate::policy::AnyPolicy;
use crate::train::optim::Optimizer;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// First bytes of every checkpoint.
const MAGIC: &[u8; 8] = b"physgrad";
/// Incremented whenever the layout of [`Body`] changes.
const FORMAT: u16 = 8;

/// Start of the contents. Decoded before the body, so that a mismatch yields a specific error.
#[derive(Serialize, Deserialize)]
struct Header {
    version: String,
    precision: String,
    label: String,
    params: usize,
}

#[derive(Serialize, Deserialize)]
struct Body<'a, F: Clone> {
    theta: Cow<'a, [F]>,
    optimizer: Cow<'a, Optimizer<F>>,
    direction: Cow<'a, [F]>,
    records: Cow<'a, [Record]>,
    skipped_in_a_row: usize,
    best: Cow<'a, Best<F>>,
    /// Unfinished epoch, and the state before it.
    epoch: Option<(Epoch, Cow<'a, Snapshot<F>>)>,
    /// Episodes and value function of a training by windows.
    episodes: Option<EpisodesState<F>>,
}

/// Error of [`Session::restore`](crate::train::Session::restore). The session is unchanged.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// Bytes that are not a checkpoint.
    #[error("this is not a physgrad checkpoint")]
    NotACheckpoint,
    /// Checkpoint in another format.
    #[error(
        "this checkpoint has format {found}, but this version of physgrad reads format {FORMAT}; use the version that wrote it"
    )]
    Format {
        /// Format of the checkpoint.
        found: u16,
    },
    /// Truncated or modified checkpoint, or a state that a training with the settings of the
    /// session cannot reach.
    #[error("this checkpoint is damaged, or belongs to a training with other settings: {0}")]
    Damaged(String),
    /// Checkpoint of another version of physgrad, whose results may differ.
    #[error("this checkpoint was written by physgrad {found}, but this is {}; use version {found}", env!("CARGO_PKG_VERSION"))]
    Version {
        /// Version that wrote the checkpoint.
        found: String,
    },
    /// Checkpoint of a run with other settings.
    #[error(
        "this checkpoint belongs to another run. These settings differ:\n{}",
        differences(found, expected)
    )]
    Label {
        /// Label of the checkpoint.
        found: String,
        /// Label of the session.
        expected: String,
    },
    /// Checkpoint in another precision.
    #[error(
        "this checkpoint has precision {found}, but this run has {expected}; set the same precision"
    )]
    Precision {
        /// Precision of the checkpoint.
        found: String,
        /// Precision of the session.
        expected: String,
    },
    /// Checkpoint of a policy with another number of parameters.
    #[error(
        "this checkpoint has {found} parameters, but this policy has {expected}; use the same policy"
    )]
    Shape {
        /// Number of parameters in the checkpoint.
        found: usize,
        /// Number of parameters of the policy.
        expected: usize,
    },
}

/// Lists the lines that occur in only one of two settings texts. Used only for error messages.
pub fn differences(found: &str, expected: &str) -> String {
    let only = |a: &str, b: &str, whose: &str| -> Vec<String> {
        a.lines()
            .filter(|line| !b.lines().any(|l| l == *line))
            .map(|line| format!("  {whose} {line}"))
            .collect()
    };
    [only(found, expected, "there:"), only(expected, found, "here: ")].concat().join("\n")
}

/// CRC-32C.
const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);

/// Writes magic number, format and a matching checksum into the head of `bytes`.
pub(super) fn seal(bytes: &mut [u8]) {
    /// Offset of the contents.
    const CONTENTS: usize = MAGIC.len() + size_of::<u16>() + size_of::<u32>();
    if let Some((head, contents)) = bytes.split_at_mut_checked(CONTENTS) {
        head[..MAGIC.len()].copy_from_slice(MAGIC);
        head[MAGIC.len()..][..2].copy_from_slice(&FORMAT.to_le_bytes());
        head[MAGIC.len() + 2..].copy_from_slice(&CRC.checksum(contents).to_le_bytes());
    }
}

impl<F: Float> State<F> {
    /// Serializes the training in progress, see
    /// [`Session::checkpoint`](crate::train::Session::checkpoint).
    #[inline(never)]
    pub(super) fn checkpoint(&self, label: &str) -> Vec<u8> {
        let header = Header {
            version: env!("CARGO_PKG_VERSION").into(),
            precision: F::NAME.into(),
            label: label.into(),
            params: self.weights.theta().len(),
        };
        let body = Body {
            theta: Cow::Borrowed(self.weights.theta()),
            optimizer: Cow::Borrowed(&self.optimizer),
            direction: Cow::Borrowed(&self.direction),
            records: Cow::Borrowed(&self.records),
            skipped_in_a_row: self.skipped_in_a_row,
            best: Cow::Borrowed(&self.best),
            epoch: self.epoch.clone().map(|epoch| (epoch, Cow::Borrowed(&self.before))),
            episodes: self.episodes.as_ref().map(Episodes::state),
        };
        let contents = postcard::to_stdvec(&(header, body))
            .expect("postcard serializes numbers and text without errors");
        [MAGIC.as_slice(), &FORMAT.to_le_bytes(), &CRC.checksum(&contents).to_le_bytes(), &contents]
            .concat()
    }

    /// Restores a checkpoint, or returns an error and changes nothing.
    #[inline(never)]
    pub(super) fn restore(
        &mut self,
        policy: &dyn AnyPolicy<F>,
        bytes: &[u8],
        label: &str,
    ) -> Result<(), CheckpointError> {
        let rest = bytes.strip_prefix(MAGIC).ok_or(CheckpointError::NotACheckpoint)?;
        let (format, rest) = rest
            .split_first_chunk()
            .ok_or_else(|| CheckpointError::Damaged("it ends after the file signature".into()))?;
        let found = u16::from_le_bytes(*format);
        if found != FORMAT {
            return Err(CheckpointError::Format { found });
        }
        let damaged = |what: &dyn ToString| CheckpointError::Damaged(what.to_string());
        let (crc, contents) =
            rest.split_first_chunk().ok_or_else(|| damaged(&"it ends before its contents"))?;
        if CRC.checksum(contents) != u32::from_le_bytes(*crc) {
            return Err(damaged(&"its checksum is wrong"));
        }
        let (header, body) =
            postcard::take_from_bytes::<Header>(contents).map_err(|e| damaged(&e))?;
        if header.version != env!("CARGO_PKG_VERSION") {
            return Err(CheckpointError::Version { found: header.version });
        }
        if header.label != label {
            return Err(CheckpointError::Label { found: header.label, expected: label.into() });
        }
        if header.precision != F::NAME {
            return Err(CheckpointError::Precision {
                found: header.precision,
                expected: F::NAME.into(),
            });
        }
        let body: Body<F> = postcard::from_bytes(body).map_err(|e| damaged(&e))?;
        let expected = policy.param_count();
        if let Some(found) =
            [header.params, body.theta.len()].into_iter().find(|&found| found != expected)
        {
            return Err(CheckpointError::Shape { found, expected });
        }
        self.validate(&body).map_err(|e| damaged(&e))?;
        self.weights.update(policy, |theta| theta.copy_from_slice(&body.theta));
        self.optimizer = body.optimizer.into_owned();
        self.direction = body.direction.into_owned();
        self.records = body.records.into_owned();
        self.skipped_in_a_row = body.skipped_in_a_row;
        self.best = body.best.into_owned();
        self.skips.clear();
        self.diverged = [None; 2];
        self.epoch = body.epoch.map(|(epoch, before)| {
            self.before = before.into_owned();
            epoch
        });
        if let (Some(episodes), Some(state)) = (&mut self.episodes, &body.episodes) {
            episodes.set_state(state);
        }
        self.order_samples();
        if self.records.len() >= self.training.epochs && self.epoch.take().is_some() {
            self.restore_start_of_epoch(policy);
        }
        Ok(())
    }

    /// Checks that a training with these settings can reach this state.
    fn validate(&self, body: &Body<F>) -> Result<(), String> {
        let updates = self.updates_per_epoch();
        let mut steps = 0;
        for (i, record) in body.records.iter().enumerate() {
            record.validate(i + 1, updates)?;
            steps += (updates - record.skipped) as u64;
        }
        if let Some((epoch, before)) = &body.epoch {
            let Epoch { updates: done, skipped, means, seconds } = epoch;
            if *done >= updates || skipped.checked_add(means.updates()) != Some(*done) {
                return Err(format!(
                    "its unfinished epoch has {done} of {updates} updates, {skipped} of them skipped"
                ));
            }
            if !(*seconds >= 0.0 && seconds.is_finite()) {
                return Err(format!("its unfinished epoch has a time of {seconds} s"));
            }
            self.validate_episodes(&before.episodes)?;
            self.validate_state(
                &before.theta,
                &before.optimizer,
                &before.direction,
                before.skipped_in_a_row,
                steps,
            )?;
            steps += means.updates() as u64;
        }
        self.validate_episodes(&body.episodes)?;
        self.validate_theta(&body.best.theta)?;
        self.validate_state(
            &body.theta,
            &body.optimizer,
            &body.direction,
            body.skipped_in_a_row,
            steps,
        )
    }

    /// Checks episodes and value function.
    fn validate_episodes(&self, state: &Option<EpisodesState<F>>) -> Result<(), String> {
        match (&self.episodes, state) {
            (None, None) => Ok(()),
            (Some(episodes), Some(state)) => episodes.validate(state),
            _ => {
                Err("it is of a training by windows, or of whole rollouts, unlike this run".into())
            }
        }
    }

    /// Checks the state after `steps` applied updates.
    fn validate_state(
        &self,
        theta: &[F],
        optimizer: &Optimizer<F>,
        direction: &[F],
        skipped: usize,
        steps: u64,
    ) -> Result<(), String> {
        self.validate_theta(theta)?;
        if direction.len() != self.direction.len() {
            return Err(format!(
                "its average has {} components, but that of this run {}",
                direction.len(),
                self.direction.len()
            ));
        }
        if let Some(i) = direction.iter().position(|d| !d.as_().is_finite()) {
            return Err(format!("component {i} of its average is {}", direction[i]));
        }
        if skipped > self.training.max_skipped {
            return Err(format!(
                "{skipped} updates in a row were skipped; allowed: {}",
                self.training.max_skipped
            ));
        }
        optimizer.validate(&self.optimizer, steps)
    }

    fn validate_theta(&self, theta: &[F]) -> Result<(), String> {
        let params = self.weights.theta().len();
        if theta.len() != params {
            return Err(format!("it has {} parameters, but the policy has {params}", theta.len()));
        }
        match theta.iter().position(|p| !p.as_().is_finite()) {
            Some(i) => Err(format!("parameter {i} is {}", theta[i])),
            None => Ok(()),
        }
    }
}
