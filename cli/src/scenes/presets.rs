//! Presets: scenes that are compiled into the program.

use crate::platform::folder::SETTINGS;
use crate::platform::terminal::did_you_mean;
use crate::scenes::source::SceneSource;
use crate::settings::VERSION;
use crate::tasks::{self, AnyTaskSpec};
use anyhow::{Context, Result, anyhow, bail};
use std::borrow::Cow;
use std::path::Path;

/// Name and text of every file in `presets/`.
const PRESETS: [(&str, &str); 42] = [
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
    ("lqr", include_str!("presets/lqr.toml")),
    ("double_pendulum", include_str!("presets/double_pendulum.toml")),
    ("pendulum", include_str!("presets/pendulum.toml")),
    ("pole_chain", include_str!("presets/pole_chain.toml")),
    ("slider", include_str!("presets/slider.toml")),
    ("bounce", include_str!("presets/bounce.toml")),
    ("push", include_str!("presets/push.toml")),
    ("equations", include_str!("presets/equations.toml")),
    ("cart_pole_balance", include_str!("presets/cart_pole_balance.toml")),
    ("bioreactor", include_str!("presets/bioreactor.toml")),
    ("bodies", include_str!("presets/bodies.toml")),
    ("half_cheetah", include_str!("presets/half_cheetah.toml")),
    ("half_cheetah_run", include_str!("presets/half_cheetah_run.toml")),
    ("hopper", include_str!("presets/hopper.toml")),
    ("hopper_run", include_str!("presets/hopper_run.toml")),
    ("hopper_shac", include_str!("presets/hopper_shac.toml")),
    ("walker2d", include_str!("presets/walker2d.toml")),
    ("walker2d_run", include_str!("presets/walker2d_run.toml")),
    ("ant", include_str!("presets/ant.toml")),
    ("ant_run", include_str!("presets/ant_run.toml")),
    ("ant_shac", include_str!("presets/ant_shac.toml")),
    ("arm", include_str!("presets/arm.toml")),
    ("swimmer", include_str!("presets/swimmer.toml")),
    ("reacher", include_str!("presets/reacher.toml")),
    ("inverted_double_pendulum", include_str!("presets/inverted_double_pendulum.toml")),
];

/// Presets with more effects than in the paper, one per task of the paper.
pub const RICH: [&str; 3] = ["cart_pole_windy", "guidance_walled", "quantum_double_well"];

/// Name and first line of every preset. Tasks of the user are presets with their default settings.
pub fn all() -> impl Iterator<Item = (&'static str, &'static str)> {
    let first_line =
        |text: &'static str| text.lines().next().unwrap_or_default().trim_start_matches(['#', ' ']);
    let built_in = PRESETS.into_iter().map(move |(name, text)| (name, first_line(text)));
    built_in.chain(tasks::own().iter().map(|task| (task.name(), task.about())))
}

/// Text of a preset.
pub fn text(name: &str) -> Result<Cow<'static, str>> {
    let built_in =
        PRESETS.into_iter().find(|(preset, _)| *preset == name).map(|(_, text)| text.into());
    let own = || tasks::own().iter().find(|task| task.name() == name);
    let preset = |task: &&dyn AnyTaskSpec| {
        format!("# {}\nscene = {VERSION}\ntask = {name:?}\n", task.about()).into()
    };
    built_in.or_else(|| own().map(preset)).with_context(|| {
        let names: Vec<&str> = all().map(|(name, _)| name).collect();
        format!("there is no preset `{name}`; presets: {}", names.join(", "))
    })
}

/// Source of the preset with this name, or of the file at this path.
pub fn source(name: &str) -> Result<SceneSource> {
    let path = Path::new(name);
    if path.is_dir() && !all().any(|(preset, _)| preset == name) {
        let scene = path.join(SETTINGS);
        if scene.exists() {
            bail!("{name} is a folder, not a scene; the scene of its run is {}", scene.display());
        }
        bail!(
            "{name} is a folder, not a scene; give the path of a scene, which ends in .toml, or the name of a preset"
        );
    }
    if is_path(name) {
        return SceneSource::read(path);
    }
    let question = did_you_mean(name, all().map(|(preset, _)| preset));
    let text = text(name).map_err(|error| {
        anyhow!("{error}; to use a scene file, give its path, which ends in .toml{question}")
    })?;
    SceneSource::parse(&format!("preset {name}"), &text)
}

/// Short name of a preset or file, for the names of folders with its results.
pub fn short_name(name: &str) -> String {
    let path = Path::new(name);
    // Names the scene of a saved run after the folder of the run.
    let folder = path.parent().and_then(Path::file_name).filter(|_| path.ends_with(SETTINGS));
    match folder.or_else(|| path.file_stem()) {
        Some(stem) if is_path(name) => stem.to_string_lossy().into_owned(),
        _ => name.to_owned(),
    }
}

/// True if the name is a file path rather than a preset.
pub fn is_path(name: &str) -> bool {
    name.ends_with(".toml") || name.contains(std::path::is_separator)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_have_the_name_of_the_scene_or_run() {
        assert_eq!(short_name("guidance_0.1"), "guidance_0.1");
        assert_eq!(short_name("scenes/windy.toml"), "windy");
        assert_eq!(short_name("runs/windy_2/run.toml"), "windy_2");
        assert_eq!(short_name("run.toml"), "run");
    }
}
