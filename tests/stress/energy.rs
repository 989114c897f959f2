//! Stress case: energy over long free motion.

use super::step;
use super::steps::larger;
use super::{Case, Finding};
use physgrad::Integrated;
use physgrad::Ode;
use physgrad::Scalar;
use physgrad::integrator::{Integrator, RungeKutta, SemiImplicit};
use physgrad::tasks::{CartPoleSystem, DoublePendulum, PoleChain};
use physgrad::{Inputs, OdeInputs};
use std::f64::consts::PI;

pub(super) const CASES: &[Case] = &[Case {
    name: "energy",
    about: "free motion: RK4 with 10,000 steps of 1 ms, semi-implicit Euler with a million steps of 10 ms",
    criterion: "with RK4, the energy of a pendulum changes by at most 1e-9 of the difference between hanging and \
                upright at rest. With semi-implicit Euler, the largest error of the last tenth of the steps is at most \
                1.01 times that of the first. The means of both tenths differ by at most 1 % of the amplitude. With \
                explicit Euler, they differ by at least 10 %",
    explanation: "Explicit Euler gains energy over long times, and training can exploit this gain. RK4 loses little over \
                long times; symplectic methods have no trend. Scenes select the method by `integrator.method`, and \
                `physgrad accuracy` measures errors and costs. Limits: with RK4, the energy of the chaotic chain drifts. \
                The drift is reported without a bound",
    run: energy,
}];

/// Pendulum of 1 m: x = [angle from hanging in rad, rate in rad/s].
struct Pendulum;

/// Gravitational acceleration, m/s².
const GRAVITY: f64 = 9.81;

impl Ode for Pendulum {
    fn state_dim(&self) -> usize {
        2
    }
    fn control_dim(&self) -> usize {
        1
    }
    fn rate<T: Scalar>(&self, OdeInputs { x, u, .. }: OdeInputs<'_, T>, rate: &mut [T]) {
        rate[0] = x[1];
        rate[1] = u[0] - T::from(GRAVITY) * x[0].sin();
    }
    fn velocity(&self, i: usize) -> Option<usize> {
        (i == 0).then_some(1)
    }
}

/// Initial state at rest, 2 rad from hanging, where the oscillation is not sinusoidal.
const START: [f64; 2] = [2.0, 0.0];

/// Energy per mass, J/kg.
fn pendulum_energy(x: &[f64]) -> f64 {
    0.5 * x[1] * x[1] - GRAVITY * x[0].cos()
}

fn energy() -> Vec<Finding> {
    let mut findings = vec![Finding::at_most(
        "pendulum, RK4, 10 s: largest relative change of energy",
        drift(Pendulum, &START, 0, &pendulum_energy),
        1e-9,
    )];
    let (double, chain) = (
        DoublePendulum::default(),
        PoleChain(CartPoleSystem { poles: 3, ..CartPoleSystem::default() }),
    );
    let horizontal = [1.57, 0.0, 1.57, 0.0];
    for (name, drift) in [
        ("double pendulum", drift(double, &horizontal, 0, &|x| double.energy(x))),
        (
            "chain of 3 poles",
            drift(chain, &[0.0, 0.0, 0.5, 0.0, 0.3, 0.0, 0.1, 0.0], 2, &|x| chain.energy(x)),
        ),
    ] {
        findings.push(Finding::info(
            format!("{name}, RK4, 10 s: largest relative change of energy"),
            format!("{drift:.1e}"),
        ));
    }
    let long = tenths(SemiImplicit, 1_000_000);
    findings.push(Finding::at_most(
        "semi-implicit Euler, a million steps: trend relative to the amplitude",
        long.trend,
        0.01,
    ));
    findings.push(Finding::at_most(
        "semi-implicit Euler: largest error in the last tenth over that in the first",
        long.growth,
        1.01,
    ));
    findings.push(Finding::info(
        "semi-implicit Euler: amplitude of the energy error, relative to the energy difference between hanging and upright",
        format!("{:.1e}", long.amplitude),
    ));
    let explicit = tenths(RungeKutta::EULER, 10_000);
    findings.push(Finding::at_least(
        "explicit Euler, 10,000 steps: trend relative to the amplitude",
        explicit.trend,
        0.1,
    ));
    findings
}

/// Energy difference between all angles hanging and all upright, at rest. It does not depend on the
/// zero of energy. Angles are every second component from `first_angle` on.
fn scale(state_dim: usize, first_angle: usize, energy: &dyn Fn(&[f64]) -> f64) -> f64 {
    let at = |angle: f64| {
        let mut x = vec![0.0; state_dim];
        x[first_angle..].iter_mut().step_by(2).for_each(|x| *x = angle);
        energy(&x)
    };
    (at(0.0) - at(PI)).abs()
}

/// Largest energy change along 10 s of free motion in steps of 1 ms, relative to [`scale`].
fn drift<O: Ode>(ode: O, start: &[f64], first_angle: usize, energy: &dyn Fn(&[f64]) -> f64) -> f64 {
    let system = Integrated { ode, integrator: RungeKutta::RK4, dt: 1e-3 };
    let (mut x, mut next) = (start.to_vec(), start.to_vec());
    let before = energy(start);
    let mut largest: f64 = 0.0;
    for _ in 0..10_000 {
        step(&system, Inputs::new(&x, &[0.0]), &mut next);
        std::mem::swap(&mut x, &mut next);
        largest = larger(largest, (energy(&x) - before).abs());
    }
    largest / scale(start.len(), first_angle, energy)
}

/// Energy error in the first and last tenth of a rollout.
struct Tenths {
    /// Difference of the mean errors, in units of the amplitude.
    trend: f64,
    /// Ratio of the largest errors, last tenth to first.
    growth: f64,
    /// Half the range of the error, relative to the scale of the energy.
    amplitude: f64,
}

fn tenths<I: Integrator>(integrator: I, steps: usize) -> Tenths {
    let system = Integrated { ode: Pendulum, integrator, dt: 1e-2 };
    let (mut x, mut next) = (START, START);
    let before = pendulum_energy(&x);
    tenths_of(steps, |_| {
        step(&system, Inputs::new(&x, &[0.0]), &mut next);
        std::mem::swap(&mut x, &mut next);
        pendulum_energy(&x) - before
    })
}

/// Statistics of the energy errors `error(t)` for t from 0 to `steps - 1`. A NaN that persists to
/// the last step makes the trend and the growth NaN. Neither then meets its bound.
fn tenths_of(steps: usize, mut error: impl FnMut(usize) -> f64) -> Tenths {
    let (mut low, mut high): (f64, f64) = (0.0, 0.0);
    let (mut sums, mut largest) = ([0.0; 10], [0.0_f64; 10]);
    for t in 0..steps {
        let (error, tenth) = (error(t), 10 * t / steps);
        (low, high) = (low.min(error), high.max(error));
        sums[tenth] += error;
        largest[tenth] = larger(largest[tenth], error.abs());
    }
    let amplitude = 0.5 * (high - low);
    let trend = (sums[9] - sums[0]).abs() / (0.1 * steps as f64) / amplitude;
    Tenths {
        trend,
        growth: largest[9] / largest[0],
        amplitude: amplitude / scale(START.len(), 0, &pendulum_energy),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nan_energy_fails_the_bounds_of_trend_and_growth() {
        // Two periods in each tenth.
        let oscillation = |t: usize| (2.0 * PI * t as f64 / 50.0).sin();
        let finite = tenths_of(1000, oscillation);
        assert!(finite.trend <= 0.1 && finite.growth <= 1.01, "{} {}", finite.trend, finite.growth);
        for nan_from in [0, 950] {
            let Tenths { trend, growth, .. } =
                tenths_of(1000, |t| if t < nan_from { oscillation(t) } else { f64::NAN });
            let passes = trend <= 0.1 || growth <= 1.01;
            assert!(!passes, "NaN from step {nan_from}: {trend} {growth}");
        }
    }
}
