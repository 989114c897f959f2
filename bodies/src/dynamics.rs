//! [`Work`]: poses, velocities, forces and the mass matrix of one evaluation.

use crate::contact::Contact;
use crate::drag;
use crate::matrix::Matrix;
use crate::rows::Row;
use crate::spatial::*;
use crate::tree::*;
use physgrad::Scalar;

/// Positions, velocities, controls and parameters.
pub(crate) type Arguments<'a, T> = [&'a [T]; 4];

/// Values of one evaluation, kept for its derivative. The vectors keep their memory.
#[derive(Clone, Debug)]
pub(crate) struct Work<T> {
    /// Orientation and position of each link, relative to the origin.
    pub(crate) r: Vec<M<T>>,
    pub(crate) p: Vec<V<T>>,
    /// Displacement of the leading slides.
    pub(crate) origin: V<T>,
    /// Axes of the degrees of freedom, and velocities of the links.
    pub(crate) s: Vec<Spatial<T>>,
    pub(crate) v: Vec<Spatial<T>>,
    pub(crate) inertia: Vec<Inertia<T>>,
    /// Inertia of each link and those after it.
    composite: Vec<Inertia<T>>,
    force: Vec<Spatial<T>>,
    bias: Vec<Spatial<T>>,
    pub(crate) mass: Matrix<T>,
    /// Force of each degree of freedom without constraints.
    pub(crate) tau: Vec<T>,
    /// Acceleration under the constraints.
    pub(crate) a: Vec<T>,
    /// Acceleration of the step, with implicit damping.
    pub(crate) stepped: Vec<T>,
    pub(crate) damped: Matrix<T>,
    pub(crate) rows: Vec<Row<T>>,
    pub(crate) contacts: Vec<Contact<T>>,
    /// Columns of the contacts: normal and two tangents per degree of freedom.
    pub(crate) columns: Vec<V<T>>,
    pub(crate) hessian: Matrix<T>,
    /// Whether the factors of `hessian` are those at `a` in all lanes.
    pub(crate) is_exact: bool,
    /// Whether contacts couple branches.
    pub(crate) is_coupled: bool,
    /// Iterations of the solver.
    pub(crate) iterations: usize,
    /// Sum of the actuators of each degree of freedom, before the range of its joint.
    pub(crate) actuation: Vec<T>,
    /// Accelerations of the contacts along a Newton step.
    pub(crate) along: Vec<V<T>>,
    pub(crate) direction: Vec<T>,
    /// `M a`, and `M` times the Newton step.
    pub(crate) momentum: Vec<T>,
    pub(crate) product: Vec<T>,
    /// Descent of the cost per length of the Newton step.
    pub(crate) descent: T,
}

impl<T: Scalar> Default for Work<T> {
    fn default() -> Self {
        Self {
            r: Vec::new(),
            p: Vec::new(),
            origin: [T::zero(); 3],
            s: Vec::new(),
            v: Vec::new(),
            inertia: Vec::new(),
            composite: Vec::new(),
            force: Vec::new(),
            bias: Vec::new(),
            mass: Matrix::default(),
            tau: Vec::new(),
            a: Vec::new(),
            stepped: Vec::new(),
            damped: Matrix::default(),
            rows: Vec::new(),
            contacts: Vec::new(),
            columns: Vec::new(),
            hessian: Matrix::default(),
            is_exact: false,
            is_coupled: false,
            iterations: 0,
            actuation: Vec::new(),
            along: Vec::new(),
            direction: Vec::new(),
            momentum: Vec::new(),
            product: Vec::new(),
            descent: T::zero(),
        }
    }
}

impl<T: Scalar> Work<T> {
    /// Makes room for a tree: later steps do not allocate, however many constraints they have.
    #[inline(always)]
    pub(crate) fn fit(&mut self, tree: &Tree) {
        let limits = if tree.has_rows { 3 * tree.nv() } else { 0 };
        let fits =
            self.contacts.capacity() >= tree.contacts.len() && self.rows.capacity() >= limits;
        if self.tau.len() != tree.nv() || !fits || self.columns.capacity() < tree.columns {
            self.resize(tree);
            self.rows = Vec::with_capacity(limits);
            self.contacts = Vec::with_capacity(tree.contacts.len());
            self.along = Vec::with_capacity(tree.contacts.len());
            self.columns = Vec::with_capacity(tree.columns);
        }
    }

    pub(crate) fn resize(&mut self, tree: &Tree) {
        let n = tree.nv();
        let zero = Spatial::fill(T::zero());
        self.r.resize(n, [[T::zero(); 3]; 3]);
        self.p.resize(n, [T::zero(); 3]);
        for list in [&mut self.s, &mut self.v, &mut self.force, &mut self.bias] {
            list.resize(n, zero);
        }
        self.inertia.resize(n, Inertia::zero());
        self.composite.resize(n, Inertia::zero());
        for list in [
            &mut self.tau,
            &mut self.a,
            &mut self.stepped,
            &mut self.actuation,
            &mut self.direction,
            &mut self.momentum,
            &mut self.product,
        ] {
            list.resize(n, T::zero());
        }
        for matrix in [&mut self.mass, &mut self.hessian, &mut self.damped] {
            matrix.resize(n);
        }
    }

    /// Poses, axes, velocities and inertias of the links.
    #[inline(always)]
    pub(crate) fn kinematics(&mut self, tree: &Tree, [q, v, _, params]: Arguments<'_, T>) {
        let o = T::zero();
        self.origin = [o; 3];
        let upright: M<T> = three!(|i| three!(|j| T::from(IDENTITY[i][j])));
        for (k, dof) in tree.dofs.iter().enumerate() {
            let above = tree.parent[k];
            let (mut turn, mut at) =
                if above == NONE { (upright, [o; 3]) } else { (self.r[above], self.p[above]) };
            if let Some((offset, turned)) = &dof.frame {
                if *offset != [0.0; 3] {
                    at = add(at, rotate(&turn, *offset));
                }
                if let Some(by) = turned {
                    turn = product_with(&turn, by);
                }
            }
            self.s[k] = match dof.kind {
                Kind::Slide => {
                    let axis = rotate(&turn, dof.axis);
                    let by = scale(axis, q[dof.q] - dof.zero);
                    if k < tree.root {
                        self.origin = add(self.origin, by);
                    } else {
                        at = add(at, by);
                    }
                    Spatial { a: [o; 3], l: axis }
                }
                Kind::Hinge => {
                    let axis = rotate(&turn, dof.axis);
                    let anchor = add(at, rotate(&turn, dof.point));
                    turn = product(&turn, &about(dof.axis, q[dof.q] - dof.zero));
                    at = sub(anchor, rotate(&turn, dof.point));
                    Spatial { a: axis, l: cross(anchor, axis) }
                }
                Kind::Turn(i) => {
                    let anchor = add(at, rotate(&turn, dof.point));
                    if i == 0 {
                        turn = product(&turn, &of_quaternion(&q[dof.q..dof.q + 4]));
                        at = sub(anchor, rotate(&turn, dof.point));
                    }
                    let axis = [turn[0][i], turn[1][i], turn[2][i]];
                    Spatial { a: axis, l: cross(anchor, axis) }
                }
            };
            (self.r[k], self.p[k]) = (turn, at);
            let own = self.s[k].times(v[k]);
            self.v[k] = if above == NONE { own } else { self.v[above] + own };
            if dof.has_mass() {
                self.inertia[k] = link_inertia(dof, &turn, at, params);
            }
        }
    }

    /// Forces without constraints, and the mass matrix.
    #[inline(always)]
    pub(crate) fn forces(&mut self, tree: &Tree, [q, v, u, params]: Arguments<'_, T>) {
        let o = T::zero();
        let n = tree.nv();
        let g = tree.options.gravity;
        let lift = Spatial { a: [o; 3], l: constant(g.map(|g| -g)) };
        for (k, dof) in tree.dofs.iter().enumerate() {
            let above = tree.parent[k];
            let before = if above == NONE { lift } else { self.bias[above] };
            self.bias[k] = match dof.base {
                NONE => before,
                base => before + self.v[base].cross_motion(self.s[k].times(v[k])),
            };
            if dof.has_mass() {
                let momentum = self.inertia[k].times(self.v[k]);
                self.force[k] =
                    self.inertia[k].times(self.bias[k]) + self.v[k].cross_force(momentum);
                self.composite[k] = self.inertia[k];
            } else {
                self.force[k] = Spatial::fill(o);
                self.composite[k] = Inertia::zero();
            }
        }
        for part in &tree.drags {
            let push = drag::force(
                part,
                &tree.options,
                &self.r[part.dof],
                self.p[part.dof],
                self.v[part.dof],
            );
            self.force[part.dof] = self.force[part.dof] - push;
        }
        for k in (0..n).rev() {
            let dof = &tree.dofs[k];
            let mut tau = -self.s[k].dot(self.force[k]);
            if !dof.damping.is_absent() {
                tau -= v[k] * dof.damping.of(params);
            }
            if !dof.stiffness.is_absent() {
                tau -= (q[dof.q] - dof.spring) * dof.stiffness.of(params);
            }
            self.tau[k] = tau;
            let momentum = self.composite[k].times(self.s[k]);
            *self.mass.at_mut(k, k) = self.s[k].dot(momentum) + dof.armature.of(params);
            let mut j = tree.parent[k];
            while j != NONE {
                *self.mass.at_mut(k, j) = self.s[j].dot(momentum);
                j = tree.parent[j];
            }
            let j = tree.parent[k];
            if j != NONE {
                let (force, composite) = (self.force[k], self.composite[k]);
                self.force[j] += force;
                self.composite[j].add(&composite);
            }
        }
        self.actuate(tree, [q, v, u, params]);
    }

    #[inline(always)]
    fn actuate(&mut self, tree: &Tree, [q, v, u, params]: Arguments<'_, T>) {
        // One actuator per joint is the rule; a range of the joint bounds their sum.
        self.actuation.fill(T::zero());
        for (motor, &u) in tree.motors.iter().zip(u) {
            let force = motor.limited(motor.force(tree, [q, v, params], u));
            let force = force * motor.gear.of(params);
            for &(k, by) in &motor.ends {
                self.actuation[k] += times(force, by);
            }
        }
        for (k, dof) in tree.dofs.iter().enumerate() {
            let force = self.actuation[k];
            self.tau[k] += dof.force_range.map_or(force, |[low, high]| force.clamp(low, high));
        }
    }

    /// Everything but constraints.
    #[inline(always)]
    pub(crate) fn unconstrained(&mut self, tree: &Tree, arguments: Arguments<'_, T>) {
        self.kinematics(tree, arguments);
        self.forces(tree, arguments);
    }

    /// Writes the acceleration of a step with implicit damping: `(M + dt B) a' = M a = τ + Jᵀ f`.
    #[inline(always)]
    pub(crate) fn damp(&mut self, tree: &Tree, [q, v, u, params]: Arguments<'_, T>) {
        if !tree.damps {
            self.stepped.copy_from_slice(&self.a);
            return;
        }
        let mut stepped = std::mem::take(&mut self.stepped);
        self.constrained(tree, &mut stepped);
        self.damped.copy(&self.mass, &tree.parent, crate::matrix::Chains::Tree(&tree.parent));
        let dt = tree.options.dt;
        for (k, dof) in tree.dofs.iter().enumerate() {
            *self.damped.at_mut(k, k) += dof.damping.of(params) * dt;
        }
        if tree.implicit_feedback() {
            let damps = |(motor, _): &(&Motor, _)| !motor.velocity.is_absent();
            for (motor, &u) in tree.motors.iter().zip(u).filter(damps) {
                let gear = motor.gear.of(params);
                let force = motor.force(tree, [q, v, params], u);
                let passes = motor.feeds_back(tree, force, &self.actuation);
                let feedback = gear * gear * passes * (motor.velocity.of(params) * dt);
                for &(k, j, by) in &motor.pairs {
                    *self.damped.at_mut(k, j) += times(feedback, by);
                }
            }
        }
        self.damped.factor(&tree.parent);
        self.damped.solve(&tree.parent, &mut stepped);
        self.stepped = stepped;
    }
}

impl Dof {
    /// 1 if the sum of the forces of actuators is inside its range, else 0.
    #[inline(always)]
    pub(crate) fn passes<T: Scalar>(&self, force: T) -> T {
        self.force_range.map_or(T::one(), |range| inside(force, range))
    }
}

impl Motor {
    /// Position and velocity: the sums of those of its ends.
    #[inline(always)]
    pub(crate) fn motion<T: Scalar>(&self, tree: &Tree, q: &[T], v: &[T]) -> (T, T) {
        let end = |&(k, by): &(usize, f64)| (times(q[tree.dofs[k].q], by), times(v[k], by));
        let ends = self.ends.iter().map(end);
        ends.reduce(|sum, end| (sum.0 + end.0, sum.1 + end.1)).unwrap_or((T::zero(), T::zero()))
    }

    /// Force before its range and the gear.
    #[inline(always)]
    pub(crate) fn force<T: Scalar>(&self, tree: &Tree, [q, v, params]: [&[T]; 3], u: T) -> T {
        let u = self.control_range.map_or(u, |[low, high]| u.clamp(low, high));
        let mut force = u * self.gain.of(params);
        if !self.position.is_absent() || !self.velocity.is_absent() || self.constant != 0.0 {
            let (q, v) = self.motion(tree, q, v);
            let against = q * self.position.of(params) + v * self.velocity.of(params);
            force += -(against * self.gear.of(params)) + self.constant;
        }
        force
    }

    /// 1 if the force is inside its range, else 0.
    #[inline(always)]
    pub(crate) fn passes<T: Scalar>(&self, force: T) -> T {
        self.force_range.map_or(T::one(), |range| inside(force, range))
    }

    /// 1 if velocity feedback is implicit, else 0: the force is inside its range, and the sum of the
    /// actuators inside that of the joint. MuJoCo does not ask for the latter at the ends of tendons.
    #[inline(always)]
    pub(crate) fn feeds_back<T: Scalar>(&self, tree: &Tree, force: T, actuation: &[T]) -> T {
        match self.ends[..] {
            [(k, _)] if !self.is_tendon => self.passes(force) * tree.dofs[k].passes(actuation[k]),
            _ => self.passes(force),
        }
    }

    /// The force within its range.
    #[inline(always)]
    pub(crate) fn limited<T: Scalar>(&self, force: T) -> T {
        self.force_range.map_or(force, |[low, high]| force.clamp(low, high))
    }
}

/// The number times a coefficient, which is often 1.
#[inline(always)]
fn times<T: Scalar>(x: T, by: f64) -> T {
    if by == 1.0 { x } else { x * by }
}

/// 1 inside of a range, 0 outside.
#[inline(always)]
pub(crate) fn inside<T: Scalar>(x: T, [low, high]: [f64; 2]) -> T {
    let (o, one) = (T::zero(), T::one());
    T::select_lt(x, T::from(high), T::select_lt(T::from(low), x, one, o), o)
}

/// Inertia about the origin of a link at this pose.
#[inline(always)]
fn link_inertia<T: Scalar>(dof: &Dof, turn: &M<T>, at: V<T>, params: &[T]) -> Inertia<T> {
    let placed = |part: &Inertial, mass: T, moments: [T; 6]| {
        Inertia::of(mass, add(at, rotate(turn, part.centre)), moments)
    };
    let fixed = &dof.fixed;
    let mut all = if fixed.mass > 0.0 {
        placed(fixed, T::from(fixed.mass), congruence(turn, &fixed.moments))
    } else {
        Inertia::zero()
    };
    for (mass, part) in &dof.varied {
        let mass = mass.of(params);
        let mut moments = congruence(turn, &part.moments);
        moments.iter_mut().for_each(|moment| *moment *= mass);
        all.add(&placed(part, mass, moments));
    }
    for part in &dof.shaped {
        all.add(&part.inertia(turn, at, params));
    }
    all
}

/// Rotation by an angle about a unit vector.
#[inline(always)]
fn about<T: Scalar>([x, y, z]: [f64; 3], angle: T) -> M<T> {
    let (sin, cos) = angle.sin_cos();
    let rest = -cos + 1.0;
    [
        [rest * (x * x) + cos, rest * (x * y) - sin * z, rest * (x * z) + sin * y],
        [rest * (x * y) + sin * z, rest * (y * y) + cos, rest * (y * z) - sin * x],
        [rest * (x * z) - sin * y, rest * (y * z) + sin * x, rest * (z * z) + cos],
    ]
}

/// Rotation of a quaternion of any length.
#[inline(always)]
fn of_quaternion<T: Scalar>(q: &[T]) -> M<T> {
    let [w, x, y, z] = [q[0], q[1], q[2], q[3]];
    let c = T::from(2.0) / (w * w + x * x + y * y + z * z);
    let one = |a: T| -(a * c) + 1.0;
    [
        [one(y * y + z * z), (x * y - w * z) * c, (x * z + w * y) * c],
        [(x * y + w * z) * c, one(x * x + z * z), (y * z - w * x) * c],
        [(x * z - w * y) * c, (y * z + w * x) * c, one(x * x + y * y)],
    ]
}
