//! Joints.

use super::known;
use super::settings::Compiler;
use super::softness::softness;
use super::view::View;
use crate::files::FileError;
use crate::model::{Joint, JointKind, Limit};
use crate::rotation::{Pose, apply, unit};

/// Reads a joint in a frame of its body. The name is empty if it has none.
pub(crate) fn joint(
    view: &View,
    compiler: &Compiler,
    body: usize,
    frame: &Pose,
) -> Result<Joint, FileError> {
    let name = view.element().get("name").unwrap_or("");
    if view.element().name == "freejoint" {
        view.check(&known::FREE_JOINT)?;
        return Ok(Joint::new(name, body, JointKind::Free));
    }
    view.check(&known::JOINT)?;
    let kind = match view.word("type", &["hinge", "slide", "ball", "free"], 0)? {
        0 => JointKind::Hinge,
        1 => JointKind::Slide,
        2 => JointKind::Ball,
        _ => JointKind::Free,
    };
    let scalar = matches!(kind, JointKind::Hinge | JointKind::Slide);
    let angle = if kind == JointKind::Hinge { compiler.angles.unit } else { 1.0 };
    let mut joint = Joint {
        stiffness: view.linear("stiffness")?,
        damping: view.linear("damping")?,
        armature: view.natural("armature", 0.0)?,
        friction_loss: view.natural("frictionloss", 0.0)?,
        friction_softness: softness(view, "solreffriction", "solimpfriction")?,
        ..Joint::new(name, body, kind)
    };
    if joint.damping < 0.0 {
        return Err(view.error_at("damping", "`damping` is negative; it must be at least 0"));
    }
    if kind != JointKind::Free {
        joint.point = frame.point(view.exact("pos")?.unwrap_or([0.0; 3]));
        joint.limit = limit(view, compiler, kind, angle)?;
    }
    if scalar {
        let axis = unit(view.exact("axis")?.unwrap_or([0.0, 0.0, 1.0]))
            .ok_or_else(|| view.error_at("axis", "`axis` has no direction; its length is 0"))?;
        joint.axis = apply(&frame.rotation, axis);
        joint.reference = angle * view.number("ref", 0.0)?;
        joint.spring_reference = angle * view.number("springref", 0.0)?;
        let (range, limited) = ("actuatorfrcrange", "actuatorfrclimited");
        joint.force_range = view.range(range, limited, compiler.auto_limits)?;
    }
    Ok(joint)
}

fn limit(
    view: &View,
    compiler: &Compiler,
    kind: JointKind,
    angle: f64,
) -> Result<Option<Limit>, FileError> {
    let softness = softness(view, "solreflimit", "solimplimit")?;
    let margin = view.natural("margin", 0.0)?;
    let Some(range) = view.range("range", "limited", compiler.auto_limits)? else {
        return Ok(None);
    };
    if kind == JointKind::Ball {
        return Err(view.error_at(
            "range",
            "limits of ball joints are not supported; set `limited` to false or use hinges",
        ));
    }
    Ok(Some(Limit { range: range.map(|r| angle * r), margin, softness }))
}
