//! The folder of a run: files that are either old or new, never half-written.

use anyhow::{Context, Result, bail};
use std::fs;
use std::io::{ErrorKind, Write};
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

/// All that a run writes, and the report on it.
const RUN_FILES: [&str; 8] = [SETTINGS, CHECKPOINT, METRICS, POLICY, LEARNING_CURVE, TRAJECTORY, ANIMATION, REPORT];

/// A folder that has been shown to be writable.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Makes the folder and writes to it once, so that a problem shows before training and not after.
    pub fn create(path: &Path) -> Result<Self> {
        let folder = Self { path: path.to_owned() };
        let attempt = || -> Result<()> {
            fs::create_dir_all(path)?;
            let probe = path.join(".physgrad-probe");
            fs::write(&probe, b"")?;
            fs::remove_file(&probe)?;
            Ok(())
        };
        attempt()
            .with_context(|| format!("the output folder {} cannot be written to; choose another with --out", path.display()))?;
        Ok(folder)
    }

    /// A folder that must be there.
    pub fn existing(path: &Path) -> Result<Self> {
        if path.is_dir() { Ok(Self { path: path.to_owned() }) } else { bail!("there is no folder {}", path.display()) }
    }

    /// A new folder `runs/<name>`, or `runs/<name>-2` and so on if that is taken.
    pub fn fresh(name: &str) -> Result<Self> {
        Self::create(Path::new(RUNS))?;
        for i in 1.. {
            let path = Path::new(RUNS).join(if i == 1 { name.into() } else { format!("{name}-{i}") });
            match fs::create_dir(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error).with_context(|| format!("cannot make the folder {}", path.display())),
            }
        }
        unreachable!("there are enough numbers")
    }

    /// Its own name, without the way there.
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

    /// Moves the files of a run that is already there into a sub-folder, so that nothing is overwritten. Returns where
    /// to.
    pub fn move_aside(&self) -> Result<Option<PathBuf>> {
        if !self.has(SETTINGS) {
            return Ok(None);
        }
        let free = (1..).map(|i| self.file(&format!("previous-{i}"))).find(|path| !path.exists());
        let aside = free.expect("there are enough numbers");
        fs::create_dir(&aside)?;
        for name in RUN_FILES.into_iter().filter(|name| self.has(name)) {
            fs::rename(self.file(name), aside.join(name))?;
        }
        Ok(Some(aside))
    }

    /// Writes a file beside its name and renames it: whoever reads it, or kills us, finds the old or the new.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        let (temporary, path) = (self.file(&format!(".{name}.new")), self.file(name));
        let attempt = || -> std::io::Result<()> {
            let mut file = fs::File::create(&temporary)?;
            file.write_all(bytes.as_ref())?;
            file.sync_all()?;
            fs::rename(&temporary, &path)
        };
        let written = attempt().with_context(|| format!("cannot write {}", path.display()));
        if written.is_err() {
            // It may not even be there.
            let _ = fs::remove_file(&temporary);
        }
        written
    }

    pub fn read(&self, name: &str) -> Result<Vec<u8>> {
        fs::read(self.file(name)).with_context(|| format!("cannot read {}", self.file(name).display()))
    }
}
