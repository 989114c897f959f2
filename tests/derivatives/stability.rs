//! Multipliers of perturbations by one step.

use physgrad::check::{Stability, stability};
use physgrad::{Inputs, Scalar, System};

/// `x_{t+1} = A x_t`.
struct Linear<const N: usize>([[f64; N]; N]);

impl<const N: usize> System for Linear<N> {
    fn state_dim(&self) -> usize {
        N
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        for (next, row) in next.iter_mut().zip(&self.0) {
            *next = row.iter().zip(x).fold(T::zero(), |sum, (&a, &x)| sum + T::from(a) * x);
        }
    }
}

fn of<const N: usize>(matrix: [[f64; N]; N]) -> Stability {
    stability(&Linear(matrix), Inputs::new(&[0.0; N], &[]))
}

/// A chain of cells, each driven by the one before.
fn cascade<const N: usize>(own: f64, driven: f64) -> [[f64; N]; N] {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            if i == j {
                own
            } else if i == j + 1 {
                driven
            } else {
                0.0
            }
        })
    })
}

fn near_within(found: Stability, expected: f64, tolerance: f64) {
    assert!((found.multiplier - expected).abs() < tolerance, "{found:?}");
}

#[test]
fn spectral_radii_are_correct_for_complex_defective_and_nilpotent_matrices() {
    let near = |found, expected| near_within(found, expected, 1e-7);
    near(of([[0.5, 0.0, 0.0], [0.0, -3.0, 0.0], [0.0, 0.0, 2.0]]), 3.0);
    assert_eq!(of([[0.5, 0.0, 0.0], [0.0, -3.0, 0.0], [0.0, 0.0, 2.0]]).component, 1);
    // Rotation by 1 rad, scaled by 2: complex eigenvalues.
    let (sin, cos) = (2.0 * f64::sin(1.0), 2.0 * f64::cos(1.0));
    near(of([[cos, -sin], [sin, cos]]), 2.0);
    // Strongly non-normal, defective and nilpotent matrices.
    near(of([[0.9, 1e6], [0.0, 0.8]]), 0.9);
    near(of([[1.0, 0.1], [0.0, 1.0]]), 1.0);
    near(of([[0.0, 1.0], [0.0, 0.0]]), 0.0);
    near(of([[0.0]]), 0.0);
    // Cascades of equal cells. The powers underflow to 0 with 30 and 100 cells.
    near_within(of(cascade::<25>(-1.5, 2.5)), 1.5, 1e-6);
    near_within(of(cascade::<30>(-1.5, 2.5)), 1.5, 1e-12);
    near_within(of(cascade::<100>(0.98, 1.0)), 0.98, 1e-12);
    // Powers that underflow before the exponent reaches the number of cells.
    near_within(of(cascade::<65>(1.5, 1e6)), 1.5, 1e-12);
    near_within(of(cascade::<129>(1.5, 2500.0)), 1.5, 1e-12);
    near(of(cascade::<129>(0.0, 2500.0)), 0.0);
    assert_eq!(of(cascade::<30>(-1.5, 2.5)).component, 29);
    assert!(of(cascade::<60>(1.0, 0.01)).is_stable());
    assert!(of([[1.0, 0.1], [0.0, 1.0]]).is_stable() && !of([[1.001]]).is_stable());
    assert!(
        of([[1.0, f64::NAN], [0.0, 1.0]]).multiplier.is_nan() && !of([[f64::INFINITY]]).is_stable()
    );
}

#[test]
fn steps_ring_if_a_multiplier_is_near_minus_1() {
    // Implicit midpoint rule with λ dt = 100: (1 - 50) / (1 + 50), beside a slow motion.
    let fast = -49.0 / 51.0;
    let found = of([[0.99, 0.1], [0.0, fast]]);
    assert!(found.is_stable() && found.rings() && found.lowest_component == 1, "{found:?}");
    assert!(
        (of([[fast]]).lowest - fast).abs() < 1e-7
            && of([[fast]]).to_string().contains("multiplier about -0.961")
    );
    // Half a turn per step, of which only the upper bound of the real part is known.
    let (sin, cos) = f64::sin_cos(3.0);
    assert!(of([[cos, -sin], [sin, cos]]).rings());
    // Decay, a quarter turn per step, growth and an alternation that decays at once.
    for resolved in [
        [[0.2, 0.0], [0.0, 0.9]],
        [[0.0, -1.0], [1.0, 0.0]],
        [[3.5, 0.0], [0.0, 1.0]],
        [[-0.4, 0.0], [0.0, 1.0]],
        // An alternation that grows, as in states of a rollout that diverges.
        [[-3.9, 0.0], [0.0, 1.0]],
        [[-1e150, 0.0], [0.0, 1.0]],
    ] {
        assert!(!of(resolved).rings(), "{resolved:?}: {:?}", of(resolved));
    }
    let diverging = of([[-1e150]]).to_string();
    assert!(diverging.contains("by 1.000e150.") && diverging.len() < 400, "{diverging}");
    // Within 100 steps, 1.0002 per step is a growth by 2 %. The doubling takes ln 2 / ln 1.0002.
    let slow = of([[1.0002]]);
    assert!(!slow.is_stable() && slow.is_stable_within(100) && !slow.is_stable_within(10_000));
    assert!((slow.growth(100) - 1.0002f64.powi(100)).abs() < 1e-6);
    assert!(slow.to_string().contains("a factor of 2 in 3466 steps"), "{slow}");
}

/// `cells` plane rotations by different angles, each multiplied by `factor`, of which the last
/// one also by `last`, then two components with linear growth and one with the multiplier `alone`.
struct Many {
    cells: usize,
    factor: f64,
    last: f64,
    alone: f64,
}

impl System for Many {
    fn state_dim(&self) -> usize {
        2 * self.cells + 3
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        for k in 0..self.cells {
            let (sin, cos) = (0.05 + k as f64 / 80.0).sin_cos();
            let factor = self.factor * if k + 1 == self.cells { self.last } else { 1.0 };
            let (a, b) = (x[2 * k], x[2 * k + 1]);
            next[2 * k] = (a * cos - b * sin) * factor;
            next[2 * k + 1] = (a * sin + b * cos) * factor;
        }
        let n = 2 * self.cells;
        next[n] = x[n] + x[n + 1] * 0.1;
        next[n + 1] = x[n + 1];
        next[n + 2] = x[n + 2] * self.alone;
    }
}

#[test]
fn beyond_200_components_the_power_iteration_finds_the_multipliers() {
    // The last angle is 0.05 + 109 / 80 = 1.41 rad: less than a quarter turn.
    let of = |factor, last, alone| {
        stability(&Many { cells: 110, factor, last, alone }, Inputs::new(&[0.0; 223], &[]))
    };
    let stable = of(1.0, 1.0, 0.5);
    assert!(stable.is_stable() && !stable.rings(), "{stable:?}");
    for (found, multiplier, components) in [
        (of(1.0, 1.02, 0.5), 1.02, 218..220),
        (of(0.9, 1.0, 3.0), 3.0, 222..223),
        (of(1.0, 1.0, -1.2), 1.2, 222..223),
    ] {
        assert!((found.multiplier / multiplier - 1.0).abs() < 2e-3, "{found:?}");
        assert!(components.contains(&found.component), "{found:?}");
    }
    let rings = of(0.9, 1.0, -49.0 / 51.0);
    assert!(rings.is_stable() && rings.rings() && rings.lowest_component == 222, "{rings:?}");
}
