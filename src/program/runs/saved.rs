//! Saved runs: finds them in folders, reads their scenes, restores their state.

use crate::program::operations::session::AnyRun;
use crate::program::platform::folder::{CHECKPOINT, Folder, METRICS, POLICY, RUNS, SETTINGS};
use crate::program::scenes::overrides::Overrides;
use crate::program::scenes::presets;
use crate::program::scenes::source::SceneSource;
use crate::program::tasks::Scene;
use anyhow::{Context, Result, bail};
use physgrad::differences;
use std::path::Path;

/// True if the folder contains a run that can be opened or resumed.
pub fn has_run(folder: &Folder) -> bool {
    folder.has(SETTINGS)
}

/// Folders of the run, or of all runs of the comparison, sorted by name.
///
/// # Errors
/// The folder contains no run, or several comparisons.
pub fn runs(folder: &Folder) -> Result<Vec<Folder>> {
    if has_run(folder) {
        return Ok(vec![folder.clone()]);
    }
    let inside = folder.file(RUNS);
    let runs = if inside.is_dir() { folders(&inside)?.into_iter().filter(has_run).collect() } else { Vec::new() };
    if !runs.is_empty() {
        return Ok(runs);
    }
    let path = folder.path().display();
    let cases: Vec<Folder> = folders(folder.path())?.into_iter().filter(|case| has_run(case) || case.has(RUNS)).collect();
    match cases.first() {
        Some(case) => {
            bail!("{path} holds {} runs or comparisons; choose one, for example {}", cases.len(), case.path().display())
        }
        None => bail!("there is no run in {path}, nor in {RUNS}/ of it: neither `train` nor `compare` has saved one"),
    }
}

/// Subfolders, sorted by name.
fn folders(path: &Path) -> Result<Vec<Folder>> {
    let context = || format!("cannot look into {}", path.display());
    let entries = std::fs::read_dir(path).with_context(context)?;
    let mut paths = entries.map(|entry| Ok(entry.with_context(context)?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    let folders = paths.iter().filter_map(|path| Folder::existing(path).ok());
    Ok(folders.filter(|folder| !folder.is_previous()).collect())
}

/// Scene of the run in the folder.
///
/// # Errors
/// There is no run, or another version of the program made it.
pub fn scene(folder: &Folder) -> Result<Scene> {
    if !has_run(folder) {
        bail!("there is no run in {}: no {SETTINGS}", folder.path().display());
    }
    let document = SceneSource::read(&folder.readable(SETTINGS)?)?;
    let own = env!("CARGO_PKG_VERSION");
    if let Some(version) = document.text("physgrad").filter(|&version| version != own) {
        bail!(
            "the run in {} was made by physgrad {version}, and this is {own}, whose numbers may differ; use {version} for it, or \
             train it anew",
            folder.path().display()
        );
    }
    document.scene()
}

/// Restores the saved state of a run. Without a checkpoint, the run stays at its start.
pub fn restore(folder: &Folder, scene: &Scene, run: &mut dyn AnyRun) -> Result<()> {
    if [CHECKPOINT, METRICS, POLICY].into_iter().all(|name| !folder.has(name)) {
        return Ok(());
    }
    let restored = run.restore(&folder.read(CHECKPOINT)?, &scene.identity());
    restored.with_context(|| format!("cannot take up {}", folder.file(CHECKPOINT).display()))
}

/// The preset or file of this name, with these changes.
pub fn changed(name: &str, changes: &Overrides) -> Result<Scene> {
    let mut document = presets::document(name)?;
    changes.apply(&mut document)?;
    document.scene()
}

/// An error unless the run in the folder has these settings; only the number of epochs may differ.
pub fn check_resumable(folder: &Folder, scene: &Scene) -> Result<()> {
    let saved = self::scene(folder)?.identity();
    if scene.identity() != saved {
        bail!(
            "a resumed run keeps its settings (only the number of epochs may change); in {}, these differ:\n{}",
            folder.path().display(),
            differences(&saved, &scene.identity())
        );
    }
    Ok(())
}

/// The scene of the run in the folder, with these changes.
pub fn resumed(folder: &Folder, changes: &Overrides) -> Result<Scene> {
    if !has_run(folder) {
        bail!("there is no run to resume in {}; without --resume, a new one starts there", folder.path().display());
    }
    let mut document = SceneSource::read(&folder.readable(SETTINGS)?)?;
    changes.apply_again(&mut document)?;
    let scene = document.scene()?;
    check_resumable(folder, &scene)?;
    Ok(scene)
}
