//! `physgrad check`: the gradient checks of the library, as a table.

use super::scene::{NAMES, Network, Scene, with_scene};
use super::settings::Settings;
use super::terminal::say;
use anyhow::{Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use indicatif::ProgressBar;
use physgrad::check::{self, Failure, Passed};
use physgrad::policy::Linear;
use physgrad::{Flow, System};
use std::time::Duration;

/// Check the gradients of systems, policies and whole rollouts against dual numbers.
#[derive(Debug, clap::Args)]
pub struct Check {
    /// The task to check [default: all]
    pub task: Option<String>,
}

/// Runs the command.
pub fn check(args: &Check) -> Result<()> {
    let names = args.task.as_deref().map_or_else(|| NAMES.to_vec(), |name| vec![name]);
    let mut results = Results { table: Table::new(), failures: Vec::new(), spinner: ProgressBar::new_spinner() };
    let header = ["task", "checked", "compared", "worst error", "allowed", ""];
    results.table.load_style(UTF8_FULL_CONDENSED).set_header(header);
    results.spinner.enable_steady_tick(Duration::from_millis(100));
    for name in names {
        with_scene!(name, S => check_scene::<S>(&mut results))
    }
    results.spinner.finish_and_clear();
    say(&results.table.to_string());
    say("errors are relative to the largest component, in double precision, against dual numbers");
    if results.failures.is_empty() {
        return Ok(());
    }
    bail!("{} of the checks failed:\n{}", results.failures.len(), results.failures.join("\n"));
}

fn check_scene<S: Scene>(results: &mut Results) {
    let defaults = Settings::<S>::defaults();
    let mut checked = None;
    for (name, task) in S::variants() {
        let system = task.system();
        let (n, m) = (system.state_dim(), system.control_dim());
        let network = defaults.policy.build(n, m);
        let linear = Linear::with_bias(n, m);
        results.add::<S>(&format!("{name}: system"), || check::try_system(system).map_err(Failure::from));
        // The same policies as in the variant before need no second look.
        if checked.replace((n, m)) != Some((n, m)) {
            results.add::<S>(&format!("{name}: network"), || check::try_policy(&network).map_err(Failure::from));
            results.add::<S>(&format!("{name}: linear policy"), || check::try_policy(&linear).map_err(Failure::from));
        }
        for flow in Flow::ALL {
            results.add::<S>(&format!("{name}: rollout, network, {flow}"), || check::try_flow(&task, &network, flow));
            results.add::<S>(&format!("{name}: rollout, linear, {flow}"), || check::try_flow(&task, &linear, flow));
        }
    }
}

struct Results {
    table: Table,
    failures: Vec<String>,
    spinner: ProgressBar,
}

impl Results {
    fn add<S: Scene>(&mut self, what: &str, check: impl FnOnce() -> Result<Passed, Failure>) {
        self.spinner.set_message(format!("{}, {what}", S::NAME));
        let (compared, worst, allowed, verdict) = match check() {
            Ok(p) => (p.compared.to_string(), format!("{:.1e}", p.worst), format!("{:.0e}", p.allowed), "ok"),
            Err(failure) => {
                self.failures.push(format!("{}, {what}: {failure}", S::NAME));
                (String::new(), String::new(), String::new(), "FAILED")
            }
        };
        self.table.add_row([S::NAME, what, &compared, &worst, &allowed, verdict]);
    }
}
