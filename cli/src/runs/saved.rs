//! Saved runs: search in folders, scenes, restored states.

use crate::operations::session::AnyRun;
use crate::platform::folder::{
    CHECKPOINT, Folder, INITIAL_POLICY, METRICS, POLICY, RUNS, SETTINGS,
};
use crate::platform::terminal::{counted, print_message};
use crate::scenes::overrides::Overrides;
use crate::scenes::presets;
use crate::scenes::source::SceneSource;
use crate::tasks::{Scene, scene};
use anyhow::{Context, Result, bail};
use physgrad::text::digits;
use physgrad::train::differences;
use std::io;
use std::path::PathBuf;

/// Returns whether the folder contains a run.
pub fn has_run(folder: &Folder) -> bool {
    folder.has(SETTINGS)
}

/// Runs of one scene.
pub struct SceneRuns {
    /// Name of the scene's folder in a comparison of several scenes; otherwise empty.
    pub name: String,
    /// One folder per run, sorted by name.
    pub runs: Vec<Folder>,
}

/// Runs in `folder`, which contains a run or a comparison: one item per scene, sorted by name. A
/// comparison of several scenes has one subfolder per scene.
///
/// # Errors
/// There is no run, or runs are immediate subfolders of `folder`. A folder cannot be read.
pub fn scenes(folder: &Folder) -> Result<Vec<SceneRuns>> {
    if has_run(folder) {
        return Ok(vec![SceneRuns { name: String::new(), runs: vec![folder.clone()] }]);
    }
    let runs = compared(folder)?;
    if !runs.is_empty() {
        return Ok(vec![SceneRuns { name: String::new(), runs }]);
    }
    let path = folder.path().display();
    let inside = folders(folder)?;
    let scene = |case: &Folder| Ok(SceneRuns { name: case.name(), runs: compared(case)? });
    let mut scenes = inside.iter().map(scene).collect::<Result<Vec<SceneRuns>>>()?;
    scenes.retain(|scene| !scene.runs.is_empty());
    match inside.iter().find(|case| has_run(case)) {
        Some(run) => {
            let count = inside.iter().filter(|case| has_run(case)).count() + scenes.len();
            bail!(
                "{path} holds {count} runs or comparisons; choose one, for example {}",
                run.path().display()
            )
        }
        None if scenes.is_empty() => {
            bail!(
                "there is no run in {path} or {path}/{RUNS}; create one with `train` or `compare`"
            )
        }
        None => Ok(scenes),
    }
}

/// Runs of the comparison of one scene in `folder`. Empty without a comparison.
fn compared(folder: &Folder) -> Result<Vec<Folder>> {
    let inside = folder.inside(RUNS)?;
    if !inside.path().is_dir() {
        return Ok(Vec::new());
    }
    Ok(folders(&inside)?.into_iter().filter(has_run).collect())
}

/// Subfolders, sorted by name. Omits renamed earlier runs, and links to folders with a warning: they
/// may lead out of the folder, or back into it.
pub fn folders(folder: &Folder) -> Result<Vec<Folder>> {
    let path = folder.path();
    let context = || format!("cannot read the folder {}", path.display());
    let entries = std::fs::read_dir(path).with_context(context)?;
    let mut paths =
        entries.map(|entry| Ok(entry.with_context(context)?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    let (links, paths): (Vec<&PathBuf>, Vec<&PathBuf>) =
        paths.iter().filter(|path| path.is_dir()).partition(|path| path.is_symlink());
    if let Some(first) = links.first() {
        let count = counted(links.len(), "link");
        print_message(&format!(
            "warning: omitted {count} to folders, for example {}; name the folder itself",
            first.display()
        ));
    }
    Ok(paths.into_iter().map(Folder::at).filter(|folder| !folder.is_previous()).collect())
}

/// Scene of the run in the folder.
///
/// # Errors
/// There is no run, or another version of the program made it. The settings are invalid or cannot
/// be read.
pub fn scene(folder: &Folder) -> Result<Scene> {
    if !has_run(folder) {
        let text = format!("there is no run in {}: it has no {SETTINGS}", folder.path().display());
        return Err(io::Error::new(io::ErrorKind::NotFound, text).into());
    }
    let source = SceneSource::read(&folder.readable(SETTINGS)?)?;
    let this = env!("CARGO_PKG_VERSION");
    if let Some(version) = source.text("physgrad").filter(|&version| version != this) {
        bail!(
            "physgrad {version} made the run in {}, and this is version {this}, whose numbers may differ; use version {version}, or \
             train again",
            folder.path().display()
        );
    }
    source.scene()
}

/// Writes the settings of a run, as [`write_scene`] does.
pub fn write_settings(folder: &Folder, scene: &Scene) -> Result<()> {
    write_scene(folder, SETTINGS, scene)
}

/// Writes a scene to this file, and a copy of its initial policy, if any. The written scene names
/// the copy.
pub fn write_scene(folder: &Folder, name: &str, scene: &Scene) -> Result<()> {
    let mut table = scene.table();
    if let Some(policy) = scene.initial_policy() {
        folder.write(INITIAL_POLICY, policy)?;
        table.insert(scene::INITIAL_POLICY.into(), INITIAL_POLICY.into());
    }
    folder.write(name, table.to_string())
}

/// Restores the saved state of a run. If the folder has neither checkpoint, metrics nor policy, the
/// run stays before its first epoch.
///
/// Prints a warning if the saved policy no longer has its recorded test loss.
pub fn restore(folder: &Folder, scene: &Scene, run: &mut dyn AnyRun) -> Result<()> {
    if [CHECKPOINT, METRICS, POLICY].into_iter().all(|name| !folder.has(name)) {
        return Ok(());
    }
    let restored = run.restore(&folder.read(CHECKPOINT)?, &scene.identity());
    restored.with_context(|| format!("cannot restore {}", folder.file(CHECKPOINT).display()))?;
    if let Some(losses) = run.changed_test_loss() {
        let (path, [recorded, computed]) =
            (folder.path().display(), losses.map(|loss| digits(loss, 9)));
        print_message(&format!(
            "warning: the best policy in {path} had the test loss {recorded} in its training, and has {computed} now. Either the \
             equations of the task have changed since, or this processor rounds differently. If the equations have changed, \
             train again"
        ));
    }
    Ok(())
}

/// Scene of the preset or file with this name, with overrides.
pub fn changed(name: &str, overrides: &Overrides) -> Result<Scene> {
    let mut source = presets::source(name)?;
    overrides.apply(&mut source)?;
    source.scene()
}

/// Checks that the run in the folder and the scene have equal identities; see [`Scene::identity`].
///
/// # Errors
/// The identities differ. As [`scene`](self::scene()).
pub fn check_resumable(folder: &Folder, scene: &Scene) -> Result<()> {
    let saved = self::scene(folder)?.identity();
    if scene.identity() != saved {
        bail!(
            "a resumed run keeps its settings (`tags`, `log` and `training.memory` may change, and the number of epochs only \
             while `training.decay` is constant); in {}, these differ:\n{}",
            folder.path().display(),
            differences(&saved, &scene.identity())
        );
    }
    Ok(())
}

/// Scene of the run in the folder, with overrides.
///
/// # Errors
/// There is no run, or the overrides are invalid or change its identity. As
/// [`scene`](self::scene()).
pub fn resumed(folder: &Folder, overrides: &Overrides) -> Result<Scene> {
    if !has_run(folder) {
        bail!(
            "there is no run to resume in {}; omit --resume to start one",
            folder.path().display()
        );
    }
    let mut source = SceneSource::read(&folder.readable(SETTINGS)?)?;
    overrides.apply_again(&mut source)?;
    let scene = source.scene()?;
    check_resumable(folder, &scene)?;
    Ok(scene)
}
