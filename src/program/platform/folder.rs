//! [`Folder`]: folder of a run. A file is replaced as a whole, so readers never see half of it.

use super::files;
use super::lock::Locked;
use anyhow::{Context, Result, bail};
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

pub const SETTINGS: &str = "run.toml";
pub const CHECKPOINT: &str = "checkpoint.bin";
pub const METRICS: &str = "metrics.csv";
pub const POLICY: &str = "policy.safetensors";
pub const LEARNING_CURVE: &str = "learning_curve.svg";
pub const TRAJECTORY: &str = "trajectory.csv";
pub const ANIMATION: &str = "animation.svg";
pub const REPORT: &str = "report.html";

/// Where a comparison keeps its runs.
pub const RUNS: &str = "runs";

/// The file whose lock a process holds while it writes to the folder. It names the process.
pub(super) const LOCK: &str = ".physgrad.lock";

/// Between the name of a folder and a number: an earlier run.
pub(super) const PREVIOUS: &str = ".previous-";

/// All that a run writes, and the report on it.
pub(super) const RUN_FILES: [&str; 8] = [SETTINGS, CHECKPOINT, METRICS, POLICY, LEARNING_CURVE, TRAJECTORY, ANIMATION, REPORT];

/// Files that only the process that holds the lock writes. Other commands write the rest to a run under way, too.
pub(super) const LOCKED_FILES: [&str; 6] = [SETTINGS, CHECKPOINT, METRICS, POLICY, LEARNING_CURVE, TRAJECTORY];

/// A folder, which may not exist yet.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// The folder at this path. Nothing is made.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// A folder that must exist.
    pub fn existing(path: &Path) -> Result<Self> {
        if path.is_dir() { Ok(Self::at(path)) } else { bail!("there is no folder {}", path.display()) }
    }

    /// A new folder `runs/<name>`, or `runs/<name>-2` and so on if that exists.
    pub fn fresh(name: &str) -> Result<Self> {
        let runs = Self::at(RUNS);
        runs.create()?;
        for i in 1.. {
            let path = runs.file(&if i == 1 { name.into() } else { format!("{name}-{i}") });
            match files::create_folder(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error).with_context(|| format!("cannot make the folder {}", path.display())),
            }
        }
        unreachable!("there are enough numbers")
    }

    /// The folder at this path, or a new one of this name in `runs`; locked.
    pub fn named(path: Option<&Path>, name: &str) -> Result<Locked> {
        path.map_or_else(|| Self::fresh(name), |path| Ok(Self::at(path)))?.lock()
    }

    /// Makes the folder, unless it exists.
    pub(super) fn create(&self) -> Result<()> {
        files::create_folders(&self.path).with_context(|| unwritable(&self.path))
    }

    /// Last part of the path.
    pub fn name(&self) -> String {
        let whole = fs::canonicalize(&self.path).unwrap_or_else(|_| self.path.clone());
        whole.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    pub fn has(&self, name: &str) -> bool {
        self.file(name).exists()
    }

    /// Whether an earlier run was moved here.
    pub fn is_previous(&self) -> bool {
        self.name().contains(PREVIOUS)
    }

    /// Names of the files and folders in it but for the lock, in order.
    pub(super) fn entries(&self) -> Result<Vec<String>> {
        let read = || -> io::Result<Vec<String>> {
            let entries = fs::read_dir(&self.path)?;
            entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned())).collect()
        };
        let mut names = read().with_context(|| format!("cannot read the folder {}", self.path.display()))?;
        names.retain(|name| name != LOCK);
        names.sort();
        Ok(names)
    }

    /// Replaces a file: a reader finds the old or the new, also after a kill or a power loss.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        self.start(name, bytes).map(drop)
    }

    /// As [`write`](Folder::write), and returns the file for what follows.
    pub fn start(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<File> {
        files::replace(&self.path, name, bytes.as_ref()).with_context(|| format!("cannot write {}", self.file(name).display()))
    }

    /// Path of a file to read.
    ///
    /// # Errors
    /// There is no such file, or it is a pipe or folder: a pipe may have no writer.
    pub fn readable(&self, name: &str) -> Result<PathBuf> {
        let path = self.file(name);
        let context = || format!("cannot read {}", path.display());
        if !fs::metadata(&path).with_context(context)?.is_file() {
            bail!("{}: it is not a file", context());
        }
        Ok(path)
    }

    pub fn read(&self, name: &str) -> Result<Vec<u8>> {
        let path = self.readable(name)?;
        fs::read(&path).with_context(|| format!("cannot read {}", path.display()))
    }
}

pub(super) fn unwritable(path: &Path) -> String {
    format!("the output folder {} cannot be written to; choose another with --out", path.display())
}
