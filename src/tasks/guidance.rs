//! Guidance by repulsion: drivers in the plane repel evaders and herd them to the origin.
//!
//! The task is that of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR
//! 2024), after Ko and Zuazua 2020 (doi:10.1142/S0218202520400047). Signs and constants are those
//! of the authors' code (tum-pbs/StableBPTT). [`Guidance`] is the task, [`GuidanceSystem`] the
//! system.

mod drive;
mod evade;
mod flock;
mod friction;
mod gap;
mod obstacles;
mod pairs;
mod spread;
mod system;
mod walls;

pub use drive::Drive;
pub use evade::Evade;
pub use flock::Flock;
pub use friction::Friction;
pub use obstacles::Obstacles;
pub use spread::Spread;
pub use system::{Center, GuidanceSystem};
pub use walls::Walls;

use crate::dynamics::effect::{Forced, HasModel, any_effect};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use crate::numbers::zip::zip;
use crate::tasks::LossMode;
use rand::RngExt;
use std::f64::consts::TAU;
use system::AGENT;

any_effect! {
    /// Any guidance effect, chosen at run time.
    GuidanceEffect of GuidanceSystem: Friction, Spread, Evade, Flock, Drive, Obstacles, Walls
}

/// Guidance system with the effects of the paper.
pub type Herding = Forced<GuidanceSystem, (Friction, Spread, Evade, Flock)>;

impl GuidanceSystem {
    /// Adds the effects of the paper with their default values.
    pub fn herding(self) -> Herding {
        Forced { system: self, effects: Default::default() }
    }
}

/// Task to bring the evaders to the origin with little control. With the evader coordinates E and
/// the control components c, the loss, in m², is the sum of two means:
///
/// ```text
/// E²                    mean over evaders and both coordinates, and over time or at the end
/// regularization · c²   mean over time, drivers and both control components
/// ```
///
/// `S` is any system that contains a [`GuidanceSystem`], for example alone, with effects, behind an
/// actuator, or advanced by an integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guidance<S = Herding> {
    /// System to control.
    pub system: S,
    /// States whose positions enter the loss. Controls always enter.
    pub loss: LossMode,
    /// Weight of the mean squared control, in m² s⁴. The mean is over all steps, all drivers, and
    /// the two control components of each driver.
    pub regularization: f64,
    /// Number of steps.
    pub horizon: usize,
}

impl Guidance {
    /// Creates the paper's task: 60 steps in 4 s, running loss, regularization 1. The paper has 2
    /// drivers and 4 evaders. It also uses the regularizations 0.1, 0.01 and 0.001.
    pub fn new(drivers: usize, evaders: usize) -> Self {
        Self::with_system(
            GuidanceSystem { drivers, evaders, ..GuidanceSystem::default() }.herding(),
        )
    }
}

impl<S: HasModel<GuidanceSystem>> Guidance<S> {
    /// Creates the paper's task for another system: 60 steps, running loss, regularization 1.
    ///
    /// # Panics
    /// Without drivers or without evaders.
    #[track_caller]
    pub fn with_system(system: S) -> Self {
        let GuidanceSystem { drivers, evaders, .. } = *system.model();
        assert!(
            drivers > 0 && evaders > 0,
            "{drivers} drivers and {evaders} evaders; allowed: at least one of each"
        );
        Self { system, loss: LossMode::Running, regularization: 1.0, horizon: 60 }
    }

    /// Returns the weight of one squared control component.
    fn control_weight(&self) -> f64 {
        self.regularization / (2 * self.system.model().drivers * self.horizon) as f64
    }

    /// Returns the weight of one squared evader coordinate in the running cost.
    fn running_weight(&self) -> f64 {
        1.0 / (2 * self.system.model().evaders * self.horizon) as f64
    }

    /// Returns the weight of one squared evader coordinate in the terminal cost.
    fn terminal_weight(&self) -> f64 {
        1.0 / (2 * self.system.model().evaders) as f64
    }

    /// Returns the sum of the squared coordinates of the evaders, times `weight`.
    #[inline(always)]
    fn distances<T: Scalar>(&self, weight: f64, x: &[T]) -> T {
        let mut squares = T::zero();
        for evader in self.system.model().evaders_of(x) {
            squares += evader[0] * evader[0] + evader[1] * evader[1];
        }
        squares * weight
    }

    /// Adds the gradient of [`distances`](Self::distances).
    #[inline(always)]
    fn distances_gradient<R: Real>(&self, weight: f64, x: &[R], x_bar: &mut [R]) {
        let slope = R::from(2.0 * weight);
        let model = self.system.model();
        for (bar, evader) in
            zip(x_bar[AGENT * model.drivers..].chunks_exact_mut(AGENT), model.evaders_of(x))
        {
            bar[0] += evader[0] * slope;
            bar[1] += evader[1] * slope;
        }
    }
}

impl<S: HasModel<GuidanceSystem>> Task for Guidance<S> {
    type System = S;

    fn system(&self) -> &S {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// ±5 1/s².
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(vec![[-5.0, 5.0]; self.system.control_dim()])
    }

    /// Draws agents at rest. Every driver is 3 to 4 m from the origin. The evaders lie within ±0.5
    /// m, in both coordinates, of a common point 1 to 2 m from the origin.
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        let ring = |rng: &mut Rng, inner: f64| {
            let (sin, cos) = rng.random_range(0.0..TAU).sin_cos();
            let radius = rng.random_range(inner..inner + 1.0);
            [radius * cos, radius * sin]
        };
        let model = self.system.model();
        let own = &mut start.x[..AGENT * model.agents()];
        let (drivers, evaders) = own.split_at_mut(AGENT * model.drivers);
        for driver in drivers.chunks_exact_mut(AGENT) {
            driver[..2].copy_from_slice(&ring(rng, 3.0));
        }
        let center = ring(rng, 1.0);
        for evader in evaders.chunks_exact_mut(AGENT) {
            for (x, center) in zip(evader.iter_mut(), center) {
                *x = center + rng.random_range(-0.5..0.5);
            }
        }
        self.system.start_extra(rng, start);
    }

    #[inline(always)]
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let mut squares = T::zero();
        for &u in u {
            squares += u * u;
        }
        let effort = squares * self.control_weight();
        match self.loss {
            LossMode::Terminal => effort,
            LossMode::Running => effort + self.distances(self.running_weight(), next),
        }
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        match self.loss {
            LossMode::Terminal => self.distances(self.terminal_weight(), x),
            LossMode::Running => T::zero(),
        }
    }

    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let slope = R::from(2.0 * self.control_weight());
        for (u_bar, &u) in zip(cotangents.u.into_iter().flatten(), inputs.u) {
            *u_bar += u * slope;
        }
        if self.loss == LossMode::Running {
            self.distances_gradient(self.running_weight(), next, next_bar);
        }
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        _p: &[R],
        x_bar: &mut [R],
        _p_bar: Option<&mut [R]>,
    ) {
        if self.loss == LossMode::Terminal {
            self.distances_gradient(self.terminal_weight(), x, x_bar);
        }
    }
}
