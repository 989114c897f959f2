//! `physgrad check`: the gradient checks of the library, as a table.

use super::scene::{NAMES, Network, Scene, with_scene};
use super::settings::Settings;
use super::train::say;
use anyhow::{Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use physgrad::check::{self, Mismatch, Passed};
use physgrad::policy::Linear;
use physgrad::{Flow, System};

/// Check the gradients of systems, policies and whole rollouts against dual numbers.
#[derive(Debug, clap::Args)]
pub struct Check {
    /// The task to check [default: all]
    pub task: Option<String>,
}

/// Runs the command.
pub fn check(args: &Check) -> Result<()> {
    let names = args.task.as_deref().map_or_else(|| NAMES.to_vec(), |name| vec![name]);
    let mut results = Results { table: Table::new(), failures: Vec::new() };
    results.table.load_style(UTF8_FULL_CONDENSED).set_header(["task", "checked", "compared", "worst error", "allowed", ""]);
    for name in names {
        with_scene!(name, S => check_scene::<S>(&mut results)?)
    }
    say(&results.table.to_string());
    say("errors are relative to the largest component, in double precision, against dual numbers");
    if results.failures.is_empty() {
        return Ok(());
    }
    bail!("{} of the checks failed:\n{}", results.failures.len(), results.failures.join("\n"));
}

fn check_scene<S: Scene>(results: &mut Results) -> Result<()> {
    let defaults = Settings::<S>::defaults();
    for (name, task) in S::variants() {
        let system = task.system();
        let (n, m) = (system.state_dim(), system.control_dim());
        let network = defaults.policy.build(n, m);
        let linear = Linear::with_bias(n, m);
        results.add::<S>(&format!("{name}: system"), check::try_system(system));
        results.add::<S>(&format!("{name}: network"), check::try_policy(&network));
        results.add::<S>(&format!("{name}: linear policy"), check::try_policy(&linear));
        for flow in Flow::ALL {
            results.add::<S>(&format!("{name}: rollout, network, {flow}"), check::try_flow(&task, &network, flow));
            results.add::<S>(&format!("{name}: rollout, linear, {flow}"), check::try_flow(&task, &linear, flow));
        }
    }
    Ok(())
}

struct Results {
    table: Table,
    failures: Vec<String>,
}

impl Results {
    fn add<S: Scene>(&mut self, what: &str, result: Result<Passed, Mismatch>) {
        let (compared, worst, allowed, verdict) = match &result {
            Ok(p) => (p.compared.to_string(), p.worst, p.allowed, "ok"),
            Err(m) => (m.to_string(), m.error, m.allowed, "FAILED"),
        };
        self.table.add_row([S::NAME, what, &compared, &format!("{worst:.1e}"), &format!("{allowed:.0e}"), verdict]);
        if let Err(mismatch) = result {
            self.failures.push(format!("{}, {what}: {mismatch}", S::NAME));
        }
    }
}
