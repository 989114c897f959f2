//! Comparisons: many runs in parallel, one thread per run. Resumes runs that are in their folders.
//!
//! A run that ended has a file `end.toml`. Shards skip such runs, and `merge` reads them.

mod train_all;
mod train_shard;

pub use train_all::train_all;
pub use train_shard::train_shard;

use crate::platform::folder::{COMPARISON, END, Folder, RUNS};
use crate::platform::lock::Locked;
use crate::platform::parallel;
use crate::runs::run::{self, End, Finished, NoUpdate, Observer, SAVE_EVERY};
use crate::runs::saved::{self, check_resumable};
use crate::runs::statistics::{Method, Outcome};
use crate::scenes::plan::MAX_PLAN;
use crate::settings::FieldName;
use crate::tasks::Scene;
use anyhow::{Context, Result, anyhow, bail};
use physgrad::Field;
use physgrad::train::{Record, differences};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// Runs of one training configuration with several fields and seeds.
pub struct Comparison {
    /// Folder of the folders of the runs.
    folder: Folder,
    runs: Vec<Run>,
    /// Prefix of messages, which distinguishes several comparisons. May be empty.
    label: String,
}

/// Run with one field and seed, with its records.
struct Run {
    field: Field,
    seed: u64,
    scene: Scene,
    folder: Folder,
    records: Vec<Record>,
    /// None before the end of the run.
    end: Option<Ending>,
}

/// Contents of `end.toml`: the end of a run.
#[derive(Debug, Serialize, Deserialize)]
struct Ending {
    /// Number of epochs in the settings.
    epochs: usize,
    /// True if the run applied no update.
    no_update: bool,
    /// Error that ended the run before all epochs were complete.
    error: Option<String>,
}

impl Ending {
    /// None for an interrupted run.
    fn new(epochs: usize, end: &End) -> Option<Self> {
        let (no_update, error) = match end {
            End::Interrupted => return None,
            End::Complete => (false, None),
            End::Failed(error) => (false, Some(error)),
            End::NoUpdate(error) => (true, error.as_ref()),
        };
        Some(Self { epochs, no_update, error: error.map(|error| format!("{error:#}")) })
    }
}

impl Run {
    /// Returns whether the folder already contains the run.
    ///
    /// # Errors
    /// The folder contains a run with other settings, or with settings that cannot be read.
    fn resumes(&self) -> Result<bool> {
        if !saved::has_run(&self.folder) {
            return Ok(false);
        }
        check_resumable(&self.folder, &self.scene).map(|()| true)
    }

    /// Trains in the run's folder, or resumes there. Waits while another process holds the lock.
    fn run(&self, observer: &mut dyn Observer) -> Result<Finished> {
        match self.folder.clone().wait_and_lock()? {
            Some(folder) => self.run_in(folder, observer),
            None => {
                Ok(Finished { records: Vec::new(), numbers: Vec::new(), end: End::Interrupted })
            }
        }
    }

    /// Trains as [`run`](Self::run) does, but does not wait. Returns None if the run has ended or
    /// another process holds the lock.
    fn run_if_free(&self, observer: &mut dyn Observer) -> Result<Option<Finished>> {
        if self.saved_end()?.is_some() {
            return Ok(None);
        }
        match self.folder.try_lock()? {
            // Another process may have ended the run before this process locked the folder.
            Some(folder) if self.saved_end()?.is_none() => self.run_in(folder, observer).map(Some),
            _ => Ok(None),
        }
    }

    fn run_in(&self, folder: Locked, observer: &mut dyn Observer) -> Result<Finished> {
        let resume = self.resumes()?;
        let folder = if resume { folder } else { folder.without_run()? };
        // One thread per run: the parallel runs occupy all cores.
        let finished = run::run(
            &folder,
            &self.scene,
            &mut *self.scene.open(1)?,
            resume,
            SAVE_EVERY,
            None,
            observer,
        )?;
        if let Some(end) = Ending::new(self.scene.epochs, &finished.end) {
            folder.write(END, toml::to_string(&end)?)?;
        }
        Ok(finished)
    }

    /// End of the run, from its folder. None if the run has not ended, or has ended with another
    /// number of epochs in its settings.
    fn saved_end(&self) -> Result<Option<Ending>> {
        if !self.folder.has(END) || !saved::has_run(&self.folder) {
            return Ok(None);
        }
        let end: Ending = read_toml(&self.folder, END)?;
        Ok(Some(end).filter(|end| end.epochs == self.scene.epochs))
    }

    /// Records of the run, from its folder.
    ///
    /// # Errors
    /// The folder contains a run with other settings, a run with more epochs than its comparison,
    /// or a run that cannot be restored.
    fn saved_records(&self) -> Result<Vec<Record>> {
        self.resumes()?;
        let scene = saved::scene(&self.folder)?;
        let mut run = scene.open(1)?;
        saved::restore(&self.folder, &scene, &mut *run)?;
        let (done, epochs) = (run.records().len(), self.scene.epochs);
        if done > epochs {
            bail!(
                "the run has {done} epochs, but its comparison has {epochs}; repeat `compare` with --epochs {done}"
            );
        }
        Ok(run.records().to_vec())
    }

    /// Outcome of the run, with the test loss of its initial policy. None if the run has not ended.
    ///
    /// # Errors
    /// The settings of the run cannot be read.
    fn outcome(&self) -> Result<Option<Outcome<'_>>> {
        let Some(end) = &self.end else { return Ok(None) };
        Ok(Some(Outcome {
            method: Method::Field(self.field),
            field: self.field,
            seed: self.seed,
            records: &self.records,
            untrained: saved::scene(&self.folder)?.open(1)?.untrained_loss(),
            diverged: end.error.is_some(),
        }))
    }
}

/// Contents of a TOML file in the folder.
fn read_toml<T: DeserializeOwned>(folder: &Folder, name: &str) -> Result<T> {
    let bytes = folder.read_up_to(name, MAX_PLAN)?;
    // Omits the line of the error, which may be long.
    let parse = |text: &str| toml::from_str(text).map_err(|error| anyhow!("{}", error.message()));
    let read = || -> Result<T> { parse(std::str::from_utf8(&bytes)?) };
    read().with_context(|| format!("cannot read {}", folder.file(name).display()))
}

/// Writes a plan, which `merge` reads.
///
/// # Errors
/// `shard` is true, and the folder has another plan. The file cannot be read or written.
pub fn write_plan(folder: &Folder, plan: &str, shard: bool) -> Result<()> {
    let is_there = folder.has(COMPARISON);
    let saved = is_there.then(|| folder.read_up_to(COMPARISON, MAX_PLAN)).transpose()?;
    match saved {
        Some(saved) if saved == plan.as_bytes() => Ok(()),
        Some(saved) if shard => bail!(
            "{} has the plan of another comparison; give all shards equal options, or choose another folder with --out. \
             These lines differ:\n{}",
            folder.file(COMPARISON).display(),
            differences(&String::from_utf8_lossy(&saved), plan)
        ),
        _ => folder.write(COMPARISON, plan),
    }
}

impl Comparison {
    /// Plans one run per field and seed. The folders need not exist.
    pub fn plan(
        label: &str,
        base: &Scene,
        fields: &[FieldName],
        seeds: u64,
        folder: &Folder,
    ) -> Result<Self> {
        let last = base
            .seed
            .checked_add(seeds.saturating_sub(1))
            .filter(|&last| i64::try_from(last).is_ok());
        let last = last.with_context(|| {
            format!(
                "{seeds} seeds from {} on exceed the largest seed, {}; use smaller seeds",
                base.seed,
                i64::MAX
            )
        })?;
        let runs = folder.inside(RUNS)?;
        let pairs =
            fields.iter().flat_map(|&field| (base.seed..=last).map(move |seed| (field, seed)));
        let run = |(field, seed): (FieldName, u64)| {
            let scene = base.with(field, seed);
            let folder = runs.inside(&format!("{}-{seed}", field.0.letter()))?;
            Ok(Run { field: field.0, seed, folder, scene, records: Vec::new(), end: None })
        };
        let all = pairs.map(run).collect::<Result<_>>()?;
        Ok(Self { runs: all, folder: runs, label: label.to_owned() })
    }

    /// Returns whether the folder of its runs exists.
    pub fn has_folder(&self) -> bool {
        self.folder.path().is_dir()
    }

    /// Returns whether at least one run of the comparison is in its folder.
    pub fn has_runs(&self) -> bool {
        self.runs.iter().any(|run| saved::has_run(&run.folder))
    }

    /// Checks that every existing run has the settings of the comparison, up to field and seed.
    ///
    /// # Errors
    /// A run has other settings, or settings that cannot be read.
    pub fn check_resumable(&self) -> Result<()> {
        self.runs.iter().try_for_each(|run| run.resumes().map(drop))?;
        // Runs of other fields or seeds have the settings of the first one.
        let is_there = self.folder.path().is_dir();
        let folders = if is_there { saved::folders(&self.folder)? } else { Vec::new() };
        let first = folders.iter().find(|folder| saved::has_run(folder));
        let (Some(first), Some(run)) = (first, self.runs.first()) else { return Ok(()) };
        let [found, expected] = [saved::scene(first)?, run.scene.clone()];
        let [found, expected] = [found, expected].map(|scene| scene.comparable());
        if found != expected {
            bail!(
                "{} holds a run with other settings; choose another folder with --out. These lines differ:\n{}",
                first.path().display(),
                differences(&found, &expected)
            );
        }
        Ok(())
    }

    /// Folders of the runs that ended.
    pub fn ended(&self) -> Vec<Folder> {
        self.runs.iter().filter(|run| run.end.is_some()).map(|run| run.folder.clone()).collect()
    }

    /// Outcomes of the runs that ended, grouped by field.
    ///
    /// # Errors
    /// The settings of a run cannot be read.
    pub fn outcomes(&self) -> Result<Vec<Outcome<'_>>> {
        self.runs.iter().filter_map(|run| run.outcome().transpose()).collect()
    }

    fn label(&self, run: &Run) -> String {
        let space = if self.label.is_empty() { "" } else { " " };
        format!("{}{space}{} seed {}", self.label, run.field.letter(), run.seed)
    }
}

/// Largest number of seeds of a comparison.
const MAX_SEEDS: u64 = 10_000;

/// Checks the options of a comparison that are given.
///
/// # Errors
/// `seeds` is 0 or above [`MAX_SEEDS`], `epochs` is 0, or a field occurs twice.
pub fn check_options(
    fields: Option<&[FieldName]>,
    seeds: Option<u64>,
    epochs: Option<usize>,
) -> Result<()> {
    if let Some(seeds) = seeds.filter(|seeds| !(1..=MAX_SEEDS).contains(seeds)) {
        bail!("--seeds is {seeds}; allowed: 1 to {MAX_SEEDS}");
    }
    if epochs == Some(0) {
        bail!("--epochs is 0; allowed: 1 or more");
    }
    check_distinct("--fields", fields.into_iter().flatten().map(|field| field.0.name()))
}

/// Returns an error if an option contains a name twice.
pub fn check_distinct<'a>(option: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
    let mut seen = HashSet::new();
    match names.into_iter().find(|name| !seen.insert(*name)) {
        Some(name) => bail!("{option} names {name} twice; give each name once"),
        None => Ok(()),
    }
}

/// Checks that a scene can open a session with each field.
///
/// # Errors
/// A setting is unusable, for example a memory budget that is too small.
pub fn check_sessions(scene: &Scene, fields: &[FieldName]) -> Result<()> {
    fields.iter().try_for_each(|&field| scene.with(field, scene.seed).open(1).map(drop))
}

/// Largest number of missing runs that a message names.
const FEW: usize = 4;

/// Runs that failed, applied no update or have not ended.
pub struct Ended {
    pub interrupted: bool,
    /// One message per failed run.
    failed: Vec<String>,
    /// Names of the runs that applied no update.
    no_update: Vec<String>,
    /// Names of the runs that have not ended. Only [`read_all`] fills this list.
    missing: Vec<String>,
    /// Number of all runs.
    runs: usize,
}

impl Ended {
    fn of(runs: usize) -> Self {
        Self {
            interrupted: false,
            failed: Vec::new(),
            no_update: Vec::new(),
            missing: Vec::new(),
            runs,
        }
    }

    fn add(&mut self, label: String, end: &Ending) {
        match &end.error {
            _ if end.no_update => self.no_update.push(label),
            Some(error) => self.failed.push(format!("{label}: {error}")),
            None => {}
        }
    }

    /// Returns an error that counts the runs that have not ended and names the first ones, if any.
    /// Otherwise, the error lists the runs that failed, if any, or else the runs that applied no
    /// update, if any.
    pub fn into_result(self) -> Result<()> {
        if !self.missing.is_empty() {
            let count = self.missing.len();
            let mut names = self.missing[..count.min(FEW)].join(", ");
            if count > FEW {
                names += &format!(" and {} more", count - FEW);
            }
            bail!(
                "{count} of {} runs are missing or not complete; repeat the command that trains them: {names}",
                self.runs
            )
        }
        if !self.failed.is_empty() {
            bail!("{} of {} runs failed:\n{}", self.failed.len(), self.runs, self.failed.join("\n"))
        }
        if !self.no_update.is_empty() {
            let count = format!("{} of {} runs", self.no_update.len(), self.runs);
            bail!(NoUpdate(format!("{count} ({})", self.no_update.join(", "))));
        }
        Ok(())
    }
}

/// All runs, with their names in messages.
fn labelled(comparisons: &[Comparison]) -> Vec<(&Run, String)> {
    comparisons
        .iter()
        .flat_map(|comparison| comparison.runs.iter().map(|run| (run, comparison.label(run))))
        .collect()
}

/// Names of the tasks of the runs.
fn tasks(runs: &[(&Run, String)]) -> String {
    let mut names: Vec<&str> = Vec::new();
    for (run, _) in runs {
        let name = run.scene.task.name();
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names.join(", ")
}

fn check_errors(errors: &[String], runs: usize) -> Result<()> {
    if !errors.is_empty() {
        bail!(
            "{} of {runs} runs could not start or be saved:\n{}",
            errors.len(),
            errors.join("\n")
        );
    }
    Ok(())
}

/// Reads the runs that ended, without training.
///
/// # Errors
/// A run cannot be read. No run has ended.
pub fn read_all(comparisons: &mut [Comparison]) -> Result<Ended> {
    let runs = labelled(comparisons);
    let read = parallel::map(&runs, |(run, _)| -> Result<Option<(Ending, Vec<Record>)>> {
        Ok(match run.saved_end()? {
            Some(end) => Some((end, run.saved_records()?)),
            None => None,
        })
    });
    let labels: Vec<String> = runs.into_iter().map(|(_, label)| label).collect();
    let mut outcome = Ended::of(labels.len());
    let all = comparisons.iter_mut().flat_map(|comparison| &mut comparison.runs);
    for ((run, read), label) in all.zip(read).zip(labels) {
        match read.with_context(|| label.clone())? {
            Some((end, records)) => {
                outcome.add(label, &end);
                (run.end, run.records) = (Some(end), records);
            }
            None => outcome.missing.push(label),
        }
    }
    if outcome.missing.len() == outcome.runs {
        return outcome.into_result().and(Ok(Ended::of(0)));
    }
    Ok(outcome)
}
