//! Episodes that end, and trainings by windows of them.

use physgrad::episode::{Ending, ValueSettings, Windows};
use physgrad::graph::{Costs, Equations, GraphTask};
use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad::policy::{Gru, Linear, Mlp};
use physgrad::prelude::*;
use physgrad::rng::Purpose;
use physgrad::train::Session;
use physgrad::{Clip, DynTask, Rollout, Training, Weights, check, losses};

/// A pendulum that falls over, with costs and an end.
fn pendulum(end: &str, horizon: usize) -> DynTask {
    let equations = serde_json::json!({
        "states": ["angle", "rate"],
        "controls": ["torque"],
        "dt": 0.1,
        "start": { "angle": { "uniform": [-0.5, 0.5] }, "rate": { "uniform": [-0.5, 0.5] } },
        "rate": { "angle": "rate", "rate": "sin(angle) + torque" },
    });
    let equations: Equations = serde_json::from_value(equations).expect("equations");
    let costs = Costs {
        running: "next.angle^2 + 0.1 * torque^2 - 1".into(),
        terminal: "3 + rate^2".into(),
        end: end.into(),
    };
    let rk4 = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    DynTask::new(GraphTask::new(&equations, &costs, rk4, 1, horizon).expect("a task"))
}

fn falling(horizon: usize) -> DynTask {
    DynTask::new(Ending::new(pendulum("abs(angle) > 0.8 or rate > 2", horizon)))
}

#[test]
fn derivatives_of_episodes_that_end_agree_with_dual_numbers() {
    let task = falling(30);
    let policy = Mlp::new([2, 6, 1]);
    check::task(&task, &policy).unwrap();
    let ended = (0..20).filter(|&seed| {
        let mut rollout = Rollout::<f64>::new(&task, &policy, 1);
        let weights = Weights::init(&policy, &mut physgrad::rng::stream(seed, Purpose::Policy, 0));
        rollout.start(&physgrad::initial_states(&task, seed, Purpose::Test, 1));
        rollout.run(&task, &policy, &weights).unwrap();
        rollout.state(30, 0, 2) > 0.0
    });
    let ended = ended.count();
    assert!((3..=20).contains(&ended), "{ended} of 20 episodes end");
}

#[test]
fn an_ended_episode_costs_what_the_shorter_one_costs() {
    let policy = Linear::new(2, 1);
    let theta = Weights::new(&policy, vec![0.3, -0.1]);
    let starts: Vec<f64> = physgrad::initial_states(&falling(30), 1, Purpose::Test, 16);
    let found = losses(&falling(30), &policy, &theta, &starts).unwrap();
    let mut lengths = Vec::new();
    for (start, found) in starts.chunks_exact(3).zip(found) {
        // The first rollout with a state beyond the limit has its terminal cost there.
        let ends = |steps: &usize| {
            let plain = pendulum("", *steps);
            let mut rollout = Rollout::<f64>::new(&plain, &policy, 1);
            rollout.start(&start[..2]);
            rollout.run(&plain, &policy, &theta).unwrap();
            rollout.state(*steps, 0, 0).abs() > 0.8 || rollout.state(*steps, 0, 1) > 2.0
        };
        let steps = (1..30).find(ends).unwrap_or(30);
        let expected = losses(&pendulum("", steps), &policy, &theta, &start[..2]).unwrap()[0];
        approx::assert_relative_eq!(found, expected, max_relative = 1e-13);
        lengths.push(steps);
    }
    assert!(lengths.iter().any(|&steps| steps < 30), "{lengths:?}");
}

#[test]
fn an_end_is_a_condition() {
    let error = |text: &str, end: &str| {
        let costs = Costs { end: end.into(), ..Costs::default() };
        let equations: Equations = serde_json::from_str(text).expect("equations");
        let rk4 = AnyIntegrator::RungeKutta(RungeKutta::RK4);
        GraphTask::new(&equations, &costs, rk4, 1, 3).map(drop).expect_err("an error").to_string()
    };
    let plain = r#"{"states": ["x"], "controls": ["u"], "dt": 1, "next": {"x": "x + u"}}"#;
    let end = |condition: &str| error(plain, condition);
    assert_eq!(
        end("x + 1"),
        "`loss.end` has an error in column 1 of `x + 1`: a number where a condition is expected, such as `a < b`"
    );
    assert_eq!(end("u > 1"), "`loss.end` depends on the control, which is not known there");
    assert!(end("x >").contains("column 4"), "{}", end("x >"));
    let named = r#"{"states": ["x"], "controls": ["u"], "dt": 1, "next": {"x": "x + u"}, "define": {"ended": "x"}}"#;
    let message = error(named, "x > 1");
    assert!(message.contains("the name of another number"), "{message}");
}

#[test]
fn derivatives_of_a_window_agree_with_dual_numbers() {
    // The oracle draws controls and noise of size 1, so some are clipped at these bounds.
    for (task, value, noise, bounds) in [
        (falling(30), true, 0.3, None),
        (falling(30), true, 0.3, Some(vec![[-0.8, 1.2]])),
        (falling(30), true, 0.0, None),
        (falling(6), false, 0.1, None),
        (pendulum("", 30), true, 0.0, None),
    ] {
        let mut windows = Windows { noise: vec![noise], ..Windows::new(task, 6) };
        if !value {
            windows.value = None;
        }
        check::task(&windows.checked(bounds, 3), &Mlp::new([2, 5, 1])).unwrap();
    }
}

/// x_{t+1} = 1.05 x + 0.5 u with the costs x² + u²/2.
struct Plant;
const GAIN: [f64; 4] = [1.05, 0.5, 1.0, 0.5];
const DISCOUNT: f64 = 0.95;

impl System for Plant {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * GAIN[0] + u[0] * GAIN[1];
    }
}

impl Task for Plant {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        20
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = rng.random_range(-1.0..1.0);
    }
    fn running_cost<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, _: &[T]) -> T {
        x[0] * x[0] * GAIN[2] + u[0] * u[0] * GAIN[3]
    }
}

/// Value x² of the discounted problem, and the optimal feedback.
fn riccati() -> [f64; 2] {
    let [a, b, q, r] = GAIN;
    let mut p = q;
    for _ in 0..1000 {
        p = q + DISCOUNT * a * a * p - (DISCOUNT * a * b * p).powi(2) / (r + DISCOUNT * b * b * p);
    }
    [p, -DISCOUNT * a * b * p / (r + DISCOUNT * b * b * p)]
}

fn session(
    value: Option<ValueSettings>,
    workers: usize,
    epochs: usize,
) -> Session<Plant, Mlp, f64> {
    session_of(workers, epochs, |windows| windows.value = value)
}

/// A training of the feedback by windows of two steps.
fn session_of(
    workers: usize,
    epochs: usize,
    change: impl FnOnce(&mut Windows),
) -> Session<Plant, Mlp, f64> {
    let training = Training {
        batch: 16,
        train_samples: 32,
        test_samples: 8,
        epochs,
        resample: true,
        learning_rate: 3e-3,
        clip: Clip::Norm(1.0),
        workers,
        ..Training::default()
    };
    let mut windows =
        Windows { discount: DISCOUNT, noise: vec![0.3], ..Windows::new(DynTask::new(Plant), 2) };
    change(&mut windows);
    Trainer::new(Plant, Mlp::new([1, 1]).bias(false).zero_init_output(true))
        .field(Field::regular())
        .precision::<f64>()
        .training(training)
        .windows(windows)
        .session()
        .unwrap()
}

#[test]
fn windows_with_a_value_function_reach_the_solution_of_riccati() {
    let [p, optimum] = riccati();
    let value = ValueSettings { widths: vec![32], learning_rate: 2e-3, ..ValueSettings::default() };
    let mut session = session(Some(value), 2, 150);
    let (mut gain, mut slope) = (0.0, 0.0);
    while !session.is_done() {
        session.epoch().unwrap();
        // Means over the last 50 epochs, because noise moves both.
        if session.records().len() > 100 {
            gain += session.weights().theta()[0] / 50.0;
            let values = session.values(&[-0.4, -0.1, 0.1, 0.4]).unwrap();
            slope += (values[3] - values[2] + values[0] - values[1]) / 0.6 / 50.0;
        }
    }
    assert!((gain / optimum - 1.0).abs() < 0.03, "{gain} is not {optimum}");
    // Of p x², between 0.1 and 0.4.
    assert!((slope / (p * 0.5) - 1.0).abs() < 0.1, "{slope} is not {}", p * 0.5);
}

#[test]
fn windows_without_a_value_function_are_short_sighted() {
    let [_, optimum] = riccati();
    let mut session = session(None, 1, 60);
    while !session.is_done() {
        session.epoch().unwrap();
    }
    // Two steps: the second control has only its own cost, so the best feedback is weaker.
    let gain = session.weights().theta()[0];
    assert!(gain / optimum < 0.9, "{gain} is too close to {optimum}");
}

#[test]
fn threads_and_interruptions_do_not_change_a_training_by_windows() {
    for normalize in [false, true] {
        let session = |workers| {
            session_of(workers, 3, |windows| {
                windows.value = Some(ValueSettings { passes: 2, ..ValueSettings::default() });
                windows.normalize = normalize;
            })
        };
        let [whole, threaded] = [1, 4].map(|workers| {
            let mut session = session(workers);
            while !session.is_done() {
                session.epoch().unwrap();
            }
            session.weights().theta().to_vec()
        });
        assert_eq!(whole, threaded);
        // Interrupted after every update.
        let mut bytes = session(1).checkpoint("run");
        let mut updates = 0;
        let theta = loop {
            let mut part = session(2);
            part.restore(&bytes, "run").unwrap();
            if part.is_done() {
                break part.weights().theta().to_vec();
            }
            part.advance(&|| true).unwrap();
            bytes = part.checkpoint("run");
            updates += 1;
        };
        assert_eq!((whole, updates), (theta, 3 * 2 * 10), "normalized: {normalize}");
    }
}

/// A given policy keeps its function while the units of the observations change.
#[test]
fn normalization_does_not_change_a_policy_from_which_a_training_starts() {
    let task = falling(200);
    let theta: Vec<f64> = (0..17).map(|i| (0.9 * f64::from(i)).sin()).collect();
    let training = Training {
        batch: 8,
        train_samples: 8,
        test_samples: 8,
        learning_rate: 1e-12,
        ..Training::default()
    };
    let trainer = |normalize| {
        Trainer::new(task.clone(), Mlp::new([2, 4, 1]))
            .precision::<f64>()
            .training(training.clone())
            .windows(Windows { normalize, ..Windows::new(task.clone(), 5) })
            .epochs(2)
    };
    let given = trainer(true).start_from(theta.clone()).run().unwrap();
    for (after, before) in given.weights.theta().iter().zip(&theta) {
        assert!((after - before).abs() < 1e-9, "{after} is not {before}");
    }
    // A drawn policy is drawn in units: its first layer differs from that of the raw observation.
    let [plain, drawn] = [false, true].map(|normalize| trainer(normalize).run().unwrap());
    let [plain, drawn] = [&plain, &drawn].map(|report| report.weights.theta()[0]);
    assert!((drawn / plain - 1.0).abs() > 0.1, "{drawn} is {plain}");
}

/// A task of one state with these costs and this end, from 0.
fn counted(rate: &str, costs: Costs, horizon: usize) -> DynTask {
    let equations = serde_json::json!({
        "states": ["q"], "controls": ["v"], "dt": 0.1, "next": { "q": rate },
    });
    let equations: Equations = serde_json::from_value(equations).expect("equations");
    let rk4 = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    let task = GraphTask::new(&equations, &costs, rk4, 1, horizon).expect("a task");
    DynTask::new(Ending::new(DynTask::new(task)))
}

/// Nearly fixed policies: the loss of the training is that of whole episodes.
#[test]
fn the_training_loss_is_that_of_whole_episodes() {
    let costs = Costs { running: "1 + 0 * v".into(), terminal: "5".into(), end: "q > 9.5".into() };
    let training = Training {
        batch: 8,
        train_samples: 8,
        test_samples: 8,
        learning_rate: 1e-12,
        ..Training::default()
    };
    let task = counted("q + 1 + 0 * v", costs, 60);
    let report = Trainer::new(task.clone(), Mlp::new([1, 1]))
        .training(training)
        .windows(Windows::new(task, 6))
        .epochs(3)
        .run()
        .unwrap();
    for record in &report.records[1..] {
        // Ten steps, and the cost of the end.
        assert!((record.train_loss - 15.0).abs() < 1e-5, "{}", record.train_loss);
        assert_eq!(record.test_loss, 15.0);
        assert_eq!(record.length, Some(10.0));
    }
}

#[test]
fn the_terminal_cost_knows_whether_an_episode_ended() {
    let loss = |horizon: usize| {
        let costs = Costs {
            running: "1 + 0 * v".into(),
            terminal: "20 * ended".into(),
            end: "q > 9.5 or q < -1".into(),
        };
        let task = counted("q + 1 + 0 * v", costs, horizon);
        let policy = Mlp::new([1, 1]);
        let theta = Weights::new(&policy, vec![0.0, 0.0]);
        losses(&task, &policy, &theta, &[0.0, 0.0]).unwrap()[0]
    };
    // Ten steps lead to the end. The last step of a horizon of ten is the end, too.
    assert_eq!([loss(60), loss(10), loss(9)], [30.0, 30.0, 9.0]);
}

/// Derivatives of steps and costs that an ended episode does not take may be infinite.
#[test]
fn an_end_guards_what_lies_behind_it() {
    let costs = Costs {
        running: "1 - sqrt(q) + 0.1 * v^2".into(),
        terminal: "where(q > 0.2, 3 * sqrt(q - 0.2), 2)".into(),
        end: "q < 0.01".into(),
    };
    let equations = serde_json::json!({
        "states": ["q"], "controls": ["v"], "dt": 0.1, "start": { "q": { "uniform": [0.4, 1.0] } },
        "next": { "q": "where(sqrt(q) > 0.5, q - 0.1 + 0.01 * v, -1)" },
        "observe": ["q", "sqrt(q)"],
    });
    let equations: Equations = serde_json::from_value(equations).expect("equations");
    let rk4 = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    let task = GraphTask::new(&equations, &costs, rk4, 1, 20).expect("a task");
    let task = DynTask::new(Ending::new(DynTask::new(task)));
    let policy = Mlp::new([2, 3, 1]);
    let trainer = Trainer::new(task.clone(), policy).epochs(2);
    for trainer in [trainer.clone(), trainer.windows(Windows::new(task, 5))] {
        let report = trainer.run().unwrap();
        assert_eq!(report.records[1].skipped, 0);
        assert!(report.records[1].length.is_some_and(|length| length < 10.0));
    }
}

/// Noise that is held for more steps than a window has is that of whole rollouts.
#[test]
fn held_noise_continues_over_windows() {
    let equations = serde_json::json!({
        "states": ["q"], "controls": ["v"], "dt": 1.0, "next": { "q": "q + w + 0 * v" },
        "parameters": { "w": { "noise": 1.0, "hold": 20 } },
    });
    let equations: Equations = serde_json::from_value(equations).expect("equations");
    let costs = Costs { running: "next.q^2".into(), ..Costs::default() };
    let rk4 = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    let task = DynTask::new(GraphTask::new(&equations, &costs, rk4, 1, 20).expect("a task"));
    let training = Training {
        batch: 512,
        train_samples: 512,
        test_samples: 512,
        learning_rate: 1e-12,
        resample: true,
        ..Training::default()
    };
    let report = Trainer::new(task.clone(), Mlp::new([1, 1]))
        .training(training)
        .windows(Windows { value: None, ..Windows::new(task, 5) })
        .epochs(2)
        .run()
        .unwrap();
    // The mean of Σ (t w)², t = 1 .. 20, is 2870; with new noise in each window it is 1000 or less.
    let found = report.records[1].train_loss;
    assert!((found / 2870.0 - 1.0).abs() < 0.25, "{found}");
}

#[test]
fn policies_that_windows_do_not_carry_on_are_refused() {
    use physgrad::policy::OpenLoop;
    assert!(
        Windows::problem_of::<f64>(&Gru::new(2, 4, 1)).is_some_and(|text| text.contains("memory"))
    );
    let timed = Windows::problem_of::<f32>(&OpenLoop::new(2, 1, 30));
    assert!(timed.is_some_and(|text| text.contains("number of the step")));
    assert_eq!(Windows::problem_of::<f64>(&Mlp::new([2, 1])), None);
    assert_eq!(Windows::problem_of::<f64>(&Linear::with_bias(2, 1)), None);
}

#[test]
fn the_end_of_an_episode_is_no_kink() {
    let (task, policy) = (falling(30), Mlp::new([2, 4, 1]));
    let weights = Weights::init(&policy, &mut physgrad::rng::stream(0, Purpose::Policy, 0));
    let starts = physgrad::initial_states(&task, 1, Purpose::Test, 4);
    assert_eq!(check::kinks(&task, &policy, &weights, &starts).len(), 0);
}

#[test]
fn the_length_of_episodes_is_recorded() {
    let task = falling(30);
    let training = Training { batch: 8, train_samples: 8, test_samples: 8, ..Training::default() };
    let trainer = Trainer::new(task.clone(), Mlp::new([2, 4, 1])).training(training).epochs(1);
    let plain = trainer.clone().run().unwrap();
    let windows = trainer.windows(Windows::new(task, 5)).run().unwrap();
    for report in [plain, windows] {
        let length = report.records[0].length.unwrap();
        assert!((1.0..=30.0).contains(&length), "{length}");
    }
}

#[test]
fn settings_that_do_not_fit_are_refused() {
    let refused = |change: fn(&mut Windows)| {
        let task = falling(30);
        let mut windows = Windows::new(task.clone(), 5);
        change(&mut windows);
        let trainer = Trainer::new(task, Mlp::new([2, 4, 1])).windows(windows);
        trainer.session().map(drop).expect_err("an error").to_string()
    };
    assert_eq!(
        refused(|windows| windows.steps = 31),
        "training.window.steps: is 31; allowed: 1 to 30, the horizon"
    );
    assert_eq!(
        refused(|windows| windows.discount = 1.0),
        "training.discount: is 1; allowed: a positive number below 1, with a value function"
    );
    assert!(refused(|windows| windows.noise = vec![f64::NAN]).contains("window.noise"));
    let windows = Windows { normalize: true, ..Windows::new(falling(30), 5) };
    let trainer = Trainer::new(falling(30), Linear::new(2, 1)).windows(windows);
    let error = trainer.session().map(drop).expect_err("an error").to_string();
    assert!(error.contains("window.normalize: needs a policy with a layer"), "{error}");
    let trainer =
        Trainer::new(falling(30), Gru::new(2, 4, 1)).windows(Windows::new(falling(30), 5));
    let error = trainer.session().map(drop).expect_err("an error").to_string();
    assert!(error.contains("policy: has a memory"), "{error}");
    let lambda = |windows: &mut Windows| {
        windows.value = Some(ValueSettings { lambda: 2.0, ..ValueSettings::default() });
    };
    assert!(refused(lambda).contains("value.lambda: is 2; allowed: 0 to 1"));
}
