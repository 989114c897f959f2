//! `physgrad fuzz`: damaged inputs, and what becomes of them.

mod inputs;

use crate::program::commands::stress::{passes, table};
use crate::program::platform::allocations::peak_during;
use crate::program::platform::parallel;
use crate::program::platform::terminal::say;
use anyhow::{Result, bail};
use comfy_table::presets::UTF8_FULL_CONDENSED;
use inputs::KINDS;
use physgrad::rng::{Purpose, stream};
use physgrad::stress::Finding;
use std::cell::RefCell;
use std::fs;
use std::panic::{self, AssertUnwindSafe};
use std::time::Instant;

/// The longest time that one input may take, s. They take milliseconds; the rest is for a machine under load.
const LONGEST: f64 = 10.0;

/// Bytes that the whole process may take.
const MOST_MEMORY: f64 = 1e9;

/// Inputs that one worker takes at a time.
const PORTION: u64 = 200;

/// Damage scenes, assignments, checkpoints and run folders, read and use them, and count panics, time and memory.
#[derive(Debug, clap::Args)]
pub struct Fuzz {
    /// Number of inputs, of all kinds together
    #[arg(long, value_name = "N", default_value_t = 130_000)]
    pub inputs: u64,
    /// Number of the first input; its number alone decides what an input is
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first: u64,
}

/// One kind of input.
struct Kind {
    name: &'static str,
    /// Inputs of this kind among [`all_shares`] in a row.
    share: u64,
    /// Makes an input of this number, and uses it within `Watched::read`.
    attempt: fn(u64, &mut Watched),
}

fn all_shares() -> u64 {
    KINDS.iter().map(|kind| kind.share).sum()
}

/// Position in [`KINDS`] of the kind of an input.
fn kind_of(number: u64) -> usize {
    let mut place = number % all_shares();
    KINDS.iter().position(|kind| place.checked_sub(kind.share).map(|rest| place = rest).is_none()).expect("a place in a share")
}

thread_local! {
    /// Place and message of a panic, on a thread that expects one.
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Uses of inputs of one kind.
#[derive(Default)]
struct Watched {
    accepted: u64,
    refused: u64,
    /// Numbers of inputs, and messages of their panics.
    panics: Vec<(u64, String)>,
    /// The largest memory in relation to the allowed one, and the input that took it.
    peak: (f64, u64),
    /// The longest time, s, and the input that took it.
    time: (f64, u64),
}

impl Watched {
    /// Uses input `number`, which may take so many bytes of memory. `work` returns whether it was accepted.
    fn read(&mut self, number: u64, allowed: usize, work: impl FnOnce() -> bool) {
        let begin = Instant::now();
        let (result, bytes) = peak_during(|| panic::catch_unwind(AssertUnwindSafe(work)));
        let (time, peak) = (begin.elapsed().as_secs_f64(), bytes as f64 / allowed as f64);
        match result {
            Ok(true) => self.accepted += 1,
            Ok(false) => self.refused += 1,
            Err(_) => self.panics.push((number, PANIC.take().unwrap_or_default())),
        }
        self.peak = if peak > self.peak.0 { (peak, number) } else { self.peak };
        self.time = if time > self.time.0 { (time, number) } else { self.time };
    }

    fn merge(&mut self, other: Self) {
        self.accepted += other.accepted;
        self.refused += other.refused;
        self.panics.extend(other.panics);
        self.peak = if other.peak.0 > self.peak.0 { other.peak } else { self.peak };
        self.time = if other.time.0 > self.time.0 { other.time } else { self.time };
    }

    fn findings(&self, name: &str) -> Vec<Finding> {
        let Self { accepted, refused, panics, peak, time } = self;
        let all = *accepted as usize + *refused as usize + panics.len();
        let panics_of =
            panics.iter().take(5).map(|(number, message)| Finding::holds(format!("input {number}"), "no panic", false, message));
        let mut findings = vec![
            Finding::told(format!("{name}: accepted, and refused"), format!("{accepted} and {refused}")),
            Finding::all(format!("{name}: without a panic"), all - panics.len(), all),
            Finding::at_most(format!("{name}: memory in relation to what is allowed (input {})", peak.1), peak.0, 1.0),
            Finding::at_most(format!("{name}: longest time, s (input {})", time.1), time.0, LONGEST),
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
        let mut watched = KINDS.map(|_| Watched::default());
        for number in begin..end.min(begin + PORTION) {
            let kind = kind_of(number);
            (KINDS[kind].attempt)(number, &mut watched[kind]);
        }
        watched
    });
    drop(panic::take_hook());
    let mut watched = KINDS.map(|_| Watched::default());
    for portion in results {
        watched.iter_mut().zip(portion).for_each(|(all, portion)| all.merge(portion));
    }
    let used = KINDS.iter().zip(&watched).filter(|(_, watched)| watched.time.0 > 0.0);
    let mut findings: Vec<Finding> = used.flat_map(|(kind, watched)| watched.findings(kind.name)).collect();
    if let Some(bytes) = peak_of_process() {
        findings.push(Finding::at_most("largest memory of the process, MB", bytes * 1e-6, MOST_MEMORY * 1e-6));
    }
    say(&format!("{} inputs\n{}", args.inputs, table(&findings, UTF8_FULL_CONDENSED)))?;
    if !passes(&findings) {
        bail!("inputs do harm; `physgrad fuzz --first NUMBER --inputs 1` repeats one of them");
    }
    Ok(())
}

/// The most bytes of memory that the process has had, where the system tells.
fn peak_of_process() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let kib = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix("kB"))?;
    kib.trim().parse().ok().map(|kib: f64| kib * 1024.0)
}

/// The random numbers of an input.
fn numbers_of(input: u64) -> physgrad::rng::Rng {
    stream(0, Purpose::Check, input)
}
