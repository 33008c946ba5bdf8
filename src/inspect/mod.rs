//! Says what a file or folder of the project holds: its text is for people, its serialised form for scripts.

mod array;
mod configuration;
mod dataset;
mod evaluation;
mod examples;
mod image;
mod layers;
mod model;
mod picture;
mod psf;
mod run;
mod tensors;
mod text;

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::core::error::Result;
use crate::dataset::CONFIG_FILE;
use crate::examples::{EXAMPLES_FILE, ExamplesFolder};
use crate::io::{PsfOptions, expand_inputs, inspect_image};
use crate::network::shipped;

pub use array::ArrayDescription;
pub use configuration::{
    DisplayDescription, FieldDescription, PoseDescription, SensorDescription, StudyDescription,
    TrainingDescription,
};
pub use dataset::{DatasetDescription, SplitDescription};
pub use evaluation::{EvaluationDescription, MethodDescription};
pub use examples::ExamplesDescription;
pub use image::{ImageDescription, Statistics};
pub use layers::LayersDescription;
pub use model::{ModelDescription, NetworkDescription};
pub use picture::Thumbnail;
pub use psf::{PsfChannel, PsfDescription};
pub use run::{CheckpointDescription, RunDescription};
pub use tensors::{BankDescription, TensorsDescription};

/// What a file or folder was found to be.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Inspection {
    /// An image.
    Image(ImageDescription),
    /// A file of several layers, none of which is the image by itself.
    Layers(LayersDescription),
    /// An image, looked at as a PSF.
    Psf(PsfDescription),
    /// A kernel bank.
    KernelBank(BankDescription),
    /// A network's weights.
    Model(ModelDescription),
    /// Tensors of unknown use.
    #[serde(rename = "model")]
    Tensors(TensorsDescription),
    /// An array that is no image.
    Array(ArrayDescription),
    /// A dataset's folder.
    Dataset(DatasetDescription),
    /// A folder of examples.
    Examples(ExamplesDescription),
    /// A training run's folder.
    Run(RunDescription),
    /// A checkpoint of a run.
    Checkpoint(CheckpointDescription),
    /// The description of a display.
    Display(DisplayDescription),
    /// The PSFs of several places of the frame.
    PsfField(FieldDescription),
    /// The pose of a panel.
    Pose(PoseDescription),
    /// A sensor, for its noise.
    Sensor(SensorDescription),
    /// The configuration of a training.
    TrainingConfiguration(TrainingDescription),
    /// The results of an evaluation.
    Evaluation(EvaluationDescription),
    /// A study.
    Study(StudyDescription),
}

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Image(found) => found.fmt(f),
            Self::Layers(found) => found.fmt(f),
            Self::Psf(found) => found.fmt(f),
            Self::KernelBank(found) => found.fmt(f),
            Self::Model(found) => found.fmt(f),
            Self::Tensors(found) => found.fmt(f),
            Self::Array(found) => found.fmt(f),
            Self::Dataset(found) => found.fmt(f),
            Self::Examples(found) => found.fmt(f),
            Self::Run(found) => found.fmt(f),
            Self::Checkpoint(found) => found.fmt(f),
            Self::Display(found) => found.fmt(f),
            Self::PsfField(found) => found.fmt(f),
            Self::Pose(found) => found.fmt(f),
            Self::Sensor(found) => found.fmt(f),
            Self::TrainingConfiguration(found) => found.fmt(f),
            Self::Evaluation(found) => found.fmt(f),
            Self::Study(found) => found.fmt(f),
        }
    }
}

/// Looks at a file or folder, recognised by its contents; images are looked at as PSFs where it is said how to read them.
///
/// # Errors
/// [`Error::Io`](crate::core::error::Error::Io) when it cannot be read; [`Error::Format`](crate::core::error::Error::Format)
/// when it is damaged or of no known kind; [`Error::Config`](crate::core::error::Error::Config) for a mistake in a
/// configuration.
pub fn inspect(path: &Path, as_psf: Option<PsfOptions>) -> Result<Inspection> {
    if is_shipped(path) {
        return ModelDescription::read(path).map(Inspection::Model);
    }
    if run::is_checkpoint(path) {
        return CheckpointDescription::read(path).map(Inspection::Checkpoint);
    }
    if let Some(folder) = examples_described_by(path) {
        return ExamplesDescription::read(folder).map(Inspection::Examples);
    }
    if let Some(results) = evaluation::results_of(path) {
        return EvaluationDescription::read(&results).map(Inspection::Evaluation);
    }
    if path.is_dir() && !dataset::is_dataset(path) {
        return RunDescription::read(path).map(Inspection::Run);
    }
    if path.is_dir() {
        return DatasetDescription::read(path).map(Inspection::Dataset);
    }
    if let Some(folder) = folder_described_by(path) {
        return DatasetDescription::read(folder).map(Inspection::Dataset);
    }
    match (path.extension().and_then(|extension| extension.to_str()), as_psf) {
        (Some("pth" | "pt"), _) => ModelDescription::read(path).map(Inspection::Model),
        (Some("toml"), _) => configuration::inspect_configuration(path),
        (_, Some(options)) => PsfDescription::read(path, options).map(Inspection::Psf),
        (Some("safetensors"), _) => tensors::inspect_tensors(path),
        (Some("npy"), _) => inspect_npy(path),
        _ => inspect_picture(path),
    }
}

/// A file that only lacks a word on which of its layers is meant is described by these.
fn inspect_picture(path: &Path) -> Result<Inspection> {
    match ImageDescription::read(path) {
        Ok(found) => Ok(Inspection::Image(found)),
        Err(error) => LayersDescription::read(path).map(Inspection::Layers).ok_or(error),
    }
}

/// What is no image may still be an array; if it is neither, the first reason says more.
fn inspect_npy(path: &Path) -> Result<Inspection> {
    match inspect_image(path) {
        Ok((pixels, encoding)) => Ok(Inspection::Image(ImageDescription::new(pixels, encoding))),
        Err(no_image) => ArrayDescription::read(path).map(Inspection::Array).ok_or(no_image),
    }
}

/// What an input stands for: itself, or the images of a folder. A dataset, a folder of examples, a run, a checkpoint, the
/// results of an evaluation and a model that the program carries are one.
///
/// # Errors
/// As [`expand_inputs`].
pub fn subjects(input: &Path) -> Result<Vec<PathBuf>> {
    let is_folder =
        dataset::is_dataset(input) || run::is_run(input) || evaluation::results_of(input).is_some();
    let is_one = is_shipped(input) || is_folder;
    if is_one || run::is_checkpoint(input) || ExamplesFolder::is_one(input) {
        return Ok(vec![input.to_owned()]);
    }
    expand_inputs(&[input.to_owned()])
}

/// Whether a name stands for a model that the program carries, and for nothing that is there.
fn is_shipped(name: &Path) -> bool {
    shipped(name).is_some() && !name.exists()
}

/// The folder of the dataset that a `dataset.toml` belongs to.
fn folder_described_by(file: &Path) -> Option<&Path> {
    folder_of(file, CONFIG_FILE)
}

/// The folder of examples that a path is, or that an `examples.toml` belongs to.
fn examples_described_by(path: &Path) -> Option<&Path> {
    if ExamplesFolder::is_one(path) { Some(path) } else { folder_of(path, EXAMPLES_FILE) }
}

/// The folder that a file of a name describes.
fn folder_of<'a>(file: &'a Path, name: &str) -> Option<&'a Path> {
    let folder = file.parent().filter(|_| file.file_name().is_some_and(|found| found == name))?;
    Some(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
}
