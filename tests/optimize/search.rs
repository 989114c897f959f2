//! Initial controls, warm starts, and costs that never increase.

use super::problems::{Explosive, SwingUp};
use physgrad::optimize::{Initial, Options, Stop, optimize};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{CartPole, LossMode};
use physgrad::{Inputs, Scalar, Start, System, Task};
use rand::RngExt;

#[test]
fn cost_never_exceeds_that_of_the_initial_controls() {
    let mut rng = stream(5, Purpose::Train, 0);
    let (cart, explosive) = (CartPole { loss: LossMode::Running, ..CartPole::new(2) }, Explosive);
    for case in 0..20 {
        let mut draw = |count: usize, size: f64| (0..count).map(|_| rng.random_range(-size..size)).collect::<Vec<f64>>();
        let options = Options { max_iterations: case, ..Options::default() };
        let (x0, u) = (draw(6, 3.0), draw(100, 30.0));
        let plan = optimize(&cart, &x0, &[], Initial::Controls(&u), &options).expect("finite");
        let start = optimize(&cart, &x0, &[], Initial::Controls(&u), &Options { max_iterations: 0, ..options.clone() });
        assert_eq!(plan.costs[0], start.expect("finite").cost);
        assert!(plan.cost <= plan.costs[0] && plan.costs.is_sorted_by(|a, b| a >= b), "case {case}: {:?}", plan.costs);
        assert!(plan.iterations() <= case);
        let plan = optimize(&explosive, &[0.3], &[], Initial::Controls(&draw(20, 0.5)), &options).expect("finite");
        assert!(plan.cost <= plan.costs[0] && plan.x.iter().all(|x| x.is_finite()), "case {case}");
    }
}

#[test]
fn rollout_of_the_planned_controls_has_the_states_and_cost_of_the_plan() {
    let (task, u) = (SwingUp::new(), vec![0.3; 100]);
    let plan = optimize(&task, &SwingUp::START, &[], Initial::Controls(&u), &Options::default()).expect("finite");
    let again = Options { max_iterations: 0, ..Options::default() };
    let again = optimize(&task, &SwingUp::START, &[], Initial::Controls(&plan.u), &again).expect("finite");
    assert_eq!((again.x, again.cost), (plan.x, plan.cost));
}

#[test]
fn warm_start_from_a_plan_needs_fewer_iterations() {
    let (task, push) = (SwingUp::new(), vec![0.3; 100]);
    let options = Options::default();
    let cold = optimize(&task, &SwingUp::START, &[], Initial::Controls(&push), &options).expect("finite");
    // The new initial state differs by 0.02 m and 0.02 rad.
    let x0 = [0.02, 0.0, SwingUp::START[2] + 0.02, 0.0];
    let from_push = optimize(&task, &x0, &[], Initial::Controls(&push), &options).expect("finite");
    let from_plan = optimize(&task, &x0, &[], Initial::Controls(&cold.u), &options).expect("finite");
    let feedback = |t: usize, x: &[f64], u: &mut [f64]| cold.feedback(t, x, u);
    let from_gains = optimize(&task, &x0, &[], Initial::Feedback(&feedback), &options).expect("finite");
    assert!(from_plan.converged() && from_gains.converged());
    assert!(from_plan.iterations() < from_push.iterations(), "{}, {}", from_plan.iterations(), from_push.iterations());
    assert!(from_gains.costs[0] < from_plan.costs[0], "gains do not reduce the initial cost");
    // An optimization that starts from its own result ends before the first iteration.
    let again = optimize(&task, &SwingUp::START, &[], Initial::Controls(&cold.u), &options).expect("finite");
    assert_eq!((again.iterations(), again.stop), (0, Stop::Gradient));
}

/// The initial cost is 1e24. Many later costs are below the rounding error of this number.
#[test]
fn a_large_initial_cost_does_not_end_the_search_early() {
    struct Quartic;
    impl System for Quartic {
        fn state_dim(&self) -> usize {
            2
        }
        fn control_dim(&self) -> usize {
            2
        }
        fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
            (next[0], next[1]) = (x[0] + u[0], x[1] + u[1]);
        }
    }
    impl Task for Quartic {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            1
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
            x[0].powi(4) + x[1] * x[1]
        }
    }
    for x0 in [[1e6, 0.0], [0.0, 1e12], [10.0, 1e12]] {
        let plan = optimize(&Quartic, &x0, &[], Initial::Zeros, &Options::default()).expect("finite");
        assert_eq!(plan.stop, Stop::Gradient, "{x0:?}");
        assert!(plan.cost < 1e-6, "{x0:?}: {}", plan.cost);
    }
}

/// The pole hangs at rest. The gradient is 0 up to rounding, although the cost is not minimal.
#[test]
fn optimization_ends_at_a_stationary_start() {
    let plan = optimize(&CartPole::new(1), &SwingUp::START, &[], Initial::Zeros, &Options::default()).expect("finite");
    assert_eq!((plan.iterations(), plan.stop), (0, Stop::Gradient));
}
