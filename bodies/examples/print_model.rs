//! Prints models of MJCF and URDF files as JSON, one line a file, for comparisons with other
//! readers. A file that is refused gives a line with `error`.
//!
//! Usage: `print_model FILE...`

use physgrad_bodies::files::read;
use physgrad_bodies::model::{Body, Form, Joint, Model, Shape, Softness, Transmission};
use std::path::Path;

fn main() {
    for file in std::env::args().skip(1) {
        let line = match read(Path::new(&file)) {
            Ok(model) => json(&model),
            Err(error) => format!("{{\"error\":{}}}", text(&error.to_string())),
        };
        println!("{line}");
    }
}

fn json(model: &Model) -> String {
    let o = &model.options;
    object(&[
        ("name", text(&model.name)),
        ("dt", format!("{:?}", o.dt)),
        ("gravity", numbers(&o.gravity)),
        ("integrator", text(&format!("{:?}", o.integrator))),
        ("cone", text(&format!("{:?}", o.cone))),
        ("impratio", format!("{:?}", o.impedance_ratio)),
        ("medium", numbers(&[o.density, o.viscosity])),
        ("wind", numbers(&o.wind)),
        ("contacts", format!("{}", o.contacts)),
        ("limits", format!("{}", o.limits)),
        ("bodies", list(model.bodies.iter().map(body))),
        ("joints", list(model.joints.iter().map(joint))),
        ("shapes", list(model.shapes.iter().map(shape))),
        (
            "sites",
            list(model.sites.iter().map(|s| {
                let place = [("body", s.body.to_string()), ("pos", numbers(&s.position))];
                object(&[("name", text(&s.name)), place[0].clone(), place[1].clone()])
            })),
        ),
        (
            "actuators",
            list(model.actuators.iter().map(|a| {
                object(&[
                    ("name", text(&a.name)),
                    ("tendon", format!("{}", matches!(a.on, Transmission::Tendon(_)))),
                    (
                        "joints",
                        list(a.on.joints().iter().map(|(joint, by)| format!("[{joint},{by:?}]"))),
                    ),
                    ("gear", format!("{:?}", a.gear)),
                    ("gain", format!("{:?}", a.gain)),
                    ("bias", numbers(&a.bias)),
                    ("ctrlrange", range(a.control_range)),
                    ("forcerange", range(a.force_range)),
                ])
            })),
        ),
        ("excluded", list(model.excluded.iter().map(|[a, b]| format!("[{a},{b}]")))),
        ("poses", list(model.poses.iter().map(|(n, q)| format!("[{},{}]", text(n), numbers(q))))),
        ("remarks", list(model.remarks.iter().map(|r| text(r)))),
    ])
}

fn body(body: &Body) -> String {
    object(&[
        ("name", text(&body.name)),
        ("parent", body.parent.to_string()),
        ("pos", numbers(&body.position)),
        ("rotation", numbers(body.rotation.as_flattened())),
        ("mass", format!("{:?}", body.mass)),
        ("centre", numbers(&body.centre)),
        ("inertia", numbers(&body.inertia)),
    ])
}

fn joint(joint: &Joint) -> String {
    let softness = joint.limit.map_or("null".into(), |l| softness(&l.softness));
    object(&[
        ("name", text(&joint.name)),
        ("body", joint.body.to_string()),
        ("kind", text(&format!("{:?}", joint.kind))),
        ("pos", numbers(&joint.point)),
        ("axis", numbers(&joint.axis)),
        ("ref", format!("{:?}", joint.reference)),
        ("springref", format!("{:?}", joint.spring_reference)),
        ("stiffness", format!("{:?}", joint.stiffness)),
        ("damping", format!("{:?}", joint.damping)),
        ("armature", format!("{:?}", joint.armature)),
        ("frictionloss", format!("{:?}", joint.friction_loss)),
        ("friction", self::softness(&joint.friction_softness)),
        ("range", range(joint.limit.map(|l| l.range))),
        ("margin", format!("{:?}", joint.limit.map_or(0.0, |l| l.margin))),
        ("limit", softness),
        ("forcerange", range(joint.force_range)),
    ])
}

fn shape(shape: &Shape) -> String {
    let (form, size) = match shape.form {
        Form::Plane => ("plane", vec![]),
        Form::Sphere(r) => ("sphere", vec![r]),
        Form::Capsule(r, h) => ("capsule", vec![r, h]),
        Form::Cylinder(r, h) => ("cylinder", vec![r, h]),
        Form::Ellipsoid(s) => ("ellipsoid", s.to_vec()),
        Form::Box(s) => ("box", s.to_vec()),
    };
    object(&[
        ("name", text(&shape.name)),
        ("body", shape.body.to_string()),
        ("form", text(form)),
        ("size", numbers(&size)),
        ("pos", numbers(&shape.position)),
        ("rotation", numbers(shape.rotation.as_flattened())),
        ("contype", shape.kinds.to_string()),
        ("conaffinity", shape.touches.to_string()),
        ("condim", shape.dimension.to_string()),
        ("friction", numbers(&shape.friction)),
        ("softness", softness(&shape.softness)),
        ("solmix", format!("{:?}", shape.mix)),
        ("priority", shape.priority.to_string()),
        ("margin", format!("{:?}", shape.margin)),
        ("rgba", numbers(&shape.colour)),
    ])
}

fn softness(softness: &Softness) -> String {
    numbers(&[softness.reference.as_slice(), softness.impedance.as_slice()].concat())
}

fn range(range: Option<[f64; 2]>) -> String {
    range.map_or("null".into(), |r| numbers(&r))
}

fn numbers(numbers: &[f64]) -> String {
    list(numbers.iter().map(|n| format!("{n:?}")))
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(","))
}

fn object(fields: &[(&str, String)]) -> String {
    let fields: Vec<String> = fields.iter().map(|(k, v)| format!("\"{k}\":{v}")).collect();
    format!("{{{}}}", fields.join(","))
}

fn text(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c < ' ' => quoted += &format!("\\u{:04x}", c as u32),
            c => quoted.push(c),
        }
    }
    quoted + "\""
}
