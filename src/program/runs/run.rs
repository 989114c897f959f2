//! One run in its folder: train, save, resume, and leave files behind.

use crate::program::operations::session::AnyRun;
use crate::program::operations::trajectory::ROLLOUTS;
use crate::program::platform::folder::{ANIMATION, CHECKPOINT, Folder, LEARNING_CURVE, POLICY, SETTINGS, TRAJECTORY};
use crate::program::platform::lock::Locked;
use crate::program::platform::signals;
use crate::program::platform::terminal::tell;
use crate::program::runs::outputs::{self, Metrics};
use crate::program::runs::saved;
use crate::program::tasks::Scene;
use anyhow::{Result, bail};
use physgrad::{Divergence, Record, Skip, TrainError};
use std::fmt;
use std::time::{Duration, Instant};

/// Default time between two checkpoints.
pub const SAVE_EVERY: Duration = Duration::from_secs(5);

/// Observer of a run.
pub trait Observer {
    /// The run goes on after this many epochs of an earlier process.
    fn resumed(&mut self, _epochs: usize) {}
    /// An epoch is done.
    fn epoch(&mut self, told: EpochEvent);
}

/// Events of an epoch.
#[derive(Clone, Copy)]
pub struct EpochEvent<'a> {
    pub record: &'a Record,
    /// Updates that were not applied, since the program was started.
    pub skips: &'a [Skip],
    pub diverged: [Option<Divergence>; 2],
    /// Reasons not to trust the gradients, unless an earlier epoch gave them.
    pub warnings: &'a [String],
}

/// A run that is done, was interrupted, or failed.
pub struct Finished {
    pub records: Vec<Record>,
    pub interrupted: bool,
    /// Reason of the failure; the run is then in its state after the last whole epoch.
    pub broken: Option<TrainError>,
    /// Updates were attempted, and none was applied.
    pub no_update: bool,
}

impl Finished {
    /// A run that a signal ended before it began.
    pub fn before_start() -> Self {
        Self { records: Vec::new(), interrupted: true, broken: None, no_update: false }
    }
}

/// A training that applied no update.
#[derive(Debug)]
pub struct NoUpdate(pub String);

impl fmt::Display for NoUpdate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(runs) = self;
        write!(
            f,
            "no update was applied in {runs}: in each, a number was not finite. The policy is untrained. Try smaller time steps, a \
             shorter horizon, or other settings of the effects"
        )
    }
}

impl std::error::Error for NoUpdate {}

/// Threads that may be asked for, unless there are more cores. Two thousand take longer to wake than to do their work.
const MOST_THREADS: usize = 256;

/// Sets up the thread pool and returns its number of threads.
pub fn threads(asked: Option<usize>) -> Result<usize> {
    let most = std::thread::available_parallelism().map_or(1, usize::from).max(MOST_THREADS);
    // As rayon reads it; 0 stands for all cores.
    let default = || std::env::var("RAYON_NUM_THREADS").ok()?.parse().ok().filter(|&threads| threads > 0);
    let (source, threads) = match (asked, default()) {
        (Some(threads), _) => ("--threads", threads),
        (None, Some(threads)) => ("RAYON_NUM_THREADS", threads),
        (None, None) => return Ok(rayon::current_num_threads()),
    };
    if !(1..=most).contains(&threads) {
        bail!("{source} is {threads}; allowed: 1 to {most}");
    }
    if asked.is_some() {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    Ok(threads)
}

/// Runs the scene in the folder; `run` is the scene, opened. If `resume`, goes on from the checkpoint. Saves at least every
/// `save_every`, but for the time of one update or evaluation.
pub fn run(
    folder: &Locked,
    scene: &Scene,
    mut run: Box<dyn AnyRun>,
    resume: bool,
    save_every: Duration,
    watch: &mut dyn Observer,
) -> Result<Finished> {
    let identity = scene.identity();
    if resume {
        saved::restore(folder, scene, &mut *run)?;
        let done = run.records().len();
        if done > scene.epochs {
            bail!("the run in {} has {done} epochs already, and asked for are {}", folder.path().display(), scene.epochs);
        }
        watch.resumed(done);
    }
    folder.clean()?;
    // Settings make a folder a run. Without a checkpoint, it is at its start.
    folder.write(SETTINGS, scene.table.to_string())?;
    let mut saver = Saver { folder, identity: &identity, metrics: None, save_every, last: Instant::now(), signal_seen: false };
    saver.save(&*run)?;

    let mut broken = None;
    let mut within_epoch = false;
    let mut warned = 0;
    while !run.is_done() && (within_epoch || signals::received().is_none()) {
        match run.advance(&|| saver.is_due()) {
            Ok(record) => {
                within_epoch = record.is_none();
                if let Some(record) = record {
                    saver.append(record);
                }
            }
            Err(error) => {
                broken = Some(error);
                break;
            }
        }
        if let Some(record) = run.records().last().filter(|_| !within_epoch) {
            // Once for each flow of a run: the numbers differ in every epoch.
            let warnings: Vec<String> = record.warnings(scene.horizon, scene.precision.epsilon());
            let news = warnings.len() > warned;
            warned = warned.max(warnings.len());
            let warnings = if news { &warnings[..] } else { &[] };
            watch.epoch(EpochEvent { record, skips: run.skips(), diverged: run.diverged(), warnings });
        }
        if saver.is_due() {
            saver.try_to_save(&*run)?;
        }
    }
    saver.save(&*run)?;
    leave(folder, scene, &*run)?;
    folder.check()?;
    let interrupted = broken.is_none() && !run.is_done();
    let no_update = run.updates() == 0 && (broken.is_some() || !run.records().is_empty());
    Ok(Finished { records: run.records().to_vec(), interrupted, broken, no_update })
}

/// Writes checkpoints and metrics of a run.
struct Saver<'a> {
    folder: &'a Locked,
    identity: &'a str,
    /// `None` if the file has to be written anew.
    metrics: Option<Metrics>,
    save_every: Duration,
    /// Time of the last attempt.
    last: Instant,
    /// A checkpoint was attempted after the signal that ends the run.
    signal_seen: bool,
}

impl Saver<'_> {
    fn is_due(&self) -> bool {
        self.last.elapsed() >= self.save_every || (!self.signal_seen && signals::received().is_some())
    }

    /// Appends an epoch to the metrics. After an error, the next save writes the file anew.
    fn append(&mut self, record: &Record) {
        if self.metrics.as_mut().is_some_and(|metrics| metrics.append(record).is_err()) {
            self.metrics = None;
        }
    }

    fn save(&mut self, run: &dyn AnyRun) -> Result<()> {
        self.folder.check()?;
        self.folder.write(CHECKPOINT, run.checkpoint(self.identity))?;
        match &self.metrics {
            // Rows that were written after the last checkpoint of an earlier process are computed again.
            None => self.metrics = Some(Metrics::create(self.folder, run.records())?),
            Some(metrics) => metrics.sync()?,
        }
        self.last = Instant::now();
        Ok(())
    }

    /// Saves, or prints a warning and lets the run go on: space may become free before its end.
    ///
    /// # Errors
    /// The folder was removed or replaced.
    fn try_to_save(&mut self, run: &dyn AnyRun) -> Result<()> {
        if !self.signal_seen && signals::received().is_some() {
            self.signal_seen = true;
            tell("\nfinishing the epoch and saving; a second signal stops at once");
        }
        if let Err(error) = self.save(run) {
            if self.folder.is_gone() {
                return Err(error);
            }
            self.metrics = None;
            self.last = Instant::now();
            tell(&format!("warning: the run goes on, but is not saved: {error:#}"));
        }
        Ok(())
    }
}

/// The files that one looks at or uses elsewhere.
fn leave(folder: &Folder, scene: &Scene, run: &dyn AnyRun) -> Result<()> {
    let task = scene.kind.name();
    let title = format!("{task}, field {}, seed {}", scene.field.0, scene.seed);
    let about = format!("physgrad {}, {task}, policy: {}", env!("CARGO_PKG_VERSION"), scene.table["policy"]);
    folder.write(POLICY, run.safetensors(about)?)?;
    folder.write(LEARNING_CURVE, outputs::learning_curve(&title, run.records()))?;
    let rollouts = run.rollouts(0..ROLLOUTS);
    folder.write(TRAJECTORY, outputs::trajectories(scene, &rollouts)?)?;
    folder.write(ANIMATION, outputs::film(scene, &rollouts[0]))
}
