//! Refines a scene by the spectra of its own neighbourhoods: an empirical Wiener filter of local cosines.
//!
//! # Method
//! The scene that the penalty on differences left is the pilot: it tells, block by block, which frequencies a neighbourhood
//! has. The same scene with all that the capture has beyond it, noise included, is filtered block by block with
//! `P²/(P² + 2N)`, P the pilot's coefficient, N the variance of the noise in it, which the PSF's inverse makes of the
//! capture's. Blocks of 8 × 8 pixels every two pixels are averaged under a window; colours are taken apart into brightness and
//! two differences, where noise is told from detail better. A second pass takes the first one's result as its pilot.
//!
//! This is the second step of BM3D-DEB (Danielyan, Katkovnik, Egiazarian 2012, doi:10.1109/TIP.2011.2176954) without the
//! grouping of similar blocks.

use ndarray::{Array2, Array3, ArrayView2, Axis, Zip};
use rayon::prelude::*;

use super::channel::Channel;
use super::cosines::{Cosines, LANES, Lanes, SIDE, STEP, add_at, add_times, lane, lanes};
use super::fit::grown;
use super::frame::Frame;
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::core::progress::Progress;
use crate::kernels::vectorised;

/// Pixels before the frame at which the first block begins.
const BEFORE: usize = SIDE - STEP;

/// Passes: the second gains 0.2 dB.
const PASSES: usize = 2;

/// How much more the noise counts than it is: an estimated pilot lacks detail.
const CAUTION: f32 = 2.0;

/// Rows that one thread refines at a time; blocks above and below are computed twice.
const STRIP: usize = 32;

/// Pixels around saturated ones that are left as they are: no block tells what a lamp hid.
const HIDDEN_PX: usize = 2;

/// Brightness and two differences of colours, of orthonormal rows.
const COLORS: [[f32; CHANNELS]; CHANNELS] = [
    [0.577_350_26, 0.577_350_26, 0.577_350_26],
    [std::f32::consts::FRAC_1_SQRT_2, 0.0, -std::f32::consts::FRAC_1_SQRT_2],
    [0.408_248_3, -0.816_496_6, 0.408_248_3],
];

/// The coefficients of a block, or what each is multiplied by.
type Block = [[f32; SIDE]; SIDE];

/// A scene, and the standard deviation of its error, `[3, height, width]`.
pub(super) struct Refined {
    pub(super) scene: Array3<f32>,
    pub(super) deviation: Array3<f32>,
}

/// What the spectra of neighbourhoods are taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pilot {
    /// A scene that was found, and then what that refined it to.
    Estimate,
    /// The scene itself.
    Truth,
}

/// Refines the scene of all channels, which becomes that of the first pass.
pub(super) fn refine(
    frame: &Frame,
    channels: &mut [Channel<'_>],
    pilot: Pilot,
    progress: &Progress,
) -> Result<Refined> {
    let (passes, caution, hidden_px) = match pilot {
        Pilot::Estimate => (PASSES, CAUTION, HIDDEN_PX),
        Pilot::Truth => (1, 1.0, 0),
    };
    let [height, width] = frame.size();
    let is_saturated = |place: [usize; 2]| channels.iter().any(|channel| channel.is_saturated(place));
    let mut saturated = Array2::from_elem((height, width), false);
    Zip::indexed(&mut saturated).par_for_each(|(y, x), saturated| *saturated = is_saturated([y, x]));
    let hidden = grown(&saturated, hidden_px);
    let (mut sharp, mut bands) = (Vec::with_capacity(CHANNELS), Vec::with_capacity(CHANNELS));
    for channel in channels.iter() {
        progress.check()?;
        let (of_channel, of_bands) = channel.sharpened(&hidden, SIDE)?;
        sharp.push(of_channel);
        bands.push(std::array::from_fn(|row| std::array::from_fn(|column| of_bands[[row, column]])));
    }
    let mut scene = Array3::zeros((CHANNELS, height, width));
    let mut variance = Array3::zeros((CHANNELS, height, width));
    for pass in 1..=passes {
        progress.check()?;
        let pilots = channels.iter().map(|channel| frame.cut(&channel.scene)).collect();
        let filter =
            Pass { channels, pilots, sharp: &sharp, bands: &bands, caution, cosines: Cosines::new() };
        filter.run(&mut scene, &mut variance);
        for (channel, mut refined) in channels.iter_mut().zip(scene.outer_iter_mut()) {
            let places = Zip::from(frame.cut_mut(&mut channel.scene)).and(&mut refined).and(&hidden);
            places.par_for_each(|before, refined, hidden| {
                *refined = if *hidden { *before } else { refined.max(0.0) };
                if pass < passes {
                    *before = *refined;
                }
            });
        }
    }
    for (channel, mut variance) in channels.iter().zip(variance.axis_iter_mut(Axis(0))) {
        variance.par_mapv_inplace(f32::sqrt);
        channel.doubt(variance)?;
    }
    Ok(Refined { scene, deviation: variance })
}

/// What a pass filters.
struct Pass<'a, 'c> {
    channels: &'a [Channel<'c>],
    pilots: Vec<ArrayView2<'a, f32>>,
    sharp: &'a [Array2<f32>],
    /// The means of the noise's spectrum for noise 1.
    bands: &'a [Block],
    /// How much more the noise counts than it is.
    caution: f32,
    cosines: Cosines,
}

/// How rows of a strip lie in memory: first the even columns, then the odd ones, mirrored at the frame's border.
#[derive(Clone, Copy)]
struct Layout {
    /// Blocks beside each other, with those that fill the last lanes.
    blocks: usize,
    /// Even columns, as many as odd ones: those of the blocks, in whole lanes.
    half: usize,
}

impl Layout {
    fn new(width: usize) -> Self {
        let blocks = (width + BEFORE).div_ceil(STEP).next_multiple_of(LANES);
        Self { blocks, half: blocks + LANES }
    }

    /// Numbers of a row.
    fn stride(self) -> usize {
        2 * self.half
    }

    /// The place of column `x` of a block, and of those beside it, whose row begins so far in a plane.
    #[inline(always)]
    fn place(self, row: usize, x: usize) -> usize {
        row + (x % 2) * self.half + x / 2
    }

    /// The columns of blocks in a row.
    #[inline(always)]
    fn columns_of_blocks(self, from: &[f32], row: usize) -> [Lanes; SIDE] {
        let mut columns = [[0.0; LANES]; SIDE];
        for (x, column) in columns.iter_mut().enumerate() {
            *column = lane(from, self.place(row, x));
        }
        columns
    }

    /// Writes a row of the frame as it lies beside what the mirrors at its border show.
    fn extend(row: &[f32], extended: &mut [f32]) {
        let columns = (0..extended.len()).map(|at| at.cast_signed() - BEFORE.cast_signed());
        let show = |out: &mut f32, column| *out = row[mirrored(column, row.len())];
        let after = (BEFORE + row.len()).min(extended.len());
        extended.iter_mut().zip(columns.clone()).take(BEFORE).for_each(|(out, column)| show(out, column));
        extended.iter_mut().zip(columns).skip(after).for_each(|(out, column)| show(out, column));
        extended[BEFORE..after].copy_from_slice(&row[..after - BEFORE]);
    }

    /// Takes such a row apart into its even and its odd columns.
    fn take_apart(self, extended: &[f32], row: &mut [f32]) {
        let (even, odd) = row.split_at_mut(self.half);
        for ((pair, even), odd) in extended.as_chunks::<2>().0.iter().zip(even).zip(odd) {
            [*even, *odd] = *pair;
        }
    }
}

/// Planes of rows, colours apart.
type Planes = [Vec<f32>; CHANNELS];

fn planes(len: usize) -> Planes {
    std::array::from_fn(|_| vec![0.0; len])
}

/// The rows `first..first + rows` of a frame, mirrored at its border, as brightness and differences.
fn padded(from: &[ArrayView2<'_, f32>], layout: Layout, first: isize, rows: usize) -> Planes {
    let height = from[0].nrows();
    let stride = layout.stride();
    let mut padded = planes(rows * stride);
    let (mut extended, mut mixed) = (planes(stride), vec![0.0; stride]);
    for row in 0..rows {
        let y = mirrored(first + row.cast_signed(), height);
        for (extended, plane) in extended.iter_mut().zip(from) {
            let row = plane.row(y);
            Layout::extend(row.to_slice().expect("rows are contiguous"), extended);
        }
        for (plane, weights) in padded.iter_mut().zip(COLORS) {
            mix(&mut mixed, extended.each_ref().map(|row| &row[..]), weights);
            layout.take_apart(&mixed, &mut plane[row * stride..][..stride]);
        }
    }
    padded
}

/// The index that a mirror at the first and at the last one shows.
fn mirrored(index: isize, length: usize) -> usize {
    let period = (2 * length).saturating_sub(2).max(1).cast_signed();
    let index = index.rem_euclid(period);
    index.min(period - index).cast_unsigned().min(length - 1)
}

/// What a row of blocks is filtered in.
struct Room {
    /// Cosines along columns of the pilot and of what is filtered, by frequency and column.
    along_columns: [Vec<f32>; 2],
    /// What the filtered blocks add up to, by frequency along columns and by column, and their variance.
    filtered: Vec<f32>,
    variance: Vec<f32>,
    /// The variance of each channel's noise in each block.
    noises: Planes,
}

impl Room {
    fn new(layout: Layout) -> Self {
        let block_row = || vec![0.0; SIDE * layout.stride()];
        Self {
            along_columns: [block_row(), block_row()],
            filtered: block_row(),
            variance: vec![0.0; layout.stride()],
            noises: planes(layout.blocks),
        }
    }
}

impl Pass<'_, '_> {
    /// Writes the filtered scene and the variance of its error.
    fn run(&self, scene: &mut Array3<f32>, variance: &mut Array3<f32>) {
        let layout = Layout::new(scene.dim().2);
        let squares = COLORS.map(|color| color.map(|weight| weight * weight));
        let strips = scene.axis_chunks_iter_mut(Axis(1), STRIP).into_par_iter();
        let strips = strips.zip(variance.axis_chunks_iter_mut(Axis(1), STRIP)).enumerate();
        strips.for_each(|(index, (mut scene, mut variance))| {
            let rows = scene.dim().1;
            let [colors, variances] = self.strip(index * STRIP, rows, layout);
            let mut mixed = vec![0.0; layout.stride()];
            for (out, from, weights) in
                [(&mut scene, &colors, &COLORS), (&mut variance, &variances, &squares)]
            {
                for (channel, mut plane) in out.outer_iter_mut().enumerate() {
                    for (y, mut row) in plane.outer_iter_mut().enumerate() {
                        let of_row = |color: usize| &from[color][y * layout.stride()..][..layout.stride()];
                        let weights = std::array::from_fn(|color| weights[color][channel]);
                        mix(&mut mixed, std::array::from_fn(of_row), weights);
                        let row = row.as_slice_mut().expect("planes are contiguous");
                        interleave(row, &mixed, layout);
                    }
                }
            }
        });
    }

    /// The colours, apart, and their variances in the rows `top..top + rows`.
    fn strip(&self, top: usize, rows: usize, layout: Layout) -> [Planes; 2] {
        let first = top.cast_signed() - BEFORE.cast_signed();
        let padded_rows = rows + BEFORE + SIDE;
        let sharp: Vec<ArrayView2<'_, f32>> = self.sharp.iter().map(|plane| plane.view()).collect();
        let from = [&self.pilots, &sharp].map(|from| padded(from, layout, first, padded_rows));
        let mut sums = [planes(rows * layout.stride()), planes(rows * layout.stride())];
        let mut room = Room::new(layout);
        // Blocks begin at even rows and columns of the frame, wherever strips do.
        for y in (0..rows + BEFORE).step_by(STEP) {
            self.write_noises(top + y, &mut room.noises);
            for color in 0..CHANNELS {
                let from = [&from[0][color][..], &from[1][color]].map(|plane| &plane[y * layout.stride()..]);
                let sums = sums.each_mut().map(|planes| &mut planes[color][..]);
                add_blocks((self, color), layout, from, &mut room, (y, sums));
            }
        }
        sums
    }

    /// Writes the variance of each channel's noise in the middles of the blocks of a row that begins so far after the first possible
    /// one.
    fn write_noises(&self, y: usize, noises: &mut Planes) {
        let (height, width) = self.pilots[0].dim();
        let middle = |at: usize, length: usize| (at + SIDE / 2).saturating_sub(BEFORE).min(length - 1);
        for (noises, channel) in noises.iter_mut().zip(self.channels) {
            let columns = (0..).map(|block| middle(STEP * block, width));
            channel.write_noise(middle(y, height), columns, noises);
            noises.iter_mut().for_each(|noise| *noise *= *noise);
        }
    }
}

vectorised! {
    /// Writes the weighted sum of three rows.
    fn mix<'a>(out: &'a mut [f32], rows: [&'a [f32]; CHANNELS], weights: [f32; CHANNELS]) -> () {
        let [first, second, third] = rows;
        for (((out, first), second), third) in out.iter_mut().zip(first).zip(second).zip(third) {
            *out = weights[0] * first + weights[1] * second + weights[2] * third;
        }
    }
}

/// Takes a row of the frame from its even and odd columns.
fn interleave(row: &mut [f32], from: &[f32], layout: Layout) {
    let (even, odd) = (&from[BEFORE / 2..layout.half], &from[layout.half + BEFORE / 2..]);
    for ((out, even), odd) in row.chunks_mut(2).zip(even).zip(odd) {
        out[0] = *even;
        if let Some(out) = out.get_mut(1) {
            *out = *odd;
        }
    }
}

vectorised! {
    /// Filters a row of blocks of one colour and adds them to the sums of that colour and of its variance, whose first row is the
    /// block's row `BEFORE − y`.
    fn add_blocks<'a, 'b, 'c>(
        of: (&'a Pass<'b, 'c>, usize),
        layout: Layout,
        from: [&'a [f32]; 2],
        room: &'a mut Room,
        to: (usize, [&'a mut [f32]; 2]),
    ) -> () {
        let ((pass, color), (y, [colors, variances])) = (of, to);
        let Room { along_columns, filtered, variance, noises } = room;
        let (cosines, stride) = (&pass.cosines, layout.stride());
        for (out, from) in along_columns.iter_mut().zip(from) {
            for at in (0..stride).step_by(LANES) {
                let coefficients = cosines.forward(&lanes(from, at, stride));
                for (u, coefficient) in coefficients.iter().enumerate() {
                    out[u * stride + at..][..LANES].copy_from_slice(coefficient);
                }
            }
        }
        filtered.fill(0.0);
        variance.fill(0.0);
        for first in (0..layout.blocks).step_by(LANES) {
            let mut weights = [[0.0; LANES]; CHANNELS];
            for (channel, (weights, noises)) in weights.iter_mut().zip(&*noises).enumerate() {
                let square = COLORS[color][channel] * COLORS[color][channel];
                add_times(weights, square, &lane(noises, first));
            }
            let mut left = [0.0; LANES];
            for u in 0..SIDE {
                let row = u * stride + first;
                let pilot = cosines.forward(&layout.columns_of_blocks(&along_columns[0], row));
                let mut sharp = cosines.forward(&layout.columns_of_blocks(&along_columns[1], row));
                for v in 0..SIDE {
                    let mut noise = [0.0; LANES];
                    for (weights, bands) in weights.iter().zip(pass.bands) {
                        add_times(&mut noise, bands[u][v], weights);
                    }
                    filter(&mut sharp[v], &pilot[v], (&noise, pass.caution), &mut left);
                }
                for (x, value) in cosines.inverse(&sharp).iter().enumerate() {
                    add_at(filtered, layout.place(row, x), cosines.window[x], value);
                }
            }
            for x in 0..SIDE {
                add_at(variance, layout.place(first, x), cosines.window[x] / COEFFICIENTS, &left);
            }
        }
        for at in (0..stride).step_by(LANES) {
            let values = cosines.inverse(&lanes(filtered, at, stride));
            let of_variance = lane(variance, at);
            for (row, value) in values.iter().enumerate() {
                let Some(row_of_sums) = (y + row).checked_sub(BEFORE) else { continue };
                let place = row_of_sums * stride + at;
                if place < colors.len() {
                    add_at(colors, place, cosines.window[row], value);
                    add_at(variances, place, cosines.window[row], &of_variance);
                }
            }
        }
    }
}

/// The coefficients of a block.
#[expect(clippy::cast_precision_loss, reason = "64 coefficients")]
const COEFFICIENTS: f32 = (SIDE * SIDE) as f32;

/// Filters a coefficient with noise of a variance, and adds to the variance of what is left.
#[inline(always)]
fn filter(coefficient: &mut Lanes, pilot: &Lanes, (noise, caution): (&Lanes, f32), left: &mut Lanes) {
    for (((value, pilot), noise), left) in coefficient.iter_mut().zip(pilot).zip(noise).zip(left) {
        let power = pilot * pilot;
        let gain = power / (power + caution * noise + f32::MIN_POSITIVE);
        *value *= gain;
        *left += gain * noise;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_taken_apart_by_a_rotation() {
        for (i, one) in COLORS.iter().enumerate() {
            for (j, other) in COLORS.iter().enumerate() {
                let inner: f32 = one.iter().zip(other).map(|(a, b)| a * b).sum();
                assert!((inner - f32::from(u8::from(i == j))).abs() < 1e-6, "{i} {j}");
            }
        }
    }

    #[test]
    fn a_mirror_stands_on_the_first_and_on_the_last_pixel() {
        let shown: Vec<usize> = (-3..7).map(|index| mirrored(index, 4)).collect();
        assert_eq!(shown, [3, 2, 1, 0, 1, 2, 3, 2, 1, 0]);
        assert!((-9..9).all(|index| mirrored(index, 1) == 0));
        assert!((-9..9).all(|index| mirrored(index, 2) == usize::from(index % 2 != 0)));
    }

    /// Without noise all blocks pass, and under their windows they add up to the image, whatever the size of the frame and the strip.
    #[test]
    fn blocks_without_noise_add_up_to_the_image() {
        for (height, width) in [(1, 1), (2, 3), (11, 14), (67, 45)] {
            let planes: Vec<_> = (0..CHANNELS)
                .map(|c| {
                    Array2::from_shape_fn((height, width), |(y, x)| {
                        ((y * 7 + x * 5 + c * 3) % 11) as f32 - 3.0
                    })
                })
                .collect();
            let pilots = planes.iter().map(|plane| plane.view()).collect();
            let bands = [[[1.0; SIDE]; SIDE]; CHANNELS];
            let (bands, cosines) = (&bands, Cosines::new());
            let pass = Pass { channels: &[], pilots, sharp: &planes, bands, caution: 1.0, cosines };
            let [mut scene, mut variance] = [(); 2].map(|()| Array3::ones((CHANNELS, height, width)));
            pass.run(&mut scene, &mut variance);
            for (plane, found) in planes.iter().zip(scene.outer_iter()) {
                assert!(plane.iter().zip(&found).all(|(a, b)| (a - b).abs() < 1e-5), "{height} × {width}");
            }
            assert!(variance.iter().all(|variance| *variance == 0.0));
        }
    }
}
