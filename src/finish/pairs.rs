//! Finds the colour matrix and the reference picture of every image, by name.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::batch::{Destination, Watcher, check_kept};
use crate::core::error::{Error, Result};
use crate::io::{expand_inputs, is_hidden, list_folder, sha256_of_input, stem_of_input, without_repeats};

/// Where the published dataset keeps its real captures, their colour matrices and the phone's own pictures.
const PUBLISHED: [&str; 3] = ["real_data/input", "real_data/CCM_txt", "real_data/jpg_ZTE"];

/// Where the colour matrices, or the reference pictures, of images are looked for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Companions {
    /// With the images: in the published dataset, where that is what is finished.
    #[default]
    OfImages,
    /// Nowhere.
    Nowhere,
    /// In a file for all images, or in a folder whose files belong to the images of the same name.
    At(PathBuf),
}

/// What is finished.
#[derive(Clone, Debug, Default)]
pub struct FinishInputs {
    /// Images, folders or patterns; also the folder of the published dataset, for its real captures.
    pub images: Vec<PathBuf>,
    /// Their colour matrices. Nowhere, those of cameras are left out as well.
    pub ccm: Companions,
    /// Their reference pictures.
    pub reference: Companions,
}

/// One picture to make.
pub(super) struct Job {
    pub(super) input: PathBuf,
    pub(super) ccm: Option<PathBuf>,
    pub(super) reference: Option<PathBuf>,
    pub(super) output: PathBuf,
    /// SHA-256 of the files, when they were first asked for.
    sha256: OnceLock<[Option<String>; 3]>,
}

impl Job {
    /// SHA-256 of the input, its colour matrix and its reference picture, which are read for it once; what is no file, such
    /// as a pipe, has none.
    pub(super) fn sha256(&self) -> Result<&[Option<String>; 3]> {
        if let Some(found) = self.sha256.get() {
            return Ok(found);
        }
        let of = |path: Option<&PathBuf>| path.map_or(Ok(None), |path| sha256_of_input(path));
        let found = [of(Some(&self.input))?, of(self.ccm.as_ref())?, of(self.reference.as_ref())?];
        Ok(self.sha256.get_or_init(|| found))
    }
}

impl FinishInputs {
    /// What to make of what; refuses what exists and pairs that are not complete before any work.
    ///
    /// # Errors
    /// When an image does not exist or has no companion where all have one, or an output may not be written.
    pub(super) fn jobs(&self, destination: &Destination<'_>, watcher: &dyn Watcher) -> Result<Vec<Job>> {
        let (inputs, ccm, reference) = self.sources()?;
        let files = without_repeats(expand_inputs(&inputs)?);
        let companions = [Companion::of(ccm.as_deref())?, Companion::of(reference.as_deref())?];
        let [ccms, references] = pair(&files, &companions, watcher)?;
        let outputs = destination.place_files(&files, &inputs)?;
        let belonging: Vec<&PathBuf> = ccms.iter().chain(&references).flatten().collect();
        check_kept(&outputs, &belonging)?;
        let with_companions = files.into_iter().zip(ccms).zip(references).zip(outputs);
        let job = |(((input, ccm), reference), output)| Job {
            input,
            ccm,
            reference,
            output,
            sha256: OnceLock::new(),
        };
        Ok(with_companions.map(job).collect())
    }

    /// Images, colour matrices and reference pictures, those of the published dataset spelled out.
    fn sources(&self) -> Result<(Vec<PathBuf>, Option<PathBuf>, Option<PathBuf>)> {
        let root = match &self.images[..] {
            [root] if root.join(PUBLISHED[0]).is_dir() => root,
            _ => return Ok((self.images.clone(), self.ccm.or(None), self.reference.or(None))),
        };
        let [captures, ccms, references] = PUBLISHED.map(|name| root.join(name));
        for (folder, companions, flag) in
            [(&ccms, &self.ccm, "--no-ccm"), (&references, &self.reference, "--no-reference")]
        {
            if *companions == Companions::OfImages && !folder.is_dir() {
                let reason = format!("{} is missing; unpack it there, or pass {flag}", folder.display());
                return Err(Error::Unsupported(reason));
            }
        }
        Ok((vec![captures], self.ccm.or(Some(ccms)), self.reference.or(Some(references))))
    }
}

impl Companions {
    /// Where they are looked for, given where they lie with the images.
    fn or(&self, of_images: Option<PathBuf>) -> Option<PathBuf> {
        match self {
            Self::OfImages => of_images,
            Self::Nowhere => None,
            Self::At(path) => Some(path.clone()),
        }
    }
}

/// Where something that belongs to images is looked for.
enum Companion {
    Nothing,
    /// One file for all images.
    File(PathBuf),
    /// A file for each image.
    Folder {
        path: PathBuf,
        names: Vec<String>,
    },
}

impl Companion {
    fn of(path: Option<&Path>) -> Result<Self> {
        match path {
            None => Ok(Self::Nothing),
            Some(path) if path.is_dir() => {
                let mut names = list_folder(path)?;
                names.retain(|name| !is_hidden(name));
                Ok(Self::Folder { names, path: path.to_owned() })
            }
            Some(path) => Ok(Self::File(path.to_owned())),
        }
    }

    /// The file that belongs to an image.
    fn find(&self, stem: &str) -> Result<Option<PathBuf>, String> {
        let (folder, names) = match self {
            Self::Nothing => return Ok(None),
            Self::File(path) => return Ok(Some(path.clone())),
            Self::Folder { path, names } => (path, names),
        };
        let exact: Vec<&String> = names.iter().filter(|name| belongs(name, stem) == Some(true)).collect();
        let longer: Vec<&String> = names.iter().filter(|name| belongs(name, stem) == Some(false)).collect();
        match (&exact[..], &longer[..]) {
            ([name], _) | ([], [name]) => Ok(Some(folder.join(name))),
            ([], []) => Err(format!("{stem} has no file in {}", folder.display())),
            ([], several) | (several, _) => {
                let names = several.iter().map(|name| name.as_str()).collect::<Vec<_>>().join(", ");
                Err(format!("{stem} has several files in {}: {names}", folder.display()))
            }
        }
    }
}

/// Whether a file belongs to the image `stem`: by the same name (true), or by its name with something appended after
/// a `_`, `-` or `.` (false).
fn belongs(file: &str, stem: &str) -> Option<bool> {
    let name = Path::new(file).file_stem()?.to_str()?;
    match name.strip_prefix(stem)? {
        "" => Some(true),
        rest => rest.starts_with(['_', '-', '.']).then_some(false),
    }
}

type Found = Vec<Option<PathBuf>>;

/// The companions of every image; names what is missing, and warns of files that belong to no image.
fn pair(files: &[PathBuf], companions: &[Companion; 2], watcher: &dyn Watcher) -> Result<[Found; 2]> {
    let mut found = [Vec::new(), Vec::new()];
    let mut missing = Vec::new();
    for file in files {
        for (companion, found) in companions.iter().zip(&mut found) {
            match companion.find(&stem_of_input(file)) {
                Ok(path) => found.push(path),
                Err(reason) => missing.push(reason),
            }
        }
    }
    if !missing.is_empty() {
        return Err(Error::Unsupported(format!(
            "images and their files do not pair: {}; rename, add or remove files",
            missing.join("; ")
        )));
    }
    for (companion, found) in companions.iter().zip(&found) {
        let Companion::Folder { path, names } = companion else { continue };
        let is_used = |name: &&String| found.iter().flatten().any(|used| *used == path.join(name));
        let unused: Vec<&str> = names.iter().filter(|name| !is_used(name)).map(String::as_str).collect();
        if !unused.is_empty() {
            watcher.warn(&format_args!("{} belongs to no image in {}", unused.join(", "), path.display()));
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::testing::Notes;
    use crate::core::shard::Shard;

    fn folder_of(root: &Path, folder: &str, names: &[&str]) -> PathBuf {
        let folder = root.join(folder);
        std::fs::create_dir_all(&folder).unwrap();
        names.iter().for_each(|name| std::fs::write(folder.join(name), "").unwrap());
        folder
    }

    fn jobs(root: &Path, inputs: &FinishInputs, notes: &Notes) -> Result<Vec<Job>> {
        let path = root.join("out/");
        let (extension, accepts_existing, shard) = ("png", false, Shard::WHOLE);
        let is_asked = false;
        inputs.jobs(&Destination { path: &path, extension, is_asked, accepts_existing, shard }, notes)
    }

    #[test]
    fn files_belong_to_images_by_name() {
        assert_eq!(belongs("a.txt", "a"), Some(true));
        assert_eq!(belongs("a_ccm.txt", "a"), Some(false));
        assert_eq!(belongs("ab.txt", "a"), None);
        let scratch = tempfile::tempdir().unwrap();
        let images = folder_of(scratch.path(), "in", &["a.exr", "a_2.exr"]);
        let ccm = folder_of(scratch.path(), "ccm", &["a.txt", "a_2.txt", "other.txt"]);
        let reference = scratch.path().join("phone.jpg");
        let inputs = FinishInputs {
            images: vec![images],
            ccm: Companions::At(ccm.clone()),
            reference: Companions::At(reference.clone()),
        };
        let notes = Notes::default();
        let found = jobs(scratch.path(), &inputs, &notes).unwrap();
        let ccms: Vec<&PathBuf> = found.iter().flat_map(|job| &job.ccm).collect();
        assert_eq!(ccms, [&ccm.join("a.txt"), &ccm.join("a_2.txt")]);
        assert!(found.iter().all(|job| job.reference.as_ref() == Some(&reference)));
        let said = format!("warning: other.txt belongs to no image in {}", ccm.display());
        assert_eq!(notes.take(), [said]);
        std::fs::remove_file(ccm.join("a_2.txt")).unwrap();
        let refused = jobs(scratch.path(), &inputs, &notes).err().unwrap().to_string();
        assert!(refused.contains("a_2 has no file in"), "{refused}");
    }

    #[test]
    fn what_belongs_to_images_is_not_written_over() {
        let scratch = tempfile::tempdir().unwrap();
        let root = scratch.path();
        let images = folder_of(root, "in", &["a.exr"]);
        let references = folder_of(root, "out", &["a.png"]);
        let inputs = FinishInputs {
            images: vec![images],
            reference: Companions::At(references),
            ..FinishInputs::default()
        };
        let path = root.join("out");
        let destination = Destination {
            path: &path,
            extension: "png",
            is_asked: false,
            accepts_existing: true,
            shard: Shard::WHOLE,
        };
        let refused = inputs.jobs(&destination, &Notes::default()).err().unwrap().to_string();
        assert!(refused.contains("out/a.png would be read and written over"), "{refused}");
    }

    #[test]
    fn the_published_dataset_brings_its_matrices_and_pictures() {
        let scratch = tempfile::tempdir().unwrap();
        let root = scratch.path();
        folder_of(root, PUBLISHED[0], &["a.npy"]);
        let matrices = folder_of(root, PUBLISHED[1], &["a_ccm.txt"]);
        let mut inputs = FinishInputs { images: vec![root.to_owned()], ..FinishInputs::default() };
        let notes = Notes::default();
        let refused = jobs(root, &inputs, &notes).err().unwrap().to_string();
        assert!(refused.ends_with("real_data/jpg_ZTE is missing; unpack it there, or pass --no-reference"));
        inputs.reference = Companions::Nowhere;
        let found = jobs(root, &inputs, &notes).unwrap();
        assert_eq!(found[0].ccm, Some(matrices.join("a_ccm.txt")));
        assert_eq!((found.len(), &found[0].reference), (1, &None));
    }
}
