//! `physgrad check`: the gradient checks of the library, as a table.

use super::kind::{KINDS, Visit};
use super::presets;
use super::scene::Scene;
use super::terminal::say;
use anyhow::{Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use indicatif::ProgressBar;
use physgrad::check::{self, Failure, Passed};
use physgrad::{Flow, Policy, System, Task};
use std::time::Duration;

/// Check the gradients of systems, policies and whole rollouts against dual numbers.
#[derive(Debug, clap::Args)]
pub struct Check {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    /// [default: all tasks, and each task of the paper with effects]
    pub scene: Option<String>,
}

/// Runs the command.
pub fn check(args: &Check) -> Result<()> {
    let mut results =
        Results { task: "", dims: None, table: Table::new(), failures: Vec::new(), spinner: ProgressBar::new_spinner() };
    let scenes = scenes(args.scene.as_deref())?;
    let header = ["task", "checked", "compared", "worst error", "allowed", ""];
    results.table.load_style(UTF8_FULL_CONDENSED).set_header(header);
    results.spinner.enable_steady_tick(Duration::from_millis(100));
    for (variant, scene) in scenes {
        if results.task != scene.kind.name() {
            (results.task, results.dims) = (scene.kind.name(), None);
        }
        scene.check(&variant, &mut results);
    }
    results.spinner.finish_and_clear();
    say(&results.table.to_string())?;
    say("errors are relative to the largest component, in double precision, against dual numbers")?;
    if results.failures.is_empty() {
        return Ok(());
    }
    bail!("{} of the checks failed:\n{}", results.failures.len(), results.failures.join("\n"));
}

/// Named scenes to check.
fn scenes(name: Option<&str>) -> Result<Vec<(String, Scene)>> {
    let tasks = KINDS.into_iter().filter(|kind| name.is_none_or(|name| name == kind.name()));
    let variants: Vec<_> = tasks.flat_map(|kind| kind.variants()).collect();
    let preset = |name: &str| Ok((name.to_owned(), presets::document(name)?.scene()?));
    match name {
        Some(name) if variants.is_empty() => Ok(vec![preset(name)?]),
        Some(_) => Ok(variants),
        None => variants.into_iter().map(Ok).chain(presets::RICH.into_iter().map(preset)).collect(),
    }
}

/// Visitor that adds the checks of one task and policy to the results.
pub struct Checking<'a> {
    pub variant: &'a str,
    pub results: &'a mut Results,
}

impl Visit for Checking<'_> {
    type Out = ();

    fn visit<T: Task, P: Policy>(self, task: T, network: P) {
        let Self { variant, results } = self;
        let system = task.system();
        let (n, m) = (system.state_dim(), system.control_dim());
        results.add(&format!("{variant}: system"), || check::try_system(system).map_err(Failure::from));
        // Skips the policy check if the dimensions did not change since the last variant.
        if results.dims.replace((n, m)) != Some((n, m)) {
            results.add(&format!("{variant}: network"), || check::try_policy(&network).map_err(Failure::from));
        }
        for flow in Flow::ALL {
            results.add(&format!("{variant}: rollout, {flow}"), || check::try_flow(&task, &network, flow));
        }
    }
}

/// Results of the checks so far.
pub struct Results {
    /// Name of the task under check.
    task: &'static str,
    /// Dimensions of state and control in the last policy check of this task.
    dims: Option<(usize, usize)>,
    table: Table,
    failures: Vec<String>,
    spinner: ProgressBar,
}

impl Results {
    fn add(&mut self, what: &str, check: impl FnOnce() -> Result<Passed, Failure>) {
        let task = self.task;
        self.spinner.set_message(format!("{task}, {what}"));
        let (compared, worst, allowed, verdict) = match check() {
            Ok(p) => (p.compared.to_string(), format!("{:.1e}", p.worst), format!("{:.0e}", p.allowed), "ok"),
            Err(failure) => {
                self.failures.push(format!("{task}, {what}: {failure}"));
                (String::new(), String::new(), String::new(), "FAILED")
            }
        };
        self.table.add_row([task, what, &compared, &worst, &allowed, verdict]);
    }
}
