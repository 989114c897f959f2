//! The `physgrad` command-line program, for built-in tasks and tasks of the user.
//!
//! [`program`] creates it, and [`Program::main`] runs it.
//!
//! The program has layers. Each imports only layers with smaller numbers.
//!
//! 1. `platform`: files, folders, locks, signals, ranks, tables, threads, terminal, CSV, JSON.
//! 2. `settings`: sections of a scene, errors in settings.
//! 3. `operations`: computations on any task and its policy.
//! 4. `tasks`: built-in tasks; `Scene`, independent of the type of its task.
//! 5. `scenes`: scene files, presets, overrides, plans of many trainings.
//! 6. `runs`: training, resuming, comparisons, output files, statistics.
//! 7. `commands`: the commands; `print` contains `scene` and `schema`.
//! 8. `api`: scenes, policies and runs for other programs, for example the Python bindings. It shares
//!    recordings, remarks, studies of accuracy and reports with the commands.
//!
//! Start with `commands/train` and `tasks/scene`.

// `println!` panics on a closed pipe. `terminal::print_result` and `terminal::print_message` do
// not.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod api;
mod commands;
#[cfg(test)]
mod damaged_inputs;
mod operations;
mod platform;
mod runs;
mod scenes;
mod settings;
mod tasks;

use anyhow::Result;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use commands::{
    accuracy, animate, check, compare, completions, effects, eval, explain, export, identify,
    merge, new, optimize, paper, print, report, robust, study, train,
};
use platform::terminal::{is_plain, print_message, set_program};
use platform::{parallel, ranks, signals};
use runs::run;
use scenes::overrides::Overrides;
use std::any::TypeId;
use std::process::ExitCode;
use std::str::FromStr;
use tasks::policy::AnyPolicyKind;
use tasks::{AnyEffectSpec, AnyTaskSpec, OwnEffect};

pub use tasks::{Controlled, ProgramEffect, ProgramPolicy, ProgramTask, SceneEffects};

/// Train neural controllers through long rollouts of differentiable physics; choose the vector
/// field that the optimizer follows.
///
/// Without a command: train cart_pole with default settings; in a program with tasks of the user,
/// train the first of them.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = false)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Train(train::Train),
    New(new::New),
    Compare(compare::Compare),
    Study(study::Study),
    Merge(merge::Merge),
    Animate(animate::Animate),
    Report(report::Report),
    Eval(eval::Eval),
    Export(export::Export),
    Robust(robust::Robust),
    Runs(commands::runs::Runs),
    Identify(identify::Identify),
    Optimize(optimize::Optimize),
    Check(check::Check),
    Paper(paper::Paper),
    Tasks(commands::tasks::Tasks),
    Scene(print::Scene),
    Schema(print::Schema),
    Explain(explain::Explain),
    Accuracy(accuracy::Accuracy),
    Effects(effects::Effects),
    Completions(completions::Completions),
}

/// Exit status of an error.
const FAILURE: u8 = 1;

/// Exit status of a training run that applied no update.
const NO_UPDATE: u8 = 3;

/// Returns the `physgrad` program with the built-in tasks. [`Program::task`] adds a task of the
/// user.
///
/// ```no_run
/// use physgrad::prelude::*;
/// use physgrad_cli::ProgramTask;
/// use schemars::JsonSchema;
/// use serde::{Deserialize, Serialize};
///
/// /// A slide. The fields are the settings `system.damping` and `system.dt` of a scene.
/// #[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
/// #[serde(default, deny_unknown_fields)]
/// struct Slide { damping: f64, dt: f64 }
///
/// impl Default for Slide {
///     fn default() -> Self { Self { damping: 0.1, dt: 0.05 } }
/// }
///
/// impl System for Slide {
///     fn state_dim(&self) -> usize { 2 }
///     fn control_dim(&self) -> usize { 1 }
///     fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
///         next[1] = x[1] + (u[0] - x[1] * self.damping) * self.dt;
///         next[0] = x[0] + next[1] * self.dt;
///     }
/// }
///
/// impl Task for Slide {
///     type System = Self;
///     fn system(&self) -> &Self { self }
///     fn horizon(&self) -> usize { 40 }
///     fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
///         x[0] = rng.random_range(-1.0..1.0);
///     }
///     fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
///         next[0] * next[0] + u[0] * u[0] * 0.01
///     }
/// }
///
/// impl ProgramTask for Slide {
///     const NAME: &'static str = "slide";
/// }
///
/// fn main() -> std::process::ExitCode {
///     physgrad_cli::program().task::<Slide>().main()
/// }
/// ```
///
/// `cargo run --release -- train slide --field C --set system.damping=0.3` trains a policy. Every
/// command that takes a scene accepts `slide`. Every command that takes the folder of a run accepts
/// a run of `slide`. Without a command, the program trains the first task of the user.
#[must_use = "call `main` to run the program"]
pub fn program() -> Program {
    Program { own: Vec::new(), effects: Vec::new(), policies: Vec::new() }
}

/// The program, with tasks, effects and policies of the user; see [`program`].
pub struct Program {
    own: Vec<&'static dyn AnyTaskSpec>,
    effects: Vec<&'static dyn AnyEffectSpec>,
    policies: Vec<&'static dyn AnyPolicyKind>,
}

impl Program {
    /// Adds a task of the user to the built-in tasks.
    #[must_use = "call `main` to run the program"]
    pub fn task<T: ProgramTask>(mut self) -> Self {
        self.own.push(tasks::entry::<T>());
        self
    }

    /// Adds an effect of the user to the effects of its task.
    #[must_use = "call `main` to run the program"]
    pub fn effect<E: ProgramEffect>(mut self) -> Self {
        self.effects.push(&const { OwnEffect::<E>::NEW });
        self
    }

    /// Adds a policy of the user to the kinds that `policy.kind` may name.
    #[must_use = "call `main` to run the program"]
    pub fn policy<P: ProgramPolicy>(mut self) -> Self {
        self.policies.push(tasks::policy::kind::<P>());
        self
    }

    /// Adds the tasks, effects and policies of the user to those that [`api`] knows in this process,
    /// without running a command.
    ///
    /// # Errors
    /// Two have equal names, or this process has registered others.
    pub fn register(self) -> Result<()> {
        tasks::register(self.own, self.effects, self.policies)
    }

    /// Runs the command of the process arguments and returns its exit status. Invalid arguments,
    /// `--help` and `--version` end the process immediately.
    pub fn main(self) -> ExitCode {
        set_program();
        signals::ignore_file_limits();
        let outcome = physgrad::engine::kernels::check_processor()
            .map_err(anyhow::Error::msg)
            .and_then(|()| tasks::register(self.own, self.effects, self.policies))
            .and_then(|()| execute(&parsed().command.unwrap_or_else(default_run)));
        let failure = outcome.err().map(|error| {
            print_message(&format!("error: {error:#}"));
            if error.is::<run::NoUpdate>() { NO_UPDATE } else { FAILURE }
        });
        ranks::end(failure);
        // After a signal and without an error, returns 128 plus the number of the signal. Scripts
        // can thus detect the interruption.
        ExitCode::from(failure.or(signals::received().map(signals::exit_status)).unwrap_or(0))
    }
}

/// The commands with their options. Options of numbers take negative ones as values, and refuse them
/// with the range.
fn commands_with_options() -> clap::Command {
    let number = |arg: clap::Arg| {
        let kind = arg.get_value_parser().type_id();
        let arg = match kind {
            _ if kind == TypeId::of::<u64>() => arg.value_parser(whole::<u64>),
            _ if kind == TypeId::of::<usize>() => arg.value_parser(whole::<usize>),
            _ if kind == TypeId::of::<f64>() => arg,
            _ => return arg,
        };
        arg.allow_negative_numbers(true)
    };
    Arguments::command().mut_subcommands(|command| command.mut_args(number))
}

/// Parses a whole number.
fn whole<T: FromStr>(text: &str) -> Result<T, &'static str> {
    text.parse().map_err(|_| "allowed: a whole number, 0 or more")
}

/// The process arguments. Invalid arguments, `--help` and `--version` end the process.
fn parsed() -> Arguments {
    let matches = commands_with_options().try_get_matches();
    matches.and_then(|matches| Arguments::from_arg_matches(&matches)).unwrap_or_else(|error| {
        if std::env::args_os().all(|argument| is_plain(&argument.to_string_lossy())) {
            error.exit();
        }
        // Clap quotes arguments unchanged, and they may be the names of files of others.
        print_message(error.to_string().trim_end());
        std::process::exit(error.exit_code());
    })
}

impl Command {
    /// The option `--threads`.
    fn threads(&self) -> Option<usize> {
        match self {
            Self::Train(args) => args.threads,
            Self::Compare(args) => args.running.threads,
            Self::Study(args) => args.running.threads,
            Self::Identify(args) => args.threads,
            Self::Optimize(args) => args.threads,
            Self::Paper(args) => args.running.threads,
            _ => None,
        }
    }

    /// Returns whether the command computes in parallel.
    fn is_parallel(&self) -> bool {
        !matches!(
            self,
            Self::New(_)
                | Self::Runs(_)
                | Self::Tasks(_)
                | Self::Scene(_)
                | Self::Schema(_)
                | Self::Explain(_)
                | Self::Effects(_)
                | Self::Completions(_)
        )
    }
}

fn execute(command: &Command) -> Result<()> {
    let threads = parallel::threads(command.threads())?;
    if command.is_parallel() {
        parallel::start(threads)?;
    }
    match command {
        Command::Accuracy(args) => accuracy::accuracy(args),
        Command::New(args) => new::new(args),
        Command::Train(args) => signals::handle().and_then(|()| train::train(args)),
        Command::Compare(args) => signals::handle().and_then(|()| compare::compare(args)),
        Command::Study(args) => signals::handle().and_then(|()| study::study(args)),
        Command::Merge(args) => merge::merge(args),
        Command::Animate(args) => animate::animate(args),
        Command::Paper(args) => signals::handle().and_then(|()| paper::paper(args)),
        Command::Report(args) => report::report(args),
        Command::Eval(args) => eval::eval(args),
        Command::Export(args) => export::export(args),
        Command::Robust(args) => robust::robust(args),
        Command::Runs(args) => commands::runs::runs(args),
        Command::Identify(args) => identify::identify(args),
        Command::Optimize(args) => optimize::optimize(args),
        Command::Check(args) => check::check(args),
        Command::Tasks(args) => commands::tasks::tasks(args),
        Command::Scene(args) => print::scene(args),
        Command::Schema(args) => print::schema(args),
        Command::Explain(args) => explain::explain(args),
        Command::Effects(args) => effects::effects(args),
        Command::Completions(args) => completions::completions(args, commands_with_options()),
    }
}

/// Training of a program without a command: of its own first task, or of cart-pole, which swings up
/// well before its last epoch.
fn default_run() -> Command {
    let own = tasks::own().first();
    let overrides = Overrides { epochs: own.is_none().then_some(400), ..Overrides::default() };
    Command::Train(train::Train {
        scene: Some(own.unwrap_or(&tasks::all()[0]).name().into()),
        overrides,
        threads: None,
        out: None,
        resume: false,
        save_every: run::SAVE_EVERY.as_secs_f64(),
        quiet: false,
        json: false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_examples_and_the_program_parses_them() {
        for command in
            Arguments::command().get_subcommands().filter(|command| !command.is_hide_set())
        {
            let name = command.get_name();
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let examples: Vec<&str> =
                help.lines().filter_map(|line| line.strip_prefix("  ")).collect();
            assert!(!examples.is_empty(), "{name} has no example");
            for example in examples {
                assert!(example.starts_with(&format!("physgrad {name}")), "{example}");
                let parsed = Arguments::try_parse_from(example.split(' '));
                assert!(parsed.is_ok(), "{example}: {}", parsed.expect_err("an error"));
            }
        }
    }

    #[test]
    fn out_and_quiet_have_the_short_options_o_and_q_in_every_command() {
        for command in Arguments::command().get_subcommands() {
            for (long, short) in [("out", 'o'), ("quiet", 'q')] {
                let option =
                    command.get_arguments().find(|argument| argument.get_long() == Some(long));
                let found = option.map_or(Some(short), clap::Arg::get_short);
                assert_eq!(found, Some(short), "--{long} of {}", command.get_name());
            }
        }
    }
}
