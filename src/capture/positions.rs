//! Joins mosaics of one point source at several positions to an image in which nothing is interpolated.

use ndarray::{Array2, Array3, ArrayView2, Axis, Zip, s};

use super::bayer::BayerPattern;
use super::point_source::peak;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage};

/// A point source that was taken at several positions.
#[derive(Clone, Debug)]
pub struct Interleaved {
    /// What all frames show, each value the mean of the photosites that saw it.
    pub image: LinearImage,
    /// How far the source lies from where it does in the first frame, in pixels down and right.
    pub displacements_px: Vec<[f64; 2]>,
}

/// How far around the peak light counts for its place, in pixels: less than the distance of orders.
const REACH_PX: f64 = 8.0;
/// The place is found when it moves by less, in pixels; after so many rounds at the latest.
const SETTLED_PX: f64 = 1e-3;
const ROUNDS: usize = 50;

/// A displacement that lies further from a whole pixel is told: the place of a core of half a pixel is known to a tenth.
const OFF_PIXEL: f64 = 0.2;

/// Puts each photosite to where the light that it sees lies in the first frame.
///
/// Displacements are found from the images, and rounded to whole pixels. Of each image, whose colours were interpolated and
/// have the photosites' own values where these stand, only those values are used.
///
/// # Errors
/// [`Error::Shape`] for images of different sizes, or that have no place in common; [`Error::Unsupported`] where some colour is
/// seen nowhere at some place, which says what position lacks.
pub fn interleave(images: &[LinearImage], pattern: BayerPattern) -> Result<Interleaved> {
    let Some(first) = images.first() else {
        return Err(Error::shape("positions of a point source", "at least one image", "none"));
    };
    let size = [first.height(), first.width()];
    if let Some(other) = images.iter().find(|image| [image.height(), image.width()] != size) {
        let show = |image: &LinearImage| format!("{} × {}", image.height(), image.width());
        return Err(Error::shape("positions of a point source", show(first), show(other)));
    }
    let places = places_of_source(images, pattern);
    let displacements_px: Vec<[f64; 2]> =
        places.iter().map(|place| [0, 1].map(|axis| place[axis] - places[0][axis])).collect();
    let whole: Vec<[isize; 2]> = displacements_px.iter().map(|shift| shift.map(rounded)).collect();
    check_coverage(&whole, pattern)?;
    let image = mean_of_photosites(images, &whole, pattern)?;
    Ok(Interleaved { image, displacements_px })
}

impl Interleaved {
    /// What the user should look at: displacements that are no whole pixels, of positions of these names.
    pub fn warnings(&self, names: &[String]) -> Vec<String> {
        let is_off = |shift: &f64| (shift - shift.round()).abs() > OFF_PIXEL;
        let off = names.iter().zip(&self.displacements_px).filter(|(_, shift)| shift.iter().any(is_off));
        off.map(|(name, [down, right])| {
            format!(
                "{name}: the source is displaced by {down:+.2} pixels down and {right:+.2} right, which are no whole pixels; \
                 the core is blurred by what they are rounded by"
            )
        })
        .collect()
    }
}

#[expect(clippy::cast_possible_truncation, reason = "places in a picture")]
fn rounded(shift: f64) -> isize {
    shift.round() as isize
}

/// The place of the source in each image.
///
/// # Method
/// 1. Photosites of one colour see a narrow core or miss it, so that their centroid is wrong by half a pixel. Those of all
///    colours together sample it, once the colours are equally bright: each is divided by its light around the peaks of all
///    images, which is complete where the positions are, and counted twice of green.
/// 2. The place is the centroid within [`REACH_PX`], under a window that falls off to nothing there and is moved to the centroid
///    until it stays.
fn places_of_source(images: &[LinearImage], pattern: BayerPattern) -> Vec<[f64; 2]> {
    let mosaics: Vec<Array2<f32>> = images.iter().map(|image| photosites(image, pattern)).collect();
    let peaks: Vec<[f64; 2]> =
        mosaics.iter().map(|mosaic| peak(mosaic.view()).map(|place| place as f64)).collect();
    let mut levels = vec![[f64::INFINITY; CHANNELS]; images.len()];
    let mut light = [0.0; CHANNELS];
    for ((mosaic, peak), levels) in mosaics.iter().zip(&peaks).zip(&mut levels) {
        let sites = sites_around(*peak, mosaic.dim());
        for &(y, x) in &sites {
            let level = &mut levels[pattern.channel(y, x)];
            *level = level.min(f64::from(mosaic[[y, x]]));
        }
        for &(y, x) in &sites {
            let channel = pattern.channel(y, x);
            light[channel] += f64::from(mosaic[[y, x]]) - levels[channel];
        }
    }
    let gains = [0, 1, 2].map(|channel| if channel == 1 { 2.0 } else { 1.0 } / light[channel]);
    let equal = |mosaic: &Array2<f32>, levels: &[f64; CHANNELS], (y, x): (usize, usize)| {
        let channel = pattern.channel(y, x);
        gains[channel] * (f64::from(mosaic[[y, x]]) - levels[channel])
    };
    let all = mosaics.iter().zip(&levels).zip(peaks);
    all.map(|((mosaic, levels), peak)| settled(peak, mosaic.dim(), |site| equal(mosaic, levels, site)))
        .collect()
}

/// The photosites of a frame around a place.
fn sites_around(place: [f64; 2], (height, width): (usize, usize)) -> Vec<(usize, usize)> {
    let near = |axis: usize, length: usize| {
        let (first, last) = (place[axis] - REACH_PX, place[axis] + REACH_PX);
        (0..length).filter(move |at| (first..=last).contains(&(*at as f64)))
    };
    near(0, height).flat_map(|y| near(1, width).map(move |x| (y, x))).collect()
}

/// The centroid of light around a place, under a window that is moved to it until it stays.
fn settled(mut place: [f64; 2], size: (usize, usize), light: impl Fn((usize, usize)) -> f64) -> [f64; 2] {
    for _ in 0..ROUNDS {
        let (mut sum, mut moment) = (0.0, [0.0; 2]);
        for (y, x) in sites_around(place, size) {
            let from = [y as f64 - place[0], x as f64 - place[1]];
            let window: f64 =
                from.iter().map(|d| (d / REACH_PX * std::f64::consts::FRAC_PI_2).cos().max(0.0)).product();
            let mass = window * window * light((y, x));
            sum += mass;
            moment = [0, 1].map(|axis| moment[axis] + mass * from[axis]);
        }
        let step = moment.map(|moment| moment / sum);
        if sum.is_nan() || sum <= 0.0 {
            break;
        }
        place = [0, 1].map(|axis| place[axis] + step[axis]);
        if step.iter().all(|step| step.abs() < SETTLED_PX) {
            break;
        }
    }
    place
}

/// The mosaic that an image was interpolated from.
fn photosites(image: &LinearImage, pattern: BayerPattern) -> Array2<f32> {
    let planes = image.planes();
    Array2::from_shape_fn((image.height(), image.width()), |(y, x)| planes[[pattern.channel(y, x), y, x]])
}

/// Refuses positions after which some place was not seen in some colour.
fn check_coverage(whole: &[[isize; 2]], pattern: BayerPattern) -> Result<()> {
    let parity = |shift: &[isize; 2]| shift.map(|shift| shift.rem_euclid(2).unsigned_abs());
    let is_seen = |channel: usize, [y, x]: [usize; 2]| {
        whole.iter().map(parity).any(|[down, right]| pattern.channel(y + down, x + right) == channel)
    };
    let places = [[0, 0], [0, 1], [1, 0], [1, 1]];
    if (0..CHANNELS).all(|channel| places.iter().all(|place| is_seen(channel, *place))) {
        return Ok(());
    }
    let missing = places.into_iter().filter(|place| !whole.iter().map(parity).any(|found| found == *place));
    let name = |count: usize| if count == 1 { "an odd" } else { "an even" };
    let missing: Vec<String> = missing
        .map(|[down, right]| format!("{} number of pixels down and {} one right", name(down), name(right)))
        .collect();
    let found: Vec<String> =
        whole.iter().map(|[down, right]| format!("{down:+} down {right:+} right")).collect();
    Err(Error::Unsupported(format!(
        "the positions ({}) leave places that no photosite of some colour has seen: add one that is displaced against the first \
         by {}",
        found.join(", "),
        missing.join(", and one by ")
    )))
}

/// The mean of what was seen of each place and colour, of the places that lie in all frames.
fn mean_of_photosites(
    images: &[LinearImage],
    whole: &[[isize; 2]],
    pattern: BayerPattern,
) -> Result<LinearImage> {
    let size = [images[0].height(), images[0].width()];
    // Rows and columns of the first frame that are in all.
    let common = [0, 1].map(|axis| {
        let lowest = whole.iter().map(|shift| shift[axis]).min().unwrap_or(0);
        let highest = whole.iter().map(|shift| shift[axis]).max().unwrap_or(0);
        let length = size[axis].saturating_sub((highest - lowest).unsigned_abs());
        ((-lowest).max(0).unsigned_abs(), length)
    });
    let [(top, height), (left, width)] = common;
    if height == 0 || width == 0 {
        let found = "frames that have no place of the source's surroundings in common";
        return Err(Error::shape("positions of a point source", "displacements of some pixels", found));
    }
    let mut sums = Array3::<f64>::zeros((CHANNELS, height, width));
    let mut counts = Array3::<f64>::zeros((CHANNELS, height, width));
    for (image, [down, right]) in images.iter().zip(whole) {
        let (row, column) = (top.wrapping_add_signed(*down), left.wrapping_add_signed(*right));
        for channel in 0..CHANNELS {
            let seen: ArrayView2<'_, f32> = image.channel(channel);
            let seen = seen.slice_move(s![row..row + height, column..column + width]);
            let [sums, counts] =
                [&mut sums, &mut counts].map(|planes| planes.index_axis_mut(Axis(0), channel));
            Zip::indexed(sums).and(counts).and(seen).par_for_each(|(y, x), sum, count, value| {
                if pattern.channel(row + y, column + x) == channel {
                    *sum += f64::from(*value);
                    *count += 1.0;
                }
            });
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
    let mean = Zip::from(&sums).and(&counts).map_collect(|sum, count| (sum / count) as f32);
    LinearImage::from_planes(mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::bayer::demosaic;
    use crate::core::rng::stream;
    use rand::RngExt as _;

    const SIZE: [usize; 2] = [60, 70];

    /// A narrow core with an order beside it, and haze; colours lie apart a little.
    fn light(channel: usize, y: f64, x: f64) -> f64 {
        let spot = |cy: f64, cx: f64, sigma: f64| {
            (-((y - cy).powi(2) + (x - cx).powi(2)) / (2.0 * sigma * sigma)).exp()
        };
        let order = 12.0 + channel as f64;
        [0.8, 1.0, 0.7][channel]
            * (spot(0.1, -0.2, 0.5) + 0.02 * spot(order, 3.0, 0.6) + 1e-3 * spot(0.0, 0.0, 9.0))
            + 1e-4
    }

    fn taken([down, right]: [f64; 2], pattern: BayerPattern) -> LinearImage {
        let [height, width] = SIZE;
        let mosaic = Array2::from_shape_fn((height, width), |(y, x)| {
            light(pattern.channel(y, x), y as f64 - 28.0 - down, x as f64 - 33.0 - right) as f32
        });
        LinearImage::from_planes(demosaic(mosaic.view(), pattern).unwrap()).unwrap()
    }

    fn worst(found: &Interleaved, at: [f64; 2]) -> f64 {
        let miss = |((channel, y, x), value): ((usize, usize, usize), &f32)| {
            (f64::from(*value) - light(channel, y as f64 - at[0], x as f64 - at[1])).abs()
        };
        found.image.planes().indexed_iter().map(miss).fold(0.0, f64::max)
    }

    /// Whatever the pattern, and however far they are displaced: the frames have 56 × 65 of 60 × 70 pixels in common.
    #[test]
    fn four_positions_show_each_place_in_each_colour() {
        let displacements = [[0.0, 0.0], [-1.0, 4.0], [2.0, 1.0], [3.0, -1.0]];
        for pattern in [BayerPattern::Rggb, BayerPattern::Bggr, BayerPattern::Grbg, BayerPattern::Gbrg] {
            let images = displacements.map(|shift| taken(shift, pattern));
            let found = interleave(&images, pattern).unwrap();
            for (found, expected) in
                found.displacements_px.iter().flatten().zip(displacements.iter().flatten())
            {
                assert!((found - expected).abs() < 0.15, "{found} instead of {expected}");
            }
            assert_eq!([found.image.height(), found.image.width()], [56, 65]);
            assert!(worst(&found, [27.0, 32.0]) < 1e-6, "{pattern:?}: {}", worst(&found, [27.0, 32.0]));
            assert_eq!(found.warnings(&["a", "b", "c", "d"].map(str::to_owned)), Vec::<String>::new());
        }
    }

    #[test]
    fn positions_that_leave_photosites_unseen_are_refused_with_what_lacks() {
        let pattern = BayerPattern::Rggb;
        let images = [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]].map(|shift| taken(shift, pattern));
        let said = interleave(&images, pattern).unwrap_err().to_string();
        assert!(said.contains("an odd number of pixels down and an odd one right"), "{said}");
        assert!(!said.contains(", and one by"), "{said}");
    }

    #[test]
    fn displacements_by_half_pixels_are_told() {
        let pattern = BayerPattern::Rggb;
        let images = [[0.0, 0.0], [1.4, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|shift| taken(shift, pattern));
        let found = interleave(&images, pattern).unwrap();
        let said = found.warnings(&["a", "b", "c", "d"].map(str::to_owned));
        assert!(said.len() == 1 && said[0].starts_with("b: the source is displaced by +1."), "{said:?}");
    }

    /// Noise of a hundredth of the peak.
    #[test]
    fn places_are_found_in_noise() {
        let mut rng = stream(3, "positions");
        let pattern = BayerPattern::Rggb;
        let noisy = |shift| {
            let planes = taken(shift, pattern).into_planes();
            let mut noise = || 0.01 * (rng.random::<f32>() - 0.5);
            LinearImage::from_planes(planes.mapv(|value| value + noise())).unwrap()
        };
        let images = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(noisy);
        let found = interleave(&images, pattern).unwrap();
        let whole: Vec<[f64; 2]> = found.displacements_px.iter().map(|shift| shift.map(f64::round)).collect();
        assert_eq!(whole, [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]);
    }
}
