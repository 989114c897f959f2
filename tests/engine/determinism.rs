//! Results are bitwise equal for any split of the work and after any interruption. Single and
//! double precision agree to rounding.

use physgrad::engine::any;
use physgrad::engine::{Batch, Evaluation};
use physgrad::policy::{self, Mlp};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{CartPole, CartPoleSystem, Guidance, LossMode, Quantum};
use physgrad::train::{CheckpointError, Record, Session};
use physgrad::{
    Field, Float, Flow, Gradient, Rollout, Scalar, Start, Task, Trainer, Training, Weights,
    initial_states,
};
use std::sync::Mutex;

const STATES: usize = 6;

fn task() -> CartPole {
    CartPole { loss: LossMode::Running, horizon: 40, ..CartPole::new(2) }
}

fn policy() -> Mlp {
    Mlp::new([STATES, 20, 12, 1])
}

fn starts<F: Float>(samples: usize) -> Vec<F> {
    initial_states(&task(), 0, Purpose::Train, samples)
}

fn weights<F: Float>() -> Weights<F> {
    Weights::init(&policy(), &mut stream(0, Purpose::Policy, 0))
}

fn gradients<F: Float>(samples: usize, workers: usize) -> (f64, Vec<Gradient<F>>) {
    let mut batch =
        Batch::new(&task(), &policy(), samples, &[Flow::MODIFIED, Flow::REGULAR], workers);
    let loss = batch.run(&task(), &policy(), &weights(), &starts::<F>(samples)).expect("finite");
    (loss, batch.gradients().to_vec())
}

#[test]
fn gradients_do_not_depend_on_the_number_of_workers() {
    for samples in [1, 4, 7, 8, 13, 32] {
        let one = gradients::<f32>(samples, 1);
        for workers in [2, 3, 5, 64] {
            assert_eq!(
                gradients::<f32>(samples, workers),
                one,
                "{samples} samples, {workers} workers"
            );
        }
    }
}

/// 150 samples take three rounds of two workers, in chunks of 28 samples.
#[test]
fn gradients_of_large_batches_do_not_depend_on_the_number_of_workers() {
    let one = gradients::<f32>(150, 1);
    for workers in [2, 3, 5] {
        assert_eq!(gradients::<f32>(150, workers), one);
    }
    // The gradient is the mean of the gradients of two halves, up to rounding.
    let starts = starts::<f64>(150);
    let of = |starts: &[f64]| {
        let mut batch = Batch::new(&task(), &policy(), 150, &[Flow::REGULAR], 2);
        batch.run(&task(), &policy(), &weights(), starts).expect("finite");
        batch.gradients()[0].to_vec()
    };
    let (first, second) = starts.split_at(starts.len() / 2);
    let (whole, first, second) = (of(&starts), of(first), of(second));
    let largest = whole.iter().fold(0.0, |largest: f64, g| largest.max(g.abs()));
    for ((whole, first), second) in whole.iter().zip(first).zip(second) {
        assert!((whole - 0.5 * (first + second)).abs() <= 1e-13 * largest);
    }
    // Beyond one round, a larger batch needs no more memory. The only exception is the sum of a
    // block for each flow, which batches with more than 128 samples store.
    let bytes = |samples: usize| {
        Batch::<f32>::new(&task(), &policy(), samples, &[Flow::REGULAR], 2).stored_bytes()
    };
    assert_eq!(bytes(64), bytes(128));
    assert_eq!(bytes(256), bytes(1024));
}

/// Returns a session of three epochs with four updates each. The order of the samples changes
/// between epochs. If `resample`, the initial states change too.
fn shuffled(starts: &[f32], resample: bool) -> Session<CartPole, Mlp, f32> {
    let training = Training { epochs: 3, batch: 4, shuffle: true, resample, ..Training::default() };
    let trainer = Trainer::new(task(), policy()).training(training);
    trainer
        .session_from(weights::<f32>().theta().to_vec(), starts.to_vec(), starts.to_vec())
        .expect("valid settings")
}

#[test]
fn a_session_restored_after_every_update_has_the_bits_of_an_uninterrupted_one() {
    for (skips, resample) in [(false, false), (true, false), (false, true)] {
        let mut starts = starts::<f32>(16);
        if skips {
            // Training skips one update of each epoch.
            starts[5 * STATES] = f32::NAN;
        }
        let mut whole = shuffled(&starts, resample);
        while !whole.is_done() {
            whole.epoch().expect("training continues");
        }
        let mut pauses = 0;
        let mut parts = shuffled(&starts, resample);
        while !parts.is_done() {
            pauses += usize::from(parts.advance(&|| true).expect("training continues").is_none());
            let mut next = shuffled(&starts, resample);
            next.restore(&parts.checkpoint("run"), "run").expect("its own checkpoint");
            parts = next;
        }
        assert_eq!(pauses, 3 * 3);
        assert_eq!(parts.weights().theta(), whole.weights().theta());
        let numbers = |session: &Session<_, _, f32>| {
            let record = |record: &Record| Record { seconds: 0.0, ..record.clone() };
            format!("{:?}", session.records().iter().map(record).collect::<Vec<_>>())
        };
        assert_eq!(numbers(&parts), numbers(&whole));
        assert_eq!(parts.records()[1].skipped, usize::from(skips));
    }
}

/// A run of three epochs, interrupted in its second epoch, becomes a run of one epoch.
#[test]
fn a_run_shortened_to_its_complete_epochs_discards_the_unfinished_one() {
    let starts = starts::<f32>(16);
    let mut long = shuffled(&starts, false);
    long.epoch().expect("finite");
    let complete = long.weights().theta().to_vec();
    assert!(
        long.advance(&|| true).expect("finite").is_none() && long.weights().theta() != complete
    );
    let training = Training { epochs: 1, batch: 4, shuffle: true, ..Training::default() };
    let mut short = Trainer::new(task(), policy())
        .training(training)
        .session_from(weights::<f32>().theta().to_vec(), starts.clone(), starts)
        .expect("valid settings");
    short.restore(&long.checkpoint("run"), "run").expect("a checkpoint of this run");
    assert!(short.is_done());
    assert_eq!(short.weights().theta(), complete);
}

#[test]
fn losses_do_not_depend_on_the_number_of_workers_nor_on_the_tape() {
    for samples in [1, 31, 33, 100] {
        let evaluate = |workers| {
            Evaluation::new(&task(), &policy(), workers)
                .run(&task(), &policy(), &weights(), &starts::<f32>(samples))
                .expect("finite")
        };
        let one = evaluate(1);
        for workers in [2, 3, 7] {
            assert_eq!(evaluate(workers), one);
        }
        assert_eq!(gradients::<f32>(samples, 1).0, one, "rollout with a tape");
    }
}

/// Returns the cost and the last state of each sample, as bits.
fn ends(
    task: &dyn any::AnyTask<f64>,
    make: impl Fn(&dyn any::AnyTask<f64>, &dyn policy::AnyPolicy<f64>, usize) -> Rollout<f64>,
) -> Vec<u64> {
    let (n, m) = (task.state_dim(), task.control_dim());
    let policy = Mlp::new([n, 8, m]);
    let starts: Vec<f64> = initial_states(task, 0, Purpose::Train, 11);
    let mut rollout = make(task, &policy, 11);
    rollout.start(&starts);
    let weights = Weights::init(&policy, &mut stream(0, Purpose::Policy, 0));
    rollout.run(task, &policy, &weights).expect("finite");
    let rollout = &rollout;
    let last = |sample| (0..n).map(move |i| rollout.state(task.horizon(), sample, i));
    let states = (0..11).flat_map(last);
    (0..11).map(|sample| rollout.cost(sample)).chain(states).map(f64::to_bits).collect()
}

#[test]
fn costs_and_last_states_do_not_depend_on_the_tape() {
    assert_eq!(ends(&task(), Rollout::new), ends(&task(), Rollout::for_evaluation));
    let guidance = Guidance::new(1, 2);
    assert_eq!(ends(&guidance, Rollout::new), ends(&guidance, Rollout::for_evaluation));
    let quantum = Quantum::new(2);
    assert_eq!(ends(&quantum, Rollout::new), ends(&quantum, Rollout::for_evaluation));
}

#[test]
fn a_sample_does_not_depend_on_the_other_samples() {
    let run = |samples: usize| {
        let mut rollout = Rollout::new(&task(), &policy(), 19);
        rollout.start(&starts::<f64>(19)[..samples * STATES]);
        rollout.run(&task(), &policy(), &weights()).expect("finite");
        let states: Vec<f64> = (0..STATES).map(|i| rollout.state(40, 2, i)).collect();
        (rollout.cost(2), states)
    };
    assert_eq!(run(3), run(19));
    assert_eq!(run(3), run(8));
}

#[test]
fn single_precision_agrees_with_double_precision_to_1e_4() {
    // Each operation adds a relative rounding error of up to 2^-24. 40 steps of hanging poles
    // amplify this error little.
    let allowed = 1e-4;
    let (loss32, g32) = gradients::<f32>(8, 1);
    let (loss64, g64) = gradients::<f64>(8, 1);
    assert!((loss32 - loss64).abs() <= allowed * loss64.abs(), "{loss32} {loss64}");
    for (g32, g64) in g32.iter().zip(&g64) {
        let scale = g64.values().iter().fold(0.0, |s: f64, g| s.max(g.abs()));
        let worst = g32
            .values()
            .iter()
            .zip(g64.values())
            .map(|(a, b)| (f64::from(*a) - b).abs())
            .fold(0.0, f64::max);
        assert!(worst <= allowed * scale, "{worst:e} of {scale:e}");
        assert!(worst > 0.0, "the gradients in f32 and f64 are equal");
    }
}

fn session(seed: u64, epochs: usize, workers: usize) -> Session<CartPole, Mlp, f32> {
    let training = Training {
        epochs,
        seed,
        batch: 6,
        train_samples: 20,
        test_samples: 9,
        shuffle: true,
        workers,
        ..Training::default()
    };
    Trainer::new(task(), policy()).training(training).session().expect("valid settings")
}

/// A [`CartPole`] that records the position of each initial state that it draws.
struct Recorded {
    task: CartPole,
    drawn: Mutex<Vec<f64>>,
}

impl Task for Recorded {
    type System = CartPoleSystem;
    fn system(&self) -> &CartPoleSystem {
        &self.task.system
    }
    fn horizon(&self) -> usize {
        3
    }
    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        self.task.start(rng, Start { x: &mut *x, p });
        self.drawn.lock().expect("one thread").push(x[0]);
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        self.task.terminal_cost(x, p)
    }
}

#[test]
fn resampling_draws_one_stream_per_epoch_and_sample() {
    const SAMPLES: usize = 5;
    let position = |purpose, index| {
        let mut x = [0.0; 4];
        CartPole::new(1).start(&mut stream(7, purpose, index), Start { x: &mut x, p: &mut [] });
        x[0]
    };
    let evaluated = (0..SAMPLES as u64)
        .map(|i| position(Purpose::Train, i))
        .chain([position(Purpose::Test, 0)]);
    // Sample i of epoch e, counted from 0, has the stream `e · SAMPLES + i`. Without resampling,
    // updates draw nothing.
    for (resample, updates) in [(false, 0), (true, 3 * SAMPLES as u64)] {
        let expected: Vec<f64> = evaluated
            .clone()
            .chain((0..updates).map(|index| position(Purpose::Train, index)))
            .collect();
        let training = Training {
            epochs: 3,
            seed: 7,
            batch: 2,
            train_samples: SAMPLES,
            test_samples: 1,
            resample,
            ..Training::default()
        };
        let task = Recorded { task: CartPole::new(1), drawn: Mutex::default() };
        let mut session = Trainer::new(task, Mlp::new([4, 8, 1]))
            .training(training)
            .session()
            .expect("valid settings");
        (0..3).for_each(|_| drop(session.epoch().expect("finite").clone()));
        assert_eq!(
            *session.task().drawn.lock().expect("one thread"),
            expected,
            "resample: {resample}"
        );
    }
}

#[test]
fn resampling_keeps_the_evaluated_sets() {
    // The learning rate is too small to change a loss, so losses of fixed sets stay equal.
    let training = Training {
        epochs: 3,
        learning_rate: 1e-300,
        train_samples: 8,
        resample: true,
        ..Training::default()
    };
    let mut session = Trainer::new(task(), policy())
        .precision::<f64>()
        .training(training)
        .session()
        .expect("valid settings");
    (0..3).for_each(|_| drop(session.epoch().expect("finite").clone()));
    let [first, second, third] = session.records() else { panic!("three epochs") };
    assert!(
        first.loss != second.loss && second.loss != third.loss,
        "an epoch repeats the initial states"
    );
    for later in [second, third] {
        assert_eq!((later.train_loss, later.test_loss), (first.train_loss, first.test_loss));
    }
}

/// Returns the records with their times set to 0.
fn without_time(records: &[Record]) -> Vec<Record> {
    records.iter().map(|r| Record { seconds: 0.0, ..r.clone() }).collect()
}

fn train(mut session: Session<CartPole, Mlp, f32>) -> (Vec<Record>, Vec<f32>) {
    while !session.is_done() {
        session.epoch().expect("finite");
    }
    (without_time(session.records()), session.weights().theta().to_vec())
}

#[test]
fn training_does_not_depend_on_the_number_of_workers() {
    let one = train(session(1, 4, 1));
    for workers in [2, 8] {
        assert_eq!(train(session(1, 4, workers)), one);
    }
    assert_ne!(train(session(2, 4, 1)).1, one.1, "another seed yields the same parameters");
}

#[test]
fn a_resumed_training_has_the_bits_of_an_uninterrupted_one() {
    let whole = train(session(1, 5, 1));
    for stop in 0..5 {
        let mut first = session(1, 5, 1);
        for _ in 0..stop {
            first.epoch().expect("finite");
        }
        let bytes = first.checkpoint("a run");
        let mut second = session(1, 5, 2);
        second.restore(&bytes, "a run").expect("its own checkpoint");
        assert_eq!(train(second), whole, "interrupted after epoch {stop}");
    }
}

#[test]
fn a_foreign_or_damaged_checkpoint_is_refused_and_changes_nothing() {
    let mut first = session(1, 2, 1);
    first.epoch().expect("finite");
    let bytes = first.checkpoint("a run");
    let mut other = session(1, 2, 1);
    let before = other.weights().theta().to_vec();

    assert_eq!(other.restore(b"something else", "a run"), Err(CheckpointError::NotACheckpoint));
    assert!(matches!(other.restore(&bytes, "another run"), Err(CheckpointError::Label { .. })));
    let mut newer = bytes.clone();
    newer[8] = 77;
    assert!(matches!(other.restore(&newer, "a run"), Err(CheckpointError::Format { found: 77 })));
    for cut in [9, 40, bytes.len() / 2, bytes.len() - 1] {
        assert!(
            matches!(other.restore(&bytes[..cut], "a run"), Err(CheckpointError::Damaged(_))),
            "cut at {cut}"
        );
    }
    let mut flipped = bytes.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    assert!(matches!(other.restore(&flipped, "a run"), Err(CheckpointError::Damaged(_))));

    let trainer = || {
        Trainer::new(task(), policy())
            .training(Training { train_samples: 20, ..Training::default() })
    };
    let mut double = trainer().precision::<f64>().session().expect("valid settings");
    assert!(matches!(double.restore(&bytes, "a run"), Err(CheckpointError::Precision { .. })));
    let mut wider =
        Trainer::new(task(), Mlp::new([STATES, 30, 1])).session().expect("valid settings");
    assert!(matches!(wider.restore(&bytes, "a run"), Err(CheckpointError::Shape { .. })));
    assert_eq!(other.weights().theta(), before);
    assert!(other.records().is_empty());
}

#[test]
fn r_computed_together_with_m_has_the_bits_of_r_alone() {
    let alone = |flow: Flow| {
        let mut batch = Batch::new(&task(), &policy(), 8, &[flow], 1);
        batch.run(&task(), &policy(), &weights(), &starts::<f64>(8)).expect("finite");
        batch.gradients()[0].clone()
    };
    let both = gradients::<f64>(8, 1).1;
    assert_eq!(both[1], alone(Flow::REGULAR), "R computed together with M");
    let mut composed = Gradient::zeros(both[0].values().len());
    Field::combined().combine(&both, &mut composed);
    assert!(composed.values().iter().any(|&c| c != 0.0));
}
