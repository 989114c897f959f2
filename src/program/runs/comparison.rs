//! Comparisons: many runs in parallel, one thread per run. Resumes runs that are in their folders.
//!
//! A run that ended has a file `end.toml`. Shards skip such runs, and `merge` reads them.

use crate::numbers::text::short;
use crate::program::platform::folder::{COMPARISON, END, Folder, RUNS};
use crate::program::platform::lock::Locked;
use crate::program::platform::parallel;
use crate::program::platform::signals;
use crate::program::platform::terminal::{counted, print_message};
use crate::program::runs::progress::Progress;
use crate::program::runs::run::{self, End, EpochEvent, Finished, NoUpdate, Observer, SAVE_EVERY};
use crate::program::runs::saved::{self, check_resumable};
use crate::program::runs::shard::Shard;
use crate::program::runs::statistics::Outcome;
use crate::program::settings::FieldName;
use crate::program::tasks::Scene;
use crate::{Field, Record, differences};
use anyhow::{Context, Result, bail};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::sync::Mutex;

/// Runs of one training configuration with several fields and seeds.
pub struct Comparison {
    runs: Vec<Run>,
    /// Prefix of messages, which distinguishes several comparisons. May be empty.
    label: String,
}

/// One field and seed, with its records.
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
    /// Error that ended the run before its last epoch.
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
        Some(Self { epochs, no_update, error: error.map(ToString::to_string) })
    }
}

impl Run {
    /// Returns whether the folder already contains the run.
    ///
    /// # Errors
    /// The folder contains a run with other settings.
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
            None => Ok(Finished { records: Vec::new(), numbers: Vec::new(), end: End::Interrupted }),
        }
    }

    /// Trains as [`run`](Self::run) does. Returns None if the run has ended or another process
    /// holds the lock.
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
        let finished = run::run(&folder, &self.scene, &mut *self.scene.open(1)?, resume, SAVE_EVERY, observer)?;
        if let Some(end) = Ending::new(self.scene.epochs, &finished.end) {
            folder.write(END, toml::to_string(&end)?)?;
        }
        Ok(finished)
    }

    /// End of the run, from its folder. None if the run has not ended.
    fn saved_end(&self) -> Result<Option<Ending>> {
        if !self.folder.has(END) || !saved::has_run(&self.folder) {
            return Ok(None);
        }
        let end: Ending = read_toml(&self.folder, END)?;
        Ok(Some(end).filter(|end| end.epochs == self.scene.epochs))
    }

    /// Records of the run, from its folder.
    fn saved_records(&self) -> Result<Vec<Record>> {
        let scene = saved::scene(&self.folder)?;
        let mut run = scene.open(1)?;
        saved::restore(&self.folder, &scene, &mut *run)?;
        Ok(run.records().to_vec())
    }

    fn outcome(&self) -> Option<Outcome<'_>> {
        let failed = self.end.as_ref()?.error.is_some();
        Some(Outcome { field: self.field, seed: self.seed, records: &self.records, failed })
    }
}

/// Contents of a TOML file in the folder.
fn read_toml<T: DeserializeOwned>(folder: &Folder, name: &str) -> Result<T> {
    let read = || -> Result<T> { Ok(toml::from_str(std::str::from_utf8(&folder.read(name)?)?)?) };
    read().with_context(|| format!("cannot read {}", folder.file(name).display()))
}

/// Writes the plan of a comparison, which `merge` reads.
///
/// # Errors
/// `shard` is true, and the folder has the plan of another comparison.
pub fn write_plan(folder: &Folder, plan: &impl Serialize, shard: bool) -> Result<()> {
    let plan = toml::to_string(plan)?;
    let saved = if folder.has(COMPARISON) { Some(folder.read(COMPARISON)?) } else { None };
    match saved {
        Some(saved) if saved == plan.as_bytes() => Ok(()),
        Some(saved) if shard => bail!(
            "{} has the plan of another comparison; give all shards equal options, or choose another folder with --out. These lines \
             differ:\n{}",
            folder.file(COMPARISON).display(),
            differences(&String::from_utf8_lossy(&saved), &plan)
        ),
        _ => folder.write(COMPARISON, plan),
    }
}

/// Plan of the comparison in the folder.
pub fn read_plan<T: DeserializeOwned>(folder: &Folder) -> Result<T> {
    read_toml(folder, COMPARISON)
}

impl Comparison {
    /// Plans one run per field and seed. The folders need not exist.
    pub fn plan(label: &str, base: &Scene, fields: &[FieldName], seeds: u64, folder: &Folder) -> Result<Self> {
        let last = base.seed.checked_add(seeds - 1).filter(|&last| i64::try_from(last).is_ok());
        let last = last.with_context(|| {
            format!("{seeds} seeds from {} on exceed the largest seed, {}; use smaller seeds", base.seed, i64::MAX)
        })?;
        let pairs = fields.iter().flat_map(|&field| (base.seed..=last).map(move |seed| (field, seed)));
        let run = |(field, seed): (FieldName, u64)| {
            let scene = base.with(field, seed)?;
            let folder = Folder::at(folder.file(RUNS).join(format!("{}-{seed}", field.0.letter())));
            Ok(Run { field: field.0, seed, folder, scene, records: Vec::new(), end: None })
        };
        Ok(Self { runs: pairs.map(run).collect::<Result<_>>()?, label: label.to_owned() })
    }

    /// Returns whether the folder of some run contains a run.
    pub fn has_runs(&self) -> bool {
        self.runs.iter().any(|run| saved::has_run(&run.folder))
    }

    /// Outcomes of the runs that ended, grouped by field.
    pub fn outcomes(&self) -> Vec<Outcome<'_>> {
        self.runs.iter().filter_map(Run::outcome).collect()
    }

    fn label(&self, run: &Run) -> String {
        let space = if self.label.is_empty() { "" } else { " " };
        format!("{}{space}{} seed {}", self.label, run.field.letter(), run.seed)
    }
}

/// Checks the options of a comparison.
///
/// # Errors
/// `seeds` or `epochs` is 0, or a field occurs twice.
pub fn check_options(fields: &[FieldName], seeds: u64, epochs: usize) -> Result<()> {
    if seeds == 0 {
        bail!("--seeds is 0; allowed: 1 or more");
    }
    if epochs == 0 {
        bail!("--epochs is 0; allowed: 1 or more");
    }
    check_distinct("--fields", fields.iter().map(|field| field.0.name()))
}

/// Returns an error if an option contains a name twice.
pub fn check_distinct<'a>(option: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
    let mut seen = HashSet::new();
    match names.into_iter().find(|name| !seen.insert(*name)) {
        Some(name) => bail!("{option} names {name} twice"),
        None => Ok(()),
    }
}

/// Checks that each scene and field can open a session.
///
/// # Errors
/// A setting is unusable, for example a memory budget that is too small.
pub fn check_sessions<'a>(bases: impl Iterator<Item = &'a Scene>, fields: &[FieldName]) -> Result<()> {
    for base in bases {
        for &field in fields {
            base.with(field, base.seed)?.open(1)?;
        }
    }
    Ok(())
}

/// End of all runs.
pub struct Ended {
    pub interrupted: bool,
    /// One message per failed run.
    failed: Vec<String>,
    /// Runs that applied no update.
    no_update: Vec<String>,
    /// Runs that have not ended, in the result of [`read_all`].
    missing: Vec<String>,
    runs: usize,
}

impl Ended {
    fn of(runs: usize) -> Self {
        Self { interrupted: false, failed: Vec::new(), no_update: Vec::new(), missing: Vec::new(), runs }
    }

    fn add(&mut self, label: String, end: &Ending) {
        match &end.error {
            _ if end.no_update => self.no_update.push(label),
            Some(error) => self.failed.push(format!("{label}: {error}")),
            None => {}
        }
    }

    /// Returns an error that lists the runs that have not ended, failed or applied no update.
    pub fn into_result(self) -> Result<()> {
        if !self.missing.is_empty() {
            bail!(
                "{} of {} runs are missing or not complete; repeat the command that trains them:\n{}",
                self.missing.len(),
                self.runs,
                self.missing.join("\n")
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

/// Trains all runs. A run that fails at a non-finite number counts as a result, and the other runs
/// continue.
///
/// # Errors
/// Before training: a folder contains a run with other settings. After training: some runs could
/// not start or could not be saved.
pub fn train_all(comparisons: &mut [Comparison], quiet: bool) -> Result<Ended> {
    let (runs, mut resumed) = (labelled(comparisons), 0);
    for (run, _) in &runs {
        // Reports a run with other settings before writing anything.
        resumed += usize::from(run.resumes()?);
    }
    let total = runs.iter().map(|(run, ..)| run.scene.epochs).sum();
    let progress = Mutex::new(Progress::new(total, quiet));
    if !quiet {
        let task = runs.first().map_or("no task", |(run, ..)| run.scene.task.name());
        print_message(&format!("{task}: {} runs, {total} epochs in total, {} threads", runs.len(), rayon::current_num_threads()));
        if resumed > 0 {
            print_message(&format!("resuming {resumed} of these runs from their folders"));
        }
    }
    let finished: Vec<Result<Finished>> = parallel::map(&runs, |(run, label)| {
        let mut observer = SharedProgress { progress: &progress, label };
        run.run(&mut observer)
    });
    if let Ok(progress) = progress.lock() {
        progress.finish();
    }

    let labels: Vec<String> = runs.into_iter().map(|(_, label)| label).collect();
    let mut outcome = Ended::of(labels.len());
    let mut errors = Vec::new();
    let all = comparisons.iter_mut().flat_map(|comparison| &mut comparison.runs);
    for ((run, finished), label) in all.zip(finished).zip(labels) {
        match finished {
            Ok(finished) => {
                run.records = finished.records;
                run.end = Ending::new(run.scene.epochs, &finished.end);
                match &run.end {
                    Some(end) => outcome.add(label, end),
                    None => outcome.interrupted = true,
                }
            }
            Err(error) => errors.push(format!("{label}: {error:#}")),
        }
    }
    check_errors(&errors, outcome.runs)?;
    Ok(outcome)
}

/// All runs, with their names in messages.
fn labelled(comparisons: &[Comparison]) -> Vec<(&Run, String)> {
    comparisons.iter().flat_map(|comparison| comparison.runs.iter().map(|run| (run, comparison.label(run)))).collect()
}

fn check_errors(errors: &[String], runs: usize) -> Result<()> {
    if !errors.is_empty() {
        bail!("{} of {runs} runs could not start or be saved:\n{}", errors.len(), errors.join("\n"));
    }
    Ok(())
}

/// Trains the runs of a shard, then all other runs that have not ended and that no other process
/// holds.
///
/// Visits the runs in the order of the shard, until a whole round finds no run to train. A run that
/// a killed process left is therefore completed by every process that visits it later.
///
/// # Errors
/// As [`train_all`].
pub fn train_shard(comparisons: &[Comparison], shard: Shard, quiet: bool) -> Result<Ended> {
    let runs = labelled(comparisons);
    for (run, _) in &runs {
        run.resumes()?;
    }
    let share = shard.share(runs.len());
    let order: Vec<(usize, usize)> = shard.order(runs.len()).into_iter().enumerate().collect();
    let epochs: usize = order[..share].iter().map(|&(_, run)| runs[run].0.scene.epochs).sum();
    let progress = Mutex::new(Progress::new(epochs, quiet));
    let threads = rayon::current_num_threads();
    if !quiet {
        let task = runs.first().map_or("no task", |(run, _)| run.scene.task.name());
        print_message(&format!("{task}: shard {shard}, {share} of {} runs, {epochs} epochs, {threads} threads", runs.len()));
    }
    let mut outcome = Ended::of(runs.len());
    let mut trained = 0;
    for round in 0.. {
        let visited: Vec<Result<Option<Finished>>> = parallel::map(&order, |&(place, run)| {
            let (run, label) = &runs[run];
            if signals::received().is_some() {
                return Ok(None);
            }
            let (epochs, counted) = (run.scene.epochs, round == 0 && place < share);
            let mut observer = ShardProgress { shared: SharedProgress { progress: &progress, label }, epochs, counted };
            let finished = run.run_if_free(&mut observer);
            if counted
                && matches!(finished, Ok(None))
                && let Ok(progress) = progress.lock()
            {
                progress.bar.dec_length(epochs as u64);
            }
            finished
        });
        let (mut found, mut errors) = (0, Vec::new());
        for (finished, &(_, run)) in visited.into_iter().zip(&order) {
            let (run, label) = &runs[run];
            match finished {
                Ok(Some(finished)) => {
                    found += 1;
                    if let Some(end) = Ending::new(run.scene.epochs, &finished.end) {
                        outcome.add(label.clone(), &end);
                    }
                }
                Ok(None) => {}
                Err(error) => errors.push(format!("{label}: {error:#}")),
            }
        }
        trained += found;
        outcome.interrupted = signals::received().is_some();
        if found == 0 || outcome.interrupted {
            if let Ok(progress) = progress.lock() {
                progress.finish();
            }
            check_errors(&errors, runs.len())?;
            break;
        }
    }
    if !quiet {
        let mut ended = 0;
        for (run, _) in &runs {
            ended += usize::from(run.saved_end()?.is_some());
        }
        let rest = runs.len() - ended;
        let held = if rest == 0 { String::new() } else { format!(", {rest} in use by other processes") };
        let text = format!("shard {shard}: trained {}; {ended} of {} have ended", counted(trained, "run"), runs.len());
        print_message(&if outcome.interrupted { text } else { text + &held });
    }
    Ok(outcome)
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

/// Reports the epochs of all runs to a shared progress bar.
struct SharedProgress<'a> {
    progress: &'a Mutex<Progress>,
    label: &'a str,
}

impl Observer for SharedProgress<'_> {
    fn resumed(&mut self, epochs: usize) {
        if let Ok(progress) = self.progress.lock() {
            progress.bar.inc(epochs as u64);
            // Excludes resumed epochs from the estimate of the remaining time.
            progress.bar.reset_eta();
        }
    }

    fn epoch(&mut self, event: EpochEvent) {
        if let Ok(mut progress) = self.progress.lock() {
            progress.advance(vec![format!("test {}", short(event.record.test_loss)), self.label.to_owned()]);
            progress.warn(&format!("{}, ", self.label), event);
        }
    }
}

/// Reports the epochs of one run of a shard. The bar counts the share, then the runs beyond it.
struct ShardProgress<'a> {
    shared: SharedProgress<'a>,
    /// Number of epochs of the run.
    epochs: usize,
    /// True if the length of the bar contains the run.
    counted: bool,
}

impl ShardProgress<'_> {
    fn count(&mut self) {
        if !std::mem::replace(&mut self.counted, true)
            && let Ok(progress) = self.shared.progress.lock()
        {
            progress.bar.inc_length(self.epochs as u64);
        }
    }
}

impl Observer for ShardProgress<'_> {
    fn resumed(&mut self, epochs: usize) {
        self.count();
        self.shared.resumed(epochs);
    }

    fn epoch(&mut self, event: EpochEvent) {
        self.count();
        self.shared.epoch(event);
    }
}
