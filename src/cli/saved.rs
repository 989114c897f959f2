//! A run that is in its folder: its settings, and the session as it was left.

use super::folder::{CHECKPOINT, Folder, RUNS, SETTINGS};
use super::scene::{Network, PolicyOf, Scene};
use super::settings::Settings;
use anyhow::{Context, Result, bail};
use physgrad::{Float, Session, System, Trainer};
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
    let mut paths = match std::fs::read_dir(&inside) {
        Ok(entries) => entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?,
        Err(_) => Vec::new(),
    };
    paths.sort();
    let runs: Vec<Folder> = paths.iter().filter_map(|path| Folder::existing(path).ok()).filter(has_run).collect();
    if runs.is_empty() {
        bail!(
            "there is no run in {}, nor in {RUNS}/ of it: neither `train` nor `compare` has saved one",
            folder.path().display()
        );
    }
    Ok(runs)
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
        bail!("this run was made by physgrad {version}, and this is {own}: its numbers would not be those of one run");
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
