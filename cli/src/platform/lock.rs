//! [`Locked`]: a folder that this process has locked, alone or together with other processes.

use super::folder::{
    COMPARISON, Folder, INITIAL_POLICY, LOCK, LOCKED_FILES, PREVIOUS, RUN_FILES, RUNS, SETTINGS,
    unwritable,
};
use super::terminal::{is_program, print_message, program, with_option};
use super::{files, signals};
use anyhow::{Context, Result, bail};
use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Read, Write};
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time between two attempts to get a lock.
const RETRY_INTERVAL: Duration = Duration::from_millis(100);

/// Largest number of attempts to open a lock file whose folder other processes move.
const MOST_MOVES: usize = 100;

#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Exclusive,
    Shared,
}

impl Folder {
    /// Creates the folder if necessary, and locks it until the returned value is dropped or the
    /// process ends. On a file system without locks, prints a warning and does not lock the folder.
    ///
    /// # Errors
    /// Another process has locked the folder. The folder cannot be written to or locked. The lock
    /// file is a link or not a regular file.
    pub fn lock(self) -> Result<Locked> {
        self.try_lock()?.with_context(|| self.in_use())
    }

    /// Locks the folder as [`lock`](Folder::lock) does, but together with other processes that call
    /// this function.
    ///
    /// # Errors
    /// As [`lock`](Folder::lock), or the file system has no locks.
    pub fn share(self) -> Result<Locked> {
        self.try_to_hold(Mode::Shared)?.with_context(|| self.in_use())
    }

    fn in_use(&self) -> String {
        let (path, holder, option) = (self.path().display(), self.holder(), with_option("--out"));
        format!(
            "the folder {path} is in use by {holder}; wait until it ends, or choose another folder{option}"
        )
    }

    /// Locks the folder as [`lock`](Folder::lock) does, but waits while another process holds the
    /// lock. Returns None if a signal arrives before or during the wait.
    pub fn wait_and_lock(self) -> Result<Option<Locked>> {
        let mut reported = false;
        while signals::received().is_none() {
            if let Some(locked) = self.try_lock()? {
                return Ok(Some(locked));
            }
            if !reported {
                print_message(&format!(
                    "waiting for the folder {}, in use by {}",
                    self.path().display(),
                    self.holder()
                ));
                reported = true;
            }
            std::thread::sleep(RETRY_INTERVAL);
        }
        Ok(None)
    }

    /// Locks the folder. Returns None if another process holds the lock.
    pub fn try_lock(&self) -> Result<Option<Locked>> {
        self.try_to_hold(Mode::Exclusive)
    }

    /// Locks the folder in this mode. Returns None if another process holds the lock.
    fn try_to_hold(&self, mode: Mode) -> Result<Option<Locked>> {
        let mut moves = 0;
        loop {
            self.create()?;
            let path = self.file(LOCK);
            if fs::symlink_metadata(&path).is_ok_and(|metadata| !is_plain_file(&metadata)) {
                bail!("{} is a link or not a regular file; remove it", path.display());
            }
            let open =
                OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
            let mut file = match open {
                // A holder of the lock may have moved the folder between `create` and `open`.
                Err(error) if error.kind() == ErrorKind::NotFound && moves < MOST_MOVES => {
                    moves += 1;
                    continue;
                }
                open => open.with_context(|| unwritable(self.path()))?,
            };
            if !self.hold_file(&file, mode)? {
                return Ok(None);
            }
            let holder = own_description();
            let write = |file: &mut File| -> io::Result<()> {
                file.set_len(0)?;
                file.write_all(holder.as_bytes())
            };
            write(&mut file).with_context(|| unwritable(self.path()))?;
            let locked = Locked { folder: self.clone(), file };
            // The previous holder may have moved the folder between `open` and `try_lock`.
            if locked.is_in_place().with_context(|| unwritable(self.path()))? {
                return Ok(Some(locked));
            }
        }
    }

    /// Locks the file. Returns false if another process holds the lock. On a file system without
    /// locks, prints a warning and returns true.
    ///
    /// # Errors
    /// The file cannot be locked, or is to be shared on a file system without locks.
    fn hold_file(&self, file: &File, mode: Mode) -> Result<bool> {
        let held = match mode {
            Mode::Exclusive => file.try_lock(),
            Mode::Shared => file.try_lock_shared(),
        };
        match held {
            Ok(()) => Ok(true),
            Err(TryLockError::WouldBlock) => Ok(false),
            Err(TryLockError::Error(error)) if is_unsupported(&error) && mode == Mode::Shared => {
                bail!(
                    "the file system of {} has no locks, which --shard needs; choose a folder on another file system with --out",
                    self.path().display()
                )
            }
            Err(TryLockError::Error(error)) if is_unsupported(&error) => {
                print_message(&format!(
                    "warning: this file system has no locks; only one process may write to {}",
                    self.path().display()
                ));
                Ok(true)
            }
            Err(TryLockError::Error(error)) => Err(error)
                .with_context(|| format!("cannot lock the folder {}", self.path().display())),
        }
    }

    /// Description of the process that holds the lock, for messages.
    fn holder(&self) -> String {
        // The holder writes its description shortly after it takes the lock.
        for _ in 0..20 {
            let mut text = String::new();
            let read = File::open(self.file(LOCK))
                .and_then(|file| file.take(1000).read_to_string(&mut text));
            if read.is_ok() && !text.trim().is_empty() {
                return text.split_whitespace().collect::<Vec<_>>().join(" ");
            }
            std::thread::sleep(RETRY_INTERVAL / 10);
        }
        "another process".into()
    }
}

/// Returns whether this is the error of a file system without locks, for example of NFS without a
/// lock service.
fn is_unsupported(error: &io::Error) -> bool {
    /// Number of this error (ENOLCK) in the operating system. It has no [`ErrorKind`] of its own.
    const NO_LOCKS: i32 = if cfg!(target_os = "linux") { 37 } else { 77 };
    error.kind() == ErrorKind::Unsupported || error.raw_os_error() == Some(NO_LOCKS)
}

/// A folder that this process has locked, if the file system has locks.
#[derive(Debug)]
pub struct Locked {
    folder: Folder,
    file: File,
}

impl Deref for Locked {
    type Target = Folder;

    fn deref(&self) -> &Folder {
        &self.folder
    }
}

impl Locked {
    /// Returns whether the path still leads to the locked folder, with its lock file.
    ///
    /// # Errors
    /// The folder cannot be read.
    fn is_in_place(&self) -> io::Result<bool> {
        match fs::symlink_metadata(self.folder.file(LOCK)) {
            Ok(current) => Ok(is_same(&current, &self.file.metadata()?)),
            Err(error)
                if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&error.kind()) =>
            {
                Ok(false)
            }
            Err(error) => Err(error),
        }
    }

    /// Returns whether the folder or its lock file was removed, moved or replaced after it was
    /// locked. False if the folder cannot be read.
    pub fn is_gone(&self) -> bool {
        matches!(self.is_in_place(), Ok(false))
    }

    /// Checks that the folder is in place.
    ///
    /// # Errors
    /// The folder or its lock file was removed, moved or replaced after it was locked. The folder
    /// cannot be read.
    pub fn check(&self) -> Result<()> {
        let path = self.path().display();
        if self.is_in_place().with_context(|| format!("cannot read the folder {path}"))? {
            return Ok(());
        }
        bail!(
            "the folder {path}, or {LOCK} in it, was removed or replaced during the run; leave both in place while it runs"
        )
    }

    /// Removes the temporary files of [`LOCKED_FILES`] that a killed process left behind.
    pub fn clean(&self) -> Result<()> {
        for name in self.entries()? {
            if files::replaced_by(&name).is_some_and(|name| LOCKED_FILES.contains(&name)) {
                let path = self.folder.file(&name);
                fs::remove_file(&path)
                    .with_context(|| format!("cannot remove {}", path.display()))?;
            }
        }
        Ok(())
    }

    /// If the folder contains an earlier run, renames the folder, and locks a new empty one in its
    /// place. Otherwise returns the folder unchanged.
    ///
    /// # Errors
    /// The folder contains a comparison. It contains a run and files that are not part
    /// of a run. Without [`SETTINGS`], it contains files of a run other than temporary files and
    /// [`INITIAL_POLICY`]. The folder of a run is the current folder, contains the current folder,
    /// or cannot be renamed. Another process locks the new folder first.
    pub fn without_run(self) -> Result<Self> {
        let path = self.path().to_owned();
        let (run, other): (Vec<String>, Vec<String>) = self
            .entries()?
            .into_iter()
            .partition(|name| RUN_FILES.contains(&files::replaced_by(name).unwrap_or(name)));
        if let Some(name) = other.iter().find(|name| [RUNS, COMPARISON].contains(&name.as_str())) {
            bail!(
                "{} holds a comparison ({name}); choose another folder{}",
                path.display(),
                with_option("--out")
            );
        }
        if !run.iter().any(|name| name == SETTINGS) {
            // A process that is killed before it writes the settings may leave temporary files and
            // the initial policy.
            let foreign = run
                .iter()
                .find(|name| *name != INITIAL_POLICY && files::replaced_by(name).is_none());
            return match foreign {
                Some(name) => bail!(
                    "{} holds {name} but no {SETTINGS}, so it is not a run; remove the file, or choose another folder{}",
                    path.display(),
                    with_option("--out")
                ),
                None => Ok(self),
            };
        }
        if let Some(name) = other.first() {
            bail!(
                "{} holds a run and {name}, which is not part of the run; resume the run{}, or choose another folder{}",
                path.display(),
                with_option("--resume"),
                with_option("--out")
            );
        }
        let whole = fs::canonicalize(&path).with_context(|| unwritable(&path))?;
        if std::env::current_dir().is_ok_and(|here| here.starts_with(&whole)) {
            bail!(
                "{} holds a run and is the current folder, which cannot be moved; choose another folder{}",
                path.display(),
                with_option("--out")
            );
        }
        move_aside(&path, &whole)?;
        // The lock moved with the folder. Another process may lock the new folder first.
        Folder::at(&whole).create()?;
        Folder::at(&path).lock()?.without_run()
    }
}

/// Renames the folder of an earlier run, and prints its new path. `whole` is its absolute path, and
/// messages show `path`.
///
/// # Errors
/// The folder cannot be renamed.
fn move_aside(path: &Path, whole: &Path) -> Result<()> {
    let aside = aside(whole)?;
    let cannot = || {
        format!(
            "cannot rename the folder {} of the earlier run; choose another folder{}",
            path.display(),
            with_option("--out")
        )
    };
    files::rename(whole, &aside).with_context(cannot)?;
    let (from, aside) = (path.display(), aside.display());
    let hint = match is_program() {
        true => format!("; to resume it: {} train --resume --out {aside}", program()),
        false => String::new(),
    };
    print_message(&format!("moved the earlier run in {from} to {aside}{hint}"));
    Ok(())
}

/// First free path for the earlier run in the folder `whole`, beside it.
fn aside(whole: &Path) -> Result<PathBuf> {
    let free = (1..).map(|i| {
        let mut name = whole.as_os_str().to_owned();
        name.push(format!("{PREVIOUS}{i}"));
        PathBuf::from(name)
    });
    // `rename` never replaces a folder with contents. Replacing an empty folder loses nothing.
    let mut aside = free.filter(|path| fs::symlink_metadata(path).is_err());
    aside.next().context("some number is free")
}

/// Description of this process for the messages of others: id, machine and command line.
fn own_description() -> String {
    let command: Vec<_> =
        std::env::args_os().map(|part| part.to_string_lossy().into_owned()).collect();
    format!("process {}{} (`{}`)", std::process::id(), on_machine(), command.join(" "))
}

/// " on NAME" with the name of this machine, because several machines may share a folder. Empty if
/// the name is unknown.
fn on_machine() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    if name.trim().is_empty() { String::new() } else { format!(" on {}", name.trim()) }
}

/// Returns whether this is a regular file with a single hard link, which can be overwritten safely.
/// Links are counted only on Unix.
fn is_plain_file(file: &Metadata) -> bool {
    #[cfg(unix)]
    let names = std::os::unix::fs::MetadataExt::nlink(file);
    #[cfg(not(unix))]
    let names = 1;
    file.is_file() && names == 1
}

#[cfg(unix)]
fn is_same(a: &Metadata, b: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

/// Always true: on other systems, a folder that contains a locked file cannot be moved or removed.
#[cfg(not(unix))]
fn is_same(_: &Metadata, _: &Metadata) -> bool {
    true
}
