//! Packages that the program and the bindings for Python share are compiled once.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// Features of each package that a build of these packages compiles.
fn features(packages: &[&str]) -> BTreeMap<String, String> {
    let mut tree = Command::new(env!("CARGO"));
    tree.args(["tree", "--offline", "--edges", "normal,build", "--no-dedupe", "--prefix", "none"]);
    tree.args(["--format", "{p}|{f}"]);
    packages.iter().for_each(|package| _ = tree.args(["--package", package]));
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the root");
    let output = tree.current_dir(root).output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("text");
    let packages = text.lines().filter_map(|line| line.split_once('|'));
    packages.map(|(package, features)| (package.to_owned(), features.to_owned())).collect()
}

#[test]
fn the_bindings_use_the_packages_of_the_program_with_equal_features() {
    let program = features(&["physgrad", "physgrad-plot", "physgrad-cli", "physgrad-tests"]);
    let bindings = features(&["physgrad-python"]);
    let differing: Vec<_> = bindings
        .iter()
        .filter(|(package, features)| program.get(*package).is_some_and(|own| own != *features))
        .collect();
    assert!(
        differing.is_empty(),
        "add these features to `cli/Cargo.toml`, so that one build serves both: {differing:?}"
    );
    assert!(bindings.len() > 60 && program.len() > 60, "{} {}", bindings.len(), program.len());
}
