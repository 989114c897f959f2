//! One time step and its reverse derivative, in outlined phases.
//!
//! Euler's method computes one acceleration, the Runge-Kutta method four. A phase is compiled once
//! per scalar and called, since a whole step that is inlined takes minutes to compile.

#[cfg(test)]
mod stress;

use crate::adjoint::{Back, Bars};
use crate::contact::Contact;
use crate::dynamics::{Arguments, Work};
use crate::model::Integrator;
use crate::rows::rows;
use crate::spatial::*;
use crate::tree::{Kind, NONE, Placed, Tree};
use physgrad::engine::kernels::Vectorized;
use physgrad::engine::outline;
use physgrad::{Cotangent, Cotangents, Inputs, Real, Scalar};

/// Parts of an acceleration.
const KINEMATICS: usize = 0;
const FORCES: usize = 1;
const CONSTRAINTS: usize = 2;
const SOLVE: usize = 3;
const NEWTON: usize = 4;
const DAMP: usize = 5;

struct Phase<'a, T, const PART: usize> {
    work: &'a mut Work<T>,
    tree: &'a Tree,
    arguments: Arguments<'a, T>,
}

impl<T: Scalar, const PART: usize> Vectorized for Phase<'_, T, PART> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { work, tree, arguments } = self;
        let [q, v, _, params] = arguments;
        match PART {
            KINEMATICS => work.kinematics(tree, arguments),
            FORCES => work.forces(tree, arguments),
            CONSTRAINTS => {
                let mut found = std::mem::take(&mut work.rows);
                rows(tree, q, v, params, &mut found);
                work.rows = found;
                work.find_contacts(tree, v, params);
                work.prepare_solver();
            }
            SOLVE => {
                let mut along = std::mem::take(&mut work.along);
                work.solve(tree, &mut along, newton::<T>);
                work.along = along;
            }
            NEWTON => {
                work.assemble(tree);
                work.newton_step(tree);
            }
            _ => work.damp(tree, arguments),
        }
    }
}

fn newton<T: Scalar>(work: &mut Work<T>, tree: &Tree) {
    outline::<T>(Phase::<T, NEWTON> { work, tree, arguments: [&[]; 4] });
}

/// Computes the acceleration of a step.
pub(crate) fn accelerate<T: Scalar>(work: &mut Work<T>, tree: &Tree, arguments: Arguments<'_, T>) {
    work.fit(tree);
    outline::<T>(Phase::<T, KINEMATICS> { work, tree, arguments });
    outline::<T>(Phase::<T, FORCES> { work, tree, arguments });
    outline::<T>(Phase::<T, CONSTRAINTS> { work, tree, arguments });
    outline::<T>(Phase::<T, SOLVE> { work, tree, arguments });
    outline::<T>(Phase::<T, DAMP> { work, tree, arguments });
}

/// Parts of the reverse pass.
const ADJOINT: usize = 0;
const CONTACTS: usize = 1;
const SWEEP: usize = 2;

struct Reverse<'a, 'b, R, C, const PART: usize> {
    back: &'a mut Back<R, C>,
    work: &'a Work<R>,
    tree: &'a Tree,
    arguments: Arguments<'a, R>,
    bar: &'a [C],
    bars: &'a mut Bars<'b, C>,
}

impl<R: Real, C: Cotangent<R>, const PART: usize> Vectorized for Reverse<'_, '_, R, C, PART> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { back, work, tree, arguments, bar, bars } = self;
        let [_, v, _, params] = arguments;
        match PART {
            ADJOINT => {
                back.solve(tree, work, bar);
                back.move_links(tree, work, v);
                back.inertial(tree, work, params, bars);
                back.rows(tree, work, bars);
            }
            CONTACTS => {
                for contact in &work.contacts {
                    back.contact(tree, work, contact, params, bars);
                }
            }
            _ => back.sweep(tree, work, arguments, bars),
        }
    }
}

/// Adds the cotangents of the arguments of an acceleration with the cotangent `bar`. `work` is that
/// of the acceleration.
fn pull<R: Real, C: Cotangent<R>>(
    back: &mut Back<R, C>,
    work: &mut Work<R>,
    tree: &Tree,
    arguments: Arguments<'_, R>,
    bar: &[C],
    bars: &mut Bars<'_, C>,
) {
    if !work.is_exact {
        newton(work, tree);
        work.is_exact = true;
    }
    outline::<R>(Reverse::<_, _, ADJOINT> { back, work, tree, arguments, bar, bars });
    if !work.contacts.is_empty() {
        outline::<R>(Reverse::<_, _, CONTACTS> { back, work, tree, arguments, bar, bars });
    }
    outline::<R>(Reverse::<_, _, SWEEP> { back, work, tree, arguments, bar, bars });
}

/// Force of a contact on the body of its second shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactForce<T> {
    /// Which point of the shapes of the model touches.
    pub contact: usize,
    /// The body.
    pub body: usize,
    /// Where the force acts, m, in axes of the world.
    pub point: [T; 3],
    /// The force, N, in axes of the world.
    pub force: [T; 3],
}

/// Buffers of a step: those of each acceleration, and the states between them.
#[derive(Debug)]
pub(crate) struct Buffers<T> {
    stages: [Stage<T>; 4],
    /// Velocity and acceleration of a whole step.
    mean: [Vec<T>; 2],
}

#[derive(Debug)]
struct Stage<T> {
    q: Vec<T>,
    v: Vec<T>,
    /// Rates of the coordinates whose motion from the first stage gives `q`, see [`rates`].
    rate: Vec<T>,
    work: Work<T>,
}

impl<T: Scalar> Default for Buffers<T> {
    fn default() -> Self {
        let stage =
            || Stage { q: Vec::new(), v: Vec::new(), rate: Vec::new(), work: Work::default() };
        Self { stages: std::array::from_fn(|_| stage()), mean: [Vec::new(), Vec::new()] }
    }
}

/// Nodes and weights of the Runge-Kutta method of order 4.
const NODES: [f64; 3] = [0.5, 0.5, 1.0];
const WEIGHTS: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];

impl<T: Scalar> Buffers<T> {
    /// Writes the next state.
    pub(crate) fn step(&mut self, tree: &Tree, inputs: Inputs<'_, T>, next: &mut [T]) {
        let Inputs { x, u, p, .. } = inputs;
        let (q, v) = x.split_at(tree.nq);
        let dt = tree.options.dt;
        let (q_next, v_next) = next.split_at_mut(tree.nq);
        if tree.options.integrator != Integrator::Rk4 {
            let work = &mut self.stages[0].work;
            accelerate(work, tree, [q, v, u, p]);
            for (k, next) in v_next.iter_mut().enumerate() {
                *next = v[k] + work.stepped[k] * dt;
            }
            return advance(tree, q, v_next, dt, q_next);
        }
        self.stage_states(tree, inputs);
        self.average(tree.nv());
        let [velocity, acceleration] = &self.mean;
        for (k, next) in v_next.iter_mut().enumerate() {
            *next = v[k] + acceleration[k] * dt;
        }
        advance(tree, q, velocity, dt, q_next);
    }

    /// Accelerations of the four stages.
    fn stage_states(&mut self, tree: &Tree, Inputs { x, u, p, .. }: Inputs<'_, T>) {
        let (q, v) = x.split_at(tree.nq);
        for i in 0..4 {
            let (before, rest) = self.stages.split_at_mut(i);
            let stage = &mut rest[0];
            stage.q.resize(q.len(), T::zero());
            stage.v.resize(v.len(), T::zero());
            stage.rate.resize(v.len(), T::zero());
            match before.last() {
                None => {
                    stage.q.copy_from_slice(q);
                    stage.v.copy_from_slice(v);
                    stage.rate.copy_from_slice(v);
                }
                Some(last) => {
                    let h = NODES[i - 1] * tree.options.dt;
                    for k in 0..v.len() {
                        stage.v[k] = v[k] + last.work.stepped[k] * h;
                    }
                    advance(tree, q, &last.rate, h, &mut stage.q);
                    rates(tree, &last.rate, h, &stage.v, &mut stage.rate);
                }
            }
            accelerate(&mut stage.work, tree, [&stage.q, &stage.v, u, p]);
        }
    }

    fn average(&mut self, n: usize) {
        for mean in &mut self.mean {
            mean.clear();
            mean.resize(n, T::zero());
        }
        for (stage, weight) in self.stages.iter().zip(WEIGHTS) {
            for k in 0..n {
                self.mean[0][k] += stage.rate[k] * weight;
                self.mean[1][k] += stage.work.stepped[k] * weight;
            }
        }
    }

    /// Position and orientation of each body.
    pub(crate) fn poses(&mut self, tree: &Tree, q: &[T], p: &[T]) -> Vec<(V<T>, M<T>)> {
        let work = &mut self.stages[0].work;
        work.resize(tree);
        let rest = vec![T::zero(); tree.nv()];
        work.kinematics(tree, [q, &rest, &[], p]);
        let pose = |body: &Placed| {
            let at = work.point(body.dof, body.position);
            let turn = match body.dof {
                NONE => body.rotation.map(constant),
                dof => product_with(&work.r[dof], &body.rotation),
            };
            (add(at, work.origin), turn)
        };
        tree.bodies.iter().map(pose).collect()
    }

    /// Contacts that push at a state.
    pub(crate) fn contact_forces(
        &mut self,
        tree: &Tree,
        arguments: Arguments<'_, T>,
    ) -> Vec<ContactForce<T>> {
        let work = &mut self.stages[0].work;
        accelerate(work, tree, arguments);
        let contacts = work.contacts.iter().map(|contact| {
            let Contact { index, frame, f, .. } = *contact;
            let along = |i: usize| scale(frame[i], f[i]);
            ContactForce {
                contact: index,
                body: tree.contacts[index].body,
                point: add(contact.x, work.origin),
                force: add(along(0), add(along(1), along(2))),
            }
        });
        contacts.collect()
    }

    /// Acceleration at a state, and iterations of the solver.
    pub(crate) fn acceleration(
        &mut self,
        tree: &Tree,
        arguments: Arguments<'_, T>,
    ) -> (&[T], usize) {
        let work = &mut self.stages[0].work;
        accelerate(work, tree, arguments);
        (&work.a, work.iterations)
    }
}

/// Buffers of the cotangents of a step.
#[derive(Debug)]
pub(crate) struct Bar<R, C> {
    back: Back<R, C>,
    q: Vec<C>,
    v: Vec<C>,
    a: Vec<C>,
    /// Cotangents of the stages of the Runge-Kutta method.
    stage: [Vec<C>; 2],
    velocity: Vec<C>,
    /// Cotangents of the rates of a stage, and of the stage before from those.
    rate: Vec<C>,
    before: Vec<C>,
}

impl<R, C> Default for Bar<R, C> {
    fn default() -> Self {
        Self {
            back: Back::default(),
            q: Vec::new(),
            v: Vec::new(),
            a: Vec::new(),
            stage: [Vec::new(), Vec::new()],
            velocity: Vec::new(),
            rate: Vec::new(),
            before: Vec::new(),
        }
    }
}

impl<R: Real, C: Cotangent<R>> Bar<R, C> {
    /// Adds the cotangents of a step.
    pub(crate) fn vjp(
        &mut self,
        buffers: &mut Buffers<R>,
        tree: &Tree,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let n = tree.nv();
        for (list, length) in
            [(&mut self.q, tree.nq), (&mut self.v, n), (&mut self.a, n), (&mut self.velocity, n)]
        {
            list.clear();
            list.resize(length, C::null());
        }
        let Cotangents { x: x_bar, mut u, mut p } = cotangents;
        if tree.options.integrator == Integrator::Rk4 {
            self.rk4(buffers, tree, inputs, next_bar, (&mut u, &mut p));
        } else {
            self.euler(buffers, tree, inputs, next_bar, (&mut u, &mut p));
        }
        if let Some(x_bar) = x_bar {
            for (bar, &by) in x_bar.iter_mut().zip(self.q.iter().chain(&self.v)) {
                *bar += by;
            }
        }
    }

    fn euler(
        &mut self,
        buffers: &mut Buffers<R>,
        tree: &Tree,
        Inputs { x, u, p, .. }: Inputs<'_, R>,
        next_bar: &[C],
        (u_bar, p_bar): (&mut Option<&mut [C]>, &mut Option<&mut [C]>),
    ) {
        let (q, v) = x.split_at(tree.nq);
        let dt = tree.options.dt;
        let (q_next_bar, v_next_bar) = next_bar.split_at(tree.nq);
        let work = &mut buffers.stages[0].work;
        accelerate(work, tree, [q, v, u, p]);
        let velocity = &mut buffers.mean[0];
        velocity.clear();
        velocity.extend(v.iter().zip(&work.stepped).map(|(&v, &a)| v + a * dt));
        self.v.copy_from_slice(v_next_bar);
        advance_vjp(tree, q, velocity, dt, q_next_bar, (&mut self.q, &mut self.v));
        for (a, &v) in self.a.iter_mut().zip(&self.v) {
            *a = v * R::from(dt);
        }
        let mut bars = Bars {
            q: &mut self.q,
            v: &mut self.v,
            u: u_bar.as_deref_mut(),
            p: p_bar.as_deref_mut(),
        };
        pull(&mut self.back, work, tree, [q, v, u, p], &self.a, &mut bars);
    }

    fn rk4(
        &mut self,
        buffers: &mut Buffers<R>,
        tree: &Tree,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        (u_bar, p_bar): (&mut Option<&mut [C]>, &mut Option<&mut [C]>),
    ) {
        let Inputs { x, u, p, .. } = inputs;
        let (q, v) = x.split_at(tree.nq);
        let (n, dt) = (v.len(), tree.options.dt);
        let (q_next_bar, v_next_bar) = next_bar.split_at(tree.nq);
        buffers.stage_states(tree, inputs);
        buffers.average(n);
        self.v.copy_from_slice(v_next_bar);
        // Cotangent of the mean rate, which each stage shares.
        advance_vjp(tree, q, &buffers.mean[0], dt, q_next_bar, (&mut self.q, &mut self.velocity));
        let mut from_later: Option<f64> = None;
        for i in (0..4).rev() {
            let weight = R::from(WEIGHTS[i]);
            // Cotangents of rate and acceleration of this stage: from the means, and from the
            // state of the next stage, in `stage` and `before`.
            for k in 0..n {
                self.a[k] = v_next_bar[k] * (weight * dt);
            }
            self.rate.clear();
            self.rate.extend(self.velocity.iter().map(|&bar| bar * weight));
            if let Some(h) = from_later {
                let [stage_q, stage_v] = &self.stage;
                for k in 0..n {
                    self.a[k] += stage_v[k] * R::from(h);
                    self.v[k] += stage_v[k];
                    self.rate[k] += self.before[k];
                }
                advance_vjp(
                    tree,
                    q,
                    &buffers.stages[i].rate,
                    h,
                    stage_q,
                    (&mut self.q, &mut self.rate),
                );
            }
            from_later = (i > 0).then(|| NODES[i - 1] * dt);
            if let Some(h) = from_later {
                self.before.clear();
                self.before.resize(n, C::null());
                let [last, stage] = [&buffers.stages[i - 1], &buffers.stages[i]];
                rates_vjp(tree, &last.rate, h, &stage.v, (&mut self.rate, &mut self.before));
            }
            let Stage { q: at, v: speed_at, work, .. } = &mut buffers.stages[i];
            let [stage_q, stage_v] = &mut self.stage;
            stage_q.clear();
            stage_q.resize(q.len(), C::null());
            stage_v.clear();
            stage_v.extend_from_slice(&self.rate);
            let mut bars =
                Bars { q: stage_q, v: stage_v, u: u_bar.as_deref_mut(), p: p_bar.as_deref_mut() };
            pull(&mut self.back, work, tree, [at, speed_at, u, p], &self.a, &mut bars);
        }
        // The first stage is the state itself.
        let [stage_q, stage_v] = &self.stage;
        for (bar, &by) in self.q.iter_mut().zip(stage_q) {
            *bar += by;
        }
        for (bar, &by) in self.v.iter_mut().zip(stage_v) {
            *bar += by;
        }
    }
}

/// Positions after the time `h` at the velocities `v`.
#[inline(always)]
fn advance<T: Scalar>(tree: &Tree, q: &[T], v: &[T], h: f64, next: &mut [T]) {
    for (k, dof) in tree.dofs.iter().enumerate() {
        match dof.kind {
            Kind::Slide | Kind::Hinge => next[dof.q] = q[dof.q] + v[k] * h,
            Kind::Turn(0) => {
                let w = [v[k], v[k + 1], v[k + 2]];
                let half = 0.5 * h;
                let Sinc { s, c, .. } = Sinc::of(dot(w, w) * (half * half));
                let s = s * half;
                let turned = hamilton(
                    [q[dof.q], q[dof.q + 1], q[dof.q + 2], q[dof.q + 3]],
                    [c, w[0] * s, w[1] * s, w[2] * s],
                );
                next[dof.q..dof.q + 4].copy_from_slice(&turned);
            }
            Kind::Turn(_) => {}
        }
    }
}

/// Adds the cotangents of positions and velocities in [`advance`].
#[inline(always)]
fn advance_vjp<R: Real, C: Cotangent<R>>(
    tree: &Tree,
    q: &[R],
    v: &[R],
    h: f64,
    next_bar: &[C],
    (q_bar, v_bar): (&mut [C], &mut [C]),
) {
    for (k, dof) in tree.dofs.iter().enumerate() {
        match dof.kind {
            Kind::Slide | Kind::Hinge => {
                q_bar[dof.q] += next_bar[dof.q];
                v_bar[k] += next_bar[dof.q] * R::from(h);
            }
            Kind::Turn(0) => {
                let w = [v[k], v[k + 1], v[k + 2]];
                let bar: [C; 4] = [
                    next_bar[dof.q],
                    next_bar[dof.q + 1],
                    next_bar[dof.q + 2],
                    next_bar[dof.q + 3],
                ];
                let half = 0.5 * h;
                let Sinc { s, c, e } = Sinc::of(dot(w, w) * (half * half));
                let sh = s * half;
                let back = hamilton(bar, [c, -(w[0] * sh), -(w[1] * sh), -(w[2] * sh)]);
                for i in 0..4 {
                    q_bar[dof.q + i] += back[i];
                }
                // conj(q) ⊗ bar.
                let [a, x, y, z] = [q[dof.q], q[dof.q + 1], q[dof.q + 2], q[dof.q + 3]];
                let real = bar[0] * a + bar[1] * x + bar[2] * y + bar[3] * z;
                let turn = [
                    bar[1] * a - bar[0] * x - bar[3] * y + bar[2] * z,
                    bar[2] * a + bar[3] * x - bar[0] * y - bar[1] * z,
                    bar[3] * a - bar[2] * x + bar[1] * y - bar[0] * z,
                ];
                let along = dot(turn, w) * (e * half * half) - real * (s * half);
                for i in 0..3 {
                    v_bar[k + i] += (turn[i] * s + along * w[i]) * R::from(half);
                }
            }
            Kind::Turn(_) => {}
        }
    }
}

/// Rates of the coordinates of a stage at the velocities `v`, where `last` are those of the stage
/// before, whose motion for the time `h` leads to this stage.
///
/// Slides and hinges have their velocities. A turn has the rate of the rotation vector θ from the
/// first stage, `w + ½ θ × w + g θ × (θ × w)` with `g = (1 - ½|θ| cot(½|θ|)) / |θ|²`. Source:
/// H. Munthe-Kaas, High order Runge-Kutta methods on manifolds, Applied Numerical Mathematics 29,
/// 1999. The sign is that of velocities in axes of the body.
#[inline(always)]
fn rates<T: Scalar>(tree: &Tree, last: &[T], h: f64, v: &[T], rates: &mut [T]) {
    rates.copy_from_slice(v);
    for (k, _) in tree.dofs.iter().enumerate().filter(|(_, dof)| dof.kind == Kind::Turn(0)) {
        let (theta, w) = (three!(|i| last[k + i] * h), [v[k], v[k + 1], v[k + 2]]);
        let (g, _) = curvature(dot(theta, theta));
        let across = cross(theta, w);
        let rate = add(w, add(scale(across, T::from(0.5)), scale(cross(theta, across), g)));
        rates[k..k + 3].copy_from_slice(&rate);
    }
}

/// Replaces the cotangents of the rates in [`rates`] by those of the velocities, and adds those of
/// the rates before.
#[inline(always)]
fn rates_vjp<R: Real, C: Cotangent<R>>(
    tree: &Tree,
    last: &[R],
    h: f64,
    v: &[R],
    (bars, last_bar): (&mut [C], &mut [C]),
) {
    let half = R::from(0.5);
    for (k, _) in tree.dofs.iter().enumerate().filter(|(_, dof)| dof.kind == Kind::Turn(0)) {
        let (theta, w) = (three!(|i| last[k + i] * h), [v[k], v[k + 1], v[k + 2]]);
        let bar = [bars[k], bars[k + 1], bars[k + 2]];
        let (g, slope) = curvature(dot(theta, theta));
        let across = cross(bar, theta);
        let w_bar = add(bar, add(scale(across, half), scale(cross(across, theta), g)));
        bars[k..k + 3].copy_from_slice(&w_bar);
        // θ × (θ × w) = θ (θ · w) - w (θ · θ).
        let (along, with) = (dot(bar, theta), dot(bar, w));
        let by_vector =
            add(scale(bar, dot(theta, w)), sub(spread(along, w), spread(with + with, theta)));
        let by_g = along * dot(theta, w) - with * dot(theta, theta);
        let theta_bar = add(
            sub(scale(cross(bar, w), -half), spread(by_g * (-slope - slope), theta)),
            scale(by_vector, g),
        );
        for i in 0..3 {
            last_bar[k + i] += theta_bar[i] * R::from(h);
        }
    }
}

/// g of [`rates`] and its derivative, as functions of |θ|².
#[inline(always)]
fn curvature<T: Scalar>(square: T) -> (T, T) {
    let quarter = square * 0.25;
    let Sinc { s, e, .. } = Sinc::of(quarter);
    let slope_far = -(s + e * 3.0) / (quarter * 2.0).max(1e-8);
    let series = (quarter * (1.0 / 15120.0) - 1.0 / 420.0) * quarter + 1.0 / 30.0;
    let slope = T::select_lt(quarter, T::from(1e-3), series, slope_far);
    let g = -e / (s * 4.0);
    (g, (e * e * 0.5 - slope * s) / (s * s * 16.0))
}

/// Functions of x²: sin(x)/x, cos(x), and (cos(x) - sin(x)/x)/x².
struct Sinc<T> {
    s: T,
    c: T,
    e: T,
}

impl<T: Scalar> Sinc<T> {
    #[inline(always)]
    fn of(square: T) -> Self {
        let x = square.max(1e-8).sqrt();
        let (sin, cos) = x.sin_cos();
        let small = T::from(1e-3);
        let near = |near: T, far: T| T::select_lt(square, small, near, far);
        let series = |a: f64, b: f64, c: f64, d: f64| ((square * d + c) * square + b) * square + a;
        Self {
            s: near(series(1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0), sin / x),
            c: near(series(1.0, -0.5, 1.0 / 24.0, -1.0 / 720.0), cos),
            e: near(
                series(-1.0 / 3.0, 1.0 / 30.0, -1.0 / 840.0, 1.0 / 45360.0),
                (cos - sin / x) / square.max(1e-8),
            ),
        }
    }
}

/// Product of quaternions.
#[inline(always)]
fn hamilton<T: Copy, X: Linear<T>>(a: [X; 4], b: [T; 4]) -> [X; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}
