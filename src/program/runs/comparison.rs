//! Comparisons: many runs in parallel, one thread per run. Resumes runs that are in their folders.

use crate::numbers::text::short;
use crate::program::platform::folder::{Folder, RUNS};
use crate::program::platform::parallel;
use crate::program::platform::terminal::print_message;
use crate::program::runs::progress::Progress;
use crate::program::runs::run::{self, End, EpochEvent, Finished, NoUpdate, Observer, SAVE_EVERY};
use crate::program::runs::saved::{self, check_resumable};
use crate::program::runs::statistics::Outcome;
use crate::program::settings::FieldName;
use crate::program::tasks::Scene;
use crate::{Field, Record};
use anyhow::{Context, Result, bail};
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
    failed: bool,
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
        let Some(folder) = self.folder.clone().wait_and_lock()? else {
            return Ok(Finished { records: Vec::new(), numbers: Vec::new(), end: End::Interrupted });
        };
        let resume = self.resumes()?;
        let folder = if resume { folder } else { folder.without_run()? };
        // One thread per run: the parallel runs occupy all cores.
        run::run(&folder, &self.scene, &mut *self.scene.open(1)?, resume, SAVE_EVERY, observer)
    }

    fn outcome(&self) -> Outcome<'_> {
        Outcome { field: self.field, seed: self.seed, records: &self.records, failed: self.failed }
    }
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
            Ok(Run { field: field.0, seed, folder, scene, records: Vec::new(), failed: false })
        };
        Ok(Self { runs: pairs.map(run).collect::<Result<_>>()?, label: label.to_owned() })
    }

    /// Returns whether the folder of some run contains a run.
    pub fn has_runs(&self) -> bool {
        self.runs.iter().any(|run| saved::has_run(&run.folder))
    }

    /// Outcomes of all runs, grouped by field.
    pub fn outcomes(&self) -> Vec<Outcome<'_>> {
        self.runs.iter().map(Run::outcome).collect()
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
    runs: usize,
}

impl Ended {
    /// Returns an error that lists the runs that failed or applied no update.
    pub fn into_result(self) -> Result<()> {
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
    let (mut runs, mut resumed) = (Vec::new(), 0);
    for comparison in &*comparisons {
        for run in &comparison.runs {
            // Reports a run with other settings before writing anything.
            resumed += usize::from(run.resumes()?);
            runs.push((run, comparison.label(run)));
        }
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
    let mut outcome = Ended { interrupted: false, failed: Vec::new(), no_update: Vec::new(), runs: labels.len() };
    let mut errors = Vec::new();
    let all = comparisons.iter_mut().flat_map(|comparison| &mut comparison.runs);
    for ((run, finished), label) in all.zip(finished).zip(labels) {
        match finished {
            Ok(finished) => {
                run.records = finished.records;
                run.failed = matches!(finished.end, End::Failed(_) | End::NoUpdate(Some(_)));
                match finished.end {
                    End::Complete => {}
                    End::Interrupted => outcome.interrupted = true,
                    End::Failed(error) => outcome.failed.push(format!("{label}: {error}")),
                    End::NoUpdate(_) => outcome.no_update.push(label),
                }
            }
            Err(error) => errors.push(format!("{label}: {error:#}")),
        }
    }
    if !errors.is_empty() {
        bail!("{} of {} runs could not start or be saved:\n{}", errors.len(), outcome.runs, errors.join("\n"));
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
