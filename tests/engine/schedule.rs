//! Binomial checkpoint schedules recompute the fewest steps. All schedules recompute exactly as
//! many steps as they report.

use physgrad::engine::{Checkpointed, Schedule};
use physgrad::policy::{Action, Observed, PolicyPass};
use physgrad::rng::Rng;
use physgrad::tasks::CartPole;
use physgrad::{Float, Flow, Gradient, Policy, Scalar, Weights};
use std::sync::atomic::{AtomicU64, Ordering};

const UNIT: usize = Schedule::UNIT;

/// Policy that counts its forward passes, one per step.
struct CallCounter(AtomicU64);

impl Policy for CallCounter {
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
        theta.fill(0.0);
    }
    fn act<T: Scalar>(&self, theta: &[T], _: Observed<'_, T>, Action { u, .. }: Action<'_, T>) {
        u.copy_from_slice(theta);
    }
    fn forward<F: Float>(&self, pass: PolicyPass<F>, _: &mut [F], u: &mut [F]) {
        self.0.fetch_add(1, Ordering::Relaxed);
        pass.at.iter().for_each(|c| u[c] = pass.packed[0]);
    }
}

/// Returns a table: entry `[s][l]` is the smallest number of recomputed segments in a reversal of
/// `l` segments with `s` checkpoints. Uses dynamic programming over the position of the next
/// checkpoint.
fn fewest(most: usize) -> Vec<Vec<u64>> {
    let mut table = vec![vec![0; most + 1]; most + 1];
    for s in 1..=most {
        for l in 2..=most {
            // Without another checkpoint, each segment is recomputed from the beginning.
            let mut best = (l * (l - 1) / 2) as u64;
            if s > 1 {
                best = (1..l)
                    .map(|k| k as u64 + table[s - 1][l - k] + table[s][k])
                    .min()
                    .unwrap()
                    .min(best);
            }
            table[s][l] = best;
        }
    }
    table
}

#[test]
fn binomial_schedules_recompute_the_fewest_steps() {
    let table = fewest(60);
    for (s, row) in table.iter().enumerate().skip(1) {
        for (l, &fewest) in row.iter().enumerate().skip(1) {
            for shorter in [0, 7] {
                let schedule = Schedule::binomial(l * UNIT - shorter, s);
                assert_eq!(
                    schedule.recomputed_steps(),
                    fewest * UNIT as u64,
                    "{l} segments, {s} checkpoints"
                );
            }
        }
    }
    // Griewank and Walther 2000 (doi:10.1145/347837.347846): s checkpoints reverse
    // l = β(s, r) = C(s + r, s) segments with at most r recomputations of each. The total is
    // r l - β(s + 1, r - 1). Here s = 3, r = 9, l = 220.
    let schedule = Schedule::binomial(220 * UNIT, 3);
    assert_eq!(schedule.recomputed_steps(), (9 * 220 - 495) * UNIT as u64);
}

#[test]
fn schedules_recompute_the_stated_number_of_steps() {
    let policy = CallCounter(AtomicU64::new(0));
    let weights = Weights::<f64>::new(&policy, vec![0.0; policy.param_count()]);
    let count = |segments: usize, schedule: &dyn Fn(usize) -> Schedule| {
        let task = CartPole { horizon: segments * UNIT - 3, ..CartPole::new(1) };
        let schedule = schedule(task.horizon);
        let mut rollout = Checkpointed::new(&task, &policy, 1, &[Flow::STOPPED], schedule);
        let mut gradients = [vec![Gradient::zeros(policy.param_count())]];
        let before = policy.0.load(Ordering::Relaxed);
        rollout
            .run(&task, &policy, &weights, &[0.0, 0.0, 0.1, 0.0], 1.0, 1, &mut gradients)
            .expect("finite");
        let steps = policy.0.load(Ordering::Relaxed) - before;
        assert_eq!(steps, task.horizon as u64 + schedule.recomputed_steps(), "{schedule:?}");
    };
    for segments in [1, 2, 3, 4, 7, 10, 21] {
        for checkpoints in [1, 2, 3, 5, 9, 20, 30] {
            count(segments, &|horizon| Schedule::binomial(horizon, checkpoints));
        }
        count(segments, &Schedule::two_level);
        count(segments, &Schedule::store_all);
        count(segments, &|horizon| Schedule::new(horizon, 3 * UNIT, 2));
    }
}

#[test]
fn two_level_segments_have_about_the_square_root_of_the_horizon() {
    let schedule = Schedule::two_level(1_000_000);
    assert_eq!((schedule.segment(), schedule.segments()), (8 * UNIT, 969));
    assert_eq!(schedule.recomputed_steps(), 968 * 8 * UNIT as u64);
    assert_eq!(Schedule::two_level(UNIT), Schedule::store_all(UNIT));
}
