//! Each module imports only the modules that its entry in `LIBRARY` or `PROGRAM` permits. An entry
//! permits only modules above it in the list.

use std::fs;
use std::path::{Path, PathBuf};

/// Module, and the modules that it may import.
type Edges = (&'static str, &'static [&'static str]);

/// Modules of the library in `src`.
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

/// Modules of the program in `src/program`.
const PROGRAM: [Edges; 8] = [
    ("platform", &[]),
    ("settings", &[]),
    ("operations", &["platform", "settings"]),
    ("tasks", &["platform", "settings", "operations"]),
    ("scenes", &["platform", "settings", "operations", "tasks"]),
    ("runs", &["platform", "settings", "operations", "tasks", "scenes"]),
    ("commands", &["platform", "settings", "operations", "tasks", "scenes", "runs"]),
    ("api", &["platform", "settings", "operations", "tasks", "scenes", "runs", "commands"]),
];

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let nested = paths.map(|path| if path.is_dir() { files(&path) } else { vec![path] });
    nested.flatten().filter(|path| path.extension().is_some_and(|extension| extension == "rs")).collect()
}

/// Returns the modules that a file of `module` imports without permission.
///
/// Imports are paths that start with `root`. Skips comment lines, and the first inline module of
/// unit tests with all lines after it.
fn forbidden(modules: &[Edges], root: &str, module: &str, text: &str) -> Vec<String> {
    let (_, allowed) = modules.iter().find(|(name, _)| *name == module).expect("a module of the list");
    let lines = without_tests(text).lines().filter(|line| !line.trim().starts_with("//"));
    let imports = lines.flat_map(|line| line.split(root).skip(1));
    let names = imports.map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default());
    names.filter(|name| *name != module && !allowed.contains(name)).map(String::from).collect()
}

/// Returns the text up to the first inline module of unit tests.
fn without_tests(text: &str) -> &str {
    let is_module =
        |(i, _): &(usize, &str)| text[*i..].lines().nth(1).is_some_and(|line| line.contains("mod ") && line.ends_with('{'));
    text.match_indices("#[cfg(test)]").find(is_module).map_or(text, |(i, _)| &text[..i])
}

/// Checks the order of the list, and the imports and `super` paths of all listed modules below
/// `folder`. Checks that `folder` contains only the listed modules and `others`.
fn check(folder: &Path, modules: &[Edges], root: &str, others: &[&str]) {
    for (i, (module, allowed)) in modules.iter().enumerate() {
        assert!(
            allowed.iter().all(|name| modules[..i].iter().any(|(above, _)| above == name)),
            "{module} may import a module that is not above it in the list"
        );
        for path in files(&folder.join(module)) {
            let text = fs::read_to_string(&path).expect("a source file");
            let forbidden = forbidden(modules, root, module, &text);
            assert!(forbidden.is_empty(), "{} imports {forbidden:?}; {module} may import {allowed:?}", path.display());
            let depth = path.strip_prefix(folder).expect("a file of the folder").components().count();
            let depth = if path.ends_with("mod.rs") { depth - 1 } else { depth };
            let leaves = leaves_folder(without_tests(&text), depth);
            assert!(!leaves, "{} leaves the folder of its module by `super`", path.display());
        }
    }
    for entry in fs::read_dir(folder).expect("a folder") {
        let name = entry.expect("an entry").file_name().into_string().expect("a name in UTF-8");
        let listed = others.contains(&&*name) || modules.iter().any(|(module, _)| *module == name);
        assert!(listed, "{}/{name} is not in the list of modules", folder.display());
    }
}

/// Returns whether the text contains `depth` consecutive `super::`.
///
/// In a file `depth` levels below the folder of all modules, this path leaves the folder of its
/// module.
fn leaves_folder(text: &str, depth: usize) -> bool {
    text.contains(&"super::".repeat(depth))
}

#[test]
fn library_modules_import_only_permitted_modules() {
    check(&source(), &LIBRARY, "crate::", &["program", "lib.rs", "main.rs"]);
}

#[test]
fn program_modules_import_only_permitted_modules() {
    check(&source().join("program"), &PROGRAM, "crate::program::", &["mod.rs"]);
}

#[test]
fn forbidden_imports_are_found_in_example_texts() {
    let library = |module: &str, text: &str| forbidden(&LIBRARY, "crate::", module, text);
    assert_eq!(library("numbers", "use crate::dynamics::system::System;\n"), ["dynamics"]);
    assert_eq!(library("policy", "//! [`x`](crate::train)\nfn f() -> crate::engine::Batch {}\n"), ["engine"]);
    assert_eq!(library("engine", "use crate::System;"), ["System"], "an import from the root of the crate is not found");
    assert!(library("tasks", "use crate::dynamics::x;\n#[cfg(test)]\nmod tests {\n    use crate::engine::y;\n}").is_empty());
    assert_eq!(library("tasks", "#[cfg(test)]\nmod tests;\nuse crate::engine::y;\n"), ["engine"]);
    let program = |module: &str, text: &str| forbidden(&PROGRAM, "crate::program::", module, text);
    assert_eq!(program("settings", "use crate::program::tasks::Settings;\n"), ["tasks"]);
    assert_eq!(program("tasks", "fn f() { crate::program::runs::run::threads(None); }\n"), ["runs"]);
    assert!(program("runs", "use crate::program::tasks::Scene;\n").is_empty());
    assert!(leaves_folder("use super::super::runs::run;", 2) && !leaves_folder("use super::schema;", 2));
}
