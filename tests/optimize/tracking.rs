//! [`Tracking`]: the task to follow a plan.

use super::problems::{Coupled, Pendulum, SwingUp};
use physgrad::engine::Evaluation;
use physgrad::optimize::{Initial, OptimizeError, Options, Plan, Tracking, optimize};
use physgrad::policy::{Linear, OpenLoop, Sum};
use physgrad::rng::{Purpose, Rng};
use physgrad::train::Decay;
use physgrad::{
    Field, Inputs, Number, Numbers, Rollout, Scalar, Start, System, Task, Trainer, Training,
    Weights, check, initial_states,
};
use std::f64::consts::PI;

fn plan() -> (SwingUp, Plan) {
    let (task, push) = (SwingUp::new(), vec![0.3; 100]);
    let options = Options { max_iterations: 60, ..Options::default() };
    let plan =
        optimize(&task, &SwingUp::START, &[], Initial::Controls(&push), &options).expect("finite");
    (task, plan)
}

#[test]
fn tracking_cost_of_the_plan_is_0_up_to_rounding() {
    let (task, plan) = plan();
    let mut tracking = Tracking::new(&task, &plan).expect("fits");
    tracking.control_weights = vec![1.0];
    let policy = OpenLoop::new(4, 1, task.horizon);
    let mut rollout = Rollout::<f64>::new(&tracking, &policy, 1);
    rollout.start(&initial_states(&tracking, 0, Purpose::Train, 1));
    rollout.run(&tracking, &policy, &Weights::new(&policy, plan.u.clone())).expect("finite");
    // Lanes may use fused multiply-add, and then round differently from scalars. 100 steps of an
    // unstable plant amplify the difference by about 1e4.
    assert!(rollout.cost(0) < 1e-20, "{}", rollout.cost(0));
    let mut moved = plan.u.clone();
    moved[10] += 0.5;
    rollout.run(&tracking, &policy, &Weights::new(&policy, moved)).expect("finite");
    assert!(
        rollout.cost(0) > 0.5 * 0.5 * 0.5,
        "the deviation of 0.5 in one control costs at most 0.5 · 0.5² = 0.125"
    );
}

#[test]
fn derivatives_of_tracking_equal_dual_numbers() {
    let plan = optimize(&Coupled, &[0.4, 0.1], &[0.3], Initial::Zeros, &Options::default())
        .expect("finite");
    let mut tracking = Tracking::new(&Coupled, &plan).expect("fits");
    (tracking.state_weights, tracking.control_weights, tracking.spread) =
        (vec![1.0, 3.0], vec![0.1, 0.2], 0.5);
    check::cost(&tracking).unwrap();
    check::task(&tracking, &Linear::new(2, 2)).unwrap();
    let starts: Vec<f64> = initial_states(&tracking, 0, Purpose::Train, 3);
    assert!(
        starts.chunks(3).all(|start| start[2] == 0.3 && (start[0] - 0.4).abs() < 0.5),
        "{starts:?}"
    );
}

/// `x' = x + u/m`, over three steps. The mass m is drawn for each sample.
struct Puck;

impl System for Puck {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([("mass", &Number::Uniform { low: 0.5, high: 2.0 })])
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        let [mass] = self.numbers().last_of(p);
        next[0] = x[0] + u[0] / mass;
    }
}

impl Task for Puck {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        3
    }
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x[0] = 1.0;
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
        x[0] * x[0]
    }
}

#[test]
fn all_samples_have_the_drawn_numbers_of_the_plan() {
    let plan =
        optimize(&Puck, &[1.0], &[0.7], Initial::Zeros, &Options::default()).expect("finite");
    let tracking = Tracking::new(&Puck, &plan).expect("fits");
    assert_eq!(
        initial_states::<f64>(&tracking, 0, Purpose::Train, 3),
        [1.0, 0.7, 1.0, 0.7, 1.0, 0.7]
    );
}

#[test]
fn training_linear_feedback_reduces_the_tracking_loss_to_a_fifth() {
    let task = Pendulum { dt: 0.05, horizon: 40 };
    let plan = optimize(&task, &[PI, 0.0], &[], Initial::Controls(&[1.0; 40]), &Options::default())
        .expect("finite");
    let mut tracking = Tracking::new(&task, &plan).expect("fits");
    tracking.spread = 0.1;
    let policy = Sum::new(OpenLoop::new(2, 1, task.horizon), Linear::new(2, 1));
    let theta = [plan.u.clone(), vec![0.0; 2]].concat();
    let (train, test) = (
        initial_states(&tracking, 0, Purpose::Train, 32),
        initial_states(&tracking, 0, Purpose::Test, 32),
    );
    let loss = |theta: &[f64]| {
        let mut evaluation = Evaluation::<f64>::new(&tracking, &policy, 1);
        evaluation
            .run(&tracking, &policy, &Weights::new(&policy, theta.to_vec()), &test)
            .expect("finite")
    };
    let before = loss(&theta);
    let training =
        Training { epochs: 100, batch: 8, workers: 1, learning_rate: 0.1, ..Training::default() };
    let training = Training { decay: Decay::Cosine { end: 0.0 }, ..training };
    let trainer = Trainer::new(tracking.clone(), policy.clone())
        .precision::<f64>()
        .field(Field::regular())
        .training(training);
    let mut session = trainer.session_from(theta, train, test.clone()).expect("valid settings");
    while !session.is_done() {
        session.epoch().expect("finite");
    }
    let after = loss(session.weights().theta());
    assert!(after < 0.2 * before, "{before} before, {after} after");
}

#[test]
fn plan_of_100_steps_is_refused_for_a_horizon_of_99() {
    let (mut task, plan) = plan();
    task.horizon = 99;
    let error = Tracking::new(&task, &plan).expect_err("too many steps");
    assert!(
        matches!(
            error,
            OptimizeError::Length { argument: "plan.x", expected: 400, found: 404, .. }
        ),
        "{error}"
    );
    assert_eq!(task.horizon(), 99);
}
