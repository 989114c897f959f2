//! `physgrad completions`: completion scripts for shells.

use crate::platform::terminal::print_result;
use anyhow::Result;
use clap_complete::{Shell, generate};

/// Print a script that completes commands and options in a shell.
///
/// bash: physgrad completions bash > ~/.local/share/bash-completion/completions/physgrad
///
/// zsh: physgrad completions zsh > _physgrad, in a folder of $fpath
///
/// fish: physgrad completions fish > ~/.config/fish/completions/physgrad.fish
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  physgrad completions bash")]
pub struct Completions {
    /// Shell of the script
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Runs the command. `program` describes all commands.
pub fn completions(args: &Completions, mut program: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    let name = program.get_name().to_owned();
    generate(args.shell, &mut program, name, &mut script);
    print_result(String::from_utf8(script)?.trim_end())
}
