//! Modules import downwards only. Lists of modules begin with the lowest.

use std::fs;
use std::path::{Path, PathBuf};

/// Module, and the modules that it may import. All of these stand above it in the list.
type Edges = (&'static str, &'static [&'static str]);

/// Modules of the library.
const LIBRARY: [Edges; 10] = [
    ("numbers", &[]),
    ("report", &[]),
    ("dynamics", &["numbers"]),
    ("policy", &["numbers"]),
    ("identify", &["numbers", "dynamics"]),
    ("tasks", &["numbers", "dynamics"]),
    ("optimize", &["numbers", "dynamics"]),
    ("engine", &["numbers", "dynamics", "policy"]),
    ("train", &["numbers", "dynamics", "policy", "engine"]),
    ("check", &["numbers", "dynamics", "policy", "engine", "train", "tasks"]),
];

/// Modules of the program.
const PROGRAM: [Edges; 7] = [
    ("platform", &[]),
    ("settings", &[]),
    ("operations", &["platform", "settings"]),
    ("tasks", &["platform", "settings", "operations"]),
    ("scenes", &["platform", "settings", "operations", "tasks"]),
    ("runs", &["platform", "settings", "operations", "tasks", "scenes"]),
    ("commands", &["platform", "settings", "operations", "tasks", "scenes", "runs"]),
];

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let nested = paths.map(|path| if path.is_dir() { files(&path) } else { vec![path] });
    nested.flatten().filter(|path| path.extension().is_some_and(|extension| extension == "rs")).collect()
}

/// Returns the forbidden imports in a file of `module`: paths that start with `root`.
///
/// Skips comments and unit tests.
fn forbidden(modules: &[Edges], root: &str, module: &str, text: &str) -> Vec<String> {
    let (_, allowed) = modules.iter().find(|(name, _)| *name == module).expect("a module of the list");
    let lines = text.lines().take_while(|line| line.trim() != "#[cfg(test)]").filter(|line| !line.trim().starts_with("//"));
    let imports = lines.flat_map(|line| line.split(root).skip(1));
    let names = imports.map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default());
    names.filter(|name| *name != module && !allowed.contains(name)).map(String::from).collect()
}

/// Checks the imports of all files below `folder`, and that the list of modules is complete.
fn check(folder: &Path, modules: &[Edges], root: &str, others: &[&str]) {
    for (i, (module, allowed)) in modules.iter().enumerate() {
        assert!(allowed.iter().all(|name| modules[..i].iter().any(|(above, _)| above == name)), "{module}");
        for path in files(&folder.join(module)) {
            let text = fs::read_to_string(&path).expect("a source file");
            let forbidden = forbidden(modules, root, module, &text);
            assert!(forbidden.is_empty(), "{} imports {forbidden:?}; {module} may import {allowed:?}", path.display());
        }
    }
    for entry in fs::read_dir(folder).expect("a folder") {
        let name = entry.expect("an entry").file_name().into_string().expect("text");
        let listed = others.contains(&&*name) || modules.iter().any(|(module, _)| *module == name);
        assert!(listed, "{}/{name} is not in the list of modules", folder.display());
    }
}

/// Returns whether the text contains `depth` consecutive `super::`, which leave the folder of the
/// program.
fn leaves_folder(text: &str, depth: usize) -> bool {
    text.contains(&"super::".repeat(depth))
}

#[test]
fn modules_of_the_library_import_downwards() {
    check(&source(), &LIBRARY, "crate::", &["program", "lib.rs", "main.rs"]);
}

#[test]
fn modules_of_the_program_import_downwards() {
    let folder = source().join("program");
    check(&folder, &PROGRAM, "crate::program::", &["mod.rs"]);
    for path in PROGRAM.iter().flat_map(|(module, _)| files(&folder.join(module))) {
        let text = fs::read_to_string(&path).expect("a source file");
        let depth = path.strip_prefix(&folder).expect("a file of the program").components().count();
        let depth = if path.ends_with("mod.rs") { depth - 1 } else { depth };
        assert!(!leaves_folder(&text, depth), "{} leaves its folder by `super`", path.display());
    }
}

#[test]
fn planted_imports_are_found() {
    let library = |module: &str, text: &str| forbidden(&LIBRARY, "crate::", module, text);
    assert_eq!(library("numbers", "use crate::dynamics::system::System;\n"), ["dynamics"]);
    assert_eq!(library("policy", "//! [`x`](crate::train)\nfn f() -> crate::engine::Batch {}\n"), ["engine"]);
    assert_eq!(library("engine", "use crate::System;"), ["System"], "imports name the module");
    assert!(library("tasks", "use crate::dynamics::x;\n#[cfg(test)]\nmod tests { use crate::engine::y; }").is_empty());
    let program = |module: &str, text: &str| forbidden(&PROGRAM, "crate::program::", module, text);
    assert_eq!(program("settings", "use crate::program::tasks::Settings;\n"), ["tasks"]);
    assert_eq!(program("tasks", "fn f() { crate::program::runs::run::threads(None); }\n"), ["runs"]);
    assert!(program("runs", "use crate::program::tasks::Scene;\n").is_empty());
    assert!(leaves_folder("use super::super::runs::run;", 2) && !leaves_folder("use super::schema;", 2));
}
