//! [`CartPoleModel`]: a model of poles on a cart, chosen at run time.

use super::{CartPoleSystem, CoupledCartPole};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::ode::ForcedOde;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Either cart-pole model. Results equal those of the model itself, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CartPoleModel {
    /// Poles do not act on each other.
    Uncoupled(CartPoleSystem),
    /// Poles act on each other through the cart.
    Coupled(CoupledCartPole),
}

impl ForcedSystem for CartPoleModel {
    type Model = CartPoleSystem;

    #[inline(always)]
    fn model(&self) -> &CartPoleSystem {
        match self {
            Self::Uncoupled(system) | Self::Coupled(CoupledCartPole(system)) => system,
        }
    }

    fn state_dim(&self) -> usize {
        ForcedSystem::state_dim(self.model())
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn force_dim(&self) -> usize {
        1 + self.model().poles
    }

    fn dt(&self) -> f64 {
        self.model().dt
    }

    #[inline(always)]
    fn forced_step<E: Effect<CartPoleSystem>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], next: &mut [T]) {
        match self {
            Self::Uncoupled(host) => host.forced_step(effects, x, u, next),
            Self::Coupled(host) => host.forced_step(effects, x, u, next),
        }
    }

    #[inline(always)]
    fn reverse<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        next_bar: &[C],
        x_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        match self {
            Self::Uncoupled(host) => host.reverse(effects, x, u, next_bar, x_bar, u_bar),
            Self::Coupled(host) => host.reverse(effects, x, u, next_bar, x_bar, u_bar),
        }
    }
}

impl ForcedOde for CartPoleModel {
    #[inline(always)]
    fn forced_rate<E: Effect<CartPoleSystem>, T: Scalar>(&self, effects: &E, x: &[T], u: &[T], rate: &mut [T]) {
        match self {
            Self::Uncoupled(host) => host.forced_rate(effects, x, u, rate),
            Self::Coupled(host) => host.forced_rate(effects, x, u, rate),
        }
    }

    #[inline(always)]
    fn forced_rate_vjp<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        x: &[R],
        u: &[R],
        rate_bar: &[C],
        x_bar: &mut [C],
        u_bar: Option<&mut [C]>,
    ) {
        match self {
            Self::Uncoupled(host) => host.forced_rate_vjp(effects, x, u, rate_bar, x_bar, u_bar),
            Self::Coupled(host) => host.forced_rate_vjp(effects, x, u, rate_bar, x_bar, u_bar),
        }
    }

    fn velocity_of(&self, i: usize) -> Option<usize> {
        self.model().velocity_of(i)
    }
}

system_without_effects!(CartPoleModel);
