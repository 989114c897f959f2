//! Terminal output: results, messages and progress bars.
//!
//! Names, tags, cells and error messages may contain text of others, and a terminal obeys the
//! control characters in it. All output therefore passes through [`plain`].
//!
//! The environment variable `COLUMNS` replaces the width of the terminal. Without it, output that
//! is not a terminal has no width: sentences are not broken, and tables break only long cells.

use anyhow::{Context, Result};
use console::Term;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle, TermLike};
use std::borrow::Cow;
use std::io::{self, ErrorKind, Write};
use std::path::PathBuf;
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// Smallest width to which output is fitted, in columns.
const NARROWEST: usize = 40;

/// Width of standard output in columns, at least 40. None if `COLUMNS` is 0, or if there is neither
/// `COLUMNS` nor a terminal.
pub fn width() -> Option<usize> {
    width_of_term(&Term::stdout())
}

fn width_of_term(term: &Term) -> Option<usize> {
    let columns = std::env::var("COLUMNS").ok().and_then(|columns| columns.parse::<usize>().ok());
    let columns = columns.or_else(|| term.size_checked().map(|(_, columns)| usize::from(columns)));
    columns.filter(|&columns| columns > 0).map(|columns| columns.max(NARROWEST))
}

/// Number of columns of a text on one line.
pub fn width_of(text: &str) -> usize {
    console::measure_text_width(text)
}

/// Returns whether a terminal shows this character and does nothing else: it is neither a control
/// character other than a line break and a tab, nor a mark that reverses the order of characters.
pub(super) fn is_shown(c: char) -> bool {
    let reorders = matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    matches!(c, '\n' | '\t') || !(c.is_control() || reorders)
}

/// Returns whether [`plain`] leaves the text unchanged.
pub fn is_plain(text: &str) -> bool {
    text.chars().all(is_shown)
}

/// The text with an escape such as `\u{1b}` in place of each character that a terminal obeys
/// instead of showing it.
pub fn plain(text: &str) -> Cow<'_, str> {
    if is_plain(text) {
        return text.into();
    }
    let escaped =
        |c: char| if is_shown(c) { c.to_string() } else { c.escape_unicode().to_string() };
    text.chars().map(escaped).collect::<String>().into()
}

/// Prints the result of a command to standard output, as [`plain`] text.
///
/// # Errors
/// The text cannot be written. A pipe that its reader, for example `head`, closes is not an error.
pub fn print_result(text: &str) -> Result<()> {
    match writeln!(std::io::stdout(), "{}", plain(text)) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write the result to standard output"),
    }
}

/// Prints sentences of a result to standard output, broken at the width of the terminal.
///
/// # Errors
/// As [`print_result`].
pub fn print_text(text: &str) -> Result<()> {
    print_result(&fitted(&plain(text), width()))
}

/// Prints a message to standard error as [`plain`] text, above the progress bar if there is one. Breaks lines at the
/// width of the terminal. Ignores write errors.
pub fn print_message(text: &str) {
    let term = Term::stderr();
    let text = fitted(&plain(text), width_of_term(&term));
    // The terminal may have echoed `^C` to the current line.
    let start = if term.is_term() { "\r" } else { "" };
    let write = || _ = writeln!(std::io::stderr(), "{start}{text}");
    let bar = BAR.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match bar.filter(|bar| !bar.is_hidden() && !bar.is_finished()) {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// Prints sentences that are no part of a result object: to standard error with `--json`, to
/// standard output otherwise.
///
/// # Errors
/// As [`print_result`].
pub fn print_note(text: &str, json: bool) -> Result<()> {
    if !json {
        return print_text(text);
    }
    print_message(text);
    Ok(())
}

/// The last progress bar of the process.
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Progress bar of `steps` steps, or a spinner if `steps` is 0. Hidden if quiet or without a
/// terminal.
pub fn progress_bar(steps: usize, template: &str, quiet: bool) -> ProgressBar {
    let bar = if steps == 0 { ProgressBar::new_spinner() } else { ProgressBar::new(steps as u64) };
    let term = Term::stderr();
    let is_visible = !quiet && term.is_term();
    bar.set_draw_target(match is_visible {
        true => ProgressDrawTarget::term_like_with_hz(Box::new(BarLine(term)), 20),
        false => ProgressDrawTarget::hidden(),
    });
    bar.set_style(ProgressStyle::with_template(template).expect("a fixed template"));
    // The spinner turns on a thread of its own, which the system may refuse.
    if steps == 0 && is_visible && std::thread::Builder::new().spawn(|| ()).is_ok() {
        bar.enable_steady_tick(Duration::from_millis(100));
    }
    *BAR.lock().unwrap_or_else(PoisonError::into_inner) = Some(bar.clone());
    bar
}

/// Columns right of a progress bar, for the echo of `^C`. A line that wraps would not be erased.
const MARGIN: usize = 4;

/// Width of the line of a progress bar. `usize::MAX` if the width of the terminal is unknown.
pub fn bar_width() -> usize {
    width_of_term(&Term::stderr()).map_or(usize::MAX, |columns| columns - MARGIN)
}

/// Terminal whose progress bars leave a margin.
#[derive(Debug)]
struct BarLine(Term);

impl TermLike for BarLine {
    fn width(&self) -> u16 {
        u16::try_from(bar_width()).unwrap_or(u16::MAX)
    }

    fn move_cursor_up(&self, lines: usize) -> io::Result<()> {
        self.0.move_cursor_up(lines)
    }

    fn move_cursor_down(&self, lines: usize) -> io::Result<()> {
        self.0.move_cursor_down(lines)
    }

    fn move_cursor_right(&self, columns: usize) -> io::Result<()> {
        self.0.move_cursor_right(columns)
    }

    fn move_cursor_left(&self, columns: usize) -> io::Result<()> {
        self.0.move_cursor_left(columns)
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.0.write_line(text)
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        self.0.write_str(text)
    }

    fn clear_line(&self) -> io::Result<()> {
        self.0.clear_line()
    }

    fn flush(&self) -> io::Result<()> {
        self.0.flush()
    }
}

/// Breaks lines of sentences between words, at the width. Leaves lines of tables unchanged.
fn fitted(text: &str, width: Option<usize>) -> String {
    let Some(width) = width else { return text.to_owned() };
    let is_table = |line: &str| line.starts_with(['│', '┌', '╞', '└', '├', '|']);
    let line = |line: &str| if is_table(line) { line.to_owned() } else { wrapped(line, width) };
    text.split('\n').map(line).collect::<Vec<_>>().join("\n")
}

/// Breaks a paragraph between words into lines of at most `width` columns, each with the
/// indentation of the first. Words that are longer than a line are not broken.
pub fn wrapped(text: &str, width: usize) -> String {
    let indent = text.len() - text.trim_start_matches(' ').len();
    let mut lines = text[..indent].to_owned();
    let mut at = indent;
    for (i, word) in text[indent..].split(' ').enumerate() {
        let count = width_of(word);
        if i > 0 && at + 1 + count > width {
            lines.truncate(lines.trim_end_matches(' ').len());
            lines.push('\n');
            lines += &text[..indent];
            at = indent;
        } else if i > 0 {
            lines.push(' ');
            at += 1;
        }
        lines += word;
        at += count;
    }
    lines
}

/// Count with its noun, in the regular plural if needed.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// Names separated by commas. From 11 names on, the first three, the last one, and their number.
pub fn listed(names: &[String]) -> String {
    match names {
        [first @ .., last] if names.len() > 10 => {
            format!("{}, … {last} ({})", first[..3].join(", "), names.len())
        }
        names => names.join(", "),
    }
}

/// Question that suggests the most similar name, to be appended to a message. Empty if no name is
/// similar.
pub fn did_you_mean<'a>(name: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    /// Least similarity of a suggestion, between 0 and 1.
    const SIMILAR: f64 = 0.8;
    let similarity = |known: &str| strsim::jaro_winkler(name, known);
    let similar = names
        .into_iter()
        .map(|known| (similarity(known), known))
        .filter(|(score, _)| *score >= SIMILAR);
    let best = similar.max_by(|(a, _), (b, _)| a.total_cmp(b));
    best.map_or_else(String::new, |(_, known)| format!("; did you mean `{known}`?"))
}

/// Name of the running program, for commands in messages. A task of the user has a program of its
/// own. Within another process, for example Python, the name is `physgrad`.
pub fn program() -> &'static str {
    PROGRAM.get().map_or("physgrad", String::as_str)
}

/// Returns whether this process is the program. Messages in another process, for example Python,
/// name no options and commands.
pub fn is_program() -> bool {
    PROGRAM.get().is_some()
}

/// How the program does something, as in " with --out". Empty within another process.
pub fn with_option(option: &str) -> String {
    if is_program() { format!(" with {option}") } else { String::new() }
}

/// Sets the name of the [`program`] to that of its executable file.
pub fn set_program() {
    let path = std::env::args_os().next().map(PathBuf::from);
    let name = path.and_then(|path| Some(path.file_stem()?.to_string_lossy().into_owned()));
    // `main` calls this function once.
    let _ = name.map(|name| PROGRAM.set(name));
}

static PROGRAM: OnceLock<String> = OnceLock::new();

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cartpole_and_quantom_suggest_the_tasks_and_rocket_suggests_none() {
        let names = ["cart_pole", "quantum", "guidance"];
        assert_eq!(did_you_mean("cartpole", names), "; did you mean `cart_pole`?");
        assert_eq!(did_you_mean("quantom", names), "; did you mean `quantum`?");
        assert_eq!(did_you_mean("rocket", names), "");
    }

    #[test]
    fn a_list_of_more_than_ten_names_is_shortened() {
        let names: Vec<String> = (1..=50).map(|i| format!("T_{i:02}")).collect();
        assert_eq!(listed(&names[..2]), "T_01, T_02");
        assert_eq!(listed(&names), "T_01, T_02, T_03, … T_50 (50)");
    }

    #[test]
    fn a_paragraph_breaks_between_words_and_keeps_its_indentation() {
        assert_eq!(wrapped("one two three", 9), "one two\nthree");
        assert_eq!(wrapped("  one  two three", 10), "  one  two\n  three");
        assert_eq!(wrapped("unbreakable", 4), "unbreakable");
    }

    #[test]
    fn sentences_are_fitted_and_tables_are_not() {
        let text = "one two three\n│ one two three │\n\n  four five six";
        assert_eq!(
            fitted(text, Some(9)),
            "one two\nthree\n│ one two three │\n\n  four\n  five\n  six"
        );
        assert_eq!(fitted(text, None), text);
    }

    #[test]
    fn control_characters_and_marks_of_direction_are_shown_as_escapes() {
        assert_eq!(plain("a\tb\nΔ é \u{301} 漢"), "a\tb\nΔ é \u{301} 漢");
        assert_eq!(plain("\x1b[31mred\r\x07"), "\\u{1b}[31mred\\u{d}\\u{7}");
        assert_eq!(plain("\u{9b}2J \u{7f} \u{202e}txt"), "\\u{9b}2J \\u{7f} \\u{202e}txt");
        for c in '\0'..=char::MAX {
            let is_harmless = !c.is_control() || matches!(c, '\n' | '\t');
            assert!(
                plain(&c.to_string()).chars().all(|c| !c.is_control() || matches!(c, '\n' | '\t')),
                "{c:?}"
            );
            assert!(
                is_harmless || plain(&c.to_string()) == format!("\\u{{{:x}}}", c as u32),
                "{c:?}"
            );
        }
    }

    #[test]
    fn one_epoch_is_singular_and_two_epochs_are_plural() {
        assert_eq!([counted(1, "epoch"), counted(2, "epoch")], ["1 epoch", "2 epochs"]);
    }
}
