//! Epochs, with their rollouts and gradients, do not allocate after the first epoch.

use allocation_counter::measure;
use physgrad::policy::{Action, Gru, Mlp, Observed};
use physgrad::rng::Rng;
use physgrad::tasks::{CartPole, LossMode};
use physgrad::{Field, Inputs, Policy, Scalar, Start, System, Task, Trainer, Training};
use rand::RngExt;

#[test]
fn epochs_do_not_allocate_after_the_first() {
    for (field, resample) in
        Field::ALL.map(|field| (field, false)).into_iter().chain([(Field::combined(), true)])
    {
        for loss in [LossMode::Terminal, LossMode::Running] {
            let task = CartPole { loss, ..CartPole::new(2) };
            // The last mini-batch is smaller than the others.
            let training = Training {
                epochs: 4,
                train_samples: 20,
                test_samples: 40,
                resample,
                workers: 1,
                ..Training::default()
            };
            let trainer =
                Trainer::new(task, Mlp::new([6, 16, 16, 1])).field(field).training(training);
            let mut session = trainer.session().expect("valid settings");
            session.epoch().expect("finite");
            let epochs = measure(|| (0..3).for_each(|_| _ = session.epoch().expect("finite")));
            assert_eq!(epochs.count_total, 0, "field {field}, {loss:?}, resample: {resample}");
        }
    }
}

/// Diffusion along a rod of 200 states, heated at one end, with default derivatives only.
struct Rod;

const STATES: usize = 200;

impl System for Rod {
    fn state_dim(&self) -> usize {
        STATES
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        for i in 0..STATES {
            let (left, right) = (if i == 0 { u[0] } else { x[i - 1] }, x[(i + 1).min(STATES - 1)]);
            next[i] = x[i] + (left + right - x[i] * 2.0) * 0.2 - x[i] * x[i] * x[i] * 0.01;
        }
    }
}

impl Task for Rod {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        10
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(STATES)
    }
    fn observe<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, y: &mut [T]) {
        y.iter_mut().zip(x).for_each(|(y, &x)| *y = x.sin());
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        next.iter().map(|&x| x * x).sum::<T>() + u[0] * u[0]
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
        x.iter().map(|&x| x * x).sum()
    }
}

/// Linear feedback that implements `act`, but no batched pass.
struct Feedback;

impl Policy for Feedback {
    fn observation_dim(&self) -> usize {
        STATES
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_count(&self) -> usize {
        STATES
    }
    fn init(&self, _: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.01);
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        u[0] = theta.iter().zip(y).map(|(&theta, &y)| theta * y).sum();
    }
}

/// Returns the number of allocations in the second and third epoch.
fn allocations_after_the_first_epoch(policy: impl Policy, field: Field) -> u64 {
    let training = Training {
        epochs: 3,
        train_samples: 20,
        test_samples: 8,
        workers: 1,
        ..Training::default()
    };
    let mut session = Trainer::new(Rod, policy)
        .field(field)
        .training(training)
        .session()
        .expect("valid settings");
    session.epoch().expect("finite");
    measure(|| (0..2).for_each(|_| _ = session.epoch().expect("finite"))).count_total
}

#[test]
fn default_derivatives_of_200_states_do_not_allocate_after_the_first_epoch() {
    for field in Field::ALL {
        assert_eq!(allocations_after_the_first_epoch(Feedback, field), 0, "field {field}");
    }
}

#[test]
fn large_recurrent_policies_do_not_allocate_after_the_first_epoch() {
    // All flows; other fields combine the same gradients.
    for field in
        [Field::combined(), Field::regular(), Field::modified(), Field::network(), Field::stopped()]
    {
        assert_eq!(
            allocations_after_the_first_epoch(Gru::new(STATES, 40, 1), field),
            0,
            "field {field}"
        );
    }
}
