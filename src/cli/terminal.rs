//! What the program says: lines, and progress.

use super::run::{Told, Watch};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use physgrad::Growth;
use std::io::Write;

/// Prints to the standard output. Who reads it may have stopped reading.
pub fn say(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// A progress bar with the losses and the time left; ten lines of text where there is no terminal.
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
        let style = ProgressStyle::with_template("{bar:30} epoch {pos}/{len}  {msg}  {elapsed} gone, {eta} left");
        bar.set_style(style.expect("a fixed template"));
        Self { bar, quiet }
    }
}

impl Watch for Progress {
    fn resumed(&mut self, epochs: usize) {
        self.bar.set_position(epochs as u64);
        self.bar.reset_eta();
        if !self.quiet {
            eprintln!("resumed after epoch {epochs}");
        }
    }

    fn epoch(&mut self, told: Told) {
        let Told { record, .. } = told;
        let growths = [("R", record.regular_growth), ("M", record.modified_growth)];
        let growth = |(flow, growth): (&str, Option<Growth>)| growth.map(|growth| format!("  {flow} 10^{:+.1}", growth.along));
        let growths: String = growths.into_iter().filter_map(growth).collect();
        self.advance(format!("train {:.3e}  test {:.3e}{growths}", record.train_loss, record.test_loss));
        self.trouble("", told);
    }
}

impl Progress {
    /// One more epoch.
    pub fn advance(&mut self, message: String) {
        self.bar.set_message(message);
        self.bar.inc(1);
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0).max(1));
        if !self.quiet && self.bar.is_hidden() && done * 10 / all != (done - 1) * 10 / all {
            eprintln!("epoch {done}/{all}: {}", self.bar.message());
        }
    }

    /// Says what was not finite in an epoch, and what is not to be trusted.
    pub fn trouble(&self, run: &str, told: Told) {
        let Told { record, skips, diverged, warnings } = told;
        let epoch = record.epoch;
        let skipped = skips.first().map(|skip| {
            let (count, update) = (skips.len(), skip.update);
            format!("{run}epoch {epoch}: {count} update(s) skipped, the first being update {update} ({})", skip.divergence)
        });
        let evaluated = ["training", "test"].into_iter().zip(diverged).filter_map(|(set, divergence)| {
            divergence.map(|divergence| format!("{run}epoch {epoch}: the {set} loss is not finite ({divergence})"))
        });
        let warnings = warnings.iter().map(|warning| format!("{run}epoch {epoch}: {warning}"));
        for text in skipped.into_iter().chain(evaluated).chain(warnings).filter(|_| !self.quiet) {
            // Above the bar where there is one.
            if self.bar.is_hidden() { eprintln!("{text}") } else { self.bar.println(text) }
        }
    }
}
