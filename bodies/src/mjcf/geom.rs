//! Geoms: shapes, and the mass that they give their body.

use super::known;
use super::settings::Compiler;
use super::softness::softness;
use super::view::View;
use crate::files::FileError;
use crate::mass::{Part, moments, turned, volume};
use crate::model::{Form, Shape, Vec3};
use crate::rotation::{Pose, from_z};
use crate::xml::shorten;
use std::collections::HashMap;

const FORMS: [&str; 9] =
    ["plane", "sphere", "capsule", "cylinder", "ellipsoid", "box", "mesh", "hfield", "sdf"];

/// Colours of materials by name.
pub(crate) type Colours<'a> = HashMap<&'a str, [f64; 4]>;

/// A geom that this reader supports, or that has no effect.
pub(crate) enum Geom {
    Shape(Box<Shape>, Option<Part>),
    /// A mesh that neither touches nor has mass.
    Drawn,
}

/// Reads a geom in a frame of its body. `weighs` tells whether the body has its mass from geoms.
pub(crate) fn geom(
    view: &View,
    compiler: &Compiler,
    colours: &Colours,
    frame: &Pose,
    weighs: bool,
) -> Result<Geom, FileError> {
    view.check(&known::GEOM)?;
    let group = f64::from(view.integer("group", 0)?);
    let weighs = weighs && (compiler.groups[0]..=compiler.groups[1]).contains(&group);
    let kinds = view.integer("contype", 1)? as u32;
    let touches = view.integer("conaffinity", 1)? as u32;
    let kind = FORMS[view.word("type", &FORMS, 1)?];
    if matches!(kind, "mesh" | "hfield" | "sdf") {
        let massless = view.text("mass").is_some() && view.number("mass", 0.0)? == 0.0;
        return drawn(view, kind, kinds | touches != 0, weighs && !massless);
    }
    if view.text("mesh").is_some() {
        return Err(view.error_at("mesh", "forms that fit a mesh are not supported; set `size`"));
    }
    let (form, pose) = form(view, kind, compiler)?;
    let pose = frame.then(&pose);
    let part = mass(view, form, &pose)?.filter(|_| weighs);
    let shape = Shape {
        name: view.element().get("name").unwrap_or("").to_string(),
        body: 0,
        form,
        position: pose.position,
        rotation: pose.rotation,
        kinds,
        touches,
        dimension: dimension(view)?,
        friction: friction(view)?,
        softness: softness(view, "solref", "solimp")?,
        mix: view.natural("solmix", 1.0)?,
        priority: view.integer("priority", 0)?,
        margin: view.natural("margin", 0.0)?,
        colour: colour(view, colours)?,
        place: view.element().place(),
    };
    Ok(Geom::Shape(Box::new(shape), part))
}

/// A mesh or a height field, which is left out if that does not change the physics.
fn drawn(view: &View, kind: &str, touches: bool, weighs: bool) -> Result<Geom, FileError> {
    let what = match kind {
        "mesh" => "meshes are",
        "hfield" => "height fields are",
        _ => "distance fields are",
    };
    if touches {
        return Err(view.error(format!(
            "{what} not supported; replace it by a capsule or another form, or set `contype` and \
             `conaffinity` to 0"
        )));
    }
    if weighs {
        return Err(view.error(format!(
            "{what} not supported and this one has mass; give the body an `inertial`"
        )));
    }
    Ok(Geom::Drawn)
}

/// Form and pose in the frame of the element.
fn form(view: &View, kind: &str, compiler: &Compiler) -> Result<(Form, Pose), FileError> {
    let [a, b, c] = view.fill("size", [0.0; 3])?;
    let ends = view.exact::<6>("fromto")?;
    let (pose, half) = match ends {
        Some(ends) => between(view, kind, ends)?,
        None => (view.pose(compiler.angles)?, b),
    };
    let third = if ends.is_some() { half } else { c };
    let (form, sizes) = match kind {
        "plane" => return Ok((Form::Plane, pose)),
        "sphere" => (Form::Sphere(a), vec![a]),
        "capsule" => (Form::Capsule(a, half), vec![a, half]),
        "cylinder" => (Form::Cylinder(a, half), vec![a, half]),
        _ => {
            let sizes = [a, if ends.is_some() { a } else { b }, third];
            let form = if kind == "box" { Form::Box(sizes) } else { Form::Ellipsoid(sizes) };
            (form, sizes.to_vec())
        }
    };
    // Smaller sizes have no volume in double precision.
    if let Some(wrong) = sizes.iter().position(|s| *s < 1e-15) {
        let count = sizes.len();
        return Err(view.error_at(
            "size",
            format!("number {} of `size` must be positive; a {kind} needs {count}", wrong + 1),
        ));
    }
    Ok((form, pose))
}

/// Pose and half length between two points. MuJoCo's z axis points from the second point to the
/// first.
fn between(view: &View, kind: &str, ends: [f64; 6]) -> Result<(Pose, f64), FileError> {
    if !matches!(kind, "capsule" | "cylinder" | "ellipsoid" | "box") {
        let what = format!("a {kind} cannot have `fromto`; set `type`, or write `pos`");
        return Err(view.error_at("fromto", what));
    }
    if view.holder("pos").is_some() {
        return Err(view.error_at("fromto", "has `pos` and `fromto`; remove one of them"));
    }
    let d: Vec3 = [0, 1, 2].map(|i| ends[i] - ends[i + 3]);
    let half = 0.5 * d.iter().map(|x| x * x).sum::<f64>().sqrt();
    match from_z(d) {
        Some(rotation) => {
            let position = [0, 1, 2].map(|i| 0.5 * (ends[i] + ends[i + 3]));
            Ok((Pose { position, rotation }, half))
        }
        None => Err(view.error_at("fromto", "the two points of `fromto` coincide; move one")),
    }
}

/// Mass, centre and inertia in the axes of the body.
fn mass(view: &View, form: Form, pose: &Pose) -> Result<Option<Part>, FileError> {
    let density = view.natural("density", 1000.0)?;
    let mass = match view.text("mass") {
        Some(_) if form == Form::Plane => 0.0,
        Some(_) => view.natural("mass", 0.0)?,
        None => density * volume(form),
    };
    let inertia = turned(moments(form).map(|m| mass * m), &pose.rotation);
    // MuJoCo's smallest mass.
    Ok((mass >= 1e-15).then_some(Part {
        mass,
        centre: pose.position,
        inertia,
        axes: Some(pose.rotation),
    }))
}

fn dimension(view: &View) -> Result<usize, FileError> {
    match view.integer("condim", 3)? {
        d @ (1 | 3 | 4 | 6) => Ok(d as usize),
        other => {
            Err(view.error_at("condim", format!("`condim` is {other}; it can be 1, 3, 4 or 6")))
        }
    }
}

fn friction(view: &View) -> Result<Vec3, FileError> {
    let friction = view.fill("friction", [1.0, 0.005, 0.0001])?;
    if friction.iter().any(|f| *f < 0.0) {
        return Err(view.error_at("friction", "`friction` is negative; it must be at least 0"));
    }
    Ok(friction)
}

/// The colour of the geom, or of its material if that of the geom is the default.
fn colour(view: &View, colours: &Colours) -> Result<[f64; 4], FileError> {
    const DEFAULT: [f64; 4] = [0.5, 0.5, 0.5, 1.0];
    let own = view.exact("rgba")?.unwrap_or(DEFAULT);
    match view.text("material") {
        Some(name) => match colours.get(name) {
            None => {
                let name = shorten(name);
                Err(view.error_at("material", format!("unknown material `{name}`; add it")))
            }
            Some(colour) if own == DEFAULT => Ok(*colour),
            Some(_) => Ok(own),
        },
        None => Ok(own),
    }
}
