//! Stress case: adjoints that explode or vanish far beyond the floating-point range.

use super::{Case, Finding};
use physgrad::Field;
use physgrad::Flow;
use physgrad::Gradient;
use physgrad::System;
use physgrad::Task;
use physgrad::engine::Batch;
use physgrad::policy::{Linear, Weights};
use physgrad::rng::Rng;
use physgrad::scalar::ExtendedF64;
use physgrad::{Float, Scalar};
use physgrad::{Inputs, Start};

pub(super) const CASES: &[Case] = &[Case {
    name: "exploding_adjoint",
    about: "system x' = a x + u with u = k x + b over 10,000 steps, in f32 and f64. a and a + k range from -1.5 to 1.5. The \
                loss is (x_T - 1)² / 2",
    criterion: "R, M and C agree with a reference with 32-bit exponents: signs exactly, largest components to 1e-9 \
                (f64) and 1e-2 (f32). A component is 0 only where the reference is 0",
    explanation: "Without exponents, the adjoint of a plant that grows by e per step overflows after 88 steps in f32 \
                and 710 in f64. The gradient is then NaN or clipped to an arbitrary value, and C, which compares the \
                signs of M and R, is silently 0. Here λ and h of each sample carry a power of two, as does the \
                gradient. Signs of R are as accurate as the trajectory at any horizon. Clipping by norm accepts any \
                exponent. Ordinary values keep their bits. Limits: numbers of one sample share an exponent, so of two \
                decoupled states the one whose adjoint is 1e38 times smaller (f32) is lost. A state that underflows \
                is 0 before the reverse pass",
    run: exploding_adjoint,
}];

const HORIZON: usize = 10_000;

/// `x_{t+1} = a x_t + u_t`.
struct Plant {
    a: f64,
    start: f64,
}

impl System for Plant {
    fn state_dim(&self) -> usize {
        1
    }
    fn control_dim(&self) -> usize {
        1
    }
    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = T::from(self.a) * x[0] + u[0];
    }
}

impl Task for Plant {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        HORIZON
    }
    fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = self.start;
    }
    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        let miss = x[0] - T::one();
        miss * miss * 0.5
    }
}

/// `[∂L/∂k, ∂L/∂b]` of a flow, with states in the precision of `F` and adjoints with 32-bit
/// exponents.
fn reference<F: Float>(plant: &Plant, gain: f64, flow: Flow) -> [ExtendedF64; 2] {
    let mut states = vec![F::from_f64(plant.start)];
    for t in 0..HORIZON {
        states.push(F::from_f64(plant.a) * states[t] + F::from_f64(gain) * states[t]);
    }
    let factor = plant.a + if flow.control != 0.0 { gain } else { 0.0 };
    let mut lambda = ExtendedF64::from(states[HORIZON].as_() - 1.0);
    let mut sums = [ExtendedF64::default(); 2];
    for t in (0..HORIZON).rev() {
        sums = [sums[0] + lambda * states[t].as_(), sums[1] + lambda];
        lambda = lambda * factor;
    }
    sums
}

fn exploding_adjoint() -> Vec<Finding> {
    // [a, k, x_0]. No state overflows. The adjoint of R or that of M overflows or underflows.
    let plants = [
        [1.5, 0.0, 0.0],
        [1.5, -0.5, 0.5],
        [1.5, -1.0, 0.5],
        [1.5, -3.0, 0.0],
        [0.5, 0.0, 0.5],
        [0.5, 0.5, 0.5],
        [0.5, -1.5, 0.5],
        [0.5, -2.0, 0.0],
    ];
    [of_precision::<f64>(&plants, 1e-9), of_precision::<f32>(&plants, 1e-2)].concat()
}

fn of_precision<F: Float>(plants: &[[f64; 3]], allowed: f64) -> Vec<Finding> {
    let (mut right, mut all) = (0, 0);
    let (mut worst, mut longest) = (0.0_f64, ExtendedF64::default());
    for &[a, gain, start] in plants {
        let plant = Plant { a, start };
        let policy = Linear::with_bias(1, 1);
        let weights = Weights::new(&policy, vec![F::from_f64(gain), F::zero()]);
        let mut batch = Batch::new(&plant, &policy, 1, &Field::combined().flows(), 1);
        if batch.run(&plant, &policy, &weights, &[F::from_f64(start)]).is_err() {
            all += 6;
            continue;
        }
        let mut combined = Gradient::zeros(2);
        Field::combined().combine(batch.gradients(), &mut combined);
        let [m, r] = [Flow::MODIFIED, Flow::REGULAR].map(|flow| reference::<F>(&plant, gain, flow));
        let c = [0, 1]
            .map(|i| if m[i].signum() == r[i].signum() { m[i] } else { ExtendedF64::default() });
        for (found, expected) in
            [(&batch.gradients()[0], m), (&batch.gradients()[1], r), (&combined, c)]
        {
            let sign = |g: f64| if g == 0.0 { 0.0 } else { g.signum() };
            for (&value, expected) in found.values().iter().zip(expected) {
                all += 1;
                right += usize::from(sign(value.as_()) == expected.signum());
            }
            let largest =
                if expected[0].log10() > expected[1].log10() { expected[0] } else { expected[1] };
            let i = usize::from(largest == expected[1]);
            let value = ExtendedF64::new(found.values()[i].as_(), found.exponent());
            if largest != ExtendedF64::default() {
                worst = worst.max((10f64.powf(value.log10() - largest.log10()) - 1.0).abs());
            }
            if largest.log10() > longest.log10() {
                longest = largest;
            }
        }
    }
    vec![
        Finding::all(
            format!("components of R, M and C in {} with the correct sign", F::NAME),
            right,
            all,
        ),
        Finding::at_most(
            format!("relative error of the largest components in {}", F::NAME),
            worst,
            allowed,
        ),
        Finding::info(format!("largest component in {}", F::NAME), longest.to_string()),
    ]
}
