//! Linear stability of a time step: spectral radius of its state Jacobian.

use super::normal;
use crate::dynamics::inputs::{Cotangents, Inputs, Tangents};
use crate::dynamics::outline::One;
use crate::dynamics::system::System;
use crate::engine::any::AnySystem;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::{Cotangent, CotangentPack, LANES, Lane, Real, Scalar};
use crate::numbers::text;
use nalgebra::{DMatrix, Matrix3, Vector3};
use std::fmt;

/// Number of squarings of the Jacobian J, which yield `J^(2³⁰)`.
const SQUARINGS: usize = 30;
/// Number of squarings of `J - 1`, whose spectral radius needs few digits.
const FEW_SQUARINGS: usize = 10;
/// Margin above 1 within which a multiplier counts as stable. Linear growth, such as a position
/// under a velocity error, yields `(2³⁰)^(1/2³⁰) ≈ 1 + 2e-8`.
const ROUNDING: f64 = 1e-6;
/// Largest number of state components for which [`stability`] stores the Jacobian. With more, the
/// function evaluates products with the Jacobian only.
pub const DENSE: usize = 200;
/// Largest number of state components for which [`jacobian_norm`] evaluates the Jacobian.
const SMALL: usize = 50;
/// Products of the power iteration before those that it evaluates, and up to the last one.
const ITERATIONS: [usize; 2] = [2048, 8192];
/// Total growth in the evaluated products, as a logarithm, that counts as none: a multiplier of 1 ± 3e-5.
const UNRESOLVED: f64 = 0.25;
/// Growth over a rollout up to which perturbations are harmless, see
/// [`Stability::is_stable_within`] and [`growth_along`].
pub const HARMLESS: f64 = 2.0;
/// Range of [`Stability::lowest`] of a step that rings. The lower bound admits the error of the
/// estimate. Below it, the perturbation grows, and the step is unstable.
const RINGING: std::ops::RangeInclusive<f64> = -1.1..=-0.6;

/// Result of [`stability`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stability {
    /// Spectral radius of the Jacobian ∂S/∂x of the step S: the asymptotic growth factor per step
    /// of the fastest growing perturbation. NaN if the Jacobian is non-finite.
    pub multiplier: f64,
    /// State component in which the fastest growing perturbation is largest. For a NaN multiplier,
    /// the first component with a non-finite derivative.
    pub component: usize,
    /// Real part of the eigenvalue of ∂S/∂x that is farthest from 1, or an upper bound if this
    /// eigenvalue is complex or decays faster than others. NaN if the Jacobian is non-finite.
    pub lowest: f64,
    /// State component in which the perturbation of the eigenvalue `lowest` is largest.
    pub lowest_component: usize,
}

impl Stability {
    /// True if no perturbation grows exponentially, up to rounding. False for NaN.
    pub fn is_stable(&self) -> bool {
        self.multiplier <= 1.0 + ROUNDING
    }

    /// True if perturbations grow at most twofold within so many steps, although they may grow
    /// exponentially. False for NaN.
    pub fn is_stable_within(&self, steps: usize) -> bool {
        self.is_stable() || self.growth(steps) <= HARMLESS
    }

    /// Growth of the fastest growing perturbation over so many steps, if each step multiplies it by
    /// [`multiplier`](Self::multiplier).
    pub fn growth(&self, steps: usize) -> f64 {
        (self.multiplier.ln() * steps as f64).exp()
    }

    /// True if a perturbation changes its sign in nearly every step and decays slowly: the step does
    /// not resolve a fast motion. False for NaN.
    ///
    /// Motion that a step resolves has multipliers near 1. The implicit midpoint rule is stable for
    /// any decay rate λ, but its multiplier `(1 - λ dt/2) / (1 + λ dt/2)` approaches -1.
    ///
    /// The impact of a body that rebounds within one step has such a multiplier too, with the
    /// opposite of the coefficient of restitution. A motion rings only if consecutive steps do.
    /// Perturbations that grow do not ring: see [`is_stable`](Self::is_stable).
    pub fn rings(&self) -> bool {
        RINGING.contains(&self.lowest)
    }
}

impl fmt::Display for Stability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { multiplier, component, lowest, lowest_component } = *self;
        if multiplier.is_nan() {
            return write!(
                f,
                "unknown: the derivative of the step is non-finite in state component {component}. Evaluate at a state where the step is \
                 differentiable, or correct the step"
            );
        }
        if self.is_stable() {
            write!(
                f,
                "stable: no perturbation grows exponentially. The largest multiplier per step is {}",
                text::growth(multiplier)
            )?;
        } else {
            write!(
                f,
                "unstable: each step multiplies a perturbation of state component {component} by {}",
                text::growth(multiplier)
            )?;
            if multiplier < 1.1 {
                // A slow growth matters only if the horizon is long.
                write!(
                    f,
                    ", a factor of 2 in {:.0} steps",
                    std::f64::consts::LN_2 / multiplier.ln()
                )?;
            }
            write!(
                f,
                ". Use shorter steps (`Substeps`), an implicit integrator (`ImplicitMidpoint`) or more damping. If steps half as \
                 long multiply it by about {}, the physics is unstable, not the step",
                text::growth(multiplier.sqrt())
            )?;
        }
        if self.rings() {
            write!(
                f,
                ". A perturbation of state component {lowest_component} changes its sign (multiplier about {lowest:.3}). If \
                 the next steps do the same, the step rings: use shorter steps for this motion"
            )?;
        }
        Ok(())
    }
}

/// Growth of a perturbation of the state under repeated steps with the Jacobian at `inputs`.
///
/// An explicit step is unstable where the dynamics are too stiff for its length. The perturbation
/// then grows with every step and usually alternates in sign. An implicit step may ring instead; see
/// [`Stability::rings`]. Stability depends on the state: evaluate it at the closest approach, in
/// contact and at rest.
///
/// The spectral radius follows from Gelfand's formula, `ρ = lim ‖Jᵏ‖^(1/k)`, with 30 squarings of
/// the Jacobian. Unlike power iteration, the formula handles complex eigenvalue pairs and defective
/// matrices. Powers may underflow to 0 for long cascades of equal cells, in which each cell drives
/// the next. The last estimate is then an upper bound. In this case, the multiplier is the smaller
/// of this bound and the spectral radius from an eigenvalue solver. The cost is a reverse derivative of
/// eight samples per eight components, and at most 40 matrix products. After underflow, it includes the
/// eigenvalues. The spectral radius of `J - 1` yields [`Stability::lowest`].
///
/// Beyond 200 state components, the function does not store the Jacobian. It multiplies a random
/// perturbation 8192 times by J, and again by `J - 1`. The growth over the last three quarters of
/// the products, without powers of their number, yields the multiplier to two or three digits. A
/// multiplier of `1 ± 3e-5` counts as 1. In long cascades of cells, in which each cell drives the next,
/// perturbations still grow after 8192 products, and the multiplier is too large.
/// ```
/// use physgrad::{Inputs, check, tasks::{FrictionScheme, SliderSystem}};
///
/// let slider = SliderSystem { smoothing: 0.01, scheme: FrictionScheme::Explicit, ..SliderSystem::default() };
/// // 1 - dt μ g / ε = -3.905
/// let found = check::stability(&slider, Inputs::new(&[0.0, 0.0], &[0.0]));
/// assert!(!found.is_stable() && (found.multiplier - 3.905).abs() < 1e-6);
/// assert!(check::stability(&SliderSystem::default(), Inputs::new(&[0.0, 0.0], &[0.0])).is_stable());
/// ```
#[inline(never)]
pub fn stability<S: System>(system: &S, inputs: Inputs<'_, f64>) -> Stability {
    of_any(system, inputs)
}

/// Object-safe system whose Jacobian is computed in lanes.
trait Linear: AnySystem<f64> {
    fn vjp_in_lanes(
        &self,
        inputs: Inputs<'_, Lane<f64>>,
        next_bar: &[One<Lane<f64>>],
        cotangents: Cotangents<'_, One<Lane<f64>>>,
    );
}

impl<S: System> Linear for S {
    fn vjp_in_lanes(
        &self,
        inputs: Inputs<'_, Lane<f64>>,
        next_bar: &[One<Lane<f64>>],
        cotangents: Cotangents<'_, One<Lane<f64>>>,
    ) {
        AnySystem::<Lane<f64>>::vjp(self, inputs, next_bar, cotangents);
    }
}

/// Spectral radius of a matrix, and the component in which its fastest growing vector is largest.
type Radius = (f64, usize);

fn of_any(system: &dyn Linear, inputs: Inputs<'_, f64>) -> Stability {
    let n = inputs.x.len();
    let [own, shifted]: [Radius; 2] = if n <= DENSE {
        let mut jacobian = jacobian(system, inputs);
        let own = by_squaring(&jacobian, n, SQUARINGS);
        (0..n).for_each(|i| jacobian[i * n + i] -= 1.0);
        [own, by_squaring(&jacobian, n, FEW_SQUARINGS)]
    } else {
        let product = |v: &[f64], out: &mut [f64]| {
            system.jvp(inputs, Tangents { x: Some(v), ..Tangents::default() }, out)
        };
        let shifted = |v: &[f64], out: &mut [f64]| {
            product(v, out);
            out.iter_mut().zip(v).for_each(|(out, v)| *out -= v);
        };
        [by_products(&product, n), by_products(&shifted, n)]
    };
    let (multiplier, component) = own;
    // |μ - 1| = s and |μ| <= ρ imply Re μ <= (1 + ρ² - s²) / 2. A real μ is 1 - s, or 1 + s = ρ.
    let bound = 0.5 * (1.0 + multiplier * multiplier - shifted.0 * shifted.0);
    Stability {
        multiplier,
        component,
        lowest: bound.max(1.0 - shifted.0),
        lowest_component: shifted.1,
    }
}

/// Growth of perturbations over consecutive steps of a rollout: the largest spectral radius of the
/// product of the Jacobians of the first k steps, for growing k. Ends at the first k with a growth
/// above [`HARMLESS`]. 0 without steps, NaN if a Jacobian is non-finite.
///
/// A single step of a motion that brakes can have a multiplier above 1, although nothing grows over
/// the steps after it. [`Stability::growth`] extrapolates one step and does not see this. Beyond 200
/// state components, the spectral radius is estimated by power iteration.
/// ```
/// use physgrad::{Inputs, check, tasks::CartPole, Task};
///
/// // A pole that stands upright falls: its perturbation doubles in about ten steps.
/// let steps = [0; 20].map(|t| Inputs { t, ..Inputs::new(&[0.0; 4], &[0.0]) });
/// assert!(check::growth_along(CartPole::new(1).system(), &steps[..2]) < 1.5);
/// assert!(check::growth_along(CartPole::new(1).system(), &steps) > check::HARMLESS);
/// ```
#[inline(never)]
pub fn growth_along<S: System>(system: &S, steps: &[Inputs<'_, f64>]) -> f64 {
    along(system, steps)
}

fn along(system: &dyn Linear, steps: &[Inputs<'_, f64>]) -> f64 {
    let n = steps.first().map_or(0, |inputs| inputs.x.len());
    let mut product: Option<Vec<f64>> = None;
    let (mut scale, mut growth, mut due) = (0.0, 0.0_f64, 1);
    for k in 1..=steps.len() {
        if n <= DENSE {
            let step = jacobian(system, steps[k - 1]);
            let mut next = match &product {
                None => step,
                Some(product) => times(&step, product, n, &mut false),
            };
            let largest = next.iter().fold(0.0, |largest: f64, slope| largest.max(slope.abs()));
            // Far from overflow.
            if largest > 1e100 && largest.is_finite() {
                next.iter_mut().for_each(|slope| *slope /= largest);
                scale += largest.ln();
            }
            product = Some(next);
        }
        if k < due && k < steps.len() {
            continue;
        }
        due = (k + 1).max(k * 5 / 4);
        let radius = match &product {
            Some(product) => by_squaring(product, n, SQUARINGS).0 * f64::exp(scale),
            None => by_rounds(system, &steps[..k]),
        };
        if radius.is_nan() {
            return f64::NAN;
        }
        growth = growth.max(radius);
        if growth > HARMLESS {
            break;
        }
    }
    growth
}

/// Spectral radius of the product of the Jacobians of consecutive steps, by power iteration.
fn by_rounds(system: &dyn Linear, steps: &[Inputs<'_, f64>]) -> f64 {
    /// Rounds before those that count, and all rounds.
    const ROUNDS: [u32; 2] = [4, 8];
    let n = steps[0].x.len();
    let mut v = normal(&mut stream(0, Purpose::Check, 3), n);
    let (mut next, mut logarithm) = (vec![0.0; n], 0.0);
    for round in 0..ROUNDS[1] {
        for &inputs in steps {
            system.jvp(inputs, Tangents { x: Some(&v), ..Tangents::default() }, &mut next);
            std::mem::swap(&mut v, &mut next);
        }
        let norm = v.iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm == 0.0 || norm.is_nan() {
            return norm;
        }
        v.iter_mut().for_each(|v| *v /= norm);
        logarithm += if round < ROUNDS[0] { 0.0 } else { norm.ln() };
    }
    (logarithm / f64::from(ROUNDS[1] - ROUNDS[0])).exp()
}

/// [`Radius`] of a matrix in row-major order, by Gelfand's formula. NaN if an entry is non-finite.
fn by_squaring(matrix: &[f64], n: usize, squarings: usize) -> Radius {
    let mut power = matrix.to_vec();
    if let Some(at) = power.iter().position(|slope| !slope.is_finite()) {
        return (f64::NAN, at / n);
    }
    let (mut logarithm, mut share, mut component, mut underflows) = (0.0, 1.0, 0, false);
    for round in 0..=squarings {
        let largest = power.iter().fold(0.0, |largest: f64, slope| largest.max(slope.abs()));
        if largest == 0.0 {
            // Without underflow, the matrix is nilpotent. Otherwise the last estimate bounds the
            // spectral radius.
            if !underflows {
                return (0.0, component);
            }
            // If the matrix is triangular, its computed eigenvalues or those of its transpose are
            // exact.
            let matrix = DMatrix::from_row_slice(n, n, matrix);
            let largest = [matrix.transpose(), matrix].map(|matrix| {
                let sizes = matrix.complex_eigenvalues().map(|value| value.re.hypot(value.im));
                sizes.iter().copied().fold(0.0, f64::max)
            });
            return (largest.into_iter().fold(f64::exp(logarithm), f64::min), component);
        }
        logarithm += share * largest.ln();
        share *= 0.5;
        for slope in &mut power {
            let is_zero = *slope == 0.0;
            *slope /= largest;
            underflows |= *slope == 0.0 && !is_zero;
        }
        let weight =
            |i: usize| power[i * n..(i + 1) * n].iter().map(|slope| slope * slope).sum::<f64>();
        component = (0..n).max_by(|&i, &j| weight(i).total_cmp(&weight(j))).unwrap_or(0);
        if round < squarings {
            power = times(&power, &power, n, &mut underflows);
        }
    }
    (logarithm.exp(), component)
}

/// [`Radius`] of a matrix of which only products with vectors are known. NaN if a product is
/// non-finite.
///
/// Fits `ln ‖Aᵏ v‖ = a + k ln ρ + q ln k` by least squares. Pairs of complex eigenvalues let the
/// norm oscillate, which the fit averages. Defective eigenvalues multiply it by a power of k.
fn by_products(product: &dyn Fn(&[f64], &mut [f64]), n: usize) -> Radius {
    let mut v = normal(&mut stream(0, Purpose::Check, 3), n);
    let (mut next, mut logarithm) = (vec![0.0; n], 0.0);
    let (mut normal_matrix, mut right) = (Matrix3::<f64>::zeros(), Vector3::zeros());
    for k in 1..=ITERATIONS[1] {
        product(&v, &mut next);
        if let Some(at) = next.iter().position(|next| !next.is_finite()) {
            return (f64::NAN, at);
        }
        let largest = next.iter().fold(0.0, |largest: f64, next| largest.max(next.abs()));
        if largest == 0.0 {
            return (0.0, 0);
        }
        v.iter_mut().zip(&next).for_each(|(v, next)| *v = next / largest);
        logarithm += largest.ln();
        if k > ITERATIONS[0] {
            let norm = logarithm + 0.5 * v.iter().map(|v| v * v).sum::<f64>().ln();
            // Centered and scaled, for small rounding errors.
            let along = k as f64 / ITERATIONS[1] as f64;
            let row = Vector3::new(1.0, along - 0.625, along.ln() + 0.55);
            normal_matrix += row * row.transpose();
            right += row * norm;
        }
    }
    let component = (0..n).max_by(|&i, &j| v[i].abs().total_cmp(&v[j].abs())).unwrap_or(0);
    let slope = normal_matrix.lu().solve(&right).map_or(f64::NAN, |fit| fit[1]);
    // `slope` is the logarithm of the growth over `ITERATIONS[1]` products.
    let slope = if slope.abs() < UNRESOLVED { 0.0 } else { slope };
    ((slope / ITERATIONS[1] as f64).exp(), component)
}

/// Frobenius norm of the state Jacobian ∂S/∂x, or beyond 50 components, the norm of its product with
/// a vector of random normal numbers, the same in each call. Infinite if an entry is NaN.
#[inline(never)]
pub fn jacobian_norm<S: System>(system: &S, inputs: Inputs<'_, f64>) -> f64 {
    let n = inputs.x.len();
    let slopes = if n <= SMALL {
        jacobian(system, inputs)
    } else {
        let (v, mut product) = (normal(&mut stream(0, Purpose::Check, 3), n), vec![0.0; n]);
        System::jvp(system, inputs, Tangents { x: Some(&v), ..Tangents::default() }, &mut product);
        product
    };
    let norm = slopes.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
    if norm.is_nan() { f64::INFINITY } else { norm }
}

/// ∂S/∂x in row-major order. Each lane of a reverse derivative computes one row.
fn jacobian(system: &dyn Linear, inputs: Inputs<'_, f64>) -> Vec<f64> {
    let n = inputs.x.len();
    let in_lanes = |values: &[f64]| -> Vec<Lane<f64>> {
        values.iter().map(|&value| Lane::from(value)).collect()
    };
    let [x, u, p] = [inputs.x, inputs.u, inputs.p].map(in_lanes);
    let inputs = Inputs { x: &x, u: &u, p: &p, t: inputs.t };
    let mut matrix = vec![0.0; n * n];
    for first in (0..n).step_by(LANES) {
        let rows = LANES.min(n - first);
        let mut next_bar = vec![CotangentPack([Lane::<f64>::zero()]); n];
        for lane in 0..rows {
            next_bar[first + lane].0[0].set_lane(lane, 1.0);
        }
        let mut x_bar = vec![One::<Lane<f64>>::null(); n];
        let wanted = Cotangents { x: Some(&mut x_bar), u: None, p: None };
        system.vjp_in_lanes(inputs, &next_bar, wanted);
        for lane in 0..rows {
            let row = &mut matrix[(first + lane) * n..][..n];
            row.iter_mut().zip(&x_bar).for_each(|(slope, bar)| *slope = bar.0[0].lane(lane));
        }
    }
    matrix
}

/// Product of two matrices. Sets `underflows` if a product of two nonzero entries is 0.
fn times(left: &[f64], right: &[f64], n: usize, underflows: &mut bool) -> Vec<f64> {
    let mut product = vec![0.0; n * n];
    for i in 0..n {
        for k in 0..n {
            let factor = left[i * n + k];
            for j in 0..n {
                let term = factor * right[k * n + j];
                *underflows |= term == 0.0 && factor != 0.0 && right[k * n + j] != 0.0;
                product[i * n + j] += term;
            }
        }
    }
    product
}
