//! Sensors: derivatives, and the sequence of measurements against a loop by hand.

use physgrad::number::Noise;
use physgrad::policy::{Gru, Linear, Mlp};
use physgrad::rng::{Purpose, Rng};
use physgrad::sensor::{Sensed, Sensor};
use physgrad::tasks::CartPole;
use physgrad::{
    DynTask, Inputs, Number, Rollout, Scalar, Start, System, Task, Weights, check, initial_states,
};

/// A position and a velocity, of which the policy sees the position in two units.
#[derive(Clone)]
struct Cart;

impl System for Cart {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[1] = x[1] + u[0] * 0.1;
        next[0] = x[0] + next[1] * 0.1;
    }
}

impl Task for Cart {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        14
    }
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        start.x[0] = Number::Uniform { low: -1.0, high: 1.0 }.draw(rng);
        start.x[1] = 0.7;
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(2)
    }
    fn observe<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, y: &mut [T]) {
        y[0] = x[0];
        y[1] = x[0] * x[1] * 2.0;
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        next[0] * next[0] + u[0] * u[0] * 0.01
    }
}

fn all() -> Sensor {
    Sensor {
        lag: 1.7,
        bias: vec![Number::Uniform { low: -0.1, high: 0.1 }, 0.3.into()],
        noise: vec![0.02, 0.5],
        sampling: 3,
        delay: 2,
    }
}

#[test]
fn all_gradients_agree_with_dual_numbers() {
    let each = [
        Sensor::default(),
        Sensor { lag: 1.7, ..Sensor::default() },
        Sensor { bias: all().bias, ..Sensor::default() },
        Sensor { noise: vec![0.0, 0.5], ..Sensor::default() },
        Sensor { sampling: 4, ..Sensor::default() },
        Sensor { delay: 1, ..Sensor::default() },
        Sensor { delay: 5, ..Sensor::default() },
        Sensor { sampling: 1, ..all() },
        Sensor { lag: 0.0, ..all() },
        all(),
    ];
    for sensor in each {
        let task = Sensed::new(DynTask::new(Cart), sensor.clone()).expect("it fits");
        for passed in [
            check::task(&task, &Mlp::new([2, 4, 1])),
            check::task(&DynTask::new(task.clone()), &Gru::new(2, 3, 1)),
        ] {
            passed.unwrap_or_else(|failure| panic!("{sensor:?}: {failure}"));
        }
    }
    let observed = Sensor { noise: vec![0.1; 4], delay: 3, ..Sensor::default() };
    let cart_pole = DynTask::new(CartPole { horizon: 12, ..CartPole::new(1) });
    let task = Sensed::new(cart_pole, observed).expect("it fits");
    check::task(&task, &Mlp::new([4, 5, 1])).unwrap_or_else(|failure| panic!("{failure}"));
}

/// What the policy sees: `u = y_0`, and the control is recorded.
#[test]
fn measurements_are_those_of_a_loop() {
    let sensor = all();
    let task = Sensed::new(DynTask::new(Cart), sensor.clone()).expect("it fits");
    let policy = Linear::new(2, 1);
    let weights = Weights::<f64>::new(&policy, vec![1.0, 0.0]);
    let starts: Vec<f64> = initial_states(&task, 3, Purpose::Test, 5);
    let mut rollout = Rollout::new(&task, &policy, 5);
    rollout.start(&starts);
    rollout.run(&task, &policy, &weights).expect("finite");
    // The exact solution for an observation that is linear between the steps.
    let a = (-1.0 / sensor.lag).exp();
    let k = (1.0 - a) * sensor.lag;
    for sample in 0..5 {
        let (mut lag, mut before, mut held, mut line) = (0.0, 0.0, 0.0, Vec::new());
        for t in 0..14 {
            // p: the bias of the first component, then the noise of both.
            let p: Vec<f64> = rollout.params_at_step(t, sample).collect();
            let y = rollout.state(t, sample, 0);
            lag = if t == 0 { y } else { a * lag + (k - a) * before + (1.0 - k) * y };
            before = y;
            if t % 3 == 0 {
                held = lag + p[0] + p[1];
            }
            line.push(held);
            let seen = line[t.saturating_sub(2)];
            let found = rollout.control(t, sample, 0);
            assert!((found - seen).abs() < 1e-14, "sample {sample}, step {t}: {found}, not {seen}");
        }
        assert_eq!(rollout.state(0, sample, 2), 0.0, "memory of the sensor");
    }
}

/// A ramp of 1 per step: the lagged value is behind by `lag (1 - exp(-t / lag))` steps.
#[test]
fn a_lag_follows_a_ramp_exactly() {
    for lag in [0.05, 0.7, 30.0] {
        let cart = Ramp;
        let sensor = Sensor { lag, ..Sensor::default() };
        let task = Sensed::new(DynTask::new(cart), sensor).expect("it fits");
        let policy = Linear::new(1, 1);
        let weights = Weights::<f64>::new(&policy, vec![1.0]);
        let mut rollout = Rollout::new(&task, &policy, 1);
        rollout.start(&[0.0, 0.0]);
        rollout.run(&task, &policy, &weights).expect("finite");
        for t in 0..20 {
            let time = f64::from(t);
            let expected = time - lag * (1.0 - (-time / lag).exp());
            let found = rollout.control(t as usize, 0, 0);
            assert!(
                (found - expected).abs() < 1e-13 * (1.0 + time),
                "{lag} {t}: {found}, not {expected}"
            );
        }
    }
}

/// `x' = x + 1`, whatever the control.
struct Ramp;

impl System for Ramp {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + 1.0;
    }
}

impl Task for Ramp {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        20
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 0.0;
    }
}

#[test]
fn numbers_of_task_and_sensor_keep_their_places() {
    let pendulum = physgrad::tasks::CartPole { horizon: 5, ..CartPole::new(1) };
    let sensor = Sensor { noise: vec![0.1, 0.0, 0.2, 0.0], ..Sensor::default() };
    let task = Sensed::new(DynTask::new(pendulum), sensor).expect("it fits");
    let varied = task.system().varied(Task::param_dim(&task));
    let names: Vec<&str> = varied.iter().map(|varied| &*varied.name).collect();
    assert_eq!(names, ["sensor.noise[0]", "sensor.noise[2]"]);
    let of = |deviation| Number::Noise(Noise { mean: 0.0, deviation, hold: 1 });
    assert_eq!([varied[0].number, varied[1].number], [of(0.1), of(0.2)]);
}

#[test]
fn lists_of_another_length_are_refused() {
    let sensor = Sensor { noise: vec![0.1], ..Sensor::default() };
    let error = Sensed::new(DynTask::new(Cart), sensor).err().expect("one of two");
    assert_eq!(error.to_string(), "has 1 numbers, but the task has 2 observed components");
}
