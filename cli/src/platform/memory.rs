//! Memory limit of this process.

use std::fs::read_to_string;
use std::path::{Path, PathBuf};

/// Memory limit of this process, in bytes: the smallest of the machine's memory and the limits of
/// the control groups. 32 GB if all are unknown.
pub fn of_this_machine() -> f64 {
    const UNKNOWN: f64 = 32e9;
    let groups = read_to_string("/proc/self/cgroup").unwrap_or_default();
    let limits =
        limit_files(&groups).filter_map(|path| read_to_string(path).ok()?.trim().parse().ok());
    let machine = read_to_string("/proc/meminfo").ok().and_then(|text| total(&text));
    limits.chain(machine).reduce(f64::min).unwrap_or(UNKNOWN)
}

/// Files with the memory limits of the control groups of a process, and of the groups that contain
/// them. `groups` is the text of its `/proc/self/cgroup`: lines `0::PATH` by version 2, lines
/// `NUMBER:CONTROLLERS:PATH` by version 1. In a container, the path may be that outside of it,
/// while the limits are those of the topmost group inside.
fn limit_files(groups: &str) -> impl Iterator<Item = PathBuf> {
    let files = |line: &str| {
        let mut parts = line.splitn(3, ':').skip(1);
        let (root, file) = match parts.next()? {
            "" => ("/sys/fs/cgroup", "memory.max"),
            names if names.split(',').any(|name| name == "memory") => {
                ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")
            }
            _ => return None,
        };
        let group = Path::new(parts.next()?.trim_start_matches('/'));
        Some(
            group
                .ancestors()
                .map(|group| Path::new(root).join(group).join(file))
                .collect::<Vec<_>>(),
        )
    };
    groups.lines().filter_map(files).flatten()
}

/// Total memory in `/proc/meminfo`, in bytes.
fn total(meminfo: &str) -> Option<f64> {
    let kib = meminfo
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:")?.trim().strip_suffix("kB"))?;
    kib.trim().parse().ok().map(|kib: f64| kib * 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mem_total_is_read_in_kb_and_this_machine_has_more_than_100_mb() {
        assert_eq!(total("MemFree:  7 kB\nMemTotal:       24576 kB\n"), Some(24576.0 * 1024.0));
        assert_eq!(total("MemTotal: much"), None);
        assert!(of_this_machine() > 1e8);
    }

    #[test]
    fn limits_of_both_versions_of_control_groups_are_those_of_the_group_and_its_parents() {
        let files = |groups: &str| {
            limit_files(groups).map(|path| path.display().to_string()).collect::<Vec<_>>()
        };
        let second = [
            "/sys/fs/cgroup/a/b/memory.max",
            "/sys/fs/cgroup/a/memory.max",
            "/sys/fs/cgroup/memory.max",
        ];
        assert_eq!(files("0::/a/b\n"), second);
        let first = ["job/memory.limit_in_bytes", "memory.limit_in_bytes"]
            .map(|end| format!("/sys/fs/cgroup/memory/{end}"));
        for groups in
            ["9:memory:/job\n", "12:cpu,cpuacct:/x\n4:hugetlb,memory:/job\n1:name=systemd:/y\n"]
        {
            assert_eq!(files(groups), first);
        }
        assert_eq!(
            files("0::/a/b\n3:memory:/job\n"),
            [&second[..], &first.each_ref().map(String::as_str)].concat()
        );
        assert!(files("").is_empty() && files("memory\n").is_empty());
    }
}
