//! Derivatives of steps against dual numbers, and lanes against single numbers.

use physgrad::{Number, check};
use physgrad_bodies::Bodies;
use physgrad_bodies::model::*;

const IDENTITY: Mat3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn body(name: &str, parent: usize, position: Vec3) -> Body {
    Body {
        name: name.into(),
        parent,
        position,
        rotation: IDENTITY,
        mass: 1.3,
        centre: [0.02, -0.01, 0.03],
        inertia: [0.02, 0.03, 0.025, 0.001, -0.002, 0.0015],
        axes: None,
    }
}

fn joint(name: &str, body: usize, kind: JointKind) -> Joint {
    Joint {
        name: name.into(),
        body,
        kind,
        point: [0.0, 0.0, 0.1],
        axis: [0.0, 0.6, 0.8],
        reference: 0.1,
        spring_reference: 0.05,
        stiffness: 0.0,
        damping: 0.4,
        armature: 0.01,
        friction_loss: 0.0,
        friction_softness: Softness::default(),
        limit: None,
        force_range: None,
    }
}

fn shape(name: &str, body: usize, form: Form) -> Shape {
    Shape {
        name: name.into(),
        body,
        form,
        position: [0.01, 0.02, -0.05],
        rotation: [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]],
        kinds: 1,
        touches: 1,
        dimension: 3,
        friction: [0.8, 0.0, 0.0],
        softness: Softness::default(),
        mix: 1.0,
        priority: 0,
        margin: 0.01,
        colour: [0.5, 0.5, 0.5, 1.0],
    }
}

/// A free body with two arms on hinges and a ball joint at the end of one, above a floor.
fn robot() -> Model {
    let limit = Limit { range: [-0.4, 0.3], margin: 0.0, softness: Softness::default() };
    let hinge = joint("shoulder", 2, JointKind::Hinge);
    let motor = |name: &str, joint: usize| Actuator {
        name: name.into(),
        joint,
        gear: 3.0,
        gain: 2.0,
        bias: [0.1, -0.7, -0.2],
        control_range: Some([-2.0, 2.0]),
        force_range: None,
    };
    let mut world = body("world", 0, [0.0; 3]);
    world.mass = 0.0;
    Model {
        name: "robot".into(),
        options: Options { dt: 0.01, ..Options::default() },
        bodies: vec![
            world,
            body("trunk", 0, [0.0, 0.0, 0.5]),
            body("arm", 1, [0.2, 0.0, 0.0]),
            body("leg", 1, [-0.2, 0.1, 0.0]),
            body("hand", 2, [0.3, 0.0, 0.1]),
        ],
        joints: vec![
            Joint { point: [0.0; 3], ..joint("root", 1, JointKind::Free) },
            Joint { stiffness: 2.0, limit: Some(limit), ..hinge.clone() },
            Joint {
                friction_loss: 0.3,
                axis: [0.0, 1.0, 0.0],
                ..joint("hip", 3, JointKind::Hinge)
            },
            Joint { axis: [1.0, 0.0, 0.0], ..joint("rail", 3, JointKind::Slide) },
            joint("wrist", 4, JointKind::Ball),
        ],
        shapes: vec![
            Shape { position: [0.0; 3], rotation: IDENTITY, ..shape("floor", 0, Form::Plane) },
            shape("trunk", 1, Form::Sphere(0.35)),
            shape("arm", 2, Form::Capsule(0.1, 0.25)),
            shape("leg", 3, Form::Capsule(0.12, 0.3)),
            Shape { kinds: 1, touches: 0, ..shape("hand", 4, Form::Box([0.1, 0.2, 0.15])) },
        ],
        sites: Vec::new(),
        actuators: vec![motor("shoulder", 1), motor("rail", 3)],
        excluded: vec![[2, 4]],
        poses: Vec::new(),
        remarks: Vec::new(),
    }
}

fn variants() -> Vec<(&'static str, Model)> {
    let with = |change: &dyn Fn(&mut Options)| {
        let mut model = robot();
        // The hand touches only the floor.
        model.shapes[4].kinds = 2;
        model.shapes[0].touches = 3;
        change(&mut model.options);
        model
    };
    vec![
        ("pyramidal", with(&|_| {})),
        ("elliptic", with(&|o| (o.cone, o.impedance_ratio) = (Cone::Elliptic, 2.0))),
        ("free", with(&|o| (o.contacts, o.limits) = (false, false))),
        ("implicit", with(&|o| o.integrator = Integrator::ImplicitFast)),
        ("runge-kutta", with(&|o| o.integrator = Integrator::Rk4)),
        // Turns of the stages are not small.
        ("long steps", with(&|o| (o.integrator, o.dt) = (Integrator::Rk4, 0.3))),
        ("medium", with(&|o| (o.density, o.viscosity, o.wind) = (300.0, 0.5, [0.3, 0.1, -0.2]))),
    ]
}

#[test]
fn derivatives_of_steps_are_those_of_dual_numbers() {
    for (name, model) in variants() {
        let bodies = Bodies::new(model).unwrap();
        check::system(&bodies).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}

#[test]
fn derivatives_by_numbers_are_those_of_dual_numbers() {
    for (name, model) in variants() {
        let numbers = Bodies::known_numbers(&model).into_iter().filter(|(_, value)| *value > 0.0);
        let numbers: Vec<(String, Number)> = numbers
            .map(|(name, value)| (name, Number::Uniform { low: 0.9 * value, high: 1.1 * value }))
            .collect();
        let bodies = Bodies::with_numbers(model, numbers).unwrap();
        check::system(&bodies).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}
