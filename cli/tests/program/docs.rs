//! Rust code in the documentation is a doctest, or quotes files in `examples`, which `cargo test`
//! compiles. The page `docs/runs.md` quotes `read_policy.py`.

use crate::markdown::{pages, root};
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
fn the_readme_quotes_the_pendulum_example_of_fewer_than_40_lines() {
    let readme = include_str!("../../../README.md");
    let example = include_str!("../../../examples/pendulum.rs");
    assert!(
        readme.contains(&format!("```rust\n{example}```")),
        "README.md and examples/pendulum.rs differ"
    );
    assert!(example.lines().count() < 40, "examples/pendulum.rs has 40 lines or more");
}

#[test]
fn own_system_md_quotes_the_own_program_example() {
    let page = include_str!("../../../docs/own_system.md");
    let example = include_str!("../../examples/own_program.rs");
    assert!(
        page.contains(&format!("```rust\n{example}```")),
        "docs/own_system.md and cli/examples/own_program.rs differ"
    );
}

#[test]
fn scenes_md_quotes_the_own_effect_example() {
    let page = include_str!("../../../docs/scenes.md");
    let example = include_str!("../../../examples/own_effect.rs");
    assert!(
        page.contains(&format!("```rust\n{example}```")),
        "docs/scenes.md and examples/own_effect.rs differ"
    );
}

#[test]
fn runs_md_quotes_the_reader_of_policies() {
    let page = include_str!("../../../docs/runs.md");
    let reader = include_str!("read_policy.py");
    assert!(
        page.contains(&format!("```python\n{reader}```")),
        "docs/runs.md and tests/program/read_policy.py differ"
    );
}
