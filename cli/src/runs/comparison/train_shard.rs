//! [`train_shard`]: the runs of comparisons that no other process trains.

use super::train_all::SharedProgress;
use super::{Comparison, Ended, Ending, Run, check_errors, labelled, tasks};
use crate::platform::parallel;
use crate::platform::signals;
use crate::platform::terminal::{counted, print_message};
use crate::runs::progress::Progress;
use crate::runs::run::{EpochEvent, Finished, Observer};
use crate::runs::shard::Shard;
use anyhow::Result;
use std::sync::Mutex;

/// Trains the runs of a shard, then all other runs that have not ended and that no other process
/// holds.
///
/// Visits the runs in the order of the shard, until a whole round finds no run to train or a signal
/// arrives. The next process that visits a run of a killed process therefore completes it.
///
/// # Errors
/// As [`train_all`](super::train_all()).
pub fn train_shard(comparisons: &[Comparison], shard: Shard, quiet: bool) -> Result<Ended> {
    let runs = labelled(comparisons);
    for (run, _) in &runs {
        run.resumes()?;
    }
    let share = shard.share(runs.len());
    let order: Vec<(usize, usize)> = shard.order(runs.len()).into_iter().enumerate().collect();
    let epochs = order[..share]
        .iter()
        .fold(0, |sum: usize, &(_, run)| sum.saturating_add(runs[run].0.scene.epochs));
    let progress = Mutex::new(Progress::new(epochs, quiet));
    let threads = rayon::current_num_threads();
    if !quiet {
        let task = tasks(&runs);
        print_message(&format!(
            "{task}: shard {shard}, {share} of {} runs, {epochs} epochs, {threads} threads",
            runs.len()
        ));
    }
    let mut outcome = Ended::of(runs.len());
    let mut trained = 0;
    for round in 0.. {
        let visited: Vec<Result<Option<Finished>>> = parallel::map(&order, |&(place, run)| {
            visit(&runs[run], round == 0 && place < share, &progress)
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
        print_end(&runs, shard, trained, outcome.interrupted)?;
    }
    Ok(outcome)
}

/// Trains a run, unless it has ended, another process holds it, or a signal has arrived. `counted`
/// is true if the length of the bar contains the epochs of the run, which are subtracted if the run
/// has ended or another process holds it.
fn visit(
    (run, label): &(&Run, String),
    counted: bool,
    progress: &Mutex<Progress>,
) -> Result<Option<Finished>> {
    if signals::received().is_some() {
        return Ok(None);
    }
    let epochs = run.scene.epochs;
    let mut observer =
        ShardProgress { shared: SharedProgress { progress, label }, epochs, counted };
    let finished = run.run_if_free(&mut observer);
    if counted
        && matches!(finished, Ok(None))
        && let Ok(progress) = progress.lock()
    {
        progress.bar.dec_length(epochs as u64);
    }
    finished
}

/// Prints how many runs this process trained, how many have ended, and, unless a signal interrupted
/// the shard, how many other processes hold.
fn print_end(
    runs: &[(&Run, String)],
    shard: Shard,
    trained: usize,
    interrupted: bool,
) -> Result<()> {
    let mut ended = 0;
    for (run, _) in runs {
        ended += usize::from(run.saved_end()?.is_some());
    }
    let rest = runs.len() - ended;
    let held =
        if rest == 0 { String::new() } else { format!(", {rest} in use by other processes") };
    let text = format!(
        "shard {shard}: trained {}; {ended} of {} have ended",
        counted(trained, "run"),
        runs.len()
    );
    print_message(&if interrupted { text } else { text + &held });
    Ok(())
}

/// Reports the epochs of one run of a shard. The length of the bar counts the epochs of the share,
/// and of every other run from its first report on.
struct ShardProgress<'a> {
    shared: SharedProgress<'a>,
    /// Number of epochs of the run.
    epochs: usize,
    /// True if the length of the bar contains the epochs of the run.
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
