//! [`train_all`]: all runs of comparisons, in one process.

use super::{Comparison, Ended, Ending, check_errors, labelled, tasks};
use crate::platform::parallel;
use crate::platform::terminal::print_message;
use crate::runs::progress::Progress;
use crate::runs::run::{EpochEvent, Finished, Observer};
use anyhow::Result;
use physgrad::text::short;
use std::sync::Mutex;

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
    let total = runs.iter().fold(0, |sum: usize, (run, _)| sum.saturating_add(run.scene.epochs));
    let progress = Mutex::new(Progress::new(total, quiet));
    if !quiet {
        print_message(&format!(
            "{}: {} runs, {total} epochs in total, {} threads",
            tasks(&runs),
            runs.len(),
            rayon::current_num_threads()
        ));
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

/// Reports the epochs of one run to the progress bar that all runs share.
pub(super) struct SharedProgress<'a> {
    pub(super) progress: &'a Mutex<Progress>,
    pub(super) label: &'a str,
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
            progress.advance(vec![
                format!("test {}", short(event.record.test_loss)),
                self.label.to_owned(),
            ]);
            progress.warn(&format!("{}, ", self.label), event);
        }
    }
}
