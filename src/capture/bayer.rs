//! Turns the mosaic of a colour sensor into three full planes (Malvar, He and Cutler 2004).

use ndarray::{Array3, ArrayView2, ArrayView3, Axis, Zip};

use crate::core::error::{Error, Result};

pub use crate::core::bayer::BayerPattern;

/// Unpacks `[4, H/2, W/2]`, one plane per photosite of the first two rows, to the mosaic `[1, H, W]`.
///
/// # Panics
/// When there are not four planes.
pub fn unpack(packed: ArrayView3<'_, f32>) -> Array3<f32> {
    let (planes, rows, columns) = packed.dim();
    assert_eq!(planes, 4, "a packed mosaic has four planes");
    Array3::from_shape_fn((1, 2 * rows, 2 * columns), |(_, y, x)| packed[[(y % 2) * 2 + x % 2, y / 2, x / 2]])
}

/// A linear filter of 5 × 5, as (dy, dx, weight in sixteenths).
type Filter = &'static [(isize, isize, f32)];

/// Green at red and blue.
const GREEN: Filter = &[
    (0, 0, 8.0),
    (-1, 0, 4.0),
    (1, 0, 4.0),
    (0, -1, 4.0),
    (0, 1, 4.0),
    (-2, 0, -2.0),
    (2, 0, -2.0),
    (0, -2, -2.0),
    (0, 2, -2.0),
];
/// Red or blue at green, when the neighbours of that colour stand left and right.
const BESIDE: Filter = &[
    (0, 0, 10.0),
    (0, -1, 8.0),
    (0, 1, 8.0),
    (-1, -1, -2.0),
    (-1, 1, -2.0),
    (1, -1, -2.0),
    (1, 1, -2.0),
    (0, -2, -2.0),
    (0, 2, -2.0),
    (-2, 0, 1.0),
    (2, 0, 1.0),
];
/// Red at blue, blue at red.
const DIAGONAL: Filter = &[
    (0, 0, 12.0),
    (-1, -1, 4.0),
    (-1, 1, 4.0),
    (1, -1, 4.0),
    (1, 1, 4.0),
    (-2, 0, -3.0),
    (2, 0, -3.0),
    (0, -2, -3.0),
    (0, 2, -3.0),
];

/// Interpolates the two missing colours of every photosite.
///
/// Bilinear interpolation is corrected by the Laplacian of the colour that is there, with the gains of
/// Malvar, He and Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images" (ICASSP 2004); the
/// frame is mirrored at its border. Next to lights the correction may overshoot downwards: values are not let
/// below the darkest photosite of the frame, or zero.
///
/// # Shapes
/// `[H, W]` to `[3, H, W]`.
///
/// # Errors
/// [`Error::Shape`] for a frame smaller than 4 × 4.
pub fn demosaic(mosaic: ArrayView2<'_, f32>, pattern: BayerPattern) -> Result<Array3<f32>> {
    let (height, width) = mosaic.dim();
    if height < 4 || width < 4 {
        return Err(Error::shape("Bayer mosaic", "at least 4 × 4 pixels", format!("{height} × {width}")));
    }
    let floor = mosaic.iter().copied().fold(0.0, f32::min);
    let mut planes = Array3::zeros((3, height, width));
    for (channel, mut plane) in planes.axis_iter_mut(Axis(0)).enumerate() {
        Zip::indexed(&mut plane).par_for_each(|(y, x), value| {
            let here = pattern.channel(y, x);
            *value = if here == channel {
                mosaic[[y, x]]
            } else if channel == 1 {
                apply(mosaic, (y, x), GREEN, false)
            } else if here == 1 {
                // Above and below when the row's other colour is not the wanted one.
                let above = pattern.channel(y, x + 1) != channel;
                apply(mosaic, (y, x), BESIDE, above)
            } else {
                apply(mosaic, (y, x), DIAGONAL, false)
            }
            .max(floor);
        });
    }
    Ok(planes)
}

/// The light that is compressed to one half: a quarter of the longest exposure's white, as in the tone mapping φ.
const COMPRESSION: f32 = 0.25;

fn compress(x: f32) -> f32 {
    x / (x.abs() + COMPRESSION)
}

/// Interpolates the missing colours of a scene with lamps: as [`demosaic`], of compressed light.
///
/// Beside a lamp that is 10³ times as bright as its surroundings the correction of a linear interpolation is larger than
/// the surroundings themselves. Compressed by `x/(|x| + 0.25)`, both are of one size. On twelve panoramas (tone-mapped
/// PSNR) that is 3.1 to 6.6 dB better than bilinear interpolation, 4.5 dB in the mean; in linear light the same filters
/// lose 0.7 dB against it. It does not keep the energy of a peak: PSFs are demosaiced in linear light.
///
/// # Errors
/// As [`demosaic`].
pub fn demosaic_scene(mosaic: ArrayView2<'_, f32>, pattern: BayerPattern) -> Result<Array3<f32>> {
    let mut planes = demosaic(mosaic.mapv(compress).view(), pattern)?;
    // Overshoots end at the brightest photosite, where compressed values still have an inverse.
    let (lowest, highest) = mosaic.iter().fold((0.0f32, 0.0f32), |(low, high), &x| (low.min(x), high.max(x)));
    let (bottom, top) = (compress(lowest), compress(highest));
    Zip::indexed(&mut planes).par_for_each(|(channel, y, x), value| {
        let v = value.clamp(bottom, top);
        *value = if pattern.channel(y, x) == channel {
            mosaic[[y, x]]
        } else {
            (COMPRESSION * v / (1.0 - v.abs())).clamp(lowest, highest)
        };
    });
    Ok(planes)
}

fn apply(mosaic: ArrayView2<'_, f32>, (y, x): (usize, usize), filter: Filter, transposed: bool) -> f32 {
    let (height, width) = mosaic.dim();
    let sum: f32 = filter
        .iter()
        .map(|&(dy, dx, weight)| {
            let (dy, dx) = if transposed { (dx, dy) } else { (dy, dx) };
            weight * mosaic[[mirrored(y, dy, height), mirrored(x, dx, width)]]
        })
        .sum();
    sum / 16.0
}

/// Mirrors at the first and last pixel, which keeps a site's colour.
fn mirrored(index: usize, offset: isize, length: usize) -> usize {
    let place = index.wrapping_add_signed(offset);
    if place < length {
        place
    } else if offset < 0 {
        place.wrapping_neg()
    } else {
        2 * (length - 1) - place
    }
}

/// Whether the greens seem to stand on the other diagonal: the pattern was probably declared wrongly.
///
/// The two green photosites of a cell see the same colour, so that their difference is small beside that of the
/// other two, in compressed light so that the edges of lamps do not outweigh the scene; without colour in the scene
/// nothing can be told.
pub fn greens_look_swapped(mosaic: ArrayView2<'_, f32>, pattern: BayerPattern) -> bool {
    let mut difference = [0.0f64; 2];
    for cell in mosaic.exact_chunks((2, 2)) {
        let cell = cell.mapv(compress);
        difference[0] += f64::from((cell[[0, 1]] - cell[[1, 0]]).abs());
        difference[1] += f64::from((cell[[0, 0]] - cell[[1, 1]]).abs());
    }
    let declared = usize::from(pattern.channel(0, 0) == 1);
    difference[declared] > 1.5 * difference[1 - declared]
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, s};

    const PATTERNS: [BayerPattern; 4] =
        [BayerPattern::Rggb, BayerPattern::Bggr, BayerPattern::Grbg, BayerPattern::Gbrg];

    fn mosaic_of(scene: &Array3<f32>, pattern: BayerPattern) -> Array2<f32> {
        let (_, height, width) = scene.dim();
        Array2::from_shape_fn((height, width), |(y, x)| scene[[pattern.channel(y, x), y, x]])
    }

    /// Luminance detail shared by the channels, as in natural scenes, on slowly varying colours.
    fn scene() -> Array3<f32> {
        Array3::from_shape_fn((3, 64, 66), |(c, y, x)| {
            let (y, x) = (y as f32, x as f32);
            let detail = (0.9 * y + 0.4 * x).sin()
                + (0.13 * x * y / 8.0).cos()
                + if (x - y).abs() < 9.0 { 1.0 } else { 0.0 };
            let colour = [0.8, 1.0, 0.6][c] + 0.1 * (0.05 * x + c as f32).sin();
            colour * (3.0 + detail)
        })
    }

    fn bilinear(mosaic: &Array2<f32>, pattern: BayerPattern) -> Array3<f32> {
        let (height, width) = mosaic.dim();
        Array3::from_shape_fn((3, height, width), |(c, y, x)| {
            if pattern.channel(y, x) == c {
                return mosaic[[y, x]];
            }
            let offsets = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx)));
            let places = offsets.map(|(dy, dx)| (mirrored(y, dy, height), mirrored(x, dx, width)));
            let values: Vec<f32> =
                places.filter(|&(y, x)| pattern.channel(y, x) == c).map(|place| mosaic[place]).collect();
            values.iter().sum::<f32>() / values.len() as f32
        })
    }

    #[expect(clippy::reversed_empty_ranges, reason = "negative ends count from the far side")]
    fn error(found: &Array3<f32>, expected: &Array3<f32>) -> f32 {
        let inner = s![.., 4..-4, 4..-4];
        let difference = &found.slice(inner) - &expected.slice(inner);
        (difference.mapv(|d| d * d).mean().unwrap()).sqrt()
    }

    #[test]
    fn is_more_than_two_decibels_better_than_bilinear_interpolation() {
        for pattern in PATTERNS {
            let (scene, mosaic) = (scene(), mosaic_of(&scene(), pattern));
            let malvar = error(&demosaic(mosaic.view(), pattern).unwrap(), &scene);
            let simple = error(&bilinear(&mosaic, pattern), &scene);
            let gain_db = 20.0 * (simple / malvar).log10();
            assert!(gain_db > 2.0, "{pattern:?}: {gain_db} dB");
        }
    }

    /// Night: the scene with lamps of up to 2000 times its brightness.
    fn night() -> Array3<f32> {
        let mut night = scene();
        for (y, x, light) in [(12, 14, 8000.0), (30, 45, 500.0), (50, 20, 2000.0)] {
            night.slice_mut(s![.., y..y + 4, x..x + 3]).fill(light);
        }
        night
    }

    #[test]
    fn lamps_spoil_nothing_around_them() {
        let tone_mapped = |planes: &Array3<f32>| planes.mapv(|x| x.max(0.0) / (x.max(0.0) + 0.25));
        for pattern in PATTERNS {
            let (night, mosaic) = (night(), mosaic_of(&night(), pattern));
            let miss = |found: &Array3<f32>| error(&tone_mapped(found), &tone_mapped(&night));
            let compressed = demosaic_scene(mosaic.view(), pattern).unwrap();
            let linear = demosaic(mosaic.view(), pattern).unwrap();
            let gain_db = 20.0 * (miss(&bilinear(&mosaic, pattern)) / miss(&compressed)).log10();
            assert!(gain_db > 2.0, "{pattern:?}: {gain_db} dB");
            assert!(miss(&linear) > 2.0 * miss(&compressed), "{pattern:?}");
            let measured =
                mosaic.indexed_iter().all(|((y, x), v)| compressed[[pattern.channel(y, x), y, x]] == *v);
            assert!(measured && compressed.iter().all(|v| v.is_finite() && *v <= 8000.0));
        }
    }

    /// All filters sum to one and are symmetric: linear ramps of one grey pass unchanged inside the frame.
    #[test]
    fn keeps_measured_values_and_grey_ramps() {
        for pattern in PATTERNS {
            let ramp = Array3::from_shape_fn((3, 12, 14), |(_, y, x)| 1.0 + 0.25 * y as f32 + 0.5 * x as f32);
            let found = demosaic(mosaic_of(&ramp, pattern).view(), pattern).unwrap();
            assert!(error(&found, &ramp) < 1e-5);
            let colours = mosaic_of(&scene(), pattern);
            let planes = demosaic(colours.view(), pattern).unwrap();
            assert!(colours.indexed_iter().all(|((y, x), v)| planes[[pattern.channel(y, x), y, x]] == *v));
        }
    }

    #[test]
    fn flat_colours_stay_flat_up_to_the_border() {
        let flat = Array3::from_shape_fn((3, 7, 9), |(c, _, _)| [0.2, 0.5, 0.9][c]);
        let found = demosaic(mosaic_of(&flat, BayerPattern::Gbrg).view(), BayerPattern::Gbrg).unwrap();
        assert!(found.iter().zip(&flat).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn unpacks_the_photosites_in_reading_order() {
        let packed = Array3::from_shape_fn((4, 3, 5), |(site, y, x)| (site * 100 + y * 10 + x) as f32);
        let mosaic = unpack(packed.view());
        assert_eq!(mosaic.dim(), (1, 6, 10));
        assert_eq!((mosaic[[0, 0, 0]], mosaic[[0, 2, 3]], mosaic[[0, 5, 8]]), (0.0, 111.0, 224.0));
    }

    #[test]
    fn notices_greens_on_the_other_diagonal() {
        let mosaic = mosaic_of(&scene(), BayerPattern::Rggb);
        assert!(!greens_look_swapped(mosaic.view(), BayerPattern::Rggb));
        assert!(greens_look_swapped(mosaic.view(), BayerPattern::Grbg));
    }
}
