//! Small matrix products held in registers: the micro-kernel under every operation.
//!
//! One call multiplies `ROWS` rows of A by a panel of B that is `COLUMNS` vectors wide and keeps the
//! `ROWS × COLUMNS` sums in registers over the whole depth. Each step of the depth loads `COLUMNS` vectors of
//! B and broadcasts `ROWS` floats of A for `ROWS·COLUMNS` multiply-adds ([`Simd::dot`]s: where a float's place holds two
//! numbers, a step is two deep). With the 32 registers of AVX-512
//! 12 × 2 and 6 × 4 fill 24 as sums, enough to hide the latency of 4 cycles at 2 a cycle; with the 16 of AVX2
//! and SSE, 6 × 2 fill 12.
//!
//! # Registers
//! Sums stay in registers only where every index into their array is a constant, which loops leave to the compiler's
//! choice: it changes with code elsewhere, and a loop that writes each sum to the stack takes 2.5 times as long. So tiles
//! are walked by [`unrolled`].

use super::simd::Simd;

/// Repeats an expression for `index` from 0 to a constant number, of which there are at most 4 or 12, without a loop:
/// `unrolled!(4, number, index => expression)`.
macro_rules! unrolled {
    (4, $count:expr, $index:ident => $body:expr) => {
        unrolled!(@ $count, $index => $body; 0 1 2 3)
    };
    (12, $count:expr, $index:ident => $body:expr) => {
        unrolled!(@ $count, $index => $body; 0 1 2 3 4 5 6 7 8 9 10 11)
    };
    (@ $count:expr, $index:ident => $body:expr; $($value:literal)*) => {
        $(
            if $value < $count {
                let $index: usize = $value;
                $body;
            }
        )*
    };
}
pub(crate) use unrolled;

/// Sums of one register tile.
pub(crate) type Tile<S, const ROWS: usize, const COLUMNS: usize> = [[<S as Simd>::Vector; COLUMNS]; ROWS];

/// A matrix within a slice: element (row `r`, depth `d`) lies at `at + r·row + d·step`.
#[derive(Clone, Copy)]
pub(crate) struct Operand<'a> {
    /// The floats that hold it, and maybe more.
    pub(crate) data: &'a [f32],
    /// Where its first element lies.
    pub(crate) at: usize,
    /// Distance between rows.
    pub(crate) row: usize,
    /// Distance between elements along the depth.
    pub(crate) step: usize,
}

/// Adds A·B to the tile, where A has `ROWS` rows and B's rows (one for each step of the depth) begin `b.step`
/// apart; `b.row` is not used.
///
/// # Safety
/// Both operands lie within their slices over the whole `depth`: for A up to
/// `at + (ROWS−1)·row + (depth−1)·step`, for B up to `at + (depth−1)·step + COLUMNS·LANES − 1`.
#[inline(always)]
pub(crate) unsafe fn multiply_add<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    mut tile: Tile<S, ROWS, COLUMNS>,
    depth: usize,
    a: Operand<'_>,
    b: Operand<'_>,
) -> Tile<S, ROWS, COLUMNS> {
    if depth == 0 {
        return tile;
    }
    debug_assert!(a.at + (ROWS - 1) * a.row + (depth - 1) * a.step < a.data.len(), "A out of its slice");
    debug_assert!(b.at + (depth - 1) * b.step + COLUMNS * S::LANES <= b.data.len(), "B out of its slice");
    for d in 0..depth {
        // SAFETY: the caller promises that both operands stay within their slices.
        unsafe {
            let mut b_vectors = [simd.splat(0.0); COLUMNS];
            unrolled!(4, COLUMNS, j => b_vectors[j] = simd.load(b.data, b.at + d * b.step + j * S::LANES));
            let a_column = a.data.as_ptr().add(a.at + d * a.step);
            unrolled!(12, ROWS, i => {
                let broadcast = simd.splat(*a_column.add(i * a.row));
                unrolled!(4, COLUMNS, j => tile[i][j] = simd.dot(broadcast, b_vectors[j], tile[i][j]));
            });
        }
    }
    tile
}

/// A tile of zeros.
#[inline(always)]
pub(crate) fn zero_tile<S: Simd, const ROWS: usize, const COLUMNS: usize>(simd: S) -> Tile<S, ROWS, COLUMNS> {
    [[simd.splat(0.0); COLUMNS]; ROWS]
}

/// How many vectors wide the panels are that `columns` outputs are packed in, for vectors of `lanes`.
pub(crate) fn panel_vectors(lanes: usize, columns: usize) -> usize {
    let vectors = columns.div_ceil(lanes);
    match lanes {
        16 if vectors.is_multiple_of(4) => 4,
        _ if vectors.is_multiple_of(2) => 2,
        _ => 1,
    }
}

/// Calls a function generic over the register tile with the sizes that suit the instruction set and the
/// panels: `with_register_tile!(S, vectors, function(arguments…))`.
macro_rules! with_register_tile {
    ($simd:ident, $vectors:expr, $function:ident($($argument:expr),* $(,)?)) => {
        match ($simd::LANES, $vectors) {
            (16, 4) => $function::<$simd, 6, 4>($($argument),*),
            (16, 2) => $function::<$simd, 12, 2>($($argument),*),
            (16, _) => $function::<$simd, 12, 1>($($argument),*),
            (_, 2) => $function::<$simd, 6, 2>($($argument),*),
            (_, _) => $function::<$simd, 6, 1>($($argument),*),
        }
    };
}
pub(crate) use with_register_tile;

/// As [`with_register_tile`], for sums of `outputs` columns and any number of rows that is a multiple of a
/// vector: 8 × 2 of 32 registers, 4 × 2 of 16 (rows must divide the channels).
macro_rules! with_weight_tile {
    ($simd:ident, $outputs:expr, $function:ident($($argument:expr),* $(,)?)) => {
        match ($simd::LANES, $outputs.is_multiple_of(2 * $simd::LANES)) {
            (16, true) => $function::<$simd, 8, 2>($($argument),*),
            (16, false) => $function::<$simd, 8, 1>($($argument),*),
            (_, true) => $function::<$simd, 4, 2>($($argument),*),
            (_, false) => $function::<$simd, 4, 1>($($argument),*),
        }
    };
}
pub(crate) use with_weight_tile;

/// The most rows of [`with_weight_tile`]'s tiles, a multiple of each.
pub(crate) const MOST_WEIGHT_ROWS: usize = 8;

/// Reads a register tile whose rows lie `row` apart.
///
/// # Safety
/// All its rows lie within `from`.
#[inline(always)]
pub(crate) unsafe fn load_tile<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    from: &[f32],
    at: usize,
    row: usize,
) -> Tile<S, ROWS, COLUMNS> {
    let mut tile = zero_tile::<S, ROWS, COLUMNS>(simd);
    unrolled!(12, ROWS, i => {
        // SAFETY: passed on to the caller.
        unrolled!(4, COLUMNS, j => tile[i][j] = unsafe { simd.load(from, at + i * row + j * S::LANES) });
    });
    tile
}

/// Writes a register tile to rows that lie `row` apart.
///
/// # Safety
/// All its rows lie within `to`.
#[inline(always)]
pub(crate) unsafe fn store_tile<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    tile: &Tile<S, ROWS, COLUMNS>,
    to: &mut [f32],
    at: usize,
    row: usize,
) {
    unrolled!(12, ROWS, i => {
        // SAFETY: passed on to the caller.
        unrolled!(4, COLUMNS, j => unsafe { simd.store(to, at + i * row + j * S::LANES, tile[i][j]) });
    });
}

/// The most rows of any register tile: how far products may read past the last row of A, less one.
pub(crate) const MOST_ROWS: usize = 12;
