//! The transform of real planes that are mostly padding: only rows that hold something are transformed on
//! the way in, only rows that are kept on the way out.
//!
//! # Method
//! 1. Two real rows are transformed as the real and imaginary part of one complex row.
//! 2. The half spectrum of the rows is kept column by column, `[kx][ky]`, so that the transform of a column
//!    and the product of two spectra run over contiguous memory.
//! 3. Between rows and columns stands an intermediate of blocks, 16 wide: 16 complex numbers are two cache
//!    lines, so both passes read and write whole lines, and every block is written by one thread only.
//!
//! # Normalization
//! [`Transform::forward`] is unscaled; [`Transform::inverse`] divides by the number of samples.

use std::ops::Range;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use rayon::prelude::*;
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};

/// Width of the blocks between the row and the column pass.
const BLOCK: usize = 16;

/// Plans are made once for each length in the whole program.
static PLANNER: LazyLock<Mutex<FftPlanner<f32>>> = LazyLock::new(|| Mutex::new(FftPlanner::new()));

/// Plans for planes of one size, and buffers that are used again.
pub(super) struct Transform {
    height: usize,
    width: usize,
    along_rows: Plans,
    along_columns: Plans,
    buffers: Mutex<Vec<Vec<Complex32>>>,
}

struct Plans {
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

/// The part of the transformed plane that is kept by [`Transform::inverse`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) top: usize,
    pub(super) left: usize,
    pub(super) height: usize,
    pub(super) width: usize,
}

impl Plans {
    fn new(length: usize) -> Self {
        // A panic while planning leaves the planner usable: it only caches finished plans.
        let mut planner = PLANNER.lock().unwrap_or_else(PoisonError::into_inner);
        Self { forward: planner.plan_fft_forward(length), inverse: planner.plan_fft_inverse(length) }
    }

    fn scratch_len(&self) -> usize {
        self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len())
    }
}

impl Transform {
    pub(super) fn new(height: usize, width: usize) -> Self {
        Self {
            height,
            width,
            along_rows: Plans::new(width),
            along_columns: Plans::new(height),
            buffers: Mutex::default(),
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
        fill: impl Fn(usize, &mut [f32]) + Sync,
    ) -> Vec<Complex32> {
        let groups: Vec<Range<usize>> = rows.iter().flat_map(split_in_blocks).collect();
        let columns = self.width / 2 + 1;
        let mut blocks = self.take_buffer(groups.len() * columns * BLOCK);
        blocks.par_chunks_mut(columns * BLOCK).zip(&groups).for_each_init(
            || RowScratch::new(&self.along_rows, self.width),
            |scratch, (block, group)| self.transform_rows(group.clone(), &fill, scratch, block),
        );
        let mut spectrum = vec![Complex32::default(); self.spectrum_len()];
        let scratch_len = self.along_columns.scratch_len();
        spectrum.par_chunks_mut(self.height).enumerate().for_each_init(
            || vec![Complex32::default(); scratch_len],
            |scratch, (kx, column)| {
                for (block, group) in blocks.chunks(columns * BLOCK).zip(&groups) {
                    let samples = &block[kx * BLOCK..][..group.len()];
                    column[group.clone()].copy_from_slice(samples);
                }
                self.along_columns.forward.process_with_scratch(column, scratch);
            },
        );
        self.return_buffer(blocks);
        spectrum
    }

    /// Transforms up to 16 rows to a block `[kx][row]`.
    fn transform_rows(
        &self,
        group: Range<usize>,
        fill: &impl Fn(usize, &mut [f32]),
        scratch: &mut RowScratch,
        block: &mut [Complex32],
    ) {
        let count = group.len();
        for first in (0..count).step_by(2) {
            let second = (first + 1 < count).then_some(first + 1);
            for (samples, row) in scratch.real.iter_mut().zip([Some(first), second]) {
                samples.fill(0.0);
                if let Some(row) = row {
                    fill(group.start + row, samples);
                }
            }
            let [a, b] = &scratch.real;
            for ((z, &a), &b) in scratch.complex.iter_mut().zip(a).zip(b) {
                *z = Complex32::new(a, b);
            }
            self.along_rows.forward.process_with_scratch(&mut scratch.complex, &mut scratch.fft);
            separate_pair(&scratch.complex, block, first, second);
        }
    }

    /// Transforms a half spectrum back and keeps one window of the plane.
    ///
    /// `product(kx, column)` writes the column of the spectrum, `[ky]`.
    pub(super) fn inverse(
        &self,
        product: impl Fn(usize, &mut [Complex32]) + Sync,
        window: Window,
        out: &mut [f32],
    ) {
        assert_eq!(out.len(), window.height * window.width, "the output has the window's size");
        let columns = self.width / 2 + 1;
        let block_len = window.height * BLOCK;
        let mut blocks = self.take_buffer(columns.div_ceil(BLOCK) * block_len);
        blocks.par_chunks_mut(block_len).enumerate().for_each_init(
            || ColumnScratch::new(&self.along_columns, self.height),
            |scratch, (index, block)| {
                let first = index * BLOCK;
                let group = first..columns.min(first + BLOCK);
                for (column, kx) in scratch.columns.chunks_mut(self.height).zip(group) {
                    product(kx, column);
                    self.along_columns.inverse.process_with_scratch(column, &mut scratch.fft);
                }
                transpose(&scratch.columns[window.top..], self.height, block);
            },
        );
        out.par_chunks_mut(BLOCK * window.width).enumerate().for_each_init(
            || RowScratch::new(&self.along_rows, self.width),
            |scratch, (index, rows)| {
                for (pair, rows) in rows.chunks_mut(2 * window.width).enumerate() {
                    join_pair(&blocks, block_len, index * BLOCK + 2 * pair, &mut scratch.complex);
                    self.along_rows.inverse.process_with_scratch(&mut scratch.complex, &mut scratch.fft);
                    self.keep_pair(&scratch.complex[window.left..], window.width, rows);
                }
            },
        );
        self.return_buffer(blocks);
    }

    /// Writes the real parts to the first row, the imaginary ones to the second where there is one.
    #[expect(clippy::cast_precision_loss, reason = "a plane has fewer than 2^24 · 2^24 samples")]
    fn keep_pair(&self, samples: &[Complex32], width: usize, rows: &mut [f32]) {
        let scale = 1.0 / (self.height as f32 * self.width as f32);
        let (first, second) = rows.split_at_mut(width);
        for (out, z) in first.iter_mut().zip(samples) {
            *out = z.re * scale;
        }
        for (out, z) in second.iter_mut().zip(samples) {
            *out = z.im * scale;
        }
    }

    fn take_buffer(&self, len: usize) -> Vec<Complex32> {
        let mut buffers = self.buffers.lock().unwrap_or_else(PoisonError::into_inner);
        let mut buffer = buffers.pop().unwrap_or_default();
        drop(buffers);
        // Stale contents are overwritten: the row pass fills what the column pass reads.
        buffer.resize(len, Complex32::default());
        buffer
    }

    fn return_buffer(&self, buffer: Vec<Complex32>) {
        self.buffers.lock().unwrap_or_else(PoisonError::into_inner).push(buffer);
    }
}

struct RowScratch {
    real: [Vec<f32>; 2],
    complex: Vec<Complex32>,
    fft: Vec<Complex32>,
}

impl RowScratch {
    fn new(plans: &Plans, width: usize) -> Self {
        Self {
            real: [vec![0.0; width], vec![0.0; width]],
            complex: vec![Complex32::default(); width],
            fft: vec![Complex32::default(); plans.scratch_len()],
        }
    }
}

struct ColumnScratch {
    columns: Vec<Complex32>,
    fft: Vec<Complex32>,
}

impl ColumnScratch {
    fn new(plans: &Plans, height: usize) -> Self {
        Self {
            columns: vec![Complex32::default(); BLOCK * height],
            fft: vec![Complex32::default(); plans.scratch_len()],
        }
    }
}

fn split_in_blocks(rows: &Range<usize>) -> impl Iterator<Item = Range<usize>> + use<> {
    let end = rows.end;
    rows.clone().step_by(BLOCK).map(move |start| start..end.min(start + BLOCK))
}

/// Separates the spectra of two real rows: with Z = F(a + ib), `F(a) = (Z[k] + Z̄[−k]) / 2` and
/// `F(b) = (Z[k] − Z̄[−k]) / 2i`.
fn separate_pair(z: &[Complex32], block: &mut [Complex32], first: usize, second: Option<usize>) {
    let n = z.len();
    for (k, samples) in block.chunks_exact_mut(BLOCK).enumerate() {
        let (p, q) = (z[k], z[if k == 0 { 0 } else { n - k }].conj());
        samples[first] = (p + q) * 0.5;
        if let Some(second) = second {
            let difference = (p - q) * 0.5;
            samples[second] = Complex32::new(difference.im, -difference.re);
        }
    }
}

/// Writes the columns, `stride` apart, as rows of a block.
fn transpose(columns: &[Complex32], stride: usize, block: &mut [Complex32]) {
    let lanes: [&[Complex32]; BLOCK] = std::array::from_fn(|lane| &columns[lane * stride..]);
    for (y, samples) in block.chunks_exact_mut(BLOCK).enumerate() {
        for (sample, lane) in samples.iter_mut().zip(lanes) {
            *sample = lane[y];
        }
    }
}

/// Joins the half spectra A and B of two rows to that of the complex row a + ib: `Z[k] = A + iB` and
/// `Z[−k] = conj(A − iB)`. Beyond the last row of a block of odd height, B repeats what is there.
fn join_pair(blocks: &[Complex32], block_len: usize, row: usize, z: &mut [Complex32]) {
    let n = z.len();
    let columns = n / 2 + 1;
    for (index, block) in blocks.chunks_exact(block_len).enumerate() {
        let first = &block[row * BLOCK..][..BLOCK];
        let second = block.get((row + 1) * BLOCK..(row + 2) * BLOCK).unwrap_or(first);
        let start = index * BLOCK;
        for (k, (a, b)) in (start..columns.min(start + BLOCK)).zip(first.iter().zip(second)) {
            z[k] = Complex32::new(a.re - b.im, a.im + b.re);
            if k > 0 {
                z[n - k] = Complex32::new(a.re + b.im, b.re - a.im);
            }
        }
    }
}
