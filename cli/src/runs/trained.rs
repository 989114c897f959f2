//! [`Trained`]: the policy of a saved run, with the scene in which it is evaluated.

use crate::operations::evaluation::AnyEvaluation;
use crate::operations::policy_file::check_settings;
use crate::operations::session::Epoch;
use crate::platform::folder::{Folder, SETTINGS};
use crate::platform::terminal::{counted, print_message};
use crate::runs::saved;
use crate::runs::statistics::best_record;
use crate::scenes::source::SceneSource;
use crate::tasks::Scene;
use anyhow::{Result, bail};
use physgrad::Policy;
use physgrad::text::short;
use physgrad::train::Record;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Policy of a saved run.
pub struct Trained {
    /// Name of the run's folder, or its path if several runs have the same name.
    pub name: String,
    /// Settings of the run, with trained numbers fixed at their values.
    pub source: SceneSource,
    /// Scene of the run.
    pub scene: Scene,
    /// Parameters of the policy, without trained numbers.
    pub theta: Vec<f64>,
}

impl Trained {
    /// Loads the policies of the runs in these folders, after the last or the best epoch. The path of
    /// a scene stands for its policy, which needs no training.
    ///
    /// # Errors
    /// A folder has no run, or a run that cannot be restored. The policy of a scene has trained
    /// numbers. The runs have different tasks.
    pub fn load_all(paths: &[PathBuf], epoch: Epoch) -> Result<Vec<Self>> {
        let load = |path: &PathBuf| {
            if path.is_file() {
                return Self::of_scene(path);
            }
            let folder = Folder::existing(path)?;
            Self::load(folder.name(), &folder, epoch)
        };
        let mut runs = paths.iter().map(load).collect::<Result<Vec<_>>>()?;
        let names: HashSet<&String> = runs.iter().map(|run| &run.name).collect();
        if names.len() < runs.len() {
            let pairs = runs.iter_mut().zip(paths);
            pairs.for_each(|(run, path)| run.name = path.display().to_string());
        }
        if let Some(other) =
            runs.iter().find(|run| run.scene.task.name() != runs[0].scene.task.name())
        {
            bail!(
                "{} has the task {}, but {} has the task {}; compare runs of one task",
                runs[0].name,
                runs[0].scene.task.name(),
                other.name,
                other.scene.task.name()
            );
        }
        Ok(runs)
    }

    /// Prepares rollouts of the policy in a scene.
    ///
    /// # Errors
    /// The scene has another number of observations, controls or parameters.
    pub fn evaluation(&self, scene: &Scene, seed: u64) -> Result<Box<dyn AnyEvaluation>> {
        let [own, other] = [&self.scene, scene].map(|scene| {
            let policy = scene.policy();
            [policy.observation_dim(), policy.control_dim()]
        });
        if own != other {
            bail!(
                "the policy has {} observations and {} controls, but this scene has {} and {}; \
                 use a scene with as many observations and controls",
                own[0],
                own[1],
                other[0],
                other[1]
            );
        }
        if !self.theta.is_empty() {
            check_settings(&self.scene.meaning_of(&self.scene), &scene.meaning_of(scene))?;
        }
        scene.evaluation(&self.theta, seed)
    }

    fn of_scene(path: &Path) -> Result<Self> {
        let source = SceneSource::read(path)?;
        let scene = source.scene()?;
        let (count, shown) = (scene.policy().param_count(), path.display());
        if count > 0 {
            bail!(
                "the policy of {shown} has {} to train; run `physgrad train {shown}` and give the folder of the run",
                counted(count, "number")
            );
        }
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
        Ok(Self { name, source, scene, theta: Vec::new() })
    }

    fn load(name: String, folder: &Folder, epoch: Epoch) -> Result<Self> {
        let scene = saved::scene(folder)?;
        let mut run = scene.open(1)?;
        saved::restore(folder, &scene, &mut *run)?;
        let mut source = SceneSource::read(&folder.readable(SETTINGS)?)?;
        let names = scene.param_names();
        for (index, value) in run.trained(epoch) {
            source.fix(&names[index], value)?;
        }
        if let Some(note) = better_epoch(&name, run.records()).filter(|_| epoch == Epoch::Last) {
            print_message(&note);
        }
        Ok(Self { name, source, scene, theta: run.theta(epoch) })
    }
}

/// Tells that an epoch before the last had a test loss that is lower by more than a twentieth.
fn better_epoch(name: &str, records: &[Record]) -> Option<String> {
    let (last, best) = (records.last()?, best_record(records)?);
    let is_close = last.test_loss - best.test_loss <= 0.05 * best.test_loss.abs();
    let steps = |record: &Record| {
        record
            .length
            .map_or_else(String::new, |steps| format!(" in episodes of {} steps", short(steps)))
    };
    (!is_close).then(|| {
        format!(
            "note: {name} has the policy of its last epoch, {}, with a test loss of {}{}. That of epoch {} had {}{}: --epoch best",
            last.epoch,
            short(last.test_loss),
            steps(last),
            best.epoch,
            short(best.test_loss),
            steps(best)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_last_epoch_that_is_worse_by_more_than_a_twentieth_is_told() {
        let note = |losses: &[f64]| {
            let record = |(i, &test_loss)| Record { epoch: i + 1, test_loss, ..Record::default() };
            better_epoch("one", &losses.iter().enumerate().map(record).collect::<Vec<_>>())
        };
        assert_eq!([note(&[]), note(&[f64::NAN]), note(&[3.0, 1.0, 1.04])], [None, None, None]);
        assert_eq!([note(&[-3.0, -100.0, -96.0]), note(&[2.0, 1.0])], [None, None]);
        for losses in [[3.0, 1.0, 1.06], [1.0, -2.0, -1.0], [f64::NAN, 2.0, f64::NAN]] {
            assert!(note(&losses).expect("a note").contains("That of epoch 2 had "));
        }
    }
}
