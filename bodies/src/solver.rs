//! Acceleration under constraints: Newton's method for a convex cost, all lanes at once.
//!
//! The acceleration minimizes `½ |a - a₀|²_M + Σ φ(J a - reference)`. Without constraints it is
//! a₀. With pyramidal cones and limits, the cost is piecewise quadratic, and the last step is exact.

use crate::cone::Block;
use crate::dynamics::Work;
use crate::matrix::Chains;
use crate::spatial::*;
use crate::tree::Tree;
use physgrad::Scalar;

/// Most iterations. Of 10⁶ random states of each tested model, also wild ones, none needed more than 33.
pub(crate) const ITERATIONS: usize = 40;
/// Most evaluations of a line search.
const SEARCH: usize = 16;

/// `W x` of a symmetric block.
#[inline(always)]
pub(crate) fn block_times<T: Copy, X: Linear<T>>(w: &Block<T>, x: V<X>) -> V<X> {
    [
        x[0] * w[0] + x[1] * w[3] + x[2] * w[4],
        x[0] * w[3] + x[1] * w[1] + x[2] * w[5],
        x[0] * w[4] + x[1] * w[5] + x[2] * w[2],
    ]
}

impl<T: Scalar> Work<T> {
    /// Writes the acceleration under the constraints to `a`.
    #[inline(always)]
    pub(crate) fn prepare_solver(&mut self) {
        let o = T::zero();
        self.a.fill(o);
        self.momentum.fill(o);
        for row in &mut self.rows {
            row.s = -row.reference;
            (row.f, row.w) = row.force(row.s);
        }
        for contact in &mut self.contacts {
            contact.s = neg(contact.reference);
            (contact.f, contact.w) = contact.cone.force(contact.s);
        }
    }

    pub(crate) fn is_free(&self) -> bool {
        self.rows.is_empty() && self.contacts.is_empty()
    }

    /// Matrix of the Newton step at the current forces, and its factors.
    #[inline(always)]
    pub(crate) fn assemble(&mut self, tree: &Tree) {
        let chains = chains(self.is_coupled, tree);
        self.hessian.copy(&self.mass, &tree.parent, chains);
        for row in &self.rows {
            *self.hessian.at_mut(row.dof, row.dof) += row.w;
        }
        for contact in &self.contacts {
            let path = &tree.contacts[contact.index].path;
            let columns = &self.columns[contact.first..contact.first + path.len()];
            for (i, &(k, _)) in path.iter().enumerate() {
                let wide = block_times(&contact.w, columns[i]);
                for (j, &(l, _)) in path[..=i].iter().enumerate() {
                    *self.hessian.at_mut(k, l) += dot(wide, columns[j]);
                }
            }
        }
        self.hessian.factor_along(chains);
    }

    /// Writes the force of each degree of freedom with constraints: `τ + Jᵀ f`.
    #[inline(always)]
    pub(crate) fn constrained(&self, tree: &Tree, out: &mut [T]) {
        out.copy_from_slice(&self.tau);
        for row in &self.rows {
            out[row.dof] += row.sign * row.f;
        }
        for contact in &self.contacts {
            let path = &tree.contacts[contact.index].path;
            for (i, &(k, _)) in path.iter().enumerate() {
                out[k] += dot(self.columns[contact.first + i], contact.f);
            }
        }
    }

    /// Writes the Newton step to `direction`: `-H⁻¹ (M a - τ - Jᵀ f)`.
    #[inline(always)]
    pub(crate) fn newton_step(&mut self, tree: &Tree) {
        let mut direction = std::mem::take(&mut self.direction);
        self.constrained(tree, &mut direction);
        if self.is_free() {
            self.hessian.solve(&tree.parent, &mut direction);
            self.direction = direction;
            return;
        }
        for (k, x) in direction.iter_mut().enumerate() {
            *x -= self.momentum[k];
            self.product[k] = *x;
        }
        self.hessian.solve_along(chains(self.is_coupled, tree), &mut direction);
        let falls = self.product.iter().zip(&direction);
        self.descent = falls.fold(T::zero(), |sum, (&x, &by)| sum + x * by);
        self.mass.times(&tree.parent, &direction, &mut self.product);
        self.direction = direction;
    }

    /// Accelerations of a contact along `direction`.
    #[inline(always)]
    fn along(&self, tree: &Tree, contact: usize) -> V<T> {
        let contact = &self.contacts[contact];
        let mut sum = [T::zero(); 3];
        for (i, &(k, _)) in tree.contacts[contact.index].path.iter().enumerate() {
            let by = self.direction[k];
            sum = add(sum, scale(self.columns[contact.first + i], by));
        }
        sum
    }

    /// Solves for the acceleration. Calls `step` for each Newton step: [`assemble`](Self::assemble)
    /// and [`newton_step`](Self::newton_step), outlined.
    #[inline(always)]
    pub(crate) fn solve(&mut self, tree: &Tree, along: &mut Vec<V<T>>, step: fn(&mut Self, &Tree)) {
        let (o, one) = (T::zero(), T::one());
        // 1 in lanes that still iterate.
        let mut running = one;
        self.is_exact = false;
        for iteration in 0..ITERATIONS {
            self.iterations = iteration + 1;
            step(self, tree);
            if self.is_free() {
                self.advance(one);
                self.is_exact = true;
                return;
            }
            self.list_along(tree, along);
            let (square, whole) = self.decrement();
            let length = if iteration == 0 { one } else { self.search(along, square) * running };
            self.advance(length);
            let changed = self.update(along, length, running);
            // A full step that changes no active set is exact for piecewise quadratic costs. Near
            // the minimum of a smooth cost, the next error is the square of the last step.
            let small = square - (whole + square) * tolerance::<T>();
            let exact = T::select_lt(o, changed, one, T::select_lt(length, one, one, o));
            let still = T::select_lt(o, small, one, o) * exact;
            running *= still;
            if !T::any_lt(o, running) {
                self.is_exact = !T::any_lt(o, changed);
                if T::DIFFERENTIATES && !self.is_exact {
                    step(self, tree);
                    self.list_along(tree, along);
                    self.advance(one);
                    self.update(along, one, one);
                }
                return;
            }
        }
    }

    #[inline(always)]
    fn list_along(&self, tree: &Tree, along: &mut Vec<V<T>>) {
        along.clear();
        for i in 0..self.contacts.len() {
            along.push(self.along(tree, i));
        }
    }

    #[inline(always)]
    fn advance(&mut self, length: T) {
        for k in 0..self.a.len() {
            self.a[k] += self.direction[k] * length;
            self.momentum[k] += self.product[k] * length;
        }
    }

    /// `Δᵀ M Δ` of the step Δ, and `aᵀ D a` with the diagonal D of M, before the step.
    #[inline(always)]
    fn decrement(&self) -> (T, T) {
        let (mut step, mut whole) = (T::zero(), T::zero());
        for k in 0..self.a.len() {
            step += self.product[k] * self.direction[k];
            whole += self.mass.at(k, k) * self.a[k] * self.a[k];
        }
        (step, whole)
    }

    /// Moves rows and contacts by the step; returns how much stiffnesses change in running lanes.
    #[inline(always)]
    fn update(&mut self, along: &[V<T>], length: T, running: T) -> T {
        let mut changed = T::zero();
        for row in &mut self.rows {
            row.s += row.sign * self.direction[row.dof] * length;
            let (f, w) = row.force(row.s);
            // Dry friction may change its direction without a change of stiffness.
            let constant = |f: T, w: T| T::select_lt(T::zero(), w, T::zero(), f);
            changed += (w - row.w).abs() + (constant(f, w) - constant(row.f, row.w)).abs();
            (row.f, row.w) = (f, w);
        }
        for (contact, &by) in self.contacts.iter_mut().zip(along) {
            contact.s = add(contact.s, scale(by, length));
            let (f, w) = contact.cone.force(contact.s);
            for i in 0..6 {
                changed += (w[i] - contact.w[i]).abs();
            }
            (contact.f, contact.w) = (f, w);
        }
        changed * running
    }

    /// Length of the step Δ that minimizes the cost along it, for `square = Δᵀ M Δ`.
    #[inline(always)]
    fn search(&self, along: &[V<T>], square: T) -> T {
        let (o, one) = (T::zero(), T::one());
        let mut linear = o;
        for k in 0..self.a.len() {
            linear += self.direction[k] * (self.momentum[k] - self.tau[k]);
        }
        let (mut low, mut high, mut length) = (o, T::from(1e9), one);
        let mut last = T::from(f64::INFINITY);
        for _ in 0..SEARCH {
            let (slope, curve) = self.slope(along, length);
            let (slope, curve) = (slope + linear + square * length, curve + square);
            low = T::select_lt(slope, o, length, low);
            high = T::select_lt(slope, o, high, length);
            let change = slope / T::select_lt(o, curve, curve, one);
            let next = length - change;
            // Bisection where Newton's method leaves the bracket, or jumps to and fro across a kink.
            let middle = ((low + high) * 0.5).min((length * 2.0).max(1.0));
            let next = T::select_lt(next, low, middle, T::select_lt(high, next, middle, next));
            let next = T::select_lt(last, change.abs() * 2.0, middle, next);
            last = (next - length).abs();
            let open = slope.abs() - self.descent * SLOPE;
            length = T::select_lt(o, open, next, length);
            if !T::any_lt(o, open) {
                break;
            }
        }
        length
    }

    /// First and second derivative of the cost of constraints along the step.
    #[inline(always)]
    fn slope(&self, along: &[V<T>], length: T) -> (T, T) {
        let (mut slope, mut curve) = (T::zero(), T::zero());
        for row in &self.rows {
            let by = row.sign * self.direction[row.dof];
            let (f, w) = row.force(row.s + by * length);
            slope -= f * by;
            curve += w * by * by;
        }
        for (contact, &by) in self.contacts.iter().zip(along) {
            let (f, w) = contact.cone.force(add(contact.s, scale(by, length)));
            slope -= dot(f, by);
            curve += dot(block_times(&w, by), by);
        }
        (slope, curve)
    }
}

/// Slope at the end of a line search, relative to that at its beginning. A full Newton step near
/// the minimum fulfils it.
const SLOPE: f64 = 0.01;

/// Square of the relative Newton step after which the iteration ends. Rounding of the step is smaller.
#[inline(always)]
fn tolerance<T: Scalar>() -> f64 {
    <T::Real as physgrad::Float>::EPSILON.powi(2) * 1e6
}

pub(crate) fn chains(is_coupled: bool, tree: &Tree) -> Chains<'_> {
    if is_coupled { Chains::All } else { Chains::Tree(&tree.parent) }
}
