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
