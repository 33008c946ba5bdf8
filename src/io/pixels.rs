//! Pixels as files hold them, and what files say of them, before their meaning is decided.

use std::path::Path;

use ndarray::{Array3, Axis};
use serde::Serialize;

use super::ColorTag;
use crate::core::bayer::{BayerPattern, looks_mosaicked};
use crate::core::camera_color::CameraColor;
use crate::core::capture::CaptureInfo;
use crate::core::exif::Exif;
use crate::core::image::{Domain, Linear, ToneMapped};
use crate::core::orientation::Orientation;
use crate::core::provenance::Provenance;

/// What the numbers of a file mean, where the file says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DomainTag {
    /// Linear irradiance.
    Linear,
    /// After the tone mapping φ.
    ToneMapped,
    /// For viewing, as `udc finish` makes them: no light can be computed from these.
    Display,
    /// Linear light in `[0, 1]`, encoded by the curve of sRGB, as pictures of most cameras and programs are. Only the user
    /// says it: such values are decoded when they are read, and no file of this domain is written.
    Srgb,
}

impl DomainTag {
    /// The name written to files; `--domain` accepts those of light, linear or tone-mapped.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => Linear::NAME,
            Self::ToneMapped => ToneMapped::NAME,
            Self::Display => "display",
            Self::Srgb => "srgb",
        }
    }

    /// The tag of a name in a file; `None` for a name that is not a domain's.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Linear, Self::ToneMapped, Self::Display].into_iter().find(|tag| tag.name() == name)
    }
}

/// The contents of an image file before their meaning is decided.
///
/// # Shapes
/// `planes` is `[channels, height, width]` with 1, 3 or (packed Bayer) 4 channels; integer formats are
/// divided by their type's maximum.
#[derive(Clone, Debug)]
pub struct Pixels {
    /// The values.
    pub planes: Array3<f32>,
    /// The domain that the file declares.
    pub domain: Option<DomainTag>,
    /// The exposure time that the file declares, in seconds.
    pub exposure_s: Option<f64>,
    /// The sensitivity (ISO) that the file declares: values grow with it as with the exposure time.
    pub iso: Option<f64>,
    /// The provenance that the file carries.
    pub provenance: Option<Provenance>,
    /// What a camera's raw file says of its values.
    pub raw: Option<RawMetadata>,
    /// Whether the samples are integers of 8 or 16 bits: unless the file says more, only the user knows what they mean.
    pub is_integer: bool,
    /// What the file says of its colours, which changes no value.
    pub color_tags: Vec<ColorTag>,
    /// What the file says of the capture that it was made of.
    pub capture: Option<CaptureInfo>,
    /// Pixels that the file shows and holds no data of: they are black.
    pub without_data: usize,
    /// What the file says and its reading does not heed, each to be told to the user.
    pub doubts: Vec<String>,
}

/// A correction that a raw file asks for and that was not made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IgnoredOpcode {
    /// The name of the opcode in the specification, or its number.
    pub name: String,
    /// Whether the file allows that it is left out.
    pub optional: bool,
}

/// What a camera's raw file says of its values; levels are in the units of the planes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RawMetadata {
    /// The colours of the mosaic; none for three full planes.
    pub bayer: Option<BayerPattern>,
    /// The value of a dark photosite.
    pub black: f64,
    /// The value of a full photosite.
    pub white: f64,
    /// Gains of red, green and blue that make grey grey.
    pub white_balance: Option<[f64; 3]>,
    /// The camera's colours.
    pub color: Option<CameraColor>,
    /// How the picture lies on the sensor, as the planes do.
    pub orientation: Orientation,
    /// By how many stops the camera wants the capture brightened.
    pub baseline_exposure_ev: Option<f64>,
    /// Corrections of the lens that the planes have.
    pub corrections: Vec<String>,
    /// Those that they have not.
    pub ignored: Vec<IgnoredOpcode>,
    /// What the camera says for those who look at the picture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exif: Option<Exif>,
}

impl Pixels {
    /// Takes planes over that a file says nothing about.
    pub fn of_planes(planes: Array3<f32>) -> Self {
        Self {
            planes,
            domain: None,
            exposure_s: None,
            iso: None,
            provenance: None,
            raw: None,
            is_integer: false,
            color_tags: Vec::new(),
            capture: None,
            without_data: 0,
            doubts: Vec::new(),
        }
    }

    /// What to tell of pixels without data where darkness is light like any other.
    pub fn describe_darkness(&self, path: &Path) -> Option<String> {
        self.darkness().map(|darkness| format!("{}: {darkness}", path.display()))
    }

    /// What to tell of one plane that seems to be a mosaic, and of whose colours nobody said anything.
    pub fn describe_mosaic(&self, path: &Path) -> Option<String> {
        let is_told = self.raw.is_some() || self.planes.dim().0 != 1;
        (!is_told && looks_mosaicked(self.planes.index_axis(Axis(0), 0))).then(|| {
            format!(
                "{}: its one channel looks like a Bayer mosaic, and is taken for grey; tell its colours with --bayer",
                path.display()
            )
        })
    }

    fn darkness(&self) -> Option<String> {
        let (_, height, width) = self.planes.dim();
        (self.without_data > 0).then(|| {
            format!(
                "its data window does not cover its display window: {} of {} pixels hold no data and are taken for darkness; crop \
                 the file to its data window",
                self.without_data,
                height * width
            )
        })
    }

    /// What to tell of the file itself, whatever its values are taken for: of pixels without data, and of what is not heeded.
    pub fn all_doubts(&self) -> Vec<String> {
        self.darkness().into_iter().chain(self.doubts.iter().cloned()).collect()
    }

    /// As [`all_doubts`](Self::all_doubts), each naming the file; there are none left.
    pub(super) fn take_doubts(&mut self, path: &Path) -> Vec<String> {
        let doubts =
            self.all_doubts().into_iter().map(|doubt| format!("{}: {doubt}", path.display())).collect();
        (self.without_data, self.doubts) = (0, Vec::new());
        doubts
    }
}

/// Pixels are square up to this share of their side: files round their numbers.
const SQUARE: f64 = 1e-3;

/// What to tell of a file that declares its pixels `aspect` times as wide as high.
pub(super) fn doubt_of_shape(aspect: f64, said_by: &str) -> Option<String> {
    let is_square = (aspect - 1.0).abs() <= SQUARE;
    let is_shape = aspect.is_finite() && aspect > 0.0;
    (is_shape && !is_square).then(|| {
        format!(
            "its pixels are {aspect:.3} times as wide as high ({said_by}) and taken as they are: a PSF fits only if its pixels have \
             the same shape"
        )
    })
}
