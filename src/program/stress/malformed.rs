//! Damaged scenes and checkpoints.

use crate::program::allocations::peak_during;
use crate::program::document::Document;
use crate::program::presets;
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::stress::{Case, Finding};
use physgrad::{Session, Trainer, Training, policy::Mlp, tasks::CartPole};
use rand::RngExt;
use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

pub const CASES: [Case; 2] = [
    Case::new(
        "malformed_scenes",
        "40,000 scenes made of presets by random damage: bytes, lines, numbers and keys changed, left out or put in",
        "each is read or refused with a message; no panic; at most 1 MB and 200 times the size of the file allocated",
        "A parser that trusts a length, or a setting that trusts a number, ends a long queue of runs by a panic or takes all memory. \
         Every key is checked for type and range before anything is made of it, and a message names file, line, what was found and what \
         is allowed. What remains: a scene of a legal size may still be slow",
        scenes,
    ),
    Case::new(
        "malformed_checkpoints",
        "60,000 checkpoints damaged at random, with a checksum that fits: header, parameters, optimizer and records",
        "each is read or refused with a message; no panic; at most 1 MB and 20 times the size of the file allocated; a session that \
         refuses is as it was",
        "A file that was cut off by a full disk is taken up as if it were whole. Checkpoints have a checksum, are written beside \
         their name and renamed, and what is behind the checksum is checked as well; a run that is killed at any moment \
         resumes, which a test does 25 times. What remains: whoever forges a checksum can set parameters, as with any file of numbers",
        checkpoints,
    ),
];

/// What came of many inputs.
#[derive(Default)]
struct Tally {
    all: usize,
    refused: usize,
    panics: usize,
    /// The largest allocation, in relation to what is allowed.
    peak: f64,
    wrong: usize,
}

thread_local! {
    static EXPECTED: Cell<bool> = const { Cell::new(false) };
}

impl Tally {
    /// Reads one input of so many bytes.
    fn read(&mut self, bytes: usize, times: usize, read: impl FnOnce() -> bool) {
        // A panic is counted; its message would only fill the screen.
        static QUIET: Once = Once::new();
        QUIET.call_once(|| {
            let before = panic::take_hook();
            panic::set_hook(Box::new(move |info| {
                if !EXPECTED.get() {
                    before(info);
                }
            }));
        });
        EXPECTED.set(true);
        let (result, peak) = peak_during(|| panic::catch_unwind(AssertUnwindSafe(read)));
        EXPECTED.set(false);
        self.all += 1;
        self.peak = self.peak.max(peak as f64 / (1_000_000 + times * bytes) as f64);
        match result {
            Ok(taken) => self.refused += usize::from(!taken),
            Err(_) => self.panics += 1,
        }
    }

    fn findings(&self) -> Vec<Finding> {
        let Self { all, refused, panics, peak, .. } = self;
        vec![
            Finding::told("read, and refused", format!("{} and {refused}", all - refused - panics)),
            Finding::all("without a panic", all - panics, *all),
            Finding::at_most("largest allocation in relation to what is allowed", *peak, 1.0),
        ]
    }
}

/// Numbers and other things that scenes are not made for.
const STRANGE: [&str; 16] = [
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e308",
    "1e-320",
    "9223372036854775807",
    "-9223372036854775808",
    "true",
    "\"\"",
    "[]",
    "{}",
    "[1, \"a\"]",
    "1979-05-27",
    "\"\u{1F600}\"",
];

fn scenes() -> Vec<Finding> {
    let texts: Vec<&str> = presets::all().filter_map(|(name, _)| presets::text(name).ok()).collect();
    let mut rng = stream(0, Purpose::Check, 0);
    let mut tally = Tally::default();
    for i in 0..40_000 {
        let mut text = texts[i % texts.len()].as_bytes().to_vec();
        for _ in 0..rng.random_range(1..4) {
            damage(&mut rng, &mut text);
        }
        let text = String::from_utf8_lossy(&text).into_owned();
        tally.read(text.len(), 200, || match Document::parse("a scene", &text).and_then(|document| document.scene()) {
            Ok(_) => true,
            Err(error) => {
                assert!(!error.to_string().is_empty(), "a message");
                false
            }
        });
    }
    tally.findings()
}

/// Something that happens to files.
fn damage(rng: &mut Rng, text: &mut Vec<u8>) {
    let at = rng.random_range(0..=text.len());
    let lines: Vec<Vec<u8>> = text.split(|&byte| byte == b'\n').map(<[u8]>::to_vec).collect();
    let line = rng.random_range(0..lines.len());
    let mut changed = lines.clone();
    match rng.random_range(0..7) {
        0 => return text.truncate(at),
        1 => return text.insert(at, rng.random()),
        2 if at < text.len() => {
            text[at] ^= 1 << rng.random_range(0..8);
            return;
        }
        3 => drop(changed.remove(line)),
        4 => changed.insert(rng.random_range(0..lines.len()), lines[line].clone()),
        5 => {
            if let Some(equals) = changed[line].iter().position(|&byte| byte == b'=') {
                changed[line].truncate(equals + 1);
                changed[line].extend(STRANGE[rng.random_range(0..STRANGE.len())].as_bytes());
            }
        }
        _ => {
            let key = ["horizon", "effects.walls", "system.poles", "training", "a", "integrator.substeps", "[loss]"];
            changed.insert(
                line,
                format!("{} = {}", key[rng.random_range(0..key.len())], STRANGE[line % STRANGE.len()]).into_bytes(),
            );
        }
    }
    *text = changed.join(&b'\n');
}

fn session() -> Session<CartPole, Mlp, f32> {
    let task = CartPole { horizon: 3, ..CartPole::new(1) };
    let training = Training { train_samples: 4, test_samples: 4, ..Training::default() };
    Trainer::new(task, Mlp::new([4, 8, 1])).training(training).session().expect("valid settings")
}

fn checkpoints() -> Vec<Finding> {
    let mut session = session();
    (0..3).for_each(|_| drop(session.epoch().expect("finite").clone()));
    let good = session.checkpoint("a run");
    let mut other = self::session();
    let theta = other.weights().theta().to_vec();
    let mut rng = stream(1, Purpose::Check, 0);
    let mut tally = Tally::default();
    for _ in 0..60_000 {
        let mut bytes = good.clone();
        for _ in 0..rng.random_range(1..5) {
            let at = rng.random_range(0..bytes.len());
            match rng.random_range(0..5) {
                0 => bytes.truncate(at.max(1)),
                1 => bytes.insert(at, rng.random()),
                // Lengths of what follows are numbers of several bytes whose highest bits are set.
                2 => bytes.splice(at..at, [0xff; 9]).for_each(drop),
                _ => bytes[at] = rng.random(),
            }
        }
        Session::<CartPole, Mlp, f32>::seal(&mut bytes);
        let mut taken = false;
        tally.read(bytes.len(), 20, || {
            taken = other.restore(&bytes, "a run").is_ok();
            taken
        });
        if taken {
            // It may be another run's state, and then is not that of the next either.
            other = self::session();
        } else {
            tally.wrong += usize::from(other.weights().theta() != theta || !other.records().is_empty());
        }
    }
    let mut findings = tally.findings();
    findings.push(Finding::all("as it was, where it refuses", tally.all - tally.wrong, tally.all));
    findings
}
