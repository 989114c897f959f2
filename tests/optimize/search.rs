//! Initial controls, warm starts, and costs that never increase.

use super::problems::{Explosive, SwingUp};
use physgrad::optimize::{Initial, Options, Stop, optimize};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{CartPole, LossMode};
use physgrad::{Inputs, Real, Scalar, Start, System, Task};
use rand::RngExt;

#[test]
fn cost_never_exceeds_that_of_the_initial_controls() {
    let mut rng = stream(5, Purpose::Train, 0);
    let (cart, explosive) = (CartPole { loss: LossMode::Running, ..CartPole::new(2) }, Explosive);
    for case in 0..20 {
        let mut draw = |count: usize, size: f64| {
            (0..count).map(|_| rng.random_range(-size..size)).collect::<Vec<f64>>()
        };
        let options = Options { max_iterations: case, ..Options::default() };
        let (x0, u) = (draw(6, 3.0), draw(100, 30.0));
        let plan = optimize(&cart, &x0, &[], Initial::Controls(&u), &options).expect("finite");
        let start = optimize(
            &cart,
            &x0,
            &[],
            Initial::Controls(&u),
            &Options { max_iterations: 0, ..options.clone() },
        );
        assert_eq!(plan.costs[0], start.expect("finite").cost);
        assert!(
            plan.cost <= plan.costs[0] && plan.costs.is_sorted_by(|a, b| a >= b),
            "case {case}: {:?}",
            plan.costs
        );
        assert!(plan.iterations() <= case);
        let plan = optimize(&explosive, &[0.3], &[], Initial::Controls(&draw(20, 0.5)), &options)
            .expect("finite");
        assert!(plan.cost <= plan.costs[0] && plan.x.iter().all(|x| x.is_finite()), "case {case}");
    }
}

#[test]
fn rollout_of_the_planned_controls_has_the_states_and_cost_of_the_plan() {
    let (task, u) = (SwingUp::new(), vec![0.3; 100]);
    let plan = optimize(&task, &SwingUp::START, &[], Initial::Controls(&u), &Options::default())
        .expect("finite");
    let again = Options { max_iterations: 0, ..Options::default() };
    let again =
        optimize(&task, &SwingUp::START, &[], Initial::Controls(&plan.u), &again).expect("finite");
    assert_eq!((again.x, again.cost), (plan.x, plan.cost));
}

#[test]
fn warm_start_from_a_plan_needs_fewer_iterations() {
    let (task, push) = (SwingUp::new(), vec![0.3; 100]);
    let options = Options::default();
    let cold =
        optimize(&task, &SwingUp::START, &[], Initial::Controls(&push), &options).expect("finite");
    // The new initial state differs by 0.02 m and 0.02 rad.
    let x0 = [0.02, 0.0, SwingUp::START[2] + 0.02, 0.0];
    let from_push = optimize(&task, &x0, &[], Initial::Controls(&push), &options).expect("finite");
    let from_plan =
        optimize(&task, &x0, &[], Initial::Controls(&cold.u), &options).expect("finite");
    let feedback = |t: usize, x: &[f64], u: &mut [f64]| cold.feedback(t, x, u);
    let from_gains =
        optimize(&task, &x0, &[], Initial::Feedback(&feedback), &options).expect("finite");
    assert!(from_plan.converged() && from_gains.converged());
    assert!(
        from_plan.iterations() < from_push.iterations(),
        "{}, {}",
        from_plan.iterations(),
        from_push.iterations()
    );
    assert!(from_gains.costs[0] < from_plan.costs[0], "gains do not reduce the initial cost");
    // An optimization that starts from its own result ends before the first iteration.
    let again = optimize(&task, &SwingUp::START, &[], Initial::Controls(&cold.u), &options)
        .expect("finite");
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
        let plan =
            optimize(&Quartic, &x0, &[], Initial::Zeros, &Options::default()).expect("finite");
        assert_eq!(plan.stop, Stop::Gradient, "{x0:?}");
        assert!(plan.cost < 1e-6, "{x0:?}: {}", plan.cost);
    }
}

/// The pole hangs at rest. The gradient is 0 up to rounding, although the cost is not minimal.
#[test]
fn optimization_ends_at_a_stationary_start() {
    let plan =
        optimize(&CartPole::new(1), &SwingUp::START, &[], Initial::Zeros, &Options::default())
            .expect("finite");
    assert_eq!((plan.iterations(), plan.stop), (0, Stop::Gradient));
}

/// `x' = x + u` in one step, with the cost `√(1 + x'²)`.
struct Root;

impl System for Root {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + u[0];
    }
}

impl Task for Root {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        1
    }
    fn start(&self, _: &mut Rng, _: Start<'_>) {}
    fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
        (x[0] * x[0] + 1.0).sqrt()
    }
}

/// A Newton step from x leads to -x³. The quadratic model predicts a decrease of `x² √(1 + x²) / 2`.
/// The actual decrease is 0.120 of it at x = 0.94, and 0.080 at x = 0.96. A step needs 0.1, so the
/// second search halves its step.
#[test]
fn a_step_needs_a_tenth_of_the_decrease_of_the_quadratic_model() {
    for (x, size) in [(0.94_f64, 1.0), (0.96, 0.5)] {
        let full = -x.powi(3);
        let decrease = (1.0 + x * x).sqrt() - (1.0 + full * full).sqrt();
        assert_eq!(decrease >= 0.1 * 0.5 * x * x * (1.0 + x * x).sqrt(), size == 1.0);
        let options = Options { max_iterations: 1, ..Options::default() };
        let plan = optimize(&Root, &[x], &[], Initial::Zeros, &options).expect("finite");
        let expected = x + size * (full - x);
        assert!((plan.x[1] - expected).abs() < 1e-12, "{x}: {}, not {expected}", plan.x[1]);
        assert_eq!(plan.rollouts, if size == 1.0 { 2 } else { 3 });
    }
}

/// The cost x²/2 with a gradient of the wrong sign: every step increases the cost.
#[test]
fn a_search_without_descent_ends_after_a_regularization_of_1e10() {
    struct Wrong;
    impl Task for Wrong {
        type System = Root;
        fn system(&self) -> &Root {
            &Root
        }
        fn horizon(&self) -> usize {
            1
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
            x[0] * x[0] * 0.5
        }
        fn terminal_cost_gradient<R: Real>(
            &self,
            x: &[R],
            _: &[R],
            x_bar: &mut [R],
            _: Option<&mut [R]>,
        ) {
            x_bar[0] -= x[0];
        }
    }
    let plan = optimize(&Wrong, &[1.0], &[], Initial::Zeros, &Options::default()).expect("finite");
    assert_eq!((plan.stop, plan.iterations()), (Stop::NoDescent, 0));
    // 0, then 0.01 times 1, 4, 32, ...: the factors double. Ten step sizes each.
    let (mut values, mut rho, mut factor) = (1, 0.01, 4.0);
    while rho <= 1e10 {
        (values, rho, factor) = (values + 1, rho * factor, factor * 2.0);
    }
    assert_eq!((values, plan.rollouts), (9, 1 + 9 * 10));
}

/// Two controls with the same effect, `x' = x + u₁ + u₂`, and the cost x'²/2. `Q_uu` is a matrix of
/// ones, so the search needs ρ. Its smallest value is 0.01, with `c = ‖b‖² = 1`. The gains
/// `-(Q_uu + 0.01)⁻¹ Q_ux` are -1/2.01.
#[test]
fn gains_of_undetermined_controls_are_those_of_the_least_regularization() {
    struct Twins;
    impl System for Twins {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            2
        }
        fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = x[0] + u[0] + u[1];
        }
    }
    impl Task for Twins {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            1
        }
        fn start(&self, _: &mut Rng, _: Start<'_>) {}
        fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
            x[0] * x[0] * 0.5
        }
    }
    let plan = optimize(&Twins, &[1.0], &[], Initial::Zeros, &Options::default()).expect("finite");
    assert!(plan.converged() && plan.x[1].abs() < 1e-8, "{}: {}", plan.stop, plan.x[1]);
    for gain in plan.gains {
        assert!((gain + 1.0 / 2.01).abs() < 1e-12, "{gain}");
    }
}

/// A tank that a pump fills: x' = x + max(u, 0), cost (x' - 1)².
struct Pump;

impl System for Pump {
    fn state_dim(&self) -> usize {
        1
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] + u[0].max(T::zero());
    }
}

impl Task for Pump {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    fn horizon(&self) -> usize {
        3
    }

    fn start(&self, _: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = 0.0;
    }

    fn running_cost<T: Scalar>(&self, _: Inputs<'_, T>, next: &[T]) -> T {
        (next[0] - T::one()) * (next[0] - T::one())
    }
}

#[test]
fn a_search_that_ends_at_a_kink_or_at_a_steep_slope_has_a_warning() {
    let flat = "the search ended where it began";
    let steep = "the search ended at a gradient above 1e-4 of the cost";
    for (x0, u, low, iterations, expected) in [
        (0.0, 0.0, f64::NEG_INFINITY, 200, Some(flat)),
        (0.0, -2.0, f64::NEG_INFINITY, 200, Some(flat)),
        (0.0, 0.0, 0.0, 200, Some(flat)),
        (0.0, 0.0, 0.01, 200, None),
        (0.0, 0.1, f64::NEG_INFINITY, 0, Some(steep)),
        (0.0, 0.1, f64::NEG_INFINITY, 200, None),
        (1.0, 0.0, f64::NEG_INFINITY, 200, None),
    ] {
        let bounds = Some(vec![[low, f64::INFINITY]]);
        let options = Options { bounds, max_iterations: iterations, ..Options::default() };
        let plan =
            optimize(&Pump, &[x0], &[], Initial::Controls(&[u; 3]), &options).expect("finite");
        let found = plan.warnings();
        let is_expected = match expected {
            Some(text) => matches!(&found[..], [found] if found.starts_with(text)),
            None => found.is_empty() && plan.cost < 0.1,
        };
        assert!(is_expected, "{x0}, {u}, {low}, {iterations}: {found:?}, cost {}", plan.cost);
    }
}

/// At its highest and lowest points, and close by, a pendulum at rest keeps its cost: a search without
/// torque ends where it began.
#[test]
fn a_search_that_ends_at_a_stationary_start_has_a_warning() {
    let task = SwingUp::new();
    for (offset, expected) in [(0.0, true), (1e-7, true), (0.1, false)] {
        let mut x0 = SwingUp::START;
        x0[2] += offset;
        let plan = optimize(&task, &x0, &[], Initial::Zeros, &Options::default()).expect("finite");
        let found = plan.warnings();
        let is_flat = found.iter().any(|text| text.starts_with("the search ended where it began"));
        assert_eq!(is_flat, expected, "{offset}: {found:?}, {:?}, cost {}", plan.costs, plan.cost);
    }
}
