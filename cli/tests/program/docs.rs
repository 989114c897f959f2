//! Rust code in the documentation is a doctest, or quotes files in `examples`, which `cargo test`
//! compiles. Some pages quote whole files.

use crate::markdown::{Page, pages, root};
use std::fs;

#[test]
fn every_rust_block_is_a_doctest_or_quotes_an_example() {
    let libraries =
        [include_str!("../../../src/lib.rs"), include_str!("../../src/lib.rs")].concat();
    let folders = ["examples", "cli/examples"]
        .map(|folder| fs::read_dir(root().join(folder)).expect("a folder"));
    let files = folders.into_iter().flatten().map(|entry| entry.expect("an entry").path());
    let examples: Vec<_> = files.filter_map(|path| fs::read_to_string(path).ok()).collect();
    let of_an_example = |block: &str| {
        examples
            .iter()
            .any(|example| block.lines().all(|line| example.lines().any(|own| own == line)))
    };
    let mut count = 0;
    for page in pages() {
        let doctest = libraries.contains(&format!("../{}\")]", page.path.display()));
        for (language, block) in
            page.blocks.iter().filter(|(language, _)| language.starts_with("rust"))
        {
            let tested = if language == "rust" {
                doctest || examples.contains(block)
            } else {
                of_an_example(block)
            };
            assert!(tested, "{}: nothing compiles this block:\n{block}", page.path.display());
            count += 1;
        }
    }
    assert!(count >= 10, "{count} blocks");
}

#[test]
fn pages_quote_whole_files() {
    for (page, language, file) in [
        ("README.md", "rust", "examples/pendulum.rs"),
        ("docs/runs.md", "python", "cli/tests/program/read_policy.py"),
        ("docs/runs.md", "toml", "examples/plans/fields.toml"),
    ] {
        let text = fs::read_to_string(root().join(file)).expect("a file");
        let found = Page::read(page).blocks(language).any(|block| block == text);
        assert!(found, "{page} and {file} differ");
    }
}

#[test]
fn the_pendulum_example_has_fewer_than_40_lines() {
    assert!(include_str!("../../../examples/pendulum.rs").lines().count() < 40);
}
