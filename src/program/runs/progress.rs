//! [`Progress`]: progress bar of a run.

use super::run::{EpochEvent, Observer};
use crate::Growth;
use crate::program::platform::terminal::print_message;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Progress bar with losses, elapsed time and ETA. Without a terminal, prints up to ten lines of
/// text instead.
pub struct Progress {
    pub bar: ProgressBar,
    quiet: bool,
}

impl Progress {
    pub fn new(epochs: usize, quiet: bool) -> Self {
        let bar = ProgressBar::new(epochs as u64);
        if quiet {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let style = ProgressStyle::with_template("{bar:30} epoch {pos}/{len}  {msg}  elapsed {elapsed}, ETA {eta}");
        bar.set_style(style.expect("a fixed template"));
        Self { bar, quiet }
    }
}

impl Observer for Progress {
    fn resumed(&mut self, epochs: usize) {
        self.bar.set_position(epochs as u64);
        self.bar.reset_eta();
        if !self.quiet {
            print_message(&format!("resumed after epoch {epochs}"));
        }
    }

    fn epoch(&mut self, event: EpochEvent) {
        let EpochEvent { record, .. } = event;
        let growths = [("R", record.regular_growth), ("M", record.modified_growth)];
        let growth = |(flow, growth): (&str, Option<Growth>)| growth.map(|growth| format!("  {flow} 10^{:+.1}", growth.along));
        let growths: String = growths.into_iter().filter_map(growth).collect();
        self.advance(format!("train {:.3e}  test {:.3e}{growths}", record.train_loss, record.test_loss));
        self.warn("", event);
    }
}

impl Progress {
    /// Advances by one epoch. `message` is the text beside the bar.
    pub fn advance(&mut self, message: String) {
        self.bar.set_message(message);
        self.bar.inc(1);
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0).max(1));
        if !self.quiet && self.bar.is_hidden() && done * 10 / all != (done - 1) * 10 / all {
            print_message(&format!("epoch {done}/{all}: {}", self.bar.message()));
        }
    }

    /// Prints the warnings of an epoch, even if quiet. `run` is a prefix that names the run.
    pub fn warn(&self, run: &str, event: EpochEvent) {
        for warning in event.warnings {
            let text = format!("{run}{warning}");
            // Prints above a visible bar.
            if self.bar.is_hidden() { print_message(&text) } else { self.bar.println(text) }
        }
    }
}
