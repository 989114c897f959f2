//! Texts that are read and texts that are refused. Comparisons with MuJoCo are in
//! `tests/references/compare_models.py`.

use super::{expand, parse, read};
use crate::Bodies;
use crate::files::Place;
use crate::model::{Cone, Form, Integrator, JointKind, Model, Transmission};
use crate::rotation::{about, from_quaternion};
use std::path::{Path, PathBuf};

/// The model of a file with this content.
fn model(content: &str) -> Model {
    parse(&format!("<mujoco>{content}</mujoco>"), "m.xml").unwrap_or_else(|e| panic!("{e}"))
}

/// The model of a body with a hinge and this content.
fn body(content: &str) -> Model {
    model(&format!("<worldbody><body><joint/>{content}</body></worldbody>"))
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-14 * a.abs().max(b.abs())
}

/// What stands in front of the part that is refused in line 2, the part, what stands behind, and
/// the message.
const REFUSED: &[(&str, &str, &str, &str)] = &[
    // Malformed and hostile.
    ("", "<worldbody></body>", "", "is not well-formed XML"),
    ("", "<!DOCTYPE a>", "", "has a document type; entities are refused, remove it"),
    ("", "<bodies/>", "", "unknown section; remove it"),
    ("", "<worldbdy/>", "", "unknown section; did you mean `worldbody`?"),
    ("", "<include file=\"a.xml\"/>", "", "includes need a file; read the model from its file"),
    // Settings.
    ("", "<compiler coordinate=\"global\"/>", "", "`coordinate` is not supported; convert"),
    ("", "<compiler angel=\"radian\"/>", "", "unknown attribute `angel`; did you mean `angle`?"),
    ("", "<compiler angle=\"grad\"/>", "", "`angle` is `grad`; it can be degree, radian"),
    ("", "<compiler eulerseq=\"xyq\"/>", "", "`eulerseq` is `xyq`; it can be like `xyz`"),
    ("", "<compiler fusestatic=\"true\"/>", "", "`fusestatic` is not supported; set it to false"),
    ("", "<option timestep=\"0\"/>", "", "`timestep` must be positive"),
    ("", "<option timestep=\"nan\"/>", "", "`timestep` has `nan`; numbers must be finite"),
    ("", "<option gravity=\"0 0\"/>", "", "`gravity` needs 3 numbers and has 2"),
    ("", "<option integrator=\"implicit\"/>", "", "the integrator `implicit` is not supported"),
    ("", "<option noslip_iterations=\"3\"/>", "", "`noslip_iterations` is not supported; set it"),
    ("<option>", "<flag spring=\"disable\"/>", "</option>", "`spring` is not supported; remove"),
    ("<option>", "<flag refsafe=\"off\"/>", "</option>", "`refsafe` is `off`; it can be"),
    // Classes.
    ("<default>", "<default/>", "</default>", "a class needs a name; add `class`"),
    ("<default>", "<geom sise=\"1\"/>", "</default>", "unknown attribute `sise`; did you mean"),
    ("<worldbody>", "<geom class=\"a\" size=\"1\"/>", "</worldbody>", "unknown class `a`; remove"),
    // Bodies.
    ("<worldbody>", "<bodie/>", "</worldbody>", "unknown element; did you mean `body`?"),
    ("<worldbody>", "<joint/>", "</worldbody>", "the world does not move; put this into a body"),
    ("<worldbody>", "<body mocap=\"true\"/>", "</worldbody>", "`mocap` is not supported; make it"),
    ("<worldbody>", "<body gravcomp=\"1\"/>", "</worldbody>", "`gravcomp` is not supported; remo"),
    (
        "<worldbody>",
        "<body euler=\"0 0 1\" quat=\"1 0 0 0\"/>",
        "</worldbody>",
        "has `quat` and `eu",
    ),
    ("<worldbody>", "<body quat=\"0 0 0 0\"/>", "</worldbody>", "`quat` has no direction; its le"),
    (
        "<worldbody><body name=\"a\"/>",
        "<body name=\"a\"/>",
        "</worldbody>",
        "the body in line 1 has",
    ),
    ("<worldbody>", "<body><joint/></body>", "</worldbody>", "it moves and has no mass or no iner"),
    ("<worldbody>", "<replicate count=\"2\"/>", "</worldbody>", "is not supported; write the cop"),
    // Masses.
    (IN, "<inertial mass=\"1\" diaginertia=\"1 1 1\"/>", OUT, "needs `pos` and `mass`; add them"),
    (IN, "<inertial pos=\"0 0 0\" mass=\"-1\"/>", OUT, "`mass` is negative; it must be at least 0"),
    (
        "<worldbody>",
        "<body><inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1 1 3\"/></body>",
        "</worldbody>",
        "a principal moment of inertia exceeds the sum of the other two",
    ),
    (
        "<worldbody>",
        "<body><inertial pos=\"0 0 0\" mass=\"1\" fullinertia=\"1 1 1 2 0 0\"/></body>",
        "</worldbody>",
        "a principal moment of inertia is negative",
    ),
    (
        "<compiler boundmass=\"1\"/><worldbody>",
        "<body/>",
        "</worldbody>",
        "`boundmass` cannot give mass to a body without a centre of mass",
    ),
    // Joints.
    (IN, "<joint type=\"ball\" range=\"0 1\"/>", OUT, "limits of ball joints are not supported"),
    (IN, "<freejoint/>", OUT, "a body with a free joint has no other joint; remove one"),
    (
        "<worldbody><body><joint type=\"ball\"/><geom size=\"1\"/>",
        "<joint/>",
        OUT,
        "a ball joint already turns the body; remove one joint",
    ),
    (
        IN,
        "<joint/><joint/><joint/><joint/><joint/><joint/>",
        OUT,
        "the joints of the body have more than 6 degrees of freedom",
    ),
    (IN, "<joint axis=\"0 0 0\"/>", OUT, "`axis` has no direction; its length is 0"),
    (IN, "<joint range=\"1 0\"/>", OUT, "`range` must have a lower and a higher number"),
    (IN, "<joint limited=\"true\"/>", OUT, "`range` must have a lower and a higher number"),
    (IN, "<joint damping=\"1 2\"/>", OUT, "`damping` is a polynomial; only its first number is"),
    (IN, "<joint armature=\"-1\"/>", OUT, "`armature` is negative; it must be at least 0"),
    (
        IN,
        "<joint springdamper=\"1 1\"/>",
        OUT,
        "`springdamper` is not supported; write `stiffness`",
    ),
    (IN, "<joint solreflimit=\"1 -1\"/>", OUT, "`solreflimit` must have two positive numbers, or"),
    // Geoms.
    (IN, "<geom type=\"mesh\" mesh=\"a\"/>", OUT, "meshes are not supported; replace it by a caps"),
    (
        IN,
        "<geom type=\"mesh\" contype=\"0\" conaffinity=\"0\"/>",
        OUT,
        "meshes are not supported an",
    ),
    (
        IN,
        "<geom type=\"hfield\" hfield=\"a\"/>",
        OUT,
        "height fields are not supported; replace it",
    ),
    (IN, "<geom type=\"plane\" size=\"1 1 1\"/>", OUT, "planes cannot move; use a box"),
    (
        IN,
        "<geom type=\"box\" size=\"1 1\"/>",
        OUT,
        "number 3 of `size` must be positive; a box nee",
    ),
    (IN, "<geom size=\"-1\"/>", OUT, "number 1 of `size` must be positive; a sphere needs 1"),
    (IN, "<geom size=\"1 1 1 1\"/>", OUT, "`size` has more than 3 numbers"),
    (IN, "<geom size=\"1\" condim=\"2\"/>", OUT, "`condim` is 2; it can be 1, 3, 4 or 6"),
    (
        IN,
        "<geom size=\"1\" fromto=\"0 0 0 0 0 1\"/>",
        OUT,
        "a sphere cannot have `fromto`; set `ty",
    ),
    (
        IN,
        "<geom type=\"capsule\" size=\"1\" fromto=\"0 0 1 0 0 1\"/>",
        OUT,
        "the two points of `fro",
    ),
    (IN, "<geom size=\"1\" material=\"a\"/>", OUT, "unknown material `a`; add it"),
    (
        IN,
        "<geom size=\"1\" fluidshape=\"ellipsoid\"/>",
        OUT,
        "`fluidshape` is not supported; set it",
    ),
    // Actuators.
    (ACT, "<motor joint=\"k\"/>", TOR, "unknown joint `k`; did you mean `j`?"),
    (ACT, "<motor/>", TOR, "has no joint; add `joint`"),
    (ACT, "<motor tendon=\"t\"/>", TOR, "unknown tendon `t`; remove it"),
    (ACT, "<motor tendon=\"t\" joint=\"j\"/>", TOR, "has `joint` and `tendon`; remove one of them"),
    (TEN, "<motor tendon=\"u\"/>", TOR, "unknown tendon `u`; did you mean `t`?"),
    (ACT, "<muscle joint=\"j\"/>", TOR, "this actuator is not supported; those that are supported"),
    (ACT, "<motr joint=\"j\"/>", TOR, "unknown actuator; did you mean `motor`?"),
    (
        ACT,
        "<position joint=\"j\" dampratio=\"1\"/>",
        TOR,
        "`dampratio` is not supported; write the",
    ),
    (
        ACT,
        "<position joint=\"j\" timeconst=\"1\"/>",
        TOR,
        "`timeconst` is not supported; remove it",
    ),
    (
        ACT,
        "<general joint=\"j\" dyntype=\"filter\"/>",
        TOR,
        "`dyntype` filter is not supported; it",
    ),
    (
        ACT,
        "<motor joint=\"j\" ctrlrange=\"1 0\"/>",
        TOR,
        "`ctrlrange` must have a lower and a high",
    ),
    // Other sections.
    (
        "<contact>",
        "<pair geom1=\"a\" geom2=\"b\"/>",
        "</contact>",
        "contact pairs are not supported",
    ),
    (
        "<contact>",
        "<exclude body1=\"world\" body2=\"wrld\"/>",
        "</contact>",
        "unknown body `wrld` as",
    ),
    ("<equality>", "<weld body1=\"a\"/>", "</equality>", "equality constraints are not supported"),
    ("<tendon>", "<fixed stiffness=\"1\"/>", "</tendon>", "`stiffness` is not supported; tendons"),
    (DON, "<joint joint=\"j\" coef=\"1\"/>", NET, "the tendon has this joint twice; add the coef"),
    (DON, "<joint joint=\"k\"/>", NET, "has no coefficient; add `coef`"),
    (DON, "<joint joint=\"i\" coef=\"1\"/>", NET, "unknown joint `i`; did you mean"),
    (DON, "<joint joint=\"b\" coef=\"1\"/>", NET, "actuators of ball and free joints are not sup"),
    (DON, "<site site=\"s\"/>", NET, "unknown element in a fixed tendon; it can be `joint`"),
    ("<tendon><fixed name=\"t\"/>", "<fixed name=\"t\"/>", "</tendon>", "another tendon has the"),
    ("<tendon>", "<fixed damping=\"1\"/>", "</tendon>", "`damping` is not supported; tendons that"),
    ("<tendon>", "<spatial range=\"0 1\"/>", "</tendon>", "limits of tendons are not supported"),
    ("<deformable>", "<flex/>", "</deformable>", "deformable bodies are not supported; remove it"),
    ("<extension>", "<plugin/>", "</extension>", "plugins are not supported; remove them"),
    ("<keyframe>", "<key qpos=\"1\"/>", "</keyframe>", "`qpos` has more than 0 numbers"),
];

const IN: &str = "<worldbody><body><joint/><geom size=\"1\"/>";
const OUT: &str = "</body></worldbody>";
const ACT: &str =
    "<worldbody><body><joint name=\"j\"/><geom size=\"1\"/></body></worldbody><actuator>";
const TOR: &str = "</actuator>";
const TEN: &str = "<worldbody><body><joint name=\"j\"/><geom size=\"1\"/></body></worldbody>\
     <tendon><fixed name=\"t\"/></tendon><actuator>";
const DON: &str = "<worldbody><body><joint name=\"j\"/><joint name=\"k\"/><geom size=\"1\"/></body>\
     <body><joint name=\"b\" type=\"ball\"/><geom size=\"1\"/></body></worldbody>\
     <tendon><fixed name=\"t\"><joint joint=\"j\" coef=\"1\"/>";
const NET: &str = "</fixed></tendon><actuator><motor tendon=\"t\"/></actuator>";

#[test]
fn refusals_name_the_line_and_the_reason() {
    for (before, part, after, message) in REFUSED {
        let text = format!("<mujoco>{before}\n{part}{after}\n</mujoco>");
        let error = parse(&text, "m.xml").expect_err(part);
        assert_eq!(error.line, 2, "{part}: {error}");
        assert!(error.what.starts_with(message), "{part}: {error}");
        // The same file without the part is read, so that the part is the reason.
        if !message.contains("well-formed") {
            let rest = format!("<mujoco>{before}\n{after}\n</mujoco>");
            parse(&rest, "m.xml").unwrap_or_else(|e| panic!("{part}: {e}"));
        }
    }
}

#[test]
fn messages_say_where() {
    let text = "<mujoco><worldbody>\n<geom name='foot' size='1' type='mesh'/></worldbody></mujoco>";
    let error = parse(text, "hopper.xml").unwrap_err().to_string();
    let start =
        "hopper.xml, line 2, <geom name=\"foot\" type=\"mesh\">: meshes are not supported; ";
    assert!(error.starts_with(start), "{error}");
    let root = parse("<mujoco modle='a'/>", "a.xml").unwrap_err();
    assert_eq!(root.what, "unknown attribute `modle`; did you mean `model`?");
    let whole = parse("<robot/>", "a.xml").unwrap_err().to_string();
    assert!(whole.starts_with("a.xml, line 1, <robot>: is not MJCF"), "{whole}");
}

/// Contacts that are not simulated are refused where their shapes stand.
#[test]
fn refused_contacts_name_their_places() {
    let error = |shapes: &str| {
        let text = format!(
            "<mujoco><worldbody>\n<geom name='floor' type='plane' size='1 1 1'/>\n\n\
             <body><freejoint/>\n{shapes}</body></worldbody></mujoco>"
        );
        Bodies::new(parse(&text, "m.xml").unwrap()).unwrap_err().to_string()
    };
    let floor = "m.xml, line 2, <geom name=\"floor\" type=\"plane\">";
    let of_forms = error("<geom type='cylinder' size='.1 .1'/>");
    let start = format!(
        "{floor} and m.xml, line 5, <geom type=\"cylinder\"> may touch, and contacts of the forms \
         plane and cylinder are not simulated; "
    );
    assert!(of_forms.starts_with(&start), "{of_forms}");
    for condim in [4, 6] {
        let of_friction = error(&format!("<geom name='a' size='.1' condim='{condim}'/>"));
        let start = format!(
            "{floor} and m.xml, line 5, <geom name=\"a\"> touch with `condim` {condim}; torsional"
        );
        assert!(of_friction.starts_with(&start), "{of_friction}");
    }
    let text = "<mujoco><worldbody><geom name='a' size='.1'/>\
                <body><freejoint/><geom name='b' type='box' size='.1 .1 .1'/></body></worldbody></mujoco>";
    let mut model = parse(text, "m.xml").unwrap();
    model.shapes.iter_mut().for_each(|shape| shape.place = Place::default());
    let of_code = Bodies::new(model).unwrap_err().to_string();
    assert!(of_code.starts_with("the shape `a` and the shape `b` may touch, "), "{of_code}");
}

/// An error about a default stands at the default.
#[test]
fn errors_of_defaults_are_at_the_default() {
    let text = "<mujoco><default>\n<geom condim='5'/>\n</default>\n<worldbody>\n<geom size='1'/>\n\
                </worldbody></mujoco>";
    assert_eq!(parse(text, "m.xml").unwrap_err().line, 2);
}

#[test]
fn numbers_overlay_those_of_outer_classes() {
    let model = model(
        "<default><geom friction='1 2 3' solimp='.1 .2 .3' size='1'/>
           <default class='a'><geom friction='4 5'/>
             <default class='b'><geom friction='6' solref='.1'/></default></default></default>
         <worldbody><geom name='main'/><geom class='b'/>
           <body childclass='a'><geom/><geom class='main'/><body><geom size='2'/></body></body>
         </worldbody>",
    );
    let friction: Vec<_> = model.shapes.iter().map(|s| s.friction).collect();
    let (main, a) = ([1.0, 2.0, 3.0], [4.0, 5.0, 3.0]);
    assert_eq!(friction, [main, [6.0, 5.0, 3.0], a, main, a]);
    assert_eq!(model.shapes[1].softness.reference, [0.1, 1.0]);
    assert_eq!(model.shapes[1].softness.impedance, [0.1, 0.2, 0.3, 0.5, 2.0]);
    assert_eq!(model.shapes[4].form, Form::Sphere(2.0));
    let names: Vec<_> = model.shapes.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["main", "geom1", "geom2", "geom3", "geom4"]);
}

/// A class has one law of force, which shortcuts replace.
#[test]
fn actuators_share_defaults() {
    let model = model(
        "<default><motor gear='3' ctrlrange='-1 1'/>
           <default class='p'><position kp='5' kv='2'/></default></default>
         <worldbody><body><joint name='j'/><geom size='1'/></body></worldbody>
         <actuator><position joint='j'/><position joint='j' class='p' kp='7'/>
           <motor joint='j' class='p'/><velocity joint='j' class='p' ctrllimited='false'/>
           <general joint='j' class='p' biasprm='9'/></actuator>",
    );
    let laws: Vec<_> = model.actuators.iter().map(|a| (a.gain, a.bias)).collect();
    let position = (1.0, [0.0, -1.0, 0.0]);
    let velocity = (1.0, [0.0, 0.0, -1.0]);
    let general = (5.0, [9.0, -5.0, -2.0]);
    assert_eq!(laws, [position, (7.0, [0.0, -7.0, -2.0]), (1.0, [0.0; 3]), velocity, general]);
    assert!(model.actuators.iter().all(|a| a.gear == 3.0 && a.force_range.is_none()));
    assert_eq!(model.actuators[0].control_range, Some([-1.0, 1.0]));
    assert_eq!(model.actuators[3].control_range, None);
}

/// A shortcut takes its numbers from the innermost class with a law of its kind.
#[test]
fn laws_skip_those_of_other_kinds() {
    let model = model(
        "<default><position kp='5' kv='2'/><default class='p'><position kp='6'/>
           <default class='v'><velocity kv='7'/></default></default></default>
         <worldbody><body><joint name='j'/><geom size='1'/></body></worldbody>
         <actuator><position joint='j' class='v'/><velocity joint='j' class='v'/>
           <general joint='j' class='v'/></actuator>",
    );
    let laws: Vec<_> = model.actuators.iter().map(|a| (a.gain, a.bias)).collect();
    let velocity = (7.0, [0.0, 0.0, -7.0]);
    assert_eq!(laws, [(6.0, [0.0, -6.0, -2.0]), velocity, velocity]);
}

/// Each form with its mass: by density, and given.
#[test]
fn actuators_act_on_fixed_tendons() {
    let model = model(
        "<default><tendon width='1'/><motor gear='.1'/></default>
         <worldbody><body><joint name='x' type='slide'/><joint name='y'/><geom size='1'/></body>
         </worldbody>
         <tendon><fixed name='idle'/><fixed name='t'><joint joint='y' coef='.5'/>
           <joint joint='x' coef='-2'/></fixed></tendon>
         <actuator><motor name='m' tendon='t'/><position name='p' tendon='t' kp='3'/>
           <motor joint='x' gear='2'/></actuator>",
    );
    let tendon = Transmission::Tendon(vec![(1, 0.5), (0, -2.0)]);
    assert_eq!((&model.actuators[0].on, model.actuators[0].gear), (&tendon, 0.1));
    assert_eq!((&model.actuators[1].on, model.actuators[1].gain), (&tendon, 3.0));
    assert_eq!(model.actuators[2].on, Transmission::Joint(0));
    assert_eq!(model.remarks, ["Tendons without forces only measure; 1 is left out."]);
}

#[test]
fn forms_give_bodies_their_mass() {
    let pi = std::f64::consts::PI;
    let cases = [
        ("type='sphere' size='.3'", 4.0 / 3.0 * pi * 0.027),
        ("type='capsule' size='.3 .5'", pi * (0.09 + 4.0 / 3.0 * 0.027)),
        ("type='cylinder' size='.3 .5'", pi * 0.09),
        ("type='ellipsoid' size='.1 .2 .3'", 4.0 / 3.0 * pi * 0.006),
        ("type='box' size='.1 .2 .3'", 8.0 * 0.006),
        ("type='box' size='.1' fromto='0 0 0 0 0 2'", 8.0 * 0.01),
    ];
    for (form, volume) in cases {
        let dense = body(&format!("<geom {form} density='500'/>"));
        assert!(close(dense.bodies[1].mass, 500.0 * volume), "{form}");
        let given = body(&format!("<geom {form} mass='2' density='500'/>"));
        assert_eq!(given.bodies[1].mass, 2.0);
        for (a, b) in dense.bodies[1].inertia.iter().zip(given.bodies[1].inertia) {
            assert!(close(*a * 2.0, b * 500.0 * volume), "{form}");
        }
    }
}

#[test]
fn compiler_corrects_masses() {
    let text = "<worldbody><body><joint/><geom size='.1' group='3'/><geom size='.2'/></body>
                <body><geom size='.1' group='3'/></body></worldbody>";
    let part = model(&format!("<compiler inertiagrouprange='3 3' boundmass='9'/>{text}"));
    assert_eq!(part.bodies[1].mass, 9.0);
    let total = model(&format!("<compiler settotalmass='14'/>{text}"));
    assert!(close(total.bodies.iter().map(|b| b.mass).sum(), 14.0));
    let plain = &model(text).bodies[1];
    let ratio = total.bodies[1].mass / plain.mass;
    assert!(close(total.bodies[1].inertia[0], ratio * plain.inertia[0]));
    let given = "<inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/><geom size='.1' mass='3'/>";
    assert_eq!(body(given).bodies[1].mass, 1.0);
    let with = |compiler: &str, content: &str| {
        model(&format!("<compiler {compiler}/><worldbody><body>{content}</body></worldbody>"))
    };
    assert_eq!(with("inertiafromgeom='true'", given).bodies[1].mass, 3.0);
    let flat = "<inertial pos='0 0 0' mass='1' diaginertia='1 1 4'/>";
    assert_eq!(
        with("balanceinertia='true'", flat).bodies[1].inertia,
        [2.0, 2.0, 2.0, 0.0, 0.0, 0.0]
    );
}

/// The same quarter turn about y in every notation.
#[test]
fn notations_of_one_rotation_agree() {
    let quarter = about([0.0, 1.0, 0.0], std::f64::consts::FRAC_PI_2);
    for notation in [
        "quat='1 0 1 0'",
        "axisangle='0 3 0 90'",
        "euler='0 90 0'",
        "zaxis='2 0 0'",
        "xyaxes='0 0 -1 0 1 .5'",
    ] {
        let model = model(&format!("<worldbody><body {notation}/></worldbody>"));
        for (a, b) in model.bodies[1].rotation.as_flattened().iter().zip(quarter.as_flattened()) {
            assert!((a - b).abs() < 1e-15, "{notation}");
        }
    }
    let radian =
        "<compiler angle='radian' eulerseq='ZYX'/><worldbody><body euler='0 1 0'/></worldbody>";
    assert!(close(model(radian).bodies[1].rotation[0][0], 1f64.cos()));
}

#[test]
fn frames_place_what_they_contain() {
    let model = model(
        "<worldbody><frame pos='1 0 0' euler='0 0 90'><body name='a' pos='1 0 0'>
           <frame pos='0 0 1' axisangle='1 0 0 90'>
             <joint axis='0 0 1' pos='0 0 2'/><geom size='.1' pos='0 1 0'/><site pos='0 1 0'/>
           </frame></body></frame></worldbody>",
    );
    let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-15);
    assert!(near(model.bodies[1].position, [1.0, 1.0, 0.0]));
    assert!(near(model.joints[0].axis, [0.0, -1.0, 0.0]));
    assert!(near(model.joints[0].point, [0.0, -2.0, 1.0]));
    assert!(near(model.shapes[0].position, [0.0, 0.0, 2.0]));
    assert!(near(model.sites[0].position, [0.0, 0.0, 2.0]));
}

/// Degrees turn hinges and not slides; margins are never in degrees.
#[test]
fn joints_convert_degrees() {
    let inside = "range='-90 180' ref='90' springref='-90' margin='.5' stiffness='2'";
    let model = model(&format!(
        "<worldbody><body><joint {inside}/><joint type='slide' {inside}/>
         <joint type='ball' limited='false' {inside}/><geom size='1'/></body>
         <body><joint type='free' {inside}/><geom size='1'/></body></worldbody>"
    ));
    let (hinge, slide) = (&model.joints[0], &model.joints[1]);
    let limit = |j: &crate::model::Joint| j.limit.map(|l| (l.range, l.margin));
    let pi = std::f64::consts::PI;
    assert_eq!(limit(hinge), Some(([-pi / 2.0, pi], 0.5)));
    assert_eq!((hinge.reference, hinge.spring_reference), (pi / 2.0, -pi / 2.0));
    assert_eq!(limit(slide), Some(([-90.0, 180.0], 0.5)));
    assert_eq!((slide.reference, slide.spring_reference), (90.0, -90.0));
    assert_eq!(model.joints[2].kind, JointKind::Ball);
    assert_eq!((model.joints[3].kind, limit(&model.joints[3])), (JointKind::Free, None));
    let off = body("<geom size='1'/>");
    assert_eq!(off.joints[0].limit, None);
}

#[test]
fn options_and_flags() {
    let options = model(
        "<option timestep='.01' integrator='RK4' cone='elliptic' impratio='3' density='2'/>
         <option timestep='.02' wind='1 2 3'>
           <flag constraint='disable' gravity='disable'/></option>",
    )
    .options;
    assert_eq!((options.dt, options.gravity, options.wind), (0.02, [0.0; 3], [1.0, 2.0, 3.0]));
    assert_eq!((options.integrator, options.cone), (Integrator::Rk4, Cone::Elliptic));
    assert!(!options.contacts && !options.limits);
    let damped = |integrator: &str| {
        let text = format!(
            "<mujoco><option integrator='{integrator}'><flag eulerdamp='disable'/></option>
             <worldbody><body><joint damping='1'/><geom size='1'/></body></worldbody></mujoco>"
        );
        parse(&text, "m.xml").is_ok()
    };
    assert!(damped("RK4") && !damped("Euler"));
    let short = |time: &str| {
        let text = format!(
            "<mujoco><option><flag refsafe='disable'/></option>
             <worldbody><geom size='1' solref='{time} 1'/></worldbody></mujoco>"
        );
        parse(&text, "m.xml").is_ok()
    };
    assert!(short("0.004") && !short("0.0039"));
}

#[test]
fn poses_have_unit_quaternions() {
    let model = model(
        "<worldbody><body pos='1 2 3' quat='0 1 0 0'><freejoint/><geom size='1'/></body>
         <body><joint ref='90'/><geom size='1'/></body></worldbody>
         <keyframe><key name='a' qpos='0 0 0 3 0 4 0 1' qvel='1'/><key/></keyframe>",
    );
    let half = std::f64::consts::FRAC_PI_2;
    assert_eq!(model.poses[0], ("a".into(), vec![0.0, 0.0, 0.0, 0.6, 0.0, 0.8, 0.0, 1.0]));
    assert_eq!(model.poses[1], ("key1".into(), vec![1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 0.0, half]));
    assert_eq!(model.remarks, ["Of the key `a`, `qvel` is left out."]);
}

/// What changes nothing is named in remarks.
#[test]
fn harmless_parts_are_left_out() {
    let model = model(
        "<asset><mesh name='m' file='m.stl'/></asset><size nkey='1'/><visual/><statistic/>
         <worldbody><camera/><light/><body name='a'><joint name='j'/><geom size='1'/>
           <geom type='mesh' mesh='m' contype='0' conaffinity='0' mass='0'/></body></worldbody>
         <tendon><fixed name='t'><joint joint='j' coef='1'/></fixed></tendon>
         <sensor><jointpos joint='j'/><tendonpos tendon='t'/></sensor>
         <contact><exclude body1='world' body2='a'/></contact>",
    );
    assert_eq!(model.shapes.len(), 1);
    assert_eq!(model.excluded, [[0, 1]]);
    assert_eq!(model.remarks.len(), 5);
    assert!(model.remarks[0].starts_with("Sensors only measure; 2 are left out."));
    assert!(model.remarks[4].contains("<geom type=\"mesh\" mesh=\"m\"> in line 3"));
}

/// Colours come from the geom, or from its material.
#[test]
fn colours_come_from_materials() {
    let model = model(
        "<asset><material name='red' rgba='1 0 0 1'/></asset>
         <worldbody><geom size='1' material='red'/><geom size='1' material='red' rgba='0 1 0 1'/>
         </worldbody>",
    );
    assert_eq!(model.shapes[0].colour, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(model.shapes[1].colour, [0.0, 1.0, 0.0, 1.0]);
}

/// A folder of files, which is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str, files: &[(&str, &str)]) -> Self {
        let path = std::env::temp_dir().join(format!("bodies-{name}-{}", std::process::id()));
        for (file, content) in files {
            let file = path.join(file);
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, content).unwrap();
        }
        Self(path)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

#[test]
fn includes_are_read_and_expanded() {
    let folder = Folder::new(
        "include",
        &[
            (
                "main.xml",
                "<mujoco><worldbody><body><include file='./parts/leg.xml'/></body></worldbody>
                 <include file='parts/rest.xml'/></mujoco>",
            ),
            ("parts/leg.xml", "<mujoco>\n<joint name='a&lt;&quot;'/>\n<geom size='.1'/></mujoco>"),
            ("parts/rest.xml", "<mujoco>\n\n<option timestep='.5'/></mujoco>"),
            ("bad.xml", "<mujoco>\n<include file='parts/broken.xml'/></mujoco>"),
            ("parts/broken.xml", "<mujoco>\n\n<option timestep='x'/></mujoco>"),
        ],
    );
    let model = read(&folder.file("main.xml")).unwrap();
    assert_eq!((model.options.dt, model.joints[0].name.as_str()), (0.5, "a<\""));
    let text = expand(&folder.file("main.xml")).unwrap();
    assert!(!text.contains("include"));
    assert_eq!(parse(&text, "main.xml").unwrap(), model);
    // Also of parts that the simulation refuses, in the text alone.
    let place = parse(&text, "other.xml").unwrap().shapes[0].place.to_string();
    assert_eq!(place, "./parts/leg.xml, line 3, <geom>");
    // An expanded text stays as it is, and wrong instructions change places only.
    let twice = Folder::new("twice", &[("a.xml", &text), ("b.xml", WRONG)]);
    assert_eq!(expand(&twice.file("a.xml")).unwrap(), text);
    let text = expand(&twice.file("b.xml")).unwrap();
    assert_eq!(parse(&text, "b.xml").unwrap().bodies, read(&twice.file("b.xml")).unwrap().bodies);
    // Errors stay in the file that has them.
    let error = read(&folder.file("bad.xml")).unwrap_err();
    assert_eq!((error.file.as_str(), error.line), ("parts/broken.xml", 3));
}

const WRONG: &str = "<?from 4294967295 ?><mujoco><?from?><worldbody><?from 4294967295 a?>\n
    <body/><?from -1 b?><body/>\n<?from 0 c?><body/></worldbody></mujoco>";

#[test]
fn includes_stay_in_the_folder_and_end() {
    let outside = std::env::temp_dir().join("a.xml");
    let folder = Folder::new(
        "outside",
        &[
            ("in/loop.xml", "<mujoco>\n<include file='loop.xml'/></mujoco>"),
            ("in/twice.xml", "<mujoco><include file='a.xml'/>\n<include file='./a.xml'/></mujoco>"),
            ("in/a.xml", "<mujoco><option/></mujoco>"),
            ("in/up.xml", "<mujoco>\n<include file='../secret.xml'/></mujoco>"),
            ("in/round.xml", "<mujoco>\n<include file='x/../../secret.xml'/></mujoco>"),
            ("in/none.xml", "<mujoco>\n<include file='none/none.xml'/></mujoco>"),
            ("in/empty.xml", "<mujoco>\n<include/></mujoco>"),
            ("secret.xml", "<mujoco><option/></mujoco>"),
        ],
    );
    let absolute = format!("<mujoco>\n<include file='{}'/></mujoco>", outside.display());
    std::fs::write(folder.file("in/absolute.xml"), absolute).unwrap();
    let mut cases = vec![
        ("loop", "includes a file again"),
        ("twice", "includes a file again"),
        ("up", "leaves the folder of the model"),
        ("round", "leaves the folder of the model"),
        ("absolute", "leaves the folder of the model"),
        ("none", "the file cannot be read"),
        ("empty", "has no file; add `file`"),
    ];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("../secret.xml", folder.file("in/link.xml")).unwrap();
        let text = "<mujoco>\n<include file='link.xml'/></mujoco>";
        std::fs::write(folder.file("in/linked.xml"), text).unwrap();
        cases.push(("linked", "leaves the folder of the model"));
    }
    for (name, message) in cases {
        let error = read(&folder.file(&format!("in/{name}.xml"))).unwrap_err();
        assert!(error.what.starts_with(message), "{name}: {error}");
        assert_eq!(error.line, 2, "{name}: {error}");
    }
    let error = read(Path::new("/nowhere/a.xml")).unwrap_err();
    assert!(error.to_string().starts_with("a.xml: cannot be read"), "{error}");
}

/// Texts that would use much memory or time.
#[test]
fn bombs_are_refused() {
    let deep = "<body>".repeat(100_000);
    let wide = format!("<mujoco><worldbody>{}</worldbody></mujoco>", "<geom/>".repeat(200_000));
    let attributes: String = (0..1000).map(|i| format!(" a{i}=''")).collect();
    let entities = "<!DOCTYPE a [<!ENTITY b 'bbbb'><!ENTITY c '&b;&b;&b;'>]><mujoco/>";
    let spaces: String = (0..60).map(|i| format!("<a xmlns:n{i}='{i}'>")).collect();
    for (text, message) in [
        (format!("<mujoco><worldbody>{deep}"), "has more than 300 levels of nested elements"),
        (wide, "has more than 100000 elements"),
        (format!("<mujoco{attributes}/>"), "has more than 200 attributes in one element"),
        (entities.to_string(), "has a document type; entities are refused"),
        (spaces, "has more than 50 namespaces"),
        ("<!--".repeat(1000), "is not well-formed XML"),
        ("<".repeat(100_000), "has more than 300 levels"),
    ] {
        let error = parse(&text, "m.xml").unwrap_err();
        assert!(error.what.starts_with(message), "{error}");
    }
    // Keys without numbers have as many as the model.
    let joints = "<joint type='slide'/>".repeat(6) + "<geom size='1'/>";
    let bodies = format!("<body>{joints}</body>").repeat(2000);
    let keys = "<key/>".repeat(200);
    let text =
        format!("<mujoco><worldbody>{bodies}</worldbody><keyframe>{keys}</keyframe></mujoco>");
    let error = parse(&text, "m.xml").unwrap_err();
    assert!(error.what.starts_with("the keys have more than 1000000 numbers"), "{error}");
}

/// Models as deep as documents may be do not use up the stack.
#[test]
fn bodies_can_be_deep() {
    let depth = 290;
    let open = "<body><joint/><geom size='.1'/><frame>".repeat(depth / 2);
    let close = "</frame></body>".repeat(depth / 2);
    let deep = model(&format!("<worldbody>{open}{close}</worldbody>"));
    assert_eq!(deep.bodies.len(), 1 + depth / 2);
}

/// A quaternion in a file need not be a unit quaternion.
#[test]
fn quaternions_are_scaled() {
    let scaled = model("<worldbody><body quat='2 0 0 0'/><body quat='3 0 4 0'/></worldbody>");
    assert_eq!(scaled.bodies[1].rotation, from_quaternion([1.0, 0.0, 0.0, 0.0]));
    assert_eq!(scaled.bodies[2].rotation, from_quaternion([0.6, 0.0, 0.8, 0.0]));
}
