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
use super::fit::grown;
use super::frame::Frame;
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::core::progress::Progress;
use crate::kernels::vectorised;

/// Side of a block: 16 restores 0.1 dB worse.
const SIDE: usize = 8;

/// Pixels from one block to the next: with 4 it is 0.2 dB worse.
const STEP: usize = 2;

/// Pixels before the frame at which the first block begins.
const BEFORE: usize = SIDE - STEP;

/// Passes: the second gains 0.2 dB.
const PASSES: usize = 2;

/// How much more the noise counts than it is: a pilot lacks detail.
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

type Block = [[f32; SIDE]; SIDE];

/// A scene, and the standard deviation of its error, `[3, height, width]`.
pub(super) struct Refined {
    pub(super) scene: Array3<f32>,
    pub(super) deviation: Array3<f32>,
}

/// Refines the scene of all channels, which becomes that of the first pass.
pub(super) fn refine(frame: &Frame, channels: &mut [Channel<'_>], progress: &Progress) -> Result<Refined> {
    let [height, width] = frame.size();
    let is_saturated = |place: [usize; 2]| channels.iter().any(|channel| channel.is_saturated(place));
    let saturated = Array2::from_shape_fn((height, width), |(y, x)| is_saturated([y, x]));
    let hidden = grown(&saturated, HIDDEN_PX);
    let (mut sharp, mut bands) = (Vec::with_capacity(CHANNELS), Vec::with_capacity(CHANNELS));
    for channel in channels.iter() {
        progress.check()?;
        let (of_channel, of_bands) = channel.sharpened(&hidden, SIDE)?;
        sharp.push(of_channel);
        bands.push(std::array::from_fn(|row| std::array::from_fn(|column| of_bands[[row, column]])));
    }
    let mut scene = Array3::zeros((CHANNELS, height, width));
    let mut variance = Array3::zeros((CHANNELS, height, width));
    for pass in 1..=PASSES {
        progress.check()?;
        let pilots = channels.iter().map(|channel| frame.cut(&channel.scene)).collect();
        let filter = Pass { channels, pilots, sharp: &sharp, bands: &bands, cosines: Cosines::new() };
        filter.run(&mut scene, &mut variance);
        for (channel, mut refined) in channels.iter_mut().zip(scene.outer_iter_mut()) {
            let places = Zip::from(frame.cut_mut(&mut channel.scene)).and(&mut refined).and(&hidden);
            places.par_for_each(|before, refined, hidden| {
                *refined = if *hidden { *before } else { refined.max(0.0) };
                if pass < PASSES {
                    *before = *refined;
                }
            });
        }
    }
    for (channel, mut variance) in channels.iter().zip(variance.axis_iter_mut(Axis(0))) {
        let mut deviation = variance.mapv(f32::sqrt);
        channel.doubt(&mut deviation);
        variance.assign(&deviation);
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
    cosines: Cosines,
}

/// Three planes of rows of a strip and around it, colours apart.
struct Padded {
    planes: [Vec<f32>; CHANNELS],
    width: usize,
}

impl Padded {
    /// Rows `first..first + rows` and the columns of the frame and around it, mirrored at its border.
    fn new(from: &[ArrayView2<'_, f32>], first: isize, rows: usize) -> Self {
        let (height, of_frame) = from[0].dim();
        let width = of_frame + BEFORE + SIDE;
        let mut planes: [Vec<f32>; CHANNELS] = std::array::from_fn(|_| vec![0.0; rows * width]);
        let columns: Vec<usize> =
            (0..width).map(|x| mirrored(x.cast_signed() - BEFORE.cast_signed(), of_frame)).collect();
        for row in 0..rows {
            let y = mirrored(first + row.cast_signed(), height);
            for (x, &column) in columns.iter().enumerate() {
                let rgb: [f32; CHANNELS] = std::array::from_fn(|channel| from[channel][[y, column]]);
                for (plane, color) in planes.iter_mut().zip(&COLORS) {
                    plane[row * width + x] = color[0] * rgb[0] + color[1] * rgb[1] + color[2] * rgb[2];
                }
            }
        }
        Self { planes, width }
    }

    #[inline(always)]
    fn block(&self, plane: usize, y: usize, x: usize) -> Block {
        let start = y * self.width + x;
        let row = |row: usize| {
            let start = start + row * self.width;
            self.planes[plane][start..start + SIDE].try_into().expect("a row has the block's side")
        };
        std::array::from_fn(row)
    }
}

/// The index that a mirror at the first and at the last one shows.
fn mirrored(index: isize, length: usize) -> usize {
    let period = (2 * length).saturating_sub(2).max(1).cast_signed();
    let index = index.rem_euclid(period);
    index.min(period - index).cast_unsigned().min(length - 1)
}

impl Pass<'_, '_> {
    /// Writes the filtered scene and the variance of its error.
    fn run(&self, scene: &mut Array3<f32>, variance: &mut Array3<f32>) {
        let strips = scene.axis_chunks_iter_mut(Axis(1), STRIP).into_par_iter();
        let strips = strips.zip(variance.axis_chunks_iter_mut(Axis(1), STRIP)).enumerate();
        strips.for_each(|(index, (mut scene, mut variance))| {
            let (_, rows, width) = scene.dim();
            let [colors, variances] = self.strip(index * STRIP, rows, width);
            for y in 0..rows {
                for x in 0..width {
                    let at = y * width + x;
                    for channel in 0..CHANNELS {
                        scene[[channel, y, x]] =
                            (0..CHANNELS).map(|c| COLORS[c][channel] * colors[c][at]).sum();
                        variance[[channel, y, x]] =
                            (0..CHANNELS).map(|c| COLORS[c][channel].powi(2) * variances[c][at]).sum();
                    }
                }
            }
        });
    }

    /// The colours, apart, and their variances in the rows `top..top + rows`.
    fn strip(&self, top: usize, rows: usize, width: usize) -> [[Vec<f32>; CHANNELS]; 2] {
        let mut sums: [[Vec<f32>; CHANNELS]; 2] =
            std::array::from_fn(|_| std::array::from_fn(|_| vec![0.0; rows * width]));
        let first = top.cast_signed() - BEFORE.cast_signed();
        let padded_rows = rows + BEFORE + SIDE;
        let pilot = Padded::new(&self.pilots, first, padded_rows);
        let sharp: Vec<ArrayView2<'_, f32>> = self.sharp.iter().map(|plane| plane.view()).collect();
        let sharp = Padded::new(&sharp, first, padded_rows);
        // Blocks begin at even rows and columns of the frame, wherever strips do.
        for y in (0..rows + BEFORE).step_by(STEP) {
            add_blocks(self, [&pilot, &sharp], &mut sums, (y, top), [rows, width]);
        }
        sums
    }

    /// The filtered colours of a block and the means of their variances.
    #[inline(always)]
    fn block(
        &self,
        [pilot, sharp]: [&Padded; 2],
        [y, x]: [usize; 2],
        top: usize,
    ) -> ([Block; CHANNELS], [f32; CHANNELS]) {
        let noises: [f32; CHANNELS] =
            std::array::from_fn(|channel| self.noise(channel, [top + y, x]).powi(2));
        let mut variances = [0.0; CHANNELS];
        let blocks = std::array::from_fn(|color| {
            let pilot = self.cosines.forward(&pilot.block(color, y, x));
            let mut filtered = self.cosines.forward(&sharp.block(color, y, x));
            let weights: [f32; CHANNELS] =
                std::array::from_fn(|channel| COLORS[color][channel].powi(2) * noises[channel]);
            let mut sum = [0.0_f32; SIDE];
            for row in 0..SIDE {
                let [red, green, blue]: [&[f32; SIDE]; CHANNELS] =
                    std::array::from_fn(|channel| &self.bands[channel][row]);
                for column in 0..SIDE {
                    let noise =
                        weights[0] * red[column] + weights[1] * green[column] + weights[2] * blue[column];
                    let power = pilot[row][column] * pilot[row][column];
                    let gain = power / (power + CAUTION * noise + f32::MIN_POSITIVE);
                    filtered[row][column] *= gain;
                    sum[column] += gain * noise;
                }
            }
            #[expect(clippy::cast_precision_loss, reason = "64 coefficients")]
            let count = (SIDE * SIDE) as f32;
            variances[color] = sum.iter().sum::<f32>() / count;
            self.cosines.inverse(&filtered)
        });
        (blocks, variances)
    }

    /// The deviation of the capture's noise in the middle of a block, which begins so far after the first possible one.
    #[inline(always)]
    fn noise(&self, channel: usize, place: [usize; 2]) -> f32 {
        let (height, width) = self.pilots[0].dim();
        let [y, x] = place.map(|at| (at + SIDE / 2).saturating_sub(BEFORE));
        self.channels[channel].noise_at([y.min(height - 1), x.min(width - 1)])
    }
}

vectorised! {
    /// Adds the blocks of a row y, from the left to the right, to the colours and their variances.
    fn add_blocks<'a, 'b, 'c>(
        pass: &'a Pass<'b, 'c>,
        padded: [&'a Padded; 2],
        sums: &'a mut [[Vec<f32>; CHANNELS]; 2],
        at: (usize, usize),
        size: [usize; 2],
    ) -> () {
        let (y, top) = at;
        for x in (0..size[1] + BEFORE).step_by(STEP) {
            let (blocks, variances) = pass.block(padded, [y, x], top);
            for c in 0..CHANNELS {
                let [colors, of_variance] = &mut *sums;
                let place = [&mut colors[c][..], &mut of_variance[c][..]];
                pass.cosines.add((&blocks[c], variances[c]), place, [y, x], size);
            }
        }
    }
}

/// The cosines of a block, and the window under which blocks are averaged.
struct Cosines {
    rows: Block,
    columns: Block,
    window: Block,
}

impl Cosines {
    fn new() -> Self {
        #[expect(clippy::cast_precision_loss, reason = "indices of a block")]
        let cosine = |u: usize, x: usize| {
            let scale = if u == 0 { 1.0 } else { std::f32::consts::SQRT_2 };
            scale * (std::f32::consts::PI * u as f32 * (x as f32 + 0.5) / SIDE as f32).cos()
                / (SIDE as f32).sqrt()
        };
        // Von Hann's, without the zeros at its ends; blocks two pixels apart add up to the same everywhere.
        #[expect(clippy::cast_precision_loss, reason = "indices of a block")]
        let bell = |x: usize| (std::f32::consts::PI * (x as f32 + 1.0) / (SIDE as f32 + 1.0)).sin().powi(2);
        let sum: f32 = (0..SIDE).step_by(STEP).map(bell).sum();
        Self {
            rows: std::array::from_fn(|u| std::array::from_fn(|x| cosine(u, x))),
            columns: std::array::from_fn(|x| std::array::from_fn(|u| cosine(u, x))),
            window: std::array::from_fn(|y| std::array::from_fn(|x| bell(y) * bell(x) / (sum * sum))),
        }
    }

    /// The coefficients of a block, by row and column of frequencies.
    #[inline(always)]
    fn forward(&self, block: &Block) -> Block {
        product(&product(&self.rows, block), &self.columns)
    }

    #[inline(always)]
    fn inverse(&self, coefficients: &Block) -> Block {
        product(&product(&self.columns, coefficients), &self.rows)
    }

    /// Adds a block and its variance under the window, where it lies in the strip.
    #[inline(always)]
    fn add(
        &self,
        (block, variance): (&Block, f32),
        [colors, variances]: [&mut [f32]; 2],
        [y, x]: [usize; 2],
        [rows, width]: [usize; 2],
    ) {
        let first = BEFORE.saturating_sub(x);
        let last = SIDE.min(width + BEFORE - x);
        for (row, (block, window)) in block.iter().zip(&self.window).enumerate() {
            let Some(at) = (y + row).checked_sub(BEFORE).filter(|at| *at < rows) else { continue };
            let start = at * width + x + first - BEFORE;
            let to = colors[start..].iter_mut().zip(&mut variances[start..]);
            let from = block[first..last].iter().zip(&window[first..last]);
            for ((color, of_variance), (value, weight)) in to.zip(from) {
                *color += weight * value;
                *of_variance += weight * variance;
            }
        }
    }
}

/// The product of two blocks as matrices, row by row of the second: eight numbers at a time.
#[inline(always)]
fn product(left: &Block, right: &Block) -> Block {
    let mut out = [[0.0; SIDE]; SIDE];
    for (out, left) in out.iter_mut().zip(left) {
        for (left, right) in left.iter().zip(right) {
            for (out, right) in out.iter_mut().zip(right) {
                *out += left * right;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block() -> Block {
        std::array::from_fn(|y| std::array::from_fn(|x| ((y * 31 + x * 17) % 23) as f32 / 23.0))
    }

    #[test]
    fn cosines_return_and_keep_the_power() {
        let (cosines, block) = (Cosines::new(), block());
        let coefficients = cosines.forward(&block);
        let power = |block: &Block| block.iter().flatten().map(|v| v * v).sum::<f32>();
        assert!((power(&coefficients) / power(&block) - 1.0).abs() < 1e-5);
        let mean = block.iter().flatten().sum::<f32>() / 8.0;
        assert!((coefficients[0][0] - mean).abs() < 1e-5, "{} {mean}", coefficients[0][0]);
        let back = cosines.inverse(&coefficients);
        assert!(back.iter().flatten().zip(block.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn a_row_of_cosines_is_one_column_of_coefficients() {
        let cosines = Cosines::new();
        let wave: Block = std::array::from_fn(|_| cosines.rows[3]);
        let coefficients = cosines.forward(&wave);
        for (u, row) in coefficients.iter().enumerate() {
            for (v, value) in row.iter().enumerate() {
                let expected = if (u, v) == (0, 3) { 8f32.sqrt() } else { 0.0 };
                assert!((value - expected).abs() < 1e-5, "{u} {v}: {value}");
            }
        }
    }

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

    /// Blocks under their windows add up to the image, whatever the size of the frame and the strip.
    #[test]
    fn windows_add_up_to_one() {
        let cosines = Cosines::new();
        let (rows, width) = (11, 14);
        let (mut colors, mut variances) = (vec![0.0; rows * width], vec![0.0; rows * width]);
        for y in (0..rows + BEFORE).step_by(STEP) {
            for x in (0..width + BEFORE).step_by(STEP) {
                cosines.add(
                    (&[[1.0; SIDE]; SIDE], 2.0),
                    [&mut colors, &mut variances],
                    [y, x],
                    [rows, width],
                );
            }
        }
        assert!(colors.iter().all(|v| (v - 1.0).abs() < 1e-5), "{colors:?}");
        assert!(variances.iter().all(|v| (v - 2.0).abs() < 1e-5));
    }
}
