//! [`Model`]: bodies, joints, shapes and actuators as a file describes them. Constants only, in SI
//! units and rad.

use crate::files::Place;

/// A vector.
pub type Vec3 = [f64; 3];
/// A rotation matrix, in rows.
pub type Mat3 = [[f64; 3]; 3];

/// Articulated bodies. `bodies[0]` is the world, and parents precede their children.
///
/// The joints and shapes of a body have consecutive indices, in the order of the bodies.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Name of the model.
    pub name: String,
    /// Global settings.
    pub options: Options,
    /// Bodies, the world first.
    pub bodies: Vec<Body>,
    /// Joints, in the order of the bodies.
    pub joints: Vec<Joint>,
    /// Shapes that touch or are drawn, in the order of the bodies.
    pub shapes: Vec<Shape>,
    /// Named points, in the order of the bodies.
    pub sites: Vec<Site>,
    /// Actuators, one per control.
    pub actuators: Vec<Actuator>,
    /// Pairs of bodies that never touch.
    pub excluded: Vec<[usize; 2]>,
    /// Named positions: one number per joint, 4 for a ball joint and 7 for a free joint.
    pub poses: Vec<(String, Vec<f64>)>,
    /// What the file has and what does not change the physics, one sentence each.
    pub remarks: Vec<String>,
}

impl Model {
    /// Makes all contacts softer, and wider before they reach their full stiffness, so that forces
    /// begin without a jump: gradients then describe what happens near a first touch. `width` in m,
    /// `time` in s.
    pub fn soften_contacts(&mut self, width: f64, time: f64) {
        for shape in &mut self.shapes {
            let [_, high, _, middle, power] = shape.softness.impedance;
            shape.softness.impedance = [0.0, high, width, middle, power];
            shape.softness.reference = [time, 1.0];
        }
    }
}

/// Settings of the whole model.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Time step, s.
    pub dt: f64,
    /// Gravity, m/s².
    pub gravity: Vec3,
    /// Method of time steps.
    pub integrator: Integrator,
    /// Friction cone.
    pub cone: Cone,
    /// Ratio of frictional to normal impedance, for elliptic cones.
    pub impedance_ratio: f64,
    /// Density of the medium, kg/m³.
    pub density: f64,
    /// Viscosity of the medium, Pa s.
    pub viscosity: f64,
    /// Velocity of the medium, m/s.
    pub wind: Vec3,
    /// Whether bodies touch.
    pub contacts: bool,
    /// Whether joints have limits.
    pub limits: bool,
}

impl Default for Options {
    /// Defaults of MJCF.
    fn default() -> Self {
        Self {
            dt: 0.002,
            gravity: [0.0, 0.0, -9.81],
            integrator: Integrator::Euler,
            cone: Cone::Pyramidal,
            impedance_ratio: 1.0,
            density: 0.0,
            viscosity: 0.0,
            wind: [0.0; 3],
            contacts: true,
            limits: true,
        }
    }
}

/// Method of time steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrator {
    /// Semi-implicit Euler method. Joint damping is implicit.
    Euler,
    /// As `Euler`, and velocity feedback of actuators is implicit too.
    ImplicitFast,
    /// Runge-Kutta method of order 4. Everything is explicit.
    Rk4,
}

/// Friction cone of contacts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cone {
    /// Pyramid with four edges.
    Pyramidal,
    /// Circular cone.
    Elliptic,
}

/// A rigid body.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Unique name.
    pub name: String,
    /// Index of the parent; 0 for the world itself.
    pub parent: usize,
    /// Position in the frame of the parent in the reference pose, m.
    pub position: Vec3,
    /// Orientation in the frame of the parent in the reference pose.
    pub rotation: Mat3,
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the frame of the body, m.
    pub centre: Vec3,
    /// Moments of inertia about the centre of mass, in the axes of the body: xx, yy, zz, xy, xz,
    /// yz. Unit kg m².
    pub inertia: [f64; 6],
    /// Principal axes in columns, in the axes of the body, if the file gives them: those of the only
    /// shape with mass, or of its inertia. None: any principal axes.
    pub axes: Option<Mat3>,
}

impl Body {
    /// A body without mass at a pose in its parent.
    pub fn new(name: &str, parent: usize, position: Vec3, rotation: Mat3) -> Self {
        let (mass, centre, inertia, axes) = (0.0, [0.0; 3], [0.0; 6], None);
        Self { name: name.to_owned(), parent, position, rotation, mass, centre, inertia, axes }
    }
}

/// A joint between a body and its parent.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Unique name.
    pub name: String,
    /// Index of the body that it moves.
    pub body: usize,
    /// Kind of motion.
    pub kind: JointKind,
    /// A point of the axis, in the frame of the body, m. Zero for a free joint.
    pub point: Vec3,
    /// Unit vector of the axis in the frame of the body, for hinges and slides.
    pub axis: Vec3,
    /// Position in the reference pose, rad or m.
    pub reference: f64,
    /// Position of the spring at rest, rad or m.
    pub spring_reference: f64,
    /// Stiffness of the spring, N m/rad or N/m.
    pub stiffness: f64,
    /// Damping, N m s/rad or N s/m.
    pub damping: f64,
    /// Rotor inertia, kg m² or kg.
    pub armature: f64,
    /// Dry friction, N m or N.
    pub friction_loss: f64,
    /// Softness of dry friction.
    pub friction_softness: Softness,
    /// Range of positions, rad or m.
    pub limit: Option<Limit>,
    /// Range of the sum of actuator forces, N m or N.
    pub force_range: Option<[f64; 2]>,
}

impl Joint {
    /// A joint about the z axis through the origin of a body, without forces.
    pub fn new(name: &str, body: usize, kind: JointKind) -> Self {
        Self {
            name: name.to_owned(),
            body,
            kind,
            point: [0.0; 3],
            axis: [0.0, 0.0, 1.0],
            reference: 0.0,
            spring_reference: 0.0,
            stiffness: 0.0,
            damping: 0.0,
            armature: 0.0,
            friction_loss: 0.0,
            friction_softness: Softness::default(),
            limit: None,
            force_range: None,
        }
    }
}

/// Motion that a joint permits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Translation along the axis.
    Slide,
    /// Rotation about the axis.
    Hinge,
    /// Rotation about the point. The position is a unit quaternion, the velocity in axes of the
    /// body.
    Ball,
    /// Free motion. The position is a translation and a unit quaternion. Translational velocity in
    /// axes of the world, angular velocity in axes of the body.
    Free,
}

/// Range of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Smallest and largest position, rad or m.
    pub range: [f64; 2],
    /// Distance at which the limit begins to act, rad or m.
    pub margin: f64,
    /// Softness.
    pub softness: Softness,
}

/// Softness of a constraint: `solref` and `solimp` of MJCF.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Softness {
    /// Time constant in s and damping ratio; negative numbers are stiffness and damping.
    pub reference: [f64; 2],
    /// Impedance: smallest, largest, width, midpoint, power.
    pub impedance: [f64; 5],
}

impl Default for Softness {
    /// Defaults of MJCF.
    fn default() -> Self {
        Self { reference: [0.02, 1.0], impedance: [0.9, 0.95, 0.001, 0.5, 2.0] }
    }
}

/// A shape that is fixed to a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Unique name.
    pub name: String,
    /// Index of the body.
    pub body: usize,
    /// Form.
    pub form: Form,
    /// Position of the centre in the frame of the body, m.
    pub position: Vec3,
    /// Orientation in the frame of the body.
    pub rotation: Mat3,
    /// Bits of the kinds of contact that it has. Two shapes touch if `kinds` of one meets `touches`
    /// of the other.
    pub kinds: u32,
    /// Bits of the kinds of contact that it accepts.
    pub touches: u32,
    /// Dimension of contacts: 1 without friction, 3 with sliding friction, 4 with torsional
    /// friction, 6 with rolling friction.
    pub dimension: usize,
    /// Coefficients of sliding, torsional and rolling friction.
    pub friction: Vec3,
    /// Softness of contacts.
    pub softness: Softness,
    /// Weight of the softness in contacts with another shape.
    pub mix: f64,
    /// Of two shapes, the one with the higher priority determines the contact.
    pub priority: i32,
    /// Distance at which contacts are found, m.
    pub margin: f64,
    /// Colour: red, green, blue, opacity.
    pub colour: [f64; 4],
    /// Where it stands in its file.
    pub place: Place,
}

/// Form of a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    /// Half space below z = 0.
    Plane,
    /// Ball with this radius, m.
    Sphere(f64),
    /// Cylinder along z with round ends: radius, and half the length without the ends, m.
    Capsule(f64, f64),
    /// Cylinder along z: radius, and half the length, m.
    Cylinder(f64, f64),
    /// Half axes, m.
    Ellipsoid(Vec3),
    /// Half lengths of the edges, m.
    Box(Vec3),
}

impl Form {
    /// Name of the form.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Plane => "plane",
            Self::Sphere(_) => "sphere",
            Self::Capsule(..) => "capsule",
            Self::Cylinder(..) => "cylinder",
            Self::Ellipsoid(_) => "ellipsoid",
            Self::Box(_) => "box",
        }
    }
}

/// A named point of a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    /// Unique name.
    pub name: String,
    /// Index of the body.
    pub body: usize,
    /// Position in the frame of the body, m.
    pub position: Vec3,
}

/// What an actuator acts on.
#[derive(Clone, Debug, PartialEq)]
pub enum Transmission {
    /// A hinge or slide, by its index.
    Joint(usize),
    /// A fixed tendon: hinges and slides with coefficients. Its position is the sum of those of the
    /// joints, times the coefficients, and its force acts on each joint, times the coefficient.
    Tendon(Vec<(usize, f64)>),
}

impl Transmission {
    /// The joints with their coefficients.
    pub fn joints(&self) -> Vec<(usize, f64)> {
        match self {
            Self::Joint(joint) => vec![(*joint, 1.0)],
            Self::Tendon(joints) => joints.clone(),
        }
    }
}

/// An actuator with the force `gear (gain u + bias₀ + bias₁ gear q + bias₂ gear v)`, for position q
/// and velocity v of what it acts on.
#[derive(Clone, Debug, PartialEq)]
pub struct Actuator {
    /// Unique name.
    pub name: String,
    /// What it acts on.
    pub on: Transmission,
    /// Ratio between joint or tendon and actuator.
    pub gear: f64,
    /// Force per control.
    pub gain: f64,
    /// Constant force, force per position, and force per velocity.
    pub bias: Vec3,
    /// Range to which controls are limited.
    pub control_range: Option<[f64; 2]>,
    /// Range to which the force before the gear is limited.
    pub force_range: Option<[f64; 2]>,
}
