//! Checkpoints that have a valid checksum but damaged contents, or that belong to another training.

use physgrad::train::{OptimizerKind, Session};
use physgrad::{Trainer, Training, policy::Mlp, tasks::CartPole};
use std::panic::{AssertUnwindSafe, catch_unwind};

type Small = Session<CartPole, Mlp, f32>;

fn session(rule: &str, learning_rate: f64) -> Small {
    session_of(CartPole { horizon: 3, ..CartPole::new(1) }, rule, learning_rate)
}

fn session_of(task: CartPole, rule: &str, learning_rate: f64) -> Small {
    let rule = OptimizerKind::named(rule).expect("a known optimizer");
    let training = Training {
        rule,
        learning_rate,
        batch: 2,
        train_samples: 4,
        test_samples: 2,
        ..Training::default()
    };
    Trainer::new(task, Mlp::new([4, 2, 1])).training(training).session().expect("valid settings")
}

/// Returns a session after two epochs. If `paused`, the session has also done one of the two
/// updates of the third epoch.
fn trained(rule: &str, paused: bool) -> Small {
    let mut session = session(rule, 1e-3);
    (0..2).for_each(|_| drop(session.epoch().expect("finite").clone()));
    if paused {
        assert!(
            session.advance(&|| true).expect("finite").is_none(),
            "the epoch ends after one update"
        );
    }
    session
}

/// Corrects the checksum, restores the bytes, and trains to the end of an epoch.
fn restored_and_trained(rule: &str, bytes: &mut [u8]) -> Result<(), String> {
    Small::seal(bytes);
    let mut session = session(rule, 1e-3);
    session.restore(bytes, "a run").map_err(|error| error.to_string())?;
    session.epoch().map(drop).map_err(|error| error.to_string())
}

/// Damages each byte of the contents in eleven ways. The contents follow 14 bytes: magic number,
/// format number and checksum.
#[test]
fn a_damaged_checkpoint_is_refused_or_trains_an_epoch_without_a_panic() {
    for (rule, paused) in [("adam", false), ("adam", true), ("adagrad", true)] {
        let good = trained(rule, paused).checkpoint("a run");
        restored_and_trained(rule, &mut good.clone()).expect("its own checkpoint");
        for at in 14..good.len() {
            let replaced = |with: &[u8]| [&good[..at], with, &good[at + 1..]].concat();
            let byte = good[at];
            let mut damaged: Vec<Vec<u8>> =
                [0, 1, 0x7f, 0x80, 0xff, byte ^ 1, byte.wrapping_add(1), byte.wrapping_sub(1)]
                    .map(|byte| replaced(&[byte]))
                    .into();
            damaged.extend([replaced(&[]), replaced(&[byte, byte]), replaced(&[0xff; 9])]);
            for mut bytes in damaged {
                let outcome =
                    catch_unwind(AssertUnwindSafe(|| restored_and_trained(rule, &mut bytes)));
                assert!(outcome.is_ok(), "{rule}, paused: {paused}, byte {at}: {byte:#x}");
            }
        }
    }
}

#[test]
fn a_restored_session_notices_that_the_equations_have_changed() {
    let bytes = trained("adam", true).checkpoint("a run");
    let mut same = session("adam", 1e-3);
    assert_eq!(same.changed_test_loss(), None, "no epoch has a test loss");
    same.restore(&bytes, "a run").expect("its own checkpoint");
    assert_eq!(same.changed_test_loss(), None);

    let mut system = CartPole::new(1).system;
    system.gravity = 20.0.into();
    let mut changed = session_of(CartPole { horizon: 3, system, ..CartPole::new(1) }, "adam", 1e-3);
    changed.restore(&bytes, "a run").expect("a checkpoint with an equal label");
    let [recorded, computed] = changed.changed_test_loss().expect("another loss");
    let lowest =
        changed.records().iter().map(|record| record.test_loss).fold(f64::INFINITY, f64::min);
    assert_eq!(recorded, lowest);
    assert_ne!(computed, recorded);
}

#[test]
fn a_checkpoint_of_another_optimizer_is_refused() {
    let bytes = trained("adam", false).checkpoint("a run");
    for (rule, rate) in [("adam", 2e-3), ("adadelta", 1e-3), ("sgd", 1e-3)] {
        let mut other = session(rule, rate);
        let error = other.restore(&bytes, "a run").expect_err("another optimizer").to_string();
        assert!(error.contains("its optimizer is Adam"), "{error}");
        assert!(other.records().is_empty(), "the refused checkpoint changes the session");
    }
}

#[test]
fn a_checkpoint_with_another_number_of_updates_per_epoch_is_refused() {
    let bytes = trained("adam", false).checkpoint("a run");
    let task = CartPole { horizon: 3, ..CartPole::new(1) };
    let training = Training { batch: 4, train_samples: 4, test_samples: 2, ..Training::default() };
    let mut other = Trainer::new(task, Mlp::new([4, 2, 1]))
        .training(training)
        .session()
        .expect("valid settings");
    let error = other.restore(&bytes, "a run").expect_err("another number of updates").to_string();
    assert!(
        error.contains("its optimizer counts 4 steps, but its epochs have 2 updates"),
        "{error}"
    );
}
