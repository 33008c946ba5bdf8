//! Smooths planes by a bell that costs the same whatever its width, and what is made of that: local brightness, painted
//! holes.

use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, Zip};
use rayon::prelude::*;

use super::frame::row;
use super::sums::{LANES, Lanes};
use crate::kernels::fourier::transpose;
use crate::kernels::vectorised;

/// Passes of a box; three are a cubic spline, within 3 % of a Gaussian.
const PASSES: usize = 3;

/// A place of a line, of lines that are smoothed side by side: as many as a cache line holds.
pub(super) type Place = [f32; LANES];

/// Standard deviations, in pixels, of the bells that fill holes, from the finest that reaches a pixel.
const PAINTING_PX: [f32; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// The part of a bell that has to lie on known pixels: fewer tell one of them rather than a mean.
const LEAST_KNOWN: f32 = 0.05;

/// Smooths with a bell of standard deviation `sigma_px`, the plane being zero outside: a symmetric matrix.
///
/// # Equation
/// Three boxes of 2r + 1 pixels have the variance `3·((2r + 1)² − 1)/12`; r is the one that is nearest to σ.
pub(super) fn smooth(plane: &mut Array2<f32>, sigma_px: f32) {
    let radius = radius_of(sigma_px);
    smooth_rows(plane, radius, |_, _| ());
    plane.axis_chunks_iter_mut(Axis(1), LANES).into_par_iter().for_each_init(
        Lines::default,
        |lines, strip| {
            smooth_columns(lines, strip, radius);
        },
    );
}

/// Smooths a plane whose rows `fill(y, row)` writes, as [`smooth`] does, and hands it on by strips of columns: `keep(x, smoothed,
/// strip)` takes the rows of each, which begins at column x, to that of `out`. The sum of what it returns is returned. What `room`,
/// of the size of `out`, holds is overwritten.
pub(super) fn smooth_into(
    (out, room): (&mut Array2<f32>, &mut Array2<f32>),
    sigma_px: f32,
    fill: impl Fn(usize, &mut [f32]) + Sync,
    keep: impl Fn(usize, &[Place], ArrayViewMut2<'_, f32>) -> f64 + Sync,
) -> f64 {
    let radius = radius_of(sigma_px);
    smooth_rows(room, radius, fill);
    columns_into(room, out, radius, keep)
}

/// [`smooth_into`], of a plane whose rows are made of those of `out`.
pub(super) fn smooth_beside(
    (out, room): (&mut Array2<f32>, &mut Array2<f32>),
    sigma_px: f32,
    fill: impl Fn(usize, &[f32], &mut [f32]) + Sync,
    keep: impl Fn(usize, &[Place], ArrayViewMut2<'_, f32>) -> f64 + Sync,
) -> f64 {
    let radius = radius_of(sigma_px);
    smooth_rows(room, radius, |y, samples| fill(y, row(out, y), samples));
    columns_into(room, out, radius, keep)
}

/// Fills rows and smooths along them.
fn smooth_rows(plane: &mut Array2<f32>, radius: usize, fill: impl Fn(usize, &mut [f32]) + Sync) {
    let groups = plane.axis_chunks_iter_mut(Axis(0), LANES).into_par_iter().enumerate();
    groups.for_each_init(Lines::default, |lines, (group, mut rows)| {
        for (index, mut row) in rows.rows_mut().into_iter().enumerate() {
            fill(group * LANES + index, row.as_slice_mut().expect("planes are contiguous"));
        }
        lines.take_rows(rows.view());
        smooth_taken(lines, radius);
        lines.give_rows(rows);
    });
}

/// Smooths along the columns of `plane`, and hands the rows of strips on.
fn columns_into(
    plane: &Array2<f32>,
    out: &mut Array2<f32>,
    radius: usize,
    keep: impl Fn(usize, &[Place], ArrayViewMut2<'_, f32>) -> f64 + Sync,
) -> f64 {
    let strips = plane.axis_chunks_iter(Axis(1), LANES).into_par_iter();
    let strips = strips.zip(out.axis_chunks_iter_mut(Axis(1), LANES)).enumerate();
    let sums = strips.map_init(Lines::default, |lines, (strip, (from, out))| {
        take_columns(lines, from, radius);
        keep(strip * LANES, &lines.0[0], out)
    });
    sums.collect::<Vec<f64>>().into_iter().sum()
}

vectorised! {
    /// Smooths the lines that were taken in.
    fn smooth_taken<'a>(lines: &'a mut Lines, radius: usize) -> () {
        lines.smooth(radius);
    }
}

vectorised! {
    /// Smooths along columns, at most as many as there are lanes.
    fn smooth_columns<'a>(lines: &'a mut Lines, strip: ArrayViewMut2<'a, f32>, radius: usize) -> () {
        let mut strip = strip;
        lines.smooth_columns(strip.view(), radius);
        for (mut row, places) in strip.rows_mut().into_iter().zip(&lines.0[0]) {
            let row = row.as_slice_mut().expect("rows are contiguous");
            row.iter_mut().zip(places).for_each(|(out, place)| *out = *place);
        }
    }
}

vectorised! {
    /// As [`smooth_columns`]; the result stays among the lines.
    fn take_columns<'a>(lines: &'a mut Lines, columns: ArrayView2<'a, f32>, radius: usize) -> () {
        lines.smooth_columns(columns, radius);
    }
}

/// Lines that are smoothed side by side, and room for as many.
#[derive(Default)]
struct Lines([Vec<Place>; 2]);

impl Lines {
    /// Takes rows in, at most as many as there are lanes.
    fn take_rows(&mut self, rows: ArrayView2<'_, f32>) {
        let [places, _] = &mut self.0;
        places.clear();
        places.resize(rows.ncols(), [0.0; LANES]);
        let blocks = blocks_of(rows.dim());
        if let Some(samples) = rows.as_slice() {
            for (at, block) in places.as_chunks_mut::<LANES>().0.iter_mut().enumerate().take(blocks) {
                transpose(&samples[at * LANES..], rows.ncols(), block.as_flattened_mut(), LANES);
            }
        }
        for (index, row) in rows.rows().into_iter().enumerate() {
            places.iter_mut().zip(row).skip(blocks * LANES).for_each(|(place, value)| place[index] = *value);
        }
    }

    /// Writes rows as they are now.
    fn give_rows(&self, mut rows: ArrayViewMut2<'_, f32>) {
        let [places, _] = &self.0;
        let (blocks, width) = (blocks_of(rows.dim()), rows.ncols());
        if let Some(samples) = rows.as_slice_mut() {
            for (at, block) in places.as_chunks::<LANES>().0.iter().enumerate().take(blocks) {
                transpose(block.as_flattened(), LANES, &mut samples[at * LANES..], width);
            }
        }
        for (index, mut row) in rows.rows_mut().into_iter().enumerate() {
            row.iter_mut().zip(places).skip(blocks * LANES).for_each(|(out, place)| *out = place[index]);
        }
    }

    /// Takes columns in and smooths them.
    #[inline(always)]
    fn smooth_columns(&mut self, columns: ArrayView2<'_, f32>, radius: usize) {
        let [places, _] = &mut self.0;
        places.clear();
        places.extend(columns.rows().into_iter().map(|row| {
            let row = row.to_slice().expect("rows are contiguous");
            let mut place = [0.0; LANES];
            match row.first_chunk() {
                Some(whole) => place = *whole,
                None => place[..row.len()].copy_from_slice(row),
            }
            place
        }));
        self.smooth(radius);
    }

    #[inline(always)]
    fn smooth(&mut self, radius: usize) {
        let [places, room] = &mut self.0;
        room.resize(places.len(), [0.0; LANES]);
        for _ in 0..PASSES {
            smooth_lines(places, room, radius);
            std::mem::swap(places, room);
        }
    }
}

/// The local mean with a bell of `sigma_px`, of those pixels alone that lie in the plane.
pub(super) fn local_mean(plane: &Array2<f32>, sigma_px: f32) -> Array2<f32> {
    let mut mean = plane.clone();
    smooth(&mut mean, sigma_px);
    let [rows, columns] = [plane.nrows(), plane.ncols()].map(|length| coverage(length, sigma_px));
    Zip::indexed(mean.rows_mut()).par_for_each(|y, mut row| {
        row.iter_mut().zip(&columns).for_each(|(value, of_column)| *value /= rows[y] * of_column);
    });
    mean
}

/// Fills what is not `known` from its surroundings, from the finest bell that reaches it.
pub(super) fn paint(plane: &mut Array2<f32>, known: &Array2<f32>) {
    let mut holes = Zip::from(known).par_map_collect(|known| *known <= 0.0);
    let seen = Zip::from(&*plane).and(known).par_map_collect(|value, known| value * known);
    for sigma_px in PAINTING_PX {
        if !holes.iter().any(|hole| *hole) {
            return;
        }
        let (mut light, mut share) = (seen.clone(), known.clone());
        smooth(&mut light, sigma_px);
        smooth(&mut share, sigma_px);
        Zip::from(&mut *plane).and(&mut holes).and(&light).and(&share).par_for_each(
            |value, hole, light, share| {
                if *hole && *share > LEAST_KNOWN {
                    (*value, *hole) = (light / share, false);
                }
            },
        );
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few pixels")]
fn radius_of(sigma_px: f32) -> usize {
    ((4.0 * sigma_px.powi(2) + 1.0).sqrt() / 2.0).round() as usize
}

/// What a line of ones is smoothed to.
fn coverage(length: usize, sigma_px: f32) -> Vec<f32> {
    let (ones, mut lines) = (Array2::ones((1, length)), Lines::default());
    lines.take_rows(ones.view());
    lines.smooth(radius_of(sigma_px));
    lines.0[0].iter().map(|place| place[0]).collect()
}

/// Blocks of as many columns as rows that are transposed whole: those of rows that are as many as there are lanes.
fn blocks_of((rows, columns): (usize, usize)) -> usize {
    if rows == LANES { columns / LANES } else { 0 }
}

/// Smooths lines by one box.
#[inline(always)]
fn smooth_lines(before: &[Place], after: &mut [Place], radius: usize) {
    let scale = scale_of(radius);
    let mut sums: Lanes = [0.0; LANES];
    let add = |sums: &mut Lanes, place: &Place| {
        sums.iter_mut().zip(place).for_each(|(sum, value)| *sum += f64::from(*value));
    };
    before.iter().take(radius).for_each(|place| add(&mut sums, place));
    for (at, after) in after.iter_mut().enumerate() {
        if let Some(entering) = before.get(at + radius) {
            add(&mut sums, entering);
        }
        if at > radius {
            let leaving = &before[at - radius - 1];
            sums.iter_mut().zip(leaving).for_each(|(sum, value)| *sum -= f64::from(*value));
        }
        after.iter_mut().zip(&sums).for_each(|(after, sum)| *after = narrow(sum * scale));
    }
}

#[expect(clippy::cast_precision_loss, reason = "a few pixels")]
fn scale_of(radius: usize) -> f64 {
    1.0 / (2 * radius + 1) as f64
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(seed: usize) -> Array2<f32> {
        Array2::from_shape_fn((40, 90), |(y, x)| ((y * 31 + x * 17 + seed) % 23) as f32 / 23.0)
    }

    #[test]
    fn smoothing_is_symmetric_at_the_borders_too() {
        let (a, b) = (plane(1), plane(7));
        let (mut of_a, mut of_b) = (a.clone(), b.clone());
        smooth(&mut of_a, 6.0);
        smooth(&mut of_b, 6.0);
        let (left, right) = ((&of_a * &b).sum(), (&a * &of_b).sum());
        // Sums of 3600 products of 32 bits.
        assert!((left - right).abs() < 1e-4 * left, "{left} {right}");
    }

    #[test]
    fn a_bell_has_unit_sum_and_its_width() {
        for sigma_px in [1.0_f32, 4.0, 6.0, 16.0] {
            let mut bell = Array2::zeros((161, 161));
            bell[[80, 80]] = 1.0;
            smooth(&mut bell, sigma_px);
            let variance: f32 = bell.indexed_iter().map(|((y, _), v)| v * (y as f32 - 80.0).powi(2)).sum();
            // The boxes' widths are odd: a standard deviation is met to half a pixel at most.
            assert!((bell.sum() - 1.0).abs() < 1e-4, "{sigma_px}: {}", bell.sum());
            assert!((variance.sqrt() - sigma_px).abs() < 0.5, "{sigma_px}: {}", variance.sqrt());
        }
    }

    #[test]
    fn the_local_mean_of_a_constant_is_the_constant() {
        for size in [(1, 1), (3, 50), (70, 66)] {
            let mean = local_mean(&Array2::from_elem(size, 0.7), 4.0);
            assert!(mean.iter().all(|v| (v - 0.7).abs() < 1e-5), "{size:?}: {mean}");
        }
    }

    #[test]
    fn holes_are_painted_like_their_surroundings() {
        let truth = Array2::from_shape_fn((60, 60), |(_, x)| x as f32 / 60.0);
        let known = Array2::from_shape_fn((60, 60), |(y, x)| {
            f32::from((y as f32 - 30.0).hypot(x as f32 - 30.0) > 9.0)
        });
        let mut painted = &truth * &known;
        paint(&mut painted, &known);
        for ((place, painted), known) in painted.indexed_iter().zip(&known) {
            let error = (painted - truth[place]).abs();
            // A hole of 18 px over a ramp of 1/60 a pixel.
            assert!(if *known > 0.0 { error < 1e-6 } else { error < 0.15 }, "{place:?}: {error}");
        }
    }

    #[test]
    fn what_no_bell_reaches_stays() {
        let mut plane = Array2::from_elem((8, 8), 3.0);
        paint(&mut plane, &Array2::zeros((8, 8)));
        assert!(plane.iter().all(|v| *v == 3.0));
    }
}
