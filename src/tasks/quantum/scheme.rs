//! [`QuantumScheme`]: a scheme for Schrödinger's equation, chosen at run time.

use super::{Pade, QuantumSystem, Strang};
use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::outline::outline;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Any scheme for Schrödinger's equation. Results equal those of the contained scheme bit for bit.
/// Steps are outlined: each step is one function call.
///
/// | scheme | order in dt | fewest steps | cost of a step |
/// |---|---|---|---|
/// | Crank and Nicolson | 2 | 11 | one tridiagonal solve |
/// | [`Pade`] | 4 | 3 | two tridiagonal solves |
/// | [`Strang`] | 2, exact without potential | 1 | a product with a matrix |
///
/// The third column is the smallest number of steps per 0.0625 units of time with a phase error
/// below 1 %. The phase is that of the fifth eigenstate of the default box, without potential.
#[derive(Clone, Debug, PartialEq)]
pub enum QuantumScheme {
    /// Crank-Nicolson, the step of [`QuantumSystem`] itself.
    CrankNicolson(QuantumSystem),
    /// Fourth-order Padé approximant: [`Pade`].
    Pade(Pade),
    /// Symmetric splitting: [`Strang`].
    Strang(Strang),
}

/// Outlined step of a scheme.
struct SchemeStep<'a, H, E, T> {
    system: &'a H,
    effects: &'a E,
    inputs: Inputs<'a, T>,
    next: &'a mut [T],
}

impl<H: ForcedSystem, E: Effect<H::Model>, T: Scalar> Vectorized for SchemeStep<'_, H, E, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.system.forced_step(self.effects, self.inputs, self.next);
    }
}

/// Outlined reverse step of a scheme.
struct SchemeVjp<'a, H, E, R, C> {
    system: &'a H,
    effects: &'a E,
    inputs: Inputs<'a, R>,
    next_bar: &'a [C],
    cotangents: Cotangents<'a, C>,
}

impl<H: ForcedSystem, E: Effect<H::Model>, R: Real, C: Cotangent<R>> Vectorized
    for SchemeVjp<'_, H, E, R, C>
{
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { system, effects, inputs, next_bar, cotangents } = self;
        system.forced_vjp(effects, inputs, next_bar, cotangents);
    }
}

impl ForcedSystem for QuantumScheme {
    type Model = QuantumSystem;

    #[inline(always)]
    fn model(&self) -> &QuantumSystem {
        match self {
            Self::CrankNicolson(system) => system,
            Self::Pade(system) => system.model(),
            Self::Strang(system) => system.model(),
        }
    }

    fn state_dim(&self) -> usize {
        2 * self.model().grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn force_dim(&self) -> usize {
        self.model().grid
    }

    fn dt(&self) -> f64 {
        self.model().dt
    }

    #[inline(always)]
    fn forced_step<E: Effect<QuantumSystem>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        match self {
            Self::CrankNicolson(system) => {
                outline::<T>(SchemeStep { system, effects, inputs, next })
            }
            Self::Pade(system) => outline::<T>(SchemeStep { system, effects, inputs, next }),
            Self::Strang(system) => outline::<T>(SchemeStep { system, effects, inputs, next }),
        }
    }

    #[inline(always)]
    fn forced_vjp<E: Effect<QuantumSystem>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        match self {
            Self::CrankNicolson(system) => {
                outline::<R>(SchemeVjp { system, effects, inputs, next_bar, cotangents })
            }
            Self::Pade(system) => {
                outline::<R>(SchemeVjp { system, effects, inputs, next_bar, cotangents })
            }
            Self::Strang(system) => {
                outline::<R>(SchemeVjp { system, effects, inputs, next_bar, cotangents })
            }
        }
    }
}

system_without_effects!(QuantumScheme);
