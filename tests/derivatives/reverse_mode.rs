//! Default derivatives of more than 16 inputs, in reverse mode, against dual numbers.

use crate::common::operations::{Operation, compositions, operations};
use physgrad::count::{Counted, Ops};
use physgrad::policy::{Action, Linear, Observed};
use physgrad::rng::Rng;
use physgrad::scalar::{CotangentPack, Dual, Lanes};
use physgrad::{Cotangents, Inputs, Policy, Real, Scalar, Start, System, Task, check};
use rand::RngExt;

/// Number of states: more than the 16 inputs up to which forward mode computes derivatives.
const N: usize = 20;

/// Each pair of neighbouring states under one operation, `x'_i = f(x_i, x_{i+1})`.
struct Pairs {
    /// Index in [`functions`].
    operation: usize,
}

fn functions<T: Scalar>() -> Vec<(&'static str, Operation<T>)> {
    operations().into_iter().chain(compositions()).collect()
}

impl System for Pairs {
    fn state_dim(&self) -> usize {
        N
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        let f = functions::<T>()[self.operation].1;
        (0..N).for_each(|i| next[i] = f(x[i], x[(i + 1) % N]));
    }
}

/// `(∂x'/∂x)ᵀ next_bar` by the default VJP, added to cotangents with the value `initial`.
fn vjp<R: Real>(system: &impl System, x: &[R], next_bar: &[R], initial: R) -> Vec<R> {
    let mut x_bar = vec![initial; x.len()];
    system.vjp(
        Inputs::new(x, &[]),
        next_bar,
        Cotangents { x: Some(&mut x_bar), ..Cotangents::default() },
    );
    x_bar
}

/// Components of `(∂x'/∂x)ᵀ next_bar` by dual numbers with one tangent, and the sums of the
/// magnitudes of their terms.
fn vjp_by_duals(system: &impl System, x: &[f64], next_bar: &[f64]) -> Vec<[f64; 2]> {
    let column = |i: usize| {
        let seed =
            |(k, &x): (usize, &f64)| Dual { value: x, tangents: [if k == i { 1.0 } else { 0.0 }] };
        let x: Vec<Dual<f64, 1>> = x.iter().enumerate().map(seed).collect();
        let mut next = x.clone();
        system.step(Inputs::new(&x, &[]), &mut next);
        let terms = || next.iter().zip(next_bar).map(|(next, bar)| next.tangents[0] * bar);
        [terms().sum(), terms().map(f64::abs).sum()]
    };
    (0..x.len()).map(column).collect()
}

/// Twenty numbers of a list, in a mixed order.
fn mixed(numbers: &[f64], step: usize) -> Vec<f64> {
    (0..N).map(|i| numbers[(i * step + i / numbers.len()) % numbers.len()]).collect()
}

#[test]
fn the_derivative_of_every_function_agrees_with_dual_numbers() {
    let (x, next_bar) = (mixed(&[0.3, 2.5, 1.0, 7e-3, 12.0], 2), mixed(&[0.7, -1.3, 0.2], 1));
    for (operation, (name, _)) in functions::<f64>().into_iter().enumerate() {
        let system = Pairs { operation };
        let found = vjp(&system, &x, &next_bar, -0.0);
        for (i, (found, [expected, size])) in
            found.into_iter().zip(vjp_by_duals(&system, &x, &next_bar)).enumerate()
        {
            // Slopes and products are rounded a few times each. Operations that cancel, such as
            // 1 - tanh², and compositions amplify the rounding by less than 20.
            assert!(
                (found - expected).abs() <= 40.0 * f64::EPSILON * (1.0 + size),
                "{name} {i}: {found} for {expected}"
            );
        }
    }
}

#[test]
fn derivatives_at_zeros_and_infinities_agree_where_dual_numbers_are_finite() {
    let x = mixed(&[0.0, -0.0, 1.0, -1.0, 0.3, -2.7, 1e7, f64::INFINITY, f64::NAN], 4);
    let next_bar = mixed(&[0.7, 0.0, -1.3], 1);
    for (operation, (name, _)) in functions::<f64>().into_iter().enumerate() {
        let system = Pairs { operation };
        let found = vjp(&system, &x, &next_bar, -0.0);
        for (i, (found, [expected, _])) in
            found.into_iter().zip(vjp_by_duals(&system, &x, &next_bar)).enumerate()
        {
            if expected.is_finite() {
                assert!(
                    (found - expected).abs() <= 40.0 * f64::EPSILON * expected.abs(),
                    "{name} {i}: {found} for {expected}"
                );
            }
        }
    }
}

#[test]
fn every_lane_has_the_bits_of_a_scalar() {
    let (x, next_bar) =
        (mixed(&[0.0, -0.5, 1.0, 3.25, -1e-3, 7e6, f64::NAN], 3), mixed(&[0.7, 0.0, -1.3], 1));
    let shifted = |values: &[f64], lane: usize| -> Vec<f64> {
        (0..N).map(|i| values[(i + 5 * lane) % N]).collect()
    };
    let packed = |values: &[f64]| -> Vec<Lanes<f64, 8>> {
        let lanes: [Vec<f64>; 8] = std::array::from_fn(|lane| shifted(values, lane));
        (0..N).map(|i| Lanes(std::array::from_fn(|lane| lanes[lane][i]))).collect()
    };
    for (operation, (name, _)) in functions::<f64>().into_iter().enumerate() {
        let system = Pairs { operation };
        let all = vjp(&system, &packed(&x), &packed(&next_bar), Lanes([-0.0; 8]));
        for lane in 0..8 {
            let one = vjp(&system, &shifted(&x, lane), &shifted(&next_bar, lane), -0.0);
            for (all, one) in all.iter().zip(one) {
                let all = all.lane(lane);
                assert!(
                    all.to_bits() == one.to_bits() || all.is_nan() && one.is_nan(),
                    "{name}, lane {lane}: {all}, {one}"
                );
            }
        }
    }
}

/// Copies of states, a detached number, the norm of two states, and a selection.
struct Paths;

impl System for Paths {
    fn state_dim(&self) -> usize {
        N
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        next.fill(T::from(1.0));
        next[0] = x[0];
        next[1] = x[1] + x[2].detach() * 3.0;
        next[2] = (x[3] * x[3] + x[4] * x[4]).sqrt();
        next[3] = T::select_lt(x[5], T::zero(), x[5].sqrt(), x[5]);
    }
}

#[test]
fn zero_cotangents_constants_and_detached_numbers_contribute_nothing() {
    let mut next_bar = vec![2.0; N];
    next_bar[0] = -0.0;
    // At the zero vector, the square root has an infinite slope and the squares have slope 0. Their
    // product counts as 0. The branch that is not selected contributes nothing.
    let mut x = vec![0.0; N];
    x[5] = 0.5;
    let found = vjp(&Paths, &x, &next_bar, -0.0);
    let mut expected = [-0.0; N];
    (expected[1], expected[5]) = (2.0, 2.0);
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&found[..3]), bits(&expected[..3]));
    assert_eq!(found, expected);
    assert_eq!(
        bits(&found[6..]),
        bits(&expected[6..]),
        "an input without a path has a changed cotangent"
    );
    x[3] = f64::NAN;
    assert!(vjp(&Paths, &x, &next_bar, 0.0)[3].is_nan());
}

/// Operations of a step, and of its default VJP for one and for two columns of cotangents.
fn counts(system: &impl System) -> [Ops; 3] {
    let x = vec![Counted(0.5); N];
    let mut next = x.clone();
    let two = CotangentPack([Counted(1.0); 2]);
    let (next_bars, mut x_bars) = (vec![two; N], vec![two; N]);
    [
        Ops::of(|| system.step(Inputs::new(&x, &[]), &mut next)).0,
        Ops::of(|| vjp(system, &x, &x, Counted(0.0))).0,
        Ops::of(|| {
            let cotangents = Cotangents { x: Some(&mut x_bars), ..Cotangents::default() };
            system.vjp(Inputs::new(&x, &[]), &next_bars, cotangents);
        })
        .0,
    ]
}

#[test]
fn operation_counts_are_those_of_values_slopes_and_cotangents() {
    let none = Ops::default();
    let n = N as u64;
    for (operation, (name, _)) in functions::<f64>().into_iter().enumerate() {
        // Operations per output: the step, the slopes, and the products with one column of
        // cotangents.
        let (step, slopes, cotangents) = match name {
            "add" => (Ops { add: 1, ..none }, none, Ops { add: 2, ..none }),
            "sub" => (Ops { add: 1, ..none }, none, Ops { add: 2, ..none }),
            "add_f64" => (Ops { add: 1, ..none }, none, none),
            "mul" => (Ops { multiply: 1, ..none }, none, Ops { multiply: 2, add: 2, ..none }),
            "mul_f64" => (Ops { multiply: 1, ..none }, none, Ops { multiply: 1, add: 1, ..none }),
            // 1 - t².
            "tanh" => (
                Ops { transcendental: 1, ..none },
                Ops { multiply: 1, add: 1, ..none },
                Ops { multiply: 1, add: 1, ..none },
            ),
            // 1/b and -(q/b).
            "div" => (
                Ops { divide: 1, ..none },
                Ops { divide: 1, multiply: 1, negate: 1, ..none },
                Ops { multiply: 2, add: 2, ..none },
            ),
            _ => continue,
        };
        let times = |ops: Ops, factor: u64| (0..factor).fold(none, |sum, _| sum + ops);
        // Each column adds one number per output, and one per input at the end.
        let columns =
            |k: u64| times(step + slopes, n) + times(cotangents + Ops { add: 2, ..none }, k * n);
        assert_eq!(
            counts(&Pairs { operation }),
            [times(step, n), columns(1), columns(2)],
            "{name}"
        );
    }
}

/// Row of masses between two walls, connected by hardening springs. The parameter is the stiffness
/// of the springs. The controls push two of the masses.
struct Chain;

const MASSES: usize = 12;

impl System for Chain {
    fn state_dim(&self) -> usize {
        2 * MASSES
    }
    fn control_dim(&self) -> usize {
        2
    }
    fn param_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, p, t }: Inputs<'_, T>, next: &mut [T]) {
        let (q, v) = x.split_at(MASSES);
        for i in 0..MASSES {
            let left = if i == 0 { q[0] } else { q[i] - q[i - 1] };
            let right = if i + 1 < MASSES { q[i + 1] - q[i] } else { -q[i] };
            let force = (right - left) * p[0] + right * right * right - left * left * left;
            let push = if i < 2 { u[i] * (t as f64 * 0.1).cos() } else { T::zero() };
            next[MASSES + i] = v[i] + (force - v[i] * 0.1 + push) * 0.05;
            next[i] = q[i] + next[MASSES + i] * 0.05;
        }
    }
}

impl Task for Chain {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        9
    }
    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
        p[0] = rng.random_range(0.5..2.0);
    }
    fn observation_dim(&self) -> Option<usize> {
        Some(MASSES)
    }
    fn observe<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, y: &mut [T]) {
        (0..MASSES).for_each(|i| y[i] = x[i].sin() + x[MASSES + i] * p[0]);
    }
    fn running_cost<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let moved: T = next.iter().zip(x).map(|(&next, &x)| (next - x) * next).sum();
        moved * p[0] + (u[0] * u[0] + u[1] * u[1]) * 0.1
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        x.iter().map(|&x| x * x).sum::<T>() / p[0]
    }
}

/// One tanh layer by `act` only, with a memory of one number.
struct Layer {
    inputs: usize,
    outputs: usize,
}

impl Policy for Layer {
    fn observation_dim(&self) -> usize {
        self.inputs
    }
    fn control_dim(&self) -> usize {
        self.outputs
    }
    fn memory_dim(&self) -> usize {
        1
    }
    fn param_count(&self) -> usize {
        self.outputs * (self.inputs + 1)
    }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        theta.fill_with(|| rng.random_range(-0.3..0.3));
    }
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, memory, .. }: Observed<'_, T>,
        action: Action<'_, T>,
    ) {
        for (u, row) in action.u.iter_mut().zip(theta.chunks_exact(self.inputs + 1)) {
            let sum =
                row.iter().zip(y).map(|(&w, &y)| w * y).sum::<T>() + row[self.inputs] * memory[0];
            *u = sum.tanh();
        }
        action.memory[0] = memory[0] * 0.9 + action.u[0];
    }
}

#[test]
fn default_derivatives_of_a_task_with_24_states_are_exact_in_every_flow() {
    check::system(&Chain).unwrap();
    check::task(&Chain, &Linear::new(MASSES, 2)).unwrap();
}

#[test]
fn default_derivatives_of_act_only_policies_are_exact_in_every_flow() {
    check::policy(&Layer { inputs: 5, outputs: 3 }).unwrap();
    check::policy(&Layer { inputs: 20, outputs: 2 }).unwrap();
    check::task(&Chain, &Layer { inputs: MASSES, outputs: 2 }).unwrap();
}
