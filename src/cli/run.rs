//! One run in its folder: train, save, resume, and leave files behind.

use super::folder::{CHECKPOINT, Folder, SETTINGS};
use super::outputs;
use super::scene::{Network, PolicyOf, Scene};
use super::settings::{Precision, Settings};
use anyhow::{Context, Result};
use physgrad::{Float, Record, Session, Skip, System, Trainer};
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
    /// An epoch is done.
    fn epoch(&mut self, record: &Record, skips: &[Skip]);
}

/// A run that is done, or was interrupted.
pub struct Finished {
    pub records: Vec<Record>,
    pub interrupted: bool,
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
    let task = S::build(&settings.system, &settings.loss, settings.horizon);
    let policy = policy(settings, &task);
    let trainer = Trainer::new(task, policy).precision::<F>().field(settings.field.0).training(settings.training(workers));
    let mut session = trainer.session()?;
    let identity = settings.identity();
    if resume {
        let file = folder.file(CHECKPOINT);
        let restored = session.restore(&folder.read(CHECKPOINT)?, &identity);
        restored.with_context(|| format!("cannot resume from {}", file.display()))?;
        watch.resumed(session.records().len());
    }
    folder.write(SETTINGS, settings.to_table().to_string())?;
    // Rows that were written after the checkpoint are computed again.
    let mut metrics = outputs::Metrics::create(folder, session.records())?;

    let mut saved = Instant::now();
    let mut trained = Ok(());
    while !session.is_done() && !INTERRUPTED.load(Ordering::Relaxed) {
        match session.epoch() {
            Ok(record) => metrics.row(record)?,
            Err(error) => {
                trained = Err(error);
                break;
            }
        }
        if let Some(record) = session.records().last() {
            watch.epoch(record, session.skips());
        }
        if saved.elapsed() >= SAVE_EVERY {
            folder.write(CHECKPOINT, session.checkpoint(&identity))?;
            saved = Instant::now();
        }
    }
    if trained.is_ok() {
        // A run that broke off within an epoch keeps the checkpoint of a whole one.
        folder.write(CHECKPOINT, session.checkpoint(&identity))?;
    }
    leave(folder, settings, &session)?;
    trained.with_context(|| format!("what was learned up to then is in {}", folder.path().display()))?;
    Ok(Finished { records: session.records().to_vec(), interrupted: !session.is_done() })
}

/// The policy from all state components to all controls.
fn policy<S: Scene>(settings: &Settings<S>, task: &S) -> PolicyOf<S> {
    settings.policy.build(task.system().state_dim(), task.system().control_dim())
}

/// The files that one looks at or uses elsewhere.
fn leave<S: Scene, F: Float>(folder: &Folder, settings: &Settings<S>, session: &Session<S, PolicyOf<S>, F>) -> Result<()> {
    let title = format!("{}, field {}, seed {}", S::NAME, settings.field.0, settings.seed);
    let about = format!("physgrad {}, {}, policy: {:?}", settings.physgrad, S::NAME, settings.policy);
    folder.write("policy.safetensors", outputs::safetensors(about, session.policy(), session.weights().theta())?)?;
    folder.write("learning_curve.svg", outputs::learning_curve(&title, session.records()))?;
    let rollouts = outputs::rollouts(session);
    folder.write("trajectory.csv", outputs::trajectories(session.task(), &rollouts)?)?;
    folder.write("animation.svg", session.task().animation(&rollouts[0].states, &rollouts[0].controls).to_svg())
}
