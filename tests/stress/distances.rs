//! Stress case: coincident and very distant agents.

use super::step;
use super::steps::{error, finite, larger, vjp_by_duals};
use super::{AnySystem, vjp};
use super::{Case, Finding};
use physgrad::Forced;
use physgrad::System;
use physgrad::scalar::Single;
use physgrad::tasks::{
    Evade, Flock, Friction, GuidanceEffect, GuidanceSystem, Obstacles, Spread, Walls,
};
use physgrad::{Float, Real, Scalar};
use physgrad::{Inputs, Tangents};

pub(super) const CASES: &[Case] = &[Case {
    name: "guidance_distances",
    about: "agents and an obstacle at distances from 0 to 1e8 m in f64, including 1e-300 m, and from \
                0 to 1e-10 m in f32",
    criterion: "states, JVPs and VJPs are finite. Dual numbers and VJP agree to 1e-12 (f64) and 1e-5 (f32), also for \
                position components alone. Forces have the correct direction and magnitude to 1e-12 (f64) and 1e-5 \
                (f32). An unguarded distance has a non-finite derivative (a planted fault)",
    explanation: "The norm |r| has no derivative at 0, and r² underflows at 1e-162 and overflows at \
                1e154. Underflow and overflow make the derivative of an unguarded distance \
                non-finite. Here separations are scaled by a power of two before squaring. The \
                derivative at 0 is that of the force, which is differentiable there. Limits: at 0 a \
                force has no direction, and is 0",
    run: guidance_distances,
}];

type Crowd = Forced<GuidanceSystem, Vec<GuidanceEffect>>;

/// Two drivers and two evaders, with an obstacle centered at the origin and walls that only agents
/// at 1e8 m touch.
fn crowd() -> Crowd {
    let system = GuidanceSystem { drivers: 2, evaders: 2, ..GuidanceSystem::default() };
    let obstacles = Obstacles { centers: vec![[0.0, 0.0]], ..Obstacles::default() };
    let effects = vec![
        Friction::default().into(),
        Spread::default().into(),
        Evade::default().into(),
        Flock::default().into(),
        obstacles.into(),
        Walls::default().into(),
    ];
    Forced { system, effects }
}

fn guidance_distances() -> Vec<Finding> {
    let mut findings = findings_at::<f64>(&[0.0, 1e-300, 1e-160, 1e-20, 1e-8, 1e8], 1e-12);
    findings.extend(findings_at::<Single<f32>>(&[0.0, 1e-30, 1e-10], 1e-5));
    let [x_bar, ..] = vjp(&Unguarded, Inputs::new(&[6e-301, 8e-301], &[]), &[1.0; 2]);
    let is_finite = finite(&x_bar);
    findings.push(Finding::holds(
        "unguarded distance of 1e-300",
        "non-finite",
        !is_finite,
        if is_finite { "finite" } else { "non-finite" },
    ));
    findings
}

/// Planted fault: the force of [`Evade`] with an unguarded distance.
struct Unguarded;

impl System for Unguarded {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        0
    }

    fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
        let distance = T::from(0.1) + (x[0] * x[0] + x[1] * x[1]).sqrt();
        let share = T::from(15.0) / (distance * distance);
        (next[0], next[1]) = (x[0] * share, x[1] * share);
    }
}

fn findings_at<R: Real>(distances: &[f64], allowed: f64) -> Vec<Finding> {
    let system = crowd();
    let (mut finite_count, mut vjp_error, mut force_error) = (0, 0.0f64, 0.0f64);
    for &distance in distances {
        let (is_finite, error) = derivatives::<R>(&system, distance);
        finite_count += usize::from(is_finite);
        vjp_error = larger(vjp_error, error);
        if distance > 0.0 {
            force_error = larger(force_error, relative_force_error::<R>(distance));
        }
    }
    vec![
        Finding::all(
            format!("distances in {} with finite results", <R::Real as Float>::NAME),
            finite_count,
            distances.len(),
        ),
        Finding::at_most(
            format!("VJP against dual numbers in {}", <R::Real as Float>::NAME),
            vjp_error,
            allowed,
        ),
        Finding::at_most(
            format!("relative error of forces in {}", <R::Real as Float>::NAME),
            force_error,
            allowed,
        ),
    ]
}

/// Returns whether all values are finite, and the largest error of the VJP.
///
/// Cotangents select the velocity of one agent at a time, and controls are zero. Otherwise larger
/// terms would mask the force derivatives.
fn derivatives<R: Real>(system: &dyn AnySystem<R>, distance: f64) -> (bool, f64) {
    let (n, m) = (system.state_dim(), system.control_dim());
    let position = |agent: usize| [0.6, 0.8].map(|share| R::from(agent as f64 * distance * share));
    let x: Vec<R> =
        (0..4).flat_map(|agent| position(agent).into_iter().chain([R::zero(); 2])).collect();
    let u = vec![R::zero(); m];
    let mut next = vec![R::zero(); n];
    system.step(Inputs::new(&x, &u), &mut next);
    let (mut all_finite, mut worst) = (finite(&next), 0.0f64);
    for k in 0..n {
        let mut x_tan = vec![R::zero(); n];
        x_tan[k] = R::one();
        system.jvp(
            Inputs::new(&x, &u),
            Tangents { x: Some(&x_tan), ..Tangents::default() },
            &mut next,
        );
        all_finite &= finite(&next);
    }
    for agent in 0..4 {
        let mut bar = vec![R::zero(); n];
        (bar[4 * agent + 2], bar[4 * agent + 3]) = (R::one(), R::from(0.5));
        let [x_bar, u_bar, _] = vjp(system, Inputs::new(&x, &u), &bar);
        let [x_dual, u_dual] = vjp_by_duals(system, &x, &u, &bar);
        let positions = |v: &[R]| (0..n).filter(|k| k % 4 < 2).map(|k| v[k]).collect::<Vec<R>>();
        all_finite &= [&x_bar, &u_bar, &x_dual, &u_dual].into_iter().all(|bar| finite(bar));
        for error in [
            error(&x_bar, &x_dual),
            error(&u_bar, &u_dual),
            error(&positions(&x_bar), &positions(&x_dual)),
        ] {
            worst = larger(worst, error);
        }
    }
    (all_finite, worst)
}

/// Relative error of an evader's acceleration by one driver, against `15 r / (0.1 + |r|)²`.
fn relative_force_error<R: Real>(distance: f64) -> f64 {
    let model = GuidanceSystem { drivers: 1, evaders: 1, dt: 1.0, ..GuidanceSystem::default() };
    let (zero, along, across) = (R::zero(), R::from(0.6 * distance), R::from(0.8 * distance));
    let mut next = [zero; 8];
    let system: Crowd = Forced { system: model, effects: vec![Evade::default().into()] };
    step(
        &system,
        Inputs::new(&[zero, zero, zero, zero, along, across, zero, zero], &[zero; 2]),
        &mut next,
    );
    let force = 15.0 / (0.1 + distance) * (distance / (0.1 + distance));
    let shares = [next[6].lane(0).to_f64() / force, next[7].lane(0).to_f64() / force];
    larger((shares[0] - 0.6).abs(), (shares[1] - 0.8).abs())
}
