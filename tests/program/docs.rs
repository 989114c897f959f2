//! Code in the documentation equals example files that other tests compile and run.

#[test]
fn the_readme_quotes_the_pendulum_example_of_fewer_than_40_lines() {
    let readme = include_str!("../../README.md");
    let example = include_str!("../../examples/pendulum.rs");
    assert!(readme.contains(&format!("```rust\n{example}```")), "README.md and examples/pendulum.rs differ");
    assert!(example.lines().count() < 40, "examples/pendulum.rs has fewer than 40 lines");
}

#[test]
fn own_system_md_quotes_the_own_program_example() {
    let page = include_str!("../../docs/own_system.md");
    let example = include_str!("../../examples/own_program.rs");
    assert!(page.contains(&format!("```rust\n{example}```")), "docs/own_system.md and examples/own_program.rs differ");
}

#[test]
fn scenes_md_quotes_the_own_effect_example_of_fewer_than_80_lines() {
    let page = include_str!("../../docs/scenes.md");
    let example = include_str!("../../examples/own_effect.rs");
    assert!(page.contains(&format!("```rust\n{example}```")), "docs/scenes.md and examples/own_effect.rs differ");
    assert!(example.lines().count() < 80, "examples/own_effect.rs has fewer than 80 lines");
}

#[test]
fn runs_md_quotes_the_reader_of_policies() {
    let page = include_str!("../../docs/runs.md");
    let reader = include_str!("read_policy.py");
    assert!(page.contains(&format!("```python\n{reader}```")), "docs/runs.md and tests/program/read_policy.py differ");
}

#[test]
fn scenes_md_quotes_only_lines_of_the_scene_effect_example() {
    let page = include_str!("../../docs/scenes.md");
    let example = include_str!("../../examples/scene_effect.rs");
    let section = page.split("## Custom effects in scenes").nth(1).expect("the section");
    let block = section.split("```").nth(1).expect("a block of code");
    for line in block.lines().skip(1) {
        assert!(example.lines().any(|of_example| of_example == line), "{line} is no line of examples/scene_effect.rs");
    }
}
