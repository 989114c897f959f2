//! [`Growth`]: growth of an adjoint along a rollout, and the warnings derived from it.

use crate::engine::flow::Flow;
use serde::{Deserialize, Serialize};

/// Growth of the adjoint of one flow along a rollout, in decades (log10 of a ratio of norms).
///
/// One step contributes `log10(‖λ_t‖ / ‖λ_{t+1} + ∂l/∂x_{t+1}‖)`. The cost gradient `∂l/∂x_{t+1}`
/// therefore does not count as growth. The cost gradient `∂l/∂x_t`, a part of λ_t, does. A step
/// contributes nothing if the flow is truncated there, or if the denominator is 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Growth from the last state to the initial state, mean over samples. Negative if the adjoint
    /// vanishes, -∞ if the adjoint of a sample becomes 0.
    pub along: f64,
    /// Largest growth over any range of consecutive steps without a cut or truncation, maximum over
    /// samples. At least 0.
    pub worst_window: f64,
}

/// Threshold of the warning about the growth of M along a rollout, in decades.
const UNSTABLE: f64 = 3.0;

impl Growth {
    /// Returns a warning if the growth makes the gradient of `flow` unreliable or unbalanced.
    ///
    /// `horizon` is the number of steps of a rollout, `epsilon` the machine epsilon of its
    /// precision.
    ///
    /// - R and N: rounding errors of the forward pass grow like the adjoint of R. If `worst_window`
    ///   exceeds the number of decimal digits, `-log10(epsilon)`, contributions of early steps have
    ///   unreliable signs.
    /// - M ignores the policy's response to deviations. If the plant is unstable without this
    ///   response, M grows. The first steps then outweigh the last by a factor of 10^`along`. Warns
    ///   above 3 decades.
    pub fn warning(&self, flow: Flow, horizon: usize, epsilon: f64) -> Option<String> {
        let digits = -epsilon.log10();
        let Self { along, worst_window } = *self;
        if flow.control != 0.0 && worst_window > digits {
            let steps = (horizon as f64 * digits / worst_window) as usize;
            let precise = if digits < 10.0 { "f64, " } else { "" };
            return Some(format!(
                "{flow} grows by up to 10^{worst_window:.0} along a rollout, and numbers have {digits:.0} digits. Before the last {steps} \
                 of the {horizon} steps, its signs are unreliable. Use {precise}a shorter horizon, or M"
            ));
        }
        if flow.letter() == "M" && along > UNSTABLE {
            return Some(format!(
                "M grows by 10^{along:.0} along a rollout, because the plant is unstable without the policy's response. The first steps \
                 outweigh the last. Clip by norm, shorten the horizon, or use R"
            ));
        }
        None
    }
}

/// Accumulates the growth of one sample's adjoint.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Meter {
    along: f64,
    /// Largest growth of a range that ends at the current step.
    running: f64,
    worst_window: f64,
    /// Growth since the last cut of the adjoint, or since it last became 0.
    since_cut: f64,
}

impl Meter {
    /// Adds one step, from the squared norms of the stored values before and after it.
    ///
    /// `exponent` is the change of the exponent of the sample. The ratio of the norms of λ is
    /// 2^`exponent` times that of the stored values.
    pub(crate) fn step(&mut self, before: f64, after: f64, exponent: i32) {
        if before == 0.0 {
            return;
        }
        let decades = 0.5 * (after.log10() - before.log10())
            + f64::from(exponent) * std::f64::consts::LOG10_2;
        self.along += decades;
        // Later growth must not add to -∞.
        self.since_cut = if after == 0.0 { 0.0 } else { self.since_cut + decades };
        self.running = (self.running + decades).max(0.0);
        self.worst_window = self.worst_window.max(self.running);
    }

    /// Growth along the rollout, and largest growth of a range of steps.
    pub(crate) fn growth(&self) -> [f64; 2] {
        [self.along, self.worst_window]
    }

    /// Growth since the last cut, or since the adjoint last became 0.
    pub(crate) fn since_cut(&self) -> f64 {
        self.since_cut
    }

    /// Registers a cut of the adjoint. Ranges of steps end there.
    pub(crate) fn cut(&mut self) {
        (self.running, self.since_cut) = (0.0, 0.0);
    }
}

/// Combines the growth of many samples.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct GrowthStats {
    samples: usize,
    along: f64,
    worst_window: f64,
}

impl GrowthStats {
    pub(crate) fn add(&mut self, [along, worst_window]: [f64; 2]) {
        self.samples += 1;
        self.along += along;
        self.worst_window = self.worst_window.max(worst_window);
    }

    /// Mean and largest growth. `None` without samples.
    pub(crate) fn growth(&self) -> Option<Growth> {
        (self.samples > 0).then(|| Growth {
            along: self.along / self.samples as f64,
            worst_window: self.worst_window,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn norms_that_decay_by_one_decade_have_a_worst_window_of_three_decades() {
        let mut meter = Meter::default();
        // Norms 1, 10, 1000, 1, 0.01, 0.1; `step` takes squares.
        for (before, after) in [(1.0, 1e2), (1e2, 1e6), (1e6, 1.0), (1.0, 1e-4), (1e-4, 1e-2)] {
            meter.step(before, after, 0);
        }
        assert!(
            (meter.along + 1.0).abs() < 1e-12 && (meter.worst_window - 3.0).abs() < 1e-12,
            "{meter:?}"
        );
        // A change of the exponent counts as growth.
        meter.step(1.0, 1.0, 100);
        assert!((meter.along + 1.0 - 100.0 * 2f64.log10()).abs() < 1e-9, "{meter:?}");
        // A zero adjoint contributes no growth. An adjoint that becomes zero contributes -∞.
        meter.step(0.0, 0.0, 0);
        assert!(meter.along.is_finite());
        meter.step(1.0, 0.0, 0);
        assert_eq!(meter.along, f64::NEG_INFINITY);
    }

    #[test]
    fn r_warns_of_growth_beyond_its_digits_and_m_of_growth_beyond_3_decades() {
        let growth = |along: f64, worst_window: f64| Growth { along, worst_window };
        let warning = |flow: Flow, growth: Growth, epsilon: f64| {
            growth.warning(flow, 1000, epsilon).unwrap_or_default()
        };
        let (single, double) = (f64::from(f32::EPSILON), f64::EPSILON);
        // f32 has 6.92 digits. The adjoint grows by 10 decades in 1000 steps, by 6.92 in 692.
        assert!(
            warning(Flow::REGULAR, growth(2.0, 10.0), single)
                .contains("Before the last 692 of the 1000 steps")
        );
        assert_eq!(warning(Flow::REGULAR, growth(2.0, 10.0), double), "");
        assert_eq!(warning(Flow::REGULAR, growth(-30.0, 1.0), single), "");
        assert!(
            warning(Flow::REGULAR, growth(20.0, 20.0), double).contains("R grows by up to 10^20")
        );
        assert!(warning(Flow::MODIFIED, growth(4.0, 4.0), double).contains("M grows by 10^4"));
        assert_eq!(warning(Flow::MODIFIED, growth(2.0, 9.0), double), "");
        assert_eq!(warning(Flow::STOPPED, growth(f64::NEG_INFINITY, 0.0), double), "");
    }
}
