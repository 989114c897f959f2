//! Measurements of `docs/optimize.md`: comparison with Adam, and tasks without control cost.

use super::problems::SwingUp;
use physgrad::optimize::{Initial, Options, optimize};
use physgrad::policy::OpenLoop;
use physgrad::rng::Purpose;
use physgrad::tasks::{CartPole, LossMode};
use physgrad::{Adjoint, Flow, Gradient, Optimizer, Rollout, Weights, initial_states};
use std::time::Instant;

/// Largest number of updates of Adam.
const UPDATES: usize = 30_000;

/// Trains the controls of an [`OpenLoop`] policy by Adam, from the initial controls `push`.
///
/// Prints the lowest cost, and the numbers of updates and seconds until the cost is below 100, 2,
/// 1.1 and 1.01 times `least`.
fn adam(task: &SwingUp, push: &[f64], learning_rate: f64, least: f64) {
    let policy = OpenLoop::new(4, 1, task.horizon);
    let mut weights = Weights::<f64>::new(&policy, push.to_vec());
    let mut rollout = Rollout::new(task, &policy, 1);
    let mut adjoint = Adjoint::new(task, &policy, &rollout, &[Flow::REGULAR]);
    let (mut gradient, mut optimizer) =
        (Gradient::zeros(push.len()), Optimizer::adam(learning_rate, push.len()));
    let (begin, mut best, mut reached) = (Instant::now(), f64::INFINITY, Vec::new());
    let mut factors = vec![1.01, 1.1, 2.0, 100.0];
    rollout.start(&SwingUp::START);
    for update in 0..UPDATES {
        rollout.run(task, &policy, &weights).expect("finite");
        best = best.min(rollout.cost(0));
        while factors.last().is_some_and(|factor| best < factor * least) {
            reached.push((factors.pop().expect("a factor"), update, begin.elapsed().as_secs_f64()));
        }
        if factors.is_empty() {
            break;
        }
        adjoint.run(task, &policy, &weights, &rollout, 1.0).expect("finite");
        adjoint.param_gradient(0, &policy, &weights, &rollout, 0..1, &mut gradient);
        weights.update(&policy, |theta| optimizer.step(theta, &gradient));
    }
    let seconds = begin.elapsed().as_secs_f64();
    println!(
        "Adam, rate {learning_rate}: best cost {best:.6}, {seconds:.3} s; (factor, updates, s): {reached:.3?}"
    );
}

#[test]
#[ignore = "a comparison that takes about a minute and checks nothing"]
fn costs_and_times_of_optimize_and_adam_are_printed() {
    let task = SwingUp::new();
    let push: Vec<f64> = (0..task.horizon).map(|t| (0.1 * t as f64).sin()).collect();
    for tolerance in [1e-8, 1e-2] {
        let begin = Instant::now();
        let options = Options { gradient_tolerance: tolerance, ..Options::default() };
        let plan = optimize(&task, &SwingUp::START, &[], Initial::Controls(&push), &options)
            .expect("finite");
        let (seconds, cost, norm) =
            (begin.elapsed().as_secs_f64(), plan.cost, plan.gradient_norm());
        println!(
            "optimize, {} iterations, {} rollouts: cost {cost:.6}, gradient {norm:.1e}, {seconds:.3} s",
            plan.iterations(),
            plan.rollouts
        );
        for factor in [100.0, 2.0, 1.1, 1.01] {
            let iteration = plan.costs.iter().position(|&found| found < factor * cost);
            println!("  within a factor of {factor} after {iteration:?} iterations");
        }
    }
    let least =
        optimize(&task, &SwingUp::START, &[], Initial::Controls(&push), &Options::default())
            .expect("finite")
            .cost;
    for learning_rate in [0.01, 0.03, 0.1, 0.3, 1.0] {
        adam(&task, &push, learning_rate, least);
    }
}

#[test]
#[ignore = "measurements that check nothing"]
fn convergence_without_control_cost_is_printed() {
    for (poles, loss) in [1, 2, 3]
        .into_iter()
        .flat_map(|poles| [LossMode::Terminal, LossMode::Running].map(|loss| (poles, loss)))
    {
        let task = CartPole { loss, ..CartPole::new(poles) };
        let starts: Vec<f64> = initial_states(&task, 0, Purpose::Train, 20);
        let run = |x0: &[f64]| {
            optimize(&task, x0, &[], Initial::Zeros, &Options::default()).expect("finite")
        };
        let plans: Vec<_> = starts.chunks(2 + 2 * poles).map(run).collect();
        let mut costs: Vec<f64> = plans.iter().map(|plan| plan.cost).collect();
        costs.sort_by(f64::total_cmp);
        let converged = plans.iter().filter(|plan| plan.converged()).count();
        println!(
            "{poles} poles, {loss:?}: {converged} of 20 converged; cost: median {:.1e}, largest {:.1e}",
            costs[10], costs[19]
        );
    }
}
