//! Rollouts and adjoints report exactly the bytes they hold, allocate them at construction, and
//! allocate nothing later.

use physgrad::policy::Mlp;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::CartPole;
use physgrad::{Adjoint, Float, Flow, Gradient, Rollout, Weights, initial_states};

/// Returns the result of `work` and the number of bytes it requests.
fn allocated<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let mut result = None;
    let info = allocation_counter::measure(|| result = Some(work()));
    (result.expect("work is done"), info.bytes_total as usize)
}

/// Number of samples: two blocks of eight, and one sample in a third.
const SAMPLES: usize = 17;

fn assert_exact_bytes_and_no_later_allocation<F: Float>() {
    let (task, policy) = (CartPole { horizon: 20, ..CartPole::new(2) }, Mlp::new([6, 16, 16, 1]));
    let weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<F> = initial_states(&task, 0, Purpose::Train, SAMPLES);
    let mut theta_bar = Gradient::zeros(weights.theta().len());

    // The first run of a process detects the processor's features, which allocates.
    let mut first = Rollout::for_evaluation(&task, &policy, SAMPLES);
    first.start(&starts);
    first.run(&task, &policy, &weights).expect("finite");

    let (mut rollout, bytes) = allocated(|| Rollout::<F>::new(&task, &policy, SAMPLES));
    assert_eq!(rollout.stored_bytes(), bytes);
    // Three blocks of lanes: 21 states, 20 controls, one cost.
    let lanes = 3 * 8 * (21 * 6 + 20 + 1);
    let columns = SAMPLES * 20 * (6 + 1);
    assert!(bytes > (lanes + columns) * size_of::<F>(), "the bytes omit the tape of the policy");
    let run = allocated(|| {
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
    });
    assert_eq!(run.1, 0, "a run of a rollout allocates");

    let one = Flow::ALL.map(|flow| vec![flow]);
    for flows in one
        .into_iter()
        .chain([vec![Flow::MODIFIED, Flow::REGULAR], vec![Flow::MODIFIED, Flow::STOPPED]])
    {
        let names: Vec<String> = flows.iter().map(Flow::to_string).collect();
        for norms in [false, true] {
            let (mut adjoint, bytes) = allocated(|| {
                let adjoint = Adjoint::new(&task, &policy, &rollout, &flows);
                if norms { adjoint.keep_norms() } else { adjoint }
            });
            assert_eq!(adjoint.stored_bytes(), bytes, "{names:?}, norms {norms}");
            let run = allocated(|| {
                adjoint.run(&task, &policy, &weights, &rollout, F::one()).expect("finite");
                (0..flows.len()).for_each(|k| {
                    adjoint.param_gradient(
                        k,
                        &policy,
                        &weights,
                        &rollout,
                        0..SAMPLES,
                        &mut theta_bar,
                    )
                });
            });
            assert_eq!(run.1, 0, "{names:?}, norms {norms}: a run of an adjoint allocates");
        }
    }

    let (mut evaluation, bytes) =
        allocated(|| Rollout::<F>::for_evaluation(&task, &policy, SAMPLES));
    assert_eq!(evaluation.stored_bytes(), bytes);
    assert!(5 * bytes < rollout.stored_bytes());
    let run = allocated(|| {
        evaluation.start(&starts);
        evaluation.run(&task, &policy, &weights).expect("finite");
    });
    assert_eq!(run.1, 0, "a run of an evaluation allocates");
    let longer = CartPole { horizon: 2000, ..task };
    assert_eq!(Rollout::<F>::for_evaluation(&longer, &policy, SAMPLES).stored_bytes(), bytes);
}

#[test]
fn stored_bytes_equal_allocated_bytes_and_runs_allocate_nothing() {
    assert_exact_bytes_and_no_later_allocation::<f64>();
    assert_exact_bytes_and_no_later_allocation::<f32>();
}
