//! `physgrad new`: a crate with a task of the user.

use crate::program::platform::terminal::say;
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};

/// The task of `examples/own_program.rs`, renamed in new crates.
const EXAMPLE: &str = include_str!("../../../examples/own_program.rs");
const TYPE: &str = "Quadrotor";
const TASK: &str = "quadrotor";

/// Write a crate with a task of your own: a commented system, a scene and a gradient check.
#[derive(Debug, clap::Args)]
pub struct New {
    /// Name of the task and of its folder: lower case letters, digits and underscores
    pub name: String,
    /// Folder of the physgrad sources [default: those of this program, otherwise the published version]
    #[arg(long, value_name = "DIR")]
    pub path: Option<PathBuf>,
}

/// Runs the command.
pub fn new(args: &New) -> Result<()> {
    let name = &args.name;
    let valid = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if !name.starts_with(|c: char| c.is_ascii_lowercase()) || !name.chars().all(valid) {
        bail!("`{name}` is no name of a task; allowed: lower case letters, digits and underscores, a letter first");
    }
    if crate::program::tasks::all().iter().any(|task| task.name() == name) {
        bail!("`{name}` is a built-in task; choose another name");
    }
    let folder = Path::new(name);
    fs::create_dir(folder).with_context(|| format!("cannot create the folder {name}"))?;
    let files = [
        ("Cargo.toml", manifest(name, args.path.as_deref())),
        ("src/main.rs", source(name)),
        ("scene.toml", scene(name)),
        (".gitignore", "/target\n/runs\n".into()),
    ];
    fs::create_dir(folder.join("src"))?;
    for (file, text) in files {
        let path = folder.join(file);
        fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    say(&format!(
        "created {name}: Cargo.toml, src/main.rs, scene.toml. Replace the equations in src/main.rs by yours. Then:\n\n\
         cd {name}\n\
         cargo test --release                            # gradient check\n\
         cargo run --release -- train scene.toml         # training\n\
         cargo run --release -- --help                   # all commands"
    ))
}

fn manifest(name: &str, path: Option<&Path>) -> String {
    let sources = Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = path.or_else(|| sources.join("Cargo.toml").exists().then_some(sources));
    let physgrad = match path {
        Some(path) => format!("{{ path = {:?} }}", path.canonicalize().unwrap_or(path.into())),
        None => format!("{:?}", env!("CARGO_PKG_VERSION")),
    };
    format!(
        "[package]\nname = {name:?}\nversion = \"0.1.0\"\nedition = \"2024\"\n\n[dependencies]\nphysgrad = {physgrad}\n\
         schemars = \"1\"\nserde = {{ version = \"1\", features = [\"derive\"] }}\n\n\
         # Rollouts need optimization, also in debug builds.\n[profile.dev]\nopt-level = 1\n\
         [profile.dev.package.physgrad]\nopt-level = 3\n"
    )
}

/// The example with the name of the task, and a test of its gradients.
fn source(name: &str) -> String {
    let words = name.split('_').filter(|word| !word.is_empty());
    let type_name: String = words.map(|word| word[..1].to_uppercase() + &word[1..]).collect();
    // The header names the command of the example.
    let body = EXAMPLE.split_once("\n\n").map_or(EXAMPLE, |(_, body)| body);
    let body = body.replace(TYPE, &type_name).replace(&format!("\"{TASK}\""), &format!("{name:?}"));
    format!(
        "//! The task `{name}`, for now a planar quadrotor that flies to the origin and hovers.\n//!\n\
         //! `cargo run --release -- train {name}` trains a policy; `--help` lists all commands.\n\n{body}\n\
         #[cfg(test)]\nmod tests {{\n    use super::*;\n\n    #[test]\n    fn gradients_are_exact() {{\n        \
         let task = {type_name}::default();\n        check::system(task.system());\n        \
         check::task(&task, &Mlp::new([task.observation_dim().unwrap_or(task.state_dim()), 16, task.control_dim()]));\n    \
         }}\n}}\n"
    )
}

fn scene(name: &str) -> String {
    format!(
        "# Settings that differ from the defaults; `cargo run --release -- tasks` lists all.\nscene = 1\ntask = {name:?}\n\
         field = \"regular\"\n\n[policy]\nwidths = [32, 32]\n"
    )
}
