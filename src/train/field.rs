//! [`Field`]: the vector field that the optimizer follows. [`GradientCombiner`]: custom fields.

use crate::engine::adjoint::Flow;
use crate::engine::gradient::Gradient;
use crate::numbers::scalar::Float;
use std::fmt;
use std::str::FromStr;

/// Vector field over the parameters: the gradient of one [`Flow`], or a composition of two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Field<C = SignAgreement> {
    /// Gradient of one flow.
    Flow(Flow),
    /// Composition of two gradients of the same rollout.
    Composed {
        /// Flow of the first gradient.
        first: Flow,
        /// Flow of the second gradient.
        second: Flow,
        /// Rule of composition.
        by: C,
    },
}

/// Composes two gradients into one vector. Implement it to train with a custom field.
///
/// ```
/// use physgrad::{GradientCombiner, Field, Float, Flow};
///
/// /// Mean of both gradients.
/// #[derive(Clone, Copy)]
/// struct Mean;
///
/// impl GradientCombiner for Mean {
///     fn name(&self) -> &str {
///         "mean"
///     }
///     fn combine<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]) {
///         for ((out, &a), &b) in out.iter_mut().zip(first).zip(second) {
///             *out = (a + b) * F::from_f64(0.5);
///         }
///     }
/// }
///
/// let field = Field::custom(Flow::MODIFIED, Flow::REGULAR, Mean);
/// assert_eq!(field.flows(), [Flow::MODIFIED, Flow::REGULAR]);
/// ```
pub trait GradientCombiner: Sync + Send {
    /// Name, used in messages.
    fn name(&self) -> &str;
    /// Writes the composition into `out`. All three slices have one element per parameter.
    fn combine<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]);
    /// Returns true if `combine` uses only the signs of `second`.
    ///
    /// The exponents of the two gradients ([`Gradient::exponent`]) may then differ. Otherwise both
    /// are brought to the larger exponent before the composition.
    fn by_signs_of_second(&self) -> bool {
        false
    }
}

/// Components of the first gradient whose sign is that of the second; 0 elsewhere.
///
/// M and R yield the combined gradient C of the paper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SignAgreement;

impl GradientCombiner for SignAgreement {
    fn name(&self) -> &str {
        "combined"
    }
    fn combine<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]) {
        let zero = F::zero();
        for ((out, &m), &r) in out.iter_mut().zip(first).zip(second) {
            // `signum` would give 0 a sign.
            *out = if (m > zero && r > zero) || (m < zero && r < zero) { m } else { zero };
        }
    }
    fn by_signs_of_second(&self) -> bool {
        true
    }
}

impl Field {
    /// R: gradient of the loss.
    pub const fn regular() -> Self {
        Self::Flow(Flow::REGULAR)
    }
    /// M: gradient without the path through the observation.
    pub const fn modified() -> Self {
        Self::Flow(Flow::MODIFIED)
    }
    /// N: gradient without the path through the state input of the physics.
    pub const fn network() -> Self {
        Self::Flow(Flow::NETWORK)
    }
    /// S: gradient without paths between steps.
    pub const fn stopped() -> Self {
        Self::Flow(Flow::STOPPED)
    }
    /// C: M where M and R agree in sign.
    pub const fn combined() -> Self {
        Self::Composed { first: Flow::MODIFIED, second: Flow::REGULAR, by: SignAgreement }
    }
    /// All fields of the paper.
    pub const ALL: [Self; 5] = [Self::combined(), Self::regular(), Self::modified(), Self::network(), Self::stopped()];
}

impl<C: GradientCombiner> Field<C> {
    /// Composes two flows with a custom rule.
    pub const fn custom(first: Flow, second: Flow, by: C) -> Self {
        Self::Composed { first, second, by }
    }

    /// Flows whose gradients [`combine`](Field::combine) takes, in order.
    pub fn flows(&self) -> Vec<Flow> {
        match *self {
            Self::Flow(flow) => vec![flow],
            Self::Composed { first, second, .. } => vec![first, second],
        }
    }

    /// Applies `change` to the flows, for instance a truncation.
    ///
    /// ```
    /// use physgrad::Field;
    ///
    /// let field = Field::combined().with_flows(|flow| flow.truncated(32));
    /// assert_eq!(field.flows()[1].truncation, Some(32));
    /// ```
    pub fn with_flows(self, change: impl Fn(Flow) -> Flow) -> Self {
        match self {
            Self::Flow(flow) => Self::Flow(change(flow)),
            Self::Composed { first, second, by } => Self::Composed { first: change(first), second: change(second), by },
        }
    }

    /// Name, as used in settings and messages. Independent of truncation, discount and cuts.
    pub fn name(&self) -> &str {
        match self {
            Self::Flow(flow) => match flow.letter() {
                "R" => "regular",
                "M" => "modified",
                "N" => "network",
                _ => "stopped",
            },
            Self::Composed { by, .. } => by.name(),
        }
    }

    /// Composes the gradients of [`flows`](Field::flows) into `out`.
    ///
    /// # Panics
    /// If the number of gradients differs from the number of flows.
    pub fn combine<F: Float>(&self, gradients: &[Gradient<F>], out: &mut Gradient<F>) {
        match (self, gradients) {
            (Self::Flow(_), [gradient]) => out.copy_from(gradient),
            (Self::Composed { by, .. }, [first, second]) => {
                let exponent = first.exponent().max(second.exponent());
                if by.by_signs_of_second() || first.exponent() == second.exponent() {
                    by.combine(first.values(), second.values(), out.values_mut(first.exponent()));
                } else {
                    let [first, second] = [first, second].map(|gradient| gradient.clone().with_exponent(exponent));
                    by.combine(first.values(), second.values(), out.values_mut(exponent));
                }
            }
            _ => panic!("got {} gradients for the {} flows of field {}", gradients.len(), self.flows().len(), self.name()),
        }
    }
}

impl Field {
    /// Letter used in the paper.
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
        Self::ALL
            .into_iter()
            .find(|f| f.name() == name || f.letter().eq_ignore_ascii_case(name))
            .ok_or_else(|| UnknownField(name.into()))
    }
}

/// Error for a name that matches no field of the paper.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown field `{0}`; expected combined, regular, modified, network or stopped (C, R, M, N, S)")]
pub struct UnknownField(String);

/// Object-safe [`Field`] for one precision.
pub(crate) trait AnyField<F: Float>: Sync {
    fn combine(&self, gradients: &[Gradient<F>], combined: &mut Gradient<F>);
}

impl<C: GradientCombiner, F: Float> AnyField<F> for Field<C> {
    fn combine(&self, gradients: &[Gradient<F>], combined: &mut Gradient<F>) {
        Field::combine(self, gradients, combined);
    }
}
