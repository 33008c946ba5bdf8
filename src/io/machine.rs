//! Asks the system what room there is: memory, and disk where something is to be written.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::Builder;

use crate::core::error::{Error, Result};

/// Bytes of memory that this process can still take, where the system tells: what is free or can be freed, and what the
/// limit of its control group leaves.
pub fn available_memory_bytes() -> Option<u64> {
    let info = fs::read_to_string("/proc/meminfo").ok()?;
    let of_system = of_meminfo(&info, "MemAvailable:")?;
    let number = |name: &str| -> Option<u64> {
        fs::read_to_string(Path::new("/sys/fs/cgroup").join(name)).ok()?.trim().parse().ok()
    };
    let of_group =
        number("memory.max").map(|limit| limit.saturating_sub(number("memory.current").unwrap_or(0)));
    Some(of_group.map_or(of_system, |of_group| of_group.min(of_system)))
}

/// A line of `/proc/meminfo` in bytes.
fn of_meminfo(info: &str, key: &str) -> Option<u64> {
    let line = info.lines().find(|line| line.starts_with(key))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    kibibytes.checked_mul(1024)
}

/// Bytes that can still be written beside a path, where the system tells.
#[cfg(unix)]
pub fn free_disk_bytes(path: &Path) -> Option<u64> {
    let found = rustix::fs::statvfs(existing(path)).ok()?;
    found.f_bavail.checked_mul(found.f_frsize)
}

/// Bytes that can still be written beside a path, where the system tells.
#[cfg(not(unix))]
pub fn free_disk_bytes(_path: &Path) -> Option<u64> {
    None
}

/// Checks that files can be written in a folder, or that the folder can be made: writes one and removes it.
///
/// # Errors
/// [`Error::Io`] with the system's reason.
pub fn check_writable(folder: &Path) -> Result<()> {
    let there = existing(folder);
    let written = Builder::new().prefix(".udc-").suffix(".partial").tempfile_in(&there);
    written.map(|_| ()).map_err(|source| Error::io("write to", there, source))
}

/// The path, or the nearest above it that there is.
fn existing(path: &Path) -> PathBuf {
    let named = path.ancestors().find(|path| !path.as_os_str().is_empty() && path.exists());
    named.unwrap_or(Path::new(".")).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_line_of_a_key() {
        let info = "MemTotal:  16 kB\nMemAvailable:       8 kB\n";
        assert_eq!(of_meminfo(info, "MemAvailable:"), Some(8192));
        assert_eq!(of_meminfo(info, "MemFree:"), None);
        assert_eq!(of_meminfo("MemAvailable: many kB", "MemAvailable:"), None);
    }

    #[test]
    fn a_folder_that_is_not_there_is_judged_by_the_one_above() {
        let folder = tempfile::tempdir().unwrap();
        check_writable(&folder.path().join("a/b")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
        fs::write(folder.path().join("file"), "").unwrap();
        let message = check_writable(&folder.path().join("file/b")).unwrap_err().in_full();
        assert!(message.contains("cannot write to"), "{message}");
        #[cfg(unix)]
        assert!(free_disk_bytes(&folder.path().join("a/b")).is_some());
    }
}
