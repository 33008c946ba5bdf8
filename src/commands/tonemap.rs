//! `udc tonemap`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};

use super::Session;
use super::capture::note_what_is_lost;
use super::choices::FORMATS;
use super::destination::{Destination, OutputFolder, Unplaced};
use super::domain::LightDomainArg;
use super::queue::{Stages, run_all};
use udc::core::capture::CaptureInfo;
use udc::core::image::{Linear, ToneMapped};
use udc::core::provenance::Provenance;
use udc::core::tone::ToneCurve;
use udc::io::{AnyImage, DomainTag, WriteOptions, expand_inputs, image_of, read_pixels, without_repeats};

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
    /// Image to write; a folder for several inputs, or if the name ends in a slash
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Map tone-mapped values back to linear light
    #[arg(long, conflicts_with = "domain")]
    inverse: bool,
    /// What the inputs hold: srgb is decoded to linear light first; pictures of integers must be told [default: what the file
    /// says, else linear; with --inverse tone-mapped]
    ///
    /// Tone-mapped images are for --inverse, which takes them for that whatever their format.
    #[arg(long, value_enum, value_name = "DOMAIN")]
    domain: Option<LightDomainArg>,
    /// Irradiance that is mapped to one half
    #[arg(long, value_name = "A", default_value_t = ToneCurve::default().alpha)]
    alpha: f32,
    /// Irradiance at which the sensor saturates
    #[arg(long, value_name = "X", default_value_t = ToneCurve::default().x_max)]
    x_max: f32,
    /// Format of the files in an output folder
    #[arg(long, value_parser = FORMATS, default_value = "exr")]
    format: &'static str,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
}

impl TonemapArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let curve = ToneCurve::new(self.alpha, self.x_max)?;
        let jobs = self.jobs(session)?;
        let _folder = OutputFolder::of(&mut jobs.iter().map(|job| job.output.as_path()))?;
        run_all(&Mapping { args: &self, curve, session }, &jobs, session)
    }

    /// What becomes what; refuses outputs that exist before any work.
    fn jobs(&self, session: &Session) -> Result<Vec<Job>> {
        let files = without_repeats(expand_inputs(&self.inputs)?);
        let destination =
            Destination { path: &self.output, extension: self.format, accepts_existing: session.overwrite };
        let results: Vec<Unplaced> = files.iter().map(|file| Unplaced::of_file(file)).collect();
        let outputs = destination.place(&results, self.inputs.iter().any(|input| input.is_dir()))?;
        Ok(files.into_iter().zip(outputs).map(|(input, output)| Job { input, output }).collect())
    }
}

/// One image to make.
struct Job {
    input: PathBuf,
    output: PathBuf,
}

struct Mapping<'a> {
    args: &'a TonemapArgs,
    curve: ToneCurve,
    session: &'a Session,
}

impl Stages for Mapping<'_> {
    type Job = Job;
    type Input = (AnyImage, Option<CaptureInfo>);
    type Output = (AnyImage, Option<CaptureInfo>);

    fn doing(&self, job: &Job) -> String {
        format!("tone mapping {}", job.input.display())
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, job: &Job) -> Value {
        json!({
            "input": job.input.to_string_lossy(), "inverse": self.args.inverse, "tone": self.curve,
            "domain": self.args.domain.map(LightDomainArg::name),
        })
    }

    fn read(&self, job: &Job) -> Result<Self::Input> {
        let (told, path) = (self.args.domain.map(DomainTag::from), &job.input);
        let told = if self.args.inverse { Some(DomainTag::ToneMapped) } else { told };
        let mut pixels = read_pixels(path)?;
        pixels.tell(path, told)?.into_iter().for_each(|contradiction| self.session.warn(contradiction));
        let info = pixels.capture.take();
        let image = if self.args.inverse {
            AnyImage::ToneMapped(image_of::<ToneMapped>(path, pixels)?)
        } else {
            pixels.check_told_light(path)?;
            AnyImage::Linear(image_of::<Linear>(path, pixels)?)
        };
        Ok((image, info))
    }

    fn compute(&self, _: &Job, (image, info): Self::Input) -> Result<Self::Output> {
        let image = match image {
            AnyImage::Linear(image) => AnyImage::ToneMapped(self.curve.tone_map(&image)),
            AnyImage::ToneMapped(image) => AnyImage::Linear(self.curve.inverse_tone_map(&image)),
        };
        Ok((image, info))
    }

    fn write(&self, job: &Job, (image, info): Self::Output) -> Result<()> {
        if let Some(info) = &info {
            note_what_is_lost(&job.output, info, self.session);
        }
        let options = WriteOptions {
            half: self.args.half,
            overwrite: self.session.overwrite,
            provenance: Some(Provenance::new("tonemap", &self.describe(job))),
            capture: info,
        };
        let domain = image.domain();
        image.write(&job.output, domain, self.curve, &options)?;
        self.session.tell(job.output.display());
        Ok(())
    }
}
