//! Check of the derivatives of a system.

use super::oracle::pulled_back;
use super::{CASES, Comparison, Mismatch, ONE_STEP, Passed, normal};
use crate::dynamics::outline::{One, step};
use crate::dynamics::system::System;
use crate::engine::any::{AnySystem, vjp};
use crate::engine::rollout::{Lane, WIDTH};
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::numbers::scalar::{CotangentPack, Lanes, Real, Scalar};
use num_dual::Dual64;

/// Object-safe system for all scalar types that the check uses.
pub(super) trait Checked: AnySystem<f64> {
    fn step_by_duals(&self, x: &[Dual64], u: &[Dual64], next: &mut [Dual64]);
    fn step_in_lanes(&self, x: &[Lane<f64>], u: &[Lane<f64>], next: &mut [Lane<f64>]);
    fn vjp_in_lanes(&self, x: &[Lane<f64>], u: &[Lane<f64>], next_bar: &[Two], x_bar: &mut [Two], u_bar: &mut [Two]);
    fn vjp_state(&self, x: &[f64], u: &[f64], next_bar: &[One<f64>], x_bar: &mut [One<f64>]);
    fn vjp_control(&self, x: &[f64], u: &[f64], next_bar: &[One<f64>], u_bar: &mut [One<f64>]);
}

/// Cotangents of two flows, carried together by a reverse pass.
type Two = CotangentPack<Lane<f64>, 2>;

impl<S: System> Checked for S {
    fn step_by_duals(&self, x: &[Dual64], u: &[Dual64], next: &mut [Dual64]) {
        step(self, x, u, next);
    }

    fn step_in_lanes(&self, x: &[Lane<f64>], u: &[Lane<f64>], next: &mut [Lane<f64>]) {
        step(self, x, u, next);
    }

    fn vjp_in_lanes(&self, x: &[Lane<f64>], u: &[Lane<f64>], next_bar: &[Two], x_bar: &mut [Two], u_bar: &mut [Two]) {
        System::vjp(self, x, u, next_bar, x_bar, u_bar);
    }

    fn vjp_state(&self, x: &[f64], u: &[f64], next_bar: &[One<f64>], x_bar: &mut [One<f64>]) {
        System::vjp_state(self, x, u, next_bar, x_bar);
    }

    fn vjp_control(&self, x: &[f64], u: &[f64], next_bar: &[One<f64>], u_bar: &mut [One<f64>]) {
        System::vjp_control(self, x, u, next_bar, u_bar);
    }
}

/// `(∂S/∂x)ᵀ next_bar` and `(∂S/∂u)ᵀ next_bar` by dual numbers.
fn step_vjp(system: &dyn Checked, x: &[f64], u: &[f64], next_bar: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = x.len();
    let mut x_bar = pulled_back(&[x, u].concat(), next_bar, &|xu, next| system.step_by_duals(&xu[..n], &xu[n..], next));
    let u_bar = x_bar.split_off(n);
    (x_bar, u_bar)
}

/// Draws a state and a control.
type Draw<'a> = &'a dyn Fn(&mut Rng, &mut [f64], &mut [f64]);

/// See [`try_system_at`](super::try_system_at).
pub(super) fn check(system: &dyn Checked, draw: Draw) -> Result<Passed, Mismatch> {
    let (n, m) = (system.state_dim(), system.control_dim());
    let mut c = Comparison::new(ONE_STEP);
    for case in 0..CASES {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let (mut x, mut u) = (vec![0.0; n], vec![0.0; m]);
        draw(&mut rng, &mut x, &mut u);
        let next_bar = normal(&mut rng, n);

        let (x_dual, u_dual) = step_vjp(system, &x, &u, &next_bar);
        let [x_bar, u_bar] = vjp(system, &x, &u, &next_bar);
        c.slices("vjp: x_bar", &x_bar, &x_dual)?;
        c.slices("vjp: u_bar", &u_bar, &u_dual)?;
        let next_bars: Vec<_> = next_bar.iter().map(|&bar| CotangentPack([bar])).collect();
        let (mut x_only, mut u_only) = (vec![CotangentPack([f64::NAN]); n], vec![CotangentPack([f64::NAN]); m]);
        system.vjp_state(&x, &u, &next_bars, &mut x_only);
        system.vjp_control(&x, &u, &next_bars, &mut u_only);
        let plain = |bars: &[CotangentPack<f64, 1>]| bars.iter().map(|bar| bar.0[0]).collect::<Vec<_>>();
        c.slices("vjp_state: x_bar", &plain(&x_only), &x_dual)?;
        c.slices("vjp_control: u_bar", &plain(&u_only), &u_dual)?;

        let (x_tan, u_tan) = (normal(&mut rng, n), normal(&mut rng, m));
        let (mut by_x, mut by_u) = (vec![0.0; n], vec![0.0; n]);
        system.jvp_state(&x, &u, &x_tan, &mut by_x);
        system.jvp_control(&x, &u, &u_tan, &mut by_u);
        for (what, next_tan, bar, tan) in [("jvp_state", by_x, &x_dual, &x_tan), ("jvp_control", by_u, &u_dual, &u_tan)] {
            let terms = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a * b).abs()).sum::<f64>();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let scale = terms(&next_bar, &next_tan).max(terms(bar, tan));
            c.one(what, 0, dot(&next_bar, &next_tan), dot(bar, tan), scale)?;
        }
        lanes(system, &x, &u, &next_bar, &mut c)?;
    }
    Ok(c.passed)
}

/// Compares SIMD lanes with scalars, bit for bit. Every lane has other inputs. The VJP has two
/// columns with opposite cotangents, so that their results are opposite.
fn lanes(system: &dyn Checked, x: &[f64], u: &[f64], next_bar: &[f64], c: &mut Comparison) -> Result<(), Mismatch> {
    const W: usize = WIDTH;
    let vary = |v: &[f64], lane: usize| v.iter().map(|v| v * (1.0 + lane as f64 / 64.0)).collect::<Vec<f64>>();
    let pack = |v: &[f64]| -> Vec<Lane<f64>> {
        let lanes: [Vec<f64>; W] = std::array::from_fn(|lane| vary(v, lane));
        (0..v.len()).map(|i| Lanes(std::array::from_fn(|lane| lanes[lane][i]))).collect()
    };
    let (n, m) = (x.len(), u.len());
    let (x_lanes, u_lanes) = (pack(x), pack(u));
    let mut next = vec![Lanes::zero(); n];
    system.step_in_lanes(&x_lanes, &u_lanes, &mut next);
    let column = |v: Lane<f64>| CotangentPack([v, -v]);
    let next_bars: Vec<_> = pack(next_bar).into_iter().map(column).collect();
    let (mut x_bars, mut u_bars) = (vec![column(Lanes::zero()); n], vec![column(Lanes::zero()); m]);
    system.vjp_in_lanes(&x_lanes, &u_lanes, &next_bars, &mut x_bars, &mut u_bars);
    for lane in 0..W {
        let (x, u, next_bar) = (vary(x, lane), vary(u, lane), vary(next_bar, lane));
        let mut plain = vec![0.0; n];
        system.step(&x, &u, &mut plain);
        let [x_bar, u_bar] = vjp(system, &x, &u, &next_bar);
        c.equal("step in lanes", &next.iter().map(|v| v.lane(lane)).collect::<Vec<_>>(), &plain)?;
        for (k, sign) in [1.0, -1.0].into_iter().enumerate() {
            let column = |v: &[Two]| v.iter().map(|v| sign * v.0[k].lane(lane)).collect::<Vec<_>>();
            c.equal("vjp in lanes: x_bar", &column(&x_bars), &x_bar)?;
            c.equal("vjp in lanes: u_bar", &column(&u_bars), &u_bar)?;
        }
    }
    Ok(())
}
