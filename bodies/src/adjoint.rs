//! Reverse derivative of an acceleration, by hand.
//!
//! The acceleration a solves `r = M a + c - τ - Jᵀ f(J a - reference) = 0`. For a cotangent ā, let
//! `λ = -(∂r/∂a)⁻¹ ā`. The cotangents of state, control and parameters are the derivatives of
//! `λ · r` at constant a and λ: the power of all forces along the virtual motion λ. Implicit damping
//! adds `μ · ((M + dt B) a' - M a)` for the acceleration a' of the step.
//!
//! The power of a body is a function of the motions of its link: velocity, acceleration, and virtual
//! motion. It does not change if pose and motions move rigidly together, which gives the derivative
//! with respect to the pose. One pass from the leaves to the root then gives those with respect to
//! positions and velocities.

use crate::contact::{CapsuleOf, Contact, Pair, UPRIGHT};
use crate::drag;
use crate::dynamics::{Arguments, Work, inside};
use crate::geometry::{nearest, nearest_vjp, tangents_vjp};
use crate::solver::{block_times, chains};
use crate::spatial::*;
use crate::tree::*;
use physgrad::{Cotangent, Real};

/// Buffers of the reverse pass.
#[derive(Debug)]
pub(crate) struct Back<R, C> {
    /// Virtual accelerations λ of the constrained equation, and μ of the damped one.
    lambda: Vec<C>,
    mu: Vec<C>,
    /// Motions of the links: acceleration, `J a`, virtual motions λ and μ, and a' - a.
    acceleration: Vec<Spatial<R>>,
    change: Vec<Spatial<R>>,
    along: Vec<Spatial<R>>,
    w: Vec<Spatial<C>>,
    y: Vec<Spatial<C>>,
    /// Cotangents of λ-motions (scalars, since the power is linear in λ), of velocities,
    /// accelerations, `J a`, μ-motions and changes, and twists of poses.
    w_bar: Vec<Spatial<R>>,
    v_bar: Vec<Spatial<C>>,
    a_bar: Vec<Spatial<C>>,
    z_bar: Vec<Spatial<C>>,
    y_bar: Vec<Spatial<R>>,
    e_bar: Vec<Spatial<C>>,
    twist: Vec<Spatial<C>>,
    differences: Vec<R>,
}

impl<R, C> Default for Back<R, C> {
    fn default() -> Self {
        Self {
            lambda: Vec::new(),
            mu: Vec::new(),
            acceleration: Vec::new(),
            change: Vec::new(),
            along: Vec::new(),
            w: Vec::new(),
            y: Vec::new(),
            w_bar: Vec::new(),
            v_bar: Vec::new(),
            a_bar: Vec::new(),
            z_bar: Vec::new(),
            y_bar: Vec::new(),
            e_bar: Vec::new(),
            twist: Vec::new(),
            differences: Vec::new(),
        }
    }
}

/// Cotangents of positions, velocities, controls and parameters, which the pass adds to.
pub(crate) struct Bars<'a, C> {
    pub(crate) q: &'a mut [C],
    pub(crate) v: &'a mut [C],
    pub(crate) u: Option<&'a mut [C]>,
    pub(crate) p: Option<&'a mut [C]>,
}

impl<R: Real, C: Cotangent<R>> Back<R, C> {
    fn resize(&mut self, n: usize) {
        let (o, null) = (Spatial::fill(R::zero()), Spatial::fill(C::null()));
        for list in [&mut self.lambda, &mut self.mu] {
            list.resize(n, C::null());
        }
        for list in [
            &mut self.acceleration,
            &mut self.change,
            &mut self.along,
            &mut self.w_bar,
            &mut self.y_bar,
        ] {
            list.resize(n, o);
        }
        for list in [
            &mut self.w,
            &mut self.y,
            &mut self.v_bar,
            &mut self.a_bar,
            &mut self.z_bar,
            &mut self.e_bar,
            &mut self.twist,
        ] {
            list.resize(n, null);
        }
        self.differences.resize(n, R::zero());
    }

    /// λ and μ for the cotangent `bar` of the acceleration of the step. The factors in `work` must
    /// be those at its acceleration.
    #[inline(always)]
    pub(crate) fn solve(&mut self, tree: &Tree, work: &Work<R>, bar: &[C]) {
        if self.lambda.len() != tree.nv() {
            self.resize(tree.nv());
        }
        for (lambda, &bar) in self.lambda.iter_mut().zip(bar) {
            *lambda = -bar;
        }
        if tree.damps {
            self.mu.copy_from_slice(&self.lambda);
            work.damped.solve(&tree.parent, &mut self.mu);
            work.mass.times(&tree.parent, &self.mu, &mut self.lambda);
            for k in 0..tree.nv() {
                self.differences[k] = work.stepped[k] - work.a[k];
            }
        } else {
            self.mu.fill(C::null());
            self.differences.fill(R::zero());
        }
        work.hessian.solve_along(chains(work.is_coupled, tree), &mut self.lambda);
    }

    /// Motions of the links.
    #[inline(always)]
    pub(crate) fn move_links(&mut self, tree: &Tree, work: &Work<R>, v: &[R]) {
        let o = R::zero();
        let g = tree.options.gravity;
        let lift = Spatial { a: [o; 3], l: constant(g.map(|g| -g)) };
        for (k, dof) in tree.dofs.iter().enumerate() {
            let above = tree.parent[k];
            let s = work.s[k];
            let along = s.times(work.a[k]);
            let mut acceleration = along;
            if dof.base != NONE {
                acceleration += work.v[dof.base].cross_motion(s.times(v[k]));
            }
            let (w, y) = (spread_spatial(self.lambda[k], s), spread_spatial(self.mu[k], s));
            let change = s.times(self.differences[k]);
            if above == NONE {
                self.acceleration[k] = acceleration + lift;
                (self.along[k], self.w[k], self.y[k], self.change[k]) = (along, w, y, change);
            } else {
                self.acceleration[k] = acceleration + self.acceleration[above];
                self.along[k] = along + self.along[above];
                self.w[k] = w + self.w[above];
                if tree.damps {
                    self.y[k] = y + self.y[above];
                    self.change[k] = change + self.change[above];
                }
            }
        }
    }

    /// Cotangents of the motions of the links from inertia, damping and drag.
    #[inline(always)]
    pub(crate) fn inertial(
        &mut self,
        tree: &Tree,
        work: &Work<R>,
        params: &[R],
        bars: &mut Bars<'_, C>,
    ) {
        let (o, null) = (Spatial::fill(R::zero()), Spatial::fill(C::null()));
        for (k, dof) in tree.dofs.iter().enumerate() {
            self.z_bar[k] = null;
            if !dof.has_mass() {
                (self.w_bar[k], self.a_bar[k], self.v_bar[k]) = (o, null, null);
                (self.y_bar[k], self.e_bar[k], self.twist[k]) = (o, null, null);
                continue;
            }
            let i = &work.inertia[k];
            let (v, a, w) = (work.v[k], self.acceleration[k], self.w[k]);
            let momentum = i.times(v);
            let (w_bar, a_bar) = (i.times(a) + v.cross_force(momentum), i.times(w));
            // w · (v ×* I v), by the velocity: as operand of the product, and in the momentum.
            let v_bar = i.times(w.cross_motion(v)) - w.cross_force(momentum);
            let mut all =
                w.cross_force(w_bar) + cross_force_left(a, a_bar) + cross_force_left(v, v_bar);
            (self.w_bar[k], self.a_bar[k], self.v_bar[k]) = (w_bar, a_bar, v_bar);
            if tree.damps {
                let (y, e) = (self.y[k], self.change[k]);
                let (y_bar, e_bar) = (i.times(e), i.times(y));
                all = all + y.cross_force(y_bar) + cross_force_left(e, e_bar);
                (self.y_bar[k], self.e_bar[k]) = (y_bar, e_bar);
            }
            self.twist[k] = Spatial::fill(C::null()) - all;
            if let Some(p_bar) = &mut bars.p {
                for (mass, part) in &dof.varied {
                    if let Some(entry) = mass.entry {
                        let unit = unit_inertia(part, &work.r[k], work.p[k]);
                        let force = unit.times(a) + v.cross_force(unit.times(v));
                        let mut bar = w.dot(force);
                        if tree.damps {
                            bar += self.y[k].dot(unit.times(self.change[k]));
                        }
                        p_bar[entry] += bar;
                    }
                }
                let pairs = [(w, a), (w.cross_motion(v), v), (self.y[k], self.change[k])];
                let pairs = if tree.damps { &pairs[..] } else { &pairs[..2] };
                for part in &dof.shaped {
                    part.pull((&work.r[k], work.p[k]), pairs, params, p_bar);
                }
            }
        }
        for part in &tree.drags {
            let k = part.dof;
            let pose = (&work.r[k], work.p[k]);
            let (w_bar, v_bar, twist) = drag::vjp(part, &tree.options, pose, work.v[k], self.w[k]);
            self.w_bar[k] += w_bar;
            self.v_bar[k] += v_bar;
            self.twist[k] += twist;
        }
    }

    /// Cotangents from limits and dry friction.
    #[inline(always)]
    pub(crate) fn rows(&mut self, tree: &Tree, work: &Work<R>, bars: &mut Bars<'_, C>) {
        for row in &work.rows {
            let dof = &tree.dofs[row.dof];
            let soft = dof
                .limit
                .as_ref()
                .filter(|_| row.is_limit)
                .map_or(&dof.loss_soft, |(_, soft)| soft);
            // Power -λ sign f, with the slope -w of f by s.
            let power = self.lambda[row.dof] * row.sign;
            let s_bar = power * row.w;
            bars.v[row.dof] += s_bar * (row.sign * soft.b);
            if row.is_limit {
                let (relative, pull) = soft.slopes(row.distance);
                let distance_bar = s_bar * pull - power * (row.f * relative);
                bars.q[dof.q] += distance_bar * row.sign;
            } else if let (Some(entry), Some(p_bar)) = (dof.friction_loss.entry, &mut bars.p) {
                // At the bound, the force is the bound with a sign.
                let o = R::zero();
                let sign = R::select_lt(row.s, o, R::one(), -R::one());
                let at_bound = R::select_lt(o, row.w, o, sign);
                p_bar[entry] += -(power * at_bound);
            }
        }
    }

    /// Cotangents from one contact.
    #[inline(always)]
    pub(crate) fn contact(
        &mut self,
        tree: &Tree,
        work: &Work<R>,
        contact: &Contact<R>,
        params: &[R],
        bars: &mut Bars<'_, C>,
    ) {
        let candidate = &tree.contacts[contact.index];
        let dofs = ends(&candidate.pair);
        let relative = |motion: &[Spatial<R>]| Self::relative(motion, dofs);
        let (z, v) = (relative(&self.along), relative(&work.v));
        let w = match dofs {
            [NONE, NONE] => return,
            [NONE, b] => self.w[b],
            [a, NONE] => Spatial::fill(C::null()) - self.w[a],
            [a, b] => self.w[b] - self.w[a],
        };
        let (x, frame) = (contact.x, &contact.frame);
        let in_frame = |at: V<C>| three!(|i| dot(at, frame[i]));
        let virtual_speed = in_frame(w.at(x));
        // Power -(J λ) · f. Cotangents of J λ (scalars) and of s, and of J v through the reference.
        let w_part = neg(contact.f);
        let s_bar = block_times(&contact.w, virtual_speed);
        let v_part = scale(s_bar, R::from(candidate.soft.b));
        let (relative_slope, pull) = candidate.slopes(contact.distance);
        let power = dot(virtual_speed, contact.f);
        let is_active = R::select_lt(contact.distance, R::zero(), R::one(), R::zero());
        let distance_bar = (s_bar[0] * pull - power * relative_slope) * is_active;
        if let Some(p_bar) = &mut bars.p {
            let by = contact.cone.by_friction(contact.s);
            let weight = candidate.weight_by_friction(contact.cone.friction);
            let bar = -(dot(virtual_speed, by) + power * weight);
            for (friction, counts) in candidate.friction.iter().zip(candidate.counts(params)) {
                if let Some(entry) = friction.entry {
                    p_bar[entry] += bar * counts;
                }
            }
        }
        // Forces at the contact point in axes of the world, on the second body.
        let world = |part: V<C>| combine(part, frame);
        let w_force = combine(w_part, frame);
        let (z_force, v_force) = (world(s_bar), world(v_part));
        self.push(dofs, (w_force, z_force, v_force), x);
        // The contact point moves: a velocity changes by its angular part.
        let point_bar =
            add(add(cross_left(w_force, w.a), cross(z_force, z.a)), cross(v_force, v.a));
        let turns = |i: usize| {
            let by = add(scale(w.at(x), w_part[i]), spread(s_bar[i], z.at(x)));
            add(by, spread(v_part[i], v.at(x)))
        };
        match &candidate.pair {
            Pair::Plane { dof, centre, axis, .. } => {
                let n = frame[0];
                let along = dot(point_bar, n) * R::from(-0.5) + distance_bar;
                let centre_bar = add(point_bar, spread(along, n));
                let at = work.point(*dof, *centre);
                self.twist[*dof] += Spatial::force(centre_bar, at);
                if let Some(axis) = axis.filter(|_| candidate.law == crate::cone::Law::Pyramidal) {
                    let axis = work.vector(*dof, axis);
                    let flat = sub(axis, scale(n, dot(axis, n)));
                    let square = dot(flat, flat);
                    let upright = R::from(UPRIGHT);
                    let per = R::select_lt(
                        square,
                        upright,
                        R::zero(),
                        square.max(upright).sqrt().recip(),
                    );
                    let turn = (dot(turns(1), frame[2]) - dot(turns(2), frame[1])) * per;
                    let axis_bar = spread(turn, frame[2]);
                    let moment = cross_left(axis, axis_bar);
                    self.twist[*dof] += Spatial { a: moment, l: [C::null(); 3] };
                }
            }
            Pair::Capsules(of) => {
                let n_bar = add(turns(0), tangents_vjp(frame[0], frame[1], turns(1), turns(2)));
                self.capsules(work, of, (distance_bar, point_bar, n_bar));
            }
        }
    }

    #[inline(always)]
    fn capsules(
        &mut self,
        work: &Work<R>,
        of: &[CapsuleOf; 2],
        (gap_bar, point_bar, normal_bar): (C, V<C>, V<C>),
    ) {
        let [a, b] = [work.capsule(&of[0]), work.capsule(&of[1])];
        let near = nearest(&a, &b);
        let bars = nearest_vjp([&a, &b], &near, gap_bar, point_bar, normal_bar);
        for ((of, capsule), [centre_bar, half_bar]) in of.iter().zip([a, b]).zip(bars) {
            if of.dof != NONE {
                self.twist[of.dof] += Spatial::force(centre_bar, capsule.centre);
                let moment = cross_left(capsule.half, half_bar);
                self.twist[of.dof] += Spatial { a: moment, l: [C::null(); 3] };
            }
        }
    }

    /// Motion of the second link relative to the first.
    #[inline(always)]
    fn relative(motion: &[Spatial<R>], dofs: [usize; 2]) -> Spatial<R> {
        match dofs {
            [NONE, NONE] => Spatial::fill(R::zero()),
            [NONE, b] => motion[b],
            [a, NONE] => Spatial::fill(R::zero()) - motion[a],
            [a, b] => motion[b] - motion[a],
        }
    }

    /// Adds forces at a point to the cotangents of the motions of two links.
    #[inline(always)]
    fn push(&mut self, dofs: [usize; 2], (w, z, v): (V<R>, V<C>, V<C>), x: V<R>) {
        let (w, z, v) = (Spatial::force(w, x), Spatial::force(z, x), Spatial::force(v, x));
        let [a, b] = dofs;
        if b != NONE {
            self.w_bar[b] += w;
            self.z_bar[b] += z;
            self.v_bar[b] += v;
        }
        if a != NONE {
            self.w_bar[a] = self.w_bar[a] - w;
            self.z_bar[a] = self.z_bar[a] - z;
            self.v_bar[a] = self.v_bar[a] - v;
        }
    }

    /// From the leaves to the root: cotangents of positions and velocities.
    #[inline(always)]
    pub(crate) fn sweep(
        &mut self,
        tree: &Tree,
        work: &Work<R>,
        [q, v, u, params]: Arguments<'_, R>,
        bars: &mut Bars<'_, C>,
    ) {
        for k in (0..tree.nv()).rev() {
            let (dof, s) = (&tree.dofs[k], work.s[k]);
            let (w_bar, a_bar, v_bar) = (self.w_bar[k], self.a_bar[k], self.v_bar[k]);
            let mut rate = v_bar;
            if dof.base != NONE {
                // The acceleration contains v_base × s v.
                rate = rate - cross_force_left(work.v[dof.base], a_bar);
                self.v_bar[dof.base] += cross_force_left(s.times(v[k]), a_bar);
            }
            bars.v[k] += rate.dot(s);
            let mut s_bar = spread_spatial(self.lambda[k], w_bar)
                + rate.times(v[k])
                + (a_bar + self.z_bar[k]).times(work.a[k]);
            if tree.damps {
                s_bar += spread_spatial(self.mu[k], self.y_bar[k])
                    + self.e_bar[k].times(self.differences[k]);
            }
            self.twist[k] += cross_force_left(s, s_bar);
            self.hand_over(tree, k, (w_bar, a_bar, v_bar));
        }
        self.joints(tree, work, [q, v, u, params], bars);
        self.actuators(tree, work, [q, v, u, params], bars);
    }

    #[inline(always)]
    fn hand_over(
        &mut self,
        tree: &Tree,
        k: usize,
        (w_bar, a_bar, v_bar): (Spatial<R>, Spatial<C>, Spatial<C>),
    ) {
        let above = tree.parent[k];
        if above == NONE {
            return;
        }
        self.w_bar[above] += w_bar;
        self.a_bar[above] += a_bar;
        self.v_bar[above] += v_bar;
        let (twist, z_bar) = (self.twist[k], self.z_bar[k]);
        self.twist[above] += twist;
        self.z_bar[above] += z_bar;
        if tree.damps {
            let (y_bar, e_bar) = (self.y_bar[k], self.e_bar[k]);
            self.y_bar[above] += y_bar;
            self.e_bar[above] += e_bar;
        }
    }

    /// Positions from twists, and springs, damping and armature.
    #[inline(always)]
    fn joints(
        &mut self,
        tree: &Tree,
        work: &Work<R>,
        [q, v, _, params]: Arguments<'_, R>,
        bars: &mut Bars<'_, C>,
    ) {
        let dt = R::from(tree.options.dt);
        for (k, dof) in tree.dofs.iter().enumerate() {
            let lambda = self.lambda[k];
            if !dof.damping.is_absent() {
                bars.v[k] += lambda * dof.damping.of(params);
            }
            if !dof.stiffness.is_absent() {
                bars.q[dof.q] += lambda * dof.stiffness.of(params);
            }
            match dof.kind {
                Kind::Slide | Kind::Hinge => bars.q[dof.q] += self.twist[k].dot(work.s[k]),
                Kind::Turn(0) => {
                    let turn = three!(|i| self.twist[k].dot(work.s[k + i]));
                    let by = turn_to_quaternion(turn, &q[dof.q..dof.q + 4]);
                    for i in 0..4 {
                        bars.q[dof.q + i] += by[i];
                    }
                }
                Kind::Turn(_) => {}
            }
            let Some(p_bar) = &mut bars.p else { continue };
            if let Some(entry) = dof.damping.entry {
                p_bar[entry] += lambda * v[k];
                if tree.damps {
                    p_bar[entry] += self.mu[k] * (work.stepped[k] * dt);
                }
            }
            if let Some(entry) = dof.stiffness.entry {
                p_bar[entry] += lambda * (q[dof.q] - dof.spring);
            }
            if let Some(entry) = dof.armature.entry {
                p_bar[entry] += lambda * work.a[k] + self.mu[k] * self.differences[k];
            }
        }
    }

    #[inline(always)]
    fn actuators(
        &mut self,
        tree: &Tree,
        work: &Work<R>,
        [q, v, u, params]: Arguments<'_, R>,
        bars: &mut Bars<'_, C>,
    ) {
        for (i, (motor, &u)) in tree.motors.iter().zip(u).enumerate() {
            let gear = motor.gear.of(params);
            let force = motor.force(tree, [q, v, params], u);
            let scaled = |bar: C, by: f64| if by == 1.0 { bar } else { bar * R::from(by) };
            let out = { motor.ends.iter() }
                .map(|&(k, by)| {
                    let passes = tree.dofs[k].passes(work.actuation[k]);
                    scaled(-(self.lambda[k] * passes), by)
                })
                .reduce(|sum, end| sum + end)
                .unwrap_or(C::null());
            let inner = motor.passes(force);
            let (unlimited, force) = (force, motor.limited(force));
            let force_bar = out * (gear * inner);
            if let Some(u_bar) = &mut bars.u {
                let slope = motor.control_range.map_or(R::one(), |range| inside(u, range));
                u_bar[i] += force_bar * (slope * motor.gain.of(params));
            }
            if !motor.position.is_absent() {
                let bar = -(force_bar * (gear * motor.position.of(params)));
                for &(k, by) in &motor.ends {
                    bars.q[tree.dofs[k].q] += scaled(bar, by);
                }
            }
            if !motor.velocity.is_absent() {
                let bar = -(force_bar * (gear * motor.velocity.of(params)));
                for &(k, by) in &motor.ends {
                    bars.v[k] += scaled(bar, by);
                }
            }
            let Some(p_bar) = &mut bars.p else { continue };
            let (position, velocity) = (motor.position.of(params), motor.velocity.of(params));
            let (q, v) = motor.motion(tree, q, v);
            // Implicit feedback is `gear² velocity dt`, times the product of the coefficients, in the
            // damped matrix.
            let feedback = (tree.implicit_feedback() && !motor.velocity.is_absent()).then(|| {
                let passes = motor.feeds_back(tree, unlimited, &work.actuation);
                let scale = gear * passes * tree.options.dt;
                let pair = |&(k, j, by): &(usize, usize, f64)| {
                    let bar = self.mu[k] * (work.stepped[j] * scale);
                    let both =
                        if k == j { bar } else { bar + self.mu[j] * (work.stepped[k] * scale) };
                    scaled(both, by)
                };
                motor.pairs.iter().map(pair).reduce(|sum, bar| sum + bar).unwrap_or(C::null())
            });
            if let Some(entry) = motor.gear.entry {
                let slope = (q * position + v * velocity) * inner;
                p_bar[entry] += out * (force - slope * gear);
                if let Some(feedback) = feedback {
                    p_bar[entry] += feedback * (velocity * 2.0);
                }
            }
            if let Some(entry) = motor.gain.entry {
                let u = motor.control_range.map_or(u, |[low, high]| u.clamp(low, high));
                p_bar[entry] += force_bar * u;
            }
            if let Some(entry) = motor.position.entry {
                p_bar[entry] += -(force_bar * (gear * q));
            }
            if let Some(entry) = motor.velocity.entry {
                p_bar[entry] += -(force_bar * (gear * v));
                if let Some(feedback) = feedback {
                    p_bar[entry] += feedback * gear;
                }
            }
        }
    }
}

/// Links of the two bodies of a contact.
fn ends(pair: &Pair) -> [usize; 2] {
    match pair {
        Pair::Plane { dof, .. } => [NONE, *dof],
        Pair::Capsules([a, b]) => [a.dof, b.dof],
    }
}

/// The vector with these components in a frame.
#[inline(always)]
fn combine<T: Copy, X: Linear<T>>(parts: V<X>, frame: &M<T>) -> V<X> {
    let rows = three!(|i| spread(parts[i], frame[i]));
    add(add(rows[0], rows[1]), rows[2])
}

/// Inertia of a part per mass.
#[inline(always)]
fn unit_inertia<R: Real>(part: &Inertial, r: &M<R>, p: V<R>) -> Inertia<R> {
    Inertia::of(R::one(), add(p, rotate(r, part.centre)), congruence(r, &part.moments))
}

/// Cotangent of a quaternion from that of a rotation in axes of the body.
#[inline(always)]
fn turn_to_quaternion<R: Real, C: Cotangent<R>>(g: V<C>, q: &[R]) -> [C; 4] {
    let [w, x, y, z] = [q[0], q[1], q[2], q[3]];
    let c = R::from(2.0) / (w * w + x * x + y * y + z * z);
    [
        -(g[0] * x + g[1] * y + g[2] * z) * c,
        (g[0] * w - g[1] * z + g[2] * y) * c,
        (g[0] * z + g[1] * w - g[2] * x) * c,
        (-(g[0] * y) + g[1] * x + g[2] * w) * c,
    ]
}
