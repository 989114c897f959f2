//! [`CartPoleModel`]: a model of poles on a cart, chosen at run time.

use super::{CartPoleSystem, CoupledCartPole};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::number::Numbers;
use crate::dynamics::ode::ForcedOde;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Either model of a cart with poles side by side. Results equal those of the contained model bit
/// for bit.
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
    fn numbers(&self) -> Numbers<'_> {
        self.model().numbers()
    }

    #[inline(always)]
    fn forced_step<E: Effect<CartPoleSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        match self {
            Self::Uncoupled(system) => system.forced_step(effects, inputs, next),
            Self::Coupled(system) => system.forced_step(effects, inputs, next),
        }
    }

    #[inline(always)]
    fn forced_vjp<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        match self {
            Self::Uncoupled(system) => system.forced_vjp(effects, inputs, next_bar, cotangents),
            Self::Coupled(system) => system.forced_vjp(effects, inputs, next_bar, cotangents),
        }
    }
}

impl ForcedOde for CartPoleModel {
    #[inline(always)]
    fn forced_rate<E: Effect<CartPoleSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        rate: &mut [T],
    ) {
        match self {
            Self::Uncoupled(system) => system.forced_rate(effects, inputs, rate),
            Self::Coupled(system) => system.forced_rate(effects, inputs, rate),
        }
    }

    #[inline(always)]
    fn forced_rate_vjp<E: Effect<CartPoleSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        match self {
            Self::Uncoupled(system) => {
                system.forced_rate_vjp(effects, inputs, rate_bar, cotangents)
            }
            Self::Coupled(system) => system.forced_rate_vjp(effects, inputs, rate_bar, cotangents),
        }
    }

    fn velocity_of(&self, i: usize) -> Option<usize> {
        self.model().velocity_of(i)
    }
}

system_without_effects!(CartPoleModel);
