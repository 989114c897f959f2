//! Model files: reading by the kind of the file, and errors with file and line.

use crate::model::Model;
use crate::{mjcf, urdf, xml};
use std::fmt;
use std::path::Path;
use std::sync::Arc;

/// Reads a model from an MJCF or URDF file, which its outermost element tells apart.
///
/// # Errors
///
/// If the file cannot be read, is malformed, or has something that the physics here lacks.
pub fn read(path: &Path) -> Result<Model, FileError> {
    let document = xml::read(path)?;
    match document.name.as_str() {
        "mujoco" => mjcf::read(path),
        "robot" => urdf::read(path),
        other => Err(document.error(format!(
            "`{other}` is not a model; MJCF files begin with `mujoco`, URDF files with `robot`"
        ))),
    }
}

/// Reads a model from the text of an MJCF or URDF file without includes. `name` is that of the file
/// in messages.
///
/// # Errors
///
/// If the text is malformed, or has something that the physics here lacks.
pub fn parse(text: &str, name: &str) -> Result<Model, FileError> {
    let document = xml::parse(text, name)?;
    match document.name.as_str() {
        "robot" => urdf::parse(text, name),
        _ => mjcf::parse(text, name),
    }
}

/// The text of a file with all that it includes. Places in the model of the text are those in the
/// files that it came from.
///
/// # Errors
///
/// If a file cannot be read or is malformed.
pub fn expand(path: &Path) -> Result<String, FileError> {
    mjcf::expand(path)
}

/// What is wrong with a model file, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileError {
    /// Name of the file.
    pub file: String,
    /// Line from 1; 0 if the whole file is concerned.
    pub line: u32,
    /// Element as in the file, with the attributes that identify it; empty without one.
    pub element: String,
    /// What is wrong and what to do.
    pub what: String,
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_place(f, &self.file, self.line, &self.element)?;
        write!(f, ": {}", self.what)
    }
}

/// Where a part of a model stands in its file. Empty for parts that no file has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Name of the file.
    pub file: Arc<str>,
    /// Line from 1.
    pub line: u32,
    /// Element as in the file, with the attributes that identify it.
    pub element: String,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_place(f, &self.file, self.line, &self.element)
    }
}

fn write_place(f: &mut fmt::Formatter<'_>, file: &str, line: u32, element: &str) -> fmt::Result {
    write!(f, "{file}")?;
    if line > 0 {
        write!(f, ", line {line}")?;
    }
    if !element.is_empty() {
        write!(f, ", {element}")?;
    }
    Ok(())
}

impl std::error::Error for FileError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outermost_element_tells_the_kind() {
        let path = std::env::temp_dir().join(format!("bodies-kind-{}", std::process::id()));
        let read_text = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read(&path)
        };
        assert_eq!(read_text("<mujoco model='m'/>").unwrap().name, "m");
        assert_eq!(read_text("<robot name='r'><link name='a'/></robot>").unwrap().name, "r");
        let error = read_text("<sdf/>").unwrap_err();
        assert!(error.what.starts_with("`sdf` is not a model"), "{error}");
        std::fs::remove_file(&path).unwrap();
    }
}
