//! Gradients are bitwise independent of the checkpoint schedule, and memory stays within its
//! budget.

use physgrad::engine::{Batch, Checkpointed, Schedule};
use physgrad::policy::{Action, Conv, DynPolicy, Gru, Mlp, Observed, WithParams};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{CartPole, Guidance, LossMode, Quantum};
use physgrad::{
    Adjoint, Divergence, DynTask, Field, Float, Flow, Gradient, Policy, Rollout, Scalar, Task,
    initial_states,
};
use physgrad::{TrainError, Trainer, Training, Weights};
use rand::RngExt;

const UNIT: usize = Schedule::UNIT;

/// Returns the result of `work`, the bytes that it retains, and its peak of allocated bytes.
fn held<T>(work: impl FnOnce() -> T) -> (T, usize, usize) {
    let mut result = None;
    let info = allocation_counter::measure(|| result = Some(work()));
    (result.expect("work is done"), info.bytes_current as usize, info.bytes_max as usize)
}

/// Draws small parameters, so that long rollouts stay near their initial state.
fn weights<F: Float, P: Policy>(policy: &P) -> Weights<F> {
    let mut rng = stream(3, Purpose::Check, 0);
    Weights::new(
        policy,
        (0..policy.param_count()).map(|_| F::from_f64(rng.random_range(-0.1..0.1))).collect(),
    )
}

fn starts<F: Float, T: Task>(task: &T, samples: usize) -> Vec<F> {
    initial_states(task, 0, Purpose::Train, samples)
}

/// Returns the costs of the samples and the gradients of the flows. `Rollout` and `Adjoint` store
/// all steps.
fn stored<F: Float, T: Task, P: Policy>(
    task: &T,
    policy: &P,
    samples: usize,
    flows: &[Flow],
) -> Result<Vec<F>, Divergence> {
    let weights = weights::<F, P>(policy);
    let mut rollout = Rollout::new(task, policy, samples + 1);
    rollout.start(&starts(task, samples));
    rollout.run(task, policy, &weights)?;
    let mut adjoint = Adjoint::new(task, policy, &rollout, flows);
    adjoint.run(task, policy, &weights, &rollout, F::from_f64(0.5))?;
    let mut all: Vec<F> = (0..samples).map(|sample| rollout.cost(sample)).collect();
    for k in 0..flows.len() {
        let mut theta_bar = Gradient::zeros(policy.param_count());
        adjoint.param_gradient(k, policy, &weights, &rollout, 0..samples, &mut theta_bar);
        all.extend(theta_bar.to_vec());
    }
    Ok(all)
}

/// Returns the costs and gradients as [`stored`] does, with a checkpoint schedule.
fn scheduled<F: Float, T: Task, P: Policy>(
    task: &T,
    policy: &P,
    samples: usize,
    flows: &[Flow],
    schedule: Schedule,
) -> Result<Vec<F>, Divergence> {
    let weights = weights::<F, P>(policy);
    let mut rollout = Checkpointed::new(task, policy, samples + 1, flows, schedule);
    let mut gradients = [vec![Gradient::zeros(policy.param_count()); flows.len()]];
    let starts = starts::<F, T>(task, samples);
    // The first run has one more sample. Values that remain in the buffers must not affect the
    // second run.
    let more = [&starts[..], &starts[..starts.len() / samples]].concat();
    for starts in [&more, &starts] {
        rollout.run(
            task,
            policy,
            &weights,
            starts,
            F::from_f64(0.5),
            samples + 1,
            &mut gradients,
        )?;
    }
    let costs = (0..samples).map(|sample| rollout.cost(sample));
    Ok(costs.chain(gradients.iter().flatten().flat_map(Gradient::to_vec)).collect())
}

fn schedules(horizon: usize) -> Vec<Schedule> {
    let binomial = [1, 2, 3, 100].map(|checkpoints| Schedule::binomial(horizon, checkpoints));
    let others = [
        Schedule::store_all(horizon),
        Schedule::two_level(horizon),
        Schedule::new(horizon, 2 * UNIT, 1),
    ];
    binomial.into_iter().chain(others).collect()
}

/// Returns each flow alone, and pairs with none, one or two flows through the policy's input.
fn flows() -> Vec<Vec<Flow>> {
    let pairs = [
        [Flow::MODIFIED, Flow::REGULAR],
        [Flow::MODIFIED, Flow::STOPPED],
        [Flow::NETWORK, Flow::REGULAR],
    ];
    Flow::ALL.map(|flow| vec![flow]).into_iter().chain(pairs.map(Vec::from)).collect()
}

fn assert_bits_of_store_all<F: Float, T: Task, P: Policy>(task: &T, policy: &P, samples: &[usize]) {
    for &samples in samples {
        for flows in flows() {
            let all = stored::<F, T, P>(task, policy, samples, &flows).expect("finite");
            assert!(
                all.iter().all(|g| g.as_().is_finite())
                    && all[samples..].iter().any(|&g| g != F::zero())
            );
            for schedule in schedules(task.horizon()) {
                let same = scheduled::<F, T, P>(task, policy, samples, &flows, schedule)
                    .expect("finite")
                    == all;
                assert!(same, "{schedule:?}, {samples} samples, {flows:?} in {}", F::NAME);
            }
        }
    }
}

/// Returns a network of the type whose passes the library compiles.
fn network(mlp: Mlp) -> WithParams<DynPolicy> {
    WithParams::new(DynPolicy::new(mlp), [])
}

fn cart_pole(horizon: usize) -> DynTask {
    DynTask::new(CartPole { horizon, loss: LossMode::Running, ..CartPole::new(1) })
}

#[test]
fn all_schedules_have_the_bits_of_store_all_with_one_control() {
    let (task, policy) = (cart_pole(4 * UNIT + 17), network(Mlp::new([4, 8, 8, 1])));
    assert_bits_of_store_all::<f32, _, _>(&task, &policy, &[3, 11]);
    assert_bits_of_store_all::<f64, _, _>(&task, &policy, &[3, 11]);
    // Horizons whose last segment has one step or full length.
    for horizon in [2 * UNIT + 1, 3 * UNIT, UNIT + 1] {
        assert_bits_of_store_all::<f64, _, _>(&cart_pole(horizon), &policy, &[9]);
    }
}

#[test]
fn all_schedules_have_the_bits_of_store_all_with_several_controls() {
    let task = DynTask::new(Guidance { horizon: 3 * UNIT + 5, ..Guidance::new(1, 1) });
    let policy = network(Mlp::new([physgrad::System::state_dim(task.system()), 8, 2]));
    assert_bits_of_store_all::<f32, _, _>(&task, &policy, &[5]);
    assert_bits_of_store_all::<f64, _, _>(&task, &policy, &[9]);
}

#[test]
fn all_schedules_have_the_bits_of_store_all_with_a_convolution_and_with_derivatives_by_duals() {
    let task = DynTask::new(Quantum { horizon: 2 * UNIT + 9, ..Quantum::new(1) });
    let n = physgrad::System::state_dim(task.system());
    let flows = [Flow::MODIFIED, Flow::REGULAR];
    let conv = Conv::new(n / 2, 4);
    let all = stored::<f32, _, _>(&task, &conv, 5, &flows).expect("finite");
    for schedule in schedules(task.horizon()) {
        assert_eq!(scheduled(&task, &conv, 5, &flows, schedule), Ok(all.clone()), "{schedule:?}");
    }
    assert_bits_of_store_all::<f64, _, _>(&cart_pole(2 * UNIT + 9), &Plain, &[3]);
}

#[test]
fn all_schedules_have_the_bits_of_store_all_with_a_memory() {
    let (task, policy) = (cart_pole(2 * UNIT + 9), Gru::new(4, 6, 1));
    assert_bits_of_store_all::<f32, _, _>(&task, &policy, &[11]);
    assert_bits_of_store_all::<f64, _, _>(&cart_pole(UNIT + 9), &policy, &[3]);
}

#[test]
fn mini_batches_over_several_workers_have_the_bits_of_store_all() {
    assert_bits_of_mini_batches(&cart_pole(3 * UNIT + 2), &Mlp::new([4, 8, 1]));
    assert_bits_of_mini_batches(&cart_pole(UNIT + 20), &Gru::new(4, 5, 1));
}

fn assert_bits_of_mini_batches(task: &DynTask, policy: &impl Policy) {
    let (weights, starts) = (weights::<f32, _>(policy), starts::<f32, _>(task, 13));
    let flows = Field::combined().flows();
    let run = |mut batch: Batch<f32>| {
        let loss = batch.run(task, policy, &weights, &starts).expect("finite");
        (loss, batch.gradients().to_vec())
    };
    let all = run(Batch::new(task, policy, 17, &flows, 1));
    for workers in [1, 2, 5] {
        for schedule in schedules(task.horizon()) {
            assert_eq!(run(Batch::scheduled(task, policy, 17, &flows, workers, schedule)), all);
        }
    }
}

#[test]
fn every_schedule_reports_the_divergence_of_store_all() {
    let task = DynTask::new(CartPole { horizon: 3 * UNIT, ..CartPole::new(1) });
    // The control grows with the state.
    for factor in [1e4, 1e10, 1e30] {
        let policy = Growing(factor);
        let all = stored::<f32, _, _>(&task, &policy, 3, &[Flow::REGULAR]);
        for schedule in schedules(task.horizon()) {
            assert_eq!(scheduled::<f32, _, _>(&task, &policy, 3, &[Flow::REGULAR], schedule), all);
        }
    }
    assert!(stored::<f32, _, _>(&task, &Growing(1e30), 3, &[Flow::REGULAR]).is_err());
}

/// Policy `u = θ₀ x₀ + θ₁ sin x₂`, with default batched passes.
struct Plain;

impl Policy for Plain {
    fn observation_dim(&self) -> usize {
        4
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_count(&self) -> usize {
        2
    }
    fn init(&self, _: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.1);
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        u[0] = theta[0] * y[0] + theta[1] * y[2].sin_cos().0;
    }
}

/// Policy `u = factor x₀ + θ`.
struct Growing(f64);

impl Policy for Growing {
    fn observation_dim(&self) -> usize {
        4
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_count(&self) -> usize {
        1
    }
    fn init(&self, _: &mut Rng, theta: &mut [f64]) {
        theta.fill(1.0);
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        u[0] = theta[0] + y[0] * self.0;
    }
}

fn assert_exact_bytes<F: Float>() {
    let (task, policy) = (cart_pole(6 * UNIT + 40), network(Mlp::new([4, 8, 1])));
    let (weights, starts) = (weights::<F, _>(&policy), starts::<F, _>(&task, 17));
    // The first run of a process detects the processor's features, which allocates.
    stored::<F, _, _>(&cart_pole(2), &policy, 1, &[Flow::REGULAR]).expect("finite");
    for flows in flows() {
        for schedule in schedules(task.horizon()) {
            let (mut rollout, bytes, most) =
                held(|| Checkpointed::<F>::new(&task, &policy, 17, &flows, schedule));
            assert_eq!((rollout.stored_bytes(), most), (bytes, bytes), "{schedule:?}, {flows:?}");
            assert_eq!(
                Checkpointed::<F>::bytes_of(&task, &policy, 17, &flows, &schedule),
                bytes,
                "{schedule:?}, {flows:?}"
            );
            let mut gradients = vec![vec![Gradient::zeros(policy.param_count()); flows.len()]; 5];
            let run =
                || rollout.run(&task, &policy, &weights, &starts, F::one(), 4, &mut gradients);
            let (outcome, _, most) = held(run);
            assert_eq!((outcome, most), (Ok(()), 0), "a run of a schedule allocates");

            for workers in [1, 3] {
                let (batch, bytes, most) =
                    held(|| Batch::<F>::scheduled(&task, &policy, 17, &flows, workers, schedule));
                assert_eq!(
                    (batch.stored_bytes(), most),
                    (bytes, bytes),
                    "{schedule:?}, {flows:?}, {workers} workers"
                );
                assert_eq!(
                    Batch::<F>::bytes_of(&task, &policy, 17, &flows, workers, &schedule),
                    bytes
                );
            }
        }
    }
}

#[test]
fn stored_bytes_of_schedules_equal_allocated_bytes() {
    assert_exact_bytes::<f32>();
    assert_exact_bytes::<f64>();
}

#[test]
fn batches_stay_within_the_budget_and_recompute_the_fewest_steps() {
    let (task, policy) = (cart_pole(40 * UNIT - 50), Mlp::new([4, 8, 1]));
    let (weights, starts) = (weights::<f32, _>(&policy), starts::<f32, _>(&task, 6));
    let flows = Field::combined().flows();
    let all =
        Batch::<f32>::bytes_of(&task, &policy, 6, &flows, 1, &Schedule::store_all(task.horizon()))
            as u64;
    let error = Batch::<f32>::within(&task, &policy, 6, &flows, 1, 1000).unwrap_err();
    assert_eq!((error.budget, error.everything), (1000, all));
    let smallest = error.smallest;
    assert!(20 * smallest < all && error.to_string().contains(&smallest.to_string()), "{error}");
    assert!(Batch::<f32>::within(&task, &policy, 6, &flows, 1, smallest - 1).is_err());

    let mut last = u64::MAX;
    let mut expected: Option<Vec<Gradient<f32>>> = None;
    for budget in [
        smallest,
        smallest + 500,
        smallest + 3000,
        all / 15,
        all / 5,
        all / 2,
        all - 1,
        all,
        u64::MAX,
    ] {
        let ((batch, loss), _, most) = held(|| {
            let mut batch = Batch::<f32>::within(&task, &policy, 6, &flows, 1, budget)
                .expect("a sufficient budget");
            let loss = batch.run(&task, &policy, &weights, &starts).expect("finite");
            (batch, loss)
        });
        assert!(
            loss.is_finite() && most as u64 <= budget && most == batch.stored_bytes(),
            "{most} bytes of {budget}"
        );
        let schedule = batch.schedule();
        assert!(schedule.recomputed_steps() <= last, "a larger budget recomputes more steps");
        last = schedule.recomputed_steps();
        // No other schedule within the budget recomputes fewer steps.
        for units in 1..=40 {
            for checkpoints in 1..=40 {
                let other = Schedule::new(task.horizon(), units * UNIT, checkpoints);
                let bytes = Batch::<f32>::bytes_of(&task, &policy, 6, &flows, 1, &other) as u64;
                assert!(
                    bytes > budget || other.recomputed_steps() >= last,
                    "{other:?} is better than {schedule:?}"
                );
            }
        }
        assert_eq!(expected.get_or_insert_with(|| batch.gradients().to_vec()), batch.gradients());
    }
    assert_eq!(last, 0);
}

#[test]
fn a_training_within_a_budget_has_the_parameters_of_one_without() {
    let train = |memory: Option<u64>| {
        let task = CartPole { horizon: 2 * UNIT, ..CartPole::new(1) };
        let training = Training {
            epochs: 2,
            train_samples: 20,
            test_samples: 4,
            memory,
            ..Training::default()
        };
        let mut session = Trainer::new(task, Mlp::new([4, 8, 1])).training(training).session()?;
        session.epoch()?;
        let (_, held, _) = held(|| session.epoch().map(|_| ()));
        assert_eq!(held, 0, "the second epoch retains memory");
        Ok::<_, TrainError>((
            session.schedule().recomputed_steps(),
            session.weights().theta().to_vec(),
        ))
    };
    let error = train(Some(10_000)).unwrap_err();
    assert!(
        error.to_string().starts_with("training.memory: 10000 bytes are not enough"),
        "{error}"
    );
    let TrainError::Memory(error) = error else { panic!("{error}") };
    let (all, within) = (train(None).unwrap(), train(Some(error.smallest)).unwrap());
    assert_eq!((all.0, within.0), (0, UNIT as u64));
    assert_eq!(all.1, within.1);
    assert_eq!(train(Some(error.everything)).unwrap(), all);
}

#[test]
fn a_hundred_thousand_steps_fit_in_300_kilobytes() {
    let (task, policy) = (cart_pole(100_000), Mlp::new([4, 4, 1]).zero_init_output(true));
    let flows = [Flow::REGULAR];
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts = starts::<f64, _>(&task, 2);
    let run = |mut batch: Batch<f64>| {
        batch.run(&task, &policy, &weights, &starts).expect("finite");
        (batch.gradients().to_vec(), batch.schedule().recomputed_steps(), batch.stored_bytes())
    };
    let (all, none, bytes) = run(Batch::new(&task, &policy, 2, &flows, 1));
    let (gradients, again, fewer) =
        run(Batch::within(&task, &policy, 2, &flows, 1, 300_000).expect("a sufficient budget"));
    assert!(all[0].values().iter().any(|&g| g != 0.0) && gradients == all);
    assert!(
        none == 0 && again > 0 && again < 200_000 && fewer <= 300_000 && bytes > 100 * fewer,
        "{again} {fewer} {bytes}"
    );
}

#[test]
#[ignore = "a million steps: too slow for the default test run"]
fn a_million_steps_fit_in_64_and_in_4_mebibytes() {
    let (task, policy) = (cart_pole(1_000_000), Mlp::new([4, 16, 16, 1]).zero_init_output(true));
    let weights = Weights::<f64>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts = starts::<f64, _>(&task, 8);
    for budget in [64 << 20, 4 << 20] {
        let time = std::time::Instant::now();
        let (schedule, _, most) = held(|| {
            let mut batch = Batch::within(&task, &policy, 8, &[Flow::REGULAR], 1, budget)
                .expect("a sufficient budget");
            batch.run(&task, &policy, &weights, &starts).expect("finite");
            batch.schedule()
        });
        println!(
            "{schedule:?}: {} steps again, {most} bytes, {:?}",
            schedule.recomputed_steps(),
            time.elapsed()
        );
        assert!(most as u64 <= budget);
    }
}
