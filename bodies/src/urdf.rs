//! Reader of URDF, the robot descriptions of ROS.

use crate::files::FileError;
use crate::model::Model;
use crate::xml;
use std::path::Path;

/// Reads a model from a file.
///
/// # Errors
///
/// Always: this reader is to come.
pub fn read(path: &Path) -> Result<Model, FileError> {
    Err(xml::read(path)?.error("URDF is not read yet"))
}
