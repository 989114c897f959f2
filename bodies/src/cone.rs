//! [`Law`]: forces of a contact as a function of its acceleration, for pyramidal and elliptic cones.
//!
//! `s` is the acceleration of the contact over its reference: normal, and two tangents. Forces are
//! the negative gradient of a convex cost φ(s), so a contact is one block with the force f = -∇φ
//! and the stiffness W = ∇²φ. Both are proportional to the weight of the normal row. Source:
//! MuJoCo documentation, chapter Computation, sections Friction cones and Reduced primal problem.

use crate::spatial::V;
use physgrad::Scalar;

/// Kind of a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Law {
    /// Only a normal force.
    Frictionless,
    /// Four edges, the normal plus and minus friction times a tangent.
    Pyramidal,
    /// A circular cone. The ratio of impedances is that of the model.
    Elliptic,
}

/// Symmetric matrix: nn, 11, 22, n1, n2, 12.
pub(crate) type Block<T> = [T; 6];

/// Weight of the normal row, coefficient of friction, and ratio of impedances.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone<T> {
    pub(crate) law: Law,
    pub(crate) weight: T,
    pub(crate) friction: T,
    pub(crate) ratio: f64,
}

impl<T: Scalar> Cone<T> {
    /// Force and stiffness.
    #[inline(always)]
    pub(crate) fn force(&self, s: V<T>) -> (V<T>, Block<T>) {
        let (o, d) = (T::zero(), self.weight);
        match self.law {
            Law::Frictionless => {
                let w = T::select_lt(s[0], o, d, o);
                ([-(w * s[0]), o, o], [w, o, o, o, o, o])
            }
            Law::Pyramidal => self.pyramidal(s),
            Law::Elliptic => self.elliptic(s),
        }
    }

    #[inline(always)]
    fn pyramidal(&self, s: V<T>) -> (V<T>, Block<T>) {
        let (o, mu) = (T::zero(), self.friction);
        let (mut f, mut w) = ([o; 3], [o; 6]);
        for t in 0..2 {
            let slide = s[1 + t] * mu;
            let (plus, minus) = (s[0] + slide, s[0] - slide);
            let a = T::select_lt(plus, o, self.weight, o);
            let b = T::select_lt(minus, o, self.weight, o);
            let (fa, fb) = (a * plus, b * minus);
            f[0] -= fa + fb;
            f[1 + t] = (fb - fa) * mu;
            w[0] += a + b;
            w[1 + t] = (a + b) * mu * mu;
            w[3 + t] = (a - b) * mu;
        }
        (f, w)
    }

    #[inline(always)]
    fn elliptic(&self, s: V<T>) -> (V<T>, Block<T>) {
        let (o, d, mu) = (T::zero(), self.weight, self.friction);
        let Sliding { speed, along: [c1, c2], soft, over, sticks } = self.sliding(s);
        // Sliding: φ = ½ soft over², where over = sₙ - μ |sₜ| < 0.
        let normal = -(soft * over);
        let tangent = soft * over * mu;
        let cross = -(soft * mu);
        let (outer, ring) = (soft * mu * mu, -(soft * over * mu) / speed);
        let side = d * self.ratio;
        let choose =
            |hold: T, slide: T| T::select_lt(over, o, T::select_lt(o, sticks, slide, hold), o);
        (
            [
                choose(-(d * s[0]), normal),
                choose(-(side * s[1]), tangent * c1),
                choose(-(side * s[2]), tangent * c2),
            ],
            [
                choose(d, soft),
                choose(side, outer * c1 * c1 + ring * c2 * c2),
                choose(side, outer * c2 * c2 + ring * c1 * c1),
                choose(o, cross * c1),
                choose(o, cross * c2),
                choose(o, (outer - ring) * c1 * c2),
            ],
        )
    }

    #[inline(always)]
    fn sliding(&self, s: V<T>) -> Sliding<T> {
        let mu = self.friction;
        let square = s[1] * s[1] + s[2] * s[2];
        let speed = square.max(1e-30).sqrt();
        let regular = mu * mu / self.ratio;
        Sliding {
            speed,
            along: [s[1] / speed, s[2] / speed],
            soft: self.weight / (regular + 1.0),
            over: s[0] - mu * speed,
            sticks: regular * s[0] + mu * speed,
        }
    }

    /// Derivative of the force with respect to the coefficient of friction, at constant weight.
    #[inline(always)]
    pub(crate) fn by_friction(&self, s: V<T>) -> V<T> {
        let (o, mu) = (T::zero(), self.friction);
        let mut f = [o; 3];
        match self.law {
            Law::Frictionless => {}
            Law::Pyramidal => {
                for t in 0..2 {
                    let slide = s[1 + t] * mu;
                    let (plus, minus) = (s[0] + slide, s[0] - slide);
                    let a = T::select_lt(plus, o, self.weight, o);
                    let b = T::select_lt(minus, o, self.weight, o);
                    f[0] -= (a - b) * s[1 + t];
                    f[1 + t] = b * minus - a * plus - (a + b) * slide;
                }
            }
            Law::Elliptic => {
                let Sliding { speed, along, soft, over, sticks } = self.sliding(s);
                let regular = mu * mu / self.ratio;
                let slope = -(soft * mu * (2.0 / self.ratio)) / (regular + 1.0);
                let change = slope * over - soft * speed;
                let side = change * mu + soft * over;
                let zone = |x: T| T::select_lt(over, o, T::select_lt(o, sticks, x, o), o);
                f = [zone(-change), zone(side * along[0]), zone(side * along[1])];
            }
        }
        f
    }
}

/// Quantities of the sliding zone of an elliptic cone.
struct Sliding<T> {
    /// Length and direction of the tangential part.
    speed: T,
    along: [T; 2],
    /// Weight of the sliding zone.
    soft: T,
    /// Distance from the polar cone; the contact is active below 0.
    over: T,
    /// The contact sticks below 0.
    sticks: T,
}
