//! Identities between the four flows, combinations of two gradients, and names of fields.

use approx::assert_relative_eq;
use physgrad::engine::Batch;
use physgrad::policy::{Action, Mlp, Observed};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::tasks::{CartPole, LossMode};
use physgrad::train::{Combination, GradientCombiner};
use physgrad::{Field, Flow, Inputs, Policy, Scalar, Start, System, Task, Weights};
use rand::RngExt;

/// Returns the gradients of R, M, N and S of one mini-batch.
fn all_flows<T: Task, P: Policy>(task: &T, policy: &P) -> [Vec<f64>; 4] {
    let mut rng = stream(3, Purpose::Check, 0);
    let theta = (0..policy.param_count()).map(|_| rng.random_range(-0.5..0.5)).collect();
    let weights = Weights::<f64>::new(policy, theta);
    let mut starts = vec![0.0; 5 * task.system().state_dim()];
    starts
        .chunks_exact_mut(task.system().state_dim())
        .for_each(|x| task.start(&mut rng, Start { x, p: &mut [] }));
    Flow::ALL.map(|flow| {
        let mut batch = Batch::new(task, policy, 5, &[flow], 1);
        batch.run(task, policy, &weights, &starts).expect("finite");
        batch.gradients()[0].to_vec()
    })
}

fn assert_close(a: &[f64], b: &[f64]) {
    let scale = a.iter().fold(0.0, |s: f64, a| s.max(a.abs()));
    assert!(scale > 0.0, "all components are 0, so the comparison proves nothing");
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() <= 1e-13 * scale, "component {i}: {a:e} and {b:e}");
    }
}

fn assert_differ(a: &[f64], b: &[f64]) {
    let scale = a.iter().fold(0.0, |s: f64, a| s.max(a.abs()));
    assert!(
        a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-6 * scale),
        "the vectors agree to 1e-6"
    );
}

/// Policy with one control, `u = θ_0 + sin θ_1`, independent of the state.
struct Blind;

impl Policy for Blind {
    fn observation_dim(&self) -> usize {
        6
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn param_count(&self) -> usize {
        2
    }
    fn init(&self, _: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.3);
    }
    fn act<T: Scalar>(&self, theta: &[T], _: Observed<'_, T>, Action { u, .. }: Action<'_, T>) {
        u[0] = theta[0] + theta[1].sin();
    }
}

/// Memoryless physics: the next state depends on the control only. With two controls, the reverse
/// pass through the policy runs step by step. With one control, one pass linearizes the policy at
/// all steps.
struct Forgetful<const CONTROLS: usize>;

impl<const CONTROLS: usize> System for Forgetful<CONTROLS> {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        CONTROLS
    }
    fn step<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = u[0].sin() + 0.2;
        next[1] = u[CONTROLS - 1] * u[0] - 0.1;
    }
}

impl<const CONTROLS: usize> Task for Forgetful<CONTROLS> {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        7
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, x: &[T]) -> T {
        x[0] * x[1] + u[0] * u[0]
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * x[0] * x[1]
    }
}

fn cart_pole(horizon: usize, loss: LossMode) -> CartPole {
    CartPole { horizon, loss, ..CartPole::new(2) }
}

#[test]
fn all_flows_are_equal_over_one_step() {
    for loss in [LossMode::Terminal, LossMode::Running] {
        let [r, m, n, s] = all_flows(&cart_pole(1, loss), &Mlp::new([6, 8, 1]));
        for other in [m, n, s] {
            assert_close(&r, &other);
        }
    }
}

#[test]
fn all_flows_differ_over_20_steps() {
    let [r, m, n, s] = all_flows(&cart_pole(20, LossMode::Running), &Mlp::new([6, 8, 1]));
    for (a, b) in [(&r, &m), (&r, &n), (&r, &s), (&m, &n), (&m, &s), (&n, &s)] {
        assert_differ(a, b);
    }
}

#[test]
fn if_the_policy_ignores_the_state_r_equals_m_and_n_equals_s() {
    let [r, m, n, s] = all_flows(&cart_pole(20, LossMode::Running), &Blind);
    assert_close(&r, &m);
    assert_close(&n, &s);
    assert_differ(&r, &s);
}

#[test]
fn if_the_physics_ignores_the_state_m_equals_s_and_r_equals_n() {
    let with_one = all_flows(&Forgetful::<1>, &Mlp::new([2, 8, 1]));
    let with_two = all_flows(&Forgetful::<2>, &Mlp::new([2, 8, 2]));
    for [r, m, n, s] in [with_one, with_two] {
        assert_close(&m, &s);
        assert_close(&r, &n);
        assert_differ(&r, &m);
    }
}

#[test]
fn with_a_terminal_loss_s_is_less_than_a_tenth_of_r() {
    let [r, _, _, s] = all_flows(&cart_pole(20, LossMode::Terminal), &Mlp::new([6, 8, 1]));
    let norm = |g: &[f64]| g.iter().map(|g| g * g).sum::<f64>().sqrt();
    assert!(norm(&s) < 0.1 * norm(&r));
}

#[test]
fn sign_agreement_keeps_components_of_equal_sign_and_sets_others_to_0() {
    let combine = |a: &[f64], b: &[f64]| {
        let mut out = vec![f64::NAN; a.len()];
        Combination::SignAgreement.combine(a, b, &mut out);
        out
    };
    let mut rng = stream(4, Purpose::Check, 0);
    let g: Vec<f64> = (0..1000).map(|_| rng.random_range(-1.0..1.0)).collect();
    let h: Vec<f64> = (0..1000).map(|_| rng.random_range(-1.0..1.0)).collect();
    let minus: Vec<f64> = g.iter().map(|g| -g).collect();
    assert_eq!(combine(&g, &g), g);
    assert!(combine(&g, &minus).iter().all(|&c| c == 0.0));
    for ((&c, &m), &r) in combine(&g, &h).iter().zip(&g).zip(&h) {
        assert!(c.abs() <= m.abs());
        assert_eq!(c, if (m > 0.0) == (r > 0.0) { m } else { 0.0 });
    }
    // The result is 0 where either component is 0 or NaN.
    let nan = f64::NAN;
    assert_eq!(
        combine(&[0.0, -0.0, 1.0, 1.0, nan, -2.0], &[1.0, -1.0, 0.0, nan, 1.0, -1e-300]),
        [0.0, 0.0, 0.0, 0.0, 0.0, -2.0]
    );
    assert_eq!(combine(&[1.0, -1.0], &[f64::INFINITY, f64::INFINITY]), [1.0, 0.0]);
}

/// Returns two random vectors and their combination. The components are uniform in -1 .. 1, times
/// the first factor in the first vector and the second factor in the second.
fn combined(by: Combination, [a, b]: [f64; 2]) -> [Vec<f64>; 3] {
    let mut rng = stream(5, Purpose::Check, 0);
    let mut drawn =
        |factor: f64| (0..1000).map(|_| factor * rng.random_range(-1.0..1.0)).collect::<Vec<f64>>();
    let (m, r) = (drawn(a), drawn(b));
    let mut out = vec![f64::NAN; m.len()];
    by.combine(&m, &r, &mut out);
    [m, r, out]
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Bound on the error of sums of 1000 products in any order, relative to the sum of the magnitudes
/// of the products: 1000 roundings.
const SUMS: f64 = 1000.0 * f64::EPSILON;

#[test]
fn projection_of_m_is_orthogonal_to_an_opposed_r_and_m_otherwise() {
    let [m, r, out] = combined(Combination::Projection, [1.0, 3.0]);
    let minus: Vec<f64> = r.iter().map(|r| -r).collect();
    let mut other = vec![f64::NAN; m.len()];
    Combination::Projection.combine(&m, &minus, &mut other);
    let (kept, projected, opposed) =
        if dot(&m, &r) > 0.0 { (out, other, minus) } else { (other, out, r) };
    assert!(kept == m, "M changes although it agrees with R");
    let norms = dot(&m, &m).sqrt() * dot(&opposed, &opposed).sqrt();
    assert!(dot(&m, &opposed) < -0.01 * norms / 1000.0, "the vectors are not opposed");
    assert!(dot(&projected, &opposed).abs() < SUMS * norms);
    // The removed part is parallel to R.
    let removed: Vec<f64> = m.iter().zip(&projected).map(|(m, p)| m - p).collect();
    assert_relative_eq!(
        dot(&removed, &opposed).abs(),
        (dot(&removed, &removed) * dot(&opposed, &opposed)).sqrt(),
        max_relative = 1e-9
    );
}

#[test]
fn the_conflict_free_field_has_equal_angles_to_m_and_r_and_the_norm_of_both_projections() {
    for factors in [[1.0, 1.0], [1.0, 1e6], [1e-3, 2.0], [-1.0, 5.0]] {
        let [m, r, out] = combined(Combination::ConflictFree, factors);
        let cosine = |g: &[f64]| dot(&out, g) / (dot(&out, &out) * dot(g, g)).sqrt();
        assert_relative_eq!(cosine(&m), cosine(&r), max_relative = 1e-9);
        assert!(cosine(&m) > 0.0);
        // ConFIG: the norm is the sum of the projections of both gradients.
        let length = dot(&out, &out).sqrt();
        assert_relative_eq!(length, (dot(&m, &out) + dot(&r, &out)) / length, max_relative = 1e-12);
    }
}

#[test]
fn sizes_come_from_m_and_signs_or_directions_from_r() {
    let [m, r, out] = combined(Combination::SignsOfSecond, [1.0, 1e-200]);
    for ((out, m), r) in out.iter().zip(&m).zip(&r) {
        assert_eq!((out.abs(), *out > 0.0), (m.abs(), *r > 0.0));
    }
    let [m, r, out] = combined(Combination::NormOfFirst, [1.0, 1e100]);
    assert_relative_eq!(dot(&out, &out), dot(&m, &m), max_relative = 1e-12);
    assert_relative_eq!(
        dot(&out, &r),
        (dot(&out, &out) * dot(&r, &r)).sqrt(),
        max_relative = 1e-12
    );
}

#[test]
fn combinations_that_ignore_the_size_of_r_keep_their_bits_for_powers_of_two() {
    for by in Combination::ALL {
        let [_, _, once] = combined(by, [1.0, 1.0]);
        let [_, _, scaled] = combined(by, [1.0, 2.0_f64.powi(300)]);
        assert_eq!(once == scaled, by.ignores_size_of_second(), "{by:?}");
    }
}

#[test]
fn combinations_of_equal_gradients_are_multiples_of_them_and_those_of_zeros_are_finite() {
    let (g, zero) = ([0.5, -2.0], [0.0, 0.0]);
    for by in Combination::ALL {
        let mut out = [f64::NAN; 2];
        by.combine(&g, &g, &mut out);
        // ConFIG adds the norms of both gradients.
        let length = if by == Combination::ConflictFree { 2.0 } else { 1.0 };
        assert_relative_eq!(out.as_slice(), g.map(|g| g * length).as_slice(), max_relative = 1e-15);
        for (a, b) in [(g, zero), (zero, g), (zero, zero)] {
            by.combine(&a, &b, &mut out);
            assert!(out.iter().all(|v| v.is_finite()), "{by:?} of {a:?} and {b:?} is {out:?}");
        }
    }
}

#[test]
fn fields_parse_from_names_and_letters() {
    for field in Field::ALL {
        assert_eq!(field.name().parse(), Ok(field));
        assert_eq!(field.letter().parse(), Ok(field));
    }
    let error = "sideways".parse::<Field>().unwrap_err().to_string();
    assert!(error.contains("sideways") && error.contains("combined"), "{error}");
}
