//! The transform of real planes that are mostly padding: only rows that hold something are transformed on
//! the way in, only rows that are kept on the way out.
//!
//! # Method
//! 1. Two real rows are transformed as the real and imaginary part of one complex row.
//! 2. The half spectrum of the rows is kept column by column, `[kx][ky]`, so that the transform of a column
//!    and the product of two spectra run over contiguous memory.
//! 3. Between rows and columns stands an intermediate of tiles, 8 × 8: 8 complex numbers are a cache line or two, so both passes
//!    read and write whole lines. A column pass reads tiles by columns and leaves the same ones by rows, so that there is one
//!    intermediate, not two.
//!
//! Both precisions share this code; [`Convolver`](super::Convolver) says which one serves.
//!
//! # Normalization
//! [`Transform::forward`] is unscaled; [`Transform::inverse`] divides by the number of samples.

use std::ops::Range;
use std::sync::{Arc, PoisonError};

use rayon::prelude::*;
use rustfft::Fft;
use rustfft::num_complex::Complex;

use super::pool::{Loan, Pool};
use super::real::Real;

/// Rows and columns of the tiles between the row and the column pass.
const BLOCK: usize = 8;

/// Samples of a tile: by columns, `[kx][row]`, before the column pass of an inverse transform, and by rows after it.
const TILE: usize = BLOCK * BLOCK;

/// Plans for planes of one size, and buffers that are used again.
pub(super) struct Transform<T: Real> {
    height: usize,
    width: usize,
    along_rows: Plans<T>,
    along_columns: Plans<T>,
    /// What stands between the row and the column pass, one at a time for each plane in work: `[row / 8][kx / 8]` tiles.
    tiles: Pool<Vec<Complex<T>>>,
    /// What a thread works in.
    scratches: Pool<Scratch<T>>,
    spectra: Pool<Vec<Complex<T>>>,
}

struct Plans<T: Real> {
    forward: Arc<dyn Fft<T>>,
    inverse: Arc<dyn Fft<T>>,
}

/// What takes the samples of a row to its place, as [`Transform::filter`] has it.
pub(super) trait Keep: Fn(usize, &[f32], &mut [f32]) -> f64 + Sync {}

impl<F: Fn(usize, &[f32], &mut [f32]) -> f64 + Sync> Keep for F {}

/// The part of the transformed plane that is kept by [`Transform::inverse`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) top: usize,
    pub(super) left: usize,
    pub(super) height: usize,
    pub(super) width: usize,
}

impl<T: Real> Plans<T> {
    fn new(length: usize) -> Self {
        // A panic while planning leaves the planner usable: it only caches finished plans.
        let mut planner = T::planner().lock().unwrap_or_else(PoisonError::into_inner);
        Self { forward: planner.plan_fft_forward(length), inverse: planner.plan_fft_inverse(length) }
    }

    fn scratch_len(&self) -> usize {
        self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len())
    }
}

impl<T: Real> Transform<T> {
    pub(super) fn new(height: usize, width: usize) -> Self {
        Self {
            height,
            width,
            along_rows: Plans::new(width),
            along_columns: Plans::new(height),
            tiles: Pool::new(),
            scratches: Pool::new(),
            spectra: Pool::new(),
        }
    }

    /// Number of rows, the length of a spectrum's column.
    pub(super) fn height(&self) -> usize {
        self.height
    }

    /// Number of samples of the half spectrum, `[width / 2 + 1][height]`.
    pub(super) fn spectrum_len(&self) -> usize {
        (self.width / 2 + 1) * self.height
    }

    /// Transforms a plane whose rows outside of `rows` are zero.
    ///
    /// `fill(row, samples)` writes the samples of a row, which come as zeros. The result is `[kx][ky]`.
    pub(super) fn forward(
        &self,
        rows: &[Range<usize>],
        fill: impl Fn(usize, &mut [T]) + Sync,
    ) -> Vec<Complex<T>> {
        let groups: Vec<Range<usize>> = rows.iter().flat_map(split_in_blocks).collect();
        let mut tiles = self.lend_tiles(groups.len());
        self.transform_groups(&groups, &fill, &mut tiles);
        let mut spectrum = self.spectra.take().unwrap_or_default();
        spectrum.resize(self.spectrum_len(), Complex::default());
        spectrum.par_chunks_mut(self.height).enumerate().for_each_init(
            || self.lend_scratch(),
            |scratch, (kx, column)| {
                let mut next = 0;
                for (tiles, group) in tiles.chunks(self.tiles_len()).zip(&groups) {
                    column[next..group.start].fill(Complex::default());
                    let samples = &tiles[kx * BLOCK..][..group.len()];
                    column[group.clone()].copy_from_slice(samples);
                    next = group.end;
                }
                column[next..].fill(Complex::default());
                self.along_columns.forward.process_with_scratch(column, &mut scratch.fft);
            },
        );
        spectrum
    }

    /// Transforms a plane of which only the first `rows` rows are not zero, lets `multiply(kx, column)` change each column of its
    /// spectrum, transforms it back and keeps one window: [`forward`](Self::forward) and [`inverse`](Self::inverse), without a
    /// spectrum in memory.
    ///
    /// `keep(row, samples, out)` takes each row of the window to that of `out`; the sum of what it returns is returned, added in
    /// the order of the rows.
    pub(super) fn filter(
        &self,
        (rows, fill): (usize, impl Fn(usize, &mut [T]) + Sync),
        multiply: impl Fn(usize, &mut [Complex<T>]) + Sync,
        window: Window,
        (out, keep): (&mut [f32], impl Keep),
    ) -> f64 {
        let groups: Vec<Range<usize>> = split_in_blocks(&(0..rows)).collect();
        let mut tiles = self.lend_tiles(groups.len().max(window.height.div_ceil(BLOCK)));
        self.transform_groups(&groups, &fill, &mut tiles);
        let change = |kx: usize, column: &mut [Complex<T>], scratch: &mut [Complex<T>]| {
            self.along_columns.forward.process_with_scratch(column, scratch);
            multiply(kx, column);
        };
        self.inverse_columns(&mut tiles, (rows, change), window);
        self.inverse_rows(&tiles, window, (out, keep))
    }

    /// Takes a spectrum that is no longer needed, to be overwritten by the next one.
    pub(super) fn reuse(&self, spectrum: Vec<Complex<T>>) {
        self.spectra.put(spectrum);
    }

    /// Transforms groups of rows to rows of tiles.
    fn transform_groups(
        &self,
        groups: &[Range<usize>],
        fill: &(impl Fn(usize, &mut [T]) + Sync),
        tiles: &mut [Complex<T>],
    ) {
        tiles.par_chunks_mut(self.tiles_len()).zip(groups).for_each_init(
            || self.lend_scratch(),
            |scratch, (tiles, group)| self.transform_rows(group.clone(), fill, scratch, tiles),
        );
    }

    /// Transforms up to [`BLOCK`] rows to tiles `[kx][row]`.
    fn transform_rows(
        &self,
        group: Range<usize>,
        fill: &impl Fn(usize, &mut [T]),
        scratch: &mut Scratch<T>,
        tiles: &mut [Complex<T>],
    ) {
        let count = group.len();
        for first in (0..count).step_by(2) {
            let second = (first + 1 < count).then_some(first + 1);
            for (samples, row) in scratch.real.iter_mut().zip([Some(first), second]) {
                samples.fill(T::default());
                if let Some(row) = row {
                    fill(group.start + row, samples);
                }
            }
            let [a, b] = &scratch.real;
            let samples = &mut scratch.pairs[..self.width];
            for ((z, &a), &b) in samples.iter_mut().zip(a).zip(b) {
                *z = Complex::new(a, b);
            }
            self.along_rows.forward.process_with_scratch(samples, &mut scratch.fft);
            separate_pair(samples, tiles, first, second);
        }
    }

    /// Transforms a half spectrum back and keeps one window of the plane.
    ///
    /// `product(kx, column)` writes a column of the spectrum, `[ky]`.
    pub(super) fn inverse(
        &self,
        product: impl Fn(usize, &mut [Complex<T>]) + Sync,
        window: Window,
        out: &mut [f32],
    ) {
        assert_eq!(out.len(), window.height * window.width, "the output has the window's size");
        let mut tiles = self.lend_tiles(window.height.div_ceil(BLOCK));
        self.inverse_columns(&mut tiles, (0, |kx, column, _| product(kx, column)), window);
        self.inverse_rows(&tiles, window, (out, copy_row));
    }

    /// Transforms columns back, of each what `change(kx, column, scratch)` makes of it: it begins with what the tiles hold of the
    /// first `rows` rows, and zeros. Leaves the rows of the window by rows.
    fn inverse_columns(
        &self,
        tiles: &mut [Complex<T>],
        (rows, change): (usize, impl Fn(usize, &mut [Complex<T>], &mut [Complex<T>]) + Sync),
        window: Window,
    ) {
        let columns = self.width / 2 + 1;
        let mut by_columns: Vec<Vec<&mut [Complex<T>; TILE]>> = Vec::new();
        by_columns.resize_with(columns.div_ceil(BLOCK), Vec::new);
        for tiles in tiles.chunks_exact_mut(self.tiles_len()) {
            by_columns.iter_mut().zip(tiles.as_chunks_mut().0).for_each(|(column, tile)| column.push(tile));
        }
        by_columns.par_iter_mut().enumerate().for_each_init(
            || self.lend_scratch(),
            |scratch, (index, tiles)| {
                let scratch = &mut **scratch;
                gather(tiles, rows, &mut scratch.columns, self.height);
                let kxs = index * BLOCK..columns.min((index + 1) * BLOCK);
                for (column, kx) in scratch.columns.chunks_mut(self.height).zip(kxs) {
                    change(kx, column, &mut scratch.fft);
                    self.along_columns.inverse.process_with_scratch(column, &mut scratch.fft);
                }
                let rows = window.top..window.top + window.height;
                transpose(&scratch.columns, self.height, rows, tiles);
            },
        );
    }

    /// Transforms the rows of tiles by rows back.
    fn inverse_rows(
        &self,
        tiles: &[Complex<T>],
        window: Window,
        (out, keep): (&mut [f32], impl Keep),
    ) -> f64 {
        let scale = T::one() / T::from_usize(self.height * self.width).expect("a float holds any count");
        let tasks = out.par_chunks_mut(BLOCK * window.width).zip(tiles.par_chunks(self.tiles_len()));
        let sums = tasks.enumerate().map_init(
            || self.lend_scratch(),
            |scratch, (index, (out, tiles))| {
                let (scratch, stride) = (&mut **scratch, self.width + 1);
                join_pairs(tiles, out.len() / window.width, &mut scratch.pairs, stride);
                let pairs = scratch.pairs.chunks_exact_mut(stride);
                let mut sum = 0.0;
                for ((pair, out), row) in
                    pairs.zip(out.chunks_mut(2 * window.width)).zip((index * BLOCK..).step_by(2))
                {
                    let samples = &mut pair[..self.width];
                    self.along_rows.inverse.process_with_scratch(samples, &mut scratch.fft);
                    let samples = &samples[window.left..][..window.width];
                    let [real, imaginary] = &mut scratch.kept;
                    real.clear();
                    real.extend(samples.iter().map(|z| narrow(z.re * scale)));
                    imaginary.clear();
                    imaginary.extend(samples.iter().map(|z| narrow(z.im * scale)));
                    for (index, (out, kept)) in
                        out.chunks_mut(window.width).zip([real, imaginary]).enumerate()
                    {
                        sum += keep(row + index, kept, out);
                    }
                }
                sum
            },
        );
        sums.collect::<Vec<f64>>().into_iter().sum()
    }

    /// Samples of a row of tiles.
    fn tiles_len(&self) -> usize {
        (self.width / 2 + 1).next_multiple_of(BLOCK) * BLOCK
    }

    /// Lends so many rows of tiles; stale contents are overwritten before they are read.
    fn lend_tiles(&self, rows: usize) -> Loan<'_, Vec<Complex<T>>> {
        let (mut tiles, len) = (self.tiles.lend(Vec::new), rows * self.tiles_len());
        if tiles.capacity() < len {
            // Nothing that is to be overwritten is copied.
            *tiles = Vec::with_capacity(len);
        }
        tiles.resize(len, Complex::default());
        tiles
    }

    fn lend_scratch(&self) -> Loan<'_, Scratch<T>> {
        self.scratches.lend(|| Scratch::new(self))
    }
}

/// What one thread works in.
struct Scratch<T> {
    /// Two rows.
    real: [Vec<T>; 2],
    /// The rows of a block, each two as one, with the places that [`join_pairs`] wants.
    pairs: Vec<Complex<T>>,
    /// The columns of a block.
    columns: Vec<Complex<T>>,
    fft: Vec<Complex<T>>,
    /// Two rows of a result.
    kept: [Vec<f32>; 2],
}

impl<T: Real> Scratch<T> {
    fn new(transform: &Transform<T>) -> Self {
        let fft_len = transform.along_rows.scratch_len().max(transform.along_columns.scratch_len());
        Self {
            real: [vec![T::default(); transform.width], vec![T::default(); transform.width]],
            pairs: vec![Complex::default(); BLOCK / 2 * (transform.width + 1)],
            columns: vec![Complex::default(); BLOCK * transform.height],
            fft: vec![Complex::default(); fft_len],
            kept: Default::default(),
        }
    }
}

fn split_in_blocks(rows: &Range<usize>) -> impl Iterator<Item = Range<usize>> + use<> {
    let end = rows.end;
    rows.clone().step_by(BLOCK).map(move |start| start..end.min(start + BLOCK))
}

/// Keeps the samples of a row as they are, and adds nothing.
pub fn copy_row(_: usize, samples: &[f32], out: &mut [f32]) -> f64 {
    out.copy_from_slice(samples);
    0.0
}

fn narrow<T: Real>(value: T) -> f32 {
    value.to_f32().expect("a float is rounded")
}

/// Reads the columns of tiles by columns, which hold so many rows; the others are zeros. Columns stand `height` apart.
fn gather<T: Real>(
    tiles: &[&mut [Complex<T>; TILE]],
    rows: usize,
    columns: &mut [Complex<T>],
    height: usize,
) {
    for (tile, first) in tiles.iter().zip((0..rows).step_by(BLOCK)) {
        let count = BLOCK.min(rows - first);
        for (column, samples) in columns.chunks_exact_mut(height).zip(tile.as_chunks::<BLOCK>().0) {
            column[first..first + count].copy_from_slice(&samples[..count]);
        }
    }
    columns.chunks_exact_mut(height).for_each(|column| column[rows..].fill(Complex::default()));
}

/// Separates the spectra of two real rows: with Z = F(a + ib), `F(a) = (Z[k] + Z̄[−k]) / 2` and
/// `F(b) = (Z[k] − Z̄[−k]) / 2i`.
fn separate_pair<T: Real>(z: &[Complex<T>], tiles: &mut [Complex<T>], first: usize, second: Option<usize>) {
    let n = z.len();
    for (k, samples) in tiles.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate().take(n / 2 + 1) {
        let (p, q) = (z[k], z[if k == 0 { 0 } else { n - k }].conj());
        samples[first] = (p + q) * T::from(0.5);
        if let Some(second) = second {
            let difference = (p - q) * T::from(0.5);
            samples[second] = Complex::new(difference.im, -difference.re);
        }
    }
}

/// Writes some rows of columns, which stand `height` apart, to tiles by rows.
fn transpose<T: Real>(
    columns: &[Complex<T>],
    height: usize,
    rows: Range<usize>,
    tiles: &mut [&mut [Complex<T>; TILE]],
) {
    let lanes: [&[Complex<T>]; BLOCK] = std::array::from_fn(|lane| &columns[lane * height..][rows.clone()]);
    for (tile, first) in tiles.iter_mut().zip((0..rows.len()).step_by(BLOCK)) {
        for (samples, y) in tile.as_chunks_mut::<BLOCK>().0.iter_mut().zip(first..rows.len()) {
            for (sample, lane) in samples.iter_mut().zip(lanes) {
                *sample = lane[y];
            }
        }
    }
}

/// Joins the half spectra A and B of each two of the first `rows` rows of tiles by rows to that of the complex row a + ib:
/// `Z[k] = A + iB` and `Z[−k] = conj(A − iB)`. Where the last row is alone, B repeats A.
///
/// The spectra stand `stride` apart in `zs`, one place more than samples, so that Z[−0] has somewhere to go.
fn join_pairs<T: Real>(tiles: &[Complex<T>], rows: usize, zs: &mut [Complex<T>], stride: usize) {
    let n = stride - 1;
    let columns = n / 2 + 1;
    for (tile, start) in tiles.as_chunks::<TILE>().0.iter().zip((0..columns).step_by(BLOCK)) {
        let count = BLOCK.min(columns - start);
        for (z, row) in zs.chunks_exact_mut(stride).zip((0..rows).step_by(2)) {
            let a = &tile[row * BLOCK..][..count];
            let b = &tile[(row + 1).min(rows - 1) * BLOCK..][..count];
            for ((z, a), b) in z[start..].iter_mut().zip(a).zip(b) {
                *z = Complex::new(a.re - b.im, a.im + b.re);
            }
            let mirrored = z[..=n - start].iter_mut().rev();
            for ((z, a), b) in mirrored.zip(a).zip(b) {
                *z = Complex::new(a.re + b.im, b.re - a.im);
            }
        }
    }
}
