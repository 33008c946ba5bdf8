//! Finds the colour matrix and the reference picture of every image, by name.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::{Result, bail};

use udc::io::{expand_inputs, is_hidden, list_folder, sha256_of_file, without_repeats};

use super::FinishArgs;
use crate::commands::Session;
use crate::commands::destination::{Destination, Unplaced};

/// Where the published dataset keeps its real captures, their colour matrices and the phone's own pictures.
const PUBLISHED: [&str; 3] = ["real_data/input", "real_data/CCM_txt", "real_data/jpg_ZTE"];

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
        let of = |path: Option<&PathBuf>| {
            path.filter(|path| path.is_file()).map(|path| sha256_of_file(path)).transpose()
        };
        let found = [of(Some(&self.input))?, of(self.ccm.as_ref())?, of(self.reference.as_ref())?];
        Ok(self.sha256.get_or_init(|| found))
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

impl FinishArgs {
    /// What to make of what; refuses what exists and pairs that are not complete before any work.
    pub(super) fn jobs(&self, session: &Session) -> Result<Vec<Job>> {
        let (inputs, ccm, reference) = self.sources()?;
        let files = without_repeats(expand_inputs(&inputs)?);
        let companions = [Companion::of(ccm.as_deref())?, Companion::of(reference.as_deref())?];
        let [ccms, references] = pair(&files, &companions, session)?;
        let destination = Destination {
            path: &self.output,
            extension: self.format.extension(),
            accepts_existing: session.overwrite || self.resume,
        };
        let in_folder = inputs.iter().any(|input| input.is_dir());
        let results: Vec<Unplaced> = files.iter().map(|file| Unplaced::of_file(file)).collect();
        let outputs = destination.place(&results, in_folder)?;
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

    /// Inputs, colour matrices and reference pictures, those of the published dataset spelled out.
    fn sources(&self) -> Result<(Vec<PathBuf>, Option<PathBuf>, Option<PathBuf>)> {
        let root = match &self.inputs[..] {
            [root] if root.join(PUBLISHED[0]).is_dir() => root,
            _ => return Ok((self.inputs.clone(), self.ccm.clone(), self.reference.clone())),
        };
        let [captures, ccms, references] = PUBLISHED.map(|name| root.join(name));
        for (folder, is_off, flag) in [
            (&ccms, self.no_ccm || self.ccm.is_some(), "--no-ccm"),
            (&references, self.no_reference || self.reference.is_some(), "--no-reference"),
        ] {
            if !is_off && !folder.is_dir() {
                bail!("{} is missing; unpack it there, or pass {flag}", folder.display());
            }
        }
        let ccm = if self.no_ccm { None } else { self.ccm.clone().or(Some(ccms)) };
        let reference = if self.no_reference { None } else { self.reference.clone().or(Some(references)) };
        Ok((vec![captures], ccm, reference))
    }
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
    fn find(&self, stem: &str) -> std::result::Result<Option<PathBuf>, String> {
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
fn pair(files: &[PathBuf], companions: &[Companion; 2], session: &Session) -> Result<[Found; 2]> {
    let stem = |file: &PathBuf| file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut found = [Vec::new(), Vec::new()];
    let mut missing = Vec::new();
    for file in files {
        for (companion, found) in companions.iter().zip(&mut found) {
            match companion.find(&stem(file)) {
                Ok(path) => found.push(path),
                Err(reason) => missing.push(reason),
            }
        }
    }
    if !missing.is_empty() {
        bail!("images and their files do not pair: {}; rename, add or remove files", missing.join("; "));
    }
    for (companion, found) in companions.iter().zip(&found) {
        let Companion::Folder { path, names } = companion else { continue };
        let is_used = |name: &&String| found.iter().flatten().any(|used| *used == path.join(name));
        let unused: Vec<&str> = names.iter().filter(|name| !is_used(name)).map(String::as_str).collect();
        if !unused.is_empty() {
            session.warn(format_args!("{} belongs to no image in {}", unused.join(", "), path.display()));
        }
    }
    Ok(found)
}
