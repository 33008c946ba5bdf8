//! `udc finish`.

mod pairs;
mod style;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use udc::core::capture::{CaptureInfo, is_exposure, is_level};
use udc::core::error::Error;
use udc::core::image::CHANNELS;
use udc::core::orientation::Orientation;
use udc::core::provenance::Provenance;
use udc::core::tone::ToneCurve;
use udc::finish::{
    Curve, FinishConfig, Look, Photograph, automatic_curve, channel_means, finish, read_color_matrix,
};
use udc::io::{AnyImage, Format, WriteOptions, read_pixels};

use super::destination::OutputFolder;
use super::domain::DomainArg;
use super::picture::read_any;
use super::queue::{Stages, remaining, run_all};
use super::{Session, misuse, text_of};
use pairs::Job;
use style::StyleArgs;

/// Finish restored images for viewing: colour matrix, curve, reference scaling, local contrast
///
/// The steps, in this order: inverse tone mapping of tone-mapped images, putting it upright, clipped highlights, clip, colour
/// matrix, curve, scaling of the channels to the means of a reference picture, CLAHE of lightness. An EXR of `udc restore`
/// or `udc fuse` says itself how its capture lies, where it clips, and the colour matrix of its camera.
///
/// The exposure is chosen from the picture, unless there is a --reference or a flag of the curve: the median is shown as
/// middle grey, but no more than three stops brighter than the camera exposed it (its baseline exposure respected), and
/// white is the light that 99 % of the unclipped pixels stay below, but no more than where the capture clips; --verbose
/// says what was chosen. --ccm and --reference may be folders, whose files
/// belong to the images of the same name. The folder of the published dataset stands for its real captures with
/// their matrices and pictures. A file that cannot be finished is named at the end, the others are done.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc finish restored.exr -o restored.png\n  \
    udc finish restored.exr --ccm ccm.txt --reference phone.jpg -o restored.jpg\n  \
    udc finish restored/ --ccm real_data/CCM_txt --reference real_data/jpg_ZTE -o finished/\n  \
    udc finish PUBLISHED_ROOT -o finished/ --resume")]
pub(crate) struct FinishArgs {
    /// Images, folders or patterns; also the folder of the published dataset
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write; a folder for several inputs, or if the name ends in a slash
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// What the inputs hold: srgb is decoded to linear light [default: what the file says, else linear; integer formats must
    /// be told]
    #[arg(long, value_enum, value_name = "DOMAIN")]
    domain: Option<DomainArg>,
    /// Colour matrix: .txt `key: nine numbers`, .npy, .toml; or a folder of them
    #[arg(long, value_name = "FILE")]
    ccm: Option<PathBuf>,
    /// Leave out the colour matrices of the published dataset and of cameras
    #[arg(long, conflicts_with = "ccm")]
    no_ccm: bool,
    /// Picture, of any size, whose channel means to take over; or a folder of them
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Leave out the reference pictures of the published dataset
    #[arg(long, conflicts_with = "reference")]
    no_reference: bool,
    /// How the picture lies, as EXIF numbers it: 1 upright, 3 upside down, 6 to be turned right, 8 left [default: what the
    /// file says, else 1]
    #[arg(long, value_name = "1…8", value_parser = parse_orientation)]
    orientation: Option<Orientation>,
    /// Light at which red, green and blue of the capture clip; what is clipped is made neutral [default: what the file says]
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', num_args = 1, value_parser = parse_level)]
    saturation: Option<Vec<f32>>,
    /// Stops by which the camera wants its captures brightened, which the automatic exposure respects [default: what the file
    /// says, else 0]
    #[arg(long, value_name = "EV", value_parser = parse_exposure, allow_negative_numbers = true)]
    baseline_exposure: Option<f64>,
    #[command(flatten)]
    style: StyleArgs,
    /// Format of the files in an output folder
    #[arg(long, value_enum, value_name = "FORMAT", default_value_t = FormatArg::Png)]
    format: FormatArg,
    /// Keep the images that are there and go on with the others
    ///
    /// An EXR says how it was made, and is refused if that was otherwise or of files with other contents (SHA-256), wherever
    /// they lie; other formats are kept as they are.
    #[arg(long)]
    resume: bool,
    /// Bits of PNG and TIFF [default: 8 for PNG, 16 for TIFF]
    #[arg(long, value_name = "8|16", value_parser = parse_bits)]
    bits: Option<u8>,
    /// Irradiance that the tone mapping maps to one half
    #[arg(long, value_name = "A", default_value_t = ToneCurve::default().alpha)]
    alpha: f32,
    /// Irradiance at which the capture saturates
    #[arg(long, value_name = "X", default_value_t = ToneCurve::default().x_max)]
    x_max: f32,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    Png,
    Jpg,
    Tif,
    Exr,
}

fn parse_bits(text: &str) -> Result<u8, String> {
    match text {
        "8" => Ok(8),
        "16" => Ok(16),
        _ => Err("write 8 or 16".to_owned()),
    }
}

fn parse_orientation(text: &str) -> Result<Orientation, String> {
    let number = text.parse().ok();
    number.and_then(Orientation::from_exif).ok_or_else(|| "write a number from 1 to 8".to_owned())
}

fn parse_exposure(text: &str) -> Result<f64, String> {
    let stops = text.trim().parse().ok().filter(|stops| is_exposure(*stops));
    stops.ok_or_else(|| "write a number of stops from -10 to 10".to_owned())
}

fn parse_level(text: &str) -> Result<f32, String> {
    let level = text.trim().parse().ok().filter(|level| is_level(*level));
    level.ok_or_else(|| "write three numbers from 1e-6 to 1e9, for red, green and blue: 1.9,1,1.6".to_owned())
}

impl FinishArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if let Some(count) = self.saturation.as_ref().map(Vec::len).filter(|count| *count != CHANNELS) {
            return Err(misuse(
                "finish",
                &format!("--saturation takes three levels, red, green and blue; found {count}"),
            ));
        }
        if self.baseline_exposure.is_some() && (self.reference.is_some() || self.style.says_curve()) {
            return Err(misuse(
                "finish",
                "--baseline-exposure belongs to the automatic exposure: leave out --reference and the flags of the curve",
            ));
        }
        let curve = ToneCurve::new(self.alpha, self.x_max)?;
        self.style.check_curve()?;
        let config = self.style.config();
        config.check()?;
        let mut jobs = self.jobs(session)?;
        let ignores = |job: &&Job, bits: u8| match Format::of_extension(&job.output) {
            Ok(Format::Png | Format::Tiff) | Err(_) => false,
            Ok(Format::Jpeg) => bits != 8,
            Ok(_) => true,
        };
        if let Some(bits) = self.bits
            && let Some(job) = jobs.iter().find(|job| ignores(job, bits))
        {
            bail!(
                "--bits {bits} is for PNG and TIFF, and {} would ignore it; leave it out",
                job.output.display()
            );
        }
        let finishing = Finishing { args: &self, curve, config, session };
        if self.resume {
            jobs = remaining(&finishing, jobs, session)?;
        }
        let _folder = OutputFolder::of(&mut jobs.iter().map(|job| job.output.as_path()))?;
        run_all(&finishing, &jobs, session)
    }
}

impl FormatArg {
    fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpg => "jpg",
            Self::Tif => "tif",
            Self::Exr => "exr",
        }
    }
}

struct Finishing<'a> {
    args: &'a FinishArgs,
    curve: ToneCurve,
    config: FinishConfig,
    session: &'a Session,
}

impl Finishing<'_> {
    /// Whether the exposure of a picture is chosen from it.
    fn is_automatic(&self, job: &Job) -> bool {
        job.reference.is_none() && !self.args.style.says_curve()
    }

    /// The look that is said of the capture, and the flags that override it.
    fn look(&self, job: &Job, said: &CaptureInfo) -> Result<Look> {
        let said = CaptureInfo {
            baseline_exposure_ev: self.args.baseline_exposure.or(said.baseline_exposure_ev),
            orientation: self.args.orientation.or(said.orientation),
            ..said.clone()
        };
        let mut look = Look::of_capture(&said);
        look.ccm = look.ccm.filter(|_| !self.args.no_ccm);
        if let Some(&[red, green, blue]) = self.args.saturation.as_deref() {
            look.saturation = Some([red, green, blue]);
        }
        if let Some(path) = &job.ccm {
            look.ccm = Some(read_color_matrix(path)?);
        }
        Ok(look)
    }

    /// The settings for a job's format.
    fn config_of(&self, job: &Job) -> FinishConfig {
        let eight_bit = match (Format::of_extension(&job.output).ok(), self.args.bits) {
            (Some(Format::Jpeg), _) => true,
            (Some(Format::Png), bits) => bits != Some(16),
            (Some(Format::Tiff), bits) => bits == Some(8),
            _ => false,
        };
        // An exposure that is chosen needs no limit beside.
        let clip = if self.is_automatic(job) { self.args.style.clip_given() } else { self.config.clip };
        FinishConfig { eight_bit, clip, ..self.config }
    }
}

impl Stages for Finishing<'_> {
    type Job = Job;
    type Input = (AnyImage, Look);
    type Output = Photograph;

    fn doing(&self, job: &Job) -> String {
        format!("finishing {}", job.input.display())
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, job: &Job) -> Value {
        let mut finish = json!(self.config_of(job));
        if self.is_automatic(job) {
            finish["curve"] = json!("automatic");
        }
        json!({
            "domain": self.args.domain.map(DomainArg::name), "tone": self.curve, "finish": finish,
            "orientation": self.args.orientation, "saturation": self.args.saturation,
            "baseline-exposure-ev": self.args.baseline_exposure,
        })
    }

    fn identify(&self, job: &Job) -> Result<Value> {
        let [input, ccm, reference] = job.sha256()?;
        Ok(json!({ "input-sha256": input, "ccm-sha256": ccm, "reference-sha256": reference }))
    }

    fn read(&self, job: &Job) -> Result<Self::Input> {
        // Before the pixels, so that they are not older than it.
        job.sha256()?;
        let read = || read_any(&job.input, self.args.domain, self.session);
        let (image, said) = self.session.timed(format_args!("reading {}", job.input.display()), read)?;
        let mut look = self.look(job, &said.unwrap_or_default())?;
        if let (Some(ccm), Some(path)) = (&look.ccm, &job.ccm)
            && ccm.looks_transposed()
        {
            self.session.warn(format_args!(
                "the columns of {} sum to one, not its rows, so that grey becomes coloured; it may be transposed",
                path.display()
            ));
        }
        if let Some(path) = &job.reference {
            // Not light but a look: its values are compared with those that are shown.
            let planes = read_pixels(path)?.planes;
            if planes.dim().0 != 3 {
                return Err(Error::format(path, "is grey; a reference picture has three channels").into());
            }
            look.reference_means = Some(channel_means(&planes));
        }
        Ok((image, look))
    }

    fn compute(&self, job: &Job, (image, look): Self::Input) -> Result<Photograph> {
        let image = image.into_linear(self.curve);
        let mut config = self.config_of(job);
        if self.is_automatic(job) {
            config.curve = automatic_curve(&image, &look, self.args.x_max);
            if let Curve::Photographic { grey, white } = config.curve {
                let input = job.input.display();
                self.session
                    .detail(format_args!("{input}: middle grey at light {grey:.4}, white at {white:.4}"));
            }
        }
        let planes = self.session.timed(self.doing(job), || finish(image, &look, &config))?;
        Ok(Photograph { planes, look, curve: config.curve, eight_bit: config.eight_bit })
    }

    fn write(&self, job: &Job, photograph: Photograph) -> Result<()> {
        let mut described = self.describe(job);
        // Where the files lay; what they are is told by their contents.
        let text = |path: &Option<PathBuf>| path.as_deref().map(text_of);
        described["input"] = json!(text_of(&job.input));
        described["ccm"] = json!(text(&job.ccm));
        described["reference"] = json!(text(&job.reference));
        let [input, ccm, reference] = job.sha256()?;
        described["input-sha256"] = json!(input);
        described["ccm-sha256"] = json!(ccm);
        described["reference-sha256"] = json!(reference);
        described["look"] = json!(photograph.look);
        described["curve"] = json!(photograph.curve);
        let provenance = Some(Provenance::new("finish", &described));
        let options =
            WriteOptions { overwrite: self.session.overwrite, provenance, ..WriteOptions::default() };
        let write = || photograph.write(&job.output, &options);
        self.session.timed(format_args!("writing {}", job.output.display()), write)?;
        self.session.tell(job.output.display());
        Ok(())
    }
}
