//! Library modules import only lower modules.

use std::fs;
use std::path::{Path, PathBuf};

/// Modules with their allowed imports. All imports stand above the module in this list.
const MODULES: [(&str, &[&str]); 8] = [
    ("numbers", &[]),
    ("report", &[]),
    ("dynamics", &["numbers"]),
    ("policy", &["numbers"]),
    ("tasks", &["numbers", "dynamics"]),
    ("engine", &["numbers", "dynamics", "policy"]),
    ("train", &["numbers", "dynamics", "policy", "engine"]),
    ("check", &["numbers", "dynamics", "policy", "engine", "train", "tasks"]),
];

fn files(folder: &Path) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let nested = paths.map(|path| if path.is_dir() { files(&path) } else { vec![path] });
    nested.flatten().filter(|path| path.extension().is_some_and(|extension| extension == "rs")).collect()
}

/// Returns the forbidden imports of a file of this module. Comments and unit tests may name
/// anything.
fn forbidden(module: &str, text: &str) -> Vec<String> {
    let (_, allowed) = MODULES.into_iter().find(|(name, _)| *name == module).expect("a module of the list");
    let lines = text.lines().take_while(|line| line.trim() != "#[cfg(test)]").filter(|line| !line.trim().starts_with("//"));
    let imports = lines.flat_map(|line| line.split("crate::").skip(1));
    let names = imports.map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default());
    names.filter(|name| *name != module && !allowed.contains(name)).map(String::from).collect()
}

#[test]
fn every_module_imports_what_stands_above_it() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for (i, (module, allowed)) in MODULES.into_iter().enumerate() {
        assert!(allowed.iter().all(|name| MODULES[..i].iter().any(|(above, _)| above == name)), "{module}");
        for path in files(&source.join(module)) {
            let text = fs::read_to_string(&path).expect("a source file");
            let forbidden = forbidden(module, &text);
            assert!(forbidden.is_empty(), "{} imports {forbidden:?}; {module} may import {allowed:?}", path.display());
        }
    }
    let listed =
        |name: &str| ["program", "lib.rs", "main.rs"].contains(&name) || MODULES.iter().any(|(module, _)| *module == name);
    for entry in fs::read_dir(&source).expect("a folder") {
        let name = entry.expect("an entry").file_name().into_string().expect("text");
        assert!(listed(&name), "src/{name} is not in the list of modules");
    }
}

#[test]
fn a_planted_import_is_found() {
    assert_eq!(forbidden("numbers", "use crate::dynamics::system::System;\n"), ["dynamics"]);
    assert_eq!(forbidden("policy", "//! [`x`](crate::train)\nfn f() -> crate::engine::Batch {}\n"), ["engine"]);
    assert_eq!(forbidden("engine", "use crate::System;"), ["System"], "imports name the module");
    assert!(forbidden("tasks", "use crate::dynamics::x;\n#[cfg(test)]\nmod tests { use crate::engine::y; }").is_empty());
}
