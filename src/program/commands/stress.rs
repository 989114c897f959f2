//! `physgrad stress`: runs the hard cases and compares their results with their criteria.

mod reproducible;

use crate::program::platform::json::print_json;
use crate::program::platform::parallel;
use crate::program::platform::table::Table;
use crate::program::platform::terminal::{print_result, print_text, progress_bar};
use crate::stress::{self, Case, Finding};
use anyhow::{Result, bail};
use serde_json::json;
use std::time::Instant;

/// Run the hard cases: long horizons, stiffness, chaos, singular geometry, overflow.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  physgrad stress --list\n  physgrad stress double_pendulum contact")]
pub struct Stress {
    /// Cases to run, by name or prefix [default: all]
    pub cases: Vec<String>,
    /// List the cases and their criteria without running them
    #[arg(long, conflicts_with = "json")]
    list: bool,
    /// Print Markdown, as in docs/stability.md
    #[arg(long, conflicts_with = "json")]
    markdown: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/json.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn stress(args: &Stress) -> Result<()> {
    let cases = chosen(&args.cases)?;
    if args.list {
        let lines: Vec<String> =
            cases.iter().map(|case| format!("{}: {}\n    passes when: {}", case.name, case.about, case.criterion)).collect();
        return print_text(&lines.join("\n"));
    }
    let bar = progress_bar(cases.len(), "{bar:20} {pos}/{len} cases  {msg}  {elapsed}", false);
    bar.tick();
    let run = |case: &Case| {
        let begin = Instant::now();
        let findings = case.run();
        bar.set_message(case.name);
        bar.inc(1);
        (findings, begin.elapsed().as_secs_f64())
    };
    let results: Vec<(Vec<Finding>, f64)> = parallel::map(&cases, run);
    bar.finish_and_clear();
    if args.markdown {
        print_result(HEAD)?;
    }
    if args.json {
        let found = cases.iter().zip(&results).map(|(case, (findings, seconds))| {
            let pass = passes(findings);
            let findings = findings.iter().map(|Finding { what, measured, limit, pass }| {
                json!({ "what": what, "measured": measured, "required": limit, "pass": pass })
            });
            let findings = findings.collect::<Vec<_>>();
            json!({ "name": case.name, "pass": pass, "seconds": seconds, "findings": findings })
        });
        print_json(&json!({ "cases": found.collect::<Vec<_>>() }))?;
    }
    for (case, (findings, seconds)) in cases.iter().zip(&results).filter(|_| !args.json) {
        if args.markdown { print_result(&markdown(case, findings)) } else { print_text(&text(case, findings, *seconds)) }?;
    }
    let failed: Vec<&str> =
        cases.iter().zip(&results).filter(|(_, (found, _))| !passes(found)).map(|(case, _)| case.name).collect();
    if !failed.is_empty() {
        bail!("{} of {} cases failed: {}", failed.len(), cases.len(), failed.join(", "));
    }
    if !args.markdown && !args.json {
        print_result(&format!("{} of {} cases pass", cases.len(), cases.len()))?;
    }
    Ok(())
}

/// Cases whose names start with one of these prefixes. Without prefixes, all cases.
fn chosen(names: &[String]) -> Result<Vec<Case>> {
    let all: Vec<Case> = stress::cases().chain(reproducible::CASES).collect();
    if let Some(name) = names.iter().find(|name| !all.iter().any(|case| case.name.starts_with(name.as_str()))) {
        let known: Vec<&str> = all.iter().map(|case| case.name).collect();
        bail!("there is no case `{name}`; available: {}", known.join(", "));
    }
    let is_chosen = |case: &Case| names.is_empty() || names.iter().any(|name| case.name.starts_with(name.as_str()));
    Ok(all.into_iter().filter(is_chosen).collect())
}

pub fn passes(findings: &[Finding]) -> bool {
    !findings.is_empty() && findings.iter().all(|finding| finding.pass)
}

pub fn table(findings: &[Finding]) -> Table {
    let mut table = Table::new(["", "measured", "required", ""]);
    for Finding { what, measured, limit, pass } in findings {
        let verdict = match (limit.is_empty(), pass) {
            (true, _) => "",
            (_, true) => "pass",
            (_, false) => "FAIL",
        };
        table.row([what, measured, limit, verdict]);
    }
    table
}

fn text(case: &Case, findings: &[Finding], seconds: f64) -> String {
    let Case { name, about, criterion, .. } = case;
    let verdict = if passes(findings) { "pass" } else { "FAIL" };
    let table = table(findings);
    format!("{name}: {verdict} ({seconds:.1} s)\n  {about}\n  passes when: {criterion}\n{table}\n")
}

fn markdown(case: &Case, findings: &[Finding]) -> String {
    let Case { name, about, criterion, explanation, .. } = case;
    format!("\n## {name}\n\n{about}.\n\nPasses when: {criterion}.\n\n{}\n\n{explanation}.", table(findings).markdown())
}

/// Head of the Markdown page.
const HEAD: &str = "\
# Stability

Numerically hard cases, their criteria, and measured values. Criteria precede the first measurement. Two quantities
exceed their declared bounds and are reported without a bound: the error of springs with 42 to 60 steps per contact
(`contact`), and the f32 norm without control (`quantum_long`). `physgrad stress` and the tests run all cases. `physgrad stress
--markdown` prints this text. The last digits depend on the processor.";
