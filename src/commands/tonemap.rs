//! `udc tonemap`.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use super::Session;
use super::picture::AnyImage;
use super::queue::{Stages, run_all};
use udc::core::image::{Linear, ToneMapped};
use udc::core::io::{Format, WriteOptions, check_output, create_folder, expand_inputs, read_image};
use udc::core::provenance::Provenance;
use udc::core::tone::ToneCurve;

/// Apply the tone mapping or its inverse
///
/// A file that cannot be mapped is named at the end, the others are done.
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc tonemap scene.exr -o scene.png\n         udc tonemap --inverse restored.png -o \
                        restored.exr\n\nThe mapping is x/(x+alpha) of x clipped to x-max"
)]
pub(crate) struct TonemapArgs {
    /// Images, folders or patterns
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write; a folder for several inputs
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Map tone-mapped values back to linear light
    #[arg(long)]
    inverse: bool,
    /// Irradiance that is mapped to one half
    #[arg(long, value_name = "A", default_value_t = ToneCurve::default().alpha)]
    alpha: f32,
    /// Irradiance at which the sensor saturates
    #[arg(long, value_name = "X", default_value_t = ToneCurve::default().x_max)]
    x_max: f32,
    /// Format of the files in an output folder
    #[arg(long, value_enum, default_value_t = FormatArg::Exr)]
    format: FormatArg,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    Exr,
    Npy,
    Png,
    Tif,
}

impl TonemapArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let curve = ToneCurve::new(self.alpha, self.x_max)?;
        let jobs = self.jobs(session)?;
        run_all(&Mapping { args: &self, curve, session }, &jobs, session)
    }

    /// What becomes what; refuses outputs that exist before any work.
    fn jobs(&self, session: &Session) -> Result<Vec<Job>> {
        let inputs = expand_inputs(&self.inputs)?;
        let to_folder =
            inputs.len() > 1 || self.inputs.iter().any(|input| input.is_dir()) || self.output.is_dir();
        let extension = self.format.to_possible_value().expect("no format is hidden").get_name().to_owned();
        let mut jobs: Vec<Job> = Vec::with_capacity(inputs.len());
        for input in inputs {
            let name = input.file_stem().unwrap_or_default().to_string_lossy();
            let (output, folder) = match to_folder {
                true => (self.output.join(format!("{name}.{extension}")), Some(self.output.clone())),
                false => (self.output.clone(), None),
            };
            Format::of_extension(&output)?;
            // In a folder that is yet to be made nothing can be in the way.
            if folder.as_deref().is_none_or(Path::is_dir) {
                check_output(&output, session.overwrite)?;
            }
            if let Some(other) = jobs.iter().find(|job| job.output == output) {
                let (a, b) = (other.input.display(), input.display());
                bail!("{a} and {b} would both be written to {}", output.display());
            }
            jobs.push(Job { input, output, folder });
        }
        Ok(jobs)
    }
}

/// One image to make.
struct Job {
    input: PathBuf,
    output: PathBuf,
    /// The folder to make for it.
    folder: Option<PathBuf>,
}

struct Mapping<'a> {
    args: &'a TonemapArgs,
    curve: ToneCurve,
    session: &'a Session,
}

impl Stages for Mapping<'_> {
    type Job = Job;
    type Input = AnyImage;
    type Output = AnyImage;

    fn doing(&self, job: &Job) -> String {
        format!("tone mapping {}", job.input.display())
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, job: &Job) -> Value {
        json!({"input": job.input.to_string_lossy(), "inverse": self.args.inverse, "tone": self.curve})
    }

    fn read(&self, job: &Job) -> Result<AnyImage> {
        Ok(match self.args.inverse {
            true => AnyImage::ToneMapped(read_image::<ToneMapped>(&job.input)?),
            false => AnyImage::Linear(read_image::<Linear>(&job.input)?),
        })
    }

    fn compute(&self, _: &Job, image: AnyImage) -> Result<AnyImage> {
        Ok(match image {
            AnyImage::Linear(image) => AnyImage::ToneMapped(self.curve.tone_map(&image)),
            AnyImage::ToneMapped(image) => AnyImage::Linear(self.curve.inverse_tone_map(&image)),
        })
    }

    fn write(&self, job: &Job, image: AnyImage) -> Result<()> {
        let options = WriteOptions {
            half: self.args.half,
            overwrite: self.session.overwrite,
            provenance: Some(Provenance::new("tonemap", &self.describe(job))),
        };
        if let Some(folder) = &job.folder {
            create_folder(folder)?;
        }
        let domain = image.domain();
        image.write(&job.output, domain, self.curve, &options)?;
        self.session.tell(job.output.display());
        Ok(())
    }
}
