//! `udc finish`.

mod style;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use udc::batch::Destination;
use udc::core::capture::{CaptureInfo, parse_exposure, parse_level};
use udc::core::orientation::Orientation;
use udc::core::shard::Shard;
use udc::core::tone::ToneFlags;
use udc::finish::{Companions, FinishInputs, FinishPlan};
use udc::io::DomainTag;

use super::choices::{Choices, DOMAINS};
use super::layer::LayerArgs;
use super::{Session, misuse};
use style::StyleArgs;

/// Finish restored images for viewing: colour matrix, curve, reference scaling, local contrast
///
/// The steps, in this order: inverse tone mapping of tone-mapped images, putting it upright, clipped highlights, clip, colour
/// matrix, colours of the display, curve, scaling of the channels to the means of a reference picture, CLAHE of lightness. An
/// EXR of `udc restore` or `udc fuse` says itself how its capture lies, where it clips, and the colour matrix of its camera; one
/// of other primaries than those of sRGB is converted. What the camera says (EXIF) goes into the picture.
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
    udc finish restored.exr --color-space display-p3 --hdr -o restored.jpg\n  \
    udc finish render.exr --layer beauty --bits 16 -o beauty.tif\n  \
    udc finish restored/ --ccm real_data/CCM_txt --reference real_data/jpg_ZTE -o finished/\n  \
    udc finish PUBLISHED_ROOT -o finished/ --resume\n  \
    udc finish restored/ -o finished/ --shard 2/8")]
pub(crate) struct FinishArgs {
    /// Images, folders or patterns; also the folder of the published dataset
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write, .png, .jpg, .tif or .exr; a folder for several inputs, or if the name ends in a slash
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// What the inputs hold: srgb is decoded to linear light [default: what the file says, else linear; required
    /// for 8- and 16-bit files that do not say it]
    #[arg(long, value_name = "DOMAIN", value_parser = DOMAINS)]
    domain: Option<DomainTag>,
    /// Colour matrix: .txt `key: nine numbers`, .npy, .toml; or a folder of them
    #[arg(long, value_name = "FILE")]
    ccm: Option<PathBuf>,
    /// Leave out the colour matrices of the published dataset and of cameras; other primaries than those of sRGB are converted still
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
    #[arg(long, value_name = "1…8")]
    orientation: Option<Orientation>,
    /// Light at which red, green and blue of the capture clip; what is clipped is made neutral [default: what the file says]
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', num_args = 1, value_parser = parse_level)]
    saturation: Option<Vec<f32>>,
    /// Stops by which the camera wants its captures brightened, which the automatic exposure respects [default: what the file
    /// says, else 0]
    #[arg(long, value_name = "EV", value_parser = parse_exposure, allow_negative_numbers = true)]
    baseline_exposure: Option<f64>,
    #[command(flatten)]
    layer: LayerArgs,
    #[command(flatten)]
    style: StyleArgs,
    /// Format of the files in an output folder [default: png]
    #[arg(long, value_name = "FORMAT", value_parser = PICTURE_FORMATS)]
    format: Option<&'static str>,
    /// Keep the images that are there and go on with the others
    ///
    /// An EXR says how it was made, and is refused if that was otherwise or of files with other contents (SHA-256), wherever
    /// they lie; other formats are kept as they are.
    #[arg(long)]
    resume: bool,
    /// Leave out what the camera says of the picture: its name, time, exposure, position
    #[arg(long)]
    no_exif: bool,
    /// Finish only the I-th of N parts; all parts may be finished at the same time, into one folder
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    /// Bits of PNG and TIFF [default: 8 for PNG, 16 for TIFF]
    #[arg(long, alias = "depth", value_name = "8|16", value_parser = BITS)]
    bits: Option<u8>,
    /// Irradiance that the tone mapping maps to one half [default: what a tone-mapped file says, else 0.25]
    #[arg(long, value_name = "A")]
    alpha: Option<f32>,
    /// Irradiance at which the capture, fused of all its exposures, saturates [default: what the file's origin says, else
    /// 500]
    #[arg(long, value_name = "X")]
    x_max: Option<f32>,
}

/// The formats of pictures in an output folder, as their extensions.
const PICTURE_FORMATS: Choices<&str> =
    Choices(&[("png", "png", ""), ("jpg", "jpg", ""), ("tif", "tif", ""), ("exr", "exr", "")]);

const BITS: Choices<u8> = Choices(&[("8", 8, ""), ("16", 16, "")]);

impl FinishArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let plan = self.plan(session)?;
        let inputs = FinishInputs {
            images: self.layer.of(&self.inputs),
            ccm: companions(self.no_ccm, self.ccm),
            reference: companions(self.no_reference, self.reference),
        };
        let destination = Destination {
            path: &self.output,
            extension: self.format.unwrap_or("png"),
            is_asked: self.format.is_some(),
            accepts_existing: session.overwrite || self.resume,
            shard: self.shard,
        };
        Ok(plan.run(&inputs, &destination, self.resume, session)?)
    }

    fn plan(&self, session: &Session) -> Result<FinishPlan> {
        let saturation = match self.saturation.as_deref() {
            None => None,
            Some(&[red, green, blue]) => Some([red, green, blue]),
            Some(levels) => {
                let count = levels.len();
                let reason = format!("--saturation takes three levels, red, green and blue; found {count}");
                return Err(misuse("finish", &reason));
            }
        };
        if self.baseline_exposure.is_some() && (self.reference.is_some() || self.style.says_curve()) {
            return Err(misuse(
                "finish",
                "--baseline-exposure belongs to the automatic exposure: leave out --reference and the flags of the curve",
            ));
        }
        Ok(FinishPlan {
            domain: self.domain,
            tone: ToneFlags { alpha: self.alpha, x_max: self.x_max },
            style: self.style.style()?,
            told: CaptureInfo {
                saturation,
                orientation: self.orientation,
                baseline_exposure_ev: self.baseline_exposure,
                ..CaptureInfo::default()
            },
            bits: self.bits,
            leaves_out_exif: self.no_exif,
            overwrite: session.overwrite,
        })
    }
}

/// Where what belongs to images is looked for, by the flag that leaves it out and the one that names it.
fn companions(are_left_out: bool, named: Option<PathBuf>) -> Companions {
    if are_left_out { Companions::Nowhere } else { named.map_or(Companions::OfImages, Companions::At) }
}
