//! [`Field`]: the vector field that the optimizer follows.

use crate::engine::adjoint::Flow;
use crate::engine::gradient::Gradient;
use crate::numbers::scalar::Float;
use std::fmt;
use std::str::FromStr;

/// The gradient of one [`Flow`], or a composition of two. Knows nothing but flat slices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Field<C = SignAgreement> {
    /// The gradient of one flow.
    Flow(Flow),
    /// Two gradients of the same rollout, made into one vector.
    Composed {
        /// The first gradient.
        first: Flow,
        /// The second gradient.
        second: Flow,
        /// What is made of them.
        by: C,
    },
}

/// Makes one vector of two gradients. Implement it to follow a field of your own.
///
/// ```
/// use physgrad::{Compose, Field, Float, Flow};
///
/// /// The mean of the two.
/// #[derive(Clone, Copy)]
/// struct Mean;
///
/// impl Compose for Mean {
///     fn name(&self) -> &str {
///         "mean"
///     }
///     fn compose<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]) {
///         for ((out, &a), &b) in out.iter_mut().zip(first).zip(second) {
///             *out = (a + b) * F::lift(0.5);
///         }
///     }
/// }
///
/// let field = Field::composed(Flow::MODIFIED, Flow::REGULAR, Mean);
/// assert_eq!(field.flows(), [Flow::MODIFIED, Flow::REGULAR]);
/// ```
pub trait Compose: Sync + Send {
    /// Its name, for records.
    fn name(&self) -> &str;
    /// Writes `out`; all three have the length of `θ`.
    fn compose<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]);
    /// Whether nothing of the second gradient is used but signs. Then it may be beyond the range of all numbers; else one of two
    /// that have different exponents ([`Gradient`]) is brought to that of the other before they are composed.
    fn by_signs_of_second(&self) -> bool {
        false
    }
}

/// The first gradient, in the components in which both have the same strict sign; else 0. Of M and R it makes the
/// paper's combined gradient C.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SignAgreement;

impl Compose for SignAgreement {
    fn name(&self) -> &str {
        "combined"
    }
    fn compose<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]) {
        let zero = F::zero();
        for ((out, &m), &r) in out.iter_mut().zip(first).zip(second) {
            // Not by signum, for which 0 and a NaN have a sign too.
            *out = if (m > zero && r > zero) || (m < zero && r < zero) { m } else { zero };
        }
    }
    fn by_signs_of_second(&self) -> bool {
        true
    }
}

impl Field {
    /// R: the true gradient.
    pub const fn regular() -> Self {
        Self::Flow(Flow::REGULAR)
    }
    /// M: the physics path only.
    pub const fn modified() -> Self {
        Self::Flow(Flow::MODIFIED)
    }
    /// N: the network path only.
    pub const fn network() -> Self {
        Self::Flow(Flow::NETWORK)
    }
    /// S: one-step gradients.
    pub const fn stopped() -> Self {
        Self::Flow(Flow::STOPPED)
    }
    /// C: M where M and R agree in sign.
    pub const fn combined() -> Self {
        Self::Composed { first: Flow::MODIFIED, second: Flow::REGULAR, by: SignAgreement }
    }
    /// The five of the paper.
    pub const ALL: [Self; 5] = [Self::combined(), Self::regular(), Self::modified(), Self::network(), Self::stopped()];
}

impl<C: Compose> Field<C> {
    /// Any composition of two flows.
    pub const fn composed(first: Flow, second: Flow, by: C) -> Self {
        Self::Composed { first, second, by }
    }

    /// The flows whose gradients it needs, in order.
    pub fn flows(&self) -> Vec<Flow> {
        match *self {
            Self::Flow(flow) => vec![flow],
            Self::Composed { first, second, .. } => vec![first, second],
        }
    }

    /// Its name.
    pub fn name(&self) -> &str {
        match self {
            Self::Flow(Flow::REGULAR) => "regular",
            Self::Flow(Flow::MODIFIED) => "modified",
            Self::Flow(Flow::NETWORK) => "network",
            Self::Flow(_) => "stopped",
            Self::Composed { by, .. } => by.name(),
        }
    }

    /// Its vector, from the gradients of [`flows`](Field::flows).
    ///
    /// # Panics
    /// If there are not as many gradients as flows.
    pub fn compose<F: Float>(&self, gradients: &[Gradient<F>], out: &mut Gradient<F>) {
        match (self, gradients) {
            (Self::Flow(_), [gradient]) => out.copy_from(gradient),
            (Self::Composed { by, .. }, [first, second]) => {
                let exponent = first.exponent().max(second.exponent());
                if by.by_signs_of_second() || first.exponent() == second.exponent() {
                    by.compose(first.values(), second.values(), out.values_mut(first.exponent()));
                } else {
                    let [first, second] = [first, second].map(|gradient| gradient.clone().with_exponent(exponent));
                    by.compose(first.values(), second.values(), out.values_mut(exponent));
                }
            }
            _ => panic!("{} gradients for the {} flows of {}", gradients.len(), self.flows().len(), self.name()),
        }
    }
}

impl Field {
    /// Its letter in the paper.
    pub fn letter(&self) -> &'static str {
        match self.name() {
            "regular" => "R",
            "modified" => "M",
            "network" => "N",
            "stopped" => "S",
            _ => "C",
        }
    }
}

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Field {
    type Err = UnknownField;
    fn from_str(name: &str) -> Result<Self, UnknownField> {
        Self::ALL.into_iter().find(|f| f.name() == name || f.letter() == name).ok_or_else(|| UnknownField(name.into()))
    }
}

/// A name that is none of the paper's fields.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown field `{0}`; expected combined, regular, modified, network or stopped (C, R, M, N, S)")]
pub struct UnknownField(String);

/// A [`Field`] in one precision.
pub(crate) trait AnyField<F: Float>: Sync {
    fn compose(&self, gradients: &[Gradient<F>], composed: &mut Gradient<F>);
}

impl<C: Compose, F: Float> AnyField<F> for Field<C> {
    fn compose(&self, gradients: &[Gradient<F>], composed: &mut Gradient<F>) {
        Field::compose(self, gradients, composed);
    }
}
