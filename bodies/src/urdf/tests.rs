//! Texts that are read and texts that are refused.

use super::parse;
use crate::Bodies;
use crate::model::{Form, JointKind, Model, Transmission};

const INERTIAL: &str = "<inertial><origin xyz='0 0 1'/><mass value='2'/>
    <inertia ixx='1' ixy='0' ixz='0' iyy='2' iyz='0' izz='3'/></inertial>";

fn link(name: &str, content: &str) -> String {
    format!("<link name='{name}'>{content}</link>")
}

fn joint(name: &str, kind: &str, parent: &str, child: &str, content: &str) -> String {
    format!(
        "<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>
         {content}</joint>"
    )
}

fn robot(content: &str) -> Model {
    parse(&format!("<robot name='r'>{content}</robot>"), "r.urdf").unwrap_or_else(|e| panic!("{e}"))
}

/// Base and arm with a joint of this kind and content.
fn arm(kind: &str, content: &str) -> String {
    let links = link("base", "") + &link("arm", INERTIAL);
    links + &joint("j", kind, "base", "arm", content)
}

const LIMIT: &str = "<limit lower='-1' upper='2' effort='5' velocity='3'/>";

#[test]
fn joints_have_limits_and_motors() {
    let place = "<origin xyz='1 2 3' rpy='0 0 1.5707963267948966'/><axis xyz='0 2 0'/>
                 <dynamics damping='3' friction='.4'/>";
    let model = robot(&arm("revolute", &format!("{place}{LIMIT}")));
    let names: Vec<_> = model.bodies.iter().map(|b| b.name.as_str()).collect();
    assert_eq!(names, ["world", "base", "arm"]);
    assert_eq!((model.bodies[2].parent, model.bodies[2].position), (1, [1.0, 2.0, 3.0]));
    assert!((model.bodies[2].rotation[1][0] - 1.0).abs() < 1e-15);
    let joint = &model.joints[0];
    assert_eq!((joint.kind, joint.axis), (JointKind::Hinge, [0.0, 1.0, 0.0]));
    assert_eq!((joint.damping, joint.friction_loss), (3.0, 0.4));
    assert_eq!(joint.limit.unwrap().range, [-1.0, 2.0]);
    assert_eq!(joint.force_range, Some([-5.0, 5.0]));
    let motor = &model.actuators[0];
    assert_eq!((motor.name.as_str(), &motor.on, motor.gain), ("j", &Transmission::Joint(0), 1.0));
    assert_eq!(motor.control_range, Some([-5.0, 5.0]));
    assert_eq!(model.remarks, ["Limits of velocities do not act; 1 is left out."]);
}

#[test]
fn kinds_of_joints() {
    let endless = robot(&arm("continuous", "<limit effort='0' velocity='1'/>"));
    assert_eq!((endless.joints[0].limit, endless.joints[0].force_range), (None, None));
    assert_eq!(endless.actuators[0].control_range, None);
    assert_eq!(endless.joints[0].axis, [1.0, 0.0, 0.0]);
    assert_eq!(robot(&arm("prismatic", LIMIT)).joints[0].kind, JointKind::Slide);
    let fixed = robot(&arm("fixed", ""));
    assert_eq!((fixed.bodies.len(), fixed.joints.len(), fixed.actuators.len()), (3, 0, 0));
    let floating = link("world", "") + &link("arm", INERTIAL);
    let floating = robot(&(floating + &joint("j", "floating", "world", "arm", "")));
    assert_eq!((floating.joints[0].kind, floating.joints[0].body), (JointKind::Free, 1));
    assert!(floating.actuators.is_empty());
}

#[test]
fn inertia_turns_with_its_origin() {
    let turned = INERTIAL.replace("xyz='0 0 1'", "rpy='0 0 1.5707963267948966'");
    let model = robot(&link("base", &turned));
    for (a, b) in model.bodies[1].inertia.iter().zip([2.0, 1.0, 3.0, 0.0, 0.0, 0.0]) {
        assert!((a - b).abs() < 1e-15);
    }
    let plain = robot(&link("base", INERTIAL));
    assert_eq!((plain.bodies[1].mass, plain.bodies[1].centre), (2.0, [0.0, 0.0, 1.0]));
}

#[test]
fn collisions_become_shapes() {
    let shape = |name: &str, form: &str| {
        format!("<collision name='{name}'><geometry>{form}</geometry></collision>")
    };
    let content = shape("ball", "<sphere radius='2'/>")
        + &shape("", "<cylinder radius='1' length='3'/>")
        + &shape("ball", "<box size='1 2 3'/>")
        + &shape("m", "<mesh filename='a.stl'/>")
        + "<visual><geometry><mesh filename='a.stl'/></geometry></visual>";
    let model = robot(&link("base", &content));
    let forms: Vec<_> = model.shapes.iter().map(|s| (s.name.as_str(), s.form)).collect();
    let cylinder = Form::Cylinder(1.0, 1.5);
    let cube = Form::Box([0.5, 1.0, 1.5]);
    assert_eq!(forms, [("ball", Form::Sphere(2.0)), ("geom1", cylinder), ("geom2", cube)]);
    assert!(model.remarks[0].starts_with("Meshes do not touch; 1 left out"));
    assert!(model.remarks[1].starts_with("Visual shapes are only drawn; 1 is left out."));
}

#[test]
fn refused_contacts_name_their_places() {
    let floor = "<collision name='floor'><geometry><box size='9 9 1'/></geometry></collision>";
    let foot = "\n<collision><geometry><cylinder radius='1' length='3'/></geometry></collision>";
    let links = link("world", floor) + &link("arm", &format!("{INERTIAL}{foot}"));
    let model = robot(&(links + &joint("j", "floating", "world", "arm", "")));
    let error = Bodies::new(model).unwrap_err().to_string();
    let start = "r.urdf, line 3, <collision> and r.urdf, line 1, <collision name=\"floor\"> may touch, \
                 and contacts of the forms cylinder and box ";
    assert!(error.starts_with(start), "{error}");
}

/// A link without mass may move if a link that is fixed to it has mass.
#[test]
fn fixed_links_belong_to_the_link_that_moves() {
    let links = link("base", "") + &link("dummy", "") + &link("arm", INERTIAL);
    let turn = joint("j", "continuous", "base", "dummy", "");
    assert_eq!(
        robot(&(links.clone() + &turn + &joint("k", "fixed", "dummy", "arm", ""))).joints.len(),
        1
    );
    let slides = joint("k", "prismatic", "dummy", "arm", LIMIT);
    let text = format!("<robot>{links}{turn}{slides}</robot>");
    let error = parse(&text, "r.urdf").unwrap_err();
    assert!(
        error.to_string().contains("<link name=\"dummy\">: it moves and has no mass"),
        "{error}"
    );
}

/// Each content is refused, with this beginning of the message.
fn refused(cases: &[(String, &str)]) {
    for (content, message) in cases {
        let error = parse(&format!("<robot>{content}</robot>"), "r.urdf").expect_err(content);
        assert!(error.what.starts_with(message), "{content}: {error}");
    }
}

#[test]
fn refusals_of_joints_name_the_reason() {
    let two = link("base", "") + &link("arm", INERTIAL);
    let with = |content: &str| arm("revolute", &format!("{LIMIT}{content}"));
    refused(&[
        (String::new(), "no link is outermost"),
        (two.clone(), "no joint leads to this link, and none leads to `base`"),
        (link("a", "") + &link("a", ""), "another link has the same name"),
        (link("", ""), "has no name; add `name`"),
        (arm("revolute", ""), "has no limits; add `limit`"),
        (arm("revolute", "<limit effort='1'/>"), "`lower` must be less than `upper`"),
        (arm("revolute", "<limit lower='0' upper='x'/>"), "`upper` has `x`, not a number"),
        (arm("planar", ""), "planar joints are not supported"),
        (arm("revolut", ""), "unknown type `revolut`; did you mean `revolute`?"),
        (arm("floating", ""), "the parent of a floating joint must be a link with the name"),
        (with("<mimic joint='j'/>"), "coupled joints are not supported; remove `mimic`"),
        (with("<axis xyz='0 0 0'/>"), "its axis has length 0"),
        (with("<dynamics damping='-1'/>"), "`damping` is negative"),
        (with("<dynamic/>"), "unknown element in a joint; did you mean `dynamics`?"),
        (two.clone() + &joint("j", "fixed", "base", "hand", ""), "unknown link `hand` as child"),
        (with("") + &joint("j", "fixed", "base", "arm", ""), "another joint has the same name"),
        (with("") + &joint("k", "fixed", "base", "arm", ""), "its child is the child of another"),
        (
            two.clone()
                + &joint("j", "fixed", "base", "arm", "")
                + &joint("k", "fixed", "arm", "base", ""),
            "no link is outermost",
        ),
        (
            link("root", "")
                + &two
                + &joint("j", "fixed", "base", "arm", "")
                + &joint("k", "fixed", "arm", "base", ""),
            "some links form a loop",
        ),
        (
            link("base", "") + &link("world", "") + &joint("j", "fixed", "base", "world", ""),
            "only the outermost link can be `world`",
        ),
    ]);
}

#[test]
fn refusals_of_links_name_the_reason() {
    let solid = |inertia: &str| {
        let inertial = format!("<inertial><mass value='1'/>{inertia}</inertial>");
        link("base", "") + &link("arm", &inertial) + &joint("j", "continuous", "base", "arm", "")
    };
    let shape =
        |form: &str| link("base", &format!("<collision><geometry>{form}</geometry></collision>"));
    refused(&[
        (solid(""), "has no moments of inertia; add `inertia`"),
        (solid("<inertia ixx='1' iyy='1' izz='3'/>"), "a principal moment of its inertia"),
        (solid("<inertia ixx='1' iyy='1' izz='1' ixy='2'/>"), "a principal moment of its inertia"),
        (solid("<inertia ixx='0' iyy='0' izz='0'/>"), "it moves and has no mass or no inertia"),
        (link("a", "<inertial/>"), "has no mass; add `mass`"),
        (link("a", "<collison/>"), "unknown element in a link; did you mean `collision`?"),
        (shape(""), "has no geometry; add `geometry` with a form"),
        (shape("<sphere/>"), "`radius` must be a positive number"),
        (shape("<box size='1 1 0'/>"), "`size` must be three positive numbers"),
        (shape("<cone/>"), "unknown form; "),
        ("<lnk/>".into(), "unknown element; did you mean `link`?"),
        ("<x:macro xmlns:x='x'/>".into(), "macros are not expanded; run xacro first"),
    ]);
}

/// Long chains do not use the stack.
#[test]
fn chains_can_be_long() {
    let count = 20_000;
    let mut text = link("l0", "");
    for i in 1..count {
        text += &link(&format!("l{i}"), "");
        text += &format!(
            "<joint name='j{i}' type='fixed'><parent link='l{}'/><child link='l{i}'/></joint>",
            i - 1
        );
    }
    assert_eq!(robot(&text).bodies.len(), count + 1);
}
