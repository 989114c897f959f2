//! Scenes that come with the program.

use super::document::Document;
use anyhow::{Context, Result, anyhow};
use std::path::Path;

/// A line for every file in `presets/`.
const PRESETS: [(&str, &str); 17] = [
    ("cart_pole", include_str!("presets/cart_pole.toml")),
    ("cart_pole_1", include_str!("presets/cart_pole_1.toml")),
    ("cart_pole_2", include_str!("presets/cart_pole_2.toml")),
    ("cart_pole_3", include_str!("presets/cart_pole_3.toml")),
    ("cart_pole_4", include_str!("presets/cart_pole_4.toml")),
    ("cart_pole_windy", include_str!("presets/cart_pole_windy.toml")),
    ("guidance", include_str!("presets/guidance.toml")),
    ("guidance_1", include_str!("presets/guidance_1.toml")),
    ("guidance_0.1", include_str!("presets/guidance_0.1.toml")),
    ("guidance_0.01", include_str!("presets/guidance_0.01.toml")),
    ("guidance_0.001", include_str!("presets/guidance_0.001.toml")),
    ("guidance_walled", include_str!("presets/guidance_walled.toml")),
    ("quantum", include_str!("presets/quantum.toml")),
    ("quantum_3", include_str!("presets/quantum_3.toml")),
    ("quantum_4", include_str!("presets/quantum_4.toml")),
    ("quantum_5", include_str!("presets/quantum_5.toml")),
    ("quantum_double_well", include_str!("presets/quantum_double_well.toml")),
];

/// The presets with more in play than the paper has: one a task.
pub const RICH: [&str; 3] = ["cart_pole_windy", "guidance_walled", "quantum_double_well"];

/// The names of all presets, each with the first line of its file.
pub fn all() -> impl Iterator<Item = (&'static str, &'static str)> {
    PRESETS.into_iter().map(|(name, text)| (name, text.lines().next().unwrap_or_default().trim_start_matches(['#', ' '])))
}

/// The file of a preset.
pub fn text(name: &str) -> Result<&'static str> {
    let found = PRESETS.into_iter().find(|(preset, _)| *preset == name).map(|(_, text)| text);
    found.with_context(|| {
        let names: Vec<&str> = all().map(|(name, _)| name).collect();
        format!("there is no preset `{name}`, only {}", names.join(", "))
    })
}

/// The preset of this name, or the scene in the file at this path.
pub fn document(name: &str) -> Result<Document> {
    if is_path(name) {
        return Document::read(Path::new(name));
    }
    let text = text(name).map_err(|none| anyhow!("{none}; a scene of your own is named by its path, which ends in .toml"))?;
    Document::parse(&format!("preset {name}"), text)
}

/// What results of the preset or file are called.
pub fn short_name(name: &str) -> String {
    match Path::new(name).file_stem() {
        Some(stem) if is_path(name) => stem.to_string_lossy().into_owned(),
        _ => name.to_owned(),
    }
}

fn is_path(name: &str) -> bool {
    name.ends_with(".toml") || name.contains(std::path::is_separator)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_a_scene_and_begins_with_what_it_is() {
        for (name, text) in PRESETS {
            assert!(text.starts_with("# "), "{name}");
            if let Err(error) = document(name).and_then(|document| document.scene()) {
                panic!("{error}");
            }
        }
    }
}
