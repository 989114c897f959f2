//! Default classes: attributes of elements that name a class or lie below one.

use super::known;
use super::view::View;
use crate::files::FileError;
use crate::xml::{Element, hint, shorten};
use std::collections::{HashMap, HashSet};

/// Kinds of elements that have defaults without physics that is read here.
const IRRELEVANT: [&str; 8] =
    ["mesh", "texture", "camera", "light", "pair", "equality", "skin", "hfield"];
const READ: [&str; 5] = ["joint", "geom", "site", "material", "tendon"];

/// Largest depth of nested classes. Reading an attribute passes through all of them.
const DEPTH: usize = 20;

/// All classes. The first is `main`, for elements that name none.
pub(crate) struct Classes<'a> {
    classes: Vec<Class<'a>>,
    by_name: HashMap<&'a str, usize>,
}

struct Class<'a> {
    parent: Option<usize>,
    elements: Vec<&'a Element>,
}

impl<'a> Classes<'a> {
    /// The classes of the `default` sections of a file.
    pub fn new(sections: impl Iterator<Item = &'a Element>) -> Result<Self, FileError> {
        let main = Class { parent: None, elements: Vec::new() };
        let mut classes = Self { classes: vec![main], by_name: HashMap::from([("main", 0)]) };
        for section in sections {
            if section.get("class").is_some_and(|name| name != "main") {
                return Err(section.error("the outermost class must be `main`; remove its name"));
            }
            classes.fill(0, section, 0)?;
        }
        Ok(classes)
    }

    /// Reads the elements of a class.
    fn fill(&mut self, class: usize, section: &'a Element, depth: usize) -> Result<(), FileError> {
        if depth > DEPTH {
            return Err(section.error(format!("classes are nested deeper than {DEPTH}; flatten")));
        }
        let mut seen = HashSet::new();
        for child in &section.children {
            if child.name == "default" {
                let name = match child.get("class") {
                    Some(name) if !name.is_empty() => name,
                    _ => return Err(child.error("a class needs a name; add `class`")),
                };
                let index = self.classes.len();
                if self.by_name.insert(name, index).is_some() {
                    return Err(child.error("a class of this name exists; rename one of them"));
                }
                self.classes.push(Class { parent: Some(class), elements: Vec::new() });
                self.fill(index, child, depth + 1)?;
            } else {
                check(child)?;
                if !seen.insert(&child.name) {
                    return Err(
                        child.error("the class has another element of this kind; merge them")
                    );
                }
                self.classes[class].elements.push(child);
            }
        }
        Ok(())
    }

    /// The class that an attribute of an element names, or the class that it inherits.
    pub fn named(
        &self,
        element: &'a Element,
        attribute: &str,
        inherited: usize,
    ) -> Result<usize, FileError> {
        let Some(name) = element.get(attribute) else { return Ok(inherited) };
        self.by_name.get(name).copied().ok_or_else(|| {
            let hint = hint(name, self.by_name.keys().copied());
            element.error(format!("unknown class `{}`; {hint}", shorten(name)))
        })
    }

    /// The element with the defaults of its class, or of the class that it inherits, for elements
    /// of these names.
    pub fn view(
        &self,
        element: &'a Element,
        inherited: usize,
        names: &[&str],
    ) -> Result<View<'a>, FileError> {
        Ok(View::new(self.groups(element, inherited, names)?.concat()))
    }

    /// The elements of these names of each class, the outermost class first, and the element
    /// itself.
    pub fn groups(
        &self,
        element: &'a Element,
        inherited: usize,
        names: &[&str],
    ) -> Result<Vec<Vec<&'a Element>>, FileError> {
        let mut groups = vec![vec![element]];
        let mut next = Some(self.named(element, "class", inherited)?);
        while let Some(class) = next {
            let elements = self.classes[class].elements.iter().copied();
            groups.push(elements.filter(|e| names.contains(&e.name.as_str())).collect());
            next = self.classes[class].parent;
        }
        groups.reverse();
        Ok(groups)
    }
}

/// Refuses unknown elements and attributes of a class.
fn check(element: &Element) -> Result<(), FileError> {
    let name = element.name.as_str();
    match name {
        "joint" => known::JOINT.check(element),
        "geom" => known::GEOM.check(element),
        "site" => known::SITE.check(element),
        "general" => known::GENERAL.check(element),
        "motor" => known::MOTOR.check(element),
        "position" => known::POSITION.check(element),
        "velocity" => known::VELOCITY.check(element),
        _ if READ.contains(&name) || IRRELEVANT.contains(&name) => Ok(()),
        _ if known::OTHER_ACTUATORS.contains(&name) => Ok(()),
        _ => {
            let all = READ.into_iter().chain(IRRELEVANT).chain(known::ACTUATORS);
            let hint = hint(name, all);
            Err(element.error(format!("unknown element in a class; {hint}")))
        }
    }
}
