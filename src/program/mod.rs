//! The `physgrad` command-line program (feature `program`).
//!
//! A scene file becomes a run in five steps:
//!
//! 1. `presets` and `document` read the text.
//! 2. `settings` holds the sections.
//! 3. `kind` maps a task name to types.
//! 4. `scene` hides the types.
//! 5. `run` trains and saves.
//!
//! There is one module per command: `train`, `compare`, `animate`, `report`, `check`, `paper`,
//! `tasks`, `print` (`scene` and `schema`), `explain`, `accuracy`, `stress` and `effects`.
//! Start with `train` and `scene`.

mod accuracy;
mod allocations;
mod animate;
mod any_run;
mod changes;
mod check;
mod compare;
mod document;
mod effects;
mod explain;
mod files;
mod folder;
#[cfg(feature = "fuzz")]
mod fuzz;
mod kind;
mod outputs;
mod paper;
mod parallel;
mod presets;
mod print;
mod problem;
mod report;
mod run;
mod saved;
mod scene;
mod settings;
mod signals;
mod statistics;
mod stress;
mod sweep;
mod tasks;
mod terminal;
mod train;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::process::ExitCode;
use terminal::tell;

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
    /// List the tasks and their settings
    Tasks,
    Scene(print::Scene),
    Schema(print::Schema),
    Explain(explain::Explain),
    Accuracy(accuracy::Accuracy),
    Stress(stress::Stress),
    Effects(effects::Effects),
    #[cfg(feature = "fuzz")]
    #[command(hide = true)]
    Fuzz(fuzz::Fuzz),
}

/// Exit status of a training run that applied no update.
const NO_UPDATE: u8 = 3;

/// Runs the program and returns its exit status.
pub fn main() -> ExitCode {
    signals::ignore_file_limits();
    let command = Arguments::parse().command.unwrap_or_else(default_run);
    match (execute(&command), signals::received()) {
        // Makes a shell script stop: its next command does not run.
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
        Command::Tasks => tasks::tasks(),
        Command::Scene(args) => print::scene(args),
        Command::Schema(args) => print::schema(args),
        Command::Explain(args) => explain::explain(args),
        Command::Effects(args) => effects::effects(args),
        #[cfg(feature = "fuzz")]
        Command::Fuzz(args) => fuzz::fuzz(args),
    }
}

fn default_run() -> Command {
    Command::Train(train::Train {
        scene: "cart_pole".into(),
        changes: changes::Overrides::default(),
        threads: None,
        out: None,
        resume: false,
        save_every: run::SAVE_EVERY.as_secs_f64(),
        quiet: false,
    })
}
