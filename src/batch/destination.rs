//! Where the results of one or several inputs go: to the file that the user names, or to files of a folder.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf, is_separator};

use crate::core::error::{Error, Result};
use crate::core::shard::Shard;
use crate::io::{Format, check_output, file_of_input, identity, names_folder, stem_of_input};

/// What the user names for the results, and how files are named in it if it is a folder.
#[derive(Clone, Copy, Debug)]
pub struct Destination<'a> {
    /// A file or a folder.
    pub path: &'a Path,
    /// The extension of files in a folder.
    pub extension: &'a str,
    /// Whether the user asked for that extension.
    pub is_asked: bool,
    /// Whether files that are there do not matter.
    pub accepts_existing: bool,
    /// Whose files must not be there: those of the other shards may be.
    pub shard: Shard,
}

/// A result before it has a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unplaced {
    /// Its file's name in a folder, without extension.
    pub name: String,
    /// What it is made of, for messages.
    pub source: String,
}

impl Unplaced {
    /// The result of one file, named as it.
    pub fn of_file(file: &Path) -> Self {
        Self { name: stem_of_input(file), source: file.display().to_string() }
    }
}

impl Destination<'_> {
    /// Names a file for what becomes of each file, before any work; `named` is what the user named for them.
    ///
    /// # Errors
    /// As [`place`](Self::place) and [`check_kept`].
    pub fn place_files(&self, files: &[PathBuf], named: &[PathBuf]) -> Result<Vec<PathBuf>> {
        let results: Vec<Unplaced> = files.iter().map(|file| Unplaced::of_file(file)).collect();
        let outputs = self.place(&results, named.iter().any(|input| names_folder(input)))?;
        check_kept(&outputs, files)?;
        Ok(outputs)
    }

    /// Names a file for each result, before any work; `in_folder` says that they belong to one whatever their number.
    ///
    /// A folder that is there, or a name that ends in a separator, is a folder for a single result too.
    ///
    /// # Errors
    /// When several results have one file, a file is there that may not be replaced, or one is named of another format than is
    /// asked for.
    pub fn place(&self, results: &[Unplaced], in_folder: bool) -> Result<Vec<PathBuf>> {
        let names_folder = self.path.is_dir() || ends_in_separator(self.path);
        let in_folder = in_folder || results.len() > 1;
        if in_folder && !names_folder && (self.path.exists() || Format::of_extension(self.path).is_ok()) {
            return Err(Error::Unsupported(format!(
                "several inputs, or those of a folder, need a folder to be written to, and {} names a file; write -o {}/",
                self.path.display(),
                self.path.with_extension("").display()
            )));
        }
        if !in_folder && !names_folder {
            let named = Format::of_extension(self.path)?;
            if self.is_asked && Format::of_extension(Path::new(&format!("a.{}", self.extension)))? != named {
                return Err(Error::Unsupported(format!(
                    "{} names a file that is no {}, which --format asks for in a folder: leave --format out, or name a folder",
                    self.path.display(),
                    self.extension
                )));
            }
            check_output(self.path, self.accepts_existing)?;
            return Ok(vec![self.path.to_owned()]);
        }
        let file = |result: &Unplaced| self.path.join(format!("{}.{}", result.name, self.extension));
        let files: Vec<PathBuf> = results.iter().map(file).collect();
        for (index, file) in files.iter().enumerate() {
            if let Some(other) = files[..index].iter().position(|earlier| earlier == file) {
                let (a, b) = (&results[other].source, &results[index].source);
                let reason = format!(
                    "{a} and {b} would both be written to {}: rename one, or write them to separate folders",
                    file.display()
                );
                return Err(Error::Unsupported(reason));
            }
        }
        if self.path.is_dir() {
            let own = self.shard.choose(files.iter().collect());
            own.into_iter().try_for_each(|file| check_output(file, self.accepts_existing))?;
        }
        Ok(files)
    }
}

/// Refuses outputs that are files which are read for them, by their own names or through links: whoever lets files be replaced does not
/// mean these.
///
/// # Errors
/// [`Error::Unsupported`] naming the first.
pub fn check_kept(outputs: &[PathBuf], read: &[impl AsRef<Path>]) -> Result<()> {
    let places = |input: &Path| [Some(identity(input)), input.canonicalize().ok()].into_iter().flatten();
    let read: BTreeSet<PathBuf> =
        read.iter().flat_map(|input| places(file_of_input(input.as_ref()))).collect();
    match outputs.iter().find(|output| read.contains(&identity(output))) {
        Some(output) => Err(Error::Unsupported(format!(
            "{} would be read and written over: name another file or folder with -o",
            output.display()
        ))),
        None => Ok(()),
    }
}

fn ends_in_separator(path: &Path) -> bool {
    path.to_string_lossy().ends_with(is_separator)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_results_go_to_a_folder_and_one_to_a_file() {
        let scratch = tempfile::tempdir().unwrap();
        let files = ["x/a.exr", "x/b.exr", "y/a.npy"].map(PathBuf::from);
        let place = |name: &str, files: &[PathBuf], accepts_existing| {
            let path = scratch.path().join(name);
            Destination {
                path: &path,
                extension: "png",
                is_asked: false,
                accepts_existing,
                shard: Shard::WHOLE,
            }
            .place_files(files, &[])
        };
        assert_eq!(place("a.tif", &files[..1], false).unwrap(), [scratch.path().join("a.tif")]);
        let placed = place("out", &files[..2], false).unwrap();
        assert_eq!(placed, ["out/a.png", "out/b.png"].map(|name| scratch.path().join(name)));
        assert_eq!(place("out/", &files[..1], false).unwrap(), placed[..1]);
        let said = place("a.tif", &files[..2], false).unwrap_err().to_string();
        assert!(said.contains("need a folder"), "{said}");
        let said = place("out/", &files, false).unwrap_err().to_string();
        assert!(said.contains("x/a.exr and y/a.npy would both be written to"), "{said}");
        std::fs::create_dir(scratch.path().join("out")).unwrap();
        std::fs::write(&placed[1], "there").unwrap();
        assert!(place("out", &files[..2], false).is_err());
        assert_eq!(place("out", &files[..2], true).unwrap(), placed);
        let (path, shard) = (scratch.path().join("out"), Shard { index: 0, count: 2 });
        let to =
            Destination { path: &path, extension: "png", is_asked: false, accepts_existing: false, shard };
        assert_eq!(to.place_files(&files[..2], &[]).unwrap(), placed, "the file of another shard is there");
    }

    /// By whatever path it is named, or a layer of it; an output that is not there is nobody's input.
    #[test]
    fn what_is_read_is_not_written_over() {
        let scratch = tempfile::tempdir().unwrap();
        let [a, b] = ["a.png", "b.png"].map(|name| scratch.path().join(name));
        std::fs::write(&a, "read").unwrap();
        let folder = scratch.path().to_owned();
        let to = |path| Destination {
            path,
            extension: "png",
            is_asked: false,
            accepts_existing: true,
            shard: Shard::WHOLE,
        };
        let again = scratch.path().join("..").join(scratch.path().file_name().unwrap()).join("a.png");
        for path in [&a, &again, &folder] {
            let said = to(path).place_files(std::slice::from_ref(&a), &[]).unwrap_err().to_string();
            assert!(said.contains("a.png would be read and written over"), "{said}");
        }
        assert!(
            to(&a).place_files(&[folder.join("a.png:left")], &[]).is_err(),
            "its other layers would be lost"
        );
        assert_eq!(to(&b).place_files(std::slice::from_ref(&a), &[]).unwrap(), std::slice::from_ref(&b));
    }

    /// A link that is written over is a link no more, and what it led to stays.
    #[cfg(unix)]
    #[test]
    fn what_is_read_through_a_link_is_not_written_over() {
        let scratch = tempfile::tempdir().unwrap();
        let [file, link, to_link] = ["a.png", "b.png", "c.png"].map(|name| scratch.path().join(name));
        std::fs::write(&file, "read").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        std::os::unix::fs::symlink(&link, &to_link).unwrap();
        for read in [&link, &to_link] {
            let said = check_kept(std::slice::from_ref(&file), &[read]).unwrap_err().to_string();
            assert!(said.contains("a.png would be read and written over"), "{said}");
            assert!(check_kept(std::slice::from_ref(read), &[read]).is_err());
        }
        check_kept(&[link], &[&file]).unwrap();
    }

    #[test]
    fn a_format_that_is_asked_for_is_that_of_the_file_that_is_named() {
        let scratch = tempfile::tempdir().unwrap();
        let place = |name: &str, extension: &str| {
            let path = &scratch.path().join(name);
            let to =
                Destination { path, extension, is_asked: true, accepts_existing: false, shard: Shard::WHOLE };
            to.place_files(&[PathBuf::from("x/a.exr")], &[])
        };
        assert_eq!(place("b.tiff", "tif").unwrap(), [scratch.path().join("b.tiff")]);
        assert_eq!(place("out/", "jpg").unwrap(), [scratch.path().join("out/a.jpg")]);
        let said = place("b.png", "jpg").unwrap_err().to_string();
        assert!(
            said.contains("b.png names a file that is no jpg") && said.contains("leave --format out"),
            "{said}"
        );
    }
}
