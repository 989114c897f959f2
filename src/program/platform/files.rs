//! Durable file operations. After a kill or a power loss, each replacement of a file is either
//! absent or complete.
//!
//! If the environment variable `PHYSGRAD_FILE_LOG` names a file, each elementary operation except a
//! removal appends one JSON line to it. The first operation of the process empties the file. The
//! test of power loss replays every prefix of such a log.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, RandomState};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::process;
use std::sync::{LazyLock, Mutex, PoisonError};

/// Replaces a file: writes a temporary file beside it, synchronizes it, and renames it.
///
/// Returns the open file, to append to. Replaces a symbolic link rather than following it.
pub fn replace(folder: &Path, name: &str, bytes: &[u8]) -> io::Result<File> {
    let (temporary, path) = (folder.join(temporary(name)), folder.join(name));
    let attempt = || -> io::Result<File> {
        let mut file = OpenOptions::new().write(true).create_new(true).open(&temporary)?;
        log(|| json!({ "create": temporary }));
        append(&mut file, &temporary, bytes)?;
        sync(&file, &temporary)?;
        rename(&temporary, &path)?;
        Ok(file)
    };
    attempt().inspect_err(|_| {
        // The temporary file may not exist.
        let _ = fs::remove_file(&temporary);
    })
}

/// Name of a temporary file that replaces the file `name`.
///
/// The name contains a random part, because processes in different containers may have equal ids.
fn temporary(name: &str) -> String {
    format!(".{name}.{}{:016x}.new", process::id(), RandomState::new().hash_one(name))
}

/// Name of the file that a temporary file replaces. None unless the given name has the form
/// `.name.digits.new` with hexadecimal digits, as from [`temporary`].
pub fn replaced_by(temporary: &str) -> Option<&str> {
    let (name, process) = temporary.strip_prefix('.')?.strip_suffix(".new")?.rsplit_once('.')?;
    (!process.is_empty() && process.bytes().all(|byte| byte.is_ascii_hexdigit())).then_some(name)
}

/// Appends bytes to an open file.
pub fn append(file: &mut File, path: &Path, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes)?;
    log(|| json!({ "append": path, "bytes": BASE64_STANDARD.encode(bytes) }));
    Ok(())
}

/// Waits until the contents of a file are on disk.
pub fn sync(file: &File, path: &Path) -> io::Result<()> {
    file.sync_all()?;
    log(|| json!({ "sync": path }));
    Ok(())
}

/// Renames a file or folder within its parent folder, and waits until the parent is on disk.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    log(|| json!({ "rename": from, "to": to }));
    sync_parent(to)
}

/// Creates a folder and its parents, and waits until they are on disk.
pub fn create_folders(path: &Path) -> io::Result<()> {
    match create_folder(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).ok_or(error)?;
            create_folders(parent)?;
            unless_exists(path, create_folder(path))
        }
        result => unless_exists(path, result),
    }
}

fn unless_exists(path: &Path, result: io::Result<()>) -> io::Result<()> {
    if path.is_dir() { Ok(()) } else { result }
}

/// Creates one folder, and waits until it is on disk.
pub fn create_folder(path: &Path) -> io::Result<()> {
    fs::create_dir(path)?;
    log(|| json!({ "create_folder": path }));
    sync_parent(path)
}

/// Waits until the entries of the parent folder are on disk.
fn sync_parent(path: &Path) -> io::Result<()> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // Only Unix can open a folder as a file.
    if cfg!(unix) {
        match File::open(parent)?.sync_all() {
            // Some network file systems cannot synchronize a folder.
            Err(error) if [ErrorKind::InvalidInput, ErrorKind::Unsupported].contains(&error.kind()) => {}
            synchronized => synchronized?,
        }
    }
    log(|| json!({ "sync_folder": parent }));
    Ok(())
}

fn log(operation: impl FnOnce() -> Value) {
    static LOG: LazyLock<Option<Mutex<File>>> = LazyLock::new(|| {
        let path = std::env::var_os("PHYSGRAD_FILE_LOG")?;
        Some(Mutex::new(File::create(path).expect("the log of file operations can be created")))
    });
    if let Some(file) = &*LOG {
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        writeln!(file, "{}", operation()).expect("the log of file operations can be written");
    }
}
