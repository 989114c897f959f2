//! Derivatives at singular points: powers, lengths, inverse functions, and 0 times infinity. The
//! right values are limits and formulas. Forward and reverse mode agree in every precision.

use physgrad::count::Counted;
use physgrad::engine::Batch;
use physgrad::policy::Linear;
use physgrad::rng::Rng;
use physgrad::scalar::{Dual, Lanes, Single};
use physgrad::{
    Cotangents, Float, Flow, Inputs, Real, Scalar, Start, System, Task, Weights, check,
};

type Function<T> = fn(T, T) -> T;

const INF: f64 = f64::INFINITY;
const NAN: f64 = f64::NAN;

/// Name, point (x, y), derivatives with respect to x and y.
type Row = (&'static str, [f64; 2], [f64; 2]);

/// Functions with the points at which they are checked.
fn table<T: Scalar>() -> Vec<(Row, Function<T>)> {
    let powers: Vec<(Row, Function<T>)> = vec![
        (("|x|^1.5", [0.0, 0.0], [0.0, 0.0]), |x, _| x.abs().powf(1.5)),
        (("|x|^1.5", [-4.0, 0.0], [-3.0, 0.0]), |x, _| x.abs().powf(1.5)),
        // The derivative of |x| at 0 is that from the right.
        (("|x|^1", [0.0, 0.0], [1.0, 0.0]), |x, _| x.abs().powf(1.0)),
        (("|x|^1", [-0.5, 0.0], [-1.0, 0.0]), |x, _| x.abs().powf(1.0)),
        (("x^1", [0.0, 0.0], [1.0, 0.0]), |x, _| x.powf(1.0)),
        (("x^0", [0.0, 0.0], [0.0, 0.0]), |x, _| x.powf(0.0)),
        (("x^2", [-3.0, 0.0], [-6.0, 0.0]), |x, _| x.powf(2.0)),
        (("x^0.5", [0.0, 0.0], [INF, 0.0]), |x, _| x.powf(0.5)),
        (("(x^2)^0.5", [0.0, 0.0], [0.0, 0.0]), |x, _| (x * x).powf(0.5)),
        (("(x^3 + x)^-1", [0.0, 0.0], [-INF, 0.0]), |x, _| (x * x * x + x).powf(-1.0)),
        (("powi 0", [0.0, 0.0], [0.0, 0.0]), |x, _| x.powi(0)),
        (("powi 1", [0.0, 0.0], [1.0, 0.0]), |x, _| x.powi(1)),
        (("powi 3", [0.0, 0.0], [0.0, 0.0]), |x, _| x.powi(3)),
        (("powi 3", [-2.0, 0.0], [12.0, 0.0]), |x, _| x.powi(3)),
        (("powi -2", [2.0, 0.0], [-0.25, 0.0]), |x, _| x.powi(-2)),
        (("powi -1", [0.0, 0.0], [-INF, 0.0]), |x, _| x.powi(-1)),
    ];
    let lengths: Vec<(Row, Function<T>)> = vec![
        (("hypot", [0.0, 0.0], [0.0, 0.0]), |x, y| x.hypot(y)),
        (("hypot", [3.0, -4.0], [0.6, -0.8]), |x, y| x.hypot(y)),
        (("hypot", [0.0, -2.0], [0.0, -1.0]), |x, y| x.hypot(y)),
        (("hypot", [3e-30, 4e-30], [0.6, 0.8]), |x, y| x.hypot(y)),
        (("hypot", [-3e30, 4e30], [-0.6, 0.8]), |x, y| x.hypot(y)),
        (("hypot", [3e-300, 4e-300], [0.6, 0.8]), |x, y| x.hypot(y)),
        (("hypot", [3e300, 4e300], [0.6, 0.8]), |x, y| x.hypot(y)),
        (("hypot of three", [1e-25, 2e-25], [1.0 / 3.0, 4.0 / 3.0]), |x, y| x.hypot(y).hypot(y)),
        (("atan2", [3.0, 4.0], [-0.16, 0.12]), |x, y| y.atan2(x)),
        (("atan2", [3e-30, 4e-30], [-1.6e29, 1.2e29]), |x, y| y.atan2(x)),
        (("atan2", [3e30, 4e30], [-1.6e-31, 1.2e-31]), |x, y| y.atan2(x)),
        (("atan2", [3e-250, 4e-250], [-1.6e249, 1.2e249]), |x, y| y.atan2(x)),
        (("atan2", [3e250, 4e250], [-1.6e-251, 1.2e-251]), |x, y| y.atan2(x)),
        (("atan2", [0.0, 0.0], [NAN, NAN]), |x, y| y.atan2(x)),
        (("atan2 of squares", [0.0, 0.0], [0.0, 0.0]), |x, y| (y * y).atan2(x * x)),
    ];
    let inverses: Vec<(Row, Function<T>)> = vec![
        (("acos", [0.6, 0.0], [-1.25, 0.0]), |x, _| x.acos()),
        (("acos", [1.0, 0.0], [-INF, 0.0]), |x, _| x.acos()),
        (("acos", [-1.0, 0.0], [-INF, 0.0]), |x, _| x.acos()),
        (("asin", [0.6, 0.0], [1.25, 0.0]), |x, _| x.asin()),
        (("asin", [1.0, 0.0], [INF, 0.0]), |x, _| x.asin()),
        // The limits -2 and 1. The chain rule does not determine them, and must not return 0.
        (("acos^2", [1.0, 0.0], [NAN, 0.0]), |x, _| x.acos() * x.acos()),
        (("acos powi 2", [1.0, 0.0], [NAN, 0.0]), |x, _| x.acos().powi(2)),
        (("sqrt^2", [0.0, 0.0], [NAN, 0.0]), |x, _| x.sqrt() * x.sqrt()),
    ];
    let rule: Vec<(Row, Function<T>)> = vec![
        (("sqrt", [0.0, 0.0], [INF, 0.0]), |x, _| x.sqrt()),
        (("sqrt of squares", [0.0, 0.0], [0.0, 0.0]), |x, y| (x * x + y * y).sqrt()),
        (("sqrt of a square, times 0", [0.0, 0.0], [0.0, 0.0]), |x, y| (x * x).sqrt() * y),
        (("sqrt times 0", [0.0, 0.0], [NAN, 0.0]), |x, y| x.sqrt() * y),
        (("sqrt times constant 0", [0.0, 0.0], [NAN, 0.0]), |x, _| x.sqrt() * 0.0),
        (("difference", [0.0, 0.0], [NAN, 1.0]), |x, y| y - x.sqrt() * y),
        (("ln^2 of a square", [1.0, 0.0], [0.0, 0.0]), |x, _| (x * x).ln() * (x * x).ln()),
        (("branch", [0.0, 0.0], [1.0, 0.0]), |x, y| T::select_lt(x, T::one(), x, y.sqrt())),
        (("branch, times 0", [0.0, 0.0], [0.0, 0.0]), |x, y| {
            T::select_lt(x, T::one(), x, y.sqrt()) * y
        }),
        (("quotient by infinity", [0.0, 2.0], [0.0, 0.0]), |x, y| y / (T::one() / x.sqrt())),
        (("1 / infinity", [0.0, 0.0], [0.0, 0.0]), |x, _| T::one() / (T::one() / x.sqrt())),
        (("0 / root", [0.0, 0.0], [NAN, 1.0]), |x, y| y / (x.sqrt() + 1.0)),
        (("detached", [0.0, 0.0], [0.0, 1.0]), |x, y| x.detach().sqrt() + y),
    ];
    [powers, lengths, inverses, rule].into_iter().flatten().collect()
}

/// The functions of the table as systems: `x'_0 = f(x_0, x_1)`, with `N` states.
struct Under<const N: usize>(usize);

impl<const N: usize> System for Under<N> {
    fn state_dim(&self) -> usize {
        N
    }
    fn control_dim(&self) -> usize {
        0
    }
    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        next.fill(T::zero());
        next[0] = table::<T>()[self.0].1(x[0], x[1]);
    }
}

/// Derivatives by the default VJP of `N` inputs, in the last lane. The other lanes hold 1.
fn by_vjp<R: Real, const N: usize>(row: usize, point: [f64; 2]) -> [f64; 2] {
    let (mut x, mut bar) = (vec![R::one(); N], vec![R::zero(); N]);
    let mut x_bar = bar.clone();
    bar[0] = R::one();
    let last = |value: f64| R::from(value).lane(0);
    (0..2).for_each(|i| x[i].set_lane(R::LANES - 1, last(point[i])));
    Under::<N>(row).vjp(
        Inputs::new(&x, &[]),
        &bar,
        Cotangents { x: Some(&mut x_bar), ..Cotangents::default() },
    );
    [0, 1].map(|i| x_bar[i].lane(R::LANES - 1).to_f64())
}

fn by_dual<T: Scalar>(row: usize, point: [f64; 2]) -> [T; 2] {
    let [x, y] = [0, 1].map(|i| Dual::variable(T::from(point[i]), i));
    let found: Dual<T, 2> = table()[row].1(x, y);
    found.tangents
}

#[test]
fn derivatives_at_singular_points_are_right_in_every_mode_and_precision() {
    use num_dual::Dual64;
    let mut wrong = Vec::new();
    for (row, ((name, point, right), _)) in table::<f64>().into_iter().enumerate() {
        let by_num_dual = [0, 1].map(|k| {
            let [x, y] = [0, 1].map(|i| Dual64::new(point[i], if i == k { 1.0 } else { 0.0 }));
            table()[row].1(x, y).eps
        });
        let mut all = vec![
            ("Dual<f64>", f64::EPSILON, by_dual::<f64>(row, point)),
            ("Dual<Counted>", f64::EPSILON, by_dual::<Counted>(row, point).map(|t| t.0)),
            ("forward, f64", f64::EPSILON, by_vjp::<f64, 2>(row, point)),
            ("reverse, f64", f64::EPSILON, by_vjp::<f64, 17>(row, point)),
            ("reverse, Counted", f64::EPSILON, by_vjp::<Counted, 17>(row, point)),
            ("forward, f64 lanes", f64::EPSILON, by_vjp::<Lanes<f64, 8>, 2>(row, point)),
            ("reverse, f64 lanes", f64::EPSILON, by_vjp::<Lanes<f64, 8>, 17>(row, point)),
        ];
        // The arithmetic of num-dual has no rule for a quotient by infinity.
        if !name.contains("infinity") {
            all.push(("Dual64", f64::EPSILON, by_num_dual));
        }
        {
            let fine = by_dual::<physgrad::scalar::DoubleDouble>(row, point).map(|t| t.to_f64());
            all.push(("Dual<DoubleDouble>", f64::EPSILON, fine));
        }
        if point.iter().all(|x| x.abs() < 1e38 && (*x == 0.0 || x.abs() > 1e-38)) {
            let eps = f64::from(f32::EPSILON);
            all.extend([
                (
                    "Dual<f32>",
                    eps,
                    by_dual::<Single<f32>>(row, point).map(|t| f64::from(t.lane(0))),
                ),
                ("forward, f32 lanes", eps, by_vjp::<Lanes<f32, 8>, 2>(row, point)),
                ("reverse, f32 lanes", eps, by_vjp::<Lanes<f32, 8>, 17>(row, point)),
            ]);
        }
        for (mode, eps, found) in all {
            let is_right = |(found, right): (&f64, &f64)| match right.is_finite() {
                // Each formula rounds its argument, slope and products: at most 8 times.
                true => (found - right).abs() <= 8.0 * eps * right.abs(),
                false => found == right || found.is_nan() && right.is_nan(),
            };
            if !found.iter().zip(&right).all(is_right) {
                wrong.push(format!("{name} at {point:?} by {mode}: {found:?}, right {right:?}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn second_derivatives_at_singular_points_are_right() {
    type Second = Dual<Dual<f64, 1>, 1>;
    type Row = (&'static str, f64, f64, fn(Second) -> Second);
    let all: [Row; 20] = [
        ("|x|^1.5", 4.0, 0.375, |x| x.abs().powf(1.5)),
        ("|x|^1.5", 0.0, INF, |x| x.abs().powf(1.5)),
        ("x^2", 0.0, 2.0, |x| x.powf(2.0)),
        ("x^3", 0.0, 0.0, |x| x.powf(3.0)),
        ("x^1", 0.0, 0.0, |x| x.powf(1.0)),
        ("x^0", 0.0, 0.0, |x| x.powf(0.0)),
        ("powi 2", 0.0, 2.0, |x| x.powi(2)),
        ("powi 3", -1.0, -6.0, |x| x.powi(3)),
        ("powi -1", 2.0, 0.25, |x| x.powi(-1)),
        ("hypot with 1", 0.0, 1.0, |x| x.hypot(Second::from(1.0))),
        ("hypot with 1e-170", 0.0, 1e170, |x| x.hypot(Second::from(1e-170))),
        ("hypot with 0", 0.0, 0.0, |x| x.hypot(Second::from(0.0))),
        ("hypot with 0", 3.0, 0.0, |x| x.hypot(Second::from(0.0))),
        ("hypot^2", 0.0, 0.0, |x| x.hypot(x) * x.hypot(x)),
        ("atan2 with 1", 1.0, -0.5, |x| x.atan2(Second::from(1.0))),
        ("acos", 0.6, -1.171875, |x| x.acos()),
        ("asin", 0.6, 1.171875, |x| x.asin()),
        ("sqrt of a square", 0.0, 0.0, |x| (x * x).sqrt()),
        ("sqrt of a square, times the square", 0.0, 0.0, |x| (x * x).sqrt() * (x * x)),
        ("sqrt of a fourth power", 1.0, 2.0, |x| (x * x * x * x).sqrt()),
    ];
    for (name, x, right, f) in all {
        let found = f(Dual { value: Dual::variable(x, 0), tangents: [Dual::constant(1.0)] })
            .tangents[0]
            .tangents[0];
        let near = (found - right).abs() <= 8.0 * f64::EPSILON * f64::abs(right);
        assert!(found == right || near, "{name} at {x}: {found}, right {right}");
    }
}

#[test]
fn powers_and_lengths_have_the_values_of_the_standard_library() {
    let numbers = [0.0, -0.0, 1.0, -3.0, 4.0, 1e-200, 5e-324, 1e200, f64::MAX, INF, NAN];
    for (x, y) in numbers.into_iter().flat_map(|x| numbers.map(|y| (x, y))) {
        for exponent in [0.0, 1.0, 0.5, -1.0, 2.0, 3.0, -2.5] {
            let (found, right) = (Scalar::powf(x, exponent), x.powf(exponent));
            assert!(
                found == right || found.is_nan() && right.is_nan(),
                "{x}^{exponent}: {found}, {right}"
            );
        }
        // Two additions, two squares and a root: at most 2 units in the last place.
        let (found, right) = (Scalar::hypot(x, y), f64::hypot(x, y));
        let near = (found - right).abs() <= 2.0 * f64::EPSILON * right;
        // The length of (∞, NaN) is NaN here: NaN propagates.
        assert!(
            found == right || near || found.is_nan() && (x.is_nan() || y.is_nan()),
            "|({x}, {y})|: {found}, {right}"
        );
    }
}

#[test]
fn powers_in_double_double_have_31_digits() {
    use physgrad::scalar::DoubleDouble;
    for (base, exponent, square) in
        [(2.0, 0.5, 2.0), (3.0, 1.5, 27.0), (10.0, -0.5, 0.1), (2.0, 100.0, 2f64.powi(200))]
    {
        let power = Scalar::powf(DoubleDouble::from(base), exponent);
        let right =
            if square == 0.1 { DoubleDouble::from(1.0) / 10.0 } else { DoubleDouble::from(square) };
        let error = ((power * power - right) / right).to_f64().abs();
        assert!(error <= 1e-28, "{base}^{exponent}: {power:?}, error {error:e}");
    }
    let power =
        |base: f64, exponent: f64| Scalar::powf(DoubleDouble::from(base), exponent).to_f64();
    assert_eq!([power(-2.0, 101.0), power(-2.0, 100.0)], [-(2f64.powi(101)), 2f64.powi(100)]);
    assert_eq!(
        [power(0.0, 0.0), power(0.0, 1.5), power(0.0, -0.5), power(-3.0, 1.0)],
        [1.0, 0.0, INF, -3.0]
    );
    assert!(power(-2.0, 0.5).is_nan());
}

/// A stable plant, `x' = 0.01 x + u`, whose cost is the distance from 0. It comes within 1e-40.
struct Resting;

impl System for Resting {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        2
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        (0..2).for_each(|i| next[i] = x[i] * 0.01 + u[i]);
    }
}

impl Task for Resting {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        30
    }
    fn start(&self, _rng: &mut Rng, start: Start<'_>) {
        start.x.copy_from_slice(&[0.6, 0.8]);
    }
    fn terminal_cost<T: Scalar>(&self, _x: &[T], _p: &[T]) -> T {
        T::zero()
    }
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
        next[0].hypot(next[1])
    }
}

#[test]
fn the_gradient_of_a_plant_that_comes_to_rest_is_right_in_f32() {
    let policy = Linear::new(2, 2);
    let theta = vec![0.0; physgrad::Policy::param_count(&policy)];
    let weights = Weights::<f32>::new(&policy, theta);
    let mut batch = Batch::new(&Resting, &policy, 1, &[Flow::REGULAR], 1);
    batch.run(&Resting, &policy, &weights, &[0.6, 0.8]).expect("finite");
    // The loss is Σ r_t. A gain k of both components changes r_{t+1} by k r_t at once, and later
    // ones by 0.01 per step: dr_t/dk = t 0.01^(t-1).
    let right = (1..=30).map(|t| f64::from(t) * 0.01_f64.powi(t - 1)).sum::<f64>();
    let gradient = batch.gradients()[0].values();
    // θ holds the gains [x → u, y → u]: the diagonal ones are 0 and 3 in either order of storage.
    let found = f64::from(gradient[0]) + f64::from(gradient[3]);
    assert!((found - right).abs() <= 1e-5 * right, "{found}, right {right}");
}

/// A step at whose state 0 a derivative is right (`Some`), wrong or not defined.
struct AtRest(usize);

impl System for AtRest {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let f = match self.0 {
            // Smooth, by its own derivative; a kink; no value at 0.
            0 => x[0].abs().powf(1.5),
            1 => x[0].abs() + x[0].hypot(x[1]),
            2 => T::one() / x[0],
            // Smooth, but NaN by the chain rule.
            _ => (x[0].abs().ln() * 1.5).exp(),
        };
        next[0] = f + u[0];
        next[1] = x[1] * 0.5;
    }
}

#[test]
fn the_check_of_a_system_visits_the_state_0() {
    for correct in 0..3 {
        check::system(&AtRest(correct)).unwrap_or_else(|error| panic!("{correct}: {error}"));
    }
    let error = check::system(&AtRest(3)).expect_err("NaN at rest").to_string();
    assert!(error.starts_with("the derivative of step is not finite at the state 0"), "{error}");
}
