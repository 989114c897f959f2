//! Bounded controls satisfy the conditions of Karush, Kuhn and Tucker (KKT).

use super::linear::by_adjoint;
use super::problems::{Coupled, Pendulum};
use physgrad::optimize::{Initial, Options, Plan, optimize};
use physgrad::tasks::Lqr;
use std::f64::consts::PI;

/// Checks the KKT conditions at a plan. Between the bounds, the gradient vanishes. At a bound, the
/// negative gradient points outwards. A control whose bounds are equal has no condition.
///
/// Returns the numbers of controls at the lower bound, between the bounds, and at the upper bound.
/// Controls with equal bounds count as at the lower bound.
fn kkt(plan: &Plan, bounds: &[[f64; 2]], gradient: &[f64], tolerance: f64) -> [usize; 3] {
    let mut counts = [0; 3];
    for (i, (&u, &gradient)) in plan.u.iter().zip(gradient).enumerate() {
        let [low, high] = bounds[i % bounds.len()];
        assert!(low <= u && u <= high, "u[{i}] = {u} is outside of [{low}, {high}]");
        if low == high {
            counts[0] += 1;
        } else if u == low {
            assert!(gradient > -tolerance, "the gradient of u[{i}] at its lower bound is negative: {gradient}");
            counts[0] += 1;
        } else if u == high {
            assert!(gradient < tolerance, "the gradient of u[{i}] at its upper bound is positive: {gradient}");
            counts[2] += 1;
        } else {
            assert!(gradient.abs() < tolerance, "the gradient of u[{i}] = {u} between its bounds is {gradient}, not 0");
            counts[1] += 1;
        }
    }
    counts
}

/// The problem is convex. The KKT conditions are therefore sufficient for the global minimum.
#[test]
fn bounded_linear_regulator_satisfies_kkt_conditions() {
    let (task, x0) = (Lqr::spring(), [1.0, 0.0]);
    // Without bounds, the optimal force lies between -0.34 N and 0.40 N.
    let bounds = [[-0.2, 0.3]];
    let options = Options { gradient_tolerance: 1e-9, bounds: Some(bounds.to_vec()), ..Options::default() };
    let plan = optimize(&task, &x0, &[], Initial::Zeros, &options).expect("finite");
    assert!(plan.converged(), "{}", plan.stop);
    let counts = kkt(&plan, &bounds, &by_adjoint(&task, &x0, &plan.u), 1e-8);
    assert!(
        counts.iter().all(|&count| count > 0),
        "controls at the lower bound, between the bounds, at the upper bound: {counts:?}"
    );
    assert!(plan.cost > task.least_loss(&x0));
}

#[test]
fn two_controls_with_different_or_infinite_bounds_satisfy_kkt_conditions() {
    // Bounds of each control, and the least number of controls at a bound.
    for (bounds, active) in [
        (vec![[-0.3, 0.25], [-0.2, 0.1]], 1),
        (vec![[f64::NEG_INFINITY, 0.05], [-0.1, f64::INFINITY]], 1),
        (vec![[f64::NEG_INFINITY, f64::INFINITY], [0.05, 0.05]], 12),
    ] {
        let options = Options { gradient_tolerance: 1e-11, bounds: Some(bounds.clone()), ..Options::default() };
        let plan = optimize(&Coupled, &[0.9, -1.3], &[0.8], Initial::Zeros, &options).expect("finite");
        assert!(plan.gradient_norm() <= 1e-11, "{bounds:?}: {}", plan.stop);
        let [low, free, high] = kkt(&plan, &bounds, &by_adjoint(&Coupled, &[0.9, -1.3, 0.8], &plan.u), 1e-10);
        assert!(
            low + high >= active && free > 0,
            "{bounds:?}: controls at the lower bound, between the bounds, at the upper bound: {low}, {free}, {high}"
        );
        // All gains of a control at a bound are 0. A control between its bounds has a gain other
        // than 0.
        for (i, &u) in plan.u.iter().enumerate() {
            let [low, high] = bounds[i % 2];
            let moves = plan.gains[2 * i..][..2].iter().any(|&gain| gain != 0.0);
            assert_eq!(moves, low < u && u < high, "{bounds:?}: control {i}");
        }
    }
}

/// The limit is about half of the torque that holds the pendulum horizontally. The pendulum
/// therefore swings back and forth.
#[test]
fn half_of_the_holding_torque_swings_up_a_pendulum() {
    let (task, limit) = (Pendulum { dt: 0.05, horizon: 100 }, 5.0);
    let push: Vec<f64> = (0..task.horizon).map(|t| (0.15 * t as f64).sin()).collect();
    let options = Options::default().bounded(1, limit);
    let plan = optimize(&task, &[PI, 0.0], &[], Initial::Controls(&push), &options).expect("finite");
    let last = plan.state(task.horizon);
    // Deviations of 0.01 rad and 0.01 rad/s cost at most 0.006 at the end. Hanging costs 200.
    assert!(last[0].cos() > 0.01f64.cos() && last[1].abs() < 0.01, "{last:?}");
    assert!(plan.converged() && plan.u.iter().all(|u| u.abs() <= limit), "{}", plan.stop);
    kkt(&plan, &[[-limit, limit]], &by_adjoint(&task, &[PI, 0.0], &plan.u), 1e-7);
}
