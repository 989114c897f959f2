//! Derivatives of steps against dual numbers, and lanes against single numbers.

use physgrad::{Inputs, Number, System as _, check};
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
        place: Default::default(),
    }
}

/// A free body with two arms on hinges and a ball joint at the end of one, above a floor.
fn robot() -> Model {
    let limit = Limit { range: [-0.4, 0.3], margin: 0.0, softness: Softness::default() };
    let hinge = joint("shoulder", 2, JointKind::Hinge);
    let motor = |name: &str, joint: usize| Actuator {
        name: name.into(),
        on: Transmission::Joint(joint),
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

/// Actuators that follow a position and a velocity, one of them at its bound.
fn servos(integrator: Integrator) -> Model {
    let mut model = robot();
    model.options.integrator = integrator;
    model.options.contacts = false;
    let servo = |name: &str, gain: f64, bias: Vec3, force_range| Actuator {
        name: name.into(),
        gain,
        bias,
        force_range,
        ..model.actuators[0].clone()
    };
    let bounded = servo("bounded", 20.0, [0.0, -20.0, 0.0], Some([-0.5, 0.5]));
    let follower = servo("follower", 5.0, [0.0, -5.0, -0.4], None);
    let mut speed = servo("speed", 2.0, [0.0, 0.0, -2.0], None);
    speed.on = Transmission::Joint(3);
    model.actuators = vec![bounded, follower, speed];
    model
}

/// Tendons with a motor, and with servos, across branches and on one chain, one of them at its bound.
fn tendons(integrator: Integrator) -> Model {
    let mut model = servos(integrator);
    let [shoulder, hip, rail] = [1, 2, 3];
    model.joints[hip].force_range = Some([-0.8, 0.8]);
    let ends = [
        vec![(shoulder, 0.7), (rail, -1.2)],
        vec![(hip, 0.6), (rail, -0.4), (shoulder, 1.0)],
        vec![(rail, 1.5), (hip, 0.0)],
    ];
    for (actuator, ends) in model.actuators.iter_mut().zip(ends) {
        actuator.on = Transmission::Tendon(ends);
    }
    let motor = Actuator {
        name: "motor".into(),
        on: Transmission::Tendon(vec![(hip, -0.5), (rail, 2.0)]),
        bias: [0.0; 3],
        ..model.actuators[0].clone()
    };
    model.actuators.push(motor);
    model
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
        ("servos", servos(Integrator::Euler)),
        ("implicit servos", servos(Integrator::ImplicitFast)),
        ("tendons", tendons(Integrator::Euler)),
        ("implicit tendons", tendons(Integrator::ImplicitFast)),
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
        let numbers = Bodies::known_numbers(&model).into_iter();
        let numbers: Vec<(String, Number)> = numbers
            .filter(|(name, value)| *value != 0.0 || name.contains("shear") || name.contains("kv"))
            .map(|(name, value)| {
                let half = if value == 0.0 { 0.2 } else { 0.1 * value.abs() };
                (name, Number::Uniform { low: value - half, high: value + half })
            })
            .collect();
        let bodies = Bodies::with_numbers(model, numbers).unwrap();
        check::system(&bodies).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}

/// Numbers of the distribution of mass and of gains, away from those of the model.
fn shifted(model: &Model) -> Vec<(String, f64)> {
    let is_chosen = |name: &String| name.starts_with("body.") || name.contains(".k");
    let all = Bodies::known_numbers(model).into_iter().filter(|(name, _)| is_chosen(name));
    all.enumerate().map(|(i, (name, value))| (name, value * 1.1 + 0.01 * (i % 5) as f64)).collect()
}

#[test]
fn a_number_of_a_sample_acts_as_the_same_number_in_the_model() {
    for (name, model) in variants() {
        let values = shifted(&model);
        let fixed = values.iter().map(|(name, value)| (name.clone(), Number::Fixed(*value)));
        let drawn = values.iter().map(|(name, value)| {
            (name.clone(), Number::Uniform { low: value - 1e-9, high: value + 1e-9 })
        });
        let fixed = Bodies::with_numbers(model.clone(), fixed.collect()).unwrap();
        let drawn = Bodies::with_numbers(model.clone(), drawn.collect()).unwrap();
        let mut x = fixed.reference().to_vec();
        x.extend((0..fixed.velocities()).map(|i| 0.3 - 0.1 * i as f64));
        let (u, p) =
            (vec![0.4; fixed.control_dim()], values.iter().map(|v| v.1).collect::<Vec<_>>());
        let of =
            |bodies: &Bodies, p: &[f64]| bodies.accelerations(Inputs { x: &x, u: &u, p, t: 0 }).0;
        let (a, b, unchanged) =
            (of(&fixed, &[]), of(&drawn, &p), of(&Bodies::new(model).unwrap(), &[]));
        for ((a, b), unchanged) in a.iter().zip(&b).zip(&unchanged) {
            assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{name}: {a} and {b}");
            assert!((a - unchanged).abs() > 1e-6, "{name}: the numbers change nothing");
        }
    }
}
