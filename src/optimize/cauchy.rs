//! Decrease of the cost that a gradient step predicts: a test of convergence that does not depend on
//! the regularization.

use super::derivatives::Expansion;
use super::options::Bounds;
use nalgebra::DVector;

impl Expansion {
    /// Predicted decrease of the cost along the projected negative gradient, within the bounds, by
    /// the quadratic model of this expansion. The step has the length that is optimal for the
    /// absolute curvature along the gradient.
    pub(super) fn cauchy_decrease(&self, u: &[f64], bounds: &Bounds) -> f64 {
        let m = self.damping.len();
        let projected =
            |(i, (&u, &gradient)): (usize, (&f64, &f64))| -bounds.projected(i % m, u, gradient);
        let mut change: Vec<f64> =
            u.iter().zip(&self.by_control).enumerate().map(projected).collect();
        let [slope, curvature] = self.along(&change);
        if slope == 0.0 {
            return 0.0;
        }
        let length = -slope / curvature.abs();
        for (change, u) in change.chunks_mut(m).zip(u.chunks(m)) {
            for (change, [low, high]) in change.iter_mut().zip(bounds.changes(u)) {
                *change = (*change * length).max(low).min(high);
            }
        }
        let [slope, curvature] = self.along(&change);
        -slope - 0.5 * curvature.abs()
    }

    /// Slope and second derivative of the cost along a change of all controls, `[step][control]`.
    fn along(&self, change: &[f64]) -> [f64; 2] {
        let (n, m) = (self.gradient.len(), self.damping.len());
        let slope =
            self.by_control.iter().zip(change).map(|(gradient, change)| gradient * change).sum();
        let (mut x, mut curvature) = (DVector::zeros(n), 0.0);
        for (step, change) in self.steps.iter().zip(change.chunks(m)) {
            let z = DVector::from_iterator(n + m, x.iter().chain(change).copied());
            curvature += z.dot(&(&step.hessian * &z));
            x = &step.dynamics * z;
        }
        [slope, curvature + x.dot(&(&self.hessian * &x))]
    }
}
