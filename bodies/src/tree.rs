//! [`Tree`]: a model as chains of degrees of freedom, with the constants that steps read.

use crate::components::word;
use crate::contact::candidates;
use crate::distribution::{self, Distribution};
use crate::dynamics::Work;
use crate::model::*;
use crate::rows::Soft;
use crate::spatial::*;
use physgrad::Scalar;

/// Index that stands for no degree of freedom: the world.
pub(crate) const NONE: usize = usize::MAX;

/// A physical number of a model: a constant, or an entry of the parameters of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Coefficient {
    /// The constant, or a typical value.
    pub(crate) value: f64,
    /// Index in the parameters.
    pub(crate) entry: Option<usize>,
}

impl Coefficient {
    /// Whether the number is the constant 0, so that its term is absent.
    #[inline(always)]
    pub(crate) fn is_absent(&self) -> bool {
        self.value == 0.0 && self.entry.is_none()
    }

    #[inline(always)]
    pub(crate) fn of<T: Scalar>(&self, p: &[T]) -> T {
        self.entry.map_or(T::from(self.value), |entry| p[entry])
    }
}

/// Motion of one degree of freedom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    Slide,
    Hinge,
    /// Component 0, 1 or 2 of the angular velocity in axes of the body. The position is one
    /// quaternion for the three, which are consecutive.
    Turn(usize),
}

/// One degree of freedom and the link that it moves.
#[derive(Clone, Debug)]
pub(crate) struct Dof {
    pub(crate) kind: Kind,
    /// Degree of freedom from which the base of the joint moves: the one before the joint.
    pub(crate) base: usize,
    /// Index in the positions.
    pub(crate) q: usize,
    /// Position and orientation of the body in the link before, on the first degree of freedom of a
    /// body.
    pub(crate) frame: Option<(Vec3, Option<Mat3>)>,
    pub(crate) point: Vec3,
    pub(crate) axis: Vec3,
    /// Position in the reference pose.
    pub(crate) zero: f64,
    pub(crate) armature: Coefficient,
    pub(crate) damping: Coefficient,
    pub(crate) stiffness: Coefficient,
    pub(crate) friction_loss: Coefficient,
    pub(crate) spring: f64,
    pub(crate) limit: Option<(Limit, Soft)>,
    pub(crate) loss_soft: Soft,
    pub(crate) force_range: Option<[f64; 2]>,
    /// Mean diagonal of the inverse mass matrix over the joint, in the reference pose.
    pub(crate) weight: f64,
    /// Parts of the link with a constant mass, as one.
    pub(crate) fixed: Inertial,
    /// Parts of the link whose mass is a parameter.
    pub(crate) varied: Vec<(Coefficient, Inertial)>,
    /// Parts of the link whose centre or moments are parameters.
    pub(crate) shaped: Vec<Distribution>,
}

impl Dof {
    /// Whether the link has mass.
    #[inline(always)]
    pub(crate) fn has_mass(&self) -> bool {
        self.fixed.mass > 0.0 || !self.varied.is_empty() || !self.shaped.is_empty()
    }
}

/// Mass, centre, and moments about the centre, in the frame of a link.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Inertial {
    pub(crate) mass: f64,
    pub(crate) centre: Vec3,
    pub(crate) moments: [f64; 6],
}

impl Inertial {
    /// Both bodies as one.
    fn with(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        if mass == 0.0 {
            return *self;
        }
        let centre =
            [0, 1, 2].map(|i| (self.mass * self.centre[i] + other.mass * other.centre[i]) / mass);
        let mut moments = [0.0; 6];
        for part in [self, other] {
            let e = sub(part.centre, centre);
            let square = e[0] * e[0] + e[1] * e[1] + e[2] * e[2];
            for (k, (i, j)) in
                [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].into_iter().enumerate()
            {
                let diagonal = if i == j { square } else { 0.0 };
                moments[k] += part.moments[k] + part.mass * (diagonal - e[i] * e[j]);
            }
        }
        Self { mass, centre, moments }
    }
}

/// A body in the frame of its link.
#[derive(Clone, Debug)]
pub(crate) struct Placed {
    /// Degree of freedom of the link; `NONE` for bodies that are fixed to the world.
    pub(crate) dof: usize,
    pub(crate) position: Vec3,
    pub(crate) rotation: Mat3,
    /// Index of the body at the end of rigid connections to its parent bodies.
    pub(crate) welded: usize,
    /// Mean translational diagonal of the inverse inertia at the centre of mass, in the reference
    /// pose.
    pub(crate) weight: f64,
}

/// Actuator of degrees of freedom.
#[derive(Clone, Debug)]
pub(crate) struct Motor {
    /// Degrees of freedom with their coefficients: one, or those of a tendon.
    pub(crate) ends: Vec<(usize, f64)>,
    pub(crate) is_tendon: bool,
    /// Entries of the mass matrix that velocity feedback changes, the later degree of freedom first,
    /// and the product of the coefficients: as in MuJoCo, those of ends on one chain.
    pub(crate) pairs: Vec<(usize, usize, f64)>,
    pub(crate) gear: Coefficient,
    /// Force per control, constant force, and force against position and velocity.
    pub(crate) gain: Coefficient,
    pub(crate) constant: f64,
    pub(crate) position: Coefficient,
    pub(crate) velocity: Coefficient,
    pub(crate) control_range: Option<[f64; 2]>,
    pub(crate) force_range: Option<[f64; 2]>,
}

/// Drag of a body in a medium, by the box with its mass and moments.
#[derive(Clone, Debug)]
pub(crate) struct Drag {
    pub(crate) dof: usize,
    /// Centre of mass and principal axes in the frame of the link.
    pub(crate) centre: Vec3,
    pub(crate) axes: Mat3,
    /// Coefficients of the velocity and of its square: three rotations, three translations.
    pub(crate) linear: [f64; 6],
    pub(crate) square: [f64; 6],
}

/// A compiled model.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    pub(crate) options: Options,
    pub(crate) nq: usize,
    pub(crate) dofs: Vec<Dof>,
    /// Previous degree of freedom on the way to the world.
    pub(crate) parent: Vec<usize>,
    /// Leading slides of the only root. Their displacement is the origin of all positions, so that
    /// f32 keeps its digits far away.
    pub(crate) root: usize,
    pub(crate) bodies: Vec<Placed>,
    pub(crate) motors: Vec<Motor>,
    pub(crate) contacts: Vec<crate::contact::Candidate>,
    /// Number of columns of all contacts, one per degree of freedom that moves it.
    pub(crate) columns: usize,
    pub(crate) drags: Vec<Drag>,
    /// Positions in the reference pose.
    pub(crate) reference: Vec<f64>,
    /// First degree of freedom of each joint.
    pub(crate) joints: Vec<usize>,
    /// Distribution of the mass of each body that has mass.
    pub(crate) distributions: Vec<Option<Distribution>>,
    /// Whether limits or dry friction exist.
    pub(crate) has_rows: bool,
    /// Whether damping is implicit and exists.
    pub(crate) damps: bool,
    pub(crate) friction: Vec<Coefficient>,
}

/// A physical number of a model by its name, see [`numbers`].
pub(crate) struct Numbered {
    pub(crate) name: String,
    pub(crate) value: f64,
}

/// Physical numbers of a model that may be set, drawn or trained: masses of bodies and their
/// distributions, constants of joints, gears and gains of actuators, coefficients of friction.
pub(crate) fn numbers(model: &Model) -> Vec<Numbered> {
    let mut all = Vec::new();
    let mut push = |name: String, value: f64| all.push(Numbered { name, value });
    for body in model.bodies.iter().skip(1).filter(|body| body.mass > 0.0) {
        let name = word(&body.name);
        push(format!("body.{name}.mass"), body.mass);
        for (key, value) in distribution::numbers(body, &model.options) {
            push(format!("body.{name}.{key}"), value);
        }
    }
    for joint in model.joints.iter() {
        let name = word(&joint.name);
        push(format!("joint.{name}.armature"), joint.armature);
        push(format!("joint.{name}.damping"), joint.damping);
        if matches!(joint.kind, JointKind::Hinge | JointKind::Slide) {
            push(format!("joint.{name}.stiffness"), joint.stiffness);
        }
        if joint.friction_loss > 0.0 {
            push(format!("joint.{name}.friction_loss"), joint.friction_loss);
        }
    }
    for actuator in &model.actuators {
        let name = word(&actuator.name);
        push(format!("motor.{name}.gear"), actuator.gear);
        for (key, value) in gains(actuator) {
            push(format!("motor.{name}.{key}"), value);
        }
    }
    for shape in &model.shapes {
        push(format!("shape.{}.friction", word(&shape.name)), shape.friction[0]);
    }
    all
}

/// Gains of an actuator that follows its control: `kp` and `kv` of a position, or `kv` of a velocity.
fn gains(actuator: &Actuator) -> Vec<(&'static str, f64)> {
    let Actuator { gain, bias: [_, position, velocity], .. } = *actuator;
    if gain != 0.0 && position == -gain {
        vec![("kp", gain), ("kv", -velocity)]
    } else if gain != 0.0 && position == 0.0 && velocity == -gain {
        vec![("kv", gain)]
    } else {
        Vec::new()
    }
}

impl Tree {
    /// Compiles a model. `coefficient` gives the physical number with a name of [`numbers`] and its
    /// value in the model.
    pub(crate) fn new(
        model: &Model,
        coefficient: &dyn Fn(&str, f64) -> Coefficient,
    ) -> Result<Self, String> {
        let mut tree = Self {
            options: model.options.clone(),
            nq: 0,
            dofs: Vec::new(),
            parent: Vec::new(),
            root: 0,
            bodies: Vec::new(),
            motors: Vec::new(),
            contacts: Vec::new(),
            columns: 0,
            drags: Vec::new(),
            reference: Vec::new(),
            joints: vec![0; model.joints.len()],
            distributions: model
                .bodies
                .iter()
                .map(|body| (body.mass > 0.0).then(|| Distribution::new(body, coefficient)))
                .collect(),
            has_rows: false,
            damps: false,
            friction: Vec::new(),
        };
        check_joints(model)?;
        let mut typical = model.clone();
        for (body, distribution) in typical.bodies.iter_mut().zip(&tree.distributions) {
            distribution.iter().for_each(|distribution| distribution.apply(body));
        }
        let model = &typical;
        for index in 0..model.bodies.len() {
            tree.add_body(model, index, coefficient);
        }
        tree.motors = model.actuators.iter().map(|a| tree.motor(a, coefficient)).collect();
        if tree.parent.iter().filter(|&&parent| parent == NONE).count() == 1 {
            // Slides of one body: a body above those of another stays behind.
            let slides = |joint: &&Joint| {
                joint.body == model.joints[0].body
                    && matches!(joint.kind, JointKind::Slide | JointKind::Free)
            };
            let first = model.joints.iter().take_while(slides).count();
            let all = tree.dofs.iter().take_while(|dof| dof.kind == Kind::Slide).count();
            tree.root = tree.joints.get(first).map_or(all, |&dof| dof.min(all));
        }
        tree.has_rows =
            tree.dofs.iter().any(|dof| dof.limit.is_some() || !dof.friction_loss.is_absent());
        tree.damps = match tree.options.integrator {
            Integrator::Rk4 => false,
            _ => {
                tree.dofs.iter().any(|dof| !dof.damping.is_absent())
                    || tree.implicit_feedback()
                        && tree.motors.iter().any(|motor| !motor.velocity.is_absent())
            }
        };
        if tree.implicit_feedback() && !tree.drags.is_empty() {
            return Err(
                "`implicitfast` makes the drag of a medium implicit, which is not simulated; set \
                        `integrator` to `Euler`"
                    .into(),
            );
        }
        tree.friction = model
            .shapes
            .iter()
            .map(|shape| {
                coefficient(&format!("shape.{}.friction", word(&shape.name)), shape.friction[0])
            })
            .collect();
        tree.weigh(model);
        if model.options.contacts {
            tree.contacts = candidates(model, &tree)?;
            tree.columns = tree.contacts.iter().map(|contact| contact.path.len()).sum();
        }
        Ok(tree)
    }

    pub(crate) fn nv(&self) -> usize {
        self.dofs.len()
    }

    /// Whether velocity feedback of actuators is implicit.
    #[inline(always)]
    pub(crate) fn implicit_feedback(&self) -> bool {
        self.options.integrator == Integrator::ImplicitFast
    }

    fn add_body(
        &mut self,
        model: &Model,
        index: usize,
        coefficient: &dyn Fn(&str, f64) -> Coefficient,
    ) {
        let body = &model.bodies[index];
        let (above, mut at, mut turn) = match index {
            0 => (NONE, [0.0; 3], body.rotation),
            _ => {
                let up = &self.bodies[body.parent];
                let at = add(up.position, rotate(&up.rotation, body.position));
                (up.dof, at, product(&up.rotation, &body.rotation))
            }
        };
        let mut dof = above;
        let first = self.dofs.len();
        for (j, joint) in model.joints.iter().enumerate().filter(|(_, joint)| joint.body == index) {
            self.joints[j] = self.dofs.len();
            dof = self.add_joint(model, joint, dof, coefficient);
        }
        if self.dofs.len() > first {
            if self.dofs[first].frame.is_none() {
                let turned = (turn != IDENTITY).then_some(turn);
                let free =
                    model.joints.iter().any(|j| j.body == index && j.kind == JointKind::Free);
                self.dofs[first].frame = (!free).then_some((at, turned));
            }
            (at, turn) = ([0.0; 3], IDENTITY);
        }
        let welded = if self.dofs.len() > first || index == 0 {
            index
        } else {
            self.bodies[body.parent].welded
        };
        let placed = Placed { dof, position: at, rotation: turn, welded, weight: 0.0 };
        if let Some(distribution) = self.distributions[index].as_ref().filter(|_| dof != NONE) {
            let part = Inertial {
                mass: body.mass,
                centre: add(at, rotate(&turn, body.centre)),
                moments: congruence(&turn, &body.inertia),
            };
            let mass = distribution.mass;
            let scaled = part.scaled(mass.value);
            if distribution.varies() {
                self.dofs[dof].shaped.push(distribution.placed(&placed));
            } else if mass.entry.is_some() {
                self.dofs[dof].varied.push((mass, part.scaled(1.0)));
            } else {
                self.dofs[dof].fixed = self.dofs[dof].fixed.with(&scaled);
            }
            let axes = body.axes.map(|axes| product(&turn, &axes));
            self.drags.extend(crate::drag::of(&model.options, dof, &scaled, axes));
        }
        self.bodies.push(placed);
    }

    fn add_joint(
        &mut self,
        model: &Model,
        joint: &Joint,
        before: usize,
        coefficient: &dyn Fn(&str, f64) -> Coefficient,
    ) -> usize {
        let dt = model.options.dt;
        let name = word(&joint.name);
        let number = |key: &str, value: f64| coefficient(&format!("joint.{name}.{key}"), value);
        let limit = joint.limit.filter(|_| model.options.limits);
        let dof = Dof {
            kind: Kind::Slide,
            base: before,
            q: self.nq,
            frame: None,
            point: joint.point,
            axis: joint.axis,
            zero: joint.reference,
            armature: number("armature", joint.armature),
            damping: number("damping", joint.damping),
            stiffness: number("stiffness", joint.stiffness),
            friction_loss: number("friction_loss", joint.friction_loss),
            spring: joint.spring_reference,
            limit: limit.map(|limit| (limit, Soft::new(&limit.softness, dt))),
            loss_soft: Soft::new(&joint.friction_softness, dt),
            force_range: joint.force_range,
            weight: 0.0,
            fixed: Inertial::default(),
            varied: Vec::new(),
            shaped: Vec::new(),
        };
        let body = &model.bodies[joint.body];
        let mut last = before;
        let mut push = |tree: &mut Self, dof: Dof| {
            tree.parent.push(last);
            last = tree.dofs.len();
            tree.dofs.push(dof);
        };
        match joint.kind {
            JointKind::Slide | JointKind::Hinge => {
                let kind = if joint.kind == JointKind::Slide { Kind::Slide } else { Kind::Hinge };
                push(self, Dof { kind, ..dof });
                self.reference.push(joint.reference);
                self.nq += 1;
            }
            JointKind::Ball | JointKind::Free => {
                let mut base = before;
                let mut turn = [1.0, 0.0, 0.0, 0.0];
                if joint.kind == JointKind::Free {
                    for i in 0..3 {
                        let q = self.nq + i;
                        push(self, Dof { q, base, axis: unit(i), zero: 0.0, ..dof.clone() });
                        base = self.dofs.len() - 1;
                    }
                    self.reference.extend(body.position);
                    self.nq += 3;
                    turn = quaternion(&body.rotation);
                }
                for i in 0..3 {
                    let kind = Kind::Turn(i);
                    push(self, Dof { kind, q: self.nq, base, axis: unit(i), ..dof.clone() });
                }
                self.reference.extend(turn);
                self.nq += 4;
            }
        }
        last
    }

    fn motor(&self, a: &Actuator, coefficient: &dyn Fn(&str, f64) -> Coefficient) -> Motor {
        let name = word(&a.name);
        let number = |key: &str, value: f64| coefficient(&format!("motor.{name}.{key}"), value);
        let constant = |value: f64| Coefficient { value, entry: None };
        let [bias, position, velocity] = a.bias;
        let (gain, position, velocity) = match gains(a)[..] {
            [(kp, gain), (kv, damping)] => {
                (number(kp, gain), number(kp, gain), number(kv, damping))
            }
            [(kv, gain)] => (number(kv, gain), constant(-position), number(kv, gain)),
            _ => (constant(a.gain), constant(-position), constant(-velocity)),
        };
        // An end with the coefficient 0 does not act.
        let ends: Vec<(usize, f64)> = { a.on.joints().into_iter() }
            .filter(|end| end.1 != 0.0)
            .map(|(joint, by)| (self.joints[joint], by))
            .collect();
        let above = |k: usize| {
            std::iter::successors(Some(k), |&k| Some(self.parent[k]).filter(|&up| up != NONE))
        };
        let pairs = ends.iter().flat_map(|&(k, by)| {
            let on_chain = move |&&(j, _): &&(usize, f64)| above(k).any(|up| up == j);
            ends.iter().filter(on_chain).map(move |&(j, other)| (k, j, by * other))
        });
        Motor {
            pairs: pairs.collect(),
            ends,
            is_tendon: matches!(a.on, Transmission::Tendon(_)),
            gear: number("gear", a.gear),
            gain,
            constant: bias,
            position,
            velocity,
            control_range: a.control_range,
            force_range: a.force_range,
        }
    }

    /// Weights of rows: inverse masses in the reference pose, with typical values of numbers that vary.
    fn weigh(&mut self, model: &Model) {
        let n = self.nv();
        let params: Vec<f64> = self.nominal();
        let mut work = Work::<f64>::default();
        work.resize(self);
        let (q, v, u) = (self.reference.clone(), vec![0.0; n], vec![0.0; self.motors.len()]);
        work.unconstrained(self, [&q, &v, &u, &params]);
        let mut factors = work.mass.clone();
        factors.factor(&self.parent);
        let inverse = |row: &[f64]| {
            let mut x = row.to_vec();
            factors.solve(&self.parent, &mut x);
            row.iter().zip(&x).map(|(a, b)| a * b).sum::<f64>()
        };
        let unit: Vec<f64> = (0..n)
            .map(|k| inverse(&(0..n).map(|i| f64::from(i == k)).collect::<Vec<_>>()))
            .collect();
        for (joint, &first) in model.joints.iter().zip(&self.joints) {
            let lengths: &[usize] = match joint.kind {
                JointKind::Slide | JointKind::Hinge => &[1],
                JointKind::Ball => &[3],
                JointKind::Free => &[3, 3],
            };
            let mut first = first;
            for &length in lengths {
                let group = first..first + length;
                let mean = unit[group.clone()].iter().sum::<f64>() / length as f64;
                group.for_each(|k| self.dofs[k].weight = mean);
                first += length;
            }
        }
        for (index, body) in model.bodies.iter().enumerate() {
            let Placed { dof, position, rotation, .. } = self.bodies[index];
            if dof == NONE {
                continue;
            }
            let centre = add(position, rotate(&rotation, body.centre));
            let x = add(work.p[dof], rotate(&work.r[dof], centre));
            let mut moves = vec![false; n];
            let mut j = dof;
            while j != NONE {
                moves[j] = true;
                j = self.parent[j];
            }
            let row = |i: usize| -> Vec<f64> {
                (0..n).map(|k| if moves[k] { work.s[k].at(x)[i] } else { 0.0 }).collect()
            };
            self.bodies[index].weight = (0..3).map(|i| inverse(&row(i))).sum::<f64>() / 3.0;
            if is_plain_slider(model, index) && self.bodies[body.parent].dof == NONE {
                let mass = self.distributions[index].as_ref().map_or(0.0, |d| d.mass.value);
                let weight = mass.recip();
                self.bodies[index].weight = weight;
                let own = model.joints.iter().zip(&self.joints);
                for (_, &dof) in own.filter(|(joint, _)| joint.body == index) {
                    self.dofs[dof].weight = weight;
                }
            }
        }
    }

    /// Typical values of the parameters.
    fn nominal(&self) -> Vec<f64> {
        let mut all = Vec::new();
        let mut set = |number: &Coefficient| {
            if let Some(entry) = number.entry {
                all.resize(all.len().max(entry + 1), 0.0);
                all[entry] = number.value;
            }
        };
        for dof in &self.dofs {
            for number in [&dof.armature, &dof.damping, &dof.stiffness, &dof.friction_loss] {
                set(number);
            }
        }
        self.distributions.iter().flatten().flat_map(Distribution::coefficients).for_each(&mut set);
        for motor in &self.motors {
            [&motor.gear, &motor.gain, &motor.position, &motor.velocity]
                .into_iter()
                .for_each(&mut set);
        }
        self.friction.iter().for_each(set);
        all
    }
}

/// Whether a body without children only slides along its own axes, which are principal axes through
/// its centre of mass. Its weights are its inverse mass, without armature, as in MuJoCo.
fn is_plain_slider(model: &Model, index: usize) -> bool {
    let body = &model.bodies[index];
    let [_, _, _, xy, xz, yz] = body.inertia;
    let along = |joint: &Joint| {
        joint.kind == JointKind::Slide
            && joint.point == [0.0; 3]
            && joint.axis.iter().filter(|x| **x != 0.0).count() == 1
    };
    let mut own = model.joints.iter().filter(|joint| joint.body == index).peekable();
    own.peek().is_some()
        && own.all(along)
        && body.centre == [0.0; 3]
        && [xy, xz, yz] == [0.0; 3]
        && body.axes.is_none_or(|axes| axes == IDENTITY)
        && model.bodies.iter().skip(1).all(|other| other.parent != index)
}

/// Refuses springs and limits of joints that rotate freely.
fn check_joints(model: &Model) -> Result<(), String> {
    let turns = |joint: &&Joint| matches!(joint.kind, JointKind::Ball | JointKind::Free);
    for joint in model.joints.iter().filter(turns) {
        let what = if joint.stiffness != 0.0 {
            "a spring"
        } else if joint.limit.is_some() {
            "a limit"
        } else {
            continue;
        };
        return Err(format!(
            "the joint `{}` is a ball or free joint with {what}, which is not simulated; remove it, or use three hinges",
            joint.name
        ));
    }
    Ok(())
}

impl Inertial {
    /// The same distribution of mass with another total.
    fn scaled(&self, mass: f64) -> Self {
        let by = mass / self.mass;
        Self { mass, centre: self.centre, moments: self.moments.map(|moment| moment * by) }
    }
}

pub(crate) const IDENTITY: Mat3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn unit(i: usize) -> Vec3 {
    IDENTITY[i]
}

/// Unit quaternion of a rotation, with a positive real part.
pub(crate) fn quaternion(r: &Mat3) -> [f64; 4] {
    let trace = r[0][0] + r[1][1] + r[2][2];
    // The largest component first, by which the others are divided.
    let squares = [trace, r[0][0], r[1][1], r[2][2]];
    let largest = (0..4).max_by(|&i, &j| squares[i].total_cmp(&squares[j])).unwrap_or(0);
    let q = match largest {
        0 => [1.0 + trace, r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]],
        1 => [r[2][1] - r[1][2], 1.0 + 2.0 * r[0][0] - trace, r[0][1] + r[1][0], r[0][2] + r[2][0]],
        2 => [r[0][2] - r[2][0], r[0][1] + r[1][0], 1.0 + 2.0 * r[1][1] - trace, r[1][2] + r[2][1]],
        _ => [r[1][0] - r[0][1], r[0][2] + r[2][0], r[1][2] + r[2][1], 1.0 + 2.0 * r[2][2] - trace],
    };
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
    q.map(|x| sign * x / length)
}
