//! A number that is none is named, and nothing is learned from it.

use super::{Case, Finding};
use crate::backward::Flow;
use crate::batch::Batch;
use crate::divergence::{Cause, Divergence, Variable};
use crate::effect::{Effect, With};
use crate::field::Field;
use crate::policy::{Mlp, Weights};
use crate::rng::{Purpose, stream};
use crate::scalar::Scalar;
use crate::task::Task;
use crate::tasks::{CartPole, CartPoleSystem};
use crate::train::{Trainer, Training};

pub(super) const CASES: &[Case] = &[Case {
    name: "injected_nan",
    about: "an effect that fails at one step of one sample: in its force, or in its derivative alone",
    criterion: "step, sample, pass and effect are named exactly, for any number of workers; no parameter changes",
    story: "Elsewhere a NaN is noticed in the loss, an epoch later, in all parameters. Here every step is tested, \
            forward and back, at no cost that can be measured; what is found is named, to the effect whose force or \
            derivative it is, the update is not taken, and training goes on, or stops by `max_skipped`. What remains: \
            what a system of one's own computes inside is told as a component of the state",
    run: injected_nan,
}];

/// Fails at one step in samples whose cart starts to the right of the others: its force, or its derivative alone.
#[derive(Clone, Debug)]
struct Injected {
    step: usize,
    dt: f64,
    in_derivative: bool,
}

impl Effect<CartPoleSystem> for Injected {
    fn act<T: Scalar>(&self, body: &CartPoleSystem, x: &[T], forces: &mut [T]) {
        let time = x[2 + 2 * body.poles];
        let nothing = if self.in_derivative { (x[1] - x[1].detach()).sqrt() } else { T::lift(f64::NAN) };
        let now = (time - T::lift(self.step as f64 * self.dt)).abs();
        let here = T::select_lt(T::lift(50.0), x[0], nothing, T::zero());
        forces[0] += T::select_lt(now, T::lift(0.5 * self.dt), here, T::zero());
    }

    fn clock(&self) -> Option<f64> {
        Some(0.0)
    }
}

const SAMPLES: usize = 11;
const HORIZON: usize = 30;

fn injected_nan() -> Vec<Finding> {
    let system = CartPoleSystem::default();
    let policy = Mlp::new([5, 8, 1]);
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let field = Field::combined();
    let (mut named, mut unchanged, mut all) = (0, 0, 0);
    for (step, bad) in [(0, 0), (1, 10), (7, 3), (17, 8), (HORIZON - 1, 5)] {
        for in_derivative in [false, true] {
            let effects = Injected { step, dt: system.dt, in_derivative };
            let task = CartPole { horizon: HORIZON, ..CartPole::around(With { system, effects }) };
            let starts: Vec<f64> = (0..SAMPLES)
                .flat_map(|sample| {
                    let mut x = [0.0; 5];
                    task.start(&mut stream(0, Purpose::Train, sample as u64), &mut x);
                    x[0] += if sample == bad { 100.0 } else { 0.0 };
                    x
                })
                .collect();
            let cause = Some(Cause::Effect("Injected"));
            let is_named = |divergence: Divergence| match divergence {
                Divergence::Forward { variable: Variable::State, step: at, sample, component, cause: found } => {
                    !in_derivative && (at, sample, component, found) == (step + 1, bad, 0, cause)
                }
                Divergence::Cotangent {
                    flow: Flow::MODIFIED,
                    variable: Variable::State,
                    step: at,
                    sample,
                    component,
                    cause: found,
                } => in_derivative && (at, sample, component, found) == (step, bad, 1, cause),
                _ => false,
            };
            for workers in [1, 2, 8] {
                let found = Batch::new(&task, &policy, SAMPLES, &field.flows(), workers).run(&task, &policy, &weights, &starts);
                all += 1;
                named += usize::from(found.err().is_some_and(is_named));
                let training = Training { batch: SAMPLES, workers, ..Training::default() };
                let trainer = Trainer::new(task.clone(), policy.clone()).precision::<f64>().training(training);
                let session = trainer.session_from(weights.theta().to_vec(), starts.clone(), starts.clone());
                let same = session.is_ok_and(|mut session| {
                    session.epoch().is_ok_and(|record| record.skipped == 1) && session.weights().theta() == weights.theta()
                });
                unchanged += usize::from(same);
            }
        }
    }
    vec![Finding::all("named exactly", named, all), Finding::all("without a change of the parameters", unchanged, all)]
}
