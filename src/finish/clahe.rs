//! Raises local contrast: contrast-limited adaptive histogram equalisation (CLAHE) of lightness.

use ndarray::{Array2, Array3, ArrayView2, Axis, Zip};
use rayon::prelude::*;
use serde::Serialize;

use super::lab::{LabCodes, LabSpace, lab_to_rgb, rgb_to_lab};
use super::noise_floor::NoiseFloor;
use crate::core::error::{Error, Result};
use crate::core::primaries::ColorSpace;

/// How local contrast is raised.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct ClaheConfig {
    /// The height to which a tile's histogram is cut, in multiples of its mean.
    pub clip_limit: f64,
    /// Rows and columns of tiles. Without, there are 8 × 8, as is usual; but where these would have fewer than 64 pixels, so
    /// few that each gets as many as its histogram has bins. Pictures of fewer than that stay as they are.
    pub grid: Option<[usize; 2]>,
    /// The noise whose contrast is not raised.
    pub noise: NoiseFloor,
}

impl Default for ClaheConfig {
    fn default() -> Self {
        Self { clip_limit: 1.0, grid: None, noise: NoiseFloor::default() }
    }
}

/// Tiles on each side of a picture that is large enough for them.
const USUAL_SIDE: usize = 8;

/// Pixels of a tile below which the histogram's bins are mostly empty, and what is given back to them brightens the picture.
const FEW_PIXELS: usize = 64;

/// Grids beyond this have more tiles than any use.
const LARGEST_GRID: usize = 1024;

/// Lightness codes of 8 bits.
const CODES: usize = 256;

impl ClaheConfig {
    pub(super) fn check(&self) -> Result<()> {
        if !(self.clip_limit.is_finite() && self.clip_limit > 0.0) {
            let reason = format!("must be a positive number, found {}", self.clip_limit);
            return Err(Error::config("clip-limit", reason));
        }
        if let Some(grid) = self.grid
            && grid.iter().any(|side| !(1..=LARGEST_GRID).contains(side))
        {
            let reason = format!("must have 1 to {LARGEST_GRID} tiles a side, found {grid:?}");
            return Err(Error::config("grid", reason));
        }
        self.noise.check()
    }

    /// The grid of a picture of these sides; none of one that is too small for any.
    fn grid_of(&self, [height, width]: [usize; 2]) -> Option<[usize; 2]> {
        let pixels = height * width;
        let least = if pixels >= FEW_PIXELS * USUAL_SIDE * USUAL_SIDE { FEW_PIXELS } else { CODES };
        let grids = (1..=USUAL_SIDE).rev().map(|side| [side.min(height), side.min(width)]);
        let is_filled = |[rows, columns]: &[usize; 2]| pixels >= least * rows * columns;
        self.grid.or_else(|| grids.into_iter().find(is_filled))
    }
}

/// Equalises L* of display values `[3, height, width]` in `[0, 1]` of a colour space, keeping a* and b*.
///
/// With `eight_bit` every intermediate value is an 8-bit code, as in programs that work in 8 bits; otherwise only the
/// histograms are, and lightness between two codes is mapped between their values. So it is where noise is looked for, or the
/// colours are not those of sRGB: what is below the noise is carried over as it is, beside what is mapped.
pub(super) fn equalize(planes: &mut Array3<f32>, config: &ClaheConfig, eight_bit: bool, space: ColorSpace) {
    let (_, height, width) = planes.dim();
    let Some(grid) = config.grid_of([height, width]) else { return };
    let eight_bit = eight_bit && config.noise == NoiseFloor::Ignored && space == ColorSpace::Srgb;
    let lab_space = LabSpace::of(space);
    let mut lab = to_lab(planes, eight_bit, &lab_space);
    let lightness = lab.index_axis(Axis(0), 0);
    let is_usual = config.grid.is_some() || grid == [USUAL_SIDE; 2];
    let remainder = if is_usual { Remainder::AtWholeSteps } else { Remainder::Evenly };
    let tiles = Tiles::new(lightness, grid, config.clip_limit, remainder);
    let mapped = match config.noise.detail(lightness) {
        None => tiles.map(lightness),
        Some(detail) => {
            let mut mapped = tiles.map(detail.view());
            Zip::from(&mut mapped)
                .and(lightness)
                .and(&detail)
                .par_for_each(|mapped, lightness, detail| *mapped += lightness - detail);
            mapped
        }
    };
    let keep = |v: f32| if eight_bit { v.round_ties_even() } else { v.clamp(0.0, 255.0) };
    lab.index_axis_mut(Axis(0), 0).assign(&mapped.mapv(keep));
    to_display(&lab, planes, eight_bit, &lab_space);
}

fn to_lab(planes: &Array3<f32>, eight_bit: bool, space: &LabSpace) -> Array3<f32> {
    let codes = LabCodes::new();
    convert(planes, |rgb| {
        if eight_bit { codes.encode(rgb.map(code_of)) } else { rgb_to_lab(space, rgb.map(f64::from)) }
    })
}

fn to_display(lab: &Array3<f32>, planes: &mut Array3<f32>, eight_bit: bool, space: &LabSpace) {
    *planes = convert(lab, |lab| {
        let rgb = lab_to_rgb(space, lab.map(f64::from));
        if eight_bit { rgb.map(|v| (255.0 * v).round_ties_even() / 255.0) } else { rgb }
    });
}

/// Converts pixel by pixel, row by row in parallel.
fn convert(planes: &Array3<f32>, pixel: impl Fn([f32; 3]) -> [f64; 3] + Sync) -> Array3<f32> {
    let (_, height, width) = planes.dim();
    let mut converted = Array3::zeros((3, height, width));
    converted.axis_iter_mut(Axis(1)).into_par_iter().enumerate().for_each(|(y, mut row)| {
        for x in 0..width {
            let values = pixel([planes[[0, y, x]], planes[[1, y, x]], planes[[2, y, x]]]);
            for (channel, value) in values.into_iter().enumerate() {
                #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
                let value = value as f32;
                row[[channel, x]] = value;
            }
        }
    });
    converted
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the type's range")]
fn code_of(value: f32) -> u8 {
    (255.0 * value.clamp(0.0, 1.0)).round_ties_even() as u8
}

/// The grid of tiles with the lightness that each gives to every code.
struct Tiles {
    /// Tiles in rows and columns.
    grid: [usize; 2],
    /// Height and width of a tile.
    size: [usize; 2],
    /// One table a tile, row by row.
    tables: Vec<[f32; CODES]>,
}

impl Tiles {
    /// # Equation
    /// Of each tile of n pixels (the picture mirrored at its right and lower border where it does not divide evenly)
    /// the histogram is cut at `max(⌊limit·n/256⌋, 1)`; what is cut off is given back evenly, the remainder to codes at
    /// equal distances. A code's value is the cumulative sum · 255/n, rounded (Zuiderveld, "Contrast limited adaptive
    /// histogram equalization", Graphics Gems IV, 1994).
    fn new(lightness: ArrayView2<'_, f32>, grid: [usize; 2], clip_limit: f64, remainder: Remainder) -> Self {
        let sides = [lightness.nrows(), lightness.ncols()];
        let divides = (0..2).all(|axis| sides[axis].is_multiple_of(grid[axis]));
        let padded =
            |axis: usize| sides[axis] + if divides { 0 } else { grid[axis] - sides[axis] % grid[axis] };
        let size = [padded(0) / grid[0], padded(1) / grid[1]];
        let table = |tile: usize| {
            let (top, left) = (tile / grid[1] * size[0], tile % grid[1] * size[1]);
            let mut histogram = [0u32; CODES];
            for y in top..top + size[0] {
                let row = lightness.row(mirrored(y, sides[0]));
                for x in left..left + size[1] {
                    histogram[usize::from(lightness_code(row[mirrored(x, sides[1])]))] += 1;
                }
            }
            table_of(&mut histogram, size[0] * size[1], clip_limit, remainder)
        };
        Self { grid, size, tables: (0..grid[0] * grid[1]).into_par_iter().map(table).collect() }
    }

    /// Maps every pixel between the tables of the four tiles whose centres surround it.
    fn map(&self, lightness: ArrayView2<'_, f32>) -> Array2<f32> {
        let mut mapped = Array2::zeros(lightness.dim());
        let columns: Vec<Between> = (0..lightness.ncols()).map(|x| self.between(x, 1)).collect();
        mapped.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut row)| {
            let vertical = self.between(y, 0);
            for (x, value) in row.iter_mut().enumerate() {
                let horizontal = columns[x];
                let l = lightness[[y, x]];
                let across = |tiles: usize| {
                    let table = |column: usize| look_up(&self.tables[tiles * self.grid[1] + column], l);
                    table(horizontal.first) * (1.0 - horizontal.share)
                        + table(horizontal.second) * horizontal.share
                };
                *value = across(vertical.first) * (1.0 - vertical.share)
                    + across(vertical.second) * vertical.share;
            }
        });
        mapped
    }

    fn between(&self, place: usize, axis: usize) -> Between {
        let at = place as f32 / self.size[axis] as f32 - 0.5;
        let last = self.grid[axis] - 1;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the place of a tile")]
        let (first, second) = ((at.floor().max(0.0)) as usize, (at.floor() + 1.0) as usize);
        Between { first: first.min(last), second: second.min(last), share: at - at.floor() }
    }
}

/// Two neighbouring tiles, and how far towards the second.
#[derive(Clone, Copy)]
struct Between {
    first: usize,
    second: usize,
    share: f32,
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the type's range")]
fn lightness_code(lightness: f32) -> u8 {
    lightness.round().clamp(0.0, 255.0) as u8
}

/// The value of a lightness that may lie between two codes.
fn look_up(table: &[f32; CODES], lightness: f32) -> f32 {
    let l = lightness.clamp(0.0, 255.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the codes")]
    let below = l.floor() as usize;
    let share = l - l.floor();
    let above = (below + 1).min(CODES - 1);
    table[below] * (1.0 - share) + table[above] * share
}

/// How the remainder of what was cut off is given back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Remainder {
    /// At distances of whole codes from the first, as OpenCV does: more than half of them go to the dark codes alone, which
    /// brightens even tiles of a few hundred pixels, and is nothing in those of photographs.
    AtWholeSteps,
    /// Over all codes.
    Evenly,
}

fn table_of(
    histogram: &mut [u32; CODES],
    pixels: usize,
    clip_limit: f64,
    remainder: Remainder,
) -> [f32; CODES] {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "positive, below the number of pixels of a tile or saturated"
    )]
    let limit = ((clip_limit * pixels as f64 / CODES as f64) as u32).max(1);
    let mut excess = 0;
    for count in histogram.iter_mut() {
        excess += count.saturating_sub(limit);
        *count = (*count).min(limit);
    }
    let (each, rest) = (excess / 256, excess as usize % CODES);
    histogram.iter_mut().for_each(|count| *count += each);
    let step = (CODES / rest.max(1)).max(1);
    match remainder {
        Remainder::AtWholeSteps => {
            histogram.iter_mut().step_by(step).take(rest).for_each(|count| *count += 1);
        }
        Remainder::Evenly => (0..rest).for_each(|i| histogram[(2 * i + 1) * CODES / (2 * rest)] += 1),
    }
    let scale = 255.0 / pixels as f32;
    let mut sum = 0;
    histogram.map(|count| {
        sum += count;
        (sum as f32 * scale).round_ties_even().min(255.0)
    })
}

/// Mirrors at the last pixel without repeating it; positions may lie several lengths beyond.
fn mirrored(place: usize, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let period = 2 * (length - 1);
    let place = place % period;
    place.min(period - place)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SRGB: ColorSpace = ColorSpace::Srgb;

    /// A cut at the mean leaves nothing to equalise: every code gets n/256 pixels, the table is the identity.
    #[test]
    fn a_cut_histogram_gives_back_what_was_cut() {
        let mut histogram = [0; CODES];
        histogram[40] = 2000;
        histogram[41] = 560;
        let table = table_of(&mut histogram, 2560, 1.0, Remainder::AtWholeSteps);
        assert_eq!(histogram.iter().sum::<u32>(), 2560);
        assert!(table.windows(2).all(|pair| pair[0] <= pair[1]));
        assert_eq!(table[255], 255.0);
    }

    /// Without a limit a tile's table is its cumulative histogram.
    #[test]
    fn an_unlimited_table_is_the_cumulative_histogram() {
        let mut histogram = [0; CODES];
        histogram[10] = 60;
        histogram[200] = 40;
        let table = table_of(&mut histogram, 100, 1e6, Remainder::Evenly);
        assert_eq!((table[9], table[10], table[199], table[200]), (0.0, 153.0, 153.0, 255.0));
    }

    #[test]
    fn mirrors_without_repeating_the_border() {
        let places: Vec<usize> = (0..9).map(|place| mirrored(place, 4)).collect();
        assert_eq!(places, [0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert_eq!(mirrored(5, 1), 0);
    }

    #[test]
    fn pictures_smaller_than_the_grid_are_equalised_too() {
        for (height, width) in [(1, 1), (3, 5), (8, 9), (17, 2)] {
            let mut planes = Array3::from_shape_fn((3, height, width), |(_, y, x)| (y + x) as f32 / 25.0);
            equalize(&mut planes, &ClaheConfig { grid: Some([8, 8]), ..ClaheConfig::default() }, true, SRGB);
            assert!(planes.iter().all(|v| (0.0..=1.0).contains(v)), "{height} × {width}");
        }
    }

    #[test]
    fn small_pictures_have_fewer_tiles_unless_told() {
        let of = |sides| ClaheConfig::default().grid_of(sides);
        assert_eq!(of([3000, 4000]), Some([8, 8]));
        assert_eq!(of([64, 64]), Some([8, 8]));
        assert_eq!(of([63, 64]), Some([3, 3]));
        assert_eq!(of([30, 40]), Some([2, 2]));
        assert_eq!(of([16, 16]), Some([1, 1]));
        assert_eq!(of([4000, 1]), Some([8, 1]));
        assert_eq!((of([15, 17]), of([1, 1]), of([30, 1])), (None, None, None));
        let given = ClaheConfig { grid: Some([8, 8]), ..ClaheConfig::default() };
        assert_eq!(given.grid_of([1, 1]), Some([8, 8]));
    }

    /// A cut at the mean leaves an even picture as it is, but for a pixel or two of a tile of 256: as many codes, and half as
    /// many again where display values rise faster than lightness.
    #[test]
    fn an_even_picture_of_a_few_pixels_stays_even_and_as_bright() {
        for (height, width) in [(1, 1), (30, 1), (15, 17), (16, 16), (20, 20), (30, 40), (200, 3), (60, 64)] {
            for value in [0.2, 0.5, 0.8] {
                let mut planes = Array3::from_elem((3, height, width), value);
                equalize(&mut planes, &ClaheConfig::default(), true, SRGB);
                let worst = planes.iter().map(|v| (v - value).abs()).fold(0.0, f32::max);
                assert!(worst < 4.0 / 255.0, "{height} × {width} of {value}: off by {worst}");
            }
        }
    }

    #[test]
    fn floats_keep_the_steps_between_codes() {
        let ramp = Array3::from_shape_fn((3, 64, 64), |(_, y, x)| 0.2 + (y * 64 + x) as f32 / 8192.0);
        let count = |eight_bit| {
            let mut planes = ramp.clone();
            equalize(&mut planes, &ClaheConfig::default(), eight_bit, SRGB);
            let mut values: Vec<u32> = planes.iter().map(|v| v.to_bits()).collect();
            values.sort_unstable();
            values.dedup();
            values.len()
        };
        assert!(count(true) <= 256 && count(false) > 1000, "{} {}", count(true), count(false));
    }

    /// An even dark wall with noise, of which the histogram is narrow and whose contrast is doubled, beside a bright texture.
    #[test]
    fn the_noise_of_an_even_wall_is_not_raised() {
        let mut random = 1_u64;
        let mut noise = || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 40) as f32 / 2f32.powi(24) - 0.5
        };
        let wall = Array3::from_shape_fn((3, 256, 256), |(_, y, x)| {
            if x < 128 { 0.15 + 0.03 * noise() } else { 0.5 + 0.3 * ((x / 4 + y / 4) % 2) as f32 }
        });
        let spread = |planes: &Array3<f32>| planes.slice(ndarray::s![1, 8..248, 8..100]).std(1.0);
        let equalized = |noise: NoiseFloor| {
            let mut planes = wall.clone();
            equalize(&mut planes, &ClaheConfig { noise, ..ClaheConfig::default() }, false, SRGB);
            planes
        };
        let [raised, kept] = [NoiseFloor::Ignored, NoiseFloor::Estimated].map(equalized);
        assert!(spread(&raised) > 1.3 * spread(&wall), "{} of {}", spread(&raised), spread(&wall));
        assert!(spread(&kept) < 1.1 * spread(&wall), "{} of {}", spread(&kept), spread(&wall));
        let contrast = |planes: &Array3<f32>| planes[[1, 128, 196]] - planes[[1, 128, 200]];
        assert!(
            (contrast(&kept) - contrast(&raised)).abs() < 0.02,
            "texture: {} {}",
            contrast(&kept),
            contrast(&raised)
        );
    }
}
