//! Several processes, here threads, compute the bits of one.

use physgrad::engine::{Batch, Evaluation, Growth, Ranks};
use physgrad::policy::{Linear, Mlp, Policy};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::CartPole;
use physgrad::{Flow, Gradient, Inputs, Scalar, Start, System, Task, Weights, initial_states};
use std::sync::{Arc, Barrier, Mutex};

/// Ranks that are threads of one process.
#[derive(Debug)]
struct Threads {
    rank: usize,
    /// `[from][to]`.
    messages: Arc<Mutex<Vec<Vec<Vec<u8>>>>>,
    barrier: Arc<Barrier>,
}

impl Threads {
    fn all(count: usize) -> Vec<Arc<dyn Ranks>> {
        let messages = Arc::new(Mutex::new(vec![vec![Vec::new(); count]; count]));
        let barrier = Arc::new(Barrier::new(count));
        let of =
            |rank| Arc::new(Self { rank, messages: messages.clone(), barrier: barrier.clone() });
        (0..count).map(|rank| of(rank) as _).collect()
    }
}

impl Ranks for Threads {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.messages.lock().expect("no panic").len()
    }

    fn exchange(&self, messages: &[&[u8]]) -> Vec<Vec<u8>> {
        self.messages.lock().expect("no panic")[self.rank] =
            messages.iter().map(|message| message.to_vec()).collect();
        self.barrier.wait();
        let sent = self.messages.lock().expect("no panic").clone();
        let received = sent.into_iter().map(|mut row| row.swap_remove(self.rank)).collect();
        self.barrier.wait();
        received
    }
}

/// An unstable plant: x' = 3 x + u. The adjoint of R grows by 3 per step, so that the gradients of
/// most samples exceed the range of f32 and carry exponents, and those of others do not.
struct Unstable;

impl System for Unstable {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 3.0 + u[0];
    }
}

impl Task for Unstable {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        60
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = 10f64.powf(-36.0 + 24.0 * rand::RngExt::random::<f64>(rng));
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * x[0]
    }
}

/// Losses of a batch and of an evaluation, gradients and growth.
type Found = (f64, f64, Vec<Gradient<f32>>, Vec<Option<Growth>>);

fn found<K, P>(
    task: &K,
    policy: &P,
    samples: usize,
    ranks: Option<Arc<dyn Ranks>>,
    workers: usize,
) -> Found
where
    K: Task,
    P: Policy,
{
    let weights = Weights::<f32>::init(policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<f32> = initial_states(task, 0, Purpose::Train, samples);
    let flows = [Flow::MODIFIED, Flow::REGULAR];
    let evaluation = Evaluation::new(task, policy, workers);
    let (mut batch, mut evaluation) = match ranks {
        None => (Batch::new(task, policy, samples, &flows, workers), evaluation),
        Some(ranks) => {
            let batch = Batch::shared(ranks.clone(), task, policy, samples, &flows, workers, None);
            (batch.expect("no limit"), evaluation.shared(ranks))
        }
    };
    batch.measure(true);
    let loss = batch.run(task, policy, &weights, &starts).expect("finite");
    let evaluated = evaluation.run(task, policy, &weights, &starts).expect("finite");
    (loss, evaluated, batch.gradients().to_vec(), (0..2).map(|k| batch.growth(k)).collect())
}

/// Compares with one worker of one process. Blocks have 1, 1, 2 and 3 groups of samples. The last
/// group is incomplete except for 128 samples. The last block of 130 and of 269 samples has fewer
/// groups.
fn check<K: Task, P: Policy>(task: &K, policy: &P) -> Vec<Gradient<f32>> {
    let mut gradients = Vec::new();
    for samples in [3, 128, 130, 269] {
        let one = found(task, policy, samples, None, 1);
        for workers in [2, 3] {
            let several = found(task, policy, samples, None, workers);
            assert_eq!(one, several, "{samples} samples, {workers} workers");
        }
        for count in [1, 2, 3, 8] {
            std::thread::scope(|scope| {
                let one = &one;
                for ranks in Threads::all(count) {
                    scope.spawn(move || {
                        let shared = found(task, policy, samples, Some(ranks), 2);
                        assert_eq!(one, &shared, "{samples} samples, {count} ranks");
                    });
                }
            });
        }
        gradients.extend(one.2);
    }
    gradients
}

#[test]
fn ranks_and_workers_have_the_bits_of_one_worker() {
    check(&CartPole { horizon: 5, ..CartPole::new(1) }, &Mlp::new([4, 6, 1]));
}

#[test]
fn ranks_and_workers_have_the_bits_of_one_worker_beyond_the_range_of_f32() {
    let gradients = check(&Unstable, &Linear::with_bias(1, 1));
    assert!(
        gradients.iter().any(|gradient| gradient.exponent() > 0),
        "no gradient has an exponent"
    );
}
