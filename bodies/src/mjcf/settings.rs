//! The sections `compiler` and `option`.

use super::known;
use super::view::{Angles, View};
use crate::files::FileError;
use crate::model::{Cone, Integrator, Options};
use crate::xml::{Element, shorten};

/// Whether inertia comes from geoms.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum FromGeoms {
    Never,
    Always,
    /// If the body has no `inertial`.
    Auto,
}

/// Settings of the compiler.
pub(crate) struct Compiler {
    pub angles: Angles,
    pub auto_limits: bool,
    pub from_geoms: FromGeoms,
    /// Smallest and largest group of the geoms that have mass.
    pub groups: [f64; 2],
    pub total_mass: Option<f64>,
    pub least_mass: f64,
    pub least_inertia: f64,
    pub balance: bool,
}

/// Reads all sections `compiler`; the last setting holds.
pub(crate) fn compiler(root: &Element) -> Result<Compiler, FileError> {
    let sections = sections(root, &root.children, "compiler", &["lengthrange"])?;
    let view = View::new(sections);
    if view.layers().len() > 1 {
        view.layers()[1..].iter().try_for_each(|e| View::new(vec![e]).check(&known::COMPILER))?;
    }
    let degrees = view.word("angle", &["degree", "radian"], 0)? == 0;
    Ok(Compiler {
        angles: Angles {
            unit: if degrees { std::f64::consts::PI / 180.0 } else { 1.0 },
            sequence: sequence(&view)?,
        },
        auto_limits: view.flag("autolimits", true)?,
        from_geoms: match view.word("inertiafromgeom", &["false", "true", "auto"], 2)? {
            0 => FromGeoms::Never,
            1 => FromGeoms::Always,
            _ => FromGeoms::Auto,
        },
        groups: view.exact("inertiagrouprange")?.unwrap_or([0.0, 5.0]),
        total_mass: Some(view.number("settotalmass", -1.0)?).filter(|m| *m > 0.0),
        least_mass: view.natural("boundmass", 0.0)?,
        least_inertia: view.natural("boundinertia", 0.0)?,
        balance: view.flag("balanceinertia", false)?,
    })
}

/// The root, as a layer without settings, and the sections of this name, without children but
/// these.
fn sections<'a>(
    root: &'a Element,
    children: &'a [Element],
    name: &str,
    known: &[&str],
) -> Result<Vec<&'a Element>, FileError> {
    let mut layers = vec![root];
    for section in children.iter().filter(|c| c.name == name) {
        if let Some(child) = section.children.iter().find(|c| !known.contains(&c.name.as_str())) {
            return Err(child.error(format!("unknown element in `{name}`; remove it")));
        }
        layers.push(section);
    }
    Ok(layers)
}

fn sequence(view: &View) -> Result<[u8; 3], FileError> {
    let Some(text) = view.text("eulerseq") else { return Ok(*b"xyz") };
    match text.as_bytes().try_into() {
        Ok(letters) if text.chars().all(|c| "xyzXYZ".contains(c)) => Ok(letters),
        _ => {
            let text = shorten(text);
            Err(view.error_at("eulerseq", format!("`eulerseq` is `{text}`; it can be like `xyz`")))
        }
    }
}

/// What the flags switch off beyond the options of the model.
pub(crate) struct Switches {
    pub friction_loss: bool,
    /// The flag that makes joint damping explicit, if any.
    pub explicit_damping: Option<FileError>,
    /// The flag that permits time constants shorter than two time steps, if any.
    pub short_times: Option<FileError>,
}

/// Reads all sections `option`; the last setting holds.
pub(crate) fn options(root: &Element) -> Result<(Options, Switches), FileError> {
    let layers = sections(root, &root.children, "option", &["flag"])?;
    for section in &layers[1..] {
        View::new(vec![section]).check(&known::OPTION)?;
    }
    let flags: Vec<&Element> = layers[1..].iter().flat_map(|s| &s.children).collect();
    let view = View::new(layers);
    let mut options = Options {
        dt: positive(&view, "timestep", 0.002)?,
        gravity: view.exact("gravity")?.unwrap_or([0.0, 0.0, -9.81]),
        integrator: integrator(&view)?,
        cone: [Cone::Pyramidal, Cone::Elliptic]
            [view.word("cone", &["pyramidal", "elliptic"], 0)?],
        impedance_ratio: positive(&view, "impratio", 1.0)?,
        density: view.natural("density", 0.0)?,
        viscosity: view.natural("viscosity", 0.0)?,
        wind: view.exact("wind")?.unwrap_or([0.0; 3]),
        ..Options::default()
    };
    let switches = switch(root, flags, &mut options)?;
    Ok((options, switches))
}

fn positive(view: &View, name: &str, default: f64) -> Result<f64, FileError> {
    let value = view.number(name, default)?;
    if value < 1e-12 {
        return Err(view.error_at(name, format!("`{name}` must be positive")));
    }
    Ok(value)
}

fn integrator(view: &View) -> Result<Integrator, FileError> {
    const WORDS: [&str; 5] = ["Euler", "implicitfast", "RK4", "implicit", "discrete"];
    match view.word("integrator", &WORDS, 0)? {
        0 => Ok(Integrator::Euler),
        1 => Ok(Integrator::ImplicitFast),
        2 => Ok(Integrator::Rk4),
        other => Err(view.error_at(
            "integrator",
            format!("the integrator `{}` is not supported; use implicitfast", WORDS[other]),
        )),
    }
}

/// Applies the flags to the options.
fn switch<'a>(
    root: &'a Element,
    flags: Vec<&'a Element>,
    options: &mut Options,
) -> Result<Switches, FileError> {
    for flag in &flags {
        View::new(vec![flag]).check(&known::FLAG)?;
    }
    let view = View::new(std::iter::once(root).chain(flags).collect());
    let on = |name: &str| Ok(view.word(name, &["disable", "enable"], 1)? == 1);
    let constraints = on("constraint")?;
    options.contacts = constraints && on("contact")?;
    options.limits = constraints && on("limit")?;
    if !on("gravity")? {
        options.gravity = [0.0; 3];
    }
    let damping = (!on("eulerdamp")?).then(|| {
        view.error_at(
            "eulerdamp",
            "explicit joint damping with Euler's method is not supported; remove `eulerdamp`",
        )
    });
    let short = (!on("refsafe")?).then(|| {
        view.error_at(
            "refsafe",
            "time constants below two time steps are not supported; remove `refsafe`",
        )
    });
    Ok(Switches {
        friction_loss: constraints && on("frictionloss")?,
        explicit_damping: damping.filter(|_| options.integrator == Integrator::Euler),
        short_times: short,
    })
}
