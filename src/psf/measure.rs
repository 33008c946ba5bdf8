//! Turns the fused picture of a point source into a PSF.

use std::ops::Range;

use ndarray::parallel::prelude::{
    IndexedParallelIterator as _, IntoParallelIterator as _, ParallelIterator as _,
};
use ndarray::{Array2, Array3, ArrayView2, Axis, s};
use serde::{Deserialize, Serialize};

use crate::core::broad_peak::{broad_peak, take_region};
use crate::core::error::{Error, Result};
use crate::core::haze::average_below_noise;
use crate::core::image::LinearImage;
use crate::core::psf::Psf;

use super::MAX_SIZE_PX;
use super::background::Background;
use super::quality::{PsfQuality, assess_psf};

/// What sums to one, or to one for each channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Normalization {
    /// Each channel: no change of colour.
    #[default]
    Channel,
    /// All channels together, which sum to 3: the source's colour stays, and each channel of a neutral one sums to one.
    Total,
    /// Nothing: irradiance as measured.
    None,
}

/// How a PSF is cut out of a picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct MeasureConfig {
    /// The side of the square PSF in pixels.
    pub size: usize,
    /// What is normalised.
    pub normalize: Normalization,
}

impl Default for MeasureConfig {
    /// 800 pixels, each channel of unit sum.
    fn default() -> Self {
        Self { size: 800, normalize: Normalization::Channel }
    }
}

impl MeasureConfig {
    /// Checks the size.
    ///
    /// # Errors
    /// [`Error::Config`] when it is zero or larger than any sensor's frame.
    pub fn check(&self) -> Result<()> {
        if (1..=MAX_SIZE_PX).contains(&self.size) {
            return Ok(());
        }
        Err(Error::config("size", format!("must be between 1 and {MAX_SIZE_PX}, found {}", self.size)))
    }
}

/// A measured PSF.
#[derive(Clone, Debug)]
pub struct MeasuredPsf {
    /// The PSF, each channel of unit sum.
    pub psf: Psf,
    /// The same light, normalised as asked for.
    pub image: LinearImage,
    /// What was subtracted from each channel.
    pub background: [Background; 3],
    /// From the frame's centre (N/2) to the main peak, in pixels down and right.
    pub displacement_px: [i64; 2],
    /// From the PSF's centre to each channel's centroid, in pixels down and right: below half a pixel but for lopsided
    /// cores and colours that lie apart.
    pub centroid_px: [[f64; 2]; 3],
    /// The share of the PSF that lay outside of the frame and is zero.
    pub padded: f64,
    /// For each channel, the standard deviation that noise leaves of the sum of the light, as a share of it.
    pub noise: [f64; 3],
    /// For each channel, the light by which the slope of the background was brighter or darker under the PSF, as a share of the PSF's.
    pub sloping: [f64; 3],
    /// How it spreads its light.
    pub quality: PsfQuality,
}

/// Pixels around the peak that its centroid is taken over, on each side.
const CENTROID_REACH: usize = 4;

/// Cuts the PSF out of a picture of a point source: background subtracted, main peak at N/2, cropped or padded.
///
/// Light below the noise becomes its mean over as small a square as stands out of the noise, so that noise lifts no haze
/// when it is clipped at zero. Haze that reaches the frame's border is lost, as part of the [`Background`].
///
/// `valid` marks the pixels that were measured; others are not used for the background.
///
/// # Errors
/// [`Error::Config`] for a size out of range; [`Error::Unsupported`] when a channel has no light above the background.
pub fn measure_psf(
    picture: &LinearImage,
    valid: Option<&Array2<bool>>,
    config: &MeasureConfig,
) -> Result<MeasuredPsf> {
    config.check()?;
    let background = [0, 1, 2].map(|channel| Background::of_border(picture.channel(channel), valid));
    let mut light = picture.planes().mapv(f64::from);
    light.outer_iter_mut().zip(&background).for_each(|(plane, background)| background.subtract_from(plane));
    let peak = main_peak(&light.sum_axis(Axis(0)));
    let planes = window(&light, peak, config.size);
    let [rows, columns] = inside([picture.height(), picture.width()], peak, config.size);
    let pixels = (rows.len() * columns.len()) as f64;
    let shown = [rows.len(), columns.len()];
    let mut energy = planes.clone();
    energy.slice_mut(s![.., rows, columns]).axis_iter_mut(Axis(0)).into_par_iter().zip(&background).for_each(
        |(mut plane, background)| {
            let averaged = average_below_noise(plane.view(), background.levels_of_noise());
            plane.assign(&averaged);
        },
    );
    let psf = Psf::from_energy(to_f32(&energy))?;
    let sums = [0, 1, 2].map(|channel| energy.index_axis(Axis(0), channel).sum());
    let total: f64 = sums.iter().sum();
    let image = match config.normalize {
        Normalization::Channel => LinearImage::from_planes(psf.planes().to_owned())?,
        Normalization::Total => {
            LinearImage::from_planes(to_f32(&(&energy * (energy.len_of(Axis(0)) as f64 / total))))?
        }
        Normalization::None => LinearImage::from_planes(to_f32(&energy))?,
    };
    let uncertain = |channel: usize| background[channel].deviation_of_sum(pixels) / sums[channel];
    let size = [picture.height(), picture.width()];
    let sloping = |channel: usize| background[channel].light_of_slope(shown, size) / sums[channel];
    let centre = [config.size / 2; 2];
    Ok(MeasuredPsf {
        centroid_px: [0, 1, 2].map(|channel| {
            let found = centroid(&planes.index_axis(Axis(0), channel).to_owned(), centre);
            [found[0] - centre[0] as f64, found[1] - centre[1] as f64]
        }),
        quality: assess_psf(&psf),
        psf,
        image,
        displacement_px: [offset(peak[0], picture.height() / 2), offset(peak[1], picture.width() / 2)],
        padded: 1.0 - pixels / (config.size * config.size) as f64,
        noise: [0, 1, 2].map(uncertain),
        sloping: [0, 1, 2].map(sloping),
        background,
    })
}

fn offset(index: usize, origin: usize) -> i64 {
    index as i64 - origin as i64
}

#[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
fn to_f32(planes: &Array3<f64>) -> Array3<f32> {
    planes.mapv(|v| v as f32)
}

/// The brightest pixel of the brightest spot.
///
/// The spot is the brightest 3 × 3 neighbourhood, so that a lone hot pixel does not pass for one, or the middle of a
/// saturated core. What lies beside it, a lobe or a tail, does not move it: the peak is where the PSF's centre is. Out of focus it has
/// none, and the centre is the [point of balance](broad_peak).
fn main_peak(light: &Array2<f64>) -> [usize; 2] {
    if let Some(middle) = broad_peak(light.view()) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a pixel of the picture"
        )]
        return middle.map(|place| place.round() as usize);
    }
    let (height, width) = light.dim();
    let around = |y: usize, x: usize| {
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        light.slice(s![rows, x.saturating_sub(1)..(x + 2).min(width)])
    };
    let means = Array2::from_shape_fn((height, width), |(y, x)| around(y, x).mean().unwrap_or_default());
    let [y, x] = plateau_centre(&means);
    let (place, value) = brightest(around(y, x));
    if value - light[[y, x]] > LEVEL * value.abs() {
        return [y.saturating_sub(1) + place[0], x.saturating_sub(1) + place[1]];
    }
    [y, x]
}

/// The first place of the highest value.
fn brightest(values: ArrayView2<'_, f64>) -> ([usize; 2], f64) {
    values.indexed_iter().fold(([0, 0], f64::NEG_INFINITY), |best, ((y, x), &value)| {
        if value > best.1 { ([y, x], value) } else { best }
    })
}

/// Values this close to the highest, as a share of it, are as high: rounding and interpolation leave less.
const LEVEL: f64 = 1e-3;

/// The middle of the largest connected region that is as bright as the brightest pixel: one pixel, or where a source is
/// saturated in every exposure, many.
fn plateau_centre(means: &Array2<f64>) -> [usize; 2] {
    let (_, highest) = brightest(means.view());
    let mut unseen = means.mapv(|mean| mean >= highest - LEVEL * highest.abs());
    let mut largest = (0, [0, 0]);
    for first in (0..means.len()).map(|index| [index / means.ncols(), index % means.ncols()]) {
        if !unseen[first] {
            continue;
        }
        let (count, sums) = take_region(&mut unseen, first);
        if count > largest.0 {
            largest = (count, sums.map(|sum| (sum + count / 2) / count));
        }
    }
    largest.1
}

/// The centre of mass of the light in a window around `centre`, the window's darkest value being no light.
fn centroid(light: &Array2<f64>, centre: [usize; 2]) -> [f64; 2] {
    let (height, width) = light.dim();
    let span = |place: usize, length: usize| {
        // Symmetric around the place, so that a level plane has its centroid there.
        let reach = CENTROID_REACH.min(place).min(length - 1 - place);
        place - reach..place + reach + 1
    };
    let (rows, columns) = (span(centre[0], height), span(centre[1], width));
    let window = light.slice(s![rows.clone(), columns.clone()]);
    let darkest = window.iter().copied().fold(f64::INFINITY, f64::min);
    let (mut sum, mut moment) = (0.0, [0.0; 2]);
    for ((y, x), value) in window.indexed_iter() {
        let mass = value - darkest;
        sum += mass;
        moment[0] += mass * (rows.start + y) as f64;
        moment[1] += mass * (columns.start + x) as f64;
    }
    if sum > 0.0 { moment.map(|moment| moment / sum) } else { centre.map(|place| place as f64) }
}

/// The rows and columns of the square of `size` pixels around `peak`, its pixel N/2, that lie within a frame.
fn inside([height, width]: [usize; 2], peak: [usize; 2], size: usize) -> [Range<usize>; 2] {
    let within = |length: usize, peak: usize| {
        (size / 2).saturating_sub(peak)..size.min((length + size / 2).saturating_sub(peak))
    };
    [within(height, peak[0]), within(width, peak[1])]
}

/// That square, zero outside of the frame.
fn window(light: &Array3<f64>, peak: [usize; 2], size: usize) -> Array3<f64> {
    let (_, height, width) = light.dim();
    let [rows, columns] = inside([height, width], peak, size);
    let from = |span: &Range<usize>, peak: usize| span.start + peak - size / 2..span.end + peak - size / 2;
    let found = light.slice(s![.., from(&rows, peak[0]), from(&columns, peak[1])]);
    let mut planes = Array3::zeros((3, size, size));
    planes.slice_mut(s![.., rows, columns]).assign(&found);
    planes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian spot at (y, x) with one sidelobe and a level of its own in each channel.
    fn picture(height: usize, width: usize, (y, x): (f64, f64)) -> LinearImage {
        let planes = Array3::from_shape_fn((3, height, width), |(c, row, column)| {
            let spot =
                |cy: f64, cx: f64| (-((row as f64 - cy).powi(2) + (column as f64 - cx).powi(2)) / 6.0).exp();
            (100.0 * spot(y, x) + 5.0 * spot(y + 12.0, x - 9.0) + 0.25 * (c + 1) as f64) as f32
        });
        LinearImage::from_planes(planes).unwrap()
    }

    /// Out of focus, with a bright place on the ring.
    #[test]
    fn the_centre_of_a_ring_is_its_middle() {
        let planes = Array3::from_shape_fn((3, 101, 101), |(_, y, x)| {
            let [dy, dx] = [y as f64 - 47.0, x as f64 - 52.0];
            let bright = (-((dy - 6.0).powi(2) + dx.powi(2)) / 4.0).exp();
            ((-(dy.hypot(dx) - 6.0).powi(2) / 3.0).exp() * (1.0 + 0.3 * bright)) as f32
        });
        let config = MeasureConfig { size: 41, normalize: Normalization::None };
        let measured = measure_psf(&LinearImage::from_planes(planes).unwrap(), None, &config).unwrap();
        assert_eq!(measured.displacement_px, [-3, 2]);
    }

    #[test]
    fn a_lobe_beside_the_peak_does_not_move_it() {
        let planes = Array3::from_shape_fn((3, 101, 101), |(_, y, x)| {
            let spot = |cx: f64| (-((y as f64 - 50.0).powi(2) + (x as f64 - cx).powi(2)) / 0.98).exp();
            (0.7 * (spot(50.0) + 0.3 * spot(53.0))) as f32
        });
        let picture = LinearImage::from_planes(planes).unwrap();
        let config = MeasureConfig { size: 51, normalize: Normalization::None };
        let measured = measure_psf(&picture, None, &config).unwrap();
        let plane = measured.image.channel(1);
        let brightest = plane.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
        assert_eq!(brightest, (25, 25));
    }

    #[test]
    fn puts_the_peak_at_n_over_two_for_odd_and_even_sizes() {
        for size in [40, 41] {
            let config = MeasureConfig { size, normalize: Normalization::None };
            let measured = measure_psf(&picture(90, 120, (50.3, 61.4)), None, &config).unwrap();
            let plane = measured.image.channel(1);
            let brightest = plane.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
            assert_eq!(brightest, (size / 2, size / 2));
            assert_eq!(measured.displacement_px, [5, 1]);
            // 12 rows below and 9 columns left of the peak, exp(−0.01/6) off its own maximum.
            assert!((plane[[size / 2 + 12, size / 2 - 9]] - 5.0).abs() < 0.3);
            // The window cuts the spot at 2.3 σ, on one side more than on the other.
            let [y, x] = measured.centroid_px[1];
            assert!((y - 0.3).abs() < 0.05 && (x - 0.4).abs() < 0.05, "{y} {x}");
        }
    }

    #[test]
    fn subtracts_each_channels_background() {
        let config = MeasureConfig { size: 40, normalize: Normalization::None };
        let measured = measure_psf(&picture(90, 120, (45.0, 60.0)), None, &config).unwrap();
        for (c, background) in measured.background.iter().enumerate() {
            assert!((background.level - 0.25 * (c + 1) as f64).abs() < 1e-6);
        }
        assert!(measured.image.planes()[[2, 0, 0]].abs() < 1e-6);
        assert!((measured.image.planes()[[2, 20, 20]] - 100.0).abs() < 1e-3);
    }

    /// The light of an even background, and the same on a slope that is as bright at one edge as the sidelobe.
    #[test]
    fn takes_away_a_slope_of_the_background() {
        let config = MeasureConfig { size: 60, normalize: Normalization::None };
        let even = picture(90, 120, (45.0, 60.0));
        let mut planes = even.planes().to_owned();
        planes.indexed_iter_mut().for_each(|((_, y, x), value)| *value += 0.01 * y as f32 + 0.04 * x as f32);
        let sloping = measure_psf(&LinearImage::from_planes(planes).unwrap(), None, &config).unwrap();
        let even = measure_psf(&even, None, &config).unwrap();
        assert_eq!((even.background[0].slope, even.sloping), (None, [0.0; 3]));
        let [down, right] = sloping.background[1].slope.unwrap();
        assert!((down - 0.445).abs() < 1e-3 && (right - 2.38).abs() < 1e-3, "{down} {right}");
        let difference = &sloping.image.planes() - &even.image.planes();
        let furthest = difference.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        assert!(furthest < 1e-3, "{furthest}");
        // Of 3600 pixels, half of 0.445 · 60/90 + 2.38 · 60/120, and 6π · 105 of light.
        assert!((sloping.sloping[0] - 3600.0 * 0.743 / 1979.0).abs() < 0.02, "{:?}", sloping.sloping);
        assert!(sloping.warnings().iter().any(|said| said.contains("slopes over the frame")));
        assert!(sloping.summary().last().unwrap().contains("down, +2.4e0 right"));
        assert!(even.summary().last().unwrap().starts_with("blue"));
    }

    #[test]
    fn normalises_as_asked() {
        let of = |normalize| {
            let config = MeasureConfig { size: 40, normalize };
            measure_psf(&picture(90, 120, (45.0, 60.0)), None, &config).unwrap().image
        };
        let sum = |image: &LinearImage| image.as_slice().iter().map(|v| f64::from(*v)).sum::<f64>();
        assert!((sum(&of(Normalization::Channel)) - 3.0).abs() < 1e-5);
        assert!((sum(&of(Normalization::Total)) - 3.0).abs() < 1e-5);
        // The source is as bright in all channels.
        let [total, channel] = [Normalization::Total, Normalization::Channel].map(of);
        assert!(total.as_slice().iter().zip(channel.as_slice()).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(sum(&of(Normalization::None)) > 1000.0);
    }

    #[test]
    fn pads_what_the_frame_does_not_hold() {
        let config = MeasureConfig { size: 60, normalize: Normalization::Channel };
        let measured = measure_psf(&picture(40, 40, (20.0, 12.0)), None, &config).unwrap();
        assert!((measured.padded - (1.0 - 1600.0 / 3600.0)).abs() < 1e-12);
        assert_eq!(measured.psf.planes()[[0, 30, 0]], 0.0);
    }

    #[test]
    fn centres_a_source_that_is_saturated_in_every_exposure() {
        for level in [20.0, 1.0] {
            let planes = picture(90, 120, (47.0, 64.0)).into_planes().mapv(|v| v.min(level));
            let config = MeasureConfig { size: 40, normalize: Normalization::None };
            let measured = measure_psf(&LinearImage::from_planes(planes).unwrap(), None, &config).unwrap();
            assert_eq!(measured.displacement_px, [2, 4], "cut at {level}");
        }
    }

    #[test]
    fn finds_a_peak_in_and_beside_the_outermost_pixels() {
        for (y, x) in [(0, 30), (1, 30), (2, 30), (30, 59), (30, 58), (30, 57), (0, 0), (59, 1)] {
            let image = picture(60, 60, (y as f64, x as f64));
            let config = MeasureConfig { size: 20, normalize: Normalization::None };
            let measured = measure_psf(&image, None, &config).unwrap();
            assert_eq!(measured.displacement_px, [y - 30, x - 30]);
        }
    }

    #[test]
    fn refuses_a_size_that_no_sensor_has() {
        for size in [0, 100_000, usize::MAX] {
            let config = MeasureConfig { size, ..MeasureConfig::default() };
            let message = measure_psf(&picture(30, 30, (15.0, 15.0)), None, &config).unwrap_err().to_string();
            assert!(message.contains("between 1 and 8192"), "{message}");
        }
    }

    #[test]
    fn a_hot_pixel_is_not_the_peak() {
        let mut planes = picture(60, 60, (30.0, 30.0)).into_planes();
        planes.slice_mut(s![.., 5, 5]).fill(300.0);
        let config = MeasureConfig { size: 20, normalize: Normalization::None };
        let measured = measure_psf(&LinearImage::from_planes(planes).unwrap(), None, &config).unwrap();
        assert_eq!(measured.displacement_px, [0, 0]);
    }

    #[test]
    fn refuses_a_dark_frame() {
        let dark = LinearImage::from_planes(Array3::from_elem((3, 30, 30), 0.1)).unwrap();
        assert!(measure_psf(&dark, None, &MeasureConfig::default()).is_err());
    }
}
