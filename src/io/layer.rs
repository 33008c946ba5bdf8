//! Splits what a user names into a file and a layer inside of it: `beauty.exr:diffuse` is the layer `diffuse` of `beauty.exr`.
//!
//! A file whose own name holds the colon is that file, and so is a path of Windows with its drive.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::sha256_of_file;
use crate::core::error::Result;

/// What stands between a file and the name of its layer.
const SEPARATOR: char = ':';

/// The file that a path names, and the layer that is meant of it.
///
/// What exists is itself. Else the longest beginning of the path that is a file and stands before a colon is the file.
pub(super) fn locate(path: &Path) -> (&Path, Option<&str>) {
    split(path, Path::is_file)
}

/// The file that is read of what a user names.
pub fn file_of_input(path: &Path) -> &Path {
    locate(path).0
}

/// As [`locate`], of a beginning of another kind.
pub(super) fn split(path: &Path, is_wanted: impl Fn(&Path) -> bool) -> (&Path, Option<&str>) {
    if path.symlink_metadata().is_ok() {
        return (path, None);
    }
    let text = path.to_str().unwrap_or_default();
    let before = |&(place, _): &(usize, &str)| is_wanted(Path::new(&text[..place]));
    match text.rmatch_indices(SEPARATOR).find(before) {
        Some((place, colon)) => (Path::new(&text[..place]), Some(&text[place + colon.len()..])),
        None => (path, None),
    }
}

/// The path of a layer in what a path names: a file, a folder or a pattern.
pub fn with_layer(path: &Path, layer: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(SEPARATOR.to_string());
    name.push(layer);
    name.into()
}

/// Whether a user names a folder, or a layer of the images in one.
pub fn names_folder(path: &Path) -> bool {
    path.is_dir() || split(path, Path::is_dir).1.is_some()
}

/// The name of a file without its extension, for what becomes of it: with its layer, if one is named.
pub fn stem_of_input(path: &Path) -> String {
    let (file, layer) = locate(path);
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    // What a layer is called may be no name of a file.
    let plain = |layer: &str| layer.replace(|c: char| !(c.is_alphanumeric() || "._-+ ".contains(c)), "_");
    layer.map_or_else(|| stem.clone().into_owned(), |layer| format!("{stem}.{}", plain(layer)))
}

/// As [`sha256_of_file`]; none of what is no file, such as a pipe, which can be read once only.
///
/// # Errors
/// As [`sha256_of_file`].
pub fn sha256_of_input(path: &Path) -> Result<Option<String>> {
    locate(path).0.is_file().then(|| sha256_of_file(path)).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_exists_is_itself_and_else_the_longest_file_before_a_colon() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["a.exr", "a.exr:left", "b:c.exr", "über.exr"] {
            std::fs::write(path(name), name).unwrap();
        }
        assert_eq!(locate(&path("a.exr")), (path("a.exr").as_path(), None));
        assert_eq!(locate(&path("a.exr:left")), (path("a.exr:left").as_path(), None), "a file of this name");
        assert_eq!(locate(&path("a.exr:right.RGB")), (path("a.exr").as_path(), Some("right.RGB")));
        assert_eq!(locate(&path("a.exr:left:x")), (path("a.exr:left").as_path(), Some("x")));
        assert_eq!(locate(&path("b:c.exr:x")), (path("b:c.exr").as_path(), Some("x")));
        assert_eq!(locate(&path("über.exr:größe")), (path("über.exr").as_path(), Some("größe")));
        assert_eq!(locate(&path("a.exr:")), (path("a.exr").as_path(), Some("")));
        for absent in ["none.exr:x", "C:\\photos\\a.exr", ":", ""] {
            assert_eq!(locate(Path::new(absent)), (Path::new(absent), None), "{absent}");
        }
    }

    #[test]
    fn a_layer_names_what_becomes_of_it_and_tells_it_from_others() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.exr");
        std::fs::write(&file, "contents").unwrap();
        let layer = with_layer(&file, "left/diffuse");
        assert_eq!(
            (stem_of_input(&file), stem_of_input(&layer)),
            ("a".to_owned(), "a.left_diffuse".to_owned())
        );
        let whole = sha256_of_input(&file).unwrap().unwrap();
        assert_eq!(sha256_of_input(&layer).unwrap().unwrap(), format!("{whole}:left/diffuse"));
        assert_eq!(sha256_of_input(folder.path()).unwrap(), None);
    }
}
