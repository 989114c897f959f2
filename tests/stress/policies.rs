//! Stress case: saturated policies and very large angles.

use super::{Case, Finding};
use physgrad::Float;
use physgrad::check;
use physgrad::policy::{Mlp, Policy, PolicyColumns, PolicyPass, Weights};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::CartPoleSystem;
use rand::RngExt;

pub(super) const CASES: &[Case] = &[Case {
    name: "saturated_policy",
    about: "policy inputs of 1e6, weights times 1e3, angles of 1e6 rad",
    criterion: "all values are finite. A saturated tanh has a derivative of exactly 0. Dual numbers and VJP agree to \
                1e-12",
    explanation: "Saturated layers give 0/0 or ∞ - ∞ where tanh is computed from exponentials, and sines of large \
                angles lose all digits under careless range reduction. Limits: beyond 1e6 rad, sine and cosine come \
                from the standard library, which takes longer",
    run: saturated_policy,
}];

fn saturated_policy() -> Vec<Finding> {
    let system = CartPoleSystem { poles: 2, ..CartPoleSystem::default() };
    let checked = check::system_at(&system, |rng, x, u, _| {
        x.iter_mut().for_each(|x| *x = rng.random_range(-1.0..1.0));
        (0..2).for_each(|pole| x[2 + 2 * pole] *= 1e6);
        u[0] = rng.random_range(-1.0..1.0);
    });
    let (worst, mismatch) = checked
        .map_or_else(|wrong| (f64::INFINITY, wrong.to_string()), |p| (p.worst, String::new()));
    let mut findings = vec![Finding::at_most(
        format!("cart-pole at angles of 1e6 rad, VJP against dual numbers{mismatch}"),
        worst,
        1e-12,
    )];
    findings.extend(saturated::<f32>());
    findings.extend(saturated::<f64>());
    findings
}

/// Batched passes of a policy with very large inputs or weights.
fn saturated<F: Float>() -> [Finding; 2] {
    let policy = Mlp::new([4, 32, 32, 1]);
    let (columns, x) = (8, [1e6, -2e6, 3e6, 1.5e6]);
    let mut saturated = true;
    let mut finite = true;
    for (of_weights, of_inputs) in [(1.0, 1.0), (1e3, 1e-6)] {
        let mut weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Check, 0));
        weights
            .update(&policy, |theta| theta.iter_mut().for_each(|t| *t *= F::from_f64(of_weights)));
        let x: Vec<F> = (0..columns)
            .flat_map(|c| x.map(|x| F::from_f64(x * of_inputs * (1.0 + 0.1 * c as f64))))
            .collect();
        let sizes = policy.sizes::<F>(columns);
        let zeros = |len: usize| vec![F::zero(); len];
        let (mut tape, mut u, mut tape_bar) =
            (zeros(sizes.tape), zeros(columns), zeros(sizes.tape_bar));
        let mut x_bar = vec![F::from_f64(f64::NAN); 4 * columns];
        let pass = PolicyPass::new(weights.packed(), PolicyColumns::range(0..columns), &x);
        policy.forward(pass, &mut tape, &mut u);
        policy.backward(pass, &tape, &vec![F::one(); columns], &mut tape_bar, Some(&mut x_bar));
        finite &= u.iter().chain(&x_bar).all(|x| x.as_().is_finite());
        // With inputs of 1e6, all units of the first layer saturate. With large weights, a few
        // units of the second layer may stay linear.
        saturated &= of_inputs < 1.0 || x_bar.iter().all(|&x_bar| x_bar == F::zero());
    }
    [
        Finding::holds(
            format!("controls and derivatives in {}", F::NAME),
            "finite",
            finite,
            if finite { "finite" } else { "non-finite" },
        ),
        Finding::holds(
            format!("∂N/∂x at inputs of 1e6 in {}", F::NAME),
            "exactly 0",
            saturated,
            if saturated { "exactly 0" } else { "not 0" },
        ),
    ]
}
