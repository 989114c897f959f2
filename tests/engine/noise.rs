//! Noise in the steps of rollouts: derivatives, statistics against formulas, and equal bits.

use physgrad::engine::Batch;
use physgrad::graph::{Costs, Equations, GraphTask};
use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad::number::Noise;
use physgrad::policy::{Gru, Linear, Mlp};
use physgrad::rng::{Purpose, stream};
use physgrad::train::Session;
use physgrad::{
    Flow, Inputs, Number, Numbers, Rollout, Scalar, System, Task, Trainer, Training, Weights,
    check, gradients, initial_states,
};

const RK4: AnyIntegrator = AnyIntegrator::RungeKutta(RungeKutta::RK4);

fn noise(deviation: f64, hold: usize) -> Number {
    Number::Noise(Noise { mean: 0.0, deviation, hold })
}

fn map<V>(
    pairs: impl IntoIterator<Item = (&'static str, V)>,
) -> std::collections::BTreeMap<String, V> {
    pairs.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn texts(pairs: &[(&'static str, &str)]) -> std::collections::BTreeMap<String, String> {
    map(pairs.iter().map(|&(name, text)| (name, text.to_owned())))
}

/// A pendulum with noise of the torque, of the motor, of two sensors, and in the costs, beside
/// numbers that are drawn, and noise that is held.
pub(super) fn pendulum() -> GraphTask {
    let equations = Equations {
        states: vec!["angle".into(), "rate".into()],
        controls: vec!["torque".into()],
        dt: 0.1,
        parameters: map([
            ("length", Number::Uniform { low: 0.8, high: 1.2 }),
            ("gust", noise(0.4, 3)),
            ("motor", noise(0.2, 1)),
            ("encoder", noise(0.05, 1)),
            ("gyro", Number::Noise(Noise { mean: 0.3, deviation: 0.1, hold: 1 })),
            ("goal", noise(0.1, 4)),
        ]),
        start: map([("angle", Number::Uniform { low: -1.0, high: 1.0 })]),
        rate: texts(&[
            ("angle", "rate"),
            ("rate", "-9.81 / length * sin(angle) + torque * (1 + motor) + gust"),
        ]),
        observe: vec!["angle + encoder".into(), "rate * gyro".into()],
        ..Equations::default()
    };
    let costs = Costs {
        running: "(next.angle - goal)^2 + 0.01 * torque^2 * gyro".into(),
        terminal: "(rate - goal)^2".into(),
        ..Costs::default()
    };
    GraphTask::new(&equations, &costs, RK4, 2, 20).expect("valid equations")
}

/// The scalar plant `x' = a x + u + σ w` from 0, with the cost `Σ x²`.
fn plant(a: f64, deviation: f64, hold: usize, horizon: usize) -> GraphTask {
    let equations = Equations {
        states: vec!["x".into()],
        controls: vec!["u".into()],
        dt: 1.0,
        parameters: map([("a", a.into()), ("w", noise(deviation, hold))]),
        next: texts(&[("x", "a * x + u + w")]),
        ..Equations::default()
    };
    let costs = Costs { running: "next.x^2".into(), ..Costs::default() };
    GraphTask::new(&equations, &costs, RK4, 1, horizon).expect("valid equations")
}

#[test]
fn all_gradients_agree_with_dual_numbers() {
    let task = pendulum();
    check::task(&task, &Mlp::new([2, 5, 1])).unwrap_or_else(|failure| panic!("{failure}"));
    check::task(&task, &Gru::new(2, 3, 1)).unwrap_or_else(|failure| panic!("{failure}"));
}

/// A mass whose inverse is noise, written in Rust.
struct Puck(Number);

impl System for Puck {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([("inverse_mass", &self.0)])
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        let [inverse] = self.numbers().last_of(p);
        next[1] = x[1] + u[0] * inverse * 0.05;
        next[0] = x[0] + next[1] * 0.05;
    }
}

impl Task for Puck {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        300
    }
    fn start(&self, _: &mut physgrad::rng::Rng, start: physgrad::Start<'_>) {
        start.x.copy_from_slice(&[0.0, 1.0]);
    }
    fn running_cost<T: Scalar>(&self, _: Inputs<'_, T>, next: &[T]) -> T {
        next[0] * next[0]
    }
}

#[test]
fn numbers_of_systems_in_rust_may_be_noise() {
    let task = Puck(Number::Noise(Noise { mean: 1.0, deviation: 0.3, hold: 1 }));
    check::task(&task, &Mlp::new([2, 5, 1])).unwrap_or_else(|failure| panic!("{failure}"));
}

#[test]
fn schedules_workers_and_mini_batches_have_equal_bits() {
    let task = Puck(Number::Noise(Noise { mean: 1.0, deviation: 0.3, hold: 7 }));
    let policy = Mlp::new([2, 5, 1]);
    let weights = Weights::<f32>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<f32> = initial_states(&task, 0, Purpose::Train, 21);
    let flows = [Flow::REGULAR, Flow::MODIFIED];
    let run = |mut batch: Batch<f32>| {
        let loss = batch.run(&task, &policy, &weights, &starts).expect("finite");
        (loss, batch.gradients().iter().map(|gradient| gradient.to_vec()).collect::<Vec<_>>())
    };
    let all = run(Batch::new(&task, &policy, 21, &flows, 1));
    assert_eq!(all, run(Batch::new(&task, &policy, 21, &flows, 3)), "three workers");
    let whole = Batch::<f32>::new(&task, &policy, 21, &flows, 1).stored_bytes() as u64;
    let within = Batch::within(&task, &policy, 21, &flows, 1, whole * 3 / 4).expect("it fits");
    assert!(within.schedule().segments() > 1, "the budget stores all steps");
    assert_eq!(all, run(within), "checkpoints");
    // Without a tape: the costs are those of the gradients.
    let mut rollout = Rollout::for_evaluation(&task, &policy, 21);
    rollout.start(&starts);
    rollout.run(&task, &policy, &weights).expect("finite");
    let mean = (0..21).map(|sample| f64::from(rollout.cost(sample))).sum::<f64>() / 21.0;
    assert!((mean - all.0).abs() < 1e-6 * mean, "{mean} {}", all.0);
}

/// Mean and standard error.
fn mean(values: &[f64]) -> [f64; 2] {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    [mean, (variance / count).sqrt()]
}

/// With `c = a + K`: `E Σ x² = σ² Σ_t Σ_{k<t} c^{2k}`, and its derivative by K.
#[test]
fn mean_losses_and_gradients_are_those_of_the_formula() {
    let (a, gain, sigma, horizon, samples) = (0.9, -0.3, 0.5, 12, 4096);
    let (task, policy) = (plant(a, sigma, 1, horizon), Linear::new(1, 1));
    let weights = Weights::<f64>::new(&policy, vec![gain]);
    let starts: Vec<f64> = initial_states(&task, 0, Purpose::Test, samples);
    let c: f64 = a + gain;
    let sum = |term: &dyn Fn(i32) -> f64| -> f64 {
        (1..=horizon as i32).map(|t| (0..t).map(term).sum::<f64>()).sum::<f64>() * sigma * sigma
    };
    let expected = sum(&|k| c.powi(2 * k));
    let slope = sum(&|k| f64::from(2 * k) * c.powi(2 * k - 1));
    let width = starts.len() / samples;
    let mut rollout = Rollout::for_evaluation(&task, &policy, samples);
    rollout.start(&starts);
    rollout.run(&task, &policy, &weights).expect("finite");
    let losses: Vec<f64> = (0..samples).map(|sample| rollout.cost(sample)).collect();
    let slopes: Vec<f64> = starts
        .chunks(width)
        .map(|start| {
            let fields = [physgrad::Field::regular()];
            gradients(&task, &policy, &weights, start, &fields).expect("finite")[0][0]
        })
        .collect();
    for (name, values, expected) in [("loss", losses, expected), ("gradient", slopes, slope)] {
        let [found, error] = mean(&values);
        assert!(
            (found - expected).abs() < 4.0 * error,
            "{name}: {found} ± {error}, not {expected}"
        );
        assert!(error < 0.05 * expected.abs(), "{name}: ± {error}");
    }
}

/// A sum of T values: the variance is σ² T, and σ² h² T / h if values are held for h steps.
#[test]
fn held_values_are_equal_and_others_are_independent() {
    let samples = 2000;
    for (hold, variance) in [(1, 12.0), (4, 48.0), (100, 144.0)] {
        let (task, policy) = (plant(1.0, 1.0, hold, 12), Linear::new(1, 1));
        let weights = Weights::<f64>::new(&policy, vec![0.0]);
        let starts: Vec<f64> = initial_states(&task, 1, Purpose::Test, samples);
        let mut rollout = Rollout::new(&task, &policy, samples);
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        let last: Vec<f64> = (0..samples).map(|s| rollout.state(12, s, 0).powi(2)).collect();
        let [found, error] = mean(&last);
        assert!((found - variance).abs() < 4.0 * error, "hold {hold}: {found} ± {error}");
        let seen = |t: usize| rollout.params_at_step(t, 5).next().expect("one number");
        for t in 1..12 {
            assert_eq!(seen(t) == seen(t - 1), t % hold != 0, "hold {hold}, step {t}");
        }
    }
}

#[test]
fn noises_of_one_step_are_independent_of_each_other() {
    let (task, policy) = (pendulum(), Linear::new(2, 1));
    let names: Vec<String> =
        task.system().varied(Task::param_dim(&task)).into_iter().map(|v| v.name).collect();
    let entry = |name: &str| names.iter().position(|known| known.ends_with(name)).expect("noise");
    let (motor, encoder) = (entry("motor"), entry("encoder"));
    let weights = Weights::<f64>::new(&policy, vec![0.0; 2]);
    let mut rollout = Rollout::new(&task, &policy, 200);
    rollout.start(&initial_states::<f64>(&task, 0, Purpose::Test, 200));
    rollout.run(&task, &policy, &weights).expect("finite");
    let product = |(sample, t): (usize, usize)| {
        let p: Vec<f64> = rollout.params_at_step(t, sample).collect();
        p[motor] / 0.2 * p[encoder] / 0.05
    };
    let all = (0..200).flat_map(|sample| (0..20).map(move |t| (sample, t)));
    let [correlation, error] = mean(&all.map(product).collect::<Vec<_>>());
    assert!(correlation.abs() < 4.0 * error, "{correlation} ± {error}");
}

fn session(epochs: usize) -> Session<GraphTask, Mlp, f32> {
    let training =
        Training { epochs, batch: 4, train_samples: 8, test_samples: 2, ..Training::default() };
    Trainer::new(pendulum(), Mlp::new([2, 5, 1])).training(training).session().expect("valid")
}

#[test]
fn epochs_have_different_noise_and_resumed_trainings_the_same() {
    let mut one = session(4);
    let mut losses = Vec::new();
    for _ in 0..4 {
        losses.push(one.epoch().expect("finite").loss.to_bits());
    }
    let mut first = session(4);
    (0..2).for_each(|_| drop(first.epoch().expect("finite").clone()));
    let mut second = session(4);
    second.restore(&first.checkpoint("noise"), "noise").expect("its own checkpoint");
    for expected in &losses[2..] {
        assert_eq!(second.epoch().expect("finite").loss.to_bits(), *expected);
    }
    assert_eq!(one.weights().theta(), second.weights().theta());

    // Parameters that do not move: the losses differ by the noise alone.
    let still = Training {
        epochs: 2,
        learning_rate: 1e-300,
        rule: physgrad::train::OptimizerKind::Sgd,
        train_samples: 4,
        test_samples: 4,
        ..Training::default()
    };
    let trainer = Trainer::new(plant(0.9, 1.0, 1, 5), Linear::new(1, 1)).precision::<f64>();
    let mut session = trainer.training(still).session().expect("valid");
    let [first, second] = [(); 2].map(|()| session.epoch().expect("finite").clone());
    assert_ne!(first.loss, second.loss, "both epochs have the same noise");
    assert_eq!(first.test_loss, second.test_loss, "the test set has new noise");
}

#[test]
fn a_task_without_noise_has_no_key() {
    let without = Puck(Number::Uniform { low: 0.5, high: 1.0 });
    assert_eq!(initial_states::<f64>(&without, 0, Purpose::Train, 1).len(), 3);
    let noisy = Puck(noise(0.1, 1));
    let starts = initial_states::<f32>(&noisy, 0, Purpose::Train, 1);
    assert_eq!(starts.len(), 4);
    assert_eq!(starts[2], 0.0, "the mean");
    assert_eq!(starts[3], starts[3].trunc());
    assert!(f64::from(starts[3]) < 2f64.powi(24));
}
