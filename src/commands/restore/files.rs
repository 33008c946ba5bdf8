//! Which files become which: outputs named before the work, captures read, results written in their domain.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use udc::core::image::{Linear, LinearImage, ToneMapped, ToneMappedImage};
use udc::core::io::{
    DomainTag, Format, WriteOptions, check_output, expand_inputs, image_of, inspect_image, read_pixels,
    write_image,
};
use udc::core::tone::ToneCurve;
use udc::psf::{Bracket, FuseConfig, fuse};

use super::text;
use crate::commands::Session;
use crate::commands::domain::DomainArg;

/// Where the published dataset keeps its captures.
const PUBLISHED_CAPTURES: &str = "real_data/input";

/// One image to make.
pub(super) struct Job {
    /// The capture, or the pictures of a bracket.
    pub(super) inputs: Vec<PathBuf>,
    /// The exposure times of a bracket.
    times: Option<Vec<f64>>,
    /// The image to write.
    pub(super) output: PathBuf,
}

/// An image in one of the two domains.
pub(super) enum AnyImage {
    Linear(LinearImage),
    ToneMapped(ToneMappedImage),
}

/// What was read for a job.
pub(super) struct Capture {
    /// The image.
    pub(super) pixels: AnyImage,
    /// The irradiance of a saturated pixel, where the files say it.
    pub(super) saturation: Option<f32>,
}

impl Job {
    pub(super) fn name(&self) -> String {
        self.inputs.iter().map(|path| text(path)).collect::<Vec<_>>().join(" ")
    }
}

/// One job for each input file.
pub(super) fn jobs(
    inputs: &[PathBuf],
    output: &Path,
    extension: &str,
    session: &Session,
) -> Result<Vec<Job>> {
    let files = expand_inputs(&inputs.iter().map(|input| captures_of(input)).collect::<Vec<_>>())?;
    let to_folder = files.len() > 1 || inputs.iter().any(|input| input.is_dir()) || output.is_dir();
    if to_folder {
        std::fs::create_dir_all(output)
            .with_context(|| format!("creating the folder {}", output.display()))?;
    }
    let mut jobs: Vec<Job> = Vec::with_capacity(files.len());
    for file in files {
        let name = Path::new(file.file_stem().unwrap_or_default()).to_owned();
        let output =
            if to_folder { output.join(format!("{}.{extension}", text(&name))) } else { output.to_owned() };
        Format::of_extension(&output)?;
        check_output(&output, session.overwrite)?;
        if let Some(other) = jobs.iter().find(|job| job.output == output) {
            bail!("{} and {} would both be written to {}", other.name(), file.display(), output.display());
        }
        jobs.push(Job { inputs: vec![file], times: None, output });
    }
    Ok(jobs)
}

/// The one job of a bracket.
pub(super) fn bracket_job(
    inputs: &[PathBuf],
    times: &[f64],
    output: &Path,
    session: &Session,
) -> Result<Vec<Job>> {
    let inputs = expand_inputs(inputs)?;
    Format::of_extension(output)?;
    check_output(output, session.overwrite)?;
    Ok(vec![Job { inputs, times: Some(times.to_vec()), output: output.to_owned() }])
}

fn captures_of(input: &Path) -> PathBuf {
    let published = input.join(PUBLISHED_CAPTURES);
    if published.is_dir() { published } else { input.to_owned() }
}

impl Capture {
    pub(super) fn read(job: &Job, domain: Option<DomainArg>) -> Result<Self> {
        if let Some(times) = &job.times {
            return read_bracket(&job.inputs, times);
        }
        let path = &job.inputs[0];
        let (pixels, encoding) = inspect_image(path)?;
        let is_integer = matches!(encoding.format, Format::Png | Format::Jpeg | Format::Tiff)
            && encoding.sample_type.starts_with("uint");
        let declared = pixels.domain.map(DomainArg::from);
        let pixels = match domain.or(declared) {
            None if is_integer => bail!(
                "{} does not say whether its values are linear or tone-mapped: add --domain linear or --domain \
                 tone-mapped",
                path.display()
            ),
            Some(DomainArg::ToneMapped) => AnyImage::ToneMapped(image_of::<ToneMapped>(path, pixels)?),
            Some(DomainArg::Linear) | None => AnyImage::Linear(image_of::<Linear>(path, pixels)?),
        };
        Ok(Self { pixels, saturation: None })
    }
}

fn read_bracket(inputs: &[PathBuf], times: &[f64]) -> Result<Capture> {
    let mut pictures = Vec::with_capacity(inputs.len());
    for path in inputs {
        let picture = read_pixels(path)?;
        if picture.domain == Some(DomainTag::ToneMapped) {
            bail!(
                "{} holds tone-mapped values, which add up to nothing; use the linear pictures",
                path.display()
            );
        }
        pictures.push(picture.planes);
    }
    let config = FuseConfig::default();
    let bracket = Bracket::new(pictures, times)?;
    let shortest = bracket.times().into_iter().fold(f64::INFINITY, f64::min);
    let fused = fuse(&bracket, &config)?;
    #[expect(clippy::cast_possible_truncation, reason = "an irradiance in f32")]
    let saturation = (config.white * config.saturation / shortest) as f32;
    Ok(Capture { pixels: AnyImage::Linear(fused.image), saturation: Some(saturation) })
}

impl AnyImage {
    pub(super) fn domain(&self) -> DomainArg {
        match self {
            Self::Linear(_) => DomainArg::Linear,
            Self::ToneMapped(_) => DomainArg::ToneMapped,
        }
    }

    pub(super) fn into_linear(self, curve: ToneCurve) -> LinearImage {
        match self {
            Self::Linear(image) => image,
            Self::ToneMapped(image) => curve.inverse_tone_map(&image),
        }
    }

    pub(super) fn into_tone_mapped(self, curve: ToneCurve) -> ToneMappedImage {
        match self {
            Self::Linear(image) => curve.tone_map(&image),
            Self::ToneMapped(image) => image,
        }
    }
}

/// Refuses linear light in a file of integers, before the work.
pub(super) fn check_domain_of_output(path: &Path, domain: DomainArg) -> Result<()> {
    let holds_floats = matches!(Format::of_extension(path)?, Format::Exr | Format::Npy | Format::Hdr);
    if domain == DomainArg::Linear && !holds_floats {
        bail!(
            "{} cannot hold linear light above one: add --output-domain tone-mapped, or write .exr or .npy",
            path.display()
        );
    }
    Ok(())
}

pub(super) fn write(
    path: &Path,
    image: AnyImage,
    domain: DomainArg,
    curve: ToneCurve,
    options: &WriteOptions,
) -> Result<()> {
    match domain {
        DomainArg::Linear => write_image(path, &image.into_linear(curve), options)?,
        DomainArg::ToneMapped => write_image(path, &image.into_tone_mapped(curve), options)?,
    }
    Ok(())
}
