//! Mistakes in a first simulator. The compiler rejects them with a known error code or message. For
//! each wrong expression, the form in `docs/systems.md` compiles.
//!
//! The tests call `rustc` once per compiled source, with the library that cargo built for this
//! test. They compare parts of messages, because whole messages depend on the compiler version. The
//! crate trybuild would build all dependencies a second time.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::SystemTime;
use std::{env, fs, io::Write};

/// The library linked into this test: the newest one that is not newer than the test.
fn library() -> PathBuf {
    let test = env::current_exe().expect("a test has a path");
    let modified = |path: &PathBuf| -> SystemTime {
        fs::metadata(path).and_then(|m| m.modified()).expect("a file with a time")
    };
    let built = modified(&test);
    let entries = fs::read_dir(test.parent().expect("a folder")).expect("a readable folder");
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let is_library = |path: &PathBuf| {
        let name = path.file_name().expect("a name").to_string_lossy();
        name.starts_with("libphysgrad-") && name.ends_with(".rlib")
    };
    paths
        .filter(is_library)
        .filter(|path| modified(path) <= built)
        .max_by_key(modified)
        .expect("a built library")
}

/// Errors of the compiler for a system with the given step and further items; empty if it compiles.
fn errors(step: &str, items: &str) -> String {
    let source = format!(
        "use physgrad::prelude::*;
        pub struct Own;
        impl System for Own {{
            fn state_dim(&self) -> usize {{ 1 }}
            fn control_dim(&self) -> usize {{ 1 }}
            fn step<T: Scalar>(&self, Inputs {{ x, .. }}: Inputs<'_, T>, next: &mut [T]) {{ next[0] = {step}; }}
        }}
        {items}"
    );
    let (library, folder) = (library(), tempfile::tempdir().expect("a folder"));
    let mut rustc = Command::new(env::var_os("RUSTC").unwrap_or("rustc".into()))
        .args(["--edition", "2024", "--crate-type", "lib", "--emit", "metadata", "--extern"])
        .arg(format!("physgrad={}", library.display()))
        .arg("-L")
        .arg(format!("dependency={}", library.parent().expect("a folder").display()))
        .arg("-o")
        .arg(folder.path().join("case.rmeta"))
        .arg("-")
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("rustc starts");
    rustc.stdin.take().expect("a pipe").write_all(source.as_bytes()).expect("rustc reads");
    let output = rustc.wait_with_output().expect("rustc ends");
    if output.status.success() {
        String::new()
    } else {
        String::from_utf8_lossy(&output.stderr).into_owned()
    }
}

/// Wrong expressions of a step, with the error code of the compiler and the documented form.
#[test]
fn wrong_expressions_have_a_documented_form() {
    let docs = include_str!("../../docs/systems.md");
    for (wrong, code, right) in [
        ("2.0 * x[0]", "E0277", "x[0] * 2.0"),
        ("1.0 - x[0]", "E0277", "T::from(1.0) - x[0]"),
        (
            "if x[0] > 0.0 { x[0] } else { -x[0] }",
            "E0369",
            "T::select_lt(T::zero(), x[0], x[0], -x[0])",
        ),
        ("x[0] % 6.28", "E0369", "x[0].wrap_angle()"),
    ] {
        let text = errors(wrong, "");
        assert!(text.contains(code), "{wrong}: {text}");
        assert_eq!(errors(right, ""), "", "{right}");
        assert!(
            docs.contains(&format!("| `{wrong}` | `{right}`")),
            "docs/systems.md lacks {wrong}"
        );
    }
}

#[test]
fn min_max_and_negative_powers_of_a_scalar_compile() {
    assert_eq!(errors("x[0].max(0.0) + x[0].min(x[0]) + x[0].powi(-1)", ""), "");
}

/// Types in the wrong place, with a part of the message of the compiler.
#[test]
fn types_in_the_wrong_place_are_explained() {
    for (item, sentence) in [
        (
            "pub fn boxed() -> Box<dyn System> { Box::new(Own) }",
            "method `step` has generic type parameters",
        ),
        ("pub fn checked() { check::task(&Own, &Mlp::new([1, 1])); }", "`Own` is not a task"),
        ("pub fn checked() { check::policy(&Own); }", "`Own` is not a policy"),
        ("pub fn checked() { check::system(&Mlp::new([1, 1])); }", "is not a system"),
        (
            "pub fn stepped(x: f32) -> f32 { Scalar::sqrt(x) }",
            "`f32` is not a scalar of simulators",
        ),
    ] {
        let text = errors("x[0]", item);
        assert!(text.contains(sentence), "{item}: {text}");
    }
}
