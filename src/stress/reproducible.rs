//! The same bytes, however they were computed.

use super::{Case, Finding};
use crate::policy::Mlp;
use crate::tasks::CartPole;
use crate::train::{Record, Session, Trainer, Training};

pub(super) const CASES: &[Case] = &[Case {
    name: "reproducible",
    about: "a training of cart-pole over 300 steps with 1, 2 and 8 workers, in little memory, resumed after every epoch",
    criterion: "the same bytes of parameters, optimizer and records; other bytes with another seed",
    story: "Sums over threads in the order in which they finish give other bits in each run. Here every sum has a fixed \
            order. Between processors, bits may differ: matrix products and the layers' tanh fuse where the processor \
            does",
    run: reproducible,
}];

const EPOCHS: usize = 4;

type Run = Session<CartPole, Mlp, f32>;

fn session(seed: u64, workers: usize, memory: Option<u64>) -> Option<Run> {
    let task = CartPole { horizon: 300, ..CartPole::new(2) };
    let training =
        Training { epochs: EPOCHS, batch: 13, train_samples: 39, test_samples: 8, seed, workers, memory, ..Training::default() };
    Trainer::new(task, Mlp::new([6, 16, 1])).training(training).session().ok()
}

/// Parameters and records after all epochs; the time an epoch took is left out.
fn bytes(session: &Run) -> (Vec<u32>, Vec<Record>) {
    let records = session.records().iter().map(|record| Record { seconds: 0.0, ..record.clone() });
    (session.weights().theta().iter().map(|t| t.to_bits()).collect(), records.collect())
}

fn trained(session: Option<Run>) -> Option<(Vec<u32>, Vec<Record>)> {
    let mut session = session?;
    while !session.is_done() {
        session.epoch().ok()?;
    }
    Some(bytes(&session))
}

/// The same, left and taken up again after so many epochs.
fn resumed(after: usize) -> Option<(Vec<u32>, Vec<Record>)> {
    let (mut first, mut second) = (session(0, 1, None)?, session(0, 2, None)?);
    for _ in 0..after {
        first.epoch().ok()?;
    }
    second.restore(&first.checkpoint("a run"), "a run").ok()?;
    trained(Some(second))
}

fn reproducible() -> Vec<Finding> {
    let one = trained(session(0, 1, None));
    let same = |what: String, other: Option<_>| {
        let pass = one.is_some() && other == one;
        Finding::holds(what, "the same bytes", pass, if pass { "the same" } else { "others" })
    };
    let mut findings = vec![
        same("2 workers".into(), trained(session(0, 2, None))),
        same("8 workers".into(), trained(session(0, 8, None))),
        same(
            "in 1.5 MB, which runs steps again".into(),
            trained(session(0, 1, Some(1_500_000)).filter(|session| session.schedule().recomputed_steps() > 0)),
        ),
    ];
    findings.extend((0..=EPOCHS).map(|after| same(format!("resumed after epoch {after}"), resumed(after))));
    let other = trained(session(1, 1, None));
    let pass = other.is_some() && other != one;
    findings.push(Finding::holds("another seed", "other bytes", pass, if pass { "others" } else { "the same" }));
    findings
}
