//! Validation of masses and pole counts.

use super::{CartPoleSystem, CoupledCartPole};
use crate::dynamics::number::Number;

/// Invalid parameters of a cart-pole.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MassError {
    /// A mass or a length is not positive and finite.
    #[error("{what} is {value}; allowed: a positive, finite number")]
    NotPositive {
        /// Name of the parameter.
        what: &'static str,
        /// Value of the parameter.
        value: f64,
    },
    /// The cart's mass is too small relative to the mass of the poles.
    #[error(
        "the cart's mass of {cart:.1e} kg retains fewer than seven digits in the total mass, beside {poles:.1e} kg of poles. Use a \
         cart of {:.1e} kg at least, or lighter poles",
        poles * CartPoleSystem::LIGHTEST_CART
    )]
    CartTooLight {
        /// Smallest possible mass of the cart, kg.
        cart: f64,
        /// Largest possible mass of all poles, kg.
        poles: f64,
    },
    /// A number of a chain of poles is not fixed.
    #[error(
        "{number} is not fixed; allowed: fixed numbers, because a chain of poles computes with constants"
    )]
    Varies {
        /// Name of the number.
        number: String,
    },
    /// The number of poles is zero or too large.
    #[error("{poles} poles; allowed: 1 to {most}")]
    Poles {
        /// Number of poles.
        poles: usize,
        /// Largest number of poles.
        most: usize,
    },
}

impl CartPoleSystem {
    /// Smallest cart mass relative to the mass of all poles.
    ///
    /// The equations of motion remain solvable for lighter carts, even massless ones, because
    /// uniform poles have inertia about their middle. However, rounding of the total mass then
    /// changes the mass of the cart noticeably.
    pub const LIGHTEST_CART: f64 = 1e-9;

    /// Checks the number of poles, and all possible values of the masses and the half length. For a
    /// trained number, checks the initial value and the finite bounds.
    ///
    /// Rejects cart masses of 0 and below as unphysical. The equations of [`CoupledCartPole`] are
    /// nevertheless solvable at all angles if the cart mass exceeds minus a quarter of the poles'
    /// mass.
    ///
    /// # Errors
    /// Returns a [`MassError`] for the first invalid parameter.
    pub fn check(&self) -> Result<(), MassError> {
        self.check_up_to(Self::MAX_POLES)
    }

    pub(crate) fn check_up_to(&self, most: usize) -> Result<(), MassError> {
        if !(1..=most).contains(&self.poles) {
            return Err(MassError::Poles { poles: self.poles, most });
        }
        let parameters = [
            ("the cart's mass", self.cart_mass),
            ("a pole's mass", self.pole_mass),
            ("a pole's half length", self.half_length),
        ];
        for (what, number) in parameters {
            if let Some(value) =
                number.extremes().into_iter().find(|value| !(*value > 0.0 && value.is_finite()))
            {
                return Err(MassError::NotPositive { what, value });
            }
        }
        let least = |number: Number| number.extremes().into_iter().fold(f64::INFINITY, f64::min);
        let most = |number: Number| number.extremes().into_iter().fold(0.0, f64::max);
        let (cart, poles) = (least(self.cart_mass), self.poles as f64 * most(self.pole_mass));
        if cart < poles * Self::LIGHTEST_CART {
            return Err(MassError::CartTooLight { cart, poles });
        }
        Ok(())
    }
}

impl CoupledCartPole {
    /// Applies [`CartPoleSystem::check`].
    ///
    /// # Errors
    /// Returns a [`MassError`] for the first invalid parameter.
    pub fn check(&self) -> Result<(), MassError> {
        self.0.check()
    }
}
