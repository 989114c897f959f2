//! Masses that can be computed with.

use super::{CartPoleSystem, CoupledCartPole};

/// A cart and poles that are no physics, or none that rounding leaves.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MassError {
    /// A mass or a length that nothing has.
    #[error("{what} is {value}: it has to be positive and finite, or the mass matrix is singular; write a small one for none")]
    NotPositive {
        /// The parameter.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A cart that is lost in the sum of the masses.
    #[error(
        "the cart's mass of {cart:.1e} kg is lost beside {poles:.1e} kg of poles: of M, their sum, it would keep fewer than seven \
         digits. Use a cart of {:.1e} kg at least, or lighter poles",
        poles * CartPoleSystem::LIGHTEST_CART
    )]
    CartTooLight {
        /// Mass of the cart, kg.
        cart: f64,
        /// Mass of all poles, kg.
        poles: f64,
    },
    /// No poles, or more than there is room for.
    #[error("{poles} poles: between 1 and {most} can be computed with")]
    Poles {
        /// How many there are.
        poles: usize,
        /// The most there can be.
        most: usize,
    },
}

impl CartPoleSystem {
    /// The least mass of a cart, in units of that of all poles.
    ///
    /// The equations of motion are solved to rounding for lighter carts too, and for none at all, for uniform poles have
    /// inertia of their own; but what is then computed is no longer the motion of a cart of this mass.
    pub const LIGHTEST_CART: f64 = 1e-9;

    /// Whether its masses can be computed with, and its poles are not too many.
    ///
    /// A negative mass of the cart is the one that is dangerous: the equations have solutions until it is minus a quarter of
    /// the poles', where they are singular, but free motion gains energy without end.
    ///
    /// # Errors
    /// [`MassError`].
    pub fn check(&self) -> Result<(), MassError> {
        self.check_up_to(Self::MOST_POLES)
    }

    pub(crate) fn check_up_to(&self, most: usize) -> Result<(), MassError> {
        if !(1..=most).contains(&self.poles) {
            return Err(MassError::Poles { poles: self.poles, most });
        }
        let parameters =
            [("the cart's mass", self.cart_mass), ("a pole's mass", self.pole_mass), ("a pole's half length", self.half_length)];
        if let Some((what, value)) = parameters.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite())) {
            return Err(MassError::NotPositive { what, value });
        }
        let poles = self.poles as f64 * self.pole_mass;
        if self.cart_mass < poles * Self::LIGHTEST_CART {
            return Err(MassError::CartTooLight { cart: self.cart_mass, poles });
        }
        Ok(())
    }
}

impl CoupledCartPole {
    /// As [`CartPoleSystem::check`].
    ///
    /// # Errors
    /// [`MassError`].
    pub fn check(&self) -> Result<(), MassError> {
        self.0.check()
    }
}
