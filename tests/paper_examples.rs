//! Simple tasks of the paper against dual numbers, closed forms and finite differences, and the
//! paper's statements about them.

use approx::assert_relative_eq;
use physgrad::policy::{Constant, Linear, Quadratic};
use physgrad::tasks::{Accumulator, Bowl, Reach};
use physgrad::vector_field::{self, LEARNING_RATE, ROTATION, Rotated, START};
use physgrad::{Field, GradientCombiner, Optimizer, OptimizerKind, check};

#[test]
fn every_derivative() {
    for dim in [1, 2, 5] {
        check::system(&Accumulator { dim });
    }
    check::policy(&Quadratic);
    check::policy(&Constant::new(3, 2));
    check::task(&Reach::default(), &Quadratic);
    check::task(&Reach { horizon: 11, ..Reach::default() }, &Linear::with_bias(1, 1));
    check::task(&Bowl::default(), &Constant::new(2, 2));
}

/// Returns parameters covering figure 1.
fn thetas() -> Vec<[f64; 2]> {
    vector_field::grid(4.0, 12)
}

/// Returns the states of figure 1, and ∂x_4/∂θ by the chain rule along the steps.
fn trajectory([a, b]: [f64; 2]) -> ([f64; 5], [f64; 2]) {
    let (mut x, mut slope) = ([-0.3; 5], [0.0; 2]);
    for t in 0..4 {
        let now = x[t];
        let growth = 1.0 + 2.0 * a * now + b;
        slope = [growth * slope[0] + now * now, growth * slope[1] + now];
        x[t + 1] = now + a * now * now + b * now;
    }
    (x, slope)
}

#[test]
fn regular_is_the_chain_rule_written_out() {
    let samples = vector_field::sample(&Reach::default(), &Quadratic, &Field::regular(), &thetas()).expect("finite");
    for s in samples {
        let (x, slope) = trajectory(s.theta);
        let miss = x[4] - 2.0;
        assert_relative_eq!(s.loss, miss * miss / 2.0, max_relative = 1e-12);
        // Terms of opposite sign may cancel. The tolerance is therefore relative to the norm.
        let scale = miss.abs() * slope[0].hypot(slope[1]);
        for (found, slope) in s.vector.into_iter().zip(slope) {
            assert_relative_eq!(found, miss * slope, epsilon = 1e-12 * scale, max_relative = 1e-11);
        }
    }
}

#[test]
fn regular_is_the_slope_of_the_loss() {
    let loss = |theta| vector_field::sample(&Reach::default(), &Quadratic, &Field::regular(), &[theta]).expect("finite")[0].loss;
    let h = 1e-5;
    for s in vector_field::sample(&Reach::default(), &Quadratic, &Field::regular(), &vector_field::grid(1.5, 5)).expect("finite")
    {
        let [a, b] = s.theta;
        let slopes = [(loss([a + h, b]) - loss([a - h, b])) / (2.0 * h), (loss([a, b + h]) - loss([a, b - h])) / (2.0 * h)];
        for (found, slope) in s.vector.into_iter().zip(slopes) {
            assert_relative_eq!(found, slope, epsilon = 1e-7 * (1.0 + s.norm()));
        }
    }
}

/// In M, all controls receive the same cotangent, since ∂S/∂x = 1.
#[test]
fn modified_is_the_sum_over_the_steps() {
    for s in vector_field::sample(&Reach::default(), &Quadratic, &Field::modified(), &thetas()).expect("finite") {
        let (x, _) = trajectory(s.theta);
        let miss = x[4] - 2.0;
        let sums = [x[..4].iter().map(|x| x * x).sum::<f64>(), x[..4].iter().sum()];
        let scale = miss.abs() * x[..4].iter().map(|x| x.abs()).sum::<f64>();
        for (found, sum) in s.vector.into_iter().zip(sums) {
            assert_relative_eq!(found, miss * sum, epsilon = 1e-12 * scale, max_relative = 1e-11);
        }
        // The first component therefore points towards the target everywhere, and vanishes only
        // there.
        assert!(s.vector[0] * miss >= 0.09 * miss * miss, "{s:?}");
    }
}

/// R, M and C vanish where the target is met. Elsewhere, R may vanish, and C with it, but not M.
#[test]
fn the_fields_have_their_minima_in_common() {
    for theta in thetas() {
        let target = trajectory(theta).0[4];
        let task = Reach { target, ..Reach::default() };
        let scale = vector_field::sample(&Reach { target: target + 1.0, ..task }, &Quadratic, &Field::regular(), &[theta])
            .expect("finite")[0]
            .norm();
        for field in [Field::regular(), Field::modified(), Field::combined()] {
            let s = vector_field::sample(&task, &Quadratic, &field, &[theta]).expect("finite")[0];
            // The rollout may round differently from the test.
            assert!(s.norm() <= 1e-9 * target.abs().max(1.0) * scale.max(1.0), "{field}: {s:?}");
        }
    }
    // For θ₁ = 0, θ₂ = -1, one step maps all states to 0, where R vanishes. M does not.
    let theta = [[0.0, -1.0]];
    let [r, m] = [Field::regular(), Field::modified()]
        .map(|f| vector_field::sample(&Reach::default(), &Quadratic, &f, &theta).expect("finite")[0]);
    assert!(r.norm() < 1e-12 && m.norm() > 0.1 && r.loss == 2.0, "{r:?} {m:?}");
}

#[test]
fn a_rotation_has_the_gradients_zeros_and_the_combination_descends() {
    let (task, policy) = (Bowl::default(), Constant::new(2, 2));
    let at = |field: &Field<Rotated>, thetas: &[[f64; 2]]| vector_field::sample(&task, &policy, field, thetas).expect("finite");
    let [(_, gradient), (_, rotated), (_, combined)] = Rotated::figure();
    for field in [&gradient, &rotated, &combined] {
        assert_eq!(at(field, &[[0.0; 2]])[0].norm(), 0.0);
    }
    let thetas = vector_field::grid(3.0, 16);
    let dot = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
    let mut dropped = 0;
    for ((g, r), c) in at(&gradient, &thetas).into_iter().zip(at(&rotated, &thetas)).zip(at(&combined, &thetas)) {
        assert_relative_eq!(r.norm(), g.norm() * (1.0 + ROTATION * ROTATION).sqrt(), max_relative = 1e-12);
        assert_relative_eq!(dot(r.vector, g.vector), g.norm() * g.norm(), max_relative = 1e-11);
        for i in 0..2 {
            let agrees = r.vector[i] * g.vector[i] > 0.0;
            assert_eq!(c.vector[i], if agrees { r.vector[i] } else { 0.0 });
            dropped += usize::from(!agrees);
        }
        // At least one component agrees, since r·g > 0. The combination therefore descends
        // everywhere except at the minimum.
        assert!(dot(c.vector, g.vector) > 0.0);
    }
    assert!((thetas.len() / 2..=thetas.len()).contains(&dropped), "{dropped} components dropped of {}", 2 * thetas.len());
}

/// Checks the curvature along both axes of the bowl, which is rotated by 30°.
#[test]
fn the_quadratic_has_the_stated_axes() {
    let (sin, cos) = std::f64::consts::FRAC_PI_6.sin_cos();
    let places = [[2.0 * cos, 2.0 * sin], [-2.0 * sin, 2.0 * cos]];
    let samples = vector_field::sample(&Bowl::default(), &Constant::new(2, 2), &Field::regular(), &places).expect("finite");
    for (s, curvature) in samples.iter().zip([1.0, 4.0]) {
        assert_relative_eq!(s.loss, curvature * 2.0, max_relative = 1e-14);
        assert_relative_eq!(s.vector[0], curvature * s.theta[0], max_relative = 1e-14);
        assert_relative_eq!(s.vector[1], curvature * s.theta[1], max_relative = 1e-14);
    }
}

/// From the paper: "The rotational contribution in b) prevents Adam from converging while our
/// combined vector field in c) allows Adam to approach the minimum."
#[test]
fn adam_converges_but_for_the_rotation() {
    let losses = Rotated::figure().map(|(_, field)| {
        let path =
            vector_field::descend(&Bowl::default(), &Constant::new(2, 2), &field, START, LEARNING_RATE, 1500).expect("finite");
        assert_eq!((path.len(), path[0].theta), (1501, START));
        path[1400..].iter().map(|s| s.loss).fold(0.0, f64::max)
    });
    assert!(losses[0] < 1e-20 && losses[1] > 1.0 && losses[2] < 1e-5, "{losses:?}");
}

/// Bounds the worst losses of the last iterations, from initial values in all directions.
#[test]
fn the_combination_arrives_from_most_starts() {
    let [_, (_, rotated), (_, combined)] = Rotated::figure();
    for (rate, arrivals) in [(LEARNING_RATE, 10), (10.0 * LEARNING_RATE, 2)] {
        let mut arrived = 0;
        for i in 0..16 {
            let (sin, cos) = (std::f64::consts::PI / 8.0 * (f64::from(i) + 0.5) + 0.1).sin_cos();
            let [rotation, combination] = [&rotated, &combined].map(|field| {
                let start = [2.0 * cos, 2.0 * sin];
                let path =
                    vector_field::descend(&Bowl::default(), &Constant::new(2, 2), field, start, rate, 3000).expect("finite");
                path[2700..].iter().map(|s| s.loss).fold(0.0, f64::max)
            });
            assert!(rotation > 1.0 && combination < rotation / 10.0, "{rate}, start {i}: {rotation:e} {combination:e}");
            arrived += usize::from(combination < 1e-4);
        }
        // The bounds are below the observed counts: chaos amplifies rounding differences between
        // processors.
        assert!(arrived >= arrivals, "{rate}: {arrived} of 16");
    }
}

/// Checks the documentation of `Rotated` for bowls with a single curvature.
#[test]
fn adam_orbits_where_plain_descent_arrives() {
    for (curvature, rate, strength) in [(1.0, 0.1, 3.0), (5.0, 0.1, 3.0), (1.0, 0.1, 8.0), (1.0, 0.05, 8.0)] {
        let round = Bowl { curvatures: [curvature; 2], ..Bowl::default() };
        let (policy, field) = (Constant::new(2, 2), Rotated::field(strength));
        let path = vector_field::descend(&round, &policy, &field, START, rate, 8000).expect("finite");
        let distance = path[7000..].iter().map(|s| s.theta[0].hypot(s.theta[1])).sum::<f64>() / 1001.0;
        assert_relative_eq!(distance, 2f64.sqrt() * 9.0 * rate * strength, max_relative = 0.15);

        let mut plain = Optimizer::new(OptimizerKind::Sgd, 0.001 / curvature, 2);
        let mut theta = START;
        for _ in 0..20_000 {
            let vector = vector_field::sample(&round, &policy, &field, &[theta]).expect("finite")[0].vector;
            plain.step(&mut theta, &vector);
        }
        assert!(theta[0].hypot(theta[1]) < 1e-7, "{theta:?}");
    }
}

#[test]
fn rotations_are_composed_like_any_other() {
    let mut out = [0.0; 2];
    Rotated { strength: 2.0, combined: false }.combine(&[1.0, -0.5], &[1.0, -0.5], &mut out);
    assert_eq!(out, [2.0, 1.5]);
    Rotated { strength: 2.0, combined: true }.combine(&[1.0, -0.5], &[1.0, -0.5], &mut out);
    assert_eq!(out, [2.0, 0.0]);
}

#[test]
#[should_panic(expected = "two parameters, not 1")]
fn a_plane_has_two_dimensions() {
    let _ = vector_field::sample(&Reach::default(), &Linear::new(1, 1), &Field::regular(), &[[0.0; 2]]);
}
