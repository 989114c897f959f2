//! The `physgrad` program.

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
mod folder;
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
mod statistics;
mod stress;
mod sweep;
mod tasks;
mod terminal;
mod train;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::process::ExitCode;
use std::sync::atomic::Ordering;

/// Train neural controllers through long rollouts of differentiable physics, and choose the vector field to follow.
///
/// Without a command: train cart_pole with its defaults.
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
}

/// Exit status of a run that was interrupted, and saved.
const INTERRUPTED: u8 = 130;

/// The program; what it returns is its exit status.
pub fn main() -> ExitCode {
    let command = Arguments::parse().command.unwrap_or_else(default_run);
    match execute(&command) {
        // As a shell tells of a program that Ctrl-C ended: what stands after it in a script must not go on.
        Ok(()) if run::INTERRUPTED.load(Ordering::Relaxed) => ExitCode::from(INTERRUPTED),
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn execute(command: &Command) -> Result<()> {
    match command {
        Command::Accuracy(args) => accuracy::accuracy(args),
        Command::Stress(args) => stress::stress(args),
        Command::Train(args) => on_interrupt().and_then(|()| train::train(args)),
        Command::Compare(args) => on_interrupt().and_then(|()| compare::compare(args)),
        Command::Animate(args) => animate::animate(args),
        Command::Paper(args) => on_interrupt().and_then(|()| paper::paper(args)),
        Command::Report(args) => report::report(args),
        Command::Check(args) => check::check(args),
        Command::Tasks => tasks::tasks(),
        Command::Scene(args) => print::scene(args),
        Command::Schema(args) => print::schema(args),
        Command::Explain(args) => explain::explain(args),
        Command::Effects(args) => effects::effects(args),
    }
}

fn default_run() -> Command {
    Command::Train(train::Train {
        scene: "cart_pole".into(),
        changes: changes::Changes::default(),
        threads: None,
        out: None,
        resume: false,
        save_every: run::SAVE_EVERY.as_secs_f64(),
        quiet: false,
    })
}

/// The first Ctrl-C finishes the epoch and saves; the second stops at once.
fn on_interrupt() -> Result<()> {
    ctrlc::set_handler(|| {
        if run::INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(INTERRUPTED.into());
        }
        eprintln!("\nfinishing the epoch and saving; again to stop at once");
    })?;
    Ok(())
}
