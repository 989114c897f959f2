//! One run in its folder: train, save, resume, and leave files behind.

use super::folder::{ANIMATION, CHECKPOINT, Folder, LEARNING_CURVE, POLICY, SETTINGS, TRAJECTORY};
use super::outputs;
use super::saved;
use super::scene::{PolicyOf, Scene};
use super::settings::{Precision, Settings};
use anyhow::{Result, bail};
use physgrad::{Divergence, Float, Record, Session, Skip, TrainError};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two checkpoints: at most so much work is lost when the process is killed.
const SAVE_EVERY: Duration = Duration::from_secs(5);

/// Set by Ctrl-C: the epoch under way is finished, and the run saved.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// What a run tells while it goes on.
pub trait Watch {
    /// It goes on after this many epochs of an earlier session.
    fn resumed(&mut self, _epochs: usize) {}
    /// An epoch is done, in which these updates and evaluations were not finite.
    fn epoch(&mut self, record: &Record, skips: &[Skip], diverged: [Option<Divergence>; 2]);
}

/// A run that is done, was interrupted, or broke off.
pub struct Finished {
    pub records: Vec<Record>,
    pub interrupted: bool,
    /// Why it broke off; the session was then left as it was after the last whole epoch.
    pub broken: Option<TrainError>,
}

/// Sets up the thread pool and says how many threads it has.
pub fn threads(asked: Option<usize>) -> Result<usize> {
    if let Some(threads) = asked {
        if threads == 0 {
            bail!("--threads is 0; allowed: 1 or more");
        }
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    Ok(rayon::current_num_threads())
}

/// Runs the settings in the folder. If `resume`, goes on from its checkpoint.
pub fn run<S: Scene>(
    folder: &Folder,
    settings: &Settings<S>,
    workers: usize,
    resume: bool,
    watch: &mut dyn Watch,
) -> Result<Finished> {
    match settings.precision {
        Precision::F32 => run_in::<S, f32>(folder, settings, workers, resume, watch),
        Precision::F64 => run_in::<S, f64>(folder, settings, workers, resume, watch),
    }
}

fn run_in<S: Scene, F: Float>(
    folder: &Folder,
    settings: &Settings<S>,
    workers: usize,
    resume: bool,
    watch: &mut dyn Watch,
) -> Result<Finished> {
    if INTERRUPTED.load(Ordering::Relaxed) {
        // Before it began: there is nothing to save, and an untrained policy is not worth a film.
        return Ok(Finished { records: Vec::new(), interrupted: true, broken: None });
    }
    let mut session = saved::fresh::<S, F>(settings, workers)?;
    let identity = settings.identity();
    if resume {
        saved::restore(folder, settings, &mut session)?;
        let done = session.records().len();
        if done > settings.epochs {
            bail!("the run in {} has {done} epochs already, and asked for are {}", folder.path().display(), settings.epochs);
        }
        watch.resumed(done);
    }
    folder.write(SETTINGS, settings.to_table().to_string())?;
    // Rows that were written after the checkpoint are computed again.
    let mut metrics = outputs::Metrics::create(folder, session.records())?;

    let mut saved: Option<Instant> = None;
    let mut broken = None;
    while !session.is_done() && !INTERRUPTED.load(Ordering::Relaxed) {
        match session.epoch() {
            Ok(record) => metrics.row(record)?,
            Err(error) => {
                broken = Some(error);
                break;
            }
        }
        if let Some(record) = session.records().last() {
            watch.epoch(record, session.skips(), session.diverged());
        }
        if saved.is_none_or(|at| at.elapsed() >= SAVE_EVERY) {
            folder.write(CHECKPOINT, session.checkpoint(&identity))?;
            saved = Some(Instant::now());
        }
    }
    folder.write(CHECKPOINT, session.checkpoint(&identity))?;
    leave(folder, settings, &session)?;
    let interrupted = broken.is_none() && !session.is_done();
    Ok(Finished { records: session.records().to_vec(), interrupted, broken })
}

/// The files that one looks at or uses elsewhere.
fn leave<S: Scene, F: Float>(folder: &Folder, settings: &Settings<S>, session: &Session<S, PolicyOf<S>, F>) -> Result<()> {
    let title = format!("{}, field {}, seed {}", S::NAME, settings.field.0, settings.seed);
    let about = format!("physgrad {}, {}, policy: {:?}", settings.physgrad, S::NAME, settings.policy);
    folder.write(POLICY, outputs::safetensors(about, session.policy(), session.weights().theta())?)?;
    folder.write(LEARNING_CURVE, outputs::learning_curve(&title, session.records()))?;
    let rollouts = outputs::rollouts(session, 0..outputs::ROLLOUTS);
    folder.write(TRAJECTORY, outputs::trajectories(session.task(), &rollouts)?)?;
    folder.write(ANIMATION, session.task().animation(&rollouts[0].states, &rollouts[0].controls).to_svg())
}
