//! Cart-pole: swing-up of one or more poles on one cart by one force.
//!
//! The task is that of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR
//! 2024), after Barto, Sutton and Anderson 1983 (doi:10.1109/TSMC.1983.6313077). [`CartPole`] is
//! the task.
//!
//! [`CartPoleSystem`] is the authors' model, in which no pole affects another. The acceleration of
//! each pole includes the centrifugal term of that pole only. The total mass includes one pole,
//! regardless of the number of poles. [`CoupledCartPole`] is the exact model.

mod bumpers;
mod coupled;
mod friction;
mod masses;
mod model;
mod motion;
mod system;
mod wind;

pub use bumpers::Bumpers;
pub use coupled::CoupledCartPole;
pub use friction::{CartDamping, DryFriction, PoleDamping};
pub use masses::MassError;
pub use model::CartPoleModel;
pub use system::CartPoleSystem;
pub use wind::{GustyWind, SteadyWind};

use crate::dynamics::effect::{HasModel, any_effect};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use crate::numbers::zip::zip;
use crate::tasks::LossMode;
use rand::RngExt;
use std::f64::consts::PI;

any_effect! {
    /// Any cart-pole effect, chosen at run time.
    CartPoleEffect of CartPoleSystem: PoleDamping, CartDamping, DryFriction, SteadyWind, GustyWind, Bumpers
}

/// Task to swing up all poles, with the mean of `1 - cos θ` over the poles as loss.
///
/// The loss lies between 0 (all upright) and 2 (all hanging). Position and control have no cost.
///
/// `S` is any system that contains a [`CartPoleSystem`], for example alone, coupled, with effects,
/// behind an actuator, or advanced by an integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartPole<S = CartPoleSystem> {
    /// System to control.
    pub system: S,
    /// States that enter the loss.
    pub loss: LossMode,
    /// Number of steps.
    pub horizon: usize,
}

impl CartPole {
    /// Creates the paper's task: `poles` poles, 100 steps of 0.01 s, terminal loss.
    ///
    /// # Panics
    /// If the number of poles is 0 or too large.
    #[track_caller]
    pub fn new(poles: usize) -> Self {
        let system = CartPoleSystem { poles, ..CartPoleSystem::default() };
        if let Err(error) = system.check() {
            panic!("{error}");
        }
        Self::with_system(system)
    }
}

impl<S: HasModel<CartPoleSystem>> CartPole<S> {
    /// Creates the paper's task for another system: 100 steps, terminal loss.
    pub fn with_system(system: S) -> Self {
        Self { system, loss: LossMode::Terminal, horizon: 100 }
    }

    /// Returns the mean of `1 - cos θ` over the poles.
    #[inline(always)]
    fn height<T: Scalar>(&self, x: &[T]) -> T {
        let mut cosines = T::zero();
        for pole in self.system.model().poles_of(x) {
            cosines += pole[0].cos();
        }
        T::one() - cosines * (1.0 / self.system.model().poles as f64)
    }

    /// Adds the gradient of `factor` times the mean of `1 - cos θ`.
    #[inline(always)]
    fn height_gradient<R: Real>(&self, factor: f64, x: &[R], x_bar: &mut [R]) {
        let factor = R::from(factor / self.system.model().poles as f64);
        for (x_bar, pole) in zip(x_bar[2..].chunks_exact_mut(2), self.system.model().poles_of(x)) {
            x_bar[0] += pole[0].sin() * factor;
        }
    }

    /// Returns the weight of one step in the mean over time.
    fn running_factor(&self) -> f64 {
        1.0 / self.horizon as f64
    }
}

impl<S: HasModel<CartPoleSystem>> Task for CartPole<S> {
    type System = S;

    fn system(&self) -> &S {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// ±60 N, more than policies of short trainings use.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(vec![[-60.0, 60.0]; self.system.control_dim()])
    }

    /// Draws angles within ±30° of hanging, and the other components of cart and poles within ±1,
    /// in SI units.
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        let own = 2 + 2 * self.system.model().poles;
        for (i, x) in start.x[..own].iter_mut().enumerate() {
            let draw = rng.random_range(-1.0..1.0);
            let is_angle = i >= 2 && i % 2 == 0;
            *x = if is_angle { PI + PI / 6.0 * draw } else { draw };
        }
        self.system.start_extra(rng, start);
    }

    #[inline(always)]
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
        match self.loss {
            LossMode::Terminal => T::zero(),
            LossMode::Running => self.height(next) * self.running_factor(),
        }
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        match self.loss {
            LossMode::Terminal => self.height(x),
            LossMode::Running => T::zero(),
        }
    }

    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        _inputs: Inputs<'_, R>,
        next: &[R],
        _bars: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        if self.loss == LossMode::Running {
            self.height_gradient(self.running_factor(), next, next_bar);
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
            self.height_gradient(1.0, x, x_bar);
        }
    }
}
