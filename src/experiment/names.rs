//! What is compared is called in tables as its file is.

use std::path::{Path, PathBuf};

/// The file of a training's model: its folder says more.
const MODEL_FILE: &str = "model.safetensors";

/// The name of a file or folder, or its path where another of them has the same name.
pub fn name_among(all: &[PathBuf], path: &Path) -> String {
    let name = name_of(path);
    match all.iter().filter(|other| name_of(other) == name).count() {
        1 => name,
        _ => path.to_string_lossy().into_owned(),
    }
}

/// The name of a file or folder, with its folder's where it says little.
pub fn name_of(path: &Path) -> String {
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let own = name(path).unwrap_or_else(|| path.display().to_string());
    match path.parent().and_then(name) {
        Some(folder) if own == MODEL_FILE => format!("{folder}/{own}"),
        _ => own,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_short_as_long_as_they_tell_files_apart() {
        let all = ["a/net.pth", "b/net.pth", "c/run/model.safetensors", "dataset"].map(PathBuf::from);
        let names: Vec<String> = all.iter().map(|path| name_among(&all, path)).collect();
        assert_eq!(names, ["a/net.pth", "b/net.pth", "run/model.safetensors", "dataset"]);
    }
}
