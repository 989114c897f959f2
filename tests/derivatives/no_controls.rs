//! Systems without controls, and tasks without observations.

use physgrad::actuator::{AnyActuator, Delay, Lag, Limit, LimitKind};
use physgrad::policy::{Constant, Linear, OpenLoop, TrainedParam, WithParams};
use physgrad::rng::Rng;
use physgrad::{Actuated, Field, Inputs, Scalar, Start, System, Task, Trainer, Training, check};
use rand::RngExt;

/// Decay `x' = x - p x/10` without controls.
struct Decay;

impl System for Decay {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] - p[0] * x[0] * 0.1;
    }
}

/// Task of a system without controls. The loss compares the states with the powers 0.93^t, the
/// states of [`Decay`] at p = 0.7.
struct Measured<S>(S);

impl<S: System> Task for Measured<S> {
    type System = S;
    fn system(&self) -> &S {
        &self.0
    }
    fn horizon(&self) -> usize {
        5
    }
    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        x.fill(1.0);
        p.fill_with(|| rng.random_range(0.1..0.3));
    }
    fn running_cost<T: Scalar>(&self, Inputs { t, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let error = next[0] - 0.93f64.powi(t as i32 + 1);
        error * error
    }
}

#[test]
fn parameters_of_systems_without_controls_are_trained() {
    let policies = [
        WithParams::new(Linear::new(1, 0), [TrainedParam::log(0, 0.2)]),
        WithParams::new(Linear::with_bias(1, 0), [TrainedParam::log(0, 0.2)]),
    ];
    for policy in policies {
        check::policy(&policy).unwrap();
        check::task(&Measured(Decay), &policy).unwrap();
    }
    let policy = WithParams::new(Constant::new(1, 0), [TrainedParam::log(0, 0.2)]);
    check::task(&Measured(Decay), &policy).unwrap();
    let training = Training {
        epochs: 60,
        train_samples: 8,
        test_samples: 1,
        batch: 1,
        learning_rate: 0.1,
        ..Training::default()
    };
    let training = Training { decay: physgrad::train::Decay::Cosine { end: 0.0 }, ..training };
    let report = Trainer::new(Measured(Decay), policy.clone())
        .precision::<f64>()
        .field(Field::regular())
        .training(training)
        .run();
    let rate = policy.values(report.expect("a finite training").weights.theta())[0];
    assert!((rate - 0.7).abs() < 1e-3, "{rate}");
}

#[test]
fn chains_of_actuators_on_systems_without_controls_are_the_identity() {
    let limit = AnyActuator::Limit(Limit { bound: 1.0, kind: LimitKind::Smooth });
    for actuator in [
        vec![limit],
        vec![limit, AnyActuator::Delay(Delay { steps: 2 }), AnyActuator::Lag(Lag::new(0.1, 0.1))],
    ] {
        let system = Actuated { system: Decay, actuator };
        check::system(&system).unwrap();
        let (mut next, mut alone) = ([0.0], [0.0]);
        system.step::<f64>(Inputs { x: &[0.4], u: &[], p: &[0.3], t: 0 }, &mut next);
        Decay.step::<f64>(Inputs { x: &[0.4], u: &[], p: &[0.3], t: 0 }, &mut alone);
        assert_eq!(next, alone);
        check::task(&Measured(system), &Constant::new(1, 0)).unwrap();
    }
}

/// `x' = x + u/10`, controlled without observations.
struct Blind;

impl System for Blind {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + u[0] * 0.1;
    }
}

impl Task for Blind {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        5
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(0)
    }
    fn observe<T: Scalar>(&self, _inputs: Inputs<'_, T>, _y: &mut [T]) {}
    fn start(&self, _: &mut Rng, start: Start<'_>) {
        start.x.fill(1.0);
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * x[0]
    }
}

#[test]
fn policies_without_observations_are_trained() {
    check::policy(&Linear::with_bias(0, 2)).unwrap();
    check::task(&Blind, &Linear::with_bias(0, 1)).unwrap();
    check::task(&Blind, &Constant::new(0, 1)).unwrap();
    check::task(&Blind, &OpenLoop::new(0, 1, 5)).unwrap();
}
