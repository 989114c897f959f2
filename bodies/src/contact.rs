//! [`Candidate`]: two shapes that may touch, and [`Contact`]: their contact at one state.
//!
//! A contact has a frame: the normal from the first shape to the second, and two tangents. Its
//! velocity is that of the second body relative to the first, at the contact point, in this frame.

use crate::cone::{Block, Cone, Law};
use crate::dynamics::Work;
use crate::geometry::{Capsule, nearest};
use crate::model::{Cone as Friction, *};
use crate::rows::Soft;
use crate::spatial::*;
use crate::tree::{Coefficient, NONE, Tree};
use physgrad::Scalar;

/// Two shapes that may touch in one point.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub(crate) pair: Pair,
    /// Body of the second shape.
    pub(crate) body: usize,
    pub(crate) law: Law,
    pub(crate) ratio: f64,
    pub(crate) soft: Soft,
    /// Distance at which the contact begins to push, m.
    pub(crate) margin: f64,
    /// Coefficients of friction, of which the larger counts.
    pub(crate) friction: [Coefficient; 2],
    /// Inverse mass of the contact in the reference pose.
    weight: f64,
    /// Degrees of freedom that move the bodies relative to each other, in increasing order, and
    /// whether each moves the second body.
    pub(crate) path: Vec<(usize, bool)>,
    /// Whether the path has two branches.
    branches: bool,
}

/// Forms that touch.
#[derive(Clone, Debug)]
pub(crate) enum Pair {
    /// A ball, an end of a capsule, or a corner against a plane of the world.
    Plane {
        /// Unit normal and a point of the plane.
        normal: Vec3,
        point: Vec3,
        /// Tangents without an axis.
        tangents: [Vec3; 2],
        /// Link, centre in its frame, radius.
        dof: usize,
        centre: Vec3,
        radius: f64,
        /// Unit axis of a capsule, to which the tangents are aligned.
        axis: Option<Vec3>,
        /// Centre of a box, for corners, which touch only below it.
        middle: Option<Vec3>,
    },
    /// Balls and capsules.
    Capsules([CapsuleOf; 2]),
}

/// A capsule of a link, or a ball without length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CapsuleOf {
    /// `NONE` for capsules of the world.
    pub(crate) dof: usize,
    pub(crate) centre: Vec3,
    /// From the centre to one end.
    pub(crate) half: Vec3,
    pub(crate) radius: f64,
}

/// A contact at one state.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Contact<T> {
    pub(crate) index: usize,
    /// Contact point relative to the origin.
    pub(crate) x: V<T>,
    /// Normal and tangents.
    pub(crate) frame: M<T>,
    /// Distance minus margin.
    pub(crate) distance: T,
    pub(crate) cone: Cone<T>,
    pub(crate) reference: V<T>,
    /// First column in [`Work::columns`].
    pub(crate) first: usize,
    /// Acceleration over the reference, force and stiffness, in the frame.
    pub(crate) s: V<T>,
    pub(crate) f: V<T>,
    pub(crate) w: Block<T>,
}

/// All pairs of shapes that may touch.
///
/// # Errors
/// A pair has forms whose contact is not supported.
pub(crate) fn candidates(model: &Model, tree: &Tree) -> Result<Vec<Candidate>, String> {
    let mut all = Vec::new();
    for second in 0..model.shapes.len() {
        for first in 0..second {
            if may_touch(model, tree, first, second) {
                add_pair(model, tree, [first, second], &mut all)?;
            }
        }
    }
    Ok(all)
}

/// Whether kinds, bodies and exclusions let two shapes touch.
fn may_touch(model: &Model, tree: &Tree, first: usize, second: usize) -> bool {
    let (a, b) = (&model.shapes[first], &model.shapes[second]);
    if a.kinds & b.touches == 0 && b.kinds & a.touches == 0 {
        return false;
    }
    let welded = |body: usize| tree.bodies[body].welded;
    let (i, j) = (welded(a.body), welded(b.body));
    if i == j
        || model.excluded.iter().any(|pair| [[a.body, b.body], [b.body, a.body]].contains(pair))
    {
        return false;
    }
    let above = |body: usize| welded(model.bodies[body].parent);
    i == 0 || j == 0 || (above(i) != j && above(j) != i)
}

fn add_pair(
    model: &Model,
    tree: &Tree,
    [first, second]: [usize; 2],
    all: &mut Vec<Candidate>,
) -> Result<(), String> {
    let rank = |i: usize| match model.shapes[i].form {
        Form::Plane => 0,
        Form::Sphere(_) => 1,
        Form::Capsule(..) => 2,
        Form::Ellipsoid(_) => 3,
        Form::Cylinder(..) => 4,
        Form::Box(_) => 5,
    };
    let shapes = if rank(first) <= rank(second) { [first, second] } else { [second, first] };
    let [a, b] = shapes.map(|i| &model.shapes[i]);
    let pairs = match (a.form, b.form) {
        (Form::Plane, _) => against_plane(model, tree, a, b)?,
        (Form::Sphere(_) | Form::Capsule(..), Form::Sphere(_) | Form::Capsule(..)) => {
            vec![Pair::Capsules([a, b].map(|shape| capsule_of(tree, shape)))]
        }
        _ => return Err(unsupported(a, b)),
    };
    let dimension = match a.priority.cmp(&b.priority) {
        std::cmp::Ordering::Equal => a.dimension.max(b.dimension),
        std::cmp::Ordering::Greater => a.dimension,
        std::cmp::Ordering::Less => b.dimension,
    };
    let law = match (dimension, model.options.cone) {
        (1, _) => Law::Frictionless,
        (3, Friction::Pyramidal) => Law::Pyramidal,
        (3, Friction::Elliptic) => Law::Elliptic,
        _ => {
            return Err(format!(
                "{} and {} touch with `condim` {dimension}; torsional and rolling friction are not \
                 simulated, so set `condim` to 3 or 1",
                place(a),
                place(b)
            ));
        }
    };
    let path = path(tree, a.body, b.body);
    let branches = path.iter().any(|end| end.1) && path.iter().any(|end| !end.1);
    let friction = match a.priority.cmp(&b.priority) {
        std::cmp::Ordering::Greater => [shapes[0]; 2],
        std::cmp::Ordering::Less => [shapes[1]; 2],
        std::cmp::Ordering::Equal => shapes,
    };
    for pair in pairs {
        all.push(Candidate {
            pair,
            body: b.body,
            law,
            ratio: model.options.impedance_ratio,
            soft: Soft::new(&softness(a, b), model.options.dt),
            // A gap only lists contacts that do not push yet.
            margin: a.margin + b.margin,
            friction: friction.map(|shape| tree.friction[shape]),
            weight: tree.bodies[a.body].weight + tree.bodies[b.body].weight,
            path: path.clone(),
            branches,
        });
    }
    Ok(())
}

fn unsupported(a: &Shape, b: &Shape) -> String {
    let (first, second) = (a.form.name(), b.form.name());
    format!(
        "{} and {} may touch, and contacts of the forms {first} and {second} are not simulated; \
         replace one by a sphere or capsule, or separate their kinds (`contype`, `conaffinity`) so \
         that they do not touch",
        place(a),
        place(b)
    )
}

/// Where a shape stands in its file, or its name if no file has it.
fn place(shape: &Shape) -> String {
    match shape.place.line {
        0 => format!("the shape `{}`", shape.name),
        _ => shape.place.to_string(),
    }
}

/// Softness of a contact of two shapes: that of the one with the higher priority, else a mean.
fn softness(a: &Shape, b: &Shape) -> Softness {
    if a.priority != b.priority {
        return if a.priority > b.priority { a.softness } else { b.softness };
    }
    let part = match a.mix + b.mix {
        0.0 => 0.5,
        sum => a.mix / sum,
    };
    let mean = |x: f64, y: f64| part * x + (1.0 - part) * y;
    let (x, y) = (a.softness, b.softness);
    let times = x.reference[0] > 0.0 && y.reference[0] > 0.0;
    let reference = |i: usize| {
        let (x, y) = (x.reference[i], y.reference[i]);
        if times { mean(x, y) } else { x.min(y) }
    };
    Softness {
        reference: [reference(0), reference(1)],
        impedance: std::array::from_fn(|i| mean(x.impedance[i], y.impedance[i])),
    }
}

/// Degrees of freedom that move one body but not the other.
fn path(tree: &Tree, first: usize, second: usize) -> Vec<(usize, bool)> {
    let chain = |body: usize| {
        let (mut chain, mut dof) = (Vec::new(), tree.bodies[body].dof);
        while dof != NONE {
            chain.push(dof);
            dof = tree.parent[dof];
        }
        chain
    };
    let (a, b) = (chain(first), chain(second));
    let mut path: Vec<(usize, bool)> = a
        .iter()
        .filter(|dof| !b.contains(dof))
        .map(|&dof| (dof, false))
        .chain(b.iter().filter(|dof| !a.contains(dof)).map(|&dof| (dof, true)))
        .collect();
    path.sort_unstable();
    path
}

fn capsule_of(tree: &Tree, shape: &Shape) -> CapsuleOf {
    let (dof, centre, rotation) = placed(tree, shape);
    let (radius, half) = match shape.form {
        Form::Capsule(radius, half) => (radius, rotate(&rotation, [0.0, 0.0, half])),
        Form::Sphere(radius) => (radius, [0.0; 3]),
        _ => unreachable!("only balls and capsules are capsules"),
    };
    CapsuleOf { dof, centre, half, radius }
}

/// Link of a shape, and its pose in the frame of the link.
fn placed(tree: &Tree, shape: &Shape) -> (usize, Vec3, Mat3) {
    let body = &tree.bodies[shape.body];
    let centre = add(body.position, rotate(&body.rotation, shape.position));
    (body.dof, centre, product(&body.rotation, &shape.rotation))
}

/// Points of a shape that touch a plane.
fn against_plane(
    model: &Model,
    tree: &Tree,
    plane: &Shape,
    shape: &Shape,
) -> Result<Vec<Pair>, String> {
    let (world, point, turned) = placed(tree, plane);
    if world != NONE {
        return Err(format!(
            "the plane `{}` belongs to the body `{}`, which moves; fix it to the world",
            plane.name, model.bodies[plane.body].name
        ));
    }
    let normal = [turned[0][2], turned[1][2], turned[2][2]];
    let (dof, middle, rotation) = placed(tree, shape);
    let column = |i: usize| [rotation[0][i], rotation[1][i], rotation[2][i]];
    let end = |by: Vec3| add(middle, rotate(&rotation, by));
    let (points, radius, axis) = match shape.form {
        Form::Sphere(radius) => (vec![middle], radius, None),
        Form::Capsule(radius, half) => {
            (vec![end([0.0, 0.0, half]), end([0.0, 0.0, -half])], radius, Some(column(2)))
        }
        Form::Box(half) => {
            let sign = |bit: usize, i: usize| if bit >> i & 1 == 1 { half[i] } else { -half[i] };
            ((0..8).map(|bit| end([sign(bit, 0), sign(bit, 1), sign(bit, 2)])).collect(), 0.0, None)
        }
        _ => return Err(unsupported(plane, shape)),
    };
    let tangents = tangents(normal);
    let is_box = matches!(shape.form, Form::Box(_));
    let pair = |centre: Vec3| Pair::Plane {
        normal,
        point,
        tangents,
        dof,
        centre,
        radius,
        axis,
        middle: is_box.then_some(middle),
    };
    Ok(points.into_iter().map(pair).collect())
}

/// Two unit vectors that complete a constant normal to a frame.
fn tangents(normal: Vec3) -> [Vec3; 2] {
    let first = crate::geometry::tangent(normal);
    [first, cross(normal, first)]
}

impl<T: Scalar> Work<T> {
    /// Point of a link, relative to the origin. Points of the world are relative to it too.
    #[inline(always)]
    pub(crate) fn point(&self, dof: usize, at: Vec3) -> V<T> {
        if dof == NONE {
            return three!(|i| -self.origin[i] + at[i]);
        }
        add(self.p[dof], rotate(&self.r[dof], at))
    }

    /// Vector of a link in axes of the world.
    #[inline(always)]
    pub(crate) fn vector(&self, dof: usize, by: Vec3) -> V<T> {
        if dof == NONE { constant(by) } else { rotate(&self.r[dof], by) }
    }

    #[inline(always)]
    pub(crate) fn capsule(&self, of: &CapsuleOf) -> Capsule<T> {
        Capsule {
            centre: self.point(of.dof, of.centre),
            half: self.vector(of.dof, of.half),
            radius: of.radius,
            is_ball: of.half == [0.0; 3],
        }
    }

    /// Lists the contacts that act in some lane, with their columns.
    #[inline(always)]
    pub(crate) fn find_contacts(&mut self, tree: &Tree, v: &[T], params: &[T]) {
        self.contacts.clear();
        self.columns.clear();
        self.is_coupled = false;
        for (index, candidate) in tree.contacts.iter().enumerate() {
            let place = match &candidate.pair {
                Pair::Plane { .. } => self.on_plane(&candidate.pair, candidate.margin),
                Pair::Capsules(of) => self.between(of, candidate.margin),
            };
            let Some((distance, x, frame)) = place else { continue };
            self.is_coupled |= candidate.branches;
            self.add_contact(tree, index, (distance, x, frame), v, params);
        }
    }

    #[inline(always)]
    fn on_plane(&self, pair: &Pair, margin: f64) -> Option<(T, V<T>, M<T>)> {
        let Pair::Plane { normal, point, tangents, dof, centre, radius, axis, middle } = pair
        else {
            unreachable!("a contact with a plane")
        };
        let (n, at) = (constant(*normal), self.point(*dof, *centre));
        let height = |x: V<T>| {
            let above = three!(|i| x[i] + self.origin[i] - point[i]);
            dot(above, n)
        };
        let mut gap = height(at) - *radius;
        if let Some(middle) = middle {
            // Corners above the centre of the box do not touch.
            let centre = height(self.point(*dof, *middle));
            gap = T::select_lt(centre, gap, T::from(f64::INFINITY), gap);
        }
        let distance = gap - margin;
        if !T::any_lt(distance, T::zero()) {
            return None;
        }
        let gap = T::select_lt(distance, T::zero(), gap, T::from(margin));
        let x = sub(at, scale(n, gap * 0.5 + *radius));
        let mut frame = [n, constant(tangents[0]), constant(tangents[1])];
        if let Some(axis) = axis {
            let axis = self.vector(*dof, *axis);
            let flat = sub(axis, scale(n, dot(axis, n)));
            let length = dot(flat, flat).max(UPRIGHT).sqrt();
            let aligned = scale(flat, length.recip());
            let keeps =
                |i: usize| T::select_lt(dot(flat, flat), T::from(UPRIGHT), frame[1][i], aligned[i]);
            frame[1] = [keeps(0), keeps(1), keeps(2)];
            frame[2] = cross(n, frame[1]);
        }
        Some((gap - margin, x, frame))
    }

    #[inline(always)]
    fn between(&self, of: &[CapsuleOf; 2], margin: f64) -> Option<(T, V<T>, M<T>)> {
        let [a, b] = [self.capsule(&of[0]), self.capsule(&of[1])];
        let near = nearest(&a, &b);
        let distance = near.gap - margin;
        if !T::any_lt(distance, T::zero()) {
            return None;
        }
        let first = crate::geometry::tangent_of(near.normal);
        Some((distance, near.point, [near.normal, first, cross(near.normal, first)]))
    }

    #[inline(always)]
    fn add_contact(
        &mut self,
        tree: &Tree,
        index: usize,
        (distance, x, frame): (T, V<T>, M<T>),
        v: &[T],
        params: &[T],
    ) {
        let candidate = &tree.contacts[index];
        let o = T::zero();
        let [a, b] = candidate.friction.map(|friction| friction.of::<T>(params));
        let friction = b.max(a).max(LEAST_FRICTION);
        let (weight, pull) = candidate.soft.row(distance);
        let scale = candidate.inverse(friction);
        let weight = if candidate.weight < LEAST_WEIGHT {
            T::from(1.0 / LEAST_WEIGHT) / scale
        } else {
            weight / scale
        };
        let weight = T::select_lt(distance, o, weight, o);
        let first = self.columns.len();
        let mut speed = [o; 3];
        for &(k, second) in &candidate.path {
            let at = self.s[k].at(x);
            let mut column = three!(|i| dot(at, frame[i]));
            if !second {
                column = neg(column);
            }
            for i in 0..3 {
                speed[i] += column[i] * v[k];
            }
            self.columns.push(column);
        }
        let b = candidate.soft.b;
        let reference = [-(speed[0] * b) - pull, -(speed[1] * b), -(speed[2] * b)];
        let cone = Cone { law: candidate.law, weight, friction, ratio: candidate.ratio };
        let zero = [o; 3];
        self.contacts.push(Contact {
            index,
            x,
            frame,
            distance,
            cone,
            reference,
            first,
            s: zero,
            f: zero,
            w: [o; 6],
        });
    }
}

/// Square of the sine of the angle between a capsule and a normal below which tangents are those of
/// the plane.
pub(crate) const UPRIGHT: f64 = 1e-20;

/// Bounds of MuJoCo for inverse masses of contacts, below which a contact has the largest weight,
/// and for friction.
const LEAST_WEIGHT: f64 = 1e-15;
const LEAST_FRICTION: f64 = 1e-5;

impl Candidate {
    /// The inverse mass, or 1 where the weight has its bound.
    fn inverse_mass(&self) -> f64 {
        if self.weight < LEAST_WEIGHT { 1.0 } else { self.weight }
    }

    /// Derivatives of the logarithm of the weight and of the pull with respect to the distance.
    #[inline(always)]
    pub(crate) fn slopes<T: Scalar>(&self, distance: T) -> (T, T) {
        let (relative, pull) = self.soft.slopes(distance);
        (if self.weight < LEAST_WEIGHT { T::zero() } else { relative }, pull)
    }

    /// Derivative of the friction with respect to each coefficient: 1 for the larger one.
    #[inline(always)]
    pub(crate) fn counts<T: Scalar>(&self, params: &[T]) -> [T; 2] {
        let (o, one) = (T::zero(), T::one());
        let [a, b] = self.friction.map(|friction| friction.of::<T>(params));
        let least = T::from(LEAST_FRICTION);
        let second = T::select_lt(a, b, one, o);
        let [a, b] = [a, b].map(|mu| T::select_lt(least, mu, one, o));
        [a * (-second + 1.0), b * second]
    }

    /// Inverse mass of the normal row.
    #[inline(always)]
    fn inverse<T: Scalar>(&self, friction: T) -> T {
        match self.law {
            Law::Pyramidal => {
                let square = friction * friction;
                square * (square + 1.0) * (2.0 * self.inverse_mass() / self.ratio)
            }
            _ => T::from(self.inverse_mass()),
        }
    }

    /// Derivative of the logarithm of the weight with respect to the friction.
    #[inline(always)]
    pub(crate) fn weight_by_friction<T: Scalar>(&self, friction: T) -> T {
        match self.law {
            Law::Pyramidal => {
                let square = friction * friction;
                -(square * 4.0 + 2.0) / (friction * (square + 1.0))
            }
            _ => T::zero(),
        }
    }
}
