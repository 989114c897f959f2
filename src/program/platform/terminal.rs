//! Terminal output: results and messages.

use anyhow::{Context, Result};
use std::io::{ErrorKind, Write};

/// Prints the result of a command to standard output.
///
/// # Errors
/// The text cannot be written. A pipe that its reader closes, for example `head`, is not an error.
pub fn print_result(text: &str) -> Result<()> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write the result to standard output"),
    }
}

/// Prints a message to standard error. Ignores write errors.
pub fn print_message(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Count with its noun, in the regular plural if needed.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// Question for the most similar name, to be appended to a message; empty if no name is similar.
pub fn did_you_mean<'a>(name: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    /// Least similarity of a suggestion, between 0 and 1.
    const SIMILAR: f64 = 0.8;
    let similarity = |known: &str| strsim::jaro_winkler(name, known);
    let similar = names.into_iter().map(|known| (similarity(known), known)).filter(|(score, _)| *score >= SIMILAR);
    let best = similar.max_by(|(a, _), (b, _)| a.total_cmp(b));
    best.map_or_else(String::new, |(_, known)| format!("; did you mean `{known}`?"))
}

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
    fn one_epoch_is_singular_and_two_epochs_are_plural() {
        assert_eq!([counted(1, "epoch"), counted(2, "epoch")], ["1 epoch", "2 epochs"]);
    }
}
