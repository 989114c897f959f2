//! `physgrad new`: a crate with a task of the user, also for Python, or a scene with equations.

mod python;

use crate::platform::files;
use crate::platform::terminal::print_result;
use crate::scenes::presets;
use crate::tasks;
use anyhow::{Context, Result, bail};
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Source of the task that a new crate starts from.
const EXAMPLE: &str = include_str!("../../examples/own_program.rs");
/// Type of the task in [`EXAMPLE`], which a new crate renames.
const EXAMPLE_TYPE: &str = "BallBeam";
/// Quoted name of the task in [`EXAMPLE`], which a new crate renames.
const EXAMPLE_TASK: &str = "\"ball_beam\"";

/// Names that a new crate must not have, with the reason.
const RESERVED: [(&str, &str); 3] = [
    (
        "abstract as async await become box break const continue crate do dyn else enum extern false final fn for gen if impl \
         in let loop macro match mod move mut override priv pub ref return self static struct super trait true try type \
         typeof unsafe unsized use virtual where while yield",
        "is a keyword of Rust",
    ),
    (
        "alloc build core deps examples incremental proc_macro std test",
        "is a crate of Rust or a folder of Cargo",
    ),
    ("physgrad rand schemars serde", "is a dependency of the new crate"),
];

/// Write a template of a task of your own: a crate, or a scene with equations.
///
/// A crate has a commented system in Rust, a scene and a gradient check. A scene with equations
/// needs no compiler.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad new swing_boat\n  physgrad new --python swing_boat\n  physgrad new --scene swing_boat"
)]
pub struct New {
    /// Name of the task and of its folder or scene: lower case letters, digits and underscores
    pub name: String,
    /// Write the scene NAME.toml with commented equations instead of a crate
    #[arg(long, conflicts_with_all = ["path", "python"])]
    pub scene: bool,
    /// Write a crate that also builds the Python package `physgrad` with its task
    #[arg(long)]
    pub python: bool,
    /// Folder of the physgrad sources [default: this program's, otherwise the published version]
    #[arg(long, value_name = "DIR")]
    pub path: Option<PathBuf>,
}

/// Runs the command.
pub fn new(args: &New) -> Result<()> {
    let name = &args.name;
    let valid = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if !name.starts_with(|c: char| c.is_ascii_lowercase()) || !name.chars().all(valid) {
        bail!(
            "`{name}` cannot be the name of a task; allowed: lower case letters, digits and underscores, a letter first"
        );
    }
    if args.scene {
        return scene(name);
    }
    if let Some((_, reason)) =
        RESERVED.iter().find(|(names, _)| names.split_whitespace().any(|reserved| reserved == name))
    {
        bail!(
            "`{name}` cannot be the name of a task: it {reason}. Choose another name, for instance `{name}_task`"
        );
    }
    let type_name = type_name(name);
    if uses(EXAMPLE, &type_name) || uses(TEST, &type_name) {
        bail!(
            "`{name}` cannot be the name of a task: its type would be `{type_name}`, which the new crate already uses. Choose \
             another name, for instance `{name}_task`"
        );
    }
    if tasks::all().iter().any(|task| task.name() == name) {
        bail!("`{name}` is a built-in task; choose another name");
    }
    if fs::symlink_metadata(name).is_ok() {
        bail!("cannot create the folder {name}: it exists; choose another name");
    }
    let sources = sources(args.path.as_deref());
    let mut package = Vec::new();
    let mut files = vec![
        ("Cargo.toml", manifest(name, sources)?),
        ("src/main.rs", source(name)),
        ("scene.toml", SCENE.replace("NAME", name)),
        (".gitignore", "/target\n/runs\n".into()),
    ];
    if args.python {
        let sources = sources.context(
            "a Python package needs the sources of physgrad; give their folder by --path DIR",
        )?;
        python::add(name, sources, &mut files)?;
        package = python::package(&sources.join("python/physgrad"))?;
    }
    files.extend(package.iter().map(|(file, text)| (&**file, text.clone())));
    files::create_tree(Path::new(name), &files)
        .with_context(|| format!("cannot write the folder {name}"))?;
    let equations = if args.python { "src/task.rs" } else { "src/main.rs" };
    let python = match args.python {
        true => {
            "\npip install .                                   # physgrad with this task, for Python"
        }
        false => "",
    };
    print_result(&format!(
        "created {name}: Cargo.toml, {equations}, scene.toml. Replace the equations in {equations} with your own. Then:\n\n\
         cd {name}\n\
         cargo test --release                            # gradient check\n\
         cargo run --release -- train scene.toml         # training\n\
         cargo run --release -- --help                   # all commands{python}"
    ))
}

/// Folder of the sources of physgrad: the given one, or that of this program, if it still exists.
fn sources(path: Option<&Path>) -> Option<&Path> {
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).parent();
    path.or(own.filter(|sources| sources.join("cli/Cargo.toml").exists()))
}

/// Writes a scene with equations.
fn scene(name: &str) -> Result<()> {
    let file = format!("{name}.toml");
    let text = presets::text("equations")?;
    // The first lines are about the preset.
    let body = text.split_once("\n\n").map_or(&*text, |(_, body)| body);
    let text = SCENE_HEADER.replace("NAME", name) + body;
    // Overwrites nothing.
    let written = fs::File::create_new(&file).and_then(|mut new| new.write_all(text.as_bytes()));
    written.with_context(|| format!("cannot create {file}; choose another name"))?;
    print_result(&format!(
        "created {file}: two tanks in a row. Replace their names, numbers and equations with your own. Then:\n\n\
         physgrad check {file}      # equations, derivatives, time step\n\
         physgrad train {file}      # training; results in runs/{name}"
    ))
}

const SCENE_HEADER: &str = "# NAME: equations of a system of your own, for now two tanks in a row.
# `physgrad check NAME.toml` reads them, `physgrad train NAME.toml` trains a policy, and docs/equations.md
# lists functions and operators.

";

fn manifest(name: &str, sources: Option<&Path>) -> Result<String> {
    let mut text = MANIFEST.replace("NAME", name);
    for (key, folder) in [("PHYSGRAD_CLI", "cli"), ("PHYSGRAD_PLOT", "plot"), ("PHYSGRAD", "")] {
        text = text.replace(key, &dependency(sources, folder)?);
    }
    Ok(text)
}

/// A package of these sources, otherwise of this version, as a dependency.
fn dependency(sources: Option<&Path>, folder: &str) -> Result<String> {
    let Some(sources) = sources else { return Ok(format!("{:?}", env!("CARGO_PKG_VERSION"))) };
    Ok(format!("{{ path = {} }}", toml::Value::from(utf8(&sources.join(folder))?)))
}

/// The absolute path as text.
fn utf8(path: &Path) -> Result<String> {
    let absolute = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let text = absolute.to_str().map(str::to_owned);
    text.with_context(|| format!("--path {}: it is not UTF-8 text", path.display()))
}

const MANIFEST: &str = r#"[package]
name = "NAME"
version = "0.1.0"
edition = "2024"

[dependencies]
physgrad = PHYSGRAD
physgrad-cli = PHYSGRAD_CLI
physgrad-plot = PHYSGRAD_PLOT
schemars = "1"
serde = { version = "1", features = ["derive"] }

# Rollouts need optimization, also in debug builds.
[profile.dev]
opt-level = 1
[profile.dev.package.physgrad]
opt-level = 3

# Of the packages of physgrad, only the library needs optimization.
[profile.release.package]
physgrad = { codegen-units = 8 }
physgrad-cli = { opt-level = 1 }
physgrad-plot = { opt-level = 1 }
kuva = { opt-level = 0 }
clap_builder = { opt-level = 0 }
"#;

/// Type of the task `name`: `SwingBoat` for `swing_boat`.
fn type_name(name: &str) -> String {
    let words = name.split('_').filter(|word| !word.is_empty());
    words.map(|word| word[..1].to_uppercase() + &word[1..]).collect()
}

/// Returns whether a source uses `type_name` for an item other than its task. Ignores lines that
/// contain only a comment.
fn uses(source: &str, type_name: &str) -> bool {
    let code = source.lines().filter(|line| !line.trim_start().starts_with("//"));
    let mut words = code.flat_map(|line| line.split(|c: char| !c.is_alphanumeric() && c != '_'));
    type_name != EXAMPLE_TYPE && words.any(|word| word == type_name)
}

/// Source of the new crate: the renamed example, and a test of its gradients.
fn source(name: &str) -> String {
    let type_name = type_name(name);
    // Omits the header, which contains the command of the example.
    let body = EXAMPLE.split_once("\n\n").map_or(EXAMPLE, |(_, body)| body);
    let body = body.replace(EXAMPLE_TYPE, &type_name).replace(EXAMPLE_TASK, &format!("{name:?}"));
    HEADER.replace("NAME", name) + &body + &TEST.replace("TYPE", &type_name)
}

const HEADER: &str = "//! The task `NAME`, for now a ball on a beam.
//!
//! `cargo run --release -- train NAME` trains a policy; `--help` lists all commands.

";

const TEST: &str = "
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_are_exact() {
        let task = TYPE::default();
        let observations = task.observation_dim().unwrap_or(task.state_dim());
        // Also checks the step and the costs, in states of rollouts.
        check::task(&task, &Mlp::new([observations, 16, task.control_dim()])).unwrap();
    }
}
";

const SCENE: &str = r#"# Settings that differ from the defaults; `cargo run --release -- tasks NAME` lists all.
scene = 1
task = "NAME"
field = "regular"

[policy]
widths = [32, 32]
"#;
