//! Moving average of the direction of a gradient.

use crate::engine::gradient::Gradient;
use crate::numbers::scalar::Float;
use crate::numbers::zip::zip;

/// Updates `average` with the direction of `gradient`: a ← w a + (1 - w) g / ‖g‖, with the weight
/// w. Replaces `gradient` by ‖g‖ a. `norm` is the norm of the values of the gradient, without its
/// exponent.
pub(super) fn average_direction<F: Float>(
    average: &mut [F],
    weight: f64,
    gradient: &mut Gradient<F>,
    norm: f64,
) {
    let exponent = gradient.exponent();
    for (average, value) in zip(average.iter_mut(), gradient.values_mut(exponent)) {
        // A gradient of 0 has no direction.
        let direction = if norm > 0.0 { value.as_() / norm } else { 0.0 };
        *average = F::from_f64(weight * average.as_() + (1.0 - weight) * direction);
        *value = F::from_f64(average.as_() * norm);
    }
}
