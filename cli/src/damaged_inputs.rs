//! Damaged scenes, assignments, checkpoints and run folders: no panic, within limits of time and
//! memory. The number of an input alone determines it.

#![expect(clippy::print_stdout, reason = "a test prints what happened to its inputs")]

mod inputs;

use crate::platform::parallel;
use inputs::KINDS;
use physgrad::rng::{Purpose, stream};
use std::cell::RefCell;
use std::panic::{self, AssertUnwindSafe};
use std::time::Instant;

/// Longest permitted time per input, s. Includes a margin for a loaded machine.
const MAX_SECONDS: f64 = 10.0;

/// Inputs per work item.
const PORTION: u64 = 200;

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
        let mut result = None;
        let bytes = allocation_counter::measure(|| {
            result = Some(panic::catch_unwind(AssertUnwindSafe(work)))
        })
        .bytes_max;
        let result = result.expect("`measure` runs the closure");
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

    /// One line per limit that the inputs of this kind exceed.
    fn failures(&self, name: &str) -> Vec<String> {
        let panics = self
            .panics
            .iter()
            .take(5)
            .map(|(input, panic)| format!("{name}: input {input} panics: {panic}"));
        let (peak, time) = (self.peak, self.time);
        let memory = (peak.0 > 1.0)
            .then(|| format!("{name}: input {} takes {:.1} times its memory", peak.1, peak.0));
        let time = (time.0 > MAX_SECONDS)
            .then(|| format!("{name}: input {} takes {:.1} s", time.1, time.0));
        panics.chain(memory).chain(time).collect()
    }
}

/// Uses these inputs, prints what happened to each kind, and returns the failures.
fn failures(inputs: std::ops::Range<u64>) -> Vec<String> {
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|info| PANIC.set(Some(info.to_string()))));
    let portions: Vec<u64> = inputs.clone().step_by(PORTION as usize).collect();
    let results = parallel::map(&portions, |&begin| {
        let mut outcomes = KINDS.map(|_| Outcomes::default());
        for number in begin..inputs.end.min(begin + PORTION) {
            let kind = kind_of(number);
            (KINDS[kind].attempt)(number, &mut outcomes[kind]);
        }
        outcomes
    });
    panic::set_hook(hook);
    let mut outcomes = KINDS.map(|_| Outcomes::default());
    for portion in results {
        outcomes.iter_mut().zip(portion).for_each(|(all, portion)| all.merge(portion));
    }
    let line = |(kind, Outcomes { accepted, rejected, panics, peak, time }): (&Kind, &Outcomes)| {
        let (panics, peak, time) = (panics.len(), peak.0, time.0);
        println!(
            "{}: {accepted} accepted, {rejected} rejected, {panics} panics; memory {peak:.2}, {time:.2} s",
            kind.name
        );
    };
    KINDS.iter().zip(&outcomes).for_each(line);
    KINDS.iter().zip(&outcomes).flat_map(|(kind, outcomes)| outcomes.failures(kind.name)).collect()
}

#[test]
fn damaged_inputs_cause_no_panic_and_stay_within_limits_of_time_and_memory() {
    let failures = failures(0..2_600);
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
#[ignore = "long: a minute; `cargo test --release -- --include-ignored` runs it"]
fn many_damaged_inputs_cause_no_panic() {
    let failures = failures(2_600..130_000);
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Random numbers of an input.
fn numbers_of(input: u64) -> physgrad::rng::Rng {
    stream(0, Purpose::Check, input)
}
