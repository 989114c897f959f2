//! What a page needs to know of a run, read from its folder.

use super::counted;
use super::growth::{Growth, growth};
use crate::cli::folder::Folder;
use crate::cli::outputs;
use crate::cli::saved;
use crate::cli::scene::{PolicyOf, Scene};
use crate::cli::settings::{Precision, Settings};
use crate::cli::statistics::Outcome;
use anyhow::{Result, bail};
use physgrad::{Field, Float, Record, Session, differences};
use rayon::prelude::*;
use toml::Table;

/// A run of any task and precision.
pub struct Inspected {
    pub task: &'static str,
    pub field: Field,
    pub seed: u64,
    /// Epochs asked for.
    pub epochs: usize,
    pub settings: Table,
    pub records: Vec<Record>,
    pub end: End,
    /// Of the first run of every field only.
    pub close: Option<Close>,
}

/// How a run ended.
pub enum End {
    Done,
    Interrupted,
    /// Why its next epoch cannot be trained.
    Broke(String),
}

/// What takes a look at rollouts.
pub struct Close {
    /// Of R and M, before the first epoch.
    pub before: [Growth; 2],
    /// The same as the run was left.
    pub after: [Growth; 2],
    /// An animated SVG.
    pub film: String,
}

impl Inspected {
    pub fn outcome(&self) -> Outcome<'_> {
        Outcome { field: self.field, seed: self.seed, records: &self.records, broken: matches!(self.end, End::Broke(_)) }
    }

    pub fn name(&self) -> String {
        format!("{} seed {}", self.field.letter(), self.seed)
    }

    /// What the run did not finish, if so, in words.
    pub fn trouble(&self) -> Option<String> {
        let done = counted(self.records.len(), "epoch");
        let asked = self.epochs;
        match &self.end {
            End::Done => None,
            End::Interrupted => Some(format!("was interrupted after {done} of {asked} and can be resumed")),
            End::Broke(why) => Some(format!("broke off after {done} of {asked}: {why}")),
        }
    }
}

/// The runs in these folders by field and seed; the first of every field is looked at closely.
pub fn inspect<S: Scene>(folders: &[Folder]) -> Result<Vec<Inspected>> {
    let mut runs = folders.iter().map(|folder| Ok((folder, saved::settings::<S>(folder)?))).collect::<Result<Vec<_>>>()?;
    for (folder, settings) in &runs {
        let [first, other] = [&runs[0].1, settings].map(Settings::comparable);
        if other != first {
            bail!(
                "{} and {} are not runs of one comparison: apart from field, seed and epochs, these settings differ:\n{}",
                runs[0].0.path().display(),
                folder.path().display(),
                differences(&first, &other)
            );
        }
    }
    // In the order in which `compare` has its fields if it is not told another.
    runs.sort_by_key(|(_, settings)| ("RMSCN".find(settings.field.0.letter()), settings.seed));
    let first = |i: usize| i == 0 || runs[i - 1].1.field != runs[i].1.field;
    let opened = runs.par_iter().enumerate().map(|(i, (folder, settings))| match settings.precision {
        Precision::F32 => open::<S, f32>(folder, settings, first(i)),
        Precision::F64 => open::<S, f64>(folder, settings, first(i)),
    });
    opened.collect()
}

fn open<S: Scene, F: Float>(folder: &Folder, settings: &Settings<S>, closely: bool) -> Result<Inspected> {
    let mut session = saved::fresh::<S, F>(settings, 1)?;
    let before = closely.then(|| growth(&session));
    saved::restore(folder, settings, &mut session)?;
    let close = before.map(|before| Close { before, after: growth(&session), film: outputs::film(&session, 0) });
    Ok(Inspected {
        task: S::NAME,
        field: settings.field.0,
        seed: settings.seed,
        epochs: settings.epochs,
        settings: settings.to_table(),
        records: session.records().to_vec(),
        close,
        end: end(&mut session, settings.epochs),
    })
}

/// A checkpoint does not say why there is none after it. But the same epoch fails again where it failed.
fn end<S: Scene, F: Float>(session: &mut Session<S, PolicyOf<S>, F>, epochs: usize) -> End {
    if session.records().len() >= epochs {
        return End::Done;
    }
    match session.epoch() {
        Ok(_) => End::Interrupted,
        Err(why) => End::Broke(why.to_string()),
    }
}
