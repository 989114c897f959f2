//! The tree of bodies with their joints, geoms and sites.

use super::classes::Classes;
use super::geom::{Colours, Geom, geom};
use super::joint::joint;
use super::known;
use super::settings::{Compiler, FromGeoms};
use super::view::{Known, View};
use crate::files::FileError;
use crate::mass::{Part, flat, matrix, together, turned};
use crate::model::{Body, Joint, JointKind, Shape, Site};
use crate::rotation::{IDENTITY, Pose};
use crate::xml::{Element, hint};
use std::collections::HashMap;

/// The tree, as far as it is read.
pub(crate) struct Tree<'a> {
    pub classes: &'a Classes<'a>,
    pub compiler: &'a Compiler,
    pub colours: &'a Colours<'a>,
    pub bodies: Vec<Body>,
    /// Element of each body, for errors.
    pub elements: Vec<&'a Element>,
    /// Whether each body is fixed in the world.
    pub fixed: Vec<bool>,
    pub joints: Vec<Joint>,
    pub shapes: Vec<Shape>,
    pub sites: Vec<Site>,
    pub cameras: usize,
    pub lights: usize,
    /// Labels of meshes that are left out.
    pub drawn: Vec<FileError>,
    names: HashMap<(&'static str, &'a str), u32>,
}

/// What a body or a frame has, in the order of the file, with class and frame.
#[derive(Default)]
struct Contents<'a> {
    joints: Vec<Item<'a>>,
    geoms: Vec<Item<'a>>,
    sites: Vec<Item<'a>>,
    bodies: Vec<Item<'a>>,
    inertial: Option<Item<'a>>,
}

type Item<'a> = (&'a Element, usize, Pose);

impl<'a> Tree<'a> {
    pub fn new(classes: &'a Classes<'a>, compiler: &'a Compiler, colours: &'a Colours<'a>) -> Self {
        Self {
            classes,
            compiler,
            colours,
            bodies: Vec::new(),
            elements: Vec::new(),
            fixed: Vec::new(),
            joints: Vec::new(),
            shapes: Vec::new(),
            sites: Vec::new(),
            cameras: 0,
            lights: 0,
            drawn: Vec::new(),
            names: HashMap::new(),
        }
    }

    /// Reads the world from all sections `worldbody`.
    pub fn world(&mut self, root: &'a Element) -> Result<(), FileError> {
        self.claim("body", "world", root)?;
        self.push("world", 0, &Pose::IDENTITY, root, true);
        let mut contents = Contents::default();
        for section in root.children.iter().filter(|c| c.name == "worldbody") {
            if !section.attributes.is_empty() {
                return Err(section.error("the world has no attributes; remove them"));
            }
            self.collect(section, 0, &Pose::IDENTITY, &mut contents)?;
        }
        let first = contents.joints.first().or(contents.inertial.as_ref());
        if let Some((element, ..)) = first {
            return Err(element.error("the world does not move; put this into a body"));
        }
        self.fill(0, contents)
    }

    fn push(
        &mut self,
        name: &str,
        parent: usize,
        pose: &Pose,
        element: &'a Element,
        fixed: bool,
    ) -> usize {
        self.bodies.push(Body::new(name, parent, pose.position, pose.rotation));
        self.elements.push(element);
        self.fixed.push(fixed);
        self.bodies.len() - 1
    }

    /// Sorts the children of a body or frame by kind. The depth of documents has a bound.
    fn collect(
        &mut self,
        element: &'a Element,
        class: usize,
        frame: &Pose,
        contents: &mut Contents<'a>,
    ) -> Result<(), FileError> {
        for child in &element.children {
            let item = (child, class, *frame);
            match child.name.as_str() {
                "joint" | "freejoint" => contents.joints.push(item),
                "geom" => contents.geoms.push(item),
                "site" => contents.sites.push(item),
                "body" => contents.bodies.push(item),
                "camera" => self.cameras += 1,
                "light" => self.lights += 1,
                "inertial" if contents.inertial.is_some() => {
                    return Err(child.error("the body has another `inertial`; remove one"));
                }
                "inertial" => contents.inertial = Some(item),
                "frame" => {
                    let (class, own) = self.place(child, class, &known::FRAME)?;
                    self.collect(child, class, &frame.then(&own), contents)?;
                }
                other => return Err(child.error(refusal(other))),
            }
        }
        Ok(())
    }

    /// Class and pose of a body or frame.
    fn place(
        &self,
        element: &'a Element,
        class: usize,
        known: &Known,
    ) -> Result<(usize, Pose), FileError> {
        let view = View::new(vec![element]);
        view.check(known)?;
        let class = self.classes.named(element, "childclass", class)?;
        Ok((class, view.pose(self.compiler.angles)?))
    }

    /// Reads what belongs to a body, then its children.
    fn fill(&mut self, body: usize, contents: Contents<'a>) -> Result<(), FileError> {
        self.joints(body, &contents)?;
        self.sites(body, &contents)?;
        let parts = self.shapes(body, &contents)?;
        self.weigh(body, &contents, &parts)?;
        for (element, class, frame) in contents.bodies {
            let (class, own) = self.place(element, class, &known::BODY)?;
            let name = self.name("body", element)?;
            let index = self.push(name, body, &frame.then(&own), element, self.fixed[body]);
            let mut inner = Contents::default();
            self.collect(element, class, &Pose::IDENTITY, &mut inner)?;
            self.fill(index, inner)?;
        }
        Ok(())
    }

    /// The name of an element, which no other element of the kind may have; empty without one.
    fn name(&mut self, kind: &'static str, element: &'a Element) -> Result<&'a str, FileError> {
        let name = element.get("name").unwrap_or("");
        if !name.is_empty() {
            self.claim(kind, name, element)?;
        }
        Ok(name)
    }

    fn claim(
        &mut self,
        kind: &'static str,
        name: &'a str,
        element: &Element,
    ) -> Result<(), FileError> {
        match self.names.insert((kind, name), element.line) {
            None => Ok(()),
            Some(line) => Err(element
                .error(format!("the {kind} in line {line} has the same name; rename one of them"))),
        }
    }

    fn joints(&mut self, body: usize, contents: &Contents<'a>) -> Result<(), FileError> {
        let first = self.joints.len();
        for (element, class, frame) in &contents.joints {
            let view = self.classes.view(element, *class, &["joint"])?;
            let view = if element.name == "freejoint" { View::new(vec![element]) } else { view };
            let joint = joint(&view, self.compiler, body, frame)?;
            self.name("joint", element)?;
            self.permit(&joint, first, element)?;
            self.joints.push(joint);
            self.fixed[body] = false;
        }
        Ok(())
    }

    /// Refuses combinations of joints of one body that have no coordinates.
    fn permit(&self, joint: &Joint, first: usize, element: &Element) -> Result<(), FileError> {
        let before = &self.joints[first..];
        let has = |kind| before.iter().any(|j| j.kind == kind);
        let free = joint.kind == JointKind::Free;
        if free && self.bodies[joint.body].parent != 0 {
            return Err(element.error("a free joint must belong to a child of the world"));
        }
        if (free && !before.is_empty()) || has(JointKind::Free) {
            return Err(element.error("a body with a free joint has no other joint; remove one"));
        }
        let turns = matches!(joint.kind, JointKind::Hinge | JointKind::Ball);
        if turns && has(JointKind::Ball) {
            return Err(element.error("a ball joint already turns the body; remove one joint"));
        }
        let degrees: usize = before.iter().chain([joint]).map(|j| freedom(j.kind)).sum();
        if degrees > 6 {
            return Err(element.error("the joints of the body have more than 6 degrees of freedom"));
        }
        Ok(())
    }

    fn sites(&mut self, body: usize, contents: &Contents<'a>) -> Result<(), FileError> {
        for (element, class, frame) in &contents.sites {
            let view = self.classes.view(element, *class, &["site"])?;
            view.check(&known::SITE)?;
            let own = view.pose(self.compiler.angles)?;
            let position = match view.exact::<6>("fromto")? {
                Some(ends) => [0, 1, 2].map(|i| 0.5 * (ends[i] + ends[i + 3])),
                None => own.position,
            };
            let name = self.name("site", element)?.to_string();
            self.sites.push(Site { name, body, position: frame.point(position) });
        }
        Ok(())
    }

    /// Reads the shapes and returns the masses that give the body its mass.
    fn shapes(&mut self, body: usize, contents: &Contents<'a>) -> Result<Vec<Part>, FileError> {
        let weighs = body > 0
            && match self.compiler.from_geoms {
                FromGeoms::Never => false,
                FromGeoms::Always => true,
                FromGeoms::Auto => contents.inertial.is_none(),
            };
        let mut parts = Vec::new();
        for (element, class, frame) in &contents.geoms {
            if let Some(child) = element.children.first() {
                return Err(child.error("plugins are not supported; remove the geom"));
            }
            let view = self.classes.view(element, *class, &["geom"])?;
            self.name("geom", element)?;
            match geom(&view, self.compiler, self.colours, frame, weighs)? {
                Geom::Drawn => self.drawn.push(element.error("")),
                Geom::Shape(mut shape, part) => {
                    if shape.form == crate::model::Form::Plane && !self.fixed[body] {
                        return Err(element.error("planes cannot move; use a box"));
                    }
                    shape.body = body;
                    self.shapes.push(*shape);
                    parts.extend(part);
                }
            }
        }
        Ok(parts)
    }

    /// Sets the mass of a body from its parts or its `inertial`.
    fn weigh(
        &mut self,
        body: usize,
        contents: &Contents<'a>,
        parts: &[Part],
    ) -> Result<(), FileError> {
        let part = match (&contents.inertial, parts) {
            (Some(item), []) => inertial(item, self.compiler)?,
            _ => together(parts),
        };
        let own = &mut self.bodies[body];
        (own.mass, own.centre, own.inertia) = (part.mass, part.centre, flat(&part.inertia));
        own.axes = part.axes;
        Ok(())
    }
}

fn refusal(name: &str) -> String {
    match name {
        "replicate" => "is not supported; write the copies out".into(),
        "attach" => "is not supported; write the model out".into(),
        "flexcomp" | "composite" => "deformable bodies are not supported; remove it".into(),
        "plugin" => "plugins are not supported; remove it".into(),
        "include" => "includes need a file; read the model from its file".into(),
        _ => {
            const KNOWN: [&str; 9] = [
                "body",
                "joint",
                "freejoint",
                "geom",
                "site",
                "inertial",
                "frame",
                "camera",
                "light",
            ];
            format!("unknown element; {}", hint(name, KNOWN))
        }
    }
}

/// Degrees of freedom of a joint.
pub(crate) fn freedom(kind: JointKind) -> usize {
    match kind {
        JointKind::Slide | JointKind::Hinge => 1,
        JointKind::Ball => 3,
        JointKind::Free => 6,
    }
}

/// The mass that an `inertial` gives.
fn inertial(item: &Item, compiler: &Compiler) -> Result<Part, FileError> {
    let (element, _, frame) = item;
    let view = View::new(vec![element]);
    view.check(&known::INERTIAL)?;
    if view.text("pos").is_none() || view.text("mass").is_none() {
        return Err(view.error("needs `pos` and `mass`; add them"));
    }
    let turn = view.rotation(compiler.angles)?;
    let diagonal = view.exact::<3>("diaginertia")?;
    let full = view.exact::<6>("fullinertia")?;
    if full.is_some() && (diagonal.is_some() || turn.is_some()) {
        return Err(view.error("`fullinertia` excludes `diaginertia` and rotations; remove one"));
    }
    let pose = Pose {
        position: view.exact("pos")?.unwrap_or([0.0; 3]),
        rotation: turn.unwrap_or(IDENTITY),
    };
    let inertia = match full {
        Some(full) => matrix(full),
        None => turned(diagonal.unwrap_or([0.0; 3]), &IDENTITY),
    };
    let axes = full.is_none().then_some(IDENTITY);
    let own = Part { mass: view.natural("mass", 0.0)?, centre: [0.0; 3], inertia, axes };
    Ok(own.placed(&frame.then(&pose)))
}
