//! Examples in the documentation equal files that are compiled, run and checked.

#[test]
fn the_readme_shows_the_pendulum_example_as_it_is() {
    let readme = include_str!("../../README.md");
    let example = include_str!("../../examples/pendulum.rs");
    assert!(readme.contains(&format!("```rust\n{example}```")), "README.md and examples/pendulum.rs differ");
    assert!(example.lines().count() < 40, "a newcomer's file has fewer than 40 lines");
}

#[test]
fn the_guide_shows_the_task_of_a_new_crate_as_it_is() {
    let page = include_str!("../../docs/own_system.md");
    let example = include_str!("../../examples/own_program.rs");
    assert!(page.contains(&format!("```rust\n{example}```")), "docs/own_system.md and examples/own_program.rs differ");
}

#[test]
fn the_page_on_scenes_shows_the_example_of_an_effect_as_it_is() {
    let page = include_str!("../../docs/scenes.md");
    let example = include_str!("../../examples/own_effect.rs");
    assert!(page.contains(&format!("```rust\n{example}```")), "docs/scenes.md and examples/own_effect.rs differ");
    assert!(example.lines().count() < 80, "an effect and its training have fewer than 80 lines");
}

#[test]
fn the_page_on_scenes_shows_lines_of_the_example_of_a_scene_effect() {
    let page = include_str!("../../docs/scenes.md");
    let example = include_str!("../../examples/scene_effect.rs");
    let section = page.split("## Custom effects in scenes").nth(1).expect("the section");
    let block = section.split("```").nth(1).expect("a block of code");
    for line in block.lines().skip(1) {
        assert!(example.lines().any(|of_example| of_example == line), "{line} is no line of examples/scene_effect.rs");
    }
}
