//! Optima of linear plants by Riccati's equation, and exact gradients and Hessians of costs.

use super::problems::{Coupled, SwingUp};
use physgrad::engine::Batch;
use physgrad::optimize::{Initial, Options, Plan, Stop, optimize};
use physgrad::policy::OpenLoop;
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{CartPole, LinearPlant, LossMode, Lqr};
use physgrad::{Flow, System, Task, Weights, initial_states};
use rand::RngExt;

/// Returns a regulator of a random plant with four states and two controls. Q couples the states,
/// and R couples the controls.
fn coupled_plant() -> Lqr {
    let mut rng = stream(3, Purpose::Train, 0);
    let mut draw = |size: f64| -> f64 { rng.random_range(-size..size) };
    let a = (0..16).map(|i| if i % 5 == 0 { 0.9 } else { draw(0.2) }).collect();
    let b = (0..8).map(|_| draw(1.0)).collect();
    let q = (0..16).map(|i| if i % 5 == 0 { 1.0 } else { 0.1 }).collect();
    Lqr::new(LinearPlant::new(4, a, b), q, vec![1.0, 0.4, 0.4, 0.5]).expect("a stabilizable plant")
}

/// Returns a bound on the rounding error of one linear-quadratic solution.
///
/// Each step adds errors of a few ulp per component of the state. The errors are relative to the
/// largest magnitude among 1, the states of the initial rollout, and the controls of the plan. The
/// factor 100 covers the constants.
fn rounding(plan: &Plan, task: &Lqr, x0: &[f64]) -> f64 {
    let initial = optimize(
        task,
        x0,
        &[],
        Initial::Zeros,
        &Options { max_iterations: 0, ..Options::default() },
    );
    let largest = initial
        .expect("finite")
        .x
        .iter()
        .chain(&plan.u)
        .fold(1.0, |largest: f64, x| largest.max(x.abs()));
    100.0 * (task.horizon() * x0.len()) as f64 * f64::EPSILON * largest
}

#[test]
fn one_iteration_reaches_the_optimum_of_riccatis_equation() {
    for task in [Lqr::spring(), Lqr::upright_cart_pole(), coupled_plant()] {
        let (n, m) = (task.system().state_dim(), task.system().control_dim());
        let x0: Vec<f64> = initial_states(&task, 1, Purpose::Test, 1);
        let options = Options { gradient_tolerance: 1e-10, ..Options::default() };
        let plan = optimize(&task, &x0, &[], Initial::Zeros, &options).expect("finite");
        assert_eq!((plan.iterations(), plan.stop, plan.rollouts), (1, Stop::Gradient, 2));
        let (tolerance, gain) = (rounding(&plan, &task, &x0), &task.optimum().gain);
        let mut x = x0.clone();
        for t in 0..task.horizon() {
            let u: Vec<f64> =
                gain.chunks(n).map(|row| row.iter().zip(&x).map(|(k, x)| k * x).sum()).collect();
            for (i, (found, expected)) in plan.control(t).iter().zip(&u).enumerate() {
                assert!(
                    (found - expected).abs() < tolerance,
                    "u[{t}][{i}] = {found}, not {expected}; tolerance {tolerance:e}"
                );
            }
            for (found, expected) in plan.gains[t * m * n..][..m * n].iter().zip(gain) {
                assert!(
                    (found - expected).abs() < tolerance * (1.0 + expected.abs()),
                    "gain {found}, not {expected}"
                );
            }
            let mut next = vec![0.0; n];
            task.system().step(physgrad::Inputs::new(&x, &u), &mut next);
            x = next;
        }
        let least = task.least_loss(&x0);
        assert!((plan.cost - least).abs() < tolerance * (1.0 + least), "{} and {least}", plan.cost);
    }
}

/// Returns the gradient of the cost with respect to the controls, by the adjoint of the library.
///
/// `start` is the initial state, followed by the parameters.
pub fn by_adjoint<T: Task>(task: &T, start: &[f64], u: &[f64]) -> Vec<f64> {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    let policy = OpenLoop::new(task.observation_dim().unwrap_or(n), m, task.horizon());
    let mut batch = Batch::new(task, &policy, 1, &[Flow::REGULAR], 1);
    batch.run(task, &policy, &Weights::new(&policy, u.to_vec()), start).expect("finite");
    batch.gradients()[0].to_vec()
}

/// Returns the largest magnitude of `a - b`, relative to the largest magnitude of `b`.
fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert!(a.len() == b.len() && a.iter().chain(b).all(|x| x.is_finite()), "{a:?}, {b:?}");
    let largest = b.iter().fold(0.0, |largest: f64, b| largest.max(b.abs()));
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest
}

fn compare_gradients<T: Task>(task: &T, start: &[f64]) {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    let u: Vec<f64> = (0..task.horizon() * m).map(|i| (0.7 * i as f64).sin()).collect();
    let options = Options { max_iterations: 0, ..Options::default() };
    let plan =
        optimize(task, &start[..n], &start[n..], Initial::Controls(&u), &options).expect("finite");
    assert_eq!((plan.stop, &plan.u), (Stop::Iterations, &u));
    // Both gradients use the same exact derivatives. Rounding adds about one ulp per step, in at
    // most 100 steps.
    assert!(difference(&plan.gradient, &by_adjoint(task, start, &u)) < 1e-12);
}

#[test]
fn gradients_of_plans_equal_the_adjoint_to_1e_12() {
    let start = |task: &CartPole| initial_states(task, 0, Purpose::Test, 1);
    for loss in [LossMode::Terminal, LossMode::Running] {
        let task = CartPole { loss, ..CartPole::new(2) };
        compare_gradients(&task, &start(&task));
    }
    compare_gradients(&SwingUp::new(), &SwingUp::START);
    compare_gradients(&Coupled, &[0.4, -0.3, 0.8]);
}

/// With linear dynamics, Gauss-Newton steps are Newton steps. A wrong entry of a Hessian would make
/// the convergence linear.
#[test]
fn newton_steps_converge_quadratically() {
    let at = |max_iterations: usize| {
        let options = Options {
            max_iterations,
            gradient_tolerance: 1e-13,
            cost_tolerance: 0.0,
            ..Options::default()
        };
        optimize(&Coupled, &[0.9, -1.3], &[0.8], Initial::Zeros, &options).expect("finite")
    };
    // The decrease of the cost J is below the rounding error ε J if the gradient is below about
    // (ε J)^(1/2) = 5e-8.
    let norms: Vec<f64> = (0..7).map(|k| at(k).gradient_norm()).collect();
    let small = norms.iter().position(|&norm| norm < 1.0).expect("a small gradient");
    for pair in norms[small..].windows(2) {
        assert!(pair[1] < pair[0] * pair[0] + 5e-8, "{norms:?}");
    }
    let gradient = by_adjoint(&Coupled, &[0.9, -1.3, 0.8], &at(7).u);
    assert!(gradient.iter().all(|gradient| gradient.abs() < 5e-8), "{gradient:?}");
}
