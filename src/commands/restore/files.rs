//! Which files become which: outputs named before the work, captures read.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::{Result, bail};

use udc::capture::{Developed, Pictures, SCENE_BRACKET, Told, names_of};
use udc::core::capture::CaptureInfo;
use udc::core::error::Error;
use udc::io::{DomainTag, expand_inputs, is_hidden, list_folder, read_pixels, sha256_of_file};

use super::RestoreArgs;
use crate::commands::Session;
use crate::commands::destination::{Destination, Unplaced, identity, without_repeats};
use crate::commands::domain::DomainArg;
use crate::commands::picture::AnyImage;

/// Where the published dataset keeps its captures.
const PUBLISHED_CAPTURES: &str = "real_data/input";

/// One image to make.
pub(super) struct Job {
    /// The capture, or the pictures of a bracket.
    pub(super) inputs: Vec<PathBuf>,
    /// The image to write.
    pub(super) output: PathBuf,
    /// SHA-256 of the inputs, when they were first asked for.
    sha256: OnceLock<Vec<Option<String>>>,
}

/// What was read for a job.
pub(super) struct Capture {
    /// The image.
    pub(super) pixels: AnyImage,
    /// What is known of the capture, where the files say it.
    pub(super) info: Option<CaptureInfo>,
}

impl Job {
    pub(super) fn name(&self) -> String {
        names_of(&self.inputs)
    }

    /// SHA-256 of the inputs, which are read for it once; what is no file, such as a pipe, can be read once only and has
    /// none.
    pub(super) fn inputs_sha256(&self) -> Result<&[Option<String>]> {
        if let Some(found) = self.sha256.get() {
            return Ok(found);
        }
        let of_input = |input: &PathBuf| input.is_file().then(|| sha256_of_file(input)).transpose();
        let found: Vec<Option<String>> = self.inputs.iter().map(of_input).collect::<Result<_, _>>()?;
        Ok(self.sha256.get_or_init(|| found))
    }
}

/// Files that become one image, and its name in an output folder.
struct Group {
    name: String,
    files: Vec<PathBuf>,
}

/// All that is to be made.
struct Groups {
    groups: Vec<Group>,
    /// Whether the images belong in a folder, however many they are.
    in_folder: bool,
}

impl Group {
    fn of(named: &Path, files: Vec<PathBuf>, name: Option<&std::ffi::OsStr>) -> Self {
        let name = name.unwrap_or(named.as_os_str()).to_string_lossy().into_owned();
        Self { name, files }
    }
}

impl RestoreArgs {
    /// What to restore to where; refuses outputs that exist before any work.
    pub(super) fn jobs(&self, session: &Session) -> Result<Vec<Job>> {
        let Groups { groups, in_folder } = if self.is_bracket() {
            brackets(&self.inputs, session)?
        } else {
            if let Some(flag) = self.raw.flag_of_brackets() {
                bail!("{flag} is for brackets: add --bracket, or --exposures with the times");
            }
            captures(&self.inputs)?
        };
        let destination = Destination {
            path: &self.output,
            extension: self.format.extension(),
            accepts_existing: session.overwrite || self.resume,
        };
        let unplaced = |group: &Group| Unplaced { name: group.name.clone(), source: names_of(&group.files) };
        let outputs = destination.place(&groups.iter().map(unplaced).collect::<Vec<_>>(), in_folder)?;
        let job =
            |(group, output): (Group, PathBuf)| Job { inputs: group.files, output, sha256: OnceLock::new() };
        Ok(groups.into_iter().zip(outputs).map(job).collect())
    }

    /// Whether several pictures make one image.
    pub(super) fn is_bracket(&self) -> bool {
        self.bracket || self.raw.exposures.is_some()
    }

    pub(super) fn read_capture(&self, job: &Job, session: &Session) -> Result<Capture> {
        if !self.is_bracket() && !self.raw.is_raw() {
            let file = &job.inputs[0];
            let read = || read_pixels(file);
            let pixels = session.timed(format_args!("reading {}", job.name()), read)?;
            if pixels.raw.is_none() {
                let (pixels, info) = AnyImage::of(file, pixels, self.domain, session)?;
                return Ok(Capture { pixels, info });
            }
        }
        if let Some(domain @ DomainArg::ToneMapped) = self.domain {
            bail!(
                "{}: raw pictures are linear, and --domain says {}; leave it out",
                job.name(),
                domain.name()
            );
        }
        let told = Told {
            // A picture alone needs no time.
            default_times: (!self.is_bracket()).then_some(SCENE_BRACKET),
            ..self.raw.told(self.domain.map(DomainTag::from))?
        };
        let read = || Pictures::read(&job.inputs, &told, &session.progress);
        let mut pictures = session.timed(format_args!("reading {}", job.name()), read)?;
        std::mem::take(&mut pictures.warnings).into_iter().for_each(|warning| session.warn(warning));
        let develop = || pictures.develop();
        let developed = session.timed(format_args!("fusing {}", job.name()), develop)?;
        for warning in &developed.warnings {
            session.warn(format_args!("{}: {warning}", job.name()));
        }
        let Developed { fused, info, .. } = developed;
        Ok(Capture { pixels: AnyImage::Linear(fused.image), info: Some(info) })
    }
}

/// One group for each file.
fn captures(inputs: &[PathBuf]) -> Result<Groups> {
    let of_published = |input: &PathBuf| {
        let published = input.join(PUBLISHED_CAPTURES);
        if published.is_dir() { published } else { input.clone() }
    };
    let files = without_repeats(expand_inputs(&inputs.iter().map(of_published).collect::<Vec<_>>())?);
    let groups = files.into_iter().map(|file| Group::of(&file, vec![file.clone()], file.file_stem()));
    Ok(Groups { groups: groups.collect(), in_folder: inputs.iter().any(|input| input.is_dir()) })
}

/// One group for each folder of pictures, one for all files that are named themselves.
fn brackets(inputs: &[PathBuf], session: &Session) -> Result<Groups> {
    let (folders, files): (Vec<PathBuf>, Vec<PathBuf>) =
        inputs.iter().cloned().partition(|input| input.is_dir());
    let mut groups = Vec::new();
    if !files.is_empty() {
        let files = without_repeats(expand_inputs(&files)?);
        let first = files[0].clone();
        groups.push(Group::of(&first, files, first.file_stem()));
    }
    let mut in_folder = false;
    for folder in folders {
        let names = list_folder(&folder)?;
        let shown = names.iter().filter(|name| !is_hidden(name));
        let inner: Vec<PathBuf> = shown.map(|name| folder.join(name)).filter(|path| path.is_dir()).collect();
        let is_flat = inner.is_empty();
        in_folder |= !is_flat;
        for bracket in if is_flat { vec![folder] } else { inner } {
            let files = match expand_inputs(std::slice::from_ref(&bracket)) {
                Err(error @ Error::Format { .. }) if !is_flat => {
                    session.warn(format_args!("{error}; it is left out"));
                    continue;
                }
                files => files?,
            };
            // `.` has no name of its own.
            let place = bracket.canonicalize().unwrap_or_else(|_| bracket.clone());
            groups.push(Group::of(&bracket, files, place.file_name()));
        }
    }
    if groups.is_empty() {
        bail!("no folder holds images; each folder inside of the one that is named is a bracket");
    }
    let mut seen = BTreeSet::new();
    groups.retain(|group| seen.insert(group.files.iter().map(|file| identity(file)).collect::<Vec<_>>()));
    Ok(Groups { groups, in_folder })
}
