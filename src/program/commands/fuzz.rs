//! `physgrad fuzz`: reads damaged inputs, counts panics, and measures time and memory.

mod inputs;

use crate::program::commands::stress::{passes, table};
use crate::program::operations::peak_bytes;
use crate::program::platform::parallel;
use crate::program::platform::terminal::print_result;
use crate::rng::{Purpose, stream};
use crate::stress::Finding;
use anyhow::{Result, bail};
use inputs::KINDS;
use std::cell::RefCell;
use std::fs;
use std::panic::{self, AssertUnwindSafe};
use std::time::Instant;

/// Longest permitted time per input, s. Includes a margin for a loaded machine.
const MAX_SECONDS: f64 = 10.0;

/// Permitted memory of the process, bytes.
const MAX_MEMORY: f64 = 1e9;

/// Inputs per work item.
const PORTION: u64 = 200;

/// Damage scenes, assignments, checkpoints and run folders, and use them. Count panics, and measure
/// time and memory.
#[derive(Debug, clap::Args)]
pub struct Fuzz {
    /// Number of inputs of all kinds
    #[arg(long, value_name = "N", default_value_t = 130_000)]
    pub inputs: u64,
    /// Number of the first input; the number alone determines an input
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first: u64,
}

/// One kind of input.
struct Kind {
    name: &'static str,
    /// Number of inputs of this kind among [`all_shares`] consecutive inputs.
    share: u64,
    /// Generates the input with this number and uses it within `Outcomes::record`.
    attempt: fn(u64, &mut Outcomes),
}

fn all_shares() -> u64 {
    KINDS.iter().map(|kind| kind.share).sum()
}

/// Index into [`KINDS`] for an input.
fn kind_of(number: u64) -> usize {
    let mut offset = number % all_shares();
    KINDS
        .iter()
        .position(|kind| offset.checked_sub(kind.share).map(|rest| offset = rest).is_none())
        .expect("an offset in a share")
}

thread_local! {
    /// Location and message of the last panic on this thread.
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Outcomes of the inputs of one kind.
#[derive(Default)]
struct Outcomes {
    accepted: u64,
    rejected: u64,
    /// Input numbers and panic messages.
    panics: Vec<(u64, String)>,
    /// Largest ratio of used to permitted memory, and its input.
    peak: (f64, u64),
    /// Longest time, s, and its input.
    time: (f64, u64),
}

impl Outcomes {
    /// Runs `work`, which uses the input `number`. Records the outcome, the time, and the ratio of
    /// used memory to `allowed` bytes. `work` returns true if the input is accepted.
    fn record(&mut self, number: u64, allowed: usize, work: impl FnOnce() -> bool) {
        let begin = Instant::now();
        let (result, bytes) = peak_bytes(|| panic::catch_unwind(AssertUnwindSafe(work)));
        let (time, peak) = (begin.elapsed().as_secs_f64(), bytes as f64 / allowed as f64);
        match result {
            Ok(true) => self.accepted += 1,
            Ok(false) => self.rejected += 1,
            Err(_) => self.panics.push((number, PANIC.take().unwrap_or_default())),
        }
        self.peak = if peak > self.peak.0 { (peak, number) } else { self.peak };
        self.time = if time > self.time.0 { (time, number) } else { self.time };
    }

    fn merge(&mut self, other: Self) {
        self.accepted += other.accepted;
        self.rejected += other.rejected;
        self.panics.extend(other.panics);
        self.peak = if other.peak.0 > self.peak.0 { other.peak } else { self.peak };
        self.time = if other.time.0 > self.time.0 { other.time } else { self.time };
    }

    fn findings(&self, name: &str) -> Vec<Finding> {
        let Self { accepted, rejected, panics, peak, time } = self;
        let all = *accepted as usize + *rejected as usize + panics.len();
        let panics_of =
            panics.iter().take(5).map(|(number, message)| Finding::holds(format!("input {number}"), "no panic", false, message));
        let mut findings = vec![
            Finding::info(format!("{name}: accepted and rejected inputs"), format!("{accepted} and {rejected}")),
            Finding::all(format!("{name}: without a panic"), all - panics.len(), all),
            Finding::at_most(format!("{name}: largest ratio of used to permitted memory (input {})", peak.1), peak.0, 1.0),
            Finding::at_most(format!("{name}: longest time, s (input {})", time.1), time.0, MAX_SECONDS),
        ];
        findings.extend(panics_of);
        findings
    }
}

/// Runs the command.
pub fn fuzz(args: &Fuzz) -> Result<()> {
    panic::set_hook(Box::new(|info| PANIC.set(Some(info.to_string()))));
    let end = args.first.saturating_add(args.inputs);
    let portions: Vec<u64> = (args.first..end).step_by(PORTION as usize).collect();
    let results = parallel::map(&portions, |&begin| {
        let mut outcomes = KINDS.map(|_| Outcomes::default());
        for number in begin..end.min(begin + PORTION) {
            let kind = kind_of(number);
            (KINDS[kind].attempt)(number, &mut outcomes[kind]);
        }
        outcomes
    });
    drop(panic::take_hook());
    let mut outcomes = KINDS.map(|_| Outcomes::default());
    for portion in results {
        outcomes.iter_mut().zip(portion).for_each(|(all, portion)| all.merge(portion));
    }
    let used = KINDS.iter().zip(&outcomes).filter(|(_, outcomes)| outcomes.time.0 > 0.0);
    let mut findings: Vec<Finding> = used.flat_map(|(kind, outcomes)| outcomes.findings(kind.name)).collect();
    if let Some(bytes) = peak_of_process() {
        findings.push(Finding::at_most("peak memory of the process, MB", bytes * 1e-6, MAX_MEMORY * 1e-6));
    }
    print_result(&format!("{} inputs\n{}", args.inputs, table(&findings)))?;
    if !passes(&findings) {
        bail!("some rows of the table fail; `physgrad fuzz --first NUMBER --inputs 1` repeats an input that a row names");
    }
    Ok(())
}

/// Peak memory of the process in bytes. None if the system does not report it.
fn peak_of_process() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let kib = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix("kB"))?;
    kib.trim().parse().ok().map(|kib: f64| kib * 1024.0)
}

/// Random numbers of an input.
fn numbers_of(input: u64) -> crate::rng::Rng {
    stream(0, Purpose::Check, input)
}
