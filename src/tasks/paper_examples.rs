//! Tasks for the two-parameter examples of "Stabilizing Backpropagation Through Time to Learn
//! Complex Physics" (ICLR 2024).

use crate::dynamics::inputs::{Cotangents, Inputs, Start, add};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;

/// Simplest physics, with the next state `x' = x + u`. The Jacobian `∂x'/∂x` is the identity, so
/// cotangents neither grow nor decay along a rollout.
///
/// State and control have the same number of components, without units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Accumulator {
    /// Number of components of state and control.
    pub dim: usize,
}

impl System for Accumulator {
    fn state_dim(&self) -> usize {
        self.dim
    }

    fn control_dim(&self) -> usize {
        self.dim
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        for ((next, &x), &u) in zip(zip(next.iter_mut(), x), u) {
            *next = x + u;
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        for bar in [cotangents.x, cotangents.u].into_iter().flatten() {
            add(bar, next_bar);
        }
    }
}

/// Task of the paper's figure 1: from one initial state to a target, `L = (x_T - y)² / 2`. Default
/// values are those of the paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// System to control, with one component.
    pub system: Accumulator,
    /// Initial state x_0.
    pub start: f64,
    /// Target y.
    pub target: f64,
    /// Number of steps.
    pub horizon: usize,
}

impl Default for Reach {
    fn default() -> Self {
        Self { system: Accumulator { dim: 1 }, start: -0.3, target: 2.0, horizon: 4 }
    }
}

impl Task for Reach {
    type System = Accumulator;

    fn system(&self) -> &Accumulator {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    fn start(&self, _rng: &mut Rng, start: Start<'_>) {
        start.x.fill(self.start);
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        let miss = x[0] - self.target;
        miss * miss * 0.5
    }
}

/// Task for the paper's figure 2: an elongated bowl in the plane. The paper does not state the loss
/// of that figure.
///
/// The rollout is one step from the origin, so the control equals the final state. The loss is
/// `L = (a p² + b q²) / 2`, where p and q are the components of x_1 along the axes of the bowl.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bowl {
    /// System to control, with two components.
    pub system: Accumulator,
    /// Curvatures a and b.
    pub curvatures: [f64; 2],
    /// Angle from the axis of the first component to that of curvature a, counter-clockwise, rad.
    pub angle: f64,
}

impl Default for Bowl {
    /// Returns curvatures 1 and 4, rotated by 30°. An axis-aligned bowl would favor Adam, which
    /// scales each component separately.
    fn default() -> Self {
        Self {
            system: Accumulator { dim: 2 },
            curvatures: [1.0, 4.0],
            angle: std::f64::consts::FRAC_PI_6,
        }
    }
}

impl Task for Bowl {
    type System = Accumulator;

    fn system(&self) -> &Accumulator {
        &self.system
    }

    fn horizon(&self) -> usize {
        1
    }

    fn start(&self, _rng: &mut Rng, start: Start<'_>) {
        start.x.fill(0.0);
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        let (sin, cos) = self.angle.sin_cos();
        let (sin, cos) = (T::from(sin), T::from(cos));
        let (p, q) = (x[0] * cos + x[1] * sin, x[1] * cos - x[0] * sin);
        let [a, b] = self.curvatures.map(|curvature| T::from(0.5 * curvature));
        p * p * a + q * q * b
    }
}
