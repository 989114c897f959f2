//! Reader of MJCF, the model files of MuJoCo.
//!
//! Numbers and rules follow MuJoCo 4.0: its XML reference, and models that it compiles. A file with
//! something that would change the physics and that is not supported is refused, with its line.

mod actuator;
mod classes;
mod drive;
mod finish;
mod geom;
mod include;
mod joint;
mod known;
mod pose;
mod sections;
mod settings;
mod softness;
mod tendon;
#[cfg(test)]
mod tests;
mod tree;
mod view;

use crate::files::FileError;
use crate::model::{Joint, Model};
use crate::names;
use crate::xml::{self, Element};
use settings::Switches;
use std::path::Path;
use tree::Tree;

/// Reads a model from a file, with the files that it includes from its folder.
///
/// # Errors
///
/// If a file cannot be read, is malformed, or has something that is not supported.
pub fn read(path: &Path) -> Result<Model, FileError> {
    let stem = path.file_stem().map_or(Default::default(), |s| s.to_string_lossy());
    model(&include::read(path)?, &stem)
}

/// Reads a model from text without includes. The name of its file appears in errors.
///
/// # Errors
///
/// If the text is malformed, or has something that is not supported.
pub fn parse(text: &str, name: &str) -> Result<Model, FileError> {
    let stem = Path::new(name).file_stem().map_or(Default::default(), |s| s.to_string_lossy());
    model(&xml::parse(text, name)?, &stem)
}

/// The text of a file with the elements of its includes in their places, so that it stands alone.
/// Its elements keep the lines of their files.
///
/// # Errors
///
/// If a file cannot be read or is malformed.
pub fn expand(path: &Path) -> Result<String, FileError> {
    Ok(xml::write(&include::read(path)?))
}

/// Reads the model of a document. The name is that of the file, for models without a name.
fn model(root: &Element, name: &str) -> Result<Model, FileError> {
    sections::check(root)?;
    let compiler = settings::compiler(root)?;
    let (options, switches) = settings::options(root)?;
    let classes = classes::Classes::new(sections::named(root, "default"))?;
    let colours = sections::colours(root, &classes)?;
    let mut tree = Tree::new(&classes, &compiler, &colours);
    tree.world(root)?;
    finish::finish(&mut tree)?;
    let mut model = Model {
        name: root.get("model").unwrap_or(name).to_string(),
        options,
        bodies: std::mem::take(&mut tree.bodies),
        joints: std::mem::take(&mut tree.joints),
        shapes: std::mem::take(&mut tree.shapes),
        sites: std::mem::take(&mut tree.sites),
        actuators: Vec::new(),
        excluded: Vec::new(),
        poses: Vec::new(),
        remarks: Vec::new(),
    };
    switch(&mut model, &switches)?;
    let idle = sections::actuators(root, &classes, &compiler, &mut model)?;
    sections::excluded(root, &mut model)?;
    pose::poses(root, &mut model)?;
    sections::remarks(root, &tree, idle, &mut model);
    names::fill(&mut model);
    Ok(model)
}

/// Applies flags that concern joints and softness.
fn switch(model: &mut Model, switches: &Switches) -> Result<(), FileError> {
    if !switches.friction_loss {
        model.joints.iter_mut().for_each(|j| j.friction_loss = 0.0);
    }
    let damped = model.joints.iter().any(|j| j.damping != 0.0);
    if let Some(error) = switches.explicit_damping.as_ref().filter(|_| damped) {
        return Err(error.clone());
    }
    if let Some(error) = &switches.short_times {
        let softness = |j: &Joint| [Some(j.friction_softness), j.limit.map(|l| l.softness)];
        let of_joints = model.joints.iter().flat_map(softness).flatten();
        let of_shapes = model.shapes.iter().map(|s| s.softness);
        let short = |time: f64| time > 0.0 && time < 2.0 * model.options.dt;
        if of_joints.chain(of_shapes).any(|s| short(s.reference[0])) {
            return Err(error.clone());
        }
    }
    Ok(())
}
