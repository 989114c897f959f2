//! [`Folder`]: output folder, for example of a run. [`Folder::write`] replaces a file as a whole,
//! so readers never see a partial file.

use super::files;
use super::lock::Locked;
use super::memory::of_this_machine;
use super::terminal::{is_program, with_option};
use anyhow::{Context, Result, bail};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};

pub const SETTINGS: &str = "run.toml";
pub const CHECKPOINT: &str = "checkpoint.bin";
pub const METRICS: &str = "metrics.csv";
pub const METRICS_JSONL: &str = "metrics.jsonl";
/// TensorBoard reads files with `tfevents` in their name.
pub const EVENTS: &str = "events.out.tfevents.physgrad";
pub const POLICY: &str = "policy.safetensors";
pub const BEST_POLICY: &str = "best_policy.safetensors";
pub const INITIAL_POLICY: &str = "initial_policy.safetensors";
pub const LEARNING_CURVE: &str = "learning_curve.svg";
pub const TRAJECTORY: &str = "trajectory.csv";
pub const ANIMATION: &str = "animation.svg";
pub const NUMBERS: &str = "numbers.csv";
pub const REPORT: &str = "report.html";
/// Scene that `optimize` or `identify` writes beside the results.
pub const SCENE: &str = "scene.toml";
/// Records how a run of a comparison ended.
pub const END: &str = "end.toml";

/// Plan of a comparison, beside [`RUNS`] or beside the folders that contain [`RUNS`].
pub const COMPARISON: &str = "comparison.toml";

/// Subfolder with the runs of a comparison. Also the folder in which [`Folder::fresh`] creates
/// folders.
pub const RUNS: &str = "runs";

/// Largest size of a file of settings, in bytes. Parsing takes up to 100 times the memory of the
/// text.
pub const MAX_SETTINGS: usize = 1_000_000;

/// Lock file of a folder. Contains a description of the last process that locked the folder.
pub(super) const LOCK: &str = ".physgrad.lock";

/// Infix in the name of the folder of an earlier run: `<name>.previous-<number>`.
pub(super) const PREVIOUS: &str = ".previous-";

/// Files that a run and its report write.
pub(super) const RUN_FILES: [&str; 14] = [
    SETTINGS,
    CHECKPOINT,
    METRICS,
    METRICS_JSONL,
    EVENTS,
    POLICY,
    BEST_POLICY,
    INITIAL_POLICY,
    LEARNING_CURVE,
    TRAJECTORY,
    ANIMATION,
    NUMBERS,
    REPORT,
    END,
];

/// The [`RUN_FILES`] that only the holder of the lock writes. Other commands may write the
/// remaining [`RUN_FILES`] during the run.
pub(super) const LOCKED_FILES: [&str; 12] = [
    SETTINGS,
    CHECKPOINT,
    METRICS,
    METRICS_JSONL,
    EVENTS,
    POLICY,
    BEST_POLICY,
    INITIAL_POLICY,
    LEARNING_CURVE,
    TRAJECTORY,
    NUMBERS,
    END,
];

/// A folder that may not exist yet.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// The folder at this path. Creates nothing.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// The folder at this path.
    ///
    /// # Errors
    /// There is no such folder.
    pub fn existing(path: &Path) -> Result<Self> {
        if path.is_dir() {
            Ok(Self::at(path))
        } else {
            let (kind, hint) = match path.is_file() {
                true if is_program() => (
                    ErrorKind::NotADirectory,
                    ", only a file of this name; `train SCENE` writes the folder of a run, also for a policy without trained numbers",
                ),
                true => (ErrorKind::NotADirectory, ", only a file of this name"),
                false => (ErrorKind::NotFound, ""),
            };
            let text = format!("there is no folder {}{hint}", path.display());
            Err(io::Error::new(kind, text).into())
        }
    }

    /// The folder with this name inside this one. Creates nothing.
    ///
    /// A folder and its plan may come from somebody else. Results therefore stay inside it.
    ///
    /// # Errors
    /// The name has several parts or leads elsewhere, as `a/b` and `..` do, or it is that of a link.
    pub fn inside(&self, name: &str) -> Result<Self> {
        if !is_name(name) {
            bail!(
                "{}: {name:?} cannot be the name of a folder in it; allowed: one part of a path",
                self.path.display()
            );
        }
        let path = self.file(name);
        if path.is_symlink() {
            bail!(
                "{} is a link, which results would follow out of its folder; put the folder itself there",
                path.display()
            );
        }
        Ok(Self { path })
    }

    /// Creates the folder `runs/<name>`. If this path exists, creates `runs/<name>-2`, and so on.
    pub fn fresh(name: &str) -> Result<Self> {
        let runs = Self::at(RUNS);
        runs.create()?;
        for i in 1.. {
            let path = runs.file(&if i == 1 { name.into() } else { format!("{name}-{i}") });
            match files::create_folder(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => {
                    return Err(error)
                        .with_context(|| format!("cannot create the folder {}", path.display()));
                }
            }
        }
        unreachable!("some number is free")
    }

    /// Locks the folder at this path. Without a path, locks a [`fresh`](Self::fresh) folder.
    pub fn named(path: Option<&Path>, name: &str) -> Result<Locked> {
        Self::or_fresh(path.map(|path| Self::at(path).lock()).transpose()?, name)
    }

    /// Locks the folder at this path, if any, before a computation whose results it will contain.
    ///
    /// # Errors
    /// The folder holds a training. Another process has locked it, or it cannot be written.
    pub fn reserve(path: Option<&Path>) -> Result<Option<Locked>> {
        let Some(folder) = path.map(Self::at) else { return Ok(None) };
        let trainings = [(SETTINGS, "run"), (COMPARISON, "comparison")];
        if let Some((_, training)) = trainings.into_iter().find(|(file, _)| folder.has(file)) {
            bail!(
                "{} holds a {training}; choose another folder{}",
                folder.path.display(),
                with_option("--out")
            );
        }
        folder.lock().map(Some)
    }

    /// Returns the reserved folder, or locks a [`fresh`](Self::fresh) one.
    pub fn or_fresh(reserved: Option<Locked>, name: &str) -> Result<Locked> {
        reserved.map_or_else(|| Self::fresh(name)?.lock(), Ok)
    }

    /// Checks that none of these input files is one of the files that a command writes to the
    /// folder.
    pub fn check_inputs(&self, inputs: &[&Path], outputs: &[&str]) -> Result<()> {
        let written = outputs
            .iter()
            .filter_map(|name| fs::canonicalize(self.file(name)).ok())
            .collect::<Vec<_>>();
        match inputs
            .iter()
            .find(|input| fs::canonicalize(input).is_ok_and(|input| written.contains(&input)))
        {
            Some(input) => bail!(
                "the results would replace {}; choose another folder{}",
                input.display(),
                with_option("--out")
            ),
            None => Ok(()),
        }
    }

    /// Creates the folder unless it exists.
    pub fn create(&self) -> Result<()> {
        files::create_folders(&self.path).with_context(|| unwritable(&self.path))
    }

    /// Last part of the canonical path, or of the given path if canonicalization fails. Empty if
    /// the path has no last part, as in `/`.
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

    /// Returns whether the name of the folder contains [`PREVIOUS`], as that of a renamed earlier
    /// run does.
    pub fn is_previous(&self) -> bool {
        self.name().contains(PREVIOUS)
    }

    /// Sorted names of all files and folders in this folder, except the lock file.
    pub(super) fn entries(&self) -> Result<Vec<String>> {
        let read = || -> io::Result<Vec<String>> {
            let entries = fs::read_dir(&self.path)?;
            entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned())).collect()
        };
        let mut names =
            read().with_context(|| format!("cannot read the folder {}", self.path.display()))?;
        names.retain(|name| name != LOCK);
        names.sort();
        Ok(names)
    }

    /// Replaces a file. Readers find the old or the new file, even after a kill or a power loss.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        self.start(name, bytes).map(drop)
    }

    /// Replaces a file as [`write`](Folder::write) does. Returns the open file, to append to.
    pub fn start(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<File> {
        files::replace(&self.path, name, bytes.as_ref())
            .with_context(|| format!("cannot write {}", self.file(name).display()))
    }

    /// Replaces the file at this path, which a user chose, as [`write`](Folder::write) does.
    ///
    /// # Errors
    /// The path is not that of a file in an existing folder. It is that of a link, a device or
    /// another existing entry that is not a regular file: replacing it would destroy it, and
    /// following it may lead anywhere.
    pub fn write_at(path: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
        let shown = path.display();
        let name = path.file_name().and_then(OsStr::to_str);
        let name = name.with_context(|| format!("{shown}: it is not a name of a file"))?;
        if fs::symlink_metadata(path).is_ok_and(|found| !found.is_file()) {
            bail!("{shown}: it exists and is not a regular file; choose another name");
        }
        // The parent of a bare name is the empty path.
        let parent =
            path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Self::existing(parent)?.write(name, bytes)
    }

    /// Removes a file if it exists.
    pub fn remove(&self, name: &str) -> Result<()> {
        match fs::remove_file(self.file(name)) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(error).with_context(|| format!("cannot remove {}", self.file(name).display()))
            }
            _ => Ok(()),
        }
    }

    /// Removes the files whose names start with `prefix` and end with `suffix`. An earlier command
    /// may have written them.
    pub fn remove_all(&self, prefix: &str, suffix: &str) -> Result<()> {
        let is_old = |name: &&String| name.starts_with(prefix) && name.ends_with(suffix);
        self.entries()?.iter().filter(is_old).try_for_each(|name| self.remove(name))
    }

    /// Path of a file to read.
    ///
    /// # Errors
    /// There is no such file, or it is not a regular file but, for example, a folder or a pipe.
    /// Reading a pipe could block forever.
    pub fn readable(&self, name: &str) -> Result<PathBuf> {
        let path = self.file(name);
        let context = || format!("cannot read {}", path.display());
        if !fs::metadata(&path).with_context(context)?.is_file() {
            bail!("{}: it is not a file", context());
        }
        Ok(path)
    }

    /// Contents of a file.
    ///
    /// # Errors
    /// As [`readable`](Folder::readable), or the file is larger than a quarter of the memory.
    pub fn read(&self, name: &str) -> Result<Vec<u8>> {
        // Contents are decoded into a few times their size.
        self.read_up_to(name, (of_this_machine() / 4.0) as usize)
    }

    /// Contents of a file of up to `most` bytes.
    ///
    /// # Errors
    /// As [`readable`](Folder::readable), or the file is larger.
    pub fn read_up_to(&self, name: &str, most: usize) -> Result<Vec<u8>> {
        let path = self.readable(name)?;
        let contents =
            files::read(&path, most).with_context(|| format!("cannot read {}", path.display()))?;
        contents.with_context(|| {
            format!("{} has more than {most} bytes, the limit of this file", path.display())
        })
    }
}

/// Returns whether this is the name of a file or folder: one part of a path, and not `..`.
pub fn is_name(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let is_single = matches!(parts.next(), Some(Component::Normal(part)) if part == OsStr::new(name))
        && parts.next().is_none();
    is_single && !name.contains(['/', '\\']) && !name.contains(char::is_control)
}

pub(super) fn unwritable(path: &Path) -> String {
    let (path, option) = (path.display(), with_option("--out"));
    format!("the output folder {path} cannot be written to; choose another{option}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_part_of_a_path() {
        for name in ["a", "batch=8+widths=64x64", ".._u", "a.b", "é", "...", " "] {
            assert!(is_name(name), "{name:?}");
        }
        for name in ["", ".", "..", "/", "a/", "a/b", "../a", "/a", "./a", "a\\b", "a\nb", "a\0"] {
            assert!(!is_name(name), "{name:?}");
        }
    }
}
