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
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;
use std::process;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

/// Age at which a temporary file is one of a killed process. Writing a file takes seconds.
const ABANDONED: Duration = Duration::from_secs(3600);

/// Replaces a file: writes a temporary file beside it, synchronizes it, and renames it.
///
/// Returns the open file, to append to. Replaces a symbolic link rather than following it. Keeps the
/// permissions of an earlier file. Removes the temporary files of this file that killed processes
/// left behind.
pub fn replace(folder: &Path, name: &str, bytes: &[u8]) -> io::Result<File> {
    let (temporary, path) = (folder.join(temporary(name)), folder.join(name));
    let attempt = || -> io::Result<File> {
        let mut file = OpenOptions::new().write(true).create_new(true).open(&temporary)?;
        log(|| json!({ "create": temporary }));
        if let Some(earlier) = fs::symlink_metadata(&path).ok().filter(fs::Metadata::is_file) {
            file.set_permissions(earlier.permissions())?;
        }
        append(&mut file, &temporary, bytes)?;
        sync(&file, &temporary)?;
        rename(&temporary, &path)?;
        Ok(file)
    };
    remove_abandoned(folder, name);
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

/// Removes old temporary files of the file `name`. Ignores errors: other processes may remove them
/// too, and they are only in the way of space.
fn remove_abandoned(folder: &Path, name: &str) {
    let now = SystemTime::now();
    let is_abandoned = |entry: &fs::DirEntry| {
        let modified = entry
            .metadata()
            .ok()
            .filter(fs::Metadata::is_file)
            .and_then(|file| file.modified().ok());
        modified
            .and_then(|modified| now.duration_since(modified).ok())
            .is_some_and(|age| age > ABANDONED)
    };
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_name().to_str().and_then(replaced_by) == Some(name) && is_abandoned(&entry) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Contents of a file, up to a largest number of bytes. None if it has more.
pub fn read(path: &Path, most: usize) -> io::Result<Option<Vec<u8>>> {
    let file = File::open(path)?;
    // Does not read a regular file that is too large.
    if file.metadata()?.len() > most as u64 {
        return Ok(None);
    }
    let mut bytes = Vec::new();
    file.take(1 + most as u64).read_to_end(&mut bytes)?;
    Ok(Some(bytes).filter(|bytes| bytes.len() <= most))
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
    loop {
        let result = match create_folder(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let parent =
                    path.parent().filter(|parent| !parent.as_os_str().is_empty()).ok_or(error)?;
                create_folders(parent)?;
                create_folder(path)
            }
            result => result,
        };
        if path.is_dir() {
            return Ok(());
        }
        // Another process may have renamed the folder that existed.
        let existed = matches!(&result, Err(error) if error.kind() == ErrorKind::AlreadyExists);
        let is_absent =
            matches!(fs::symlink_metadata(path), Err(error) if error.kind() == ErrorKind::NotFound);
        if !(existed && is_absent) {
            return result;
        }
    }
}

/// Creates one folder, and waits until it is on disk.
pub fn create_folder(path: &Path) -> io::Result<()> {
    fs::create_dir(path)?;
    log(|| json!({ "create_folder": path }));
    sync_parent(path)
}

/// Creates a folder with these files, given by their paths in it: writes a temporary folder beside
/// it, and renames it. After an error, removes the temporary folder.
///
/// # Errors
/// A file or folder cannot be written, for example on a full disk.
pub fn create_tree(path: &Path, files: &[(&str, String)]) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = path.with_file_name(temporary(&name));
    let attempt = || -> io::Result<()> {
        create_folder(&temporary)?;
        for (file, text) in files {
            let file = temporary.join(file);
            let (folder, name) =
                (file.parent().unwrap_or(&temporary), file.file_name().unwrap_or_default());
            create_folders(folder)?;
            replace(folder, &name.to_string_lossy(), text.as_bytes())?;
        }
        rename(&temporary, path)
    };
    attempt().inspect_err(|_| {
        // The temporary folder may not exist.
        let _ = fs::remove_dir_all(&temporary);
    })
}

/// Waits until the entries of the parent folder are on disk.
fn sync_parent(path: &Path) -> io::Result<()> {
    let parent =
        path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // Only Unix can open a folder as a file.
    if cfg!(unix) {
        match File::open(parent)?.sync_all() {
            // Some network file systems cannot synchronize a folder.
            Err(error)
                if [ErrorKind::InvalidInput, ErrorKind::Unsupported].contains(&error.kind()) => {}
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

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::TempDir;

    #[test]
    fn a_replacement_removes_the_old_temporary_files_of_its_file_only() {
        let dir = TempDir::new().expect("a folder");
        let old = SystemTime::now() - 2 * ABANDONED;
        let names =
            [".a.svg.1f.new", ".a.svg.2f.new", ".b.svg.1f.new", ".a.svg.new", "a.svg.1f.new"];
        for name in names {
            let file = File::create(dir.path().join(name)).expect("a file");
            file.set_modified(if name == names[1] { SystemTime::now() } else { old })
                .expect("a time");
        }
        replace(dir.path(), "a.svg", b"new").expect("a file");
        let exist = names.map(|name| dir.path().join(name).exists());
        assert_eq!(exist, [false, true, true, true, true]);
        assert_eq!(fs::read(dir.path().join("a.svg")).expect("a file"), b"new");
    }

    #[test]
    fn a_file_is_read_up_to_its_limit_and_a_sparse_terabyte_is_not() {
        let dir = TempDir::new().expect("a folder");
        let path = dir.path().join("file");
        fs::write(&path, b"123").expect("a file");
        assert_eq!(read(&path, 3).expect("a file").as_deref(), Some(&b"123"[..]));
        assert_eq!(read(&path, 2).expect("a file"), None);
        File::create(&path).and_then(|file| file.set_len(1 << 40)).expect("a sparse file");
        assert_eq!(read(&path, 1_000_000).expect("a file"), None);
    }
}
