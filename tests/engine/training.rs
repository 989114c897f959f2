//! Learning rates, refused settings, warnings and best parameters of trainings on plants with known
//! gradients.

use physgrad::engine::Variable;
use physgrad::number::Varied;
use physgrad::policy::{Constant, TrainedParam, WithParams};
use physgrad::rng::{Purpose, Rng};
use physgrad::train::{Decay, OptimizerKind, Session};
use physgrad::{
    Adjoint, Clip, Divergence, Field, Flow, Gradient, Inputs, Number, Numbers, Optimizer, Rollout,
    Scalar, Start, System, Task, Trainer, Training, Weights, initial_states,
};
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
    let training =
        Training { rule: OptimizerKind::Sgd, train_samples: 8, test_samples: 1, ..training };
    Trainer::new(task, Constant::new(1, 1))
        .precision::<f64>()
        .field(Field::modified())
        .training(training)
}

/// Three epochs of four updates with a gradient of 1.
fn descent(decay: Decay, warm_up: usize) -> Session<Plant, Constant, f64> {
    let task = Plant { factor: 1.0, horizon: 1, weight: 1.0 };
    let training =
        Training { epochs: 3, batch: 2, learning_rate: 0.5, decay, warm_up, ..Training::default() };
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
                    Decay::Cosine { end } => {
                        end + (1.0 - end) * 0.5 * (1.0 + (std::f64::consts::PI * s).cos())
                    }
                    Decay::Exponential { end } => (s * end.ln()).exp(),
                };
                theta -= 0.5 * factor;
                let found = session.weights().theta()[0];
                // Each update has a few rounding errors of numbers of at most 6.
                assert!(
                    (found - theta).abs() < 1e-13,
                    "{decay:?}, warm-up {warm_up}, update {update}: {found}, not {theta}"
                );
            }
            assert!(session.is_done());
        }
    }
}

#[test]
fn a_cosine_decay_to_2_and_an_exponential_decay_to_0_are_refused() {
    let refused = |decay| {
        let training = Training { decay, ..Training::default() };
        trainer(Plant { factor: 1.0, horizon: 1, weight: 1.0 }, training)
            .session()
            .expect_err("an invalid decay")
            .to_string()
    };
    assert_eq!(refused(Decay::Cosine { end: 2.0 }), "training.decay: ends at 2; allowed: 0 to 1");
    assert_eq!(
        refused(Decay::Cosine { end: f64::NAN }),
        "training.decay: ends at NaN; allowed: 0 to 1"
    );
    assert_eq!(
        refused(Decay::Exponential { end: 0.0 }),
        "training.decay: ends at 0; allowed: a positive number up to 1"
    );
}

#[test]
fn limits_of_clipping_that_are_not_positive_are_refused() {
    for clip in [Clip::Norm(-1.0), Clip::Value(-1.0), Clip::Norm(0.0), Clip::Value(f64::NAN)] {
        let training = Training { clip, ..Training::default() };
        let error = trainer(Plant { factor: 1.0, horizon: 1, weight: 1.0 }, training)
            .session()
            .expect_err("an invalid limit");
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
    trainer
        .run_with_warnings(|warning| warnings.push(warning.to_owned()))
        .expect("fewer skips than the limit");
    warnings
}

#[test]
fn each_kind_of_warning_appears_once_in_its_first_epoch() {
    let expected = [
        ("epoch 1: M grows by 10^4 along a rollout", "Clip by norm"),
        (
            "epoch 4: the training loss is not finite (forward pass",
            "Reduce the time step or the learning rate",
        ),
        (
            "epoch 4: the test loss is not finite (forward pass",
            "Reduce the time step or the learning rate",
        ),
        (
            "epoch 5: all 1 update(s) skipped, so the parameters did not change (forward pass",
            "Reduce the time step or the learning rate",
        ),
    ];
    let found = warnings(doubling());
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (found, (start, remedy)) in found.iter().zip(expected) {
        assert!(found.starts_with(start) && found.contains(remedy), "{found}");
    }
    let flat = warnings(trainer(
        Plant { factor: 1.0, horizon: 1, weight: 0.0 },
        Training { epochs: 2, ..Training::default() },
    ));
    assert!(
        matches!(&flat[..], [zero] if zero.starts_with("epoch 1: the field is exactly 0")),
        "{flat:?}"
    );
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
    process.args(["--exact", "engine::training::a_run_that_warns", "--ignored", "--nocapture"]);
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

#[test]
fn numbers_of_epochs_and_seeds_hold_before_and_after_all_settings() {
    let settings = Training { epochs: 1, seed: 1, learning_rate: 0.25, ..Training::default() };
    let plain = || {
        Trainer::new(Plant { factor: 1.0, horizon: 1, weight: 1.0 }, Constant::new(1, 1))
            .precision::<f64>()
    };
    for trainer in [
        plain().epochs(3).seed(5).training(settings.clone()),
        plain().training(settings.clone()).seed(5).epochs(3),
    ] {
        let same = Training { epochs: 3, seed: 5, ..settings.clone() };
        let [found, expected] =
            [trainer, plain().training(same)].map(|trainer| trainer.run().expect("finite"));
        assert_eq!(found.records.len(), 3);
        assert_eq!(found.weights.theta(), expected.weights.theta());
    }
}

/// The control of the first step acts on a state that shrinks by 1e-3 in each of 30 steps. The
/// gradient, 1e-87, is below the range of f32, so a step along it leaves θ unchanged.
#[test]
fn a_step_of_an_optimizer_without_clipping_applies_the_exponent_of_the_gradient() {
    #[derive(Clone, Debug)]
    struct Shrinking;
    impl System for Shrinking {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = if t == 0 { u[0] } else { x[0] * 1e-3 };
        }
    }
    impl Task for Shrinking {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            30
        }
        fn start(&self, _: &mut Rng, start: Start<'_>) {
            start.x[0] = 1.0;
        }
        fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
            x[0]
        }
    }
    let policy = Constant::new(1, 1);
    let mut weights = Weights::<f32>::new(&policy, vec![1.0]);
    let mut rollout = Rollout::new(&Shrinking, &policy, 1);
    let mut adjoint = Adjoint::new(&Shrinking, &policy, &rollout, &[Flow::REGULAR]);
    rollout.start(&[1.0]);
    rollout.run(&Shrinking, &policy, &weights).expect("finite");
    adjoint.run(&Shrinking, &policy, &weights, &rollout, 1.0).expect("finite");
    let mut gradient = Gradient::zeros(1);
    adjoint.param_gradient(0, &policy, &weights, &rollout, 0..1, &mut gradient);
    assert!((gradient.norm().log10() + 87.0).abs() < 1e-4, "{}", gradient.norm());
    let mut optimizer = Optimizer::new(OptimizerKind::Sgd, 1.0, 1);
    weights.update(&policy, |theta| optimizer.step(theta, &gradient));
    assert_eq!(weights.theta(), [1.0]);
}

/// How the trained number `off` enters.
#[derive(Clone, Copy, Debug)]
enum Role {
    /// A constant push ends at the time `off`.
    Comparison,
    Absent,
    /// The next state contains `off` times this weight.
    Linear(f64),
}

/// `x' = x + u + push`, with the last state as cost. Steps of 0.1 s.
#[derive(Clone, Debug)]
struct Pushed {
    off: Number,
    role: Role,
}

impl System for Pushed {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([("off", &self.off)])
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, t }: Inputs<'_, T>, next: &mut [T]) {
        let [off] = self.numbers().last_of(p);
        let push = match self.role {
            Role::Comparison => T::select_lt(T::from(0.1 * t as f64), off, T::one(), T::zero()),
            Role::Absent => T::zero(),
            Role::Linear(weight) => off * weight,
        };
        next[0] = x[0] + u[0] + push;
    }
}

impl Task for Pushed {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        10
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 0.0;
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
        x[0]
    }
}

/// The push ends after step 5 for `off` = 0.55 s, after step 6 for 0.605 s, and after step 4 for
/// 0.495 s: the loss depends on the number, but its slope is 0.
#[test]
fn trained_numbers_that_training_cannot_determine_are_named_once_with_a_remedy() {
    let start = 0.55;
    let free = TrainedParam::linear(0, start);
    let [above, bounded] =
        [TrainedParam::above(0, start, 0.5), TrainedParam::bounded(0, start, 0.5, 0.7)];
    for (param, role, learning_rate, expected, remedy) in [
        (
            free,
            Role::Comparison,
            1e-3,
            "with respect to off is exactly 0, but other values change the loss",
            "smooth transition",
        ),
        (
            free,
            Role::Absent,
            1e-3,
            "the loss does not depend on off, so training cannot change it",
            "Use a fixed value",
        ),
        (free, Role::Linear(1.0), 1e6, "training runs away: off = -1.000e7", "Give it bounds"),
        (above, Role::Linear(1.0), 1e3, "of it: off = 5.000e-1", "Check the bounds"),
        (bounded, Role::Linear(1.0), 1e3, "of it: off = 5.000e-1", "Check the bounds"),
        (bounded, Role::Linear(-1.0), 1e3, "of it: off = 7.000e-1", "Check the bounds"),
        (
            free,
            Role::Linear(1e200),
            1e-3,
            "component 1 is the trained number off",
            "Shorten the horizon",
        ),
        (free, Role::Linear(1.0), 1e-3, "", ""),
        (bounded, Role::Linear(1.0), 1e-3, "", ""),
    ] {
        let task = Pushed {
            off: Number::Trained { start, min: f64::NEG_INFINITY, max: f64::INFINITY },
            role,
        };
        let policy = WithParams::new(Constant::new(1, 1), [param]);
        let training = Training {
            epochs: 3,
            train_samples: 4,
            test_samples: 1,
            learning_rate,
            ..Training::default()
        };
        let training = Training { rule: OptimizerKind::Sgd, clip: Clip::None, ..training };
        let trainer = Trainer::new(task, policy)
            .precision::<f64>()
            .field(Field::regular())
            .training(training);
        let mut warnings = Vec::new();
        trainer
            .run_with_warnings(|warning| warnings.push(warning.to_owned()))
            .expect("fewer skips than the limit");
        if expected.is_empty() {
            assert_eq!(warnings, [""; 0], "{role:?}");
        } else {
            assert_eq!(warnings.len(), 1, "{role:?}: {warnings:?}");
            let is_named = warnings[0].starts_with("epoch 1: ") && warnings[0].contains(expected);
            assert!(is_named && warnings[0].contains(remedy), "{role:?}: {warnings:?}");
        }
    }
}

/// Wrapper of a system that forwards the number of parameters, and perhaps the numbers that vary.
#[derive(Clone, Debug)]
struct Wrapper {
    inner: Pushed,
    forwards: bool,
}

impl System for Wrapper {
    fn state_dim(&self) -> usize {
        self.inner.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.inner.control_dim()
    }
    fn param_dim(&self) -> usize {
        System::param_dim(&self.inner)
    }
    fn varied(&self, params: usize) -> Vec<Varied> {
        if self.forwards { self.inner.varied(params) } else { Vec::new() }
    }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.inner.step(inputs, next);
    }
}

/// Task that writes this value into the parameter, if any.
struct Wrapped(Wrapper, Option<f64>);

impl Task for Wrapped {
    type System = Wrapper;
    fn system(&self) -> &Wrapper {
        &self.0
    }
    fn horizon(&self) -> usize {
        2
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 0.0;
        self.1.into_iter().for_each(|value| start.p[0] = value);
    }
}

#[test]
fn parameters_that_nothing_sets_are_refused_by_rollouts() {
    let inner = Pushed { off: Number::Uniform { low: 0.5, high: 2.0 }, role: Role::Linear(1.0) };
    let policy = Constant::new(1, 1);
    let run = |forwards: bool, written: Option<f64>| {
        let task = Wrapped(Wrapper { inner: inner.clone(), forwards }, written);
        let starts: Vec<f64> = initial_states(&task, 0, Purpose::Train, 3);
        let mut rollout = Rollout::new(&task, &policy, 3);
        rollout.start(&starts);
        (starts, rollout.run(&task, &policy, &Weights::new(&policy, vec![0.0])))
    };
    let (starts, outcome) = run(true, None);
    assert!(
        outcome.is_ok() && starts.chunks(2).all(|start| (0.5..=2.0).contains(&start[1])),
        "{starts:?}"
    );
    let (starts, outcome) = run(false, Some(0.0));
    assert!(outcome.is_ok() && starts.iter().all(|&start| start == 0.0), "{starts:?}");
    let (_, outcome) = run(false, None);
    let divergence = outcome.expect_err("a parameter that nothing sets");
    let expected = Divergence::Forward {
        variable: Variable::Parameter,
        step: 0,
        sample: 0,
        component: 0,
        cause: None,
    };
    assert_eq!(divergence, expected);
    let text = divergence.to_string();
    assert!(
        text.contains("the parameter p[0] of sample 0 is NaN") && text.contains("forward `varied`"),
        "{text}"
    );
}
