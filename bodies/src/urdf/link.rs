//! Masses and shapes of links.

use super::{natural, number, origin, vector};
use crate::files::FileError;
use crate::mass::{Part, flat, matrix};
use crate::model::{Body, Form, Model, Shape, Softness};
use crate::xml::{Element, hint};

/// Sets the mass of a body from the `inertial` of its link. Without one it has no mass.
pub(crate) fn weigh(link: &Element, body: &mut Body) -> Result<(), FileError> {
    let Some(inertial) = link.child("inertial") else { return Ok(()) };
    let pose = origin(inertial)?;
    body.mass = match inertial.child("mass") {
        Some(mass) => natural(mass, "value", 0.0)?,
        None => return Err(inertial.error("has no mass; add `mass`")),
    };
    body.centre = pose.position;
    let Some(inertia) = inertial.child("inertia") else {
        return Err(inertial.error("has no moments of inertia; add `inertia`"));
    };
    let mut moments = [0.0; 6];
    for (moment, name) in moments.iter_mut().zip(["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]) {
        *moment = number(inertia, name)?.unwrap_or(0.0);
    }
    let own = Part { mass: body.mass, centre: [0.0; 3], inertia: matrix(moments), axes: None }
        .placed(&pose);
    body.inertia = flat(&own.inertia);
    Ok(())
}

/// Adds the shapes of the collisions of a link, and the files of meshes to the list.
pub(crate) fn shapes(
    link: &Element,
    body: usize,
    model: &mut Model,
    meshes: &mut Vec<String>,
) -> Result<(), FileError> {
    const KNOWN: [&str; 3] = ["inertial", "visual", "collision"];
    // Simulators have extensions for links.
    const IGNORED: [&str; 6] = [
        "contact",
        "sensor",
        "material",
        "self_filter",
        "collision_checking",
        "self_collision_checking",
    ];
    for child in &link.children {
        let name = child.name.as_str();
        if !KNOWN.contains(&name) && !IGNORED.contains(&name) {
            let hint = hint(name, KNOWN);
            return Err(child.error(format!("unknown element in a link; {hint}")));
        }
        if name != "collision" {
            continue;
        }
        let geometry = child.child("geometry").and_then(|g| g.children.first());
        let Some(geometry) = geometry else {
            return Err(child.error("has no geometry; add `geometry` with a form"));
        };
        if geometry.name == "mesh" {
            meshes.push(geometry.get("filename").unwrap_or("").to_string());
            continue;
        }
        let form = form(geometry)?;
        let pose = origin(child)?;
        let name = child.get("name").unwrap_or("").to_string();
        model.shapes.push(Shape {
            name,
            body,
            form,
            position: pose.position,
            rotation: pose.rotation,
            kinds: 1,
            touches: 1,
            dimension: 3,
            friction: [1.0, 0.005, 0.0001],
            softness: Softness::default(),
            mix: 1.0,
            priority: 0,
            margin: 0.0,
            colour: [0.5, 0.5, 0.5, 1.0],
            place: child.place(),
        });
    }
    Ok(())
}

fn form(geometry: &Element) -> Result<Form, FileError> {
    let size = |name: &str| match number(geometry, name)? {
        Some(size) if size >= 1e-15 => Ok(size),
        _ => Err(geometry.error(format!("`{name}` must be a positive number"))),
    };
    match geometry.name.as_str() {
        "sphere" => Ok(Form::Sphere(size("radius")?)),
        "cylinder" => Ok(Form::Cylinder(size("radius")?, 0.5 * size("length")?)),
        "capsule" => Ok(Form::Capsule(size("radius")?, 0.5 * size("length")?)),
        "box" => match vector(geometry, "size")? {
            Some(size) if size.iter().all(|s| *s >= 1e-15) => Ok(Form::Box(size.map(|s| 0.5 * s))),
            _ => Err(geometry.error("`size` must be three positive numbers")),
        },
        other => {
            let hint = hint(other, ["sphere", "cylinder", "capsule", "box", "mesh"]);
            Err(geometry.error(format!("unknown form; {hint}")))
        }
    }
}
