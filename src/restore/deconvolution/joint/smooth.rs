//! Smooths planes by a bell that costs the same whatever its width, and what is made of that: local brightness, painted
//! holes.

use std::ops::Range;

use ndarray::{Array2, ArrayViewMut2, Axis, Zip};
use rayon::prelude::*;

use super::frame::copy_of;
use super::sums::{LANES, Lanes};
use super::window::Window;
use crate::kernels::fourier::transpose;
use crate::kernels::vectorised;

/// Passes of a box; three are a cubic spline, within 3 % of a Gaussian.
const PASSES: usize = 3;

/// A place of a line, of lines that are smoothed side by side: as many as a cache line holds.
type Place = [f32; LANES];

/// Bands of rows that are smoothed side by side, and rows that each has at least, over the radius of a box: those around it are
/// smoothed along for each of two bands.
const BANDS: usize = 8;
const LEAST_ROWS: usize = 12;

/// Standard deviations, in pixels, of the bells that fill holes, from the finest that reaches a pixel.
const PAINTING_PX: [f32; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// The part of a bell that has to lie on known pixels: fewer tell one of them rather than a mean.
const LEAST_KNOWN: f32 = 0.05;

/// Smooths a plane, of which `fill(y, row)` writes rows, with a bell of standard deviation `sigma_px`, the plane being zero outside: a
/// symmetric matrix. `keep(y, smoothed, row)` takes each of its rows to that of `out`; the sum of what it returns is returned. Some rows
/// are asked for twice.
///
/// # Equation
/// Three boxes of 2r + 1 pixels have the variance `3·((2r + 1)² − 1)/12`; r is the one that is nearest to σ.
pub(super) fn smooth_into(
    mut out: ArrayViewMut2<'_, f32>,
    sigma_px: f32,
    fill: impl Fn(usize, &mut [f32]) + Sync,
    keep: impl Fn(usize, &mut [f32], &mut [f32]) -> f64 + Sync,
) -> f64 {
    let (height, width) = out.dim();
    let radius = radius_of(sigma_px);
    let rows = height.div_ceil(BANDS).max(LEAST_ROWS * radius).max(1);
    let bands = out.axis_chunks_iter_mut(Axis(0), rows).into_par_iter().enumerate();
    let sums = bands.map_init(Lines::default, |lines, (band, mut out)| {
        let band = band * rows..(band * rows + out.nrows());
        let mut cascade = Cascade::new(band.clone(), (height, width), radius);
        let mut sum = 0.0;
        cascade.run((&fill, lines), |y, smoothed| {
            let mut out = out.row_mut(y - band.start);
            sum += keep(y, smoothed, out.as_slice_mut().expect("rows are contiguous"));
        });
        sum
    });
    sums.collect::<Vec<f64>>().into_iter().sum()
}

/// The rows of a band on their way through boxes across them.
struct Cascade {
    stages: Vec<Stage>,
    width: usize,
    radius: usize,
    smoothed: Vec<f32>,
}

/// Rows that are added up across them, by one box.
struct Stage {
    /// The rows of the plane that enter and those that come out.
    rows: Range<usize>,
    out: Range<usize>,
    /// The latest rows that entered, one after another, around a ring of so many.
    ring: Vec<f32>,
    slots: usize,
    /// The sum of the rows in the box.
    sums: Vec<f64>,
}

impl Cascade {
    fn new(band: Range<usize>, (height, width): (usize, usize), radius: usize) -> Self {
        let grown = |rows: &Range<usize>| rows.start.saturating_sub(radius)..(rows.end + radius).min(height);
        let mut stages = Vec::with_capacity(PASSES);
        let mut out = band;
        for pass in (0..PASSES).rev() {
            let rows = grown(&out);
            // Rows enter the first by whole groups.
            let entering = if pass == 0 { LANES } else { 1 };
            let slots = (2 * radius + 1 + entering).next_multiple_of(entering);
            let (ring, sums) = (vec![0.0; slots * width], vec![0.0; width]);
            stages.push(Stage { rows: rows.clone(), out, ring, slots, sums });
            out = rows;
        }
        stages.reverse();
        Self { stages, width, radius, smoothed: vec![0.0; width] }
    }

    /// Takes in all rows, which `fill` writes, and hands those that are smoothed to `keep`.
    fn run(
        &mut self,
        (fill, lines): (&impl Fn(usize, &mut [f32]), &mut Lines),
        mut keep: impl FnMut(usize, &mut [f32]),
    ) {
        let rows = self.stages[0].rows.clone();
        for start in rows.clone().step_by(LANES) {
            let entering = self.stages[0].slots_of(start..start + LANES, self.width);
            let members = start..(start + LANES).min(rows.end);
            for (y, row) in members.clone().zip(entering.chunks_exact_mut(self.width)) {
                fill(y, row);
            }
            // Rows after the last are whatever stands there, and beside the others.
            lines.smooth_rows(entering, self.radius);
            for y in members {
                self.stages[0].enter(y, self.width);
                self.pass_on(0, y, &mut keep);
            }
        }
    }

    /// Lets the rows out of a stage that are told, row y having entered it last.
    fn pass_on(&mut self, stage: usize, y: usize, keep: &mut impl FnMut(usize, &mut [f32])) {
        let Self { width, radius, .. } = *self;
        while let Some(leaving) = self.stages[stage].next_out(y, radius) {
            let (before, after) = self.stages.split_at_mut(stage + 1);
            let from = &mut before[stage];
            match after.first_mut() {
                Some(next) => {
                    let row = next.slots_of(leaving..leaving + 1, width);
                    from.give(leaving, row, radius);
                    next.enter(leaving, width);
                    self.pass_on(stage + 1, leaving, keep);
                }
                None => {
                    from.give(leaving, &mut self.smoothed, radius);
                    keep(leaving, &mut self.smoothed);
                }
            }
        }
    }
}

impl Stage {
    /// The places of rows that follow one another there.
    fn slots_of(&mut self, rows: Range<usize>, width: usize) -> &mut [f32] {
        let slot = (rows.start - self.rows.start) % self.slots;
        &mut self.ring[slot * width..][..rows.len() * width]
    }

    /// Adds a row that is at its place.
    fn enter(&mut self, y: usize, width: usize) {
        let slot = (y - self.rows.start) % self.slots;
        add(&mut self.sums, &self.ring[slot * width..][..width]);
    }

    /// The next row that can come out, `latest` having entered last.
    fn next_out(&self, latest: usize, radius: usize) -> Option<usize> {
        let is_told = latest >= self.out.start + radius || latest + 1 == self.rows.end;
        (!self.out.is_empty() && is_told).then_some(self.out.start)
    }

    /// Writes row y, which comes out, and takes the one away that the box leaves.
    fn give(&mut self, y: usize, out: &mut [f32], radius: usize) {
        let width = out.len();
        match y.checked_sub(radius).filter(|leaving| *leaving >= self.rows.start) {
            Some(leaving) => {
                let slot = (leaving - self.rows.start) % self.slots;
                mean_and_subtract(out, &mut self.sums, &self.ring[slot * width..][..width], scale_of(radius));
            }
            None => mean_of(out, &self.sums, scale_of(radius)),
        }
        self.out.start = y + 1;
    }
}

vectorised! {
    fn add<'a>(sums: &'a mut [f64], row: &'a [f32]) -> () {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += f64::from(*value));
    }
}

vectorised! {
    fn mean_of<'a>(out: &'a mut [f32], sums: &'a [f64], scale: f64) -> () {
        out.iter_mut().zip(sums).for_each(|(out, sum)| *out = narrow(sum * scale));
    }
}

vectorised! {
    fn mean_and_subtract<'a>(out: &'a mut [f32], sums: &'a mut [f64], leaving: &'a [f32], scale: f64) -> () {
        for ((out, sum), leaving) in out.iter_mut().zip(sums).zip(leaving) {
            *out = narrow(*sum * scale);
            *sum -= f64::from(*leaving);
        }
    }
}

vectorised! {
    /// Smooths the lines that were taken in.
    fn smooth_taken<'a>(lines: &'a mut Lines, radius: usize) -> () {
        lines.smooth(radius);
    }
}

/// Lines that are smoothed side by side, and room for as many.
#[derive(Default)]
struct Lines([Vec<Place>; 2]);

impl Lines {
    /// Smooths along rows, as many as there are lanes.
    fn smooth_rows(&mut self, rows: &mut [f32], radius: usize) {
        let width = rows.len() / LANES;
        let whole = width - width % LANES;
        let places = &mut self.0[0];
        places.resize(width, [0.0; LANES]);
        for (at, block) in places.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            transpose(&rows[at * LANES..], width, block.as_flattened_mut(), LANES);
        }
        for (x, place) in places.iter_mut().enumerate().skip(whole) {
            place.iter_mut().enumerate().for_each(|(y, value)| *value = rows[y * width + x]);
        }
        smooth_taken(self, radius);
        let places = &self.0[0];
        for (at, block) in places.as_chunks::<LANES>().0.iter().enumerate() {
            transpose(block.as_flattened(), LANES, &mut rows[at * LANES..], width);
        }
        for (x, place) in places.iter().enumerate().skip(whole) {
            place.iter().enumerate().for_each(|(y, value)| rows[y * width + x] = *value);
        }
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

/// Smooths a plane, of which `fill` writes rows.
pub(super) fn smoothed(
    (height, width): (usize, usize),
    sigma_px: f32,
    fill: impl Fn(usize, &mut [f32]) + Sync,
) -> Array2<f32> {
    let mut out = Array2::zeros((height, width));
    let copy = |_: usize, smoothed: &mut [f32], out: &mut [f32]| {
        out.copy_from_slice(smoothed);
        0.0
    };
    smooth_into(out.view_mut(), sigma_px, fill, copy);
    out
}

/// The local mean with a bell of `sigma_px`, of those pixels alone that lie in the plane.
pub(in crate::restore) fn local_mean(plane: &Array2<f32>, sigma_px: f32) -> Array2<f32> {
    let mut mean = Array2::zeros(plane.dim());
    local_mean_into(plane, sigma_px, mean.view_mut(), |_, mean, out| out.copy_from_slice(mean));
    mean
}

/// [`local_mean`], of which `keep(y, mean, row)` takes each row to that of `out`.
pub(super) fn local_mean_into(
    plane: &Array2<f32>,
    sigma_px: f32,
    out: ArrayViewMut2<'_, f32>,
    keep: impl Fn(usize, &[f32], &mut [f32]) + Sync,
) {
    let [rows, columns] = [plane.nrows(), plane.ncols()].map(|length| coverage(length, sigma_px));
    smooth_into(out, sigma_px, copy_of(plane), |y, smoothed, out| {
        divide(smoothed, rows[y], &columns);
        keep(y, smoothed, out);
        0.0
    });
}

vectorised! {
    /// Divides a row by what ones are smoothed to.
    fn divide<'a>(row: &'a mut [f32], of_row: f32, of_columns: &'a [f32]) -> () {
        row.iter_mut().zip(of_columns).for_each(|(value, of_column)| *value /= of_row * of_column);
    }
}

/// Fills what is not `known` from its surroundings, from the finest bell that reaches it.
pub(super) fn paint(plane: &mut Array2<f32>, known: &Array2<f32>) {
    let mut holes = Zip::from(known).par_map_collect(|known| *known <= 0.0);
    for sigma_px in PAINTING_PX {
        let windows = Window::apart(&holes, [reach_of(sigma_px); 2]);
        let paint_window = |window: &Window| {
            let known = window.cut(known.view()).to_owned();
            let seen =
                Zip::from(window.cut(plane.view())).and(&known).par_map_collect(|value, known| value * known);
            let share = smoothed(seen.dim(), sigma_px, copy_of(&known));
            drop(known);
            let mut painted = smoothed(seen.dim(), sigma_px, copy_of(&seen));
            let places = Zip::from(&mut painted).and(&share).and(window.cut(holes.view()));
            places.par_for_each(|light, share, hole| {
                *light = if *hole && *share > LEAST_KNOWN { *light / share } else { f32::NAN };
            });
            painted
        };
        let painted: Vec<_> = windows.par_iter().map(paint_window).collect();
        for (window, painted) in windows.iter().zip(painted) {
            let places = Zip::from(plane.slice_mut(window.slices())).and(holes.slice_mut(window.slices()));
            places.and(&painted).for_each(|value, hole, painted| {
                if !painted.is_nan() {
                    (*value, *hole) = (*painted, false);
                }
            });
        }
    }
}

/// How far from a pixel others are that a bell of `sigma_px` takes it from.
pub(super) fn reach_of(sigma_px: f32) -> usize {
    PASSES * radius_of(sigma_px)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few pixels")]
fn radius_of(sigma_px: f32) -> usize {
    ((4.0 * sigma_px.powi(2) + 1.0).sqrt() / 2.0).round() as usize
}

/// What a line of ones is smoothed to.
fn coverage(length: usize, sigma_px: f32) -> Vec<f32> {
    let mut ones = vec![1.0; LANES * length];
    Lines::default().smooth_rows(&mut ones, radius_of(sigma_px));
    ones.truncate(length);
    ones
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

    fn smooth(plane: &Array2<f32>, sigma_px: f32) -> Array2<f32> {
        smoothed(plane.dim(), sigma_px, copy_of(plane))
    }

    fn plane(seed: usize) -> Array2<f32> {
        Array2::from_shape_fn((40, 90), |(y, x)| ((y * 31 + x * 17 + seed) % 23) as f32 / 23.0)
    }

    #[test]
    fn smoothing_is_symmetric_at_the_borders_too() {
        let (a, b) = (plane(1), plane(7));
        let [of_a, of_b] = [&a, &b].map(|plane| smooth(plane, 6.0));
        let (left, right) = ((&of_a * &b).sum(), (&a * &of_b).sum());
        // Sums of 3600 products of 32 bits.
        assert!((left - right).abs() < 1e-4 * left, "{left} {right}");
    }

    /// Three boxes along rows, then three along columns, each of a plane that is zero outside; of several bands, and of rows that no
    /// lanes divide.
    #[test]
    fn bells_are_three_boxes_in_bands_too() {
        let plane = Array2::from_shape_fn((211, 37), |(y, x)| ((y * 31 + x * 17) % 23) as f32 / 23.0);
        for radius in [1, 2, 6] {
            let sigma_px = radius as f32;
            assert_eq!(radius_of(sigma_px), radius);
            let mut expected = plane.clone();
            for axis in [Axis(1), Axis(1), Axis(1), Axis(0), Axis(0), Axis(0)] {
                let before = expected.clone();
                for (mut after, before) in expected.lanes_mut(axis).into_iter().zip(before.lanes(axis)) {
                    for at in 0..after.len() {
                        let box_of = at.saturating_sub(radius)..(at + radius + 1).min(before.len());
                        after[at] = before.slice(ndarray::s![box_of]).sum() / (2 * radius + 1) as f32;
                    }
                }
            }
            let found = smooth(&plane, sigma_px);
            let worst = (&found - &expected).iter().fold(0.0, |worst: f32, v| worst.max(v.abs()));
            assert!(worst < 1e-5, "{radius}: {worst}");
        }
    }

    #[test]
    fn a_bell_has_unit_sum_and_its_width() {
        for sigma_px in [1.0_f32, 4.0, 6.0, 16.0] {
            let mut bell = Array2::zeros((161, 161));
            bell[[80, 80]] = 1.0;
            let bell = smooth(&bell, sigma_px);
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
