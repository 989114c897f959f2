//! Data of a run for the page, from its folder or from memory.

use crate::operations::adjoint_norms::AdjointNorms;
use crate::operations::session::{AnyRun, Epoch};
use crate::platform::folder::Folder;
use crate::platform::parallel;
use crate::platform::terminal::counted;
use crate::runs::run::{located, numbers};
use crate::runs::saved;
use crate::runs::saved::SceneRuns;
use crate::runs::statistics::{InScene, Method, Outcome, position};
use crate::tasks::Scene;
use anyhow::{Result, bail};
use physgrad::Field;
use physgrad::train::{Record, TrainedNumber, differences};
use physgrad_plot::Animation;
use toml::Table;

/// Data of one run, independent of task and precision.
pub struct Inspected {
    pub task: &'static str,
    pub field: Field,
    pub seed: u64,
    /// Total number of epochs in the settings.
    pub epochs: usize,
    /// Time steps of a rollout.
    pub horizon: usize,
    /// Machine epsilon of the precision.
    pub epsilon: f64,
    pub settings: Table,
    pub records: Vec<Record>,
    /// Test loss of the initial policy.
    pub untrained: f64,
    pub end: End,
    pub numbers: Vec<ReportedNumber>,
    /// Present only for the first run of each field.
    pub rollouts: Option<RolloutData>,
}

/// A trained number of a run.
pub struct ReportedNumber {
    pub name: String,
    pub bounds: [f64; 2],
    /// Values before the first epoch, after the last one, and after that with the lowest test loss.
    pub values: [f64; 3],
}

/// Runs of one scene.
pub struct InspectedScene {
    /// Name in a comparison of several scenes; otherwise empty.
    pub name: String,
    /// Runs, sorted by field and seed.
    pub runs: Vec<Inspected>,
}

impl InspectedScene {
    pub fn read(scene: SceneRuns) -> Result<Self> {
        let mut runs = inspect(&scene.runs)?;
        let rollouts = runs.iter_mut().filter_map(|run| run.rollouts.as_mut());
        Animation::share_scale(
            &mut rollouts.map(|rollouts| &mut rollouts.animation).collect::<Vec<_>>(),
        );
        Ok(Self { name: scene.name, runs })
    }

    pub fn outcomes(&self) -> InScene<'_> {
        let runs = self.runs.iter().map(Inspected::outcome).collect();
        InScene { name: &self.name, runs, chosen: Vec::new() }
    }

    /// Title of a section about this scene.
    pub fn title(&self, title: &str) -> String {
        if self.name.is_empty() { title.into() } else { format!("{}: {title}", self.name) }
    }
}

/// State in which the run ended.
pub enum End {
    Done,
    Interrupted,
    /// Message of the error that ends the next epoch.
    Failed(String),
}

/// Data computed from rollouts.
pub struct RolloutData {
    /// Adjoint norms of R and M before the first epoch.
    pub before: [AdjointNorms; 2],
    /// Adjoint norms of R and M under the saved policy.
    pub after: [AdjointNorms; 2],
    pub animation: Animation,
}

impl Inspected {
    /// Data of a run in memory, at its current state.
    pub fn of(scene: &Scene, run: &dyn AnyRun) -> Result<Self> {
        let identity = scene.identity();
        inspected(scene, |copy| Ok(copy.restore(&run.checkpoint(&identity), &identity)?), true)
    }

    pub fn outcome(&self) -> Outcome<'_> {
        Outcome {
            method: Method::Field(self.field),
            field: self.field,
            seed: self.seed,
            records: &self.records,
            untrained: self.untrained,
            diverged: matches!(self.end, End::Failed(_)),
        }
    }

    pub fn name(&self) -> String {
        format!("{} seed {}", self.field.letter(), self.seed)
    }

    /// Describes an unfinished run. None if the run is complete.
    pub fn incomplete(&self) -> Option<String> {
        let done = counted(self.records.len(), "epoch");
        let total = self.epochs;
        match &self.end {
            End::Done => None,
            End::Interrupted => Some(format!(
                "has {done} of {total}: it is still training, or was interrupted and can be resumed"
            )),
            End::Failed(error) => Some(format!("failed after {done} of {total}: {error}")),
        }
    }
}

/// Reads the runs in these folders, sorted by field and seed. Adds rollout data for the first run
/// of each field.
fn inspect(folders: &[Folder]) -> Result<Vec<Inspected>> {
    let mut runs = folders
        .iter()
        .map(|folder| Ok((folder, saved::scene(folder)?)))
        .collect::<Result<Vec<_>>>()?;
    for run in &runs {
        check_comparable(&runs[0], run)?;
    }
    // Sorts the fields in the default order of `compare`.
    runs.sort_by_key(|(_, scene)| (position(scene.field.0.letter()), scene.seed));
    let first = |i: usize| i == 0 || runs[i - 1].1.field != runs[i].1.field;
    let all: Vec<(usize, &(&Folder, Scene))> = runs.iter().enumerate().collect();
    let saved =
        |folder, scene, first| inspected(scene, |run| saved::restore(folder, scene, run), first);
    parallel::map(&all, |&(i, (folder, scene))| saved(folder, scene, first(i)))
        .into_iter()
        .collect()
}

/// Checks that two runs belong to the same comparison.
///
/// # Errors
/// The tasks differ, or the settings in [`Scene::comparable`] differ.
fn check_comparable(first: &(&Folder, Scene), other: &(&Folder, Scene)) -> Result<()> {
    let [(path, task), (other_path, other_task)] =
        [first, other].map(|(folder, scene)| (folder.path().display(), scene.task.name()));
    if task != other_task {
        bail!(
            "{path} ({task}) and {other_path} ({other_task}) are not runs of one comparison; report each separately"
        );
    }
    let [first, other] = [first, other].map(|(_, scene)| scene.comparable());
    if first != other {
        bail!(
            "{path} and {other_path} are not runs of one comparison; report each separately. Apart from field, seed and \
             epochs, these settings differ:\n{}",
            differences(&first, &other)
        );
    }
    Ok(())
}

/// Opens a run, restores its saved state by `restore`, and collects its data.
fn inspected(
    scene: &Scene,
    restore: impl FnOnce(&mut dyn AnyRun) -> Result<()>,
    with_rollouts: bool,
) -> Result<Inspected> {
    let mut run = scene.open(1)?;
    let before = with_rollouts.then(|| run.adjoint_norms());
    let untrained = run.untrained_loss();
    restore(&mut *run)?;
    let numbers = reported(scene, &*run)?;
    let animation = || scene.animation(&run.rollouts(0..1)[0]);
    let rollouts = before.map(|before| RolloutData {
        before,
        after: run.adjoint_norms(),
        animation: animation(),
    });
    Ok(Inspected {
        task: scene.task.name(),
        field: scene.field.0,
        seed: scene.seed,
        epochs: scene.epochs,
        horizon: scene.horizon,
        epsilon: scene.precision.epsilon(),
        settings: scene.table(),
        records: run.records().to_vec(),
        untrained,
        rollouts,
        end: end(&mut *run, scene),
        numbers,
    })
}

/// The trained numbers of a run.
fn reported(scene: &Scene, run: &dyn AnyRun) -> Result<Vec<ReportedNumber>> {
    let starts = scene.starts_of_numbers()?;
    let [last, best] = [Epoch::Last, Epoch::Best].map(|epoch| numbers(scene, run, epoch));
    let values = starts.into_iter().zip(last).zip(best);
    let numbers = scene.trained_numbers().into_iter().zip(values);
    let number = |(number, ((start, (_, last)), (_, best))): (TrainedNumber, _)| ReportedNumber {
        name: number.name,
        bounds: number.map.bounds(),
        values: [start, last, best],
    };
    Ok(numbers.map(number).collect())
}

/// Determines the end of the run. A checkpoint does not record an error, so this function trains
/// the next epoch: training is deterministic, and a failed run fails again.
fn end(run: &mut dyn AnyRun, scene: &Scene) -> End {
    if run.records().len() >= scene.epochs {
        return End::Done;
    }
    match run.advance(&|| false) {
        Ok(_) => End::Interrupted,
        Err(error) => End::Failed(format!("{:#}", located(scene, error))),
    }
}
