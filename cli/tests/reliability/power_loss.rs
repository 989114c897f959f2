//! Power loss at any time: the program logs its file operations, and the test replays each prefix
//! of the log.
//!
//! The disk model is pessimistic. After a power loss, either all folders have their current
//! entries, or all have the entries of their last synchronization. Either all files have their
//! current bytes, or all have the synchronized bytes, or all have the synchronized bytes and half
//! of the rest.
#![cfg(unix)]

use crate::running::{SMALL, physgrad};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Component, Path, PathBuf};
use tempfile::TempDir;

/// Entries of a folder: names and indices of nodes.
type Names = BTreeMap<String, usize>;

/// Folder or file, with its current contents (`now`) and those of its last synchronization
/// (`synced`).
#[derive(Clone)]
enum Node {
    Folder { now: Names, synced: Names },
    File { now: Vec<u8>, synced: Vec<u8> },
}

/// Files and folders after a power loss. A folder has the value `None`.
type Tree = BTreeMap<PathBuf, Option<Vec<u8>>>;

/// Unsynchronized bytes that remain after a power loss.
#[derive(Clone, Copy)]
enum Bytes {
    All,
    None,
    Half,
}

/// Model of the disk.
#[derive(Clone)]
struct Disk {
    /// Path of the root folder.
    root: PathBuf,
    /// Folders and files. The first node is the root folder.
    nodes: Vec<Node>,
}

impl Disk {
    /// Returns the current contents of a folder without lock files, all synchronized.
    fn of(root: &Path) -> Self {
        let mut disk = Self { root: root.canonicalize().expect("a folder"), nodes: Vec::new() };
        disk.load(root);
        disk
    }

    fn load(&mut self, path: &Path) -> usize {
        let number = self.nodes.len();
        if path.is_dir() {
            self.nodes.push(Node::Folder { now: Names::new(), synced: Names::new() });
            let entries = fs::read_dir(path)
                .expect("a folder")
                .map(|entry| entry.expect("an entry").file_name());
            let names: Names = entries
                .map(|name| (name.to_string_lossy().into_owned(), self.load(&path.join(name))))
                .filter(|(name, _)| name != ".physgrad.lock")
                .collect();
            self.nodes[number] = Node::Folder { now: names.clone(), synced: names };
        } else {
            let bytes = fs::read(path).expect("a file");
            self.nodes.push(Node::File { now: bytes.clone(), synced: bytes });
        }
        number
    }

    fn find(&self, path: &Path) -> usize {
        // Relative paths start at the root folder, in which the program runs.
        let inside = path.strip_prefix(&self.root).unwrap_or(path);
        inside.components().fold(0, |node, part| match (&self.nodes[node], part) {
            (_, Component::CurDir) => node,
            (Node::Folder { now, .. }, Component::Normal(name)) => now[&*name.to_string_lossy()],
            _ => panic!("{}", path.display()),
        })
    }

    /// Returns the current names in the parent folder, and the file name.
    fn parent(&mut self, path: &Path) -> (&mut Names, String) {
        let parent = self.find(path.parent().expect("a parent"));
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        match &mut self.nodes[parent] {
            Node::Folder { now, .. } => (now, name),
            Node::File { .. } => panic!("{}", path.display()),
        }
    }

    fn add(&mut self, path: &Path, node: Node) {
        self.nodes.push(node);
        let number = self.nodes.len() - 1;
        let (names, name) = self.parent(path);
        names.insert(name, number);
    }

    fn replay(&mut self, operation: &Value) {
        let path = |key: &str| operation[key].as_str().map(PathBuf::from);
        if let Some(path) = path("create_folder") {
            self.add(&path, Node::Folder { now: Names::new(), synced: Names::new() });
        } else if let Some(path) = path("create") {
            self.add(&path, Node::File { now: Vec::new(), synced: Vec::new() });
        } else if let Some(path) = path("append") {
            let bytes = BASE64_STANDARD
                .decode(operation["bytes"].as_str().expect("bytes"))
                .expect("base64");
            let file = self.find(&path);
            match &mut self.nodes[file] {
                Node::File { now, .. } => now.extend(bytes),
                Node::Folder { .. } => panic!("{}", path.display()),
            }
        } else if let Some(from) = path("rename") {
            let (names, name) = self.parent(&from);
            let node = names.remove(&name).expect("a name");
            let (names, name) = self.parent(&path("to").expect("a path"));
            names.insert(name, node);
        } else if let Some(path) = path("sync").or_else(|| path("sync_folder")) {
            let node = self.find(&path);
            match &mut self.nodes[node] {
                Node::Folder { now, synced } => synced.clone_from(now),
                Node::File { now, synced } => synced.clone_from(now),
            }
        } else {
            panic!("{operation}");
        }
    }

    fn after_power_loss(&self, keeps_names: bool, bytes: Bytes) -> Tree {
        let mut tree = Tree::new();
        self.collect(0, Path::new(""), keeps_names, bytes, &mut tree);
        tree
    }

    fn collect(&self, node: usize, path: &Path, keeps_names: bool, bytes: Bytes, tree: &mut Tree) {
        match &self.nodes[node] {
            Node::Folder { now, synced } => {
                tree.insert(path.to_owned(), None);
                for (name, &node) in if keeps_names { now } else { synced } {
                    self.collect(node, &path.join(name), keeps_names, bytes, tree);
                }
            }
            Node::File { now, synced } => {
                let length = match bytes {
                    Bytes::All => now.len(),
                    Bytes::None => synced.len(),
                    Bytes::Half => (synced.len() + now.len()) / 2,
                };
                tree.insert(path.to_owned(), Some(now[..length].to_vec()));
            }
        }
    }
}

/// Returns all states that a power loss can leave during the operations in `log`, which start from
/// `disk`.
fn states(mut disk: Disk, log: &[Value]) -> BTreeSet<Tree> {
    let mut states = BTreeSet::new();
    for operation in [None].into_iter().chain(log.iter().map(Some)) {
        operation.into_iter().for_each(|operation| disk.replay(operation));
        for keeps_names in [true, false] {
            states.extend(
                [Bytes::All, Bytes::None, Bytes::Half]
                    .map(|bytes| disk.after_power_loss(keeps_names, bytes)),
            );
        }
    }
    states
}

fn write(tree: &Tree, root: &Path) {
    for (path, contents) in tree {
        match contents {
            None => fs::create_dir_all(root.join(path)).expect("a folder"),
            Some(bytes) => fs::write(root.join(path), bytes).expect("a file"),
        }
    }
}

/// Runs the program in the folder. Returns its messages on failure.
fn run(folder: &Path, args: &[&str]) -> Result<(), String> {
    let output = physgrad(args).args(SMALL).current_dir(folder).output().expect("the command runs");
    if output.status.success() {
        Ok(())
    } else {
        Err(String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

/// Folder in which a command ran, its contents before, and the logged file operations.
struct Scenario {
    folder: TempDir,
    before: Disk,
    log: Vec<Value>,
}

impl Scenario {
    /// Runs `first`, if given. Then runs `command` and records its file operations.
    fn record(first: Option<&[&str]>, command: &[&str]) -> Self {
        let folder = TempDir::new().expect("a folder");
        let logs = TempDir::new().expect("a folder");
        if let Some(first) = first {
            run(folder.path(), first).expect("the first command succeeds");
        }
        let before = Disk::of(folder.path());
        let log = logs.path().join("log");
        let mut recorded = physgrad(command);
        recorded
            .args(SMALL)
            .current_dir(folder.path())
            .env("PHYSGRAD_FILE_LOG", &log)
            .assert()
            .success();
        let log = fs::read_to_string(log).expect("a log");
        let log =
            log.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON")).collect();
        Self { folder, before, log }
    }

    /// Returns a file as the complete command leaves it.
    fn file(&self, path: &str) -> Vec<u8> {
        fs::read(self.folder.path().join(path)).expect(path)
    }

    /// Recovers from each state in a separate folder. Returns the number of states, and a message
    /// for each failed recovery.
    fn recover(&self, recover: &dyn Fn(&Path) -> Result<(), String>) -> (usize, Vec<String>) {
        let states = states(self.before.clone(), &self.log);
        let failed = states.iter().filter_map(|tree| {
            let folder = TempDir::new().expect("a folder");
            write(tree, folder.path());
            let names: Vec<_> = tree
                .iter()
                .map(|(path, file)| (path.display().to_string(), file.as_ref().map(Vec::len)))
                .collect();
            recover(folder.path()).err().map(|error| format!("{error}\nfrom {names:?}"))
        });
        (states.len(), failed.collect())
    }

    fn assert_recovers(&self, recover: &dyn Fn(&Path) -> Result<(), String>) {
        let (states, failed) = self.recover(recover);
        println!("{} operations, {states} states", self.log.len());
        assert!(
            states > self.log.len() / 2,
            "only {states} states for {} operations",
            self.log.len()
        );
        assert!(failed.is_empty(), "{} of {states} states: {}", failed.len(), failed[0]);
    }
}

fn same(folder: &Path, path: &str, expected: &[u8]) -> Result<(), String> {
    let found = fs::read(folder.join(path)).map_err(|error| format!("{path}: {error}"))?;
    if found == expected { Ok(()) } else { Err(format!("{path} differs")) }
}

/// Resumes the run, or starts it if its settings file is missing.
fn go_on(folder: &Path, start: &[&str]) -> Result<(), String> {
    if folder.join("run/run.toml").exists() {
        run(
            folder,
            &[
                "train",
                "cart_pole",
                "--out",
                "run",
                "--resume",
                "--epochs",
                "2",
                "--save-every",
                "0",
            ],
        )
    } else {
        run(folder, start)
    }
}

const TRAIN: [&str; 8] =
    ["train", "cart_pole", "--out", "run", "--epochs", "2", "--save-every", "0"];

#[test]
fn a_training_gives_the_same_policy_after_any_power_loss() {
    let scenario = Scenario::record(None, &TRAIN);
    let policy = scenario.file("run/policy.safetensors");
    let recover = |folder: &Path| {
        go_on(folder, &TRAIN)?;
        same(folder, "run/policy.safetensors", &policy)
    };
    scenario.assert_recovers(&recover);

    // Without synchronization of files, recovery fails from some states.
    let log =
        scenario.log.iter().filter(|operation| operation.get("sync").is_none()).cloned().collect();
    let unsafe_scenario = Scenario { log, ..Scenario::record(None, &TRAIN) };
    assert!(!unsafe_scenario.recover(&recover).1.is_empty());
}

#[test]
fn a_resumed_training_gives_the_same_policy_after_any_power_loss() {
    let first = ["train", "cart_pole", "--out", "run", "--epochs", "1"];
    let resume =
        ["train", "cart_pole", "--out", "run", "--resume", "--epochs", "2", "--save-every", "0"];
    let scenario = Scenario::record(Some(&first), &resume);
    let policy = scenario.file("run/policy.safetensors");
    scenario.assert_recovers(&|folder| {
        run(folder, &resume)?;
        same(folder, "run/policy.safetensors", &policy)
    });
}

#[test]
fn renaming_an_earlier_run_loses_no_policy_after_any_power_loss() {
    let second = ["train", "cart_pole", "--out", "run", "--epochs", "2", "--seed", "1"];
    let scenario =
        Scenario::record(Some(&["train", "cart_pole", "--out", "run", "--epochs", "2"]), &second);
    let [old, new] =
        ["run.previous-1", "run"].map(|run| scenario.file(&format!("{run}/policy.safetensors")));
    scenario.assert_recovers(&|folder| {
        let is_moved = folder.join("run.previous-1").exists();
        same(
            folder,
            if is_moved { "run.previous-1/policy.safetensors" } else { "run/policy.safetensors" },
            &old,
        )?;
        if is_moved {
            go_on(folder, &second)?
        } else {
            run(folder, &second)?
        }
        same(folder, "run.previous-1/policy.safetensors", &old)?;
        same(folder, "run/policy.safetensors", &new)
    });
}

#[test]
#[ignore = "long: two hundred recoveries"]
fn a_comparison_gives_the_same_policies_after_any_power_loss() {
    let compare = [
        "compare",
        "cart_pole",
        "--fields",
        "R,C",
        "--seeds",
        "1",
        "--epochs",
        "1",
        "--threads",
        "1",
        "--out",
        "both",
    ];
    let scenario = Scenario::record(None, &compare);
    let paths = ["R-0", "C-0"].map(|run| format!("both/runs/{run}/policy.safetensors"));
    let policies = paths.each_ref().map(|path| scenario.file(path));
    scenario.assert_recovers(&|folder| {
        run(folder, &compare)?;
        paths.iter().zip(&policies).try_for_each(|(path, policy)| same(folder, path, policy))?;
        fs::metadata(folder.join("both/summary.csv")).map(drop).map_err(|error| error.to_string())
    });
}
