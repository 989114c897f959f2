//! [`Growth`]: how an adjoint grows on its way back through a rollout, and what that says of it.

use crate::backward::Flow;
use serde::{Deserialize, Serialize};

/// How the adjoint of one flow grew along a rollout, in decades: decimal logarithms of its length.
///
/// Growth is that of what is carried: `log10(‖λ_t‖ / ‖λ_{t+1} + ∂l/∂x‖)`, summed over steps. Gradients of costs that are
/// added on the way do not count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// From the end to the start, the mean over samples; negative where it vanishes, -∞ where nothing is left.
    pub along: f64,
    /// Over the stretch on which it grows the most, the largest over samples; at least 0.
    pub stretch: f64,
}

/// Growth of M along a rollout above which it is pointed out, in decades.
const UNSTABLE: f64 = 3.0;

impl Growth {
    /// What makes the flow untrustworthy over rollouts of so many steps, in words; nothing, if nothing does. `epsilon` is the
    /// distance from 1 to the next number in the precision of the rollouts.
    ///
    /// - A rounding error of the forward pass grows as the adjoint of R does. Over a stretch on which that is by more than
    ///   numbers have digits, what R says of the states before it, signs included, is of another trajectory.
    /// - M leaves out what the policy does about a deviation. On a plant that is unstable without it, M grows, and its first
    ///   steps count 10^growth times as much as the last.
    pub fn warning(&self, flow: Flow, horizon: usize, epsilon: f64) -> Option<String> {
        let digits = -epsilon.log10();
        let Self { along, stretch } = *self;
        if flow.control && stretch > digits {
            let steps = (horizon as f64 * digits / stretch) as usize;
            return Some(format!(
                "{flow} grows by up to 10^{stretch:.0} along a rollout, and numbers have {digits:.0} digits: beyond about {steps} of \
                 the {horizon} steps its signs are those of rounding errors. A shorter horizon helps, f64, or M"
            ));
        }
        if flow == Flow::MODIFIED && along > UNSTABLE {
            return Some(format!(
                "M grows by 10^{along:.0} along a rollout: without what the policy does about it the plant is unstable, and the \
                 first steps outweigh the last. Clipping by norm helps, a shorter horizon, or R"
            ));
        }
        None
    }
}

/// Growth of one sample's adjoint, step by step.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Meter {
    along: f64,
    /// The largest growth of a stretch that ends at the step at hand, and of any.
    running: f64,
    stretch: f64,
}

impl Meter {
    /// One more step, which multiplied the square of the length by this.
    pub(crate) fn step(&mut self, before: f64, after: f64, exponent: i32) {
        if before == 0.0 {
            return;
        }
        let decades = 0.5 * (after.log10() - before.log10()) + f64::from(exponent) * std::f64::consts::LOG10_2;
        self.along += decades;
        self.running = (self.running + decades).max(0.0);
        self.stretch = self.stretch.max(self.running);
    }

    /// What many samples say together.
    pub(crate) fn growth(meters: &[&Meter]) -> Growth {
        Growth {
            along: meters.iter().map(|meter| meter.along).sum::<f64>() / meters.len() as f64,
            stretch: meters.iter().fold(0.0, |largest, meter| largest.max(meter.stretch)),
        }
    }
}
