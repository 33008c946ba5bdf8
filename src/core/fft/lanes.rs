//! The transform of real planes of 32 bits whose sides are products of 2, 3 and 5, with sixteen lines side by side.
//!
//! # Method
//! As [`Transform`](super::transform::Transform) does it, but nothing is shuffled within a line: sixteen rows, then sixteen columns,
//! are transformed at once, each in a lane. Between them stands an intermediate of tiles of 16 × 16 complex numbers, of which the
//! column pass reads rows side by side and leaves columns side by side.

use std::ops::Range;

use rayon::prelude::*;

use super::pool::{Loan, Pool};
use super::transform::Keep;
use crate::kernels::fourier::{COMPLEX, Direction, LinePlan, RealPlan, TILE, WIDE, is_smooth, transpose};

/// Plans for planes of one size, and buffers that are used again.
pub(super) struct LaneTransform {
    height: usize,
    width: usize,
    along_rows: RealPlan,
    along_columns: LinePlan,
    /// What stands between the row and the column pass, one at a time for each plane in work: `[row / 16][kx / 16]` tiles.
    tiles: Pool<Vec<f32>>,
    /// Spectra that nobody needs any more.
    spectra: Pool<LaneSpectrum>,
    /// What a thread works in.
    scratches: Pool<Scratch>,
}

/// The half spectrum of a plane, `[kx / 16][ky][part][kx mod 16]`, zero beyond its width.
pub(super) type LaneSpectrum = Vec<f32>;

/// What one thread works in.
struct Scratch {
    /// Sixteen rows, one after the other.
    rows: Vec<f32>,
    /// Room for sixteen lines side by side, twice.
    lines: [Vec<f32>; 2],
}

impl LaneTransform {
    /// Whether planes of a size can be transformed so.
    pub(super) fn serves(height: usize, width: usize) -> bool {
        [height, width].into_iter().all(|side| side.is_multiple_of(WIDE) && is_smooth(side))
    }

    /// Plans for planes of a size that [`serves`](Self::serves).
    pub(super) fn new(height: usize, width: usize) -> Self {
        assert!(Self::serves(height, width), "sides of {height} × {width} are no multiples of {WIDE}");
        let (along_rows, along_columns) = (RealPlan::new(width), LinePlan::new(height));
        let (tiles, spectra, scratches) = (Pool::new(), Pool::new(), Pool::new());
        Self { height, width, along_rows, along_columns, tiles, spectra, scratches }
    }

    /// Samples of a spectrum.
    pub(super) fn spectrum_len(&self) -> usize {
        self.tiles_of_rows() * self.height * COMPLEX
    }

    /// Where a sample of a spectrum stands: its real part, and so much further its imaginary one.
    pub(super) fn place(&self, kx: usize, ky: usize) -> [usize; 2] {
        let real = (kx / WIDE * self.height + ky) * COMPLEX + kx % WIDE;
        [real, real + WIDE]
    }

    /// Transforms a plane whose rows outside of `rows` are zero; `fill(row, samples)` writes the samples of a row, which come as
    /// zeros.
    pub(super) fn forward(
        &self,
        rows: &[Range<usize>],
        fill: impl Fn(usize, &mut [f32]) + Sync,
    ) -> LaneSpectrum {
        let is_filled = |row: &usize| rows.iter().any(|rows| rows.contains(row));
        let groups: Vec<usize> =
            (0..self.height / WIDE).filter(|group| rows_of(*group).any(|row| is_filled(&row))).collect();
        let mut tiles = self.lend_tiles(groups.len());
        let fill = |row: usize, samples: &mut [f32]| {
            if is_filled(&row) {
                fill(row, samples);
            }
        };
        self.transform_rows(&groups, &fill, &mut tiles);
        let mut spectrum = self.spectra.take().unwrap_or_else(|| vec![0.0; self.spectrum_len()]);
        spectrum.par_chunks_mut(self.height * COMPLEX).enumerate().for_each_init(
            || self.lend_scratch(),
            |scratch, (column, lines)| {
                lines.fill(0.0);
                for (group, tiles) in groups.iter().zip(tiles.chunks_exact(self.floats_of_tiles())) {
                    place_rows(&tiles[column * TILE..][..TILE], &mut lines[group * TILE..][..TILE]);
                }
                let room = &mut scratch.lines[0][..lines.len()];
                let [transformed, other] = self.along_columns.transform(Direction::Forward, lines, room);
                if self.along_columns.moves() {
                    other.copy_from_slice(transformed);
                }
            },
        );
        spectrum
    }

    /// Takes a spectrum of this size back, for the next one: a new one would come from the system page by page.
    pub(super) fn take_back(&self, spectrum: LaneSpectrum) {
        self.spectra.put(spectrum);
    }

    /// Transforms a plane of which only the first `rows` rows are not zero, lets `multiply(column, lines)` change each sixteen
    /// columns of its spectrum, transforms it back and keeps what `out`, rows of `width` samples, has room for of its top left.
    ///
    /// `keep(row, samples, out)` takes each row to that of `out`; the sum of what it returns is returned, added in the order of
    /// the rows.
    pub(super) fn filter(
        &self,
        (rows, fill): (usize, impl Fn(usize, &mut [f32]) + Sync),
        multiply: impl Fn(usize, &mut [f32]) + Sync,
        (out, width): (&mut [f32], usize),
        keep: impl Keep,
    ) -> f64 {
        let groups: Vec<usize> = (0..rows.div_ceil(WIDE)).collect();
        let kept = (out.len() / width.max(1)).div_ceil(WIDE);
        let mut tiles = self.lend_tiles(groups.len().max(kept));
        let fill = |row: usize, samples: &mut [f32]| {
            if row < rows {
                fill(row, samples);
            }
        };
        self.transform_rows(&groups, &fill, &mut tiles);
        self.transform_columns(&mut tiles, (groups.len(), kept), &multiply);
        self.transform_rows_back(&tiles, (out, width), keep)
    }

    /// Transforms groups of sixteen rows to rows of tiles.
    fn transform_rows(
        &self,
        groups: &[usize],
        fill: &(impl Fn(usize, &mut [f32]) + Sync),
        tiles: &mut [f32],
    ) {
        tiles.par_chunks_exact_mut(self.floats_of_tiles()).zip(groups).for_each_init(
            || self.lend_scratch(),
            |scratch, (tiles, group)| {
                let Scratch { rows, lines } = &mut **scratch;
                rows.fill(0.0);
                rows_of(*group)
                    .zip(rows.chunks_exact_mut(self.width))
                    .for_each(|(row, samples)| fill(row, samples));
                // Planes of lamps are dark in most rows.
                if is_zero(rows) {
                    tiles.fill(0.0);
                    return;
                }
                let [lines, room] = lines.each_mut().map(|lines| &mut lines[..self.width * WIDE]);
                for (at, block) in (0..self.width).step_by(WIDE).zip(lines.chunks_exact_mut(WIDE * WIDE)) {
                    transpose(&rows[at..], self.width, block, WIDE);
                }
                self.along_rows.forward(lines, room, tiles);
            },
        );
    }

    /// Transforms columns of the plane whose first rows of tiles are `filled`, others being zero, lets `multiply` change them, and
    /// transforms them back to the first rows of tiles that are `kept`.
    fn transform_columns(
        &self,
        tiles: &mut [f32],
        (filled, kept): (usize, usize),
        multiply: &(impl Fn(usize, &mut [f32]) + Sync),
    ) {
        let mut by_columns: Vec<Vec<&mut [f32; TILE]>> = Vec::new();
        by_columns.resize_with(self.tiles_of_rows(), Vec::new);
        for tiles in tiles.chunks_exact_mut(self.floats_of_tiles()) {
            by_columns.iter_mut().zip(tiles.as_chunks_mut().0).for_each(|(column, tile)| column.push(tile));
        }
        by_columns.par_iter_mut().enumerate().for_each_init(
            || self.lend_scratch(),
            |scratch, (column, tiles)| {
                let [lines, room] = scratch.lines.each_mut().map(|lines| &mut lines[..self.height * COMPLEX]);
                for (tile, rows) in tiles[..filled].iter().zip(lines.chunks_exact_mut(TILE)) {
                    place_rows(&tile[..], rows);
                }
                lines[filled * TILE..].fill(0.0);
                let [lines, room] = self.along_columns.transform(Direction::Forward, lines, room);
                multiply(column, lines);
                let [lines, _] = self.along_columns.transform(Direction::Inverse, lines, room);
                for (tile, rows) in tiles[..kept].iter_mut().zip(lines.chunks_exact(TILE)) {
                    tile.copy_from_slice(rows);
                }
            },
        );
    }

    /// Transforms rows of tiles, which hold columns side by side, back.
    fn transform_rows_back(&self, tiles: &[f32], (out, width): (&mut [f32], usize), keep: impl Keep) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "samples of images are below 2⁵³")]
        let scale = narrow(1.0 / (self.height * self.width) as f64);
        let tasks = out.par_chunks_mut(WIDE * width).zip(tiles.par_chunks_exact(self.floats_of_tiles()));
        let sums = tasks.enumerate().map_init(
            || self.lend_scratch(),
            |scratch, (group, (out, tiles))| {
                let Scratch { rows, lines: [spectra, room] } = &mut **scratch;
                for (tile, spectra) in tiles.chunks_exact(TILE).zip(spectra.chunks_exact_mut(TILE)) {
                    for part in [0, WIDE] {
                        transpose(&tile[part..], COMPLEX, &mut spectra[part..], COMPLEX);
                    }
                }
                let lines = self.along_rows.inverse(scale, spectra, room);
                for (at, block) in (0..width).step_by(WIDE).zip(lines.chunks_exact(WIDE * WIDE)) {
                    transpose(block, WIDE, &mut rows[at..], self.width);
                }
                let rows = rows.chunks_exact(self.width).map(|row| &row[..width]);
                let kept = rows_of(group).zip(rows).zip(out.chunks_mut(width));
                kept.map(|((row, samples), out)| keep(row, samples, out)).sum::<f64>()
            },
        );
        sums.collect::<Vec<f64>>().into_iter().sum()
    }

    /// Tiles that a row of them has.
    fn tiles_of_rows(&self) -> usize {
        self.floats_of_tiles() / TILE
    }

    fn floats_of_tiles(&self) -> usize {
        self.along_rows.floats_of_tiles()
    }

    /// Lends so many rows of tiles at least; stale contents are overwritten before they are read.
    fn lend_tiles(&self, rows: usize) -> Loan<'_, Vec<f32>> {
        let (mut tiles, len) = (self.tiles.lend(Vec::new), rows * self.floats_of_tiles());
        if tiles.len() < len {
            // Nothing that is to be overwritten is copied, and what is too small goes before the new comes.
            *tiles = Vec::new();
            *tiles = vec![0.0; len];
        }
        tiles
    }

    fn lend_scratch(&self) -> Loan<'_, Scratch> {
        self.scratches.lend(|| {
            let places = self.height.max(self.tiles_of_rows() * WIDE);
            Scratch { rows: vec![0.0; WIDE * self.width], lines: [0, 1].map(|_| vec![0.0; places * COMPLEX]) }
        })
    }
}

/// The rows of a group.
fn rows_of(group: usize) -> Range<usize> {
    group * WIDE..(group + 1) * WIDE
}

fn is_zero(samples: &[f32]) -> bool {
    // In blocks, each of which is compared at once.
    samples.chunks(WIDE).all(|block| block.iter().fold(true, |zero, sample| zero & (*sample == 0.0)))
}

/// Turns a tile of rows side by side, `[part][kx][row]`, to rows of columns side by side, `[row][part][kx]`.
fn place_rows(tile: &[f32], rows: &mut [f32]) {
    for part in 0..2 {
        transpose(&tile[part * TILE / 2..], WIDE, &mut rows[part * WIDE..], COMPLEX);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}
