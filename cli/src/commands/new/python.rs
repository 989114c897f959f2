//! `physgrad new --python`: what a crate needs to build the Python package with its task.

use super::{dependency, type_name};
use anyhow::{Context, Result};
use std::fs;
use std::path::Path;

/// Divides the crate into the task, the program and the extension module of Python, and adds the
/// description of the Python package.
pub fn add(name: &str, sources: &Path, files: &mut Vec<(&str, String)>) -> Result<()> {
    let type_name = type_name(name);
    for (file, text) in &mut *files {
        match *file {
            "Cargo.toml" => {
                let package = dependency(Some(sources), "python")?;
                let package = package.trim_end_matches(" }");
                let package = format!("{package}, default-features = false, optional = true }}");
                let own = MANIFEST.replace("NAME", name).replace("SOURCES", &package);
                *text = text.replacen("[dependencies]\n", &own, 1);
            }
            "src/main.rs" => {
                let task = text
                    .replace(
                        &format!("struct {type_name} {{"),
                        &format!("pub struct {type_name} {{"),
                    )
                    .replace("use std::process::ExitCode;\n", "");
                let main = task.find("\nfn main()").context("the example has a program")?;
                let after = task[main..].find("\n}\n").context("the program ends")? + main + 3;
                let parts = [&task[..main], &task[after..]].concat();
                *file = "src/task.rs";
                *text = parts;
            }
            _ => {}
        }
    }
    let program = format!("physgrad_cli::program().task::<task::{type_name}>()");
    files.extend([
        ("src/main.rs", MAIN.replace("NAME", name).replace("PROGRAM", &program)),
        ("src/lib.rs", MODULE.replace("NAME", name).replace("PROGRAM", &program)),
        ("pyproject.toml", PYPROJECT.replace("NAME", name)),
    ]);
    Ok(())
}

/// Files of the Python package in this folder, with their places in a new crate.
pub fn package(folder: &Path) -> Result<Vec<(String, String)>> {
    let read = || -> std::io::Result<Vec<(String, String)>> {
        let mut files = Vec::new();
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if [".py", ".pyi", ".typed"].iter().any(|end| name.ends_with(end)) {
                files.push((format!("python/physgrad/{name}"), fs::read_to_string(path)?));
            }
        }
        Ok(files)
    };
    read().with_context(|| format!("cannot read the Python package in {}", folder.display()))
}

const MANIFEST: &str = r#"# The extension module of the Python package.
[lib]
name = "NAME_python"
path = "src/lib.rs"
crate-type = ["cdylib"]
test = false
doc = false

[features]
python = ["dep:physgrad-python"]

[dependencies]
physgrad-python = SOURCES
"#;

const MAIN: &str = "//! The program with the task `NAME`: `cargo run --release -- train NAME`.

mod task;

fn main() -> std::process::ExitCode {
    PROGRAM.main()
}
";

const MODULE: &str =
    "//! The Python package `physgrad` with the task `NAME`, which `pip install .` builds.
#![cfg(feature = \"python\")]

mod task;

physgrad_python::module!(PROGRAM);
";

const PYPROJECT: &str = r#"# Replaces an installed package `physgrad` by one that also has the task `NAME`.
[build-system]
requires = ["maturin>=1.9,<2"]
build-backend = "maturin"

[project]
name = "physgrad"
requires-python = ">=3.10"
dependencies = ["numpy>=1.23"]
dynamic = ["version"]

[tool.maturin]
features = ["python"]
# A copy of the Python files of physgrad.
python-source = "python"
python-packages = ["physgrad"]
module-name = "physgrad._core"
"#;
