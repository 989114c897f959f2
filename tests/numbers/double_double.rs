//! Reference results in double-double agree with f64 where f64 is accurate. They are accurate where
//! f64 has lost all digits.

use num_dual::Dual64;
use physgrad::engine::Batch;
use physgrad::integrator::{ImplicitMidpoint, RungeKutta};
use physgrad::policy::Linear;
use physgrad::rng::{Purpose, stream};
use physgrad::scalar::{DoubleDouble, Dual};
use physgrad::tasks::{
    CartPole, CoupledCartPole, Guidance, GuidanceSystem, Pade, Quantum, QuantumSystem, Strang,
};
use physgrad::{
    Flow, Inputs, Integrated, Policy, Scalar, System, Task, Weights, check, initial_states,
};

/// Compares value and directional derivative of a step between double-double and num-dual.
fn agrees<S: System>(name: &str, system: &S, size: f64) {
    use rand::RngExt;
    let mut rng = stream(5, Purpose::Check, 0);
    let mut draw =
        |len: usize| (0..len).map(|_| size * rng.random_range(-1.0..1.0)).collect::<Vec<f64>>();
    let (n, m) = (system.state_dim(), system.control_dim());
    let (x, u, tx, tu) = (draw(n), draw(m), draw(n), draw(m));
    let fine = |(value, slope): (&f64, &f64)| Dual {
        value: DoubleDouble::from(*value),
        tangents: [DoubleDouble::from(*slope)],
    };
    let dual = |(value, slope): (&f64, &f64)| Dual64::new(*value, *slope);
    let (fx, fu): (Vec<_>, Vec<_>) =
        (x.iter().zip(&tx).map(fine).collect(), u.iter().zip(&tu).map(fine).collect());
    let (dx, du): (Vec<_>, Vec<_>) =
        (x.iter().zip(&tx).map(dual).collect(), u.iter().zip(&tu).map(dual).collect());
    let (mut fine_next, mut dual_next) = (fx.clone(), dx.clone());
    system.step(Inputs::new(&fx, &fu), &mut fine_next);
    system.step(Inputs::new(&dx, &du), &mut dual_next);
    let largest = |numbers: &mut dyn Iterator<Item = f64>| {
        numbers.fold(0.0_f64, |largest, x| largest.max(x.abs()))
    };
    let values = largest(&mut fine_next.iter().map(|x| x.value.to_f64()));
    let slopes = largest(&mut fine_next.iter().map(|x| x.tangents[0].to_f64()));
    for (i, (fine, dual)) in fine_next.iter().zip(&dual_next).enumerate() {
        let slope = dual.eps;
        assert!(
            (fine.value.to_f64() - dual.re).abs() <= 1e-13 * values,
            "{name}: value {i}: {fine:?}, {dual:?}"
        );
        assert!(
            (fine.tangents[0].to_f64() - slope).abs() <= 1e-12 * slopes,
            "{name}: slope {i}: {fine:?}, {dual:?}"
        );
    }
    // Nonzero low words show that the step does not compute in plain f64.
    assert!(fine_next.iter().any(|x| x.value.parts()[1] != 0.0), "{name}");
}

#[test]
fn steps_in_double_double_agree_with_duals_to_rounding() {
    let cart_pole = *CartPole::new(3).system();
    agrees("cart-pole", &cart_pole, 1.0);
    agrees("coupled", &CoupledCartPole(cart_pole), 1.0);
    agrees("guidance", &GuidanceSystem::default().herding(), 1.0);
    agrees("quantum", &QuantumSystem::default(), 1.0);
    agrees("Padé", &Pade(QuantumSystem::default()), 1.0);
    agrees("Strang", &Strang::new(QuantumSystem::default()), 1.0);
    let coupled = physgrad::Forced { system: CoupledCartPole(cart_pole), effects: () };
    agrees("RK4", &Integrated { ode: coupled, integrator: RungeKutta::RK4, dt: 0.05 }, 1.0);
    agrees(
        "midpoint",
        &Integrated { ode: coupled, integrator: ImplicitMidpoint { tolerance: 1e-14 }, dt: 0.01 },
        1.0,
    );
}

/// Compares the reverse pass in f64 with [`check::slope`] in double-double: the loss, and every
/// third component of the gradient of each flow.
fn slopes<T: Task, P: Policy>(name: &str, task: &T, policy: &P, allowed: f64) {
    let starts = initial_states(task, 1, Purpose::Test, 2);
    let weights = Weights::<f64>::init(policy, &mut stream(1, Purpose::Policy, 0));
    for flow in Flow::ALL {
        let mut batch = Batch::new(task, policy, 2, &[flow], 1);
        let loss = batch.run(task, policy, &weights, &starts).expect("finite");
        let gradient = batch.gradients()[0].values();
        let largest = gradient.iter().fold(0.0_f64, |largest, g| largest.max(g.abs()));
        for (i, found) in gradient.iter().enumerate().step_by(3) {
            let [exact_loss, slope] =
                check::slope(task, policy, weights.theta(), &starts, flow, |j| {
                    f64::from(u8::from(i == j))
                });
            assert!(
                (loss - exact_loss).abs() <= 1e-13 * exact_loss.abs(),
                "{name}: {loss} and {exact_loss}"
            );
            assert!(
                (found - slope).abs() <= allowed * largest,
                "{name}, {flow}, {i}: {found:e} and {slope:e}"
            );
        }
    }
}

#[test]
fn gradients_of_every_flow_agree_with_double_double_to_1e_11() {
    slopes("cart-pole", &CartPole { horizon: 30, ..CartPole::new(2) }, &Linear::new(6, 1), 1e-12);
    let guidance = Guidance { horizon: 20, ..Guidance::new(1, 2) };
    let n = guidance.system().state_dim();
    slopes("guidance", &guidance, &Linear::new(n, guidance.system().control_dim()), 1e-12);
    let system = QuantumSystem { grid: 8, ..QuantumSystem::default() };
    let quantum = Quantum { horizon: 20, ..Quantum::with_system(system, 2) };
    slopes("quantum", &quantum, &Linear::new(16, 1), 1e-11);
}

/// Task on the logistic map, which doubles errors of the angle asin √x in each step.
struct Doubling {
    system: Logistic,
}

/// Logistic map x' = 4 x (1 - x). From the initial state x₀, the k-th state is sin²(2^k asin √x₀).
struct Logistic;

impl System for Logistic {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = T::from(4.0) * x[0] * (T::one() - x[0]);
    }
}

impl Task for Doubling {
    type System = Logistic;
    fn system(&self) -> &Logistic {
        &self.system
    }
    fn horizon(&self) -> usize {
        60
    }
    fn start(&self, _rng: &mut physgrad::rng::Rng, start: physgrad::Start<'_>) {
        start.x[0] = 0.3;
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0]
    }
}

#[test]
fn double_double_is_accurate_to_1e_9_where_f64_has_lost_every_digit() {
    let (task, policy) = (Doubling { system: Logistic }, Linear::new(1, 1));
    let [exact, _] = check::slope(&task, &policy, &[0.0], &[0.3], Flow::REGULAR, |_| 0.0);
    // The factor 2^60 amplifies the rounding error of the angle. With 31 digits, the result is
    // accurate to about 1e-13.
    let start = Scalar::sqrt(DoubleDouble::from(0.3));
    let angle = start.atan2(Scalar::sqrt(DoubleDouble::from(1.0) - start * start))
        * DoubleDouble::from(2.0_f64.powi(60));
    let turns = DoubleDouble::from(2.0) * DoubleDouble::PI;
    let sin = (angle - (angle / turns).trunc() * turns).sin_cos().0;
    let closed = (sin * sin).to_f64();
    assert!((exact - closed).abs() < 1e-9, "{exact} and {closed}");
    let mut x = 0.3_f64;
    (0..60).for_each(|_| x = 4.0 * x * (1.0 - x));
    assert!((x - closed).abs() > 1e-3, "f64 is accurate too: {x} and {closed}");
}
