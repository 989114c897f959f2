//! The sections of a file beside the bodies.

use super::actuator::{Targets, actuator};
use super::classes::Classes;
use super::geom::Colours;
use super::known;
use super::settings::Compiler;
use super::tendon;
use super::tree::Tree;
use crate::files::FileError;
use crate::model::{Model, Transmission};
use crate::xml::{Element, hint, shorten};
use std::collections::{HashMap, HashSet};

const SECTIONS: [&str; 17] = [
    "compiler",
    "option",
    "size",
    "statistic",
    "visual",
    "asset",
    "custom",
    "sensor",
    "default",
    "worldbody",
    "contact",
    "actuator",
    "keyframe",
    "tendon",
    "equality",
    "deformable",
    "extension",
];

/// The sections of this name.
pub(crate) fn named<'a>(
    root: &'a Element,
    name: &'a str,
) -> impl Iterator<Item = &'a Element> + Clone {
    root.children.iter().filter(move |c| c.name == name)
}

/// The elements of the sections of this name.
fn within<'a>(root: &'a Element, name: &'a str) -> impl Iterator<Item = &'a Element> {
    named(root, name).flat_map(|s| &s.children)
}

/// Refuses what is not MJCF, and sections with elements that would change the physics.
pub(crate) fn check(root: &Element) -> Result<(), FileError> {
    if root.name != "mujoco" {
        return Err(root.error("is not MJCF; its outermost element must be `mujoco`"));
    }
    known::ROOT.check(root)?;
    for section in &root.children {
        let first = section.children.first().unwrap_or(section);
        match section.name.as_str() {
            "extension" if !section.children.is_empty() => {
                return Err(first.error("plugins are not supported; remove them"));
            }
            "equality" => equality(section)?,
            "deformable" => deformable(section)?,
            "include" => {
                return Err(section.error("includes need a file; read the model from its file"));
            }
            name if SECTIONS.contains(&name) => {}
            name => {
                let hint = hint(name, SECTIONS);
                return Err(section.error(format!("unknown section; {hint}")));
            }
        }
    }
    Ok(())
}

/// Equalities act unless they are inactive.
fn equality(section: &Element) -> Result<(), FileError> {
    match section.children.iter().find(|e| e.get("active") != Some("false")) {
        None => Ok(()),
        Some(acting) => Err(acting.error(
            "equality constraints are not supported; remove it, or join the bodies by joints",
        )),
    }
}

/// Skins are only drawn.
fn deformable(section: &Element) -> Result<(), FileError> {
    match section.children.iter().find(|e| e.name != "skin") {
        None => Ok(()),
        Some(flex) => Err(flex.error("deformable bodies are not supported; remove it")),
    }
}

/// Colours of the materials.
pub(crate) fn colours<'a>(
    root: &'a Element,
    classes: &Classes<'a>,
) -> Result<Colours<'a>, FileError> {
    let mut colours = Colours::new();
    for material in within(root, "asset").filter(|e| e.name == "material") {
        let view = classes.view(material, 0, &["material"])?;
        view.check(&known::MATERIAL)?;
        let Some(name) = material.get("name") else {
            // MuJoCo names a material after the file of its texture.
            return Err(material.error("has no name; add `name`"));
        };
        if colours.insert(name, view.exact("rgba")?.unwrap_or([1.0; 4])).is_some() {
            return Err(material.error("another material has the same name; rename one of them"));
        }
    }
    Ok(colours)
}

/// Largest number of pairs of joints of all tendons of actuators.
const PAIRS: usize = 1_000_000;

/// Reads the actuators. Returns the number of tendons without actuators.
pub(crate) fn actuators<'a>(
    root: &'a Element,
    classes: &Classes<'a>,
    compiler: &Compiler,
    model: &mut Model,
) -> Result<usize, FileError> {
    let by_name = index(model.joints.iter().map(|j| &j.name));
    let tendons = tendon::named(within(root, "tendon"), classes)?;
    let targets = Targets { joints: &model.joints, by_name, tendons, classes };
    let (mut names, mut driven, mut pairs) = (HashSet::new(), HashSet::new(), 0);
    for element in within(root, "actuator") {
        let actuator = actuator(element, &targets, compiler.auto_limits)?;
        if !actuator.name.is_empty() && !names.insert(actuator.name.clone()) {
            return Err(element.error("another actuator has the same name; rename one of them"));
        }
        if let Transmission::Tendon(ends) = &actuator.on {
            driven.insert(element.get("tendon"));
            pairs += ends.len() * ends.len();
            if pairs > PAIRS {
                let what =
                    format!("the tendons of actuators have more than {PAIRS} pairs of joints");
                return Err(element.error(what));
            }
        }
        model.actuators.push(actuator);
    }
    Ok(within(root, "tendon").count() - driven.len())
}

fn index<'a>(names: impl Iterator<Item = &'a String>) -> HashMap<String, usize> {
    names.enumerate().filter(|(_, n)| !n.is_empty()).map(|(i, n)| (n.clone(), i)).collect()
}

/// Reads the pairs of bodies that never touch.
pub(crate) fn excluded(root: &Element, model: &mut Model) -> Result<(), FileError> {
    let by_name = index(model.bodies.iter().map(|b| &b.name));
    for element in within(root, "contact") {
        match element.name.as_str() {
            "exclude" => known::EXCLUDE.check(element)?,
            "pair" => {
                return Err(element
                    .error("contact pairs are not supported; write the parameters to the geoms"));
            }
            other => {
                let hint = hint(other, ["exclude", "pair"]);
                return Err(element.error(format!("unknown element; {hint}")));
            }
        }
        let body = |attribute: &str| {
            let name = element.get(attribute).unwrap_or("");
            by_name.get(name).copied().ok_or_else(|| {
                let hint = hint(name, by_name.keys().map(String::as_str));
                let name = shorten(name);
                element.error(format!("unknown body `{name}` as `{attribute}`; {hint}"))
            })
        };
        let pair = [body("body1")?, body("body2")?];
        model.excluded.push(pair);
    }
    Ok(())
}

/// Names what the file has and what is left out, `idle` tendons among others.
pub(crate) fn remarks(root: &Element, tree: &Tree, idle: usize, model: &mut Model) {
    let count = |section: &str| within(root, section).count();
    for (count, what) in [
        (count("sensor"), "Sensors only measure"),
        (idle, "Tendons without forces only measure"),
        (count("equality"), "Inactive equality constraints do not act"),
        (count("custom"), "Custom elements do not act"),
        (count("deformable"), "Skins are only drawn"),
        (tree.cameras, "Cameras only look"),
        (tree.lights, "Lights only shine"),
    ] {
        match count {
            0 => {}
            1 => model.remarks.push(format!("{what}; 1 is left out.")),
            _ => model.remarks.push(format!("{what}; {count} are left out.")),
        }
    }
    if let Some(first) = tree.drawn.first() {
        let (count, label, line) = (tree.drawn.len(), &first.element, first.line);
        model.remarks.push(format!(
            "Meshes, height fields and distance fields that do not touch are only drawn; {count} \
             left out, the first {label} in line {line}."
        ));
    }
}
