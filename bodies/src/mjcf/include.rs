//! Files that other files include.

use crate::files::FileError;
use crate::xml::{self, Element, shorten};
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

/// Largest number of files of a model.
const FILES: usize = 100;

/// Reads a file with the elements of its includes in their places.
pub(crate) fn read(path: &Path) -> Result<Element, FileError> {
    let mut root = xml::read(path)?;
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let cannot = |e: std::io::Error| root.error(format!("its folder cannot be read: {e}"));
    let folder = folder.canonicalize().map_err(cannot)?;
    let own = path.canonicalize().map_err(cannot)?;
    let mut files = Files { folder, seen: HashSet::from([own]), elements: 0 };
    files.insert(&mut root, 0)?;
    Ok(root)
}

struct Files {
    /// The folder of the model. Paths of includes begin here.
    folder: PathBuf,
    seen: HashSet<PathBuf>,
    elements: usize,
}

impl Files {
    /// Replaces the includes below an element. A file can be included once, so that there are no
    /// loops.
    fn insert(&mut self, element: &mut Element, depth: usize) -> Result<(), FileError> {
        self.elements += 1;
        if depth > xml::DEPTH || self.elements > xml::ELEMENTS {
            return Err(element.error("is too large, with its includes; leave parts out"));
        }
        let mut children = Vec::with_capacity(element.children.len());
        for mut child in std::mem::take(&mut element.children) {
            if child.name == "include" {
                let mut document = self.document(&child)?;
                self.insert(&mut document, depth)?;
                children.append(&mut document.children);
            } else {
                self.insert(&mut child, depth + 1)?;
                children.push(child);
            }
        }
        element.children = children;
        Ok(())
    }

    fn document(&mut self, include: &Element) -> Result<Element, FileError> {
        if let Some((name, _)) = include.attributes.iter().find(|(name, _)| name != "file") {
            let what = format!("`{}` is not supported; only `file` is", shorten(name));
            return Err(include.error(what));
        }
        let Some(name) = include.get("file") else {
            return Err(include.error("has no file; add `file`"));
        };
        let path = self.resolve(include, name)?;
        if !self.seen.insert(path.clone()) {
            return Err(include.error("includes a file again; a file can be included once"));
        }
        if self.seen.len() > FILES {
            return Err(include.error(format!("the model has more than {FILES} files")));
        }
        let text =
            xml::text(&path, name).map_err(|e| include.error(format!("the file {}", e.what)))?;
        let document = xml::parse(&text, name)?;
        if document.children.is_empty() {
            return Err(include.error("the file has no elements; remove the include"));
        }
        Ok(document)
    }

    /// The path of a file, which must lie in the folder of the model.
    fn resolve(&self, include: &Element, name: &str) -> Result<PathBuf, FileError> {
        let outside = || {
            include
                .error("leaves the folder of the model; put the file there, and use its path there")
        };
        let mut depth = 0;
        for component in Path::new(name).components() {
            match component {
                Component::Normal(_) => depth += 1,
                Component::CurDir => {}
                Component::ParentDir if depth > 0 => depth -= 1,
                _ => return Err(outside()),
            }
        }
        let path = self.folder.join(name);
        let path = path
            .canonicalize()
            .map_err(|e| include.error(format!("the file cannot be read: {e}")))?;
        // Links can lead elsewhere.
        if path.starts_with(&self.folder) { Ok(path) } else { Err(outside()) }
    }
}
