//! The `physgrad` command-line program (feature `program`).
//!
//! Layers, each importing only those above it (`tests/layout.rs` lists the allowed imports):
//!
//! 1. `platform`: files, folders, locks, signals, threads, terminal.
//! 2. `settings`: sections of a scene, errors in settings.
//! 3. `operations`: computations generic over task and policy.
//! 4. `tasks`: built-in tasks; `Scene`, independent of the type of its task.
//! 5. `scenes`: scene files, presets, overrides.
//! 6. `runs`: training, resuming, sweeps, output files.
//! 7. `commands`: the commands; `print` contains `scene` and `schema`.
//!
//! Start with `commands/train` and `tasks/scene`.

mod commands;
mod operations;
mod platform;
mod runs;
mod scenes;
mod settings;
mod tasks;

use anyhow::Result;
use clap::{Parser, Subcommand};
use commands::{accuracy, animate, check, compare, effects, explain, paper, print, report, stress, train};
use platform::signals;
use platform::terminal::tell;
use runs::run;
use scenes::overrides::Overrides;
use std::process::ExitCode;

/// Train neural controllers through long rollouts of differentiable physics; choose the vector
/// field that the optimizer follows.
///
/// Without a command: train cart_pole with its default settings.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = false)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Train(train::Train),
    Compare(compare::Compare),
    Animate(animate::Animate),
    Report(report::Report),
    Check(check::Check),
    Paper(paper::Paper),
    /// List the tasks with all settings and their defaults
    Tasks,
    Scene(print::Scene),
    Schema(print::Schema),
    Explain(explain::Explain),
    Accuracy(accuracy::Accuracy),
    Stress(stress::Stress),
    Effects(effects::Effects),
    #[cfg(feature = "fuzz")]
    #[command(hide = true)]
    Fuzz(commands::fuzz::Fuzz),
}

/// Exit status of a training run that applied no update.
const NO_UPDATE: u8 = 3;

/// Runs the program and returns its exit status.
pub fn main() -> ExitCode {
    signals::ignore_file_limits();
    let command = Arguments::parse().command.unwrap_or_else(default_run);
    match (execute(&command), signals::received()) {
        // A shell script stops at a command with the status of a signal.
        (Ok(()), Some(signal)) => ExitCode::from(signals::exit_status(signal)),
        (Ok(()), None) => ExitCode::SUCCESS,
        (Err(error), _) => {
            tell(&format!("error: {error:#}"));
            if error.is::<run::NoUpdate>() { ExitCode::from(NO_UPDATE) } else { ExitCode::FAILURE }
        }
    }
}

fn execute(command: &Command) -> Result<()> {
    match command {
        Command::Accuracy(args) => accuracy::accuracy(args),
        Command::Stress(args) => stress::stress(args),
        Command::Train(args) => signals::handle().and_then(|()| train::train(args)),
        Command::Compare(args) => signals::handle().and_then(|()| compare::compare(args)),
        Command::Animate(args) => animate::animate(args),
        Command::Paper(args) => signals::handle().and_then(|()| paper::paper(args)),
        Command::Report(args) => report::report(args),
        Command::Check(args) => check::check(args),
        Command::Tasks => commands::tasks::tasks(),
        Command::Scene(args) => print::scene(args),
        Command::Schema(args) => print::schema(args),
        Command::Explain(args) => explain::explain(args),
        Command::Effects(args) => effects::effects(args),
        #[cfg(feature = "fuzz")]
        Command::Fuzz(args) => commands::fuzz::fuzz(args),
    }
}

fn default_run() -> Command {
    Command::Train(train::Train {
        scene: "cart_pole".into(),
        overrides: Overrides::default(),
        threads: None,
        out: None,
        resume: false,
        save_every: run::SAVE_EVERY.as_secs_f64(),
        quiet: false,
    })
}
