//! Stress case: location of non-finite values, and skipped updates.

use super::{Case, Finding};
use physgrad::Divergence;
use physgrad::Field;
use physgrad::Flow;
use physgrad::Scalar;
use physgrad::Task;
use physgrad::effect::ForcedSystem;
use physgrad::engine::Batch;
use physgrad::engine::Cause;
use physgrad::engine::Variable;
use physgrad::policy::{Linear, Weights};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::{Effect, Forced};
use physgrad::{Inputs, OdeInputs, Start};
use physgrad::{Trainer, Training};
use rand::RngExt;

pub(super) const CASES: &[Case] = &[Case {
    name: "injected_nan",
    about: "effect that fails at one step of one sample, in its force or only in its derivative",
    criterion: "step, sample, pass and effect are named exactly, for any number of workers. No parameter changes",
    explanation: "Without checks, a NaN appears in the loss an epoch later, when all parameters contain it. Here both \
                passes check every step. The message names the effect whose force or derivative is non-finite. \
                Training skips the update, and stops after more than `max_skipped` consecutive skips. Limits: a \
                fault inside a custom system is reported as a component of the state",
    run: injected_nan,
}];

/// Mass of 1 kg pushed along a line: `[position m, velocity m/s]`, semi-implicit Euler.
struct PointMass;

/// Time step, s.
const DT: f64 = 0.02;

impl ForcedSystem for PointMass {
    type Model = Self;

    fn model(&self) -> &Self {
        self
    }
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn force_dim(&self) -> usize {
        1
    }
    fn dt(&self) -> f64 {
        DT
    }
    #[inline(always)]
    fn forced_step<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        let (x, mut force) = (inputs.x, [inputs.u[0]]);
        effects.add_forces(self, inputs.continuous(DT), &mut force);
        next[1] = x[1] + force[0] * DT;
        next[0] = x[0] + next[1] * DT;
    }
}

/// Effect with a non-finite force, or only a non-finite derivative, at one step. It affects samples
/// with x > 50.
#[derive(Clone, Debug)]
struct Injected {
    step: usize,
    in_derivative: bool,
}

impl Effect<PointMass> for Injected {
    fn add_forces<T: Scalar>(
        &self,
        _model: &PointMass,
        OdeInputs { x, t, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let fault =
            if self.in_derivative { (x[1] - x[1].detach()).sqrt() } else { T::from(f64::NAN) };
        let time_difference = (t - (self.step as f64 * DT)).abs();
        let of_sample = T::select_lt(T::from(50.0), x[0], fault, T::zero());
        forces[0] += T::select_lt(time_difference, T::from(0.5 * DT), of_sample, T::zero());
    }
}

/// Task with the running cost x², where x is the position after the step.
struct ReturnTask(Forced<PointMass, Injected>);

impl Task for ReturnTask {
    type System = Forced<PointMass, Injected>;

    fn system(&self) -> &Self::System {
        &self.0
    }
    fn horizon(&self) -> usize {
        HORIZON
    }
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        start.x[0] = rng.random_range(-1.0..1.0);
    }
    #[inline(always)]
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, x: &[T]) -> T {
        x[0] * x[0]
    }
}

const SAMPLES: usize = 11;
const HORIZON: usize = 30;

fn injected_nan() -> Vec<Finding> {
    let policy = Linear::with_bias(2, 1);
    let weights = Weights::<f64>::new(&policy, vec![-0.5, -1.0, 0.2]);
    let field = Field::combined();
    let (mut named, mut unchanged, mut all) = (0, 0, 0);
    for (step, bad) in [(0, 0), (1, 10), (7, 3), (17, 8), (HORIZON - 1, 5)] {
        for in_derivative in [false, true] {
            let task = || {
                ReturnTask(Forced { system: PointMass, effects: Injected { step, in_derivative } })
            };
            let starts: Vec<f64> = (0..SAMPLES)
                .flat_map(|sample| {
                    let mut x = [0.0; 2];
                    task().start(
                        &mut stream(0, Purpose::Train, sample as u64),
                        Start { x: &mut x, p: &mut [] },
                    );
                    x[0] += if sample == bad { 100.0 } else { 0.0 };
                    x
                })
                .collect();
            let cause = Some(Cause::Effect("Injected"));
            let is_named = |divergence: Divergence| match divergence {
                Divergence::Forward {
                    variable: Variable::State,
                    step: at,
                    sample,
                    component,
                    cause: found,
                } => !in_derivative && (at, sample, component, found) == (step + 1, bad, 0, cause),
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
                let found = Batch::new(&task(), &policy, SAMPLES, &field.flows(), workers).run(
                    &task(),
                    &policy,
                    &weights,
                    &starts,
                );
                all += 1;
                named += usize::from(found.err().is_some_and(is_named));
                let training = Training { batch: SAMPLES, workers, ..Training::default() };
                let trainer =
                    Trainer::new(task(), policy.clone()).precision::<f64>().training(training);
                let session =
                    trainer.session_from(weights.theta().to_vec(), starts.clone(), starts.clone());
                let is_unchanged = session.is_ok_and(|mut session| {
                    session.epoch().is_ok_and(|record| record.skipped == 1)
                        && session.weights().theta() == weights.theta()
                });
                unchanged += usize::from(is_unchanged);
            }
        }
    }
    vec![
        Finding::all("faults named exactly", named, all),
        Finding::all("faults without a change of the parameters", unchanged, all),
    ]
}
