//! What a page needs to know of a run, read from its folder.

use super::counted;
use super::lengths::Lengths;
use crate::program::any_run::AnyRun;
use crate::program::folder::Folder;
use crate::program::outputs;
use crate::program::parallel;
use crate::program::saved;
use crate::program::scene::Scene;
use crate::program::statistics::Outcome;
use anyhow::{Result, bail};
use physgrad::{Field, Record, differences};
use toml::Table;

/// A run of any task and precision.
pub struct Inspected {
    pub task: &'static str,
    pub field: Field,
    pub seed: u64,
    /// Epochs asked for.
    pub epochs: usize,
    /// Steps of a rollout, and the distance of its numbers at 1.
    pub horizon: usize,
    pub epsilon: f64,
    pub settings: Table,
    pub records: Vec<Record>,
    pub end: End,
    /// Of the first run of every field only.
    pub close: Option<Close>,
}

/// How a run ended.
pub enum End {
    Done,
    Interrupted,
    /// Why its next epoch cannot be trained.
    Broke(String),
}

/// What takes a look at rollouts.
pub struct Close {
    /// Of R and M, before the first epoch.
    pub before: [Lengths; 2],
    /// The same as the run was left.
    pub after: [Lengths; 2],
    /// An animated SVG.
    pub film: String,
}

impl Inspected {
    pub fn outcome(&self) -> Outcome<'_> {
        Outcome { field: self.field, seed: self.seed, records: &self.records, broken: matches!(self.end, End::Broke(_)) }
    }

    pub fn name(&self) -> String {
        format!("{} seed {}", self.field.letter(), self.seed)
    }

    /// What the run did not finish, if so, in words.
    pub fn trouble(&self) -> Option<String> {
        let done = counted(self.records.len(), "epoch");
        let asked = self.epochs;
        match &self.end {
            End::Done => None,
            End::Interrupted => Some(format!("was interrupted after {done} of {asked} and can be resumed")),
            End::Broke(why) => Some(format!("broke off after {done} of {asked}: {why}")),
        }
    }
}

/// The runs in these folders by field and seed; the first of every field is looked at closely.
pub fn inspect(folders: &[Folder]) -> Result<Vec<Inspected>> {
    let mut runs = folders.iter().map(|folder| Ok((folder, saved::scene(folder)?))).collect::<Result<Vec<_>>>()?;
    for run in &runs {
        check_comparable(&runs[0], run)?;
    }
    // In the order in which `compare` has its fields if it is not told another.
    runs.sort_by_key(|(_, scene)| ("RMSCN".find(scene.field.0.letter()), scene.seed));
    let first = |i: usize| i == 0 || runs[i - 1].1.field != runs[i].1.field;
    let all: Vec<(usize, &(&Folder, Scene))> = runs.iter().enumerate().collect();
    parallel::map(&all, |&(i, (folder, scene))| open(folder, scene, first(i))).into_iter().collect()
}

/// An error unless the two can stand in one comparison.
fn check_comparable(first: &(&Folder, Scene), other: &(&Folder, Scene)) -> Result<()> {
    let [(here, task), (there, other_task)] = [first, other].map(|(folder, scene)| (folder.path().display(), scene.kind.name()));
    if task != other_task {
        bail!("{here} ({task}) and {there} ({other_task}) are not runs of one comparison; report each by itself");
    }
    let [first, other] = [first, other].map(|(_, scene)| scene.comparable());
    if first != other {
        bail!(
            "{here} and {there} are not runs of one comparison: apart from field, seed and epochs, these settings differ:\n{}",
            differences(&first, &other)
        );
    }
    Ok(())
}

fn open(folder: &Folder, scene: &Scene, closely: bool) -> Result<Inspected> {
    let mut run = scene.open(1)?;
    let before = closely.then(|| run.lengths());
    saved::restore(folder, scene, &mut *run)?;
    let film = || outputs::film(scene, &run.rollouts(0..1)[0]);
    let close = before.map(|before| Close { before, after: run.lengths(), film: film() });
    Ok(Inspected {
        task: scene.kind.name(),
        field: scene.field.0,
        seed: scene.seed,
        epochs: scene.epochs,
        horizon: scene.horizon,
        epsilon: scene.precision.epsilon(),
        settings: scene.table.clone(),
        records: run.records().to_vec(),
        close,
        end: end(&mut *run, scene.epochs),
    })
}

/// A checkpoint does not say why there is none after it. But the same epoch fails again where it failed.
fn end(run: &mut dyn AnyRun, epochs: usize) -> End {
    if run.records().len() >= epochs {
        return End::Done;
    }
    match run.advance(&|| false) {
        Ok(_) => End::Interrupted,
        Err(why) => End::Broke(why.to_string()),
    }
}
