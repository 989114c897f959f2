//! [`Progress`]: progress bar of a run, or of several parallel runs.

use super::run::{EpochEvent, Observer};
use crate::platform::terminal::{bar_width, plain, print_message, progress_bar};
use indicatif::ProgressBar;
use physgrad::engine::Growth;
use physgrad::text::short;

/// Progress bar with losses, elapsed time and ETA. Without a terminal, prints at most one line of
/// text per tenth of the epochs instead, unless quiet.
pub struct Progress {
    pub bar: ProgressBar,
    quiet: bool,
    repeated: Vec<Repeated>,
}

/// A kind of warning, and its repetitions.
struct Repeated {
    kind: &'static str,
    /// Run and number of a kind with one warning per number.
    number: Option<(String, String)>,
    /// Text and place of the first warning, which was printed.
    first: [String; 2],
    count: usize,
    /// Text and place of the last warning.
    last: [String; 2],
}

/// Smallest width of the line, in columns, at which the bar shows the elapsed time.
const WIDE: usize = 96;

impl Progress {
    pub fn new(epochs: usize, quiet: bool) -> Self {
        let template = match bar_width() {
            WIDE.. => "{bar:30} epoch {pos}/{len}  {msg}  elapsed {elapsed}, ETA {eta}",
            _ => "{bar:8} epoch {pos}/{len}  {msg}  ETA {eta}",
        };
        Self { bar: progress_bar(epochs, template, quiet), quiet, repeated: Vec::new() }
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
        let growth = |(flow, growth): (&str, Option<Growth>)| {
            growth.map(|growth| format!("{flow} 10^{:+.1}", growth.along))
        };
        let losses = [
            format!("train {}", short(record.train_loss)),
            format!("test {}", short(record.test_loss)),
        ];
        let length = record.length.map(|steps| format!("length {}", short(steps)));
        let growths = growths.into_iter().filter_map(growth);
        self.advance(losses.into_iter().chain(length).chain(growths).collect());
        self.warn("", event);
    }
}

impl Progress {
    /// Advances by one epoch. `parts` are the texts beside the bar, the most important first.
    pub fn advance(&mut self, parts: Vec<String>) {
        let wide = bar_width() >= WIDE;
        let digits = self.bar.length().unwrap_or(0).to_string().len();
        // Widths of the bar, the fixed text, both numbers of epochs, and the times.
        let rest = if wide { 30 + 29 + 2 * digits + 8 } else { 8 + 16 + 2 * digits + 4 };
        let message = joined(&parts, bar_width().saturating_sub(rest));
        self.bar.set_message(plain(&message).into_owned());
        self.bar.inc(1);
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0).max(1));
        if !self.quiet && self.bar.is_hidden() && done * 10 / all != (done - 1) * 10 / all {
            print_message(&format!("epoch {done}/{all}: {}", parts.join("  ")));
        }
    }

    /// Prints the first warning of each kind, even if quiet, and counts the others. Kinds with one
    /// warning per number count by run and number. `run` is a prefix that names the run.
    pub fn warn(&mut self, run: &str, event: EpochEvent) {
        for warning in event.warnings {
            let text = format!("warning: {run}{warning}");
            let last = [text, format!("{run}epoch {}", warning.epoch)];
            let kind = warning.kind;
            let number = warning.number.clone().map(|number| (run.to_owned(), number));
            let is_same =
                |repeated: &&mut Repeated| repeated.kind == kind && repeated.number == number;
            match self.repeated.iter_mut().find(is_same) {
                Some(repeated) => (repeated.count, repeated.last) = (repeated.count + 1, last),
                None => {
                    print_message(&last[0]);
                    let first = last.clone();
                    self.repeated.push(Repeated { kind, number, first, count: 1, last });
                }
            }
        }
    }

    /// Removes the bar. Prints the count of each repeated warning, even if quiet. The text of a
    /// warning about one number is that of the last epoch with the warning.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
        for Repeated { number, first, count, last, .. } in
            self.repeated.iter().filter(|repeated| repeated.count > 1)
        {
            let [[first, begin], [last, end]] = [first, last];
            print_message(&match number {
                Some(_) => format!("{last} ({count} times, first in {begin})"),
                None => format!("{first} ({count} times, last in {end})"),
            });
        }
    }
}

/// Joins as many of the first parts as fit into the width.
fn joined(parts: &[String], width: usize) -> String {
    let fitting = (0..=parts.len()).rev().map(|count| parts[..count].join("  "));
    fitting.into_iter().find(|text| text.chars().count() <= width).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_narrow_line_omits_whole_parts() {
        let parts = ["train 0.1", "test 0.2", "R 10^+0.1"].map(String::from);
        assert_eq!(joined(&parts, 30), "train 0.1  test 0.2  R 10^+0.1");
        assert_eq!(joined(&parts, 29), "train 0.1  test 0.2");
        assert_eq!(joined(&parts, 3), "");
    }
}
