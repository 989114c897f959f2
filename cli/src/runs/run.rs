//! One run in its folder: trains, saves, resumes, writes the output files.

use crate::operations::session::{AnyRun, Epoch};
use crate::operations::trajectory::ROLLOUTS;
use crate::platform::folder::{
    ANIMATION, BEST_POLICY, CHECKPOINT, Folder, LEARNING_CURVE, NUMBERS, POLICY, TRAJECTORY,
};
use crate::platform::lock::Locked;
use crate::platform::signals;
use crate::platform::terminal::print_message;
use crate::runs::limits::Limits;
use crate::runs::metrics::Metrics;
use crate::runs::outputs;
use crate::runs::saved;
use crate::settings::LogFormat;
use crate::tasks::Scene;
use anyhow::{Context, Error, Result, bail};
use physgrad::TrainError;
use physgrad::engine::{Ranks, ranks};
use physgrad::train::{Record, Warning};
use std::fmt;
use std::sync::{Arc, Once};
use std::time::{Duration, Instant};

/// Default time between two checkpoints.
pub const SAVE_EVERY: Duration = Duration::from_secs(5);

/// Observer of a run.
pub trait Observer {
    /// The run resumes after this many epochs of an earlier process.
    fn resumed(&mut self, _epochs: usize) {}
    /// An epoch is complete.
    fn epoch(&mut self, event: EpochEvent);
    /// Time between two calls of [`is_stopped`](Self::is_stopped) within an epoch, rounded up to
    /// whole updates. Further calls are at the start, and after epochs and checkpoints. With None,
    /// only these remain.
    fn poll_every(&self) -> Option<Duration> {
        None
    }
    /// Returns true to end the run after the current update. The thread that trains calls it.
    fn is_stopped(&mut self) -> bool {
        false
    }
}

/// Observer that ignores events.
pub struct Unobserved;

impl Observer for Unobserved {
    fn epoch(&mut self, _event: EpochEvent) {}
}

/// Result of an epoch, with its warnings.
#[derive(Clone, Copy)]
pub struct EpochEvent<'a> {
    /// Results of the epoch.
    pub record: &'a Record,
    /// Warnings about the epoch.
    pub warnings: &'a [Warning],
}

/// Records, trained numbers and end of a run.
pub struct Finished {
    pub records: Vec<Record>,
    /// Names and values of the trained numbers.
    pub numbers: Vec<(String, f64)>,
    pub end: End,
}

/// End of a run.
pub enum End {
    Complete,
    /// A signal or the observer ended the run.
    Interrupted,
    /// Training failed with a [`TrainError`]. The run has the state after the last complete epoch.
    Failed(Error),
    /// No update was applied, up to the end or the failure of the run.
    NoUpdate(Option<Error>),
}

/// Error of training that applied no update. Contains the names of the runs, or the folder of a
/// single run.
#[derive(Debug)]
pub struct NoUpdate(pub String);

impl fmt::Display for NoUpdate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(runs) = self;
        write!(
            f,
            "no update was applied in {runs}: every update was skipped because of a non-finite number. The \
             policy is untrained. Try smaller time steps, a shorter horizon, or other settings of the effects"
        )
    }
}

impl std::error::Error for NoUpdate {}

/// Trains the session `run` of a scene in the folder. Resumes from the checkpoint if `resume`.
///
/// Saves at the start, every `save_every`, after a signal, and at the end. A save waits for the
/// current update or evaluation. With several ranks, rank 0 calls this function and the others call
/// [`follow`].
pub fn run(
    folder: &Locked,
    scene: &Scene,
    run: &mut dyn AnyRun,
    resume: bool,
    save_every: Duration,
    ranks: Option<&Arc<dyn Ranks>>,
    observer: &mut dyn Observer,
) -> Result<Finished> {
    let identity = scene.identity();
    if resume {
        saved::restore(folder, scene, run)?;
        let done = run.records().len();
        if done > scene.epochs {
            bail!(
                "the run in {} already has {done} epochs, but `epochs` is {}; set it to {done} or more",
                folder.path().display(),
                scene.epochs
            );
        }
        observer.resumed(done);
    }
    if let Some(ranks) = ranks {
        ranks::broadcast(&**ranks, &run.checkpoint(&identity));
        run.share(ranks)?;
    }
    let mut saver = Saver::begin(folder, scene, &identity, save_every)?;
    saver.save(run)?;
    let failure = train(scene, run, ranks, Some(&mut saver), observer)?;
    saver.end(scene, run)?;
    Ok(finished(scene, run, failure))
}

/// Trains with rank 0, which calls [`run`]. Writes nothing.
///
/// # Errors
/// The settings of the ranks differ. The memory limit is too small.
pub fn follow(scene: &Scene, run: &mut dyn AnyRun, ranks: &Arc<dyn Ranks>) -> Result<()> {
    let state = ranks::broadcast(&**ranks, &[]);
    run.restore(&state, &scene.identity()).context("the state of rank 0 does not fit this rank")?;
    run.share(ranks)?;
    // All ranks fail alike, and rank 0 reports the failure.
    train(scene, run, Some(ranks), None, &mut Unobserved).map(drop)
}

/// Trains the session of a scene without a folder.
pub fn in_memory(scene: &Scene, run: &mut dyn AnyRun, observer: &mut dyn Observer) -> Finished {
    let failure = train(scene, run, None, None, observer)
        .expect("a training without a folder writes no file");
    finished(scene, run, failure)
}

/// Saves the session of a scene in the folder, as [`run`] does after its last epoch.
pub fn save(folder: &Locked, scene: &Scene, run: &dyn AnyRun) -> Result<()> {
    Saver::begin(folder, scene, &scene.identity(), SAVE_EVERY)?.end(scene, run)
}

/// Trains up to the last epoch, a failure, a signal or a stop by the observer. Returns the failure,
/// if any. A signal to one rank, or a stop or pause of one rank, applies to all.
///
/// # Errors
/// The folder was removed or replaced.
fn train(
    scene: &Scene,
    run: &mut dyn AnyRun,
    ranks: Option<&Arc<dyn Ranks>>,
    mut saver: Option<&mut Saver>,
    observer: &mut dyn Observer,
) -> Result<Option<TrainError>> {
    let on_any_rank = |value| ranks.map_or(value, |ranks| ranks::any(&**ranks, value));
    let names = scene.param_names();
    let mut limits = Limits::new(scene, &names);
    let numbers = scene.trained_numbers();
    let mut within_epoch = false;
    while !run.is_done() {
        let stops = observer.is_stopped() || (!within_epoch && signals::received().is_some());
        if on_any_rank(stops) {
            break;
        }
        let (begin, poll) = (Instant::now(), observer.poll_every());
        let due = saver.as_deref();
        let pause = || {
            on_any_rank(
                due.is_some_and(Saver::is_due) || poll.is_some_and(|poll| begin.elapsed() >= poll),
            )
        };
        match run.advance(&pause) {
            Ok(record) => {
                within_epoch = record.is_none();
                if let (Some(record), Some(saver)) = (record, &mut saver) {
                    saver.append(record);
                }
            }
            Err(error) => return Ok(Some(error)),
        }
        if let Some(record) = run.records().last().filter(|_| !within_epoch) {
            let mut warnings = run.warnings(&numbers);
            for warning in &mut warnings {
                let key = warning.divergence.and_then(|place| scene.expression_at(&place));
                warning.cause += &key.map_or_else(String::new, |key| format!("; {key}"));
            }
            if !limits.is_empty() {
                warnings.extend(limits.warnings(record.epoch, &run.trained(Epoch::Last)));
            }
            observer.epoch(EpochEvent { record, warnings: &warnings });
        }
        if let Some(saver) = saver.as_deref_mut().filter(|saver| saver.is_due()) {
            saver.try_to_save(run)?;
        }
    }
    Ok(None)
}

/// Records and end of a run.
fn finished(scene: &Scene, run: &dyn AnyRun, failure: Option<TrainError>) -> Finished {
    let records = run.records().to_vec();
    let end = match failure.map(|error| located(scene, error)) {
        None if !run.is_done() => End::Interrupted,
        None if run.updates() == 0 && !records.is_empty() => End::NoUpdate(None),
        None => End::Complete,
        Some(error) if run.updates() == 0 => End::NoUpdate(Some(error)),
        Some(error) => End::Failed(error),
    };
    Finished { records, numbers: numbers(scene, run, Epoch::Last), end }
}

/// The error, after the expression of the scene that gave the number that is not finite.
pub fn located(scene: &Scene, error: TrainError) -> Error {
    let key = match &error {
        TrainError::Diverged { last, .. } => scene.expression_at(&last.divergence),
        _ => None,
    };
    let error = Error::new(error);
    key.into_iter().fold(error, Error::context)
}

/// Names and values of the trained numbers after the epoch, of the system and of the policy.
pub fn numbers(scene: &Scene, run: &dyn AnyRun, epoch: Epoch) -> Vec<(String, f64)> {
    let names = scene.param_names();
    let of_system = run.trained(epoch).into_iter();
    let of_system = of_system.map(|(i, value)| (names[i].clone(), value));
    of_system.chain(scene.policy_numbers(&run.theta(epoch))).collect()
}

/// Writes checkpoints and metrics of a run.
struct Saver<'a> {
    folder: &'a Locked,
    identity: &'a str,
    /// Formats of the metrics besides CSV.
    logs: &'a [LogFormat],
    /// Open files of the metrics. None if the next save has to rewrite them.
    metrics: Option<Metrics>,
    save_every: Duration,
    /// Time of the last attempt to save.
    last: Instant,
    /// True once the run has attempted a checkpoint after the first signal.
    signal_seen: bool,
}

impl<'a> Saver<'a> {
    /// Removes leftover temporary files and writes the settings. A folder with settings contains a
    /// run. A run without a checkpoint has not begun its first epoch.
    fn begin(
        folder: &'a Locked,
        scene: &'a Scene,
        identity: &'a str,
        save_every: Duration,
    ) -> Result<Self> {
        folder.clean()?;
        saved::write_settings(folder, scene)?;
        let (logs, last) = (&scene.logs[..], Instant::now());
        Ok(Self { folder, identity, logs, metrics: None, save_every, last, signal_seen: false })
    }

    /// Saves the run and writes its output files.
    fn end(&mut self, scene: &Scene, run: &dyn AnyRun) -> Result<()> {
        self.save(run)?;
        write_outputs(self.folder, scene, run)?;
        let numbers = numbers(scene, run, Epoch::Last);
        if !numbers.is_empty() {
            self.folder.write(NUMBERS, outputs::numbers(&numbers)?)?;
        }
        self.folder.check()
    }

    fn is_due(&self) -> bool {
        self.last.elapsed() >= self.save_every
            || (!self.signal_seen && signals::received().is_some())
    }

    /// Appends an epoch to the metrics. After an error, the next save rewrites their files.
    fn append(&mut self, record: &Record) {
        if self.metrics.as_mut().is_some_and(|metrics| metrics.append(record).is_err()) {
            self.metrics = None;
        }
    }

    fn save(&mut self, run: &dyn AnyRun) -> Result<()> {
        self.folder.check()?;
        self.folder.write(CHECKPOINT, run.checkpoint(self.identity))?;
        match &self.metrics {
            // Drops rows after the last checkpoint of an earlier process: the run recomputes them.
            None => self.metrics = Some(Metrics::create(self.folder, self.logs, run.records())?),
            Some(metrics) => metrics.sync()?,
        }
        self.last = Instant::now();
        Ok(())
    }

    /// Saves the run. On an error, prints a warning and continues: disk space may become free.
    ///
    /// # Errors
    /// The folder was removed or replaced.
    fn try_to_save(&mut self, run: &dyn AnyRun) -> Result<()> {
        if !self.signal_seen && signals::received().is_some() {
            self.signal_seen = true;
            // Parallel runs share one message.
            static REPORTED: Once = Once::new();
            REPORTED.call_once(|| {
                print_message("finishing the epoch and saving; a second signal stops immediately")
            });
        }
        if let Err(error) = self.save(run) {
            if self.folder.is_gone() {
                return Err(error);
            }
            self.metrics = None;
            self.last = Instant::now();
            print_message(&format!(
                "warning: the run continues, but could not be saved: {error:#}"
            ));
        }
        Ok(())
    }
}

/// Writes the last and the best policy, learning curve, trajectories and animation.
fn write_outputs(folder: &Folder, scene: &Scene, run: &dyn AnyRun) -> Result<()> {
    let task = scene.task.name();
    let title = format!("{task}, field {}, seed {}", scene.field.0, scene.seed);
    folder.write(POLICY, run.safetensors(Epoch::Last, &scene.about())?)?;
    folder.write(BEST_POLICY, run.safetensors(Epoch::Best, &scene.about())?)?;
    folder.write(LEARNING_CURVE, outputs::learning_curve(&title, run.records()))?;
    let rollouts = run.rollouts(0..ROLLOUTS);
    folder.write(TRAJECTORY, outputs::trajectories(scene, rollouts.iter().enumerate())?)?;
    folder.write(ANIMATION, scene.animation(&rollouts[0]).to_svg())
}
