//! Which files become which: outputs named before the work, captures read.

use std::path::PathBuf;
use std::sync::OnceLock;

use anyhow::{Result, bail};

use udc::batch::{Destination, Unplaced, check_kept};
use udc::capture::{CaptureFiles, CaptureGroups, Told, names_of};
use udc::core::error;
use udc::io::{Format, file_of_input, identity, sha256_of_input};
use udc::restore::{Capture, CaptureReading, PoseSource};

use super::RestoreArgs;
use crate::commands::Session;

/// One image to make.
pub(super) struct Job {
    /// The capture, or the pictures of a bracket.
    pub(super) inputs: Vec<PathBuf>,
    /// The image to write.
    pub(super) output: PathBuf,
    /// SHA-256 of the inputs, when they were first asked for.
    sha256: OnceLock<Vec<Option<String>>>,
}

impl Job {
    pub(super) fn name(&self) -> String {
        names_of(&self.inputs)
    }

    /// Whether the image is a picture for viewing.
    pub(super) fn is_photograph(&self) -> bool {
        Format::of_extension(&self.output).is_ok_and(|format| format == Format::Jpeg)
    }

    /// Whether the image's format holds light far above white; what it is of another format is told where it is written.
    pub(super) fn holds_bright_light(&self) -> bool {
        Format::of_extension(&self.output).map_or(true, Format::holds_light)
    }

    /// SHA-256 of the inputs, which are read for it once; what is no file, such as a pipe, can be read once only and has
    /// none.
    pub(super) fn inputs_sha256(&self) -> error::Result<&[Option<String>]> {
        if let Some(found) = self.sha256.get() {
            return Ok(found);
        }
        let found: Vec<Option<String>> =
            self.inputs.iter().map(|input| sha256_of_input(input)).collect::<Result<_, _>>()?;
        Ok(self.sha256.get_or_init(|| found))
    }
}

impl RestoreArgs {
    /// What to restore to where; refuses outputs that exist before any work.
    pub(super) fn jobs(&self, session: &Session) -> Result<Vec<Job>> {
        let inputs = self.layer.of(&self.inputs);
        let CaptureGroups { captures, in_folder, warnings } = if self.is_bracket() {
            CaptureGroups::of_brackets(&inputs)?
        } else {
            if let Some(flag) = self.raw.flag_of_brackets() {
                bail!("{flag} is for brackets: add --bracket, or --exposures with the times");
            }
            CaptureGroups::of_files(&inputs)?
        };
        warnings.iter().for_each(|warning| session.warn(warning));
        let captures = self.without_psf(captures, session);
        let destination = Destination {
            path: &self.output,
            extension: self.format.unwrap_or("exr"),
            is_asked: self.format.is_some(),
            accepts_existing: session.overwrite || self.resume,
            shard: self.shard,
        };
        let unplaced =
            |files: &CaptureFiles| Unplaced { name: files.name.clone(), source: names_of(&files.files) };
        let outputs = destination.place(&captures.iter().map(unplaced).collect::<Vec<_>>(), in_folder)?;
        let read = captures.iter().flat_map(|capture| &capture.files).chain(self.kernel.paths());
        let read = read.chain(self.raw.dark_frames()).chain(&self.model).chain(match &self.pose {
            Some(PoseSource::File(path)) => Some(path),
            _ => None,
        });
        check_kept(&outputs, &read.collect::<Vec<_>>())?;
        let inputs = captures.into_iter().map(|capture| capture.files);
        let job = |(inputs, output)| Job { inputs, output, sha256: OnceLock::new() };
        Ok(inputs.zip(outputs).map(job).collect())
    }

    /// Leaves out the PSF that captures are restored by, which may lie beside them in their folder.
    fn without_psf(&self, captures: Vec<CaptureFiles>, session: &Session) -> Vec<CaptureFiles> {
        let of_kernel: Vec<PathBuf> = self.kernel.paths().map(|path| identity(path)).collect();
        let is_psf = |capture: &CaptureFiles| match &capture.files[..] {
            [file] => of_kernel.contains(&identity(file_of_input(file))),
            _ => false,
        };
        if captures.iter().all(is_psf) {
            return captures;
        }
        let (psf, others): (Vec<_>, Vec<_>) = captures.into_iter().partition(is_psf);
        for psf in psf {
            let name = names_of(&psf.files);
            session.warn(format_args!("{name} is the PSF, and is left out of the captures"));
        }
        others
    }

    /// Whether several pictures make one image.
    pub(super) fn is_bracket(&self) -> bool {
        self.bracket || self.raw.exposures.is_some()
    }

    pub(super) fn read_capture(&self, job: &Job, told: &Told, session: &Session) -> error::Result<Capture> {
        let read = || match self.is_bracket() {
            true => CaptureReading::of_bracket(&job.inputs, told, &session.progress),
            false => CaptureReading::of_file(&job.inputs[0], told, &session.progress),
        };
        let reading = session.timed(format_args!("reading {}", job.name()), read)?;
        reading.warnings.iter().for_each(|warning| session.warn(warning));
        if !reading.is_raw() {
            return Ok(reading.develop()?.0);
        }
        let (capture, warnings) =
            session.timed(format_args!("fusing {}", job.name()), || reading.develop())?;
        warnings.iter().for_each(|warning| session.warn(warning));
        Ok(capture)
    }
}
