//! [`Field`]: the vector field that the optimizer follows. [`GradientCombiner`]: custom fields.

use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::numbers::scalar::Float;
use crate::train::combination::Combination;
use std::fmt;
use std::str::FromStr;

/// Vector field over the parameters: the gradient of one [`Flow`], or a combination of the
/// gradients of two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Field<C = Combination> {
    /// Gradient of one flow.
    Flow(Flow),
    /// Combination of two gradients of the same mini-batch.
    Composed {
        /// Flow of the first gradient.
        first: Flow,
        /// Flow of the second gradient.
        second: Flow,
        /// Rule that combines the gradients.
        by: C,
    },
}

/// Combines two gradients into one vector. Implement it to train with a custom field.
/// [`Combination`] contains the rules of the library.
///
/// ```
/// use physgrad::{Field, Float, Flow, train::GradientCombiner};
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
    /// Writes the combination into `out`. All three slices have one element per parameter.
    fn combine<F: Float>(&self, first: &[F], second: &[F], out: &mut [F]);
    /// Returns true if a positive factor of `second` does not change the result of `combine`.
    ///
    /// The exponents of the two gradients ([`Gradient::exponent`]) may then differ. Otherwise,
    /// [`Field::combine`] brings both gradients to the larger exponent first.
    fn ignores_size_of_second(&self) -> bool {
        false
    }
    /// Writes the combination of two gradients, whose exponents may differ, into `out`.
    #[doc(hidden)]
    fn combine_gradients<F: Float>(
        &self,
        first: &Gradient<F>,
        second: &Gradient<F>,
        out: &mut Gradient<F>,
    ) {
        let exponent = common_exponent(first, second);
        if self.ignores_size_of_second() || first.exponent() == second.exponent() {
            self.combine(first.values(), second.values(), out.values_mut(first.exponent()));
        } else {
            let [first, second] =
                [first, second].map(|gradient| gradient.clone().with_exponent(exponent));
            self.combine(first.values(), second.values(), out.values_mut(exponent));
        }
    }
}

/// Larger exponent of two gradients, or 0 if both are zero. Ignores the exponent of a zero
/// gradient, which has no meaning.
pub(super) fn common_exponent<F: Float>(first: &Gradient<F>, second: &Gradient<F>) -> i32 {
    let is_nonzero = |gradient: &&Gradient<F>| gradient.values().iter().any(|&g| g != F::zero());
    [first, second].into_iter().filter(is_nonzero).map(Gradient::exponent).max().unwrap_or(0)
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
        Self::of(Combination::SignAgreement)
    }
    /// P: M without the component that opposes R.
    pub const fn projected() -> Self {
        Self::of(Combination::Projection)
    }
    /// F: direction of equal angles to M and R.
    pub const fn conflict_free() -> Self {
        Self::of(Combination::ConflictFree)
    }
    /// MR: absolute values of M with the signs of R.
    pub const fn modified_signed() -> Self {
        Self::of(Combination::SignsOfSecond)
    }
    /// RM: R with the norm of M.
    pub const fn regular_scaled() -> Self {
        Self::of(Combination::NormOfFirst)
    }
    /// Combines M and R by this rule.
    const fn of(by: Combination) -> Self {
        Self::Composed { first: Flow::MODIFIED, second: Flow::REGULAR, by }
    }

    /// All fields of the paper.
    pub const PAPER: [Self; 5] =
        [Self::combined(), Self::regular(), Self::modified(), Self::network(), Self::stopped()];
    /// All fields: those of the paper, then the other combinations of M and R.
    pub const ALL: [Self; 9] = [
        Self::combined(),
        Self::regular(),
        Self::modified(),
        Self::network(),
        Self::stopped(),
        Self::projected(),
        Self::conflict_free(),
        Self::modified_signed(),
        Self::regular_scaled(),
    ];
}

impl<C: GradientCombiner> Field<C> {
    /// Combines the gradients of two flows with a custom rule.
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
            Self::Composed { first, second, by } => {
                Self::Composed { first: change(first), second: change(second), by }
            }
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

    /// Combines the gradients of [`flows`](Field::flows) into `out`, or copies a single gradient.
    ///
    /// # Panics
    /// If the number of gradients differs from the number of flows.
    #[inline(never)]
    pub fn combine<F: Float>(&self, gradients: &[Gradient<F>], out: &mut Gradient<F>) {
        match (self, gradients) {
            (Self::Flow(_), [gradient]) => out.copy_from(gradient),
            (Self::Composed { by, .. }, [first, second]) => {
                by.combine_gradients(first, second, out)
            }
            _ => panic!(
                "got {} gradients for the {} flows of field {}",
                gradients.len(),
                self.flows().len(),
                self.name()
            ),
        }
    }
}

impl Field {
    /// Letters of the field, for legends: those of the paper, or P, F, MR and RM.
    pub fn letter(&self) -> &'static str {
        match self {
            Self::Flow(flow) => flow.letter(),
            Self::Composed { by, .. } => by.letter(),
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

/// Error for a name that matches no field.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown field `{0}`; expected combined, regular, modified, network, stopped, projected, conflict_free, modified_signed or \
     regular_scaled (C, R, M, N, S, P, F, MR, RM)"
)]
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
