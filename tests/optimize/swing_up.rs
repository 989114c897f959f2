//! Swing-ups of a cart-pole.

use super::linear::by_adjoint;
use super::problems::SwingUp;
use physgrad::initial_states;
use physgrad::optimize::{Initial, Options, Plan, optimize};
use physgrad::rng::Purpose;
use physgrad::tasks::CartPole;

/// Returns the task and its plan. Starts from a sinusoidal push, because zero controls are
/// stationary.
fn swing_up(options: &Options) -> (SwingUp, Plan) {
    let task = SwingUp::new();
    let push: Vec<f64> = (0..task.horizon).map(|t| (0.1 * t as f64).sin()).collect();
    let plan =
        optimize(&task, &SwingUp::START, &[], Initial::Controls(&push), options).expect("finite");
    (task, plan)
}

#[test]
fn cart_pole_swings_up_to_rest_with_and_without_a_bound_of_8_n() {
    for options in [Options::default(), Options::default().bounded(1, 8.0)] {
        let (task, plan) = swing_up(&options);
        let last = plan.state(task.horizon);
        // Deviations of 0.01 (SI units) cost at most 0.008 at the end. A hanging pole costs 200.
        assert!(last[2].cos() > 0.01f64.cos(), "{last:?}");
        assert!([last[0], last[1], last[3]].iter().all(|x| x.abs() < 0.01), "{last:?}");
        assert!(plan.converged(), "{}", plan.stop);
    }
}

#[test]
fn gradient_of_the_adjoint_vanishes_at_the_plan() {
    let (_, plan) = swing_up(&Options::default());
    let gradient = by_adjoint(&SwingUp::new(), &SwingUp::START, &plan.u);
    assert!(plan.gradient_norm() <= 1e-8);
    // The bound is the tolerance 1e-8, plus 1e-8 for the rounding by which both gradients differ.
    assert!(gradient.iter().all(|gradient| gradient.abs() < 2e-8), "{gradient:?}");
}

#[test]
fn cost_decreases_in_every_iteration() {
    let (_, plan) = swing_up(&Options::default());
    assert!(
        plan.iterations() > 5 && plan.costs.windows(2).all(|pair| pair[1] < pair[0]),
        "{:?}",
        plan.costs
    );
    assert_eq!(plan.costs.last(), Some(&plan.cost));
}

/// Solves the task of the paper with one and with two poles, from five initial states each. The
/// task has no control cost.
#[test]
fn cart_pole_task_of_the_paper_reaches_a_cost_below_1e_6() {
    for poles in [1, 2] {
        let task = CartPole::new(poles);
        let starts: Vec<f64> = initial_states(&task, 0, Purpose::Test, 5);
        for x0 in starts.chunks(2 + 2 * poles) {
            let plan =
                optimize(&task, x0, &[], Initial::Zeros, &Options::default()).expect("finite");
            assert!(plan.cost < 1e-6, "{poles} poles: {} ({})", plan.cost, plan.stop);
        }
    }
}
