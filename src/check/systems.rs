//! Check of the derivatives of a system.

use super::oracle::pulled_back;
use super::{CASES, Comparison, Mismatch, ONE_STEP, Passed, normal};
use crate::dynamics::inputs::{Cotangents, Inputs, Tangents};
use crate::dynamics::number::Varied;
use crate::dynamics::outline::{One, step};
use crate::dynamics::system::System;
use crate::engine::any::{AnySystem, vjp};
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::numbers::scalar::{Cotangent, CotangentPack, LANES, Lane, Lanes, Real, Scalar};
use num_dual::Dual64;
use std::cell::OnceCell;

/// Object-safe system for all scalar types that the check uses.
pub(super) trait Checked: AnySystem<f64> {
    fn varied_numbers(&self) -> Vec<Varied>;
    fn step_by_duals(&self, inputs: Inputs<'_, Dual64>, next: &mut [Dual64]);
    fn step_in_lanes(&self, inputs: Inputs<'_, Lane<f64>>, next: &mut [Lane<f64>]);
    fn vjp_in_lanes(
        &self,
        inputs: Inputs<'_, Lane<f64>>,
        next_bar: &[Two],
        cotangents: Cotangents<'_, Two>,
    );
}

/// Cotangents of two flows, carried together by a reverse pass.
type Two = CotangentPack<Lane<f64>, 2>;

impl<S: System> Checked for S {
    fn varied_numbers(&self) -> Vec<Varied> {
        self.varied(System::param_dim(self))
    }

    fn step_by_duals(&self, inputs: Inputs<'_, Dual64>, next: &mut [Dual64]) {
        step(self, inputs, next);
    }

    fn step_in_lanes(&self, inputs: Inputs<'_, Lane<f64>>, next: &mut [Lane<f64>]) {
        step(self, inputs, next);
    }

    fn vjp_in_lanes(
        &self,
        inputs: Inputs<'_, Lane<f64>>,
        next_bar: &[Two],
        cotangents: Cotangents<'_, Two>,
    ) {
        System::vjp(self, inputs, next_bar, cotangents);
    }
}

/// Names of the cotangents, in the order of [`Values`].
const NAMES: [&str; 3] = ["x_bar", "u_bar", "p_bar"];

/// State, control and parameters, or their cotangents.
type Values<T> = [Vec<T>; 3];

fn inputs<T>([x, u, p]: &Values<T>, t: usize) -> Inputs<'_, T> {
    Inputs { x, u, p, t }
}

/// Transposed Jacobian products with respect to state, control and parameters, by dual numbers.
fn step_vjp(system: &dyn Checked, at: Inputs<'_, f64>, next_bar: &[f64]) -> Values<f64> {
    let (n, m) = (at.x.len(), at.x.len() + at.u.len());
    let step = |all: &[Dual64], next: &mut [Dual64]| {
        system.step_by_duals(Inputs { x: &all[..n], u: &all[n..m], p: &all[m..], t: at.t }, next);
    };
    let mut x_bar = pulled_back(&[at.x, at.u, at.p].concat(), next_bar, &step);
    let mut u_bar = x_bar.split_off(n);
    let p_bar = u_bar.split_off(m - n);
    [x_bar, u_bar, p_bar]
}

/// Relative change of an input, or error of the solution of an implicit step, that counts as
/// rounding. Implicit integrators have this tolerance by default.
const PERTURBATION: f64 = 1e-12;

/// Allowed errors of a derivative in units of its [`Uncertainty`]: the errors of several solves
/// add, and the perturbation of an input is not the error of a stage.
const UNCERTAINTIES: f64 = 10.0;

/// Absolute differences of the components.
fn changes(a: &Values<f64>, b: &Values<f64>) -> Values<f64> {
    std::array::from_fn(|k| a[k].iter().zip(&b[k]).map(|(a, b)| (a - b).abs()).collect())
}

/// Allowed absolute errors of the derivatives by [`step_vjp`] that rounding explains: changes of
/// the reference between inputs that agree to rounding. Evaluated when first needed.
///
/// An implicit step ends its iteration within the tolerance or rounding of the solution. Two correct
/// derivatives are taken at solutions that differ by as much, and a stiff step has derivatives that
/// change strongly with the solution. Both are evaluated, since each has rounding errors of its own:
/// the linear equations of the reverse pass are as badly conditioned as the step. A wrong derivative
/// does not gain from this, as it changes as little as a correct one. The sum of the changes by [`PERTURBATION`] of each input bounds
/// the change by any perturbation of this size, to first order.
struct Uncertainty<'a> {
    system: &'a dyn Checked,
    at: Inputs<'a, f64>,
    next: &'a [f64],
    next_bar: &'a [f64],
    expected: &'a Values<f64>,
    allowed: OnceCell<Values<f64>>,
}

impl Uncertainty<'_> {
    fn allowed(&self) -> &Values<f64> {
        self.allowed.get_or_init(|| {
            let Self { at, next, .. } = *self;
            let mut allowed = self.expected.clone().map(|bars| vec![0.0; bars.len()]);
            let found = vjp(self.system, at, self.next_bar);
            // The measure of states by which Newton's iteration ends.
            let state = at.x.iter().zip(next).map(|(x, next)| 1.0 + x.abs().max(next.abs()));
            let sizes: Values<f64> = [
                state.collect(),
                at.u.iter().map(|u| u.abs()).collect(),
                at.p.iter().map(|p| p.abs()).collect(),
            ];
            for (k, sizes) in sizes.iter().enumerate() {
                for (i, size) in sizes.iter().enumerate().filter(|(_, size)| **size > 0.0) {
                    let [below, above] = [-1.0, 1.0].map(|sign| {
                        let mut values = [at.x, at.u, at.p].map(<[f64]>::to_vec);
                        values[k][i] += sign * PERTURBATION * size;
                        let at = inputs(&values, at.t);
                        let found_there = vjp(self.system, at, self.next_bar);
                        let there = step_vjp(self.system, at, self.next_bar);
                        [changes(&there, self.expected), changes(&found_there, &found)]
                    });
                    for j in 0..3 {
                        for (l, allowed) in allowed[j].iter_mut().enumerate() {
                            let all = below.iter().chain(&above).map(|changes| changes[j][l]);
                            *allowed += UNCERTAINTIES * all.fold(0.0, f64::max);
                        }
                    }
                }
            }
            allowed
        })
    }
}

/// Draws a state, a control and parameters.
type Draw<'a> = &'a dyn Fn(&mut Rng, &mut [f64], &mut [f64], &mut [f64]);

/// Performs the check of [`system_at`](super::system_at), at steps before `horizon`.
pub(super) fn check(system: &dyn Checked, draw: Draw, horizon: usize) -> Result<Passed, Mismatch> {
    let sizes = [system.state_dim(), system.control_dim(), system.param_dim()];
    let mut c = Comparison::new(ONE_STEP);
    for case in 0..CASES + AT_ZERO {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let mut values = sizes.map(|len| vec![0.0; len]);
        let [x, u, p] = &mut values;
        draw(&mut rng, x, u, p);
        for Varied { index, number, .. } in system.varied_numbers() {
            p[index] = number.draw(&mut rng);
        }
        let t = case as usize % horizon;
        let next_bar = normal(&mut rng, sizes[0]);
        if case >= CASES {
            // The state 0, first at rest, then under a control.
            values[0].fill(0.0);
            if case == CASES {
                values[1].fill(0.0);
            }
            if !is_smooth(system, &values, t, &next_bar, &mut c)? {
                continue;
            }
        }
        let at = inputs(&values, t);

        let [from_zeros, from_nans] = [0.0, f64::NAN].map(|initial| {
            let mut next = vec![initial; sizes[0]];
            system.step(at, &mut next);
            next
        });
        c.finite("step is not finite here; draw other states with `system_at`: next", &from_zeros)?;
        c.equal("step leaves a component unwritten: next", &from_nans, &from_zeros)?;

        let expected = step_vjp(system, at, &next_bar);
        let uncertainty = Uncertainty {
            system,
            at,
            next: &from_zeros,
            next_bar: &next_bar,
            expected: &expected,
            allowed: OnceCell::new(),
        };
        requests(&uncertainty, &mut c)?;

        jvps(&uncertainty, &mut rng, &mut c)?;
        lanes(system, at, &next_bar, &mut c)?;
    }
    Ok(c.passed)
}

/// Number of cases at the state 0. Random states never hit it, but systems that come to rest do.
const AT_ZERO: u64 = 2;

/// Returns whether the step has a derivative at `values`: whether derivatives on both sides, at
/// distances of about [`BESIDE`], agree. A kink has one derivative on each side, and either is
/// correct. A step that is not defined at the state 0 is not smooth there.
///
/// # Errors
/// A derivative that is not finite although both sides agree: it would end a training.
fn is_smooth(
    system: &dyn Checked,
    values: &Values<f64>,
    t: usize,
    next_bar: &[f64],
    c: &mut Comparison,
) -> Result<bool, Mismatch> {
    let is_finite = |all: &Values<f64>| all.iter().flatten().all(|bar| bar.is_finite());
    let beside = |sign: f64| {
        let moved =
            |(i, value): (usize, &f64)| value + sign * BESIDE * (1.0 + (i % 7) as f64 / 8.0);
        let [x, u] = [0, 1].map(|k| values[k].iter().enumerate().map(moved).collect());
        step_vjp(system, inputs(&[x, u, values[2].clone()], t), next_bar)
    };
    let mut next = vec![0.0; values[0].len()];
    system.step(inputs(values, t), &mut next);
    let [before, after] = [-1.0, 1.0].map(beside);
    if !(next.iter().all(|next| next.is_finite()) && is_finite(&before) && is_finite(&after)) {
        return Ok(false);
    }
    let size =
        before.iter().chain(&after).flatten().fold(1.0, |size: f64, bar| size.max(bar.abs()));
    let pairs = || before.iter().flatten().zip(after.iter().flatten());
    if pairs().any(|(before, after)| (before - after).abs() > KINK * size) {
        return Ok(false);
    }
    for (name, bars) in NAMES.into_iter().zip(step_vjp(system, inputs(values, t), next_bar)) {
        let what = format!(
            "the derivative of step is not finite at the state 0, but beside it: use `powf` or `hypot`: {name}"
        );
        c.finite(&what, &bars)?;
    }
    Ok(true)
}

/// Distance of the states that decide whether the state 0 is a kink. Curvature changes derivatives
/// by about this number, roots of it by 1e-6.
const BESIDE: f64 = 1e-12;

/// Change of a derivative between both sides that marks a kink, relative to the largest derivative,
/// at least 1.
const KINK: f64 = 1e-4;

/// Compares [`System::vjp`] with dual numbers for each combination of requested cotangents. Checks
/// that a second call adds the same cotangents again.
fn requests(uncertainty: &Uncertainty<'_>, c: &mut Comparison) -> Result<(), Mismatch> {
    let Uncertainty { system, at, next_bar, expected, .. } = *uncertainty;
    let next_bar: Vec<One<f64>> = next_bar.iter().map(|&bar| CotangentPack([bar])).collect();
    // Starts with the request of all three: the message for a `vjp` that is always wrong then names
    // no combination.
    for requested in (1..8).rev() {
        let asked = |k: usize| requested >> k & 1 == 1;
        let mut cotangents =
            [at.x, at.u, at.p].map(|values| vec![One::<f64>::null(); values.len()]);
        for calls in [1.0, 2.0] {
            let [x, u, p] = &mut cotangents;
            let request = Cotangents {
                x: asked(0).then_some(&mut x[..]),
                u: asked(1).then_some(&mut u[..]),
                p: asked(2).then_some(&mut p[..]),
            };
            system.vjp(at, &next_bar, request);
            for k in (0..3).filter(|&k| asked(k)) {
                let found: Vec<f64> = cotangents[k].iter().map(|bar| bar.0[0] / calls).collect();
                let what = match (requested, calls) {
                    (_, 2.0) => format!("vjp, second call that adds: {}", NAMES[k]),
                    (7, _) => format!("vjp: {}", NAMES[k]),
                    _ => format!("vjp with only some cotangents requested: {}", NAMES[k]),
                };
                c.slices_within(&what, &found, &expected[k], &|i| uncertainty.allowed()[k][i])?;
            }
        }
    }
    Ok(())
}

/// Compares [`System::jvp`] with derivatives by dual numbers, along random tangents of each input
/// and of all inputs.
fn jvps(uncertainty: &Uncertainty<'_>, rng: &mut Rng, c: &mut Comparison) -> Result<(), Mismatch> {
    let Uncertainty { system, at, next_bar, expected, .. } = *uncertainty;
    let n = at.x.len();
    let mut all = [at.x, at.u, at.p].map(|values| vec![0.0; values.len()]);
    let mut sum = vec![0.0; n];
    for (k, name) in ["jvp of x", "jvp of u", "jvp of p"].into_iter().enumerate() {
        let tangent = normal(rng, all[k].len());
        let mut tangents = Tangents::default();
        *[&mut tangents.x, &mut tangents.u, &mut tangents.p][k] = Some(&tangent);
        // `jvp` writes every component.
        let mut next_tan = vec![f64::NAN; n];
        system.jvp(at, tangents, &mut next_tan);
        sum.iter_mut().zip(&next_tan).for_each(|(sum, tan)| *sum += tan);
        all[k].copy_from_slice(&tangent);
        let terms = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a * b).abs()).sum::<f64>();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let scale = terms(next_bar, &next_tan).max(terms(&expected[k], &tangent));
        let [found, expected] = [dot(next_bar, &next_tan), dot(&expected[k], &tangent)];
        c.one_within(name, 0, found, expected, scale, &|| {
            terms(&uncertainty.allowed()[k], &tangent)
        })?;
    }
    let mut next_tan = vec![f64::NAN; n];
    let [x, u, p] = &all;
    system.jvp(at, Tangents { x: Some(x), u: Some(u), p: Some(p) }, &mut next_tan);
    c.slices("jvp of x, u and p: next", &next_tan, &sum)
}

/// Compares SIMD lanes with scalars, without tolerance. Every lane has different inputs. The VJP
/// carries two flows with cotangents of opposite sign, so the results have opposite signs too.
fn lanes(
    system: &dyn Checked,
    at: Inputs<'_, f64>,
    next_bar: &[f64],
    c: &mut Comparison,
) -> Result<(), Mismatch> {
    const W: usize = LANES;
    let vary = |v: &[f64], lane: usize| {
        v.iter().map(|v| v * (1.0 + lane as f64 / 64.0)).collect::<Vec<f64>>()
    };
    let pack = |v: &[f64]| -> Vec<Lane<f64>> {
        let lanes: [Vec<f64>; W] = std::array::from_fn(|lane| vary(v, lane));
        (0..v.len()).map(|i| Lanes(std::array::from_fn(|lane| lanes[lane][i]))).collect()
    };
    let both_flows = |v: Lane<f64>| CotangentPack([v, -v]);
    let packed = [at.x, at.u, at.p].map(pack);
    let mut next = vec![Lanes::zero(); at.x.len()];
    system.step_in_lanes(inputs(&packed, at.t), &mut next);
    let next_bars: Vec<Two> = pack(next_bar).into_iter().map(both_flows).collect();
    let mut cotangents = [at.x, at.u, at.p].map(|values| vec![Two::null(); values.len()]);
    let [x, u, p] = &mut cotangents;
    let request = Cotangents { x: Some(x), u: Some(u), p: (!p.is_empty()).then_some(p) };
    system.vjp_in_lanes(inputs(&packed, at.t), &next_bars, request);
    for lane in 0..W {
        let (values, next_bar) = ([at.x, at.u, at.p].map(|v| vary(v, lane)), vary(next_bar, lane));
        let mut plain = vec![0.0; at.x.len()];
        system.step(inputs(&values, at.t), &mut plain);
        c.equal("step in lanes", &next.iter().map(|v| v.lane(lane)).collect::<Vec<_>>(), &plain)?;
        let plain = vjp(system, inputs(&values, at.t), &next_bar);
        for (k, sign) in [1.0, -1.0].into_iter().enumerate() {
            for (name, (cotangents, plain)) in NAMES.into_iter().zip(cotangents.iter().zip(&plain))
            {
                let found: Vec<f64> = cotangents.iter().map(|v| sign * v.0[k].lane(lane)).collect();
                c.equal(&format!("vjp in lanes: {name}"), &found, plain)?;
            }
        }
    }
    Ok(())
}
