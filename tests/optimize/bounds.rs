//! Bounded controls satisfy the conditions of Karush, Kuhn and Tucker (KKT).

use super::linear::by_adjoint;
use super::problems::{Coupled, Pendulum, Saturating};
use physgrad::actuator::{AnyActuator, Delay, Limit, LimitKind};
use physgrad::optimize::{Initial, Options, Plan, optimize};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{CartPole, Guidance, Lqr, Upright};
use physgrad::{DynTask, Inputs, Scalar, Start, System, Task};
use rand::RngExt;
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
            assert!(
                gradient > -tolerance,
                "the gradient of u[{i}] at its lower bound is negative: {gradient}"
            );
            counts[0] += 1;
        } else if u == high {
            assert!(
                gradient < tolerance,
                "the gradient of u[{i}] at its upper bound is positive: {gradient}"
            );
            counts[2] += 1;
        } else {
            assert!(
                gradient.abs() < tolerance,
                "the gradient of u[{i}] = {u} between its bounds is {gradient}, not 0"
            );
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
    let options =
        Options { gradient_tolerance: 1e-9, bounds: Some(bounds.to_vec()), ..Options::default() };
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
        let options = Options {
            gradient_tolerance: 1e-11,
            bounds: Some(bounds.clone()),
            ..Options::default()
        };
        let plan =
            optimize(&Coupled, &[0.9, -1.3], &[0.8], Initial::Zeros, &options).expect("finite");
        assert!(plan.gradient_norm() <= 1e-11, "{bounds:?}: {}", plan.stop);
        let [low, free, high] =
            kkt(&plan, &bounds, &by_adjoint(&Coupled, &[0.9, -1.3, 0.8], &plan.u), 1e-10);
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
    let plan =
        optimize(&task, &[PI, 0.0], &[], Initial::Controls(&push), &options).expect("finite");
    let last = plan.state(task.horizon);
    // Deviations of 0.01 rad and 0.01 rad/s cost at most 0.006 at the end. Hanging costs 200.
    assert!(last[0].cos() > 0.01f64.cos() && last[1].abs() < 0.01, "{last:?}");
    assert!(plan.converged() && plan.u.iter().all(|u| u.abs() <= limit), "{}", plan.stop);
    kkt(&plan, &[[-limit, limit]], &by_adjoint(&task, &[PI, 0.0], &plan.u), 1e-7);
}

/// One step `x' = u` with the cost `x'ᵀ Q x' / 2 + qᵀ x'`: a quadratic program with bounds.
struct Quadratic {
    /// Q₁₁, Q₁₂, Q₂₂.
    hessian: [f64; 3],
    gradient: [f64; 2],
}

impl Quadratic {
    /// Returns the minimum over candidates, one per set of active bounds.
    fn minimizer(&self, bounds: &[[f64; 2]; 2]) -> [f64; 2] {
        let ([a, b, c], [p, q]) = (self.hessian, self.gradient);
        let determinant = a * c - b * b;
        let mut candidates = vec![[(b * q - c * p) / determinant, (b * p - a * q) / determinant]];
        for (active, &bound) in [0, 0, 1, 1].into_iter().zip(bounds.as_flattened()) {
            let (diagonal, slope) = if active == 0 { (c, q) } else { (a, p) };
            let [low, high] = bounds[1 - active];
            let other = (-(slope + b * bound) / diagonal).clamp(low, high);
            candidates.push(if active == 0 { [bound, other] } else { [other, bound] });
        }
        candidates.retain(|u| u.iter().zip(bounds).all(|(u, [low, high])| low <= u && u <= high));
        let cost = |u: &[f64; 2]| self.terminal_cost(u, &[]);
        candidates
            .into_iter()
            .min_by(|u, v| cost(u).total_cmp(&cost(v)))
            .expect("a candidate at a bound")
    }
}

impl System for Quadratic {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        2
    }
    fn step<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next.copy_from_slice(u);
    }
}

impl Task for Quadratic {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        1
    }
    fn start(&self, _: &mut Rng, _: Start<'_>) {}
    fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
        let ([a, b, c], [p, q]) = (self.hessian, self.gradient);
        (x[0] * x[0] * a + x[1] * x[1] * c) * 0.5 + x[0] * x[1] * b + x[0] * p + x[1] * q
    }
}

/// One iteration solves the quadratic program, with up to two active bounds and a correlation of up
/// to 0.99.
#[test]
fn one_iteration_solves_quadratic_programs_of_two_controls() {
    let mut rng = stream(7, Purpose::Train, 0);
    let mut active = [0; 3];
    for case in 0..300 {
        let mut draw = |low: f64, high: f64| rng.random_range(low..high);
        let (a, c, correlation) = (draw(0.1, 3.0), draw(0.1, 3.0), draw(-0.99, 0.99));
        let task = Quadratic {
            hessian: [a, correlation * (a * c).sqrt(), c],
            gradient: [draw(-2.0, 2.0), draw(-2.0, 2.0)],
        };
        let bounds = [[-draw(0.0, 2.0), draw(0.0, 2.0)], [-draw(0.0, 2.0), draw(0.0, 2.0)]];
        let options =
            Options { max_iterations: 1, bounds: Some(bounds.to_vec()), ..Options::default() };
        let plan = optimize(&task, &[0.0; 2], &[], Initial::Zeros, &options).expect("finite");
        let expected = task.minimizer(&bounds);
        // The condition number is at most 30 · 200. Rounding is far below.
        for (found, expected) in plan.u.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "case {case}: {:?}, not {expected:?}", plan.u);
        }
        active[expected.iter().zip(&bounds).filter(|(u, bounds)| bounds.contains(u)).count()] += 1;
    }
    assert!(active.iter().all(|&count| count > 20), "{active:?}");
}

/// A smooth saturation inside the step, and bounds on the saturated control, have the same infimum.
/// Bounds find it by convex quadratic programs.
#[test]
fn smoothly_saturating_controls_reach_the_optimum_of_bounded_controls() {
    let bounded = Saturating { limit: None };
    let options = Options { gradient_tolerance: 1e-10, ..Options::default().bounded(1, 1.0) };
    let least = optimize(&bounded, &[0.0; 2], &[], Initial::Zeros, &options).expect("finite");
    let counts = kkt(&least, &[[-1.0, 1.0]], &by_adjoint(&bounded, &[0.0; 2], &least.u), 1e-9);
    assert!(counts.iter().all(|&count| count > 0), "{counts:?}");
    let saturating = Saturating { limit: Some(1.0) };
    for start in [0.0, 2.0] {
        let initial = vec![start; saturating.horizon()];
        let plan =
            optimize(&saturating, &[0.0; 2], &[], Initial::Controls(&initial), &Options::default())
                .expect("finite");
        let excess = plan.cost / least.cost - 1.0;
        assert!(
            (-1e-9..1e-6).contains(&excess),
            "start {start}: {} and {}, {}",
            plan.cost,
            least.cost,
            plan.stop
        );
    }
}

/// A task states the controls that it is meant for. An actuator that limits them replaces these.
#[test]
fn tasks_and_actuators_state_bounds_of_the_controls() {
    let bounds = |task: &DynTask| task.control_bounds();
    assert_eq!(bounds(&DynTask::new(Saturating { limit: None })), None);
    assert_eq!(bounds(&DynTask::new(CartPole::new(2))), Some(vec![[-60.0, 60.0]]));
    assert_eq!(bounds(&DynTask::new(Upright::double_pendulum())), Some(vec![[-30.0, 30.0]]));
    let two_controls = DynTask::new(Guidance::new(1, 1));
    assert_eq!(bounds(&two_controls), Some(vec![[-5.0, 5.0]; 2]));
    let delay = AnyActuator::Delay(Delay { steps: 1 });
    let limit = AnyActuator::Limit(Limit { bound: 7.0, kind: LimitKind::Hard });
    for (chain, expected) in [(vec![delay], 5.0), (vec![delay, limit], 7.0)] {
        let system = two_controls.system().clone();
        let adapted = two_controls.clone().adapted(system, 1, chain, 3);
        assert_eq!(bounds(&adapted), Some(vec![[-expected, expected]; 2]));
    }
}
