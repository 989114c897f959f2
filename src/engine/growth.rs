//! [`Growth`]: how an adjoint grows on its way back through a rollout, and what that says of it.

use crate::engine::adjoint::Flow;
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
}

/// What many samples say together.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Together {
    samples: usize,
    along: f64,
    stretch: f64,
}

impl Together {
    pub(crate) fn add(&mut self, meter: &Meter) {
        self.samples += 1;
        self.along += meter.along;
        self.stretch = self.stretch.max(meter.stretch);
    }

    /// Nothing of no samples.
    pub(crate) fn growth(&self) -> Option<Growth> {
        (self.samples > 0).then(|| Growth { along: self.along / self.samples as f64, stretch: self.stretch })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stretch_is_the_worst_one_and_the_whole_may_still_decay() {
        let mut meter = Meter::default();
        // Lengths 1, 10, 1000, 1, 0.01, 0.1: squares are what it is told.
        for (before, after) in [(1.0, 1e2), (1e2, 1e6), (1e6, 1.0), (1.0, 1e-4), (1e-4, 1e-2)] {
            meter.step(before, after, 0);
        }
        assert!((meter.along + 1.0).abs() < 1e-12 && (meter.stretch - 3.0).abs() < 1e-12, "{meter:?}");
        // What was taken out as a power of two counts.
        meter.step(1.0, 1.0, 100);
        assert!((meter.along + 1.0 - 100.0 * 2f64.log10()).abs() < 1e-9, "{meter:?}");
        // Where there is nothing, nothing grows; where nothing is left, all of it has vanished.
        meter.step(0.0, 0.0, 0);
        assert!(meter.along.is_finite());
        meter.step(1.0, 0.0, 0);
        assert_eq!(meter.along, f64::NEG_INFINITY);
    }

    #[test]
    fn words_are_said_where_and_only_where_a_flow_is_not_to_be_trusted() {
        let growth = |along: f64, stretch: f64| Growth { along, stretch };
        let said = |flow: Flow, growth: Growth, epsilon: f64| growth.warning(flow, 1000, epsilon).unwrap_or_default();
        let (single, double) = (f64::from(f32::EPSILON), f64::EPSILON);
        // Of 7 digits after 10 decades, 690 of 1000 steps are left.
        assert!(said(Flow::REGULAR, growth(2.0, 10.0), single).contains("beyond about 692 of the 1000 steps"));
        assert_eq!(said(Flow::REGULAR, growth(2.0, 10.0), double), "");
        assert_eq!(said(Flow::REGULAR, growth(-30.0, 1.0), single), "");
        assert!(said(Flow::REGULAR, growth(20.0, 20.0), double).contains("R grows by up to 10^20"));
        assert!(said(Flow::MODIFIED, growth(4.0, 4.0), double).contains("M grows by 10^4"));
        assert_eq!(said(Flow::MODIFIED, growth(2.0, 9.0), double), "");
        assert_eq!(said(Flow::STOPPED, growth(f64::NEG_INFINITY, 0.0), double), "");
    }
}
