//! What is looked at: what the user names, told apart by what it holds, and opened.

use std::path::{Path, PathBuf};

use super::{Findings, configuration, dataset, examples, images, model, psf};
use crate::core::error::Result;
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::dataset::Dataset;
use crate::inspect::{Inspection, inspect, subjects};
use crate::io::PsfOptions;
use crate::network::Model;
use crate::restore::Pose;
use crate::train::TrainConfig;

/// What a path is looked at as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Whatever it is found to be.
    Unknown,
    /// A dataset, or a folder of examples.
    Data,
    /// A kernel bank.
    Bank,
    /// A network's weights.
    Model,
    /// A PSF.
    Psf,
    /// The configuration of a training.
    Configuration,
}

/// Everything that is looked at.
#[derive(Clone, Debug, Default)]
pub struct Patient {
    /// Files and folders, with what they are said to be.
    pub paths: Vec<(PathBuf, Role)>,
    /// How PSFs are read.
    pub psf_options: PsfOptions,
    /// Where results are to be written.
    pub output: Option<PathBuf>,
    /// Images of a dataset, and examples, that are read, spread evenly; all where it is none.
    pub images: Option<usize>,
}

/// What was opened of a patient.
#[derive(Default)]
pub(super) struct Opened {
    pub(super) datasets: Vec<(Dataset, images::Sizes)>,
    pub(super) banks: Vec<(PathBuf, KernelBank, String)>,
    pub(super) models: Vec<(PathBuf, Model)>,
    pub(super) psfs: Vec<(PathBuf, Psf)>,
    pub(super) poses: Vec<(PathBuf, Pose)>,
    pub(super) configurations: Vec<(PathBuf, TrainConfig)>,
    /// Captures and other images, with height and width.
    pub(super) images: Vec<(PathBuf, [usize; 2])>,
    /// Folders of examples.
    pub(super) examples: Vec<PathBuf>,
}

impl Opened {
    /// Opens everything; what cannot be opened is a finding.
    pub(super) fn of(patient: &Patient, findings: &mut Findings, progress: &Progress) -> Result<Self> {
        let mut opened = Self::default();
        for (path, role) in &patient.paths {
            progress.check()?;
            match role {
                Role::Unknown => opened.recognise(path, patient, (findings, progress))?,
                role => opened.open(path, *role, patient, (findings, progress))?,
            }
        }
        Ok(opened)
    }

    /// Opens what a path holds, whatever it is.
    fn recognise(
        &mut self,
        path: &Path,
        patient: &Patient,
        (findings, progress): (&mut Findings, &Progress),
    ) -> Result<()> {
        let files = match subjects(path) {
            Ok(files) => files,
            Err(error) => {
                findings.refused(path.display(), "unreadable", &error, "name a file or folder that there is");
                return Ok(());
            }
        };
        for file in files {
            progress.check()?;
            if file.is_dir() && examples::is_one(&file) {
                self.open(&file, Role::Data, patient, (findings, progress))?;
                continue;
            }
            match inspect(&file, None) {
                Ok(found) => self.take(&file, found, patient, (findings, progress))?,
                // The reader of its kind says it, and more.
                Err(_) if dataset::is_one(&file) => {
                    self.open(&file, Role::Data, patient, (findings, progress))?;
                }
                Err(error) => {
                    findings.refused(file.display(), "unreadable", &error, images::MEND_DAMAGED);
                }
            }
        }
        Ok(())
    }

    /// Looks closer at what was recognised.
    fn take(
        &mut self,
        file: &Path,
        found: Inspection,
        patient: &Patient,
        (findings, progress): (&mut Findings, &Progress),
    ) -> Result<()> {
        let role = match found {
            Inspection::Dataset(_) | Inspection::Examples(_) => Role::Data,
            Inspection::KernelBank(_) => Role::Bank,
            Inspection::Model(_) | Inspection::Tensors(_) => Role::Model,
            Inspection::Psf(_) => Role::Psf,
            Inspection::TrainingConfiguration(_) => Role::Configuration,
            Inspection::Image(image) if image.is_likely_psf() => Role::Psf,
            Inspection::Image(image) => {
                images::look_alone(file, &image, findings);
                self.images.push((file.to_owned(), [image.height, image.width]));
                return Ok(());
            }
            Inspection::Pose(pose) => {
                findings.ok(file.display(), "pose", format!("a pose: {pose}"));
                self.poses.push((file.to_owned(), pose.pose));
                return Ok(());
            }
            Inspection::Run(_) => {
                let parts = configuration::parts_of_run(file, findings);
                return parts.iter().try_for_each(|(part, role)| {
                    self.open(part, *role, patient, (&mut *findings, progress))
                });
            }
            other => {
                findings.ok(file.display(), "readable", first_line(&other.to_string()));
                return Ok(());
            }
        };
        self.open(file, role, patient, (findings, progress))
    }

    fn open(
        &mut self,
        path: &Path,
        role: Role,
        patient: &Patient,
        (findings, progress): (&mut Findings, &Progress),
    ) -> Result<()> {
        let path_buf = path.to_owned();
        match role {
            Role::Unknown => return self.recognise(path, patient, (findings, progress)),
            Role::Data if examples::is_one(path) => {
                if examples::look(path, patient.images, (findings, progress))? {
                    self.examples.push(path_buf);
                }
            }
            Role::Data => self.datasets.extend(dataset::look(path, patient.images, (findings, progress))?),
            Role::Bank => {
                self.banks.extend(psf::look_at_bank(path, findings).map(|(bank, sha)| (path_buf, bank, sha)));
            }
            Role::Model => self.models.extend(model::look(path, findings).map(|model| (path_buf, model))),
            Role::Psf => {
                let psf = psf::look(path, patient.psf_options, findings);
                self.psfs.extend(psf.map(|psf| (path_buf, psf)));
            }
            Role::Configuration => {
                let config = configuration::look(path, findings);
                self.configurations.extend(config.map(|config| (path_buf, config)));
            }
        }
        Ok(())
    }
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_owned()
}
