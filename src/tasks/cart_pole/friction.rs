//! Friction of joints and cart.

use super::CartPoleSystem;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::number::{Number, Numbers};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Viscous friction in the joints of the poles: `τ_i = -damping ω_i`.
///
/// Source: Barto, Sutton and Anderson 1983 (doi:10.1109/TSMC.1983.6313077). Their coefficient is
/// 0.000002, the default here 0.002.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PoleDamping {
    /// Torque per rate, N m s/rad, not negative.
    pub damping: Number,
}

impl Default for PoleDamping {
    fn default() -> Self {
        Self { damping: 0.002.into() }
    }
}

impl Effect<CartPoleSystem> for PoleDamping {
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([("damping", &self.damping)])
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let [damping] = self.numbers().of(p);
        for (pole, torque) in zip(model.poles_of(x), &mut forces[1..]) {
            *torque -= damping * pole[1];
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &CartPoleSystem,
        OdeInputs { p, .. }: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let [damping] = self.numbers().of(p);
        for (pole_bar, &torque_bar) in
            zip(x_bar[2..2 + 2 * model.poles].chunks_exact_mut(2), &forces_bar[1..])
        {
            pole_bar[1] -= torque_bar * damping;
        }
    }
}

/// Viscous friction of the cart on its rail: `F = -damping ẋ`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CartDamping {
    /// Force per speed, N s/m, not negative.
    pub damping: Number,
}

impl Default for CartDamping {
    fn default() -> Self {
        Self { damping: 0.1.into() }
    }
}

impl Effect<CartPoleSystem> for CartDamping {
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([("damping", &self.damping)])
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        _model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let [damping] = self.numbers().of(p);
        forces[0] -= x[1] * damping;
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _model: &CartPoleSystem,
        OdeInputs { p, .. }: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let [damping] = self.numbers().of(p);
        x_bar[1] -= forces_bar[0] * damping;
    }
}

/// Dry (Coulomb) friction of the cart on its rail, smoothed: `F = -force tanh(ẋ / smoothing)`.
///
/// Smoothing is necessary because sgn(ẋ) has no derivative at 0. Below the speed `smoothing`, the
/// cart creeps instead of sticking. Explicit steps of length dt need about
/// `force dt < 2 smoothing M`, with the total mass M.
///
/// Source: Andersson, Söderberg and Björklund 2007 (doi:10.1016/j.triboint.2005.11.014), eq. 3.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DryFriction {
    /// Force on a sliding cart, N, not negative: friction coefficient times weight.
    pub force: Number,
    /// Speed at which friction reaches three quarters of `force`, m/s, positive.
    pub smoothing: f64,
}

impl Default for DryFriction {
    fn default() -> Self {
        Self { force: 0.5.into(), smoothing: 0.05 }
    }
}

impl Effect<CartPoleSystem> for DryFriction {
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([("force", &self.force)])
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        _model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let [force] = self.numbers().of(p);
        forces[0] -= (x[1] * (1.0 / self.smoothing)).tanh() * force;
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let [force] = self.numbers().of(p);
        let share = (x[1] * R::from(1.0 / self.smoothing)).tanh();
        x_bar[1] -= forces_bar[0] * (force / self.smoothing * (R::one() - share * share));
    }
}
