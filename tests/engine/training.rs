//! Learning rates, refused settings, warnings and best parameters of trainings on plants with known
//! gradients.

use physgrad::policy::Constant;
use physgrad::rng::Rng;
use physgrad::{Clip, Decay, Field, Inputs, OptimizerKind, Scalar, Session, Start, System, Task, Trainer, Training};
use std::process::Command;

/// `x' = factor · x + u` from 0, with the cost `weight · x` of the last state. States below -1e6
/// become infinite.
#[derive(Clone, Debug)]
struct Plant {
    factor: f64,
    horizon: usize,
    weight: f64,
}

impl System for Plant {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let inside = x[0] * self.factor + u[0];
        next[0] = T::select_lt(inside, T::from(-1e6), T::from(f64::INFINITY), inside);
    }
}

impl Task for Plant {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        self.horizon
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 0.0;
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * self.weight
    }
}

/// Returns a trainer of `u = θ` from θ = 0, by gradient descent along M in double precision.
fn trainer(task: Plant, training: Training) -> Trainer<Plant, Constant, f64> {
    let training = Training { rule: OptimizerKind::Sgd, train_samples: 8, test_samples: 1, ..training };
    Trainer::new(task, Constant::new(1, 1)).precision::<f64>().field(Field::modified()).training(training)
}

/// Three epochs of four updates with a gradient of 1.
fn descent(decay: Decay, warm_up: usize) -> Session<Plant, Constant, f64> {
    let task = Plant { factor: 1.0, horizon: 1, weight: 1.0 };
    let training = Training { epochs: 3, batch: 2, learning_rate: 0.5, decay, warm_up, ..Training::default() };
    trainer(task, training).session().expect("valid settings")
}

#[test]
fn updates_have_the_learning_rates_of_the_decay() {
    for decay in [Decay::Constant, Decay::Cosine { end: 0.1 }, Decay::Exponential { end: 0.01 }] {
        for warm_up in [0, 5] {
            let mut session = descent(decay, warm_up);
            let mut theta = 0.0;
            for update in 0..12 {
                // Restores a checkpoint after every update.
                let mut next = descent(decay, warm_up);
                session.advance(&|| true).expect("finite");
                next.restore(&session.checkpoint("a run"), "a run").expect("its own checkpoint");
                session = next;
                // Documented formulas, with the progress s after the warm-up.
                let s = (f64::from(update) - warm_up as f64) / (12.0 - warm_up as f64);
                let factor = match decay {
                    _ if s < 0.0 => f64::from(update + 1) / (warm_up as f64 + 1.0),
                    Decay::Constant => 1.0,
                    Decay::Cosine { end } => end + (1.0 - end) * 0.5 * (1.0 + (std::f64::consts::PI * s).cos()),
                    Decay::Exponential { end } => (s * end.ln()).exp(),
                };
                theta -= 0.5 * factor;
                let found = session.weights().theta()[0];
                // Each update has a few rounding errors of numbers of at most 6.
                assert!((found - theta).abs() < 1e-13, "{decay:?}, warm-up {warm_up}, update {update}: {found}, not {theta}");
            }
            assert!(session.is_done());
        }
    }
}

#[test]
fn a_cosine_decay_to_2_and_an_exponential_decay_to_0_are_refused() {
    let refused = |decay| {
        let training = Training { decay, ..Training::default() };
        trainer(Plant { factor: 1.0, horizon: 1, weight: 1.0 }, training).session().expect_err("an invalid decay").to_string()
    };
    assert_eq!(refused(Decay::Cosine { end: 2.0 }), "training.decay: ends at 2; allowed: 0 to 1");
    assert_eq!(refused(Decay::Cosine { end: f64::NAN }), "training.decay: ends at NaN; allowed: 0 to 1");
    assert_eq!(refused(Decay::Exponential { end: 0.0 }), "training.decay: ends at 0; allowed: a positive number up to 1");
}

#[test]
fn limits_of_clipping_that_are_not_positive_are_refused() {
    for clip in [Clip::Norm(-1.0), Clip::Value(-1.0), Clip::Norm(0.0), Clip::Value(f64::NAN)] {
        let training = Training { clip, ..Training::default() };
        let error = trainer(Plant { factor: 1.0, horizon: 1, weight: 1.0 }, training).session().expect_err("an invalid limit");
        assert!(error.to_string().starts_with("training.clip: has the limit "), "{error}");
    }
}

/// Trainer on a plant that doubles its state. The adjoint of M grows by 2^14, 4.2 decades, in 14
/// steps. The last state is `g θ` and the gradient is `g`, with `g = 2^14 - 1 = 16383`. Each epoch
/// has one update. After n updates the last state is `-n · 1e-3 g² = -n · 2.68e5`. This value is
/// below -1e6 from n = 4 on: after epoch 4, and in the update of epoch 5.
fn doubling() -> Trainer<Plant, Constant, f64> {
    let training = Training { epochs: 6, learning_rate: 1e-3, ..Training::default() };
    trainer(Plant { factor: 2.0, horizon: 14, weight: 1.0 }, training)
}

fn warnings(trainer: Trainer<Plant, Constant, f64>) -> Vec<String> {
    let mut warnings = Vec::new();
    trainer.run_with_warnings(|warning| warnings.push(warning.to_owned())).expect("fewer skips than the limit");
    warnings
}

#[test]
fn each_kind_of_warning_appears_once_in_its_first_epoch() {
    let expected = [
        ("epoch 1: M grows by 10^4 along a rollout", "Clip by norm"),
        ("epoch 4: the training loss is not finite (forward pass", "Reduce"),
        ("epoch 4: the test loss is not finite (forward pass", "Reduce"),
        ("epoch 5: all 1 update(s) skipped, so the parameters did not change (forward pass", "Reduce"),
    ];
    let found = warnings(doubling());
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (found, (start, remedy)) in found.iter().zip(expected) {
        assert!(found.starts_with(start) && found.contains(remedy), "{found}");
    }
    let flat = warnings(trainer(Plant { factor: 1.0, horizon: 1, weight: 0.0 }, Training { epochs: 2, ..Training::default() }));
    assert!(matches!(&flat[..], [zero] if zero.starts_with("epoch 1: the field is exactly 0")), "{flat:?}");
    let task = Plant { factor: 1.0, horizon: 1, weight: 1.0 };
    assert_eq!(warnings(trainer(task, Training { epochs: 2, ..Training::default() })), [""; 0]);
}

#[test]
fn a_session_reports_each_warning_once_after_its_epoch() {
    let mut session = doubling().session().expect("valid settings");
    assert_eq!(session.warnings(), [""; 0]);
    session.epoch().expect("finite");
    assert_eq!(session.warnings().len(), 1);
    assert_eq!(session.warnings(), [""; 0], "a warning is reported twice");
}

/// Training with warnings. [`a_run_prints_its_warnings_to_standard_error`] runs this test in a
/// separate process.
#[test]
#[ignore = "prints"]
fn a_run_that_warns() {
    doubling().run().expect("fewer skips than the limit");
}

#[test]
fn a_run_prints_its_warnings_to_standard_error() {
    let mut process = Command::new(std::env::current_exe().expect("a path"));
    process.args(["--exact", "training::a_run_that_warns", "--ignored", "--nocapture"]);
    let output = process.output().expect("the test program starts");
    let printed = String::from_utf8(output.stderr).expect("text");
    assert!(output.status.success(), "{printed}");
    assert_eq!(printed.matches("warning: epoch").count(), 4, "{printed}");
    assert!(printed.contains("warning: epoch 1: M grows by 10^4"), "{printed}");
}

/// The loss is θ, and each of the four updates of an epoch subtracts the learning rate.
#[test]
fn the_best_parameters_precede_a_divergence_and_follow_a_start_from_parameters() {
    let task = Plant { factor: 1.0, horizon: 1, weight: 1.0 };
    let training = Training { epochs: 2, batch: 2, learning_rate: 2e5, ..Training::default() };
    let mut session = trainer(task.clone(), training.clone()).session().expect("valid settings");
    assert_eq!(session.best_theta(), [0.0], "the initial parameters");
    session.epoch().expect("an epoch");
    assert_eq!(session.best_theta(), [-8e5]);
    assert!(session.epoch().expect("skipped updates are allowed").test_loss.is_nan());
    assert_eq!(session.best_theta(), [-8e5]);
    assert!(session.weights().theta()[0] < -1e6);

    let training = Training { epochs: 1, learning_rate: 0.5, ..training };
    let report = trainer(task, training).start_from(vec![5.0]).run().expect("valid settings");
    assert_eq!((report.weights.theta(), report.best.theta()), (&[3.0][..], &[3.0][..]));
}
