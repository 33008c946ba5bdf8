//! Turns restored linear light into a photograph for viewing.
//!
//! The steps, each of which can be left out: putting it upright, clipped highlights, clip, colour matrix, colours of the
//! display, transfer curve, scaling of the channels to a reference picture, local contrast (CLAHE).

mod clahe;
mod color_matrix;
mod curve;
mod exposure;
mod headroom;
mod highlights;
mod lab;
mod noise_floor;
mod pairs;
mod photograph;
mod plan;
mod reference;
mod roll_off;
mod style;

use ndarray::{Array2, Array3, Axis, Zip};
use serde::Serialize;

use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::LinearImage;
use crate::core::orientation::Orientation;
use crate::core::primaries::{ColorSpace, Primaries};

pub use clahe::ClaheConfig;
pub use color_matrix::{ColorMatrix, read_color_matrix};
pub use curve::{Curve, CurveKind};
pub use exposure::automatic_curve;
pub use noise_floor::NoiseFloor;
pub use pairs::{Companions, FinishInputs};
pub use photograph::{Photograph, photograph};
pub use plan::FinishPlan;
pub use roll_off::RollOff;
pub use style::{Clip, Style};

/// What is done to every picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct FinishConfig {
    /// Irradiance above which light is clipped before the colour matrix.
    pub clip: Option<f32>,
    /// How light becomes display values.
    pub curve: Curve,
    /// How the curve is applied to colours.
    pub roll_off: RollOff,
    /// The colours of the result.
    pub color_space: ColorSpace,
    /// Local contrast.
    pub clahe: Option<ClaheConfig>,
    /// The stops by which displays with headroom may show highlights brighter than white; none for pictures without gains.
    pub hdr_stops: Option<f32>,
    /// Whether the result is to be written with 8 bits: local contrast is then computed in 8 bits too.
    pub eight_bit: bool,
}

impl Default for FinishConfig {
    /// As the published real captures are shown: clip 16, gamma 2.8 of light up to 6 in each channel of sRGB, CLAHE.
    fn default() -> Self {
        Self {
            clip: Some(16.0),
            curve: Curve::default(),
            roll_off: RollOff::default(),
            color_space: ColorSpace::default(),
            clahe: Some(ClaheConfig::default()),
            hdr_stops: None,
            eight_bit: true,
        }
    }
}

/// What belongs to one picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Look {
    /// The colour matrix of its camera and light.
    pub ccm: Option<ColorMatrix>,
    /// The mean of each channel of a reference picture, in display values.
    pub reference_means: Option<[f64; 3]>,
    /// The light of a full photosite in each channel, where it is known: what is clipped gets its likely colour.
    pub saturation: Option<[f32; 3]>,
    /// By how many stops the camera wants its captures brightened, which [`automatic_curve`] respects.
    pub baseline_exposure_ev: Option<f32>,
    /// How the picture lies in the image.
    pub orientation: Orientation,
}

impl Look {
    /// The look that is known of a capture.
    pub fn of_capture(info: &CaptureInfo) -> Self {
        Self {
            ccm: info.color_matrix().map(ColorMatrix::of),
            saturation: info.saturation,
            #[expect(clippy::cast_possible_truncation, reason = "a few stops")]
            baseline_exposure_ev: info.baseline_exposure_ev.map(|stops| stops as f32),
            orientation: info.orientation.unwrap_or_default(),
            reference_means: None,
        }
    }

    /// The light of a pixel: clipped channels estimated, then the colour matrix.
    fn light_of(&self, pixel: [f32; 3]) -> [f32; 3] {
        let pixel = self.saturation.map_or(pixel, |white| highlights::unclipped(pixel, white));
        self.ccm.map_or(pixel, |ccm| ccm.apply_to(pixel))
    }

    fn is_clipped(&self, pixel: [f32; 3]) -> bool {
        self.saturation.is_some_and(|white| highlights::is_clipped(pixel, white))
    }
}

/// Finishes a picture.
///
/// # Range
/// Display values in `[0, 1]`, `[3, height, width]`.
///
/// # Errors
/// [`Error::Config`] naming a setting that is out of range.
pub fn finish(image: LinearImage, look: &Look, config: &FinishConfig) -> Result<Array3<f32>> {
    finish_with_gains(image, look, config).map(|(planes, _)| planes)
}

/// As [`finish`], with the stops by which each pixel may be shown brighter, where they are asked for.
fn finish_with_gains(
    image: LinearImage,
    look: &Look,
    config: &FinishConfig,
) -> Result<(Array3<f32>, Option<Array2<f32>>)> {
    config.check()?;
    let mut planes = look.orientation.upright(image.into_planes());
    if let Some(white) = look.saturation {
        each_pixel(&mut planes, |pixel| highlights::unclipped(pixel, white));
    }
    if let Some(clip) = config.clip {
        planes.par_mapv_inplace(|x| x.clamp(0.0, clip));
    }
    if let Some(ccm) = &look.ccm {
        ccm.apply(&mut planes);
    }
    if config.color_space != ColorSpace::Srgb {
        to_display_colors(config.color_space).apply(&mut planes);
    }
    let (curve, roll_off) = (config.curve, config.roll_off);
    let gains = config.hdr_stops.map(|stops| headroom::gains(&planes, curve, stops));
    each_pixel(&mut planes, |pixel| roll_off.apply(curve, pixel));
    if let Some(means) = look.reference_means {
        scale_to_means(&mut planes, means);
    }
    if let Some(clahe) = &config.clahe {
        clahe::equalize(&mut planes, clahe, config.eight_bit, config.color_space);
    }
    Ok((planes, gains))
}

impl FinishConfig {
    /// Checks that every setting is in range.
    ///
    /// # Errors
    /// [`Error::Config`] naming the setting that is not.
    pub fn check(&self) -> Result<()> {
        let positive = |key: &str, value: f32| {
            if value.is_finite() && value > 0.0 {
                return Ok(());
            }
            Err(Error::config(key, format!("must be a positive number, found {value}")))
        };
        self.clip.map_or(Ok(()), |clip| positive("clip", clip))?;
        match self.curve {
            Curve::Gamma { gamma, max } => positive("gamma", gamma).and(positive("max", max))?,
            Curve::Srgb { max } | Curve::Aces { max } => positive("max", max)?,
            Curve::Photographic { grey, white } => {
                positive("grey", grey).and(positive("white", white))?;
                // One rounding of f32 and to spare.
                if grey > 0.180_001 * white {
                    let reason = format!("must be at most 0.18 of white {white}, found {grey}");
                    return Err(Error::config("grey", reason));
                }
            }
            Curve::None => {}
        }
        self.hdr_stops.map_or(Ok(()), |stops| headroom::check(stops, self.curve))?;
        self.clahe.as_ref().map_or(Ok(()), ClaheConfig::check)
    }
}

/// The matrix from linear sRGB to the linear colours of a display.
///
/// # Panics
/// Never: the primaries of displays span their colours.
fn to_display_colors(space: ColorSpace) -> ColorMatrix {
    let matrix = Primaries::SRGB.matrix_to(&space.primaries());
    ColorMatrix::of(matrix.expect("primaries of displays span their colours"))
}

/// Replaces each pixel by what becomes of it.
fn each_pixel(planes: &mut Array3<f32>, change: impl Fn([f32; 3]) -> [f32; 3] + Sync + Send) {
    let (mut r, rest) = planes.view_mut().split_at(Axis(0), 1);
    let (mut g, mut b) = rest.split_at(Axis(0), 1);
    Zip::from(&mut r).and(&mut g).and(&mut b).par_for_each(|r, g, b| [*r, *g, *b] = change([*r, *g, *b]));
}

/// The mean of each channel, which a reference picture of any size can be compared by.
pub fn channel_means(planes: &Array3<f32>) -> [f64; 3] {
    [0, 1, 2].map(|channel| {
        let plane = planes.index_axis(Axis(0), channel);
        plane.iter().map(|&v| f64::from(v)).sum::<f64>() / plane.len() as f64
    })
}

/// Multiplies each channel so that its mean becomes the given one, before values above 1 are clipped.
fn scale_to_means(planes: &mut Array3<f32>, means: [f64; 3]) {
    let own = channel_means(planes);
    for (channel, mut plane) in planes.axis_iter_mut(Axis(0)).enumerate() {
        // A black channel stays black.
        let gain = if own[channel] > 0.0 { means[channel] / own[channel] } else { 0.0 };
        #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
        let gain = gain as f32;
        plane.par_mapv_inplace(|v| (v * gain).min(1.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> LinearImage {
        let planes = Array3::from_shape_fn((3, 16, 24), |(c, y, x)| ((c + 1) * (y * 24 + x)) as f32 / 400.0);
        LinearImage::from_planes(planes).unwrap()
    }

    fn bare() -> FinishConfig {
        FinishConfig { clip: None, curve: Curve::None, clahe: None, ..FinishConfig::default() }
    }

    #[test]
    fn every_step_can_be_left_out() {
        let shown = finish(ramp(), &Look::default(), &bare()).unwrap();
        assert!(shown.iter().zip(ramp().as_slice()).all(|(a, b)| *a == b.min(1.0)));
    }

    #[test]
    fn scaling_gives_the_means_of_the_reference_unless_it_clips() {
        let means = [0.1, 0.2, 0.15];
        let look = Look { reference_means: Some(means), ..Look::default() };
        let config = FinishConfig { curve: Curve::Srgb { max: 3.0 }, ..bare() };
        let shown = finish(ramp(), &look, &config).unwrap();
        for (found, expected) in channel_means(&shown).into_iter().zip(means) {
            assert!((found / expected - 1.0).abs() < 1e-5, "{found} instead of {expected}");
        }
    }

    /// White balance leaves clipped light pink, and a colour matrix makes it magenta.
    #[test]
    fn clipped_lamps_are_white_through_a_colour_matrix() {
        let white = [1.9, 1.0, 1.6];
        let lamp = LinearImage::from_planes(Array3::from_shape_fn((3, 4, 4), |(c, ..)| white[c])).unwrap();
        let ccm = Some(ColorMatrix([[1.8, -0.6, -0.2], [-0.2, 1.5, -0.3], [0.0, -0.6, 1.6]]));
        let look = Look { ccm, saturation: Some(white), ..Look::default() };
        let curve = automatic_curve(&lamp, &look, 500.0);
        let shown = finish(lamp.clone(), &look, &FinishConfig { curve, ..bare() }).unwrap();
        assert!(shown.iter().all(|v| *v == 1.0), "{shown}");
        let before =
            finish(lamp, &Look { ccm, ..Look::default() }, &FinishConfig { curve, ..bare() }).unwrap();
        assert!(before[[1, 0, 0]] < 0.9, "without levels it is not: {before}");
    }

    #[test]
    fn the_picture_is_put_upright() {
        let look = Look { orientation: Orientation::from_exif(6).unwrap(), ..Look::default() };
        let shown = finish(ramp(), &look, &bare()).unwrap();
        assert_eq!(shown.dim(), (3, 24, 16));
        // Row 0 of the samples is the right side, their column 0 the top.
        assert_eq!(shown[[0, 0, 15]], ramp().planes()[[0, 0, 0]]);
    }

    #[test]
    fn a_black_picture_stays_black() {
        let black = LinearImage::from_planes(Array3::zeros((3, 9, 9))).unwrap();
        let look = Look { reference_means: Some([0.5; 3]), ..Look::default() };
        let shown = finish(black, &look, &FinishConfig { clahe: None, ..FinishConfig::default() }).unwrap();
        assert!(shown.iter().all(|&v| v == 0.0));
    }

    #[test]
    fn names_the_setting_that_is_out_of_range() {
        let config = FinishConfig { clip: Some(-1.0), ..FinishConfig::default() };
        assert!(finish(ramp(), &Look::default(), &config).unwrap_err().to_string().starts_with("clip"));
        let config = FinishConfig { curve: Curve::Gamma { gamma: 0.0, max: 6.0 }, ..FinishConfig::default() };
        assert!(finish(ramp(), &Look::default(), &config).unwrap_err().to_string().starts_with("gamma"));
        let clahe = Some(ClaheConfig { grid: Some([0, 8]), ..ClaheConfig::default() });
        assert!(
            finish(ramp(), &Look::default(), &FinishConfig { clahe, ..FinishConfig::default() }).is_err()
        );
    }
}
