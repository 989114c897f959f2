//! [`Run`]: a training, in memory or in a folder.

use super::{Policy, Scene};
use crate::commands::report;
use crate::operations::session::{AnyRun, Epoch};
use crate::platform::folder::{CHECKPOINT, Folder, SETTINGS};
use crate::runs::run::{self, End, NoUpdate, Observer, SAVE_EVERY};
use crate::runs::saved;
use crate::scenes::source::SceneSource;
use anyhow::Result;
use physgrad::train::Record;
use std::path::{Path, PathBuf};
use toml::Value;

/// A training. Results and files are bit for bit those of `physgrad train`, except for times.
pub struct Run {
    scene: Scene,
    run: Box<dyn AnyRun>,
    threads: usize,
    folder: Option<PathBuf>,
}

impl Run {
    /// A training before its first epoch. With a policy, the training starts from the parameters of
    /// the policy. The scene of the training then has the section `policy` of the policy's scene.
    /// `threads` is the number of threads; results do not depend on it.
    ///
    /// # Errors
    /// A setting is invalid or not read by the field, or the policy does not fit the scene.
    pub fn new(scene: &Scene, policy: Option<&Policy>, threads: usize) -> Result<Self> {
        let mut scene = scene.clone();
        if let Some(policy) = policy {
            policy.check_meaning(&scene)?;
            scene = scene.with_policy(policy)?;
            let random = Policy::new(&scene, scene.scene.seed);
            let is_random = if scene.is_f64() {
                random.theta() == policy.theta()
            } else {
                random.rounded::<f32>() == policy.rounded::<f32>()
            };
            // The random policy of the seed is no setting of the run: `physgrad train` starts from
            // it too, unless the scene has an initial policy.
            if !is_random || scene.scene.initial_policy().is_some() {
                scene.scene = scene.scene.starting_from(policy.safetensors()?);
            }
        }
        scene.scene.check_field().map_err(|error| scene.source.located(&error))?;
        Ok(Self { run: scene.scene.open(threads)?, scene, threads, folder: None })
    }

    /// Opens the run in a folder, at its last checkpoint, with this number of threads.
    ///
    /// # Errors
    /// There is no run, or another version of physgrad made it. The settings or the checkpoint
    /// cannot be read.
    pub fn load(folder: &Path, threads: usize) -> Result<Self> {
        let place = Folder::existing(folder)?;
        let checked = saved::scene(&place)?;
        let scene =
            Scene { source: SceneSource::read(&place.readable(SETTINGS)?)?, scene: checked };
        let mut run = scene.scene.open(threads)?;
        saved::restore(&place, &scene.scene, &mut *run)?;
        Ok(Self { scene, run, threads, folder: Some(std::path::absolute(folder)?) })
    }

    /// The run of a [`checkpoint`](Self::checkpoint), with the settings of its scene. It has no folder.
    ///
    /// # Errors
    /// The checkpoint is that of other settings or of another version of physgrad, or is damaged.
    pub fn restored(scene: &Scene, checkpoint: &[u8], threads: usize) -> Result<Self> {
        let mut run = scene.scene.open(threads)?;
        run.restore(checkpoint, &scene.scene.identity())?;
        Ok(Self { run, scene: scene.clone(), threads, folder: None })
    }

    /// The complete state of the training, without its settings.
    pub fn checkpoint(&self) -> Vec<u8> {
        self.run.checkpoint(&self.scene.scene.identity())
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Absolute path of the folder of the run, if it has one.
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Records of the completed epochs.
    pub fn records(&self) -> &[Record] {
        self.run.records()
    }

    /// Returns true after the last epoch.
    pub fn is_done(&self) -> bool {
        self.run.is_done()
    }

    /// Sets the total number of epochs of a run that continues. The number may be smaller than the
    /// number of completed epochs.
    ///
    /// # Errors
    /// The learning rate decays over the epochs, or the number exceeds the range of the setting.
    pub fn set_epochs(&mut self, epochs: u64) -> Result<()> {
        // The scene refuses the largest integer too, and names its limit.
        let epochs = i64::try_from(epochs).unwrap_or(i64::MAX);
        let scene = self.scene.with([("epochs".to_owned(), Some(Value::Integer(epochs)))])?;
        let mut run = scene.scene.open(self.threads)?;
        run.restore(&self.checkpoint(), &scene.scene.identity())?;
        (self.scene, self.run) = (scene, run);
        Ok(())
    }

    /// Saves the run in a folder. Later calls of [`train`](Self::train) save there too. If the
    /// folder contains another run, or another state of this run, renames that folder and creates
    /// an empty one in its place.
    ///
    /// # Errors
    /// The folder cannot be written to, or is in use. It contains a comparison, a study, another
    /// run beside other files, or files of a run without settings. It contains another run, and is
    /// or contains the current folder.
    pub fn save(&mut self, folder: &Path) -> Result<()> {
        let locked = Folder::at(folder).lock()?;
        let saved = || locked.read(CHECKPOINT).ok();
        let is_own = saved().is_some_and(|saved| saved == self.checkpoint());
        let locked = if is_own { locked } else { locked.without_run()? };
        run::save(&locked, &self.scene.scene, &*self.run)?;
        self.folder = Some(std::path::absolute(folder)?);
        Ok(())
    }

    /// Trains up to the last epoch, or until the observer stops the run. Returns whether the run is
    /// complete. A run with a folder continues from the checkpoint in the folder, and saves there.
    ///
    /// # Errors
    /// A file cannot be written, the checkpoint cannot be restored, or the folder is in use. A run
    /// in a folder has completed more epochs than its setting `epochs`. Training diverged, with a
    /// [`TrainError`](physgrad::TrainError), or the run ended without an applied update.
    pub fn train(&mut self, observer: &mut dyn Observer) -> Result<bool> {
        let (scene, run) = (&self.scene.scene, &mut *self.run);
        let finished = match &self.folder {
            Some(folder) => {
                run::run(&Folder::at(folder).lock()?, scene, run, true, SAVE_EVERY, None, observer)?
            }
            None => run::in_memory(scene, run, observer),
        };
        let name = || {
            self.folder
                .as_ref()
                .map_or_else(|| "this run".into(), |folder| folder.display().to_string())
        };
        match finished.end {
            End::Complete => Ok(true),
            End::Interrupted => Ok(false),
            End::Failed(error) => Err(error),
            End::NoUpdate(None) => Err(NoUpdate(name()).into()),
            End::NoUpdate(Some(error)) => Err(error.context(NoUpdate(name()).to_string())),
        }
    }

    /// The policy with the current parameters. With `best`, the policy after the epoch with the
    /// lowest test loss. Until an epoch has a test loss that is a number, `best` selects the
    /// initial policy.
    ///
    /// # Errors
    /// The parameters cannot be serialized.
    pub fn policy(&self, best: bool) -> Result<Policy> {
        let epoch = if best { Epoch::Best } else { Epoch::Last };
        Policy::read(&self.scene, &self.run.safetensors(epoch, &self.scene.scene.about())?)
    }

    /// Chart of training and test loss by epoch, as SVG.
    pub fn losses(&self) -> String {
        report::losses(&self.scene.scene, &*self.run)
    }

    /// The page of `physgrad report`, as HTML.
    ///
    /// # Errors
    /// The state of the run cannot be copied.
    pub fn report(&self) -> Result<String> {
        let folder = self.folder.as_deref().map(|folder| Folder::at(folder).name());
        report::of_run(folder.as_deref(), &self.scene.scene, &*self.run)
    }
}
