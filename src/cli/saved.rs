//! A run that is in its folder: its settings, and the session as it was left.

use super::folder::{CHECKPOINT, Folder, RUNS, SETTINGS};
use super::scene::{Network, PolicyOf, Scene};
use super::settings::Settings;
use anyhow::{Context, Result, bail};
use physgrad::{Float, Session, System, Trainer};
use std::path::Path;
use toml::{Table, Value};

/// Whether there is a run in the folder that can be opened or resumed.
pub fn has_run(folder: &Folder) -> bool {
    folder.has(SETTINGS) && folder.has(CHECKPOINT)
}

/// The folders of the run in the folder, or of all runs of the comparison in it, by name.
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

/// The folders in a folder, by name.
fn folders(path: &Path) -> Result<Vec<Folder>> {
    let context = || format!("cannot look into {}", path.display());
    let entries = std::fs::read_dir(path).with_context(context)?;
    let mut paths = entries.map(|entry| Ok(entry.with_context(context)?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths.iter().filter_map(|path| Folder::existing(path).ok()).collect())
}

/// The name of the task of the run in the folder.
pub fn task(folder: &Folder) -> Result<String> {
    let table = table(folder)?;
    let task = table.get("task").and_then(Value::as_str);
    task.map(str::to_owned).with_context(|| format!("{} names no task", folder.file(SETTINGS).display()))
}

/// The settings of the run in the folder, which must be there.
pub fn settings<S: Scene>(folder: &Folder) -> Result<Settings<S>> {
    let table = table(folder)?;
    let own = env!("CARGO_PKG_VERSION");
    if let Some(version) = table.get("physgrad").and_then(Value::as_str).filter(|&version| version != own) {
        bail!(
            "the run in {} was made by physgrad {version}, and this is {own}, whose numbers may differ; use {version} for it, or \
             train it anew",
            folder.path().display()
        );
    }
    Settings::from_table(table).with_context(|| unusable(folder))
}

fn table(folder: &Folder) -> Result<Table> {
    if !has_run(folder) {
        bail!("there is no run in {}: no {SETTINGS} with a {CHECKPOINT}", folder.path().display());
    }
    folder.read_text(SETTINGS)?.parse().with_context(|| unusable(folder))
}

fn unusable(folder: &Folder) -> String {
    format!("{} is not usable", folder.file(SETTINGS).display())
}

/// The session of these settings before its first epoch.
pub fn fresh<S: Scene, F: Float>(settings: &Settings<S>, workers: usize) -> Result<Session<S, PolicyOf<S>, F>> {
    let task = S::build(&settings.system, &settings.loss, settings.horizon);
    let policy = settings.policy.build(task.system().state_dim(), task.system().control_dim());
    let trainer = Trainer::new(task, policy).precision::<F>().field(settings.field.0).training(settings.training(workers));
    Ok(trainer.session()?)
}

/// Brings a fresh session to where the run in the folder was left.
pub fn restore<S: Scene, F: Float>(
    folder: &Folder,
    settings: &Settings<S>,
    session: &mut Session<S, PolicyOf<S>, F>,
) -> Result<()> {
    let restored = session.restore(&folder.read(CHECKPOINT)?, &settings.identity());
    restored.with_context(|| format!("cannot take up {}", folder.file(CHECKPOINT).display()))
}
