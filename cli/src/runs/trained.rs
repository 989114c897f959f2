//! [`Trained`]: the policy of a saved run, with the scene in which it is evaluated.

use crate::operations::evaluation::AnyEvaluation;
use crate::operations::session::Epoch;
use crate::platform::folder::{Folder, SETTINGS};
use crate::runs::saved;
use crate::scenes::source::SceneSource;
use crate::tasks::Scene;
use anyhow::{Result, bail};
use physgrad::Policy;
use std::collections::HashSet;
use std::path::PathBuf;

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
    /// Loads the policies of the runs in these folders, after the last or the best epoch.
    ///
    /// # Errors
    /// A folder has no run, or a run that cannot be restored. The runs have different tasks.
    pub fn load_all(paths: &[PathBuf], epoch: Epoch) -> Result<Vec<Self>> {
        let folders =
            paths.iter().map(|path| Folder::existing(path)).collect::<Result<Vec<_>>>()?;
        let names: HashSet<String> = folders.iter().map(Folder::name).collect();
        let are_distinct = names.len() == folders.len();
        let name = |folder: &Folder| {
            if are_distinct { folder.name() } else { folder.path().display().to_string() }
        };
        let runs = folders
            .iter()
            .map(|folder| Self::load(name(folder), folder, epoch))
            .collect::<Result<Vec<_>>>()?;
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
        scene.evaluation(&self.theta, seed)
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
        Ok(Self { name, source, scene, theta: run.theta(epoch) })
    }
}
