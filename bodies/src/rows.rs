//! [`Row`]: limits and dry friction, constraints of one degree of freedom, and the softness of all
//! constraints.
//!
//! Constraints are soft, as in MuJoCo. A row with the velocity v and the distance r > 0 outside of
//! the constraint has the reference acceleration `-b v - k d(r) r` and the weight
//! `d / ((1 - d) w)`, where w is the inverse mass of the row in the reference pose and d(r) the
//! impedance. The acceleration minimizes `½ |a - a₀|²_M + Σ ½ weight (J a - reference)²` over
//! active rows. Source: MuJoCo documentation, chapter Computation, section Constraint model.

use crate::model::Softness;
use crate::tree::Tree;
use physgrad::Scalar;

/// Softness of a row with its constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Soft {
    /// Stiffness, 1/s².
    pub(crate) k: f64,
    /// Damping, 1/s.
    pub(crate) b: f64,
    low: f64,
    high: f64,
    width: f64,
    middle: f64,
    power: f64,
    /// Factors of the two branches.
    factors: [f64; 2],
}

impl Soft {
    /// Time constants below two time steps become two time steps.
    pub(crate) fn new(softness: &Softness, dt: f64) -> Self {
        let [time, ratio] = softness.reference;
        let [low, high, width, middle, power] = softness.impedance;
        let (low, high) =
            (low.clamp(IMPEDANCE[0], IMPEDANCE[1]), high.clamp(IMPEDANCE[0], IMPEDANCE[1]));
        let (k, b) = if time > 0.0 {
            let time = time.max(2.0 * dt);
            ((high * time * ratio).powi(-2), 2.0 / (high * time))
        } else {
            (-time / (high * high), -ratio / high)
        };
        let (middle, power) = (middle.clamp(IMPEDANCE[0], IMPEDANCE[1]), power.max(1.0));
        let factors = [middle.powf(1.0 - power), (1.0 - middle).powf(1.0 - power)];
        Self { k, b, low, high, width: width.max(0.0), middle, power, factors }
    }

    /// Impedance at a distance, and its derivative with respect to the absolute distance.
    #[inline(always)]
    pub(crate) fn impedance<T: Scalar>(&self, distance: T) -> (T, T) {
        let Self { low, high, width, middle, power, factors: [a, b], .. } = *self;
        if low == high || width <= TINY {
            return (T::from(0.5 * (low + high)), T::zero());
        }
        let x = distance.abs() / width;
        let one = T::one();
        let (y, slope) = if power == 1.0 {
            (x, one)
        } else {
            let (x, rest) =
                if power == 2.0 { (x, -x + 1.0) } else { (x.max(TINY), (-x + 1.0).max(TINY)) };
            let raised = |x: T| if power == 2.0 { x } else { x.powf(power - 1.0) };
            let (up, down) = (raised(x), raised(rest));
            (
                T::select_lt(T::from(middle), x, -(rest * down * b) + 1.0, x * up * a),
                T::select_lt(T::from(middle), x, down * (power * b), up * (power * a)),
            )
        };
        let y = T::select_lt(x, one, y, one);
        let slope = T::select_lt(x, one, slope, T::zero());
        (y * (high - low) + low, slope * ((high - low) / width))
    }

    /// Weight times `scale`, and pull `k d r`, at a distance below 0 where the row is active.
    #[inline(always)]
    pub(crate) fn row<T: Scalar>(&self, distance: T) -> (T, T) {
        let (d, _) = self.impedance(distance);
        (d / (-d + 1.0), d * distance * self.k)
    }

    /// Derivatives of the logarithm of the weight, and of the pull, with respect to the distance.
    #[inline(always)]
    pub(crate) fn slopes<T: Scalar>(&self, distance: T) -> (T, T) {
        let (d, slope) = self.impedance(distance);
        // Active distances are negative: the impedance falls with the distance.
        let slope = -slope;
        let relative = slope / (d * (-d + 1.0)).max(1e-30);
        (relative, (d + slope * distance) * self.k)
    }
}

/// Widths and distances below this are 0.
const TINY: f64 = 1e-15;
/// Bounds of impedances.
const IMPEDANCE: [f64; 2] = [0.0001, 0.9999];

/// A limit or dry friction of one degree of freedom.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row<T> {
    pub(crate) dof: usize,
    /// Direction of a limit: 1 at the lower and -1 at the upper end. 1 for friction.
    pub(crate) sign: T,
    /// Distance from the limit.
    pub(crate) distance: T,
    pub(crate) weight: T,
    pub(crate) reference: T,
    /// Largest force of friction; infinite for limits.
    pub(crate) bound: T,
    pub(crate) is_limit: bool,
    /// Acceleration minus reference.
    pub(crate) s: T,
    /// Force along `sign`, and its negative slope.
    pub(crate) f: T,
    pub(crate) w: T,
}

impl<T: Scalar> Row<T> {
    /// Force and negative slope at the acceleration `s` over the reference.
    #[inline(always)]
    pub(crate) fn force(&self, s: T) -> (T, T) {
        let (o, f) = (T::zero(), -(self.weight * s));
        if self.is_limit {
            return (T::select_lt(s, o, f, o), T::select_lt(s, o, self.weight, o));
        }
        let inside = T::select_lt(f.abs(), self.bound, self.weight, o);
        (
            T::select_lt(self.bound, f, self.bound, T::select_lt(f, -self.bound, -self.bound, f)),
            inside,
        )
    }
}

/// Appends the rows of limits that act in some lane, and of dry friction.
#[inline(always)]
pub(crate) fn rows<T: Scalar>(tree: &Tree, q: &[T], v: &[T], params: &[T], rows: &mut Vec<Row<T>>) {
    let o = T::zero();
    rows.clear();
    if !tree.has_rows {
        return;
    }
    for (k, dof) in tree.dofs.iter().enumerate() {
        let row = Row {
            dof: k,
            sign: T::one(),
            distance: o,
            weight: o,
            reference: o,
            bound: o,
            is_limit: false,
            s: o,
            f: o,
            w: o,
        };
        if !dof.friction_loss.is_absent() {
            let (weight, _) = dof.loss_soft.row(o);
            let weight = weight / dof.weight;
            let reference = -(v[k] * dof.loss_soft.b);
            rows.push(Row { weight, reference, bound: dof.friction_loss.of(params), ..row });
        }
        let Some((limit, soft)) = &dof.limit else { continue };
        let [low, high] = limit.range;
        let (low, high) = (q[dof.q] - low, -q[dof.q] + high);
        for (distance, sign) in [(low, T::one()), (high, -T::one())] {
            let distance = distance - limit.margin;
            if T::any_lt(distance, o) {
                let (weight, pull) = soft.row(distance);
                let weight = T::select_lt(distance, o, weight / dof.weight, o);
                let reference = -(sign * v[k] * soft.b) - pull;
                rows.push(Row { sign, distance, weight, reference, is_limit: true, ..row });
            }
        }
    }
}
