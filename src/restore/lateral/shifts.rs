//! How far a colour lies from green in blocks of a frame.

use ndarray::parallel::prelude::*;
use ndarray::{ArrayView2, s};

use super::field::{Field, Shift};
use crate::restore::symmetric::{self, apply};

/// Side of a block.
const BLOCK_PX: usize = 32;

/// Pixels around a block that are looked at: as far as a colour may lie from green, smoothing and slopes reach.
const MARGIN_PX: usize = 9;
const WINDOW_PX: usize = BLOCK_PX + 2 * MARGIN_PX;

/// How far a colour may lie from green.
const MOST_PX: f64 = 3.5;

/// Blocks that are looked at, spread over the frame: twice as many tell it to 0.7 times the error, which is small.
const MOST_BLOCKS: usize = 200;

/// Blocks that have to tell something.
const LEAST_BLOCKS: usize = 12;

/// Pixels from a saturated one that are left out, and the share of a block's pixels that is needed.
const SATURATED_PX: usize = 2;
const LEAST_SHARE: f64 = 0.5;

/// Steps towards the field: by how many passes of smoothing, at most how many, and up to which change of a distance in pixels.
const STEPS: [(usize, usize, f64); 2] = [(2, 4, 0.25), (1, 3, 0.03)];

/// Standard deviations by which the colour has to change with green in a block for it to tell something.
const ALIKE: f64 = 4.0;

/// The part of the colour's detail in a block that green has to explain: patterns of other colours lie elsewhere without a lens.
const LEAST_EXPLAINED: f64 = 0.5;

/// The share of blocks in which green has to explain more of the colour where it is moved, of those where it is moved by so many pixels:
/// of noise about a half are such.
const LEAST_BETTER: f64 = 0.75;
const LEAST_MOVE_PX: f64 = 0.3;

/// How many times less smoothed pixels tell than independent ones.
const SMOOTHED: f64 = 9.0;

/// What no block tells better, in pixels.
const LEAST_DEVIATION_PX: f64 = 0.05;

/// Terms of a colour in a block: a constant, green, and its slopes by rows and columns.
const TERMS: usize = 4;

/// One channel: its deconvolved plane, the captured one, and what is saturated from.
pub(super) type Plane<'a> = (ArrayView2<'a, f32>, ArrayView2<'a, f32>, f32);

/// Green and another colour of a frame.
pub(super) struct Pair<'a> {
    pub(super) green: Plane<'a>,
    pub(super) colour: Plane<'a>,
}

impl Pair<'_> {
    /// The field of distances between them; none where too few blocks tell of it, or it is further than is looked for.
    pub(super) fn field(&self) -> Option<Field> {
        let (height, width) = self.green.0.dim();
        let corners = corners([height, width]);
        let mut field = Field::none([height, width]);
        for (passes, most, least_change) in STEPS {
            for _ in 0..most {
                let shifts: Vec<Shift> =
                    corners.par_iter().filter_map(|corner| self.shift(*corner, &field, passes)).collect();
                if shifts.len() < LEAST_BLOCKS {
                    return None;
                }
                let moved = field.moved(&shifts)?;
                let change = shifts.iter().map(|shift| {
                    let [from, to] = [&field, &moved].map(|field| field.at(shift.at));
                    (to[0] - from[0]).hypot(to[1] - from[1])
                });
                let change = change.fold(0.0, f64::max);
                field = moved;
                if field.furthest()[0] > MOST_PX {
                    return None;
                }
                if change < least_change {
                    break;
                }
            }
        }
        self.is_better_with(&field, &corners).then_some(field)
    }

    /// Whether green explains more of the colour in most blocks where it is moved by a field.
    fn is_better_with(&self, field: &Field, corners: &[[usize; 2]]) -> bool {
        let gains = corners.par_iter().filter_map(|corner| {
            let by = field.at(middle_of(*corner)).map(|by| by.clamp(-MOST_PX, MOST_PX));
            if by[0].hypot(by[1]) < LEAST_MOVE_PX {
                return None;
            }
            Some(self.unexplained(*corner, by)? < self.unexplained(*corner, [0.0; 2])?)
        });
        let gains: Vec<bool> = gains.collect();
        let better = gains.iter().filter(|is_better| **is_better).count();
        better as f64 >= LEAST_BETTER * gains.len() as f64
    }

    /// The squares of what a multiple of green, moved by a shift, and a constant leave of the colour in a block.
    fn unexplained(&self, corner: [usize; 2], by: [f64; 2]) -> Option<f64> {
        let known = self.known(corner);
        let [green, colour] = self.smoothed(corner, 1);
        let moved = Moved::of(&green, by);
        let mut sums = [0.0; 6];
        for (i, _) in known.iter().enumerate().filter(|(_, known)| **known) {
            let (y, x) = (i / BLOCK_PX + MARGIN_PX, i % BLOCK_PX + MARGIN_PX);
            let ([_, g, ..], c) = (moved.terms(y, x), f64::from(colour[y * WINDOW_PX + x]));
            sums.iter_mut().zip([1.0, g, c, g * g, g * c, c * c]).for_each(|(sum, value)| *sum += value);
        }
        let [n, g, c, gg, gc, cc] = sums;
        let [of_green, shared, of_colour] = [gg - g * g / n, gc - g * c / n, cc - c * c / n];
        (n > 0.0 && of_green > 0.0).then(|| of_colour - shared * shared / of_green)
    }

    /// What the block of this first pixel tells.
    ///
    /// # Equation
    /// `c(x) = b + a·g(x + u + s) ≈ b + a·g(x + u) + a·sᵀ∇g(x + u)` by least squares, s the shift beside the field u (Lucas and Kanade,
    /// IJCAI 1981), both colours smoothed.
    fn shift(&self, corner: [usize; 2], field: &Field, passes: usize) -> Option<Shift> {
        let middle = middle_of(corner);
        let known = self.known(corner);
        let count = known.iter().filter(|known| **known).count();
        if (count as f64) < LEAST_SHARE * (BLOCK_PX * BLOCK_PX) as f64 {
            return None;
        }
        let [green, colour] = self.smoothed(corner, passes);
        let moved = Moved::of(&green, field.at(middle).map(|by| by.clamp(-MOST_PX, MOST_PX)));
        let (mut normal, mut alike, mut power) = ([[0.0; TERMS]; TERMS], [0.0; TERMS], 0.0);
        for (i, _) in known.iter().enumerate().filter(|(_, known)| **known) {
            let (y, x) = (i / BLOCK_PX + MARGIN_PX, i % BLOCK_PX + MARGIN_PX);
            let terms = moved.terms(y, x);
            let value = f64::from(colour[y * WINDOW_PX + x]);
            for (row, (alike, a)) in normal.iter_mut().zip(alike.iter_mut().zip(&terms)) {
                *alike += a * value;
                row.iter_mut().zip(&terms).for_each(|(sum, b)| *sum += a * b);
            }
            power += value * value;
        }
        let inverse = symmetric::inverse(&normal)?;
        let found = apply(&inverse, &alike);
        let explained: f64 = found.iter().zip(alike).map(|(a, b)| a * b).sum();
        // The first term is a constant.
        let detail = power - alike[0].powi(2) / count as f64;
        if power - explained > (1.0 - LEAST_EXPLAINED) * detail {
            return None;
        }
        let variance = SMOOTHED * (power - explained).max(1e-12 * power) / count as f64;
        let gain = found[1];
        if gain.abs() < ALIKE * (variance * inverse[1][1]).sqrt() {
            return None;
        }
        let of_shift = |i: usize, j: usize| variance * inverse[2 + i][2 + j] / gain.powi(2);
        let least = LEAST_DEVIATION_PX.powi(2);
        let covariance = [[of_shift(0, 0) + least, of_shift(0, 1)], [of_shift(1, 0), of_shift(1, 1) + least]];
        let information = symmetric::inverse(&covariance)?;
        Some(Shift { at: middle, by: [found[2] / gain, found[3] / gain], information })
    }

    /// The windows of both colours around a block.
    fn smoothed(&self, corner: [usize; 2], passes: usize) -> [Vec<f32>; 2] {
        [&self.green, &self.colour].map(|(plane, ..)| smoothed(window(*plane, corner), passes))
    }

    /// The pixels of a block that are far from saturated ones, row by row.
    fn known(&self, corner: [usize; 2]) -> Vec<bool> {
        let mut known = vec![true; BLOCK_PX * BLOCK_PX];
        for (_, capture, from) in [&self.green, &self.colour] {
            let first = corner.map(|first| first - SATURATED_PX);
            let side = BLOCK_PX + 2 * SATURATED_PX;
            let around = capture.slice(s![first[0]..first[0] + side, first[1]..first[1] + side]);
            for ((y, x), _) in around.indexed_iter().filter(|(_, value)| **value >= *from) {
                let [rows, columns] =
                    [y, x].map(|at| at.saturating_sub(2 * SATURATED_PX)..(at + 1).min(BLOCK_PX));
                rows.for_each(|row| known[row * BLOCK_PX..][columns.clone()].fill(false));
            }
        }
        known
    }
}

/// Green as it would lie if it were moved by a shift.
struct Moved<'a> {
    green: &'a [f32],
    /// Rows and columns of whole pixels.
    whole: [isize; 2],
    /// The shares of four pixels around a place.
    shares: [[f32; 2]; 2],
}

impl<'a> Moved<'a> {
    fn of(green: &'a [f32], by: [f64; 2]) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "a few pixels")]
        let whole = by.map(|by| by.floor() as isize);
        #[expect(clippy::cast_possible_truncation, reason = "a share")]
        let shares = by.map(|by| [(1.0 - (by - by.floor())) as f32, (by - by.floor()) as f32]);
        Self { green, whole, shares }
    }

    /// A constant, green at a pixel, and its slopes there.
    fn terms(&self, y: usize, x: usize) -> [f64; TERMS] {
        let at = |down: isize, along: isize| {
            let row = y.saturating_add_signed(self.whole[0] + down);
            let column = x.saturating_add_signed(self.whole[1] + along);
            let first = row * WINDOW_PX + column;
            let [above, below] = [first, first + WINDOW_PX]
                .map(|at| self.shares[1][0] * self.green[at] + self.shares[1][1] * self.green[at + 1]);
            self.shares[0][0] * above + self.shares[0][1] * below
        };
        [
            1.0,
            f64::from(at(0, 0)),
            f64::from(at(1, 0) - at(-1, 0)) / 2.0,
            f64::from(at(0, 1) - at(0, -1)) / 2.0,
        ]
    }
}

/// The first pixels of the blocks that are looked at, which have a margin in the frame.
fn corners(size: [usize; 2]) -> Vec<[usize; 2]> {
    let [rows, columns] = size.map(|side| side.saturating_sub(2 * MARGIN_PX) / BLOCK_PX);
    let every = (rows * columns).div_ceil(MOST_BLOCKS).max(1);
    // One column further with each row, lest they lie in few columns.
    let is_taken = |row: usize, column: usize| (row * columns + column + row).is_multiple_of(every);
    let blocks = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
    blocks
        .filter(|(row, column)| is_taken(*row, *column))
        .map(|(row, column)| [row, column].map(|block| MARGIN_PX + block * BLOCK_PX))
        .collect()
}

fn middle_of(corner: [usize; 2]) -> [f64; 2] {
    corner.map(|first| first as f64 + (BLOCK_PX as f64 - 1.0) / 2.0)
}

fn window(plane: ArrayView2<'_, f32>, [top, left]: [usize; 2]) -> Vec<f32> {
    let (top, left) = (top - MARGIN_PX, left - MARGIN_PX);
    plane.slice(s![top..top + WINDOW_PX, left..left + WINDOW_PX]).iter().copied().collect()
}

/// Smooths a window by so many passes of binomials of variance 1; its outermost pixels are left as they are.
fn smoothed(mut window: Vec<f32>, passes: usize) -> Vec<f32> {
    const REACH: usize = 2;
    let mut other = window.clone();
    for _ in 0..passes {
        for step in [1, WINDOW_PX] {
            for y in REACH..WINDOW_PX - REACH {
                for x in REACH..WINDOW_PX - REACH {
                    let at = y * WINDOW_PX + x;
                    let [near, far] = [step, 2 * step].map(|step| window[at - step] + window[at + step]);
                    other[at] = (6.0 * window[at] + 4.0 * near + far) / 16.0;
                }
            }
            std::mem::swap(&mut window, &mut other);
        }
    }
    window
}
