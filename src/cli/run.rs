//! One run in its folder: train, save, resume, and leave files behind.

use super::any_run::AnyRun;
use super::folder::{ANIMATION, CHECKPOINT, Folder, LEARNING_CURVE, POLICY, SETTINGS, TRAJECTORY};
use super::outputs;
use super::saved;
use super::scene::Scene;
use anyhow::{Result, bail};
use physgrad::{Divergence, Record, Skip, TrainError};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two checkpoints: at most so much work is lost when the process is killed.
pub const SAVE_EVERY: Duration = Duration::from_secs(5);

/// Set by Ctrl-C: the epoch under way is finished, and the run saved.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// What a run tells while it goes on.
pub trait Watch {
    /// It goes on after this many epochs of an earlier run.
    fn resumed(&mut self, _epochs: usize) {}
    /// An epoch is done.
    fn epoch(&mut self, told: Told);
}

/// What there is to say of an epoch.
#[derive(Clone, Copy)]
pub struct Told<'a> {
    pub record: &'a Record,
    /// Updates that were not taken, and evaluations that were not finite.
    pub skips: &'a [Skip],
    pub diverged: [Option<Divergence>; 2],
    /// What makes its gradients untrustworthy, unless it was said before.
    pub warnings: &'a [String],
}

/// A run that is done, was interrupted, or broke off.
pub struct Finished {
    pub records: Vec<Record>,
    pub interrupted: bool,
    /// Why it broke off; it was then left as it was after the last whole epoch.
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

/// Runs the scene in the folder, and saves it so often. If `resume`, goes on from its checkpoint.
pub fn run(
    folder: &Folder,
    scene: &Scene,
    workers: usize,
    resume: bool,
    save_every: Duration,
    watch: &mut dyn Watch,
) -> Result<Finished> {
    if INTERRUPTED.load(Ordering::Relaxed) {
        // Before it began: there is nothing to save, and an untrained policy is not worth a film.
        return Ok(Finished { records: Vec::new(), interrupted: true, broken: None });
    }
    let mut run = scene.open(workers)?;
    let identity = scene.identity();
    if resume {
        saved::restore(folder, scene, &mut *run)?;
        let done = run.records().len();
        if done > scene.epochs {
            bail!("the run in {} has {done} epochs already, and asked for are {}", folder.path().display(), scene.epochs);
        }
        watch.resumed(done);
    }
    // First the checkpoint: where there are settings there is a run, and whoever kills us now can resume it.
    folder.write(CHECKPOINT, run.checkpoint(&identity))?;
    folder.write(SETTINGS, scene.table.to_string())?;
    // Rows that were written after the checkpoint are computed again.
    let mut metrics = outputs::Metrics::create(folder, run.records())?;

    let mut saved: Option<Instant> = None;
    let mut broken = None;
    let mut warned = 0;
    while !run.is_done() && !INTERRUPTED.load(Ordering::Relaxed) {
        match run.epoch() {
            Ok(record) => metrics.row(record)?,
            Err(error) => {
                broken = Some(error);
                break;
            }
        }
        if let Some(record) = run.records().last() {
            // Once for each flow of a run: the numbers differ in every epoch.
            let warnings: Vec<String> = record.warnings(scene.horizon, scene.precision.epsilon());
            let news = warnings.len() > warned;
            warned = warned.max(warnings.len());
            let warnings = if news { &warnings[..] } else { &[] };
            watch.epoch(Told { record, skips: run.skips(), diverged: run.diverged(), warnings });
        }
        if saved.is_none_or(|at| at.elapsed() >= save_every) {
            folder.write(CHECKPOINT, run.checkpoint(&identity))?;
            saved = Some(Instant::now());
        }
    }
    folder.write(CHECKPOINT, run.checkpoint(&identity))?;
    leave(folder, scene, &*run)?;
    let interrupted = broken.is_none() && !run.is_done();
    Ok(Finished { records: run.records().to_vec(), interrupted, broken })
}

/// The files that one looks at or uses elsewhere.
fn leave(folder: &Folder, scene: &Scene, run: &dyn AnyRun) -> Result<()> {
    let task = scene.kind.name();
    let title = format!("{task}, field {}, seed {}", scene.field.0, scene.seed);
    let about = format!("physgrad {}, {task}, policy: {}", env!("CARGO_PKG_VERSION"), scene.table["policy"]);
    folder.write(POLICY, run.safetensors(about)?)?;
    folder.write(LEARNING_CURVE, outputs::learning_curve(&title, run.records()))?;
    let rollouts = run.rollouts(0..outputs::ROLLOUTS);
    folder.write(TRAJECTORY, outputs::trajectories(scene, &rollouts)?)?;
    folder.write(ANIMATION, outputs::film(scene, &rollouts[0]))
}
