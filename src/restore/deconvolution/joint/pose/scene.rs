//! What a capture tells of the PSF's pose: lamps, and the flare around them.

use ndarray::{Array2, ArrayView2, Axis, Zip, s};

use super::super::super::Border;
use super::super::fit::grown;
use super::super::frame::{Blur, Frame, row};
use super::super::high_pass::HighPass;
use super::super::known::local_brightness;
use super::super::sums::{add_scaled, inner};
use crate::core::fft::TransformPrecision;
use crate::core::saturation::saturated_from;

/// The largest side of the part of a capture that is looked at: of four captures of 800 × 800 pixels it tells the pose of all, and the
/// whole of two.
const LARGEST_PX: usize = 704;

/// Pixels around lamps that are not believed.
const GUARD_PX: usize = 2;

/// Standard deviation of the high pass, in pixels: narrower than the fit of clipped light has it, since a pose is told by the
/// edges of orders, and the scene's detail grows with its size.
const HIGH_PASS_PX: f32 = 4.0;

/// Standard deviation of the bell that the power of what is left is averaged over, in pixels. A plain, unweighted fit has
/// errors three times as large: busy parts of the scene drown the orders in quiet ones.
const BUSY_PX: f32 = 4.0;

/// The light of lamps as a part of the brightest of the capture, below which places count as dark.
const LEAST_LIGHT: f32 = 1e-3;

/// Clipped pixels beside another that make lamps; fewer may be hot.
const LEAST_AREA_PX: usize = 4;

/// Places of light that are compared with the capture at most, the brightest.
const MOST_MATCHED: usize = 400;

/// A lamp that is not clipped is as many times brighter than the median.
const LAMP_CONTRAST: f32 = 8.0;

/// The share of the pixels that are lamps, at most, unless more are clipped.
const LAMP_SHARE: f64 = 1e-2;

/// A part of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::restore) struct Window {
    pub(in crate::restore) top: usize,
    pub(in crate::restore) left: usize,
    pub(in crate::restore) height: usize,
    pub(in crate::restore) width: usize,
}

/// Lamps and their surroundings in one channel of a capture.
pub(super) struct Scene {
    pub(super) frame: Frame,
    /// y.
    pub(super) capture: Array2<f32>,
    /// Where the light of lamps is to be found.
    pub(super) lamps: Array2<bool>,
    /// What is added to the light of lamps where it gathers, so that those can shine that were dark before.
    pub(super) seed: f32,
    pub(super) high_pass: HighPass,
    /// `w·h(y)`.
    pub(super) target: Array2<f32>,
}

impl Scene {
    /// Looks for lamps in a channel that saturates at `level`, through a PSF of `psf` pixels, where they take no more than the part `most`
    /// of what is looked at, if there is such a place; none without lamps.
    pub(super) fn new(
        channel: ArrayView2<'_, f32>,
        psf: [usize; 2],
        (level, alpha): (f32, f32),
        most: f64,
    ) -> Option<Self> {
        let (window, lamps_from) = window_of(channel, level, most)?;
        let Window { top, left, height, width } = window;
        let capture = channel.slice(s![top..top + height, left..left + width]).mapv(|y| y.max(0.0));
        let lamps = capture.mapv(|y| y >= lamps_from);
        let seed = LEAST_LIGHT * capture.iter().fold(0.0, |most: f32, y| most.max(*y));
        let brightness = local_brightness(&capture, alpha);
        let known = grown(&lamps, GUARD_PX).mapv(|near| if near { 0.0 } else { 1.0 });
        // All light that is fitted lies in the frame, and so does all that it is compared with.
        let frame = Frame::new([height, width], psf, Border::Zero, TransformPrecision::Single);
        let high_pass = HighPass::new(known, brightness.view(), HIGH_PASS_PX);
        let target = high_pass.passed(&capture);
        Some(Self { frame, capture, lamps, seed, high_pass, target })
    }

    /// A channel with a lamp beyond its border, in one of the places `lamps` of a plane that goes on around the frame; of its own
    /// pixels `saturated` ones are not believed.
    pub(super) fn of_lamp_outside(
        (channel, saturated): (ArrayView2<'_, f32>, &Array2<bool>),
        psf: [usize; 2],
        (lamps, seed): (Array2<bool>, f32),
        alpha: f32,
    ) -> Self {
        let capture = channel.mapv(|y| y.max(0.0));
        let brightness = local_brightness(&capture, alpha);
        let known = grown(saturated, GUARD_PX).mapv(|near| if near { 0.0 } else { 1.0 });
        let frame = Frame::new(channel.dim().into(), psf, Border::Smooth, TransformPrecision::Single);
        let high_pass = HighPass::new(known, brightness.view(), HIGH_PASS_PX);
        let target = high_pass.passed(&capture);
        Self { frame, capture, lamps, seed, high_pass, target }
    }

    /// `w·h(A x)`.
    pub(super) fn seen(&self, blur: &Blur<'_>, light: &Array2<f32>) -> Array2<f32> {
        let mut image = Array2::zeros(self.frame.size());
        blur.apply(light, &mut image);
        self.high_pass.passed(&image)
    }

    /// `w·h(y − A x)`.
    pub(super) fn left(&self, blur: &Blur<'_>, light: &Array2<f32>) -> Array2<f32> {
        let mut left = self.seen(blur, light);
        Zip::from(&mut left).and(&self.target).par_for_each(|left, target| *left = target - *left);
        left
    }

    /// How much light that falls at each place of a plane of `psf` pixels, the middle being that of lamps, explains of the capture; of the
    /// brightest places of a light, which tell most of it.
    ///
    /// # Equation
    /// `c(d) = Σ_q x(q)·b(q + d)`, b = hᵀ(w·target), which makes `⟨w h(A x), target⟩ = Σ_d k(d) c(d)` of any PSF k.
    pub(super) fn matched(&self, light: &Array2<f32>, [height, width]: [usize; 2]) -> Array2<f32> {
        let back = self.high_pass.back_unblurred(&self.target);
        let mut shining: Vec<_> = light.indexed_iter().filter(|(_, light)| **light > 0.0).collect();
        shining.sort_unstable_by(|a, b| b.1.total_cmp(a.1).then(a.0.cmp(&b.0)));
        shining.truncate(MOST_MATCHED);
        let mut matched = Array2::zeros((height, width));
        Zip::indexed(matched.rows_mut()).par_for_each(|dy, mut out| {
            for &((y, x), &light) in &shining {
                let Some(from) = (y + dy).checked_sub(height / 2).filter(|y| *y < back.nrows()) else {
                    continue;
                };
                // Column d of the plane is x + d − width/2 of the capture.
                let first = (width / 2).saturating_sub(x);
                let last = width.min(back.ncols() + width / 2 - x);
                let from = &row(&back, from)[first + x - width / 2..last + x - width / 2];
                let out = &mut out.as_slice_mut().expect("planes are contiguous")[first..last];
                out.iter_mut().zip(from).for_each(|(out, from)| *out += light * from);
            }
        });
        matched
    }

    /// Makes pixels count by what is `left` unexplained around them.
    pub(super) fn weigh(&mut self, left: &Array2<f32>) {
        self.high_pass.weigh(left, BUSY_PX);
        self.target = self.high_pass.passed(&self.capture);
    }

    /// Takes away what `columns`, which are orthonormal, explain.
    pub(super) fn project_out(plane: &mut Array2<f32>, columns: &[Array2<f32>]) {
        for column in columns {
            let part = narrow(inner(column, plane));
            add_scaled(plane, -part, column);
        }
    }
}

/// The part of a channel that saturates at `level` which is looked at for its lamps, and the light from which on pixels count as such;
/// see [`Scene::new`].
pub(super) fn window_of(channel: ArrayView2<'_, f32>, level: f32, most: f64) -> Option<(Window, f32)> {
    let clipped_from = saturated_from(level);
    // The glare around clipped light tells of it, and so do its orders: what may shine explains no other's flare.
    let lamps_from = match has_areas(&channel.mapv(|y| y >= clipped_from)) {
        true => clipped_from,
        false => clipped_from.min(bright_from(channel)),
    };
    // What is dark all over has none.
    let [top, left] = window_of_lamps(&channel.mapv(|y| y > 0.0 && y >= lamps_from), most)?;
    let [height, width] = [channel.nrows(), channel.ncols()].map(|side| side.min(LARGEST_PX));
    Some((Window { top, left, height, width }, lamps_from))
}

/// Whether there are pixels of a set beside one another.
fn has_areas(set: &Array2<bool>) -> bool {
    let beside = |y: usize, x: usize| {
        set.get((y, x + 1)).copied().unwrap_or(false) || set.get((y + 1, x)).copied().unwrap_or(false)
    };
    set.indexed_iter().filter(|((y, x), member)| **member && beside(*y, *x)).nth(LEAST_AREA_PX - 1).is_some()
}

/// The light from which on pixels count as lamps that are not clipped.
fn bright_from(channel: ArrayView2<'_, f32>) -> f32 {
    let mut values: Vec<f32> = channel.iter().copied().collect();
    let last = values.len() - 1;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a length")]
    let lamps = (last as f64 * LAMP_SHARE) as usize;
    let mut at = |rank: usize| *values.select_nth_unstable_by(rank, f32::total_cmp).1;
    at(last - lamps).max(LAMP_CONTRAST * at(last / 2))
}

/// The corner of the part of the frame whose middle holds most lamps, of those that lamps fill no more than `most` of, if there are such.
fn window_of_lamps(lamps: &Array2<bool>, most: f64) -> Option<[usize; 2]> {
    if !lamps.iter().any(|lamp| *lamp) {
        return None;
    }
    let (height, width) = lamps.dim();
    let starts = |whole: usize| {
        let room = whole.saturating_sub(LARGEST_PX);
        let count = room.div_ceil(LARGEST_PX / 4) + 1;
        (0..count).map(move |index| room * index / (count - 1).max(1))
    };
    // Near the middle the flare lies in the window on all sides: a pixel counts by its distance from the border.
    let nearness = |at: usize, whole: usize| {
        let side = whole.min(LARGEST_PX);
        (at + 1).min(side - at) as u64
    };
    let window = |start: usize, whole: usize| start..start + whole.min(LARGEST_PX);
    // Row by row, so that a clipped sky takes no longer than a lamp.
    let lefts: Vec<usize> = starts(width).collect();
    // The lamps of a row, and what these count.
    let mut of_rows = Array2::<[u64; 2]>::from_elem((height, lefts.len()), [0; 2]);
    Zip::from(of_rows.axis_iter_mut(Axis(0))).and(lamps.axis_iter(Axis(0))).par_for_each(
        |mut of_row, lamps| {
            if !lamps.iter().any(|lamp| *lamp) {
                return;
            }
            for (sum, left) in of_row.iter_mut().zip(&lefts) {
                let window = lamps.slice(s![window(*left, width)]);
                let near =
                    window.iter().enumerate().filter(|(_, lamp)| **lamp).map(|(x, _)| nearness(x, width));
                *sum = near.fold([0; 2], |[count, sum], near| [count + 1, sum + near]);
            }
        },
    );
    let room = (height.min(LARGEST_PX) * width.min(LARGEST_PX)) as f64;
    // Those with too many come after all others.
    let score = |top: usize, column: usize| -> (bool, u64) {
        let of_rows = of_rows.slice(s![window(top, height), column]);
        let count: u64 = of_rows.iter().map(|[count, _]| count).sum();
        let sum = of_rows.iter().enumerate().map(|(y, [_, of_row])| nearness(y, height) * of_row).sum();
        (count as f64 <= most * room, sum)
    };
    let corners = starts(height).flat_map(|top| (0..lefts.len()).map(move |column| (top, column)));
    let (top, column) = corners.max_by_key(|(top, column)| score(*top, *column))?;
    Some([top, lefts[column]])
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_has_most_lamps_in_its_middle() {
        let lamps = |places: &[(usize, usize)]| {
            let mut lamps = Array2::from_elem((1408, 2112), false);
            places.iter().for_each(|place| lamps[*place] = true);
            lamps
        };
        let window = |places: &[(usize, usize)]| window_of_lamps(&lamps(places), 1.0);
        assert_eq!(window(&[]), None);
        // Corners stand 176 pixels apart, and a window's middle is 352 pixels in.
        assert_eq!(window(&[(352, 352)]), Some([0, 0]));
        assert_eq!(window(&[(704, 1056)]), Some([352, 704]));
        assert_eq!(window(&[(704, 1056), (1400, 10)]), Some([352, 704]));
        assert_eq!(window(&[(704, 1056), (1000, 1410), (1001, 1409)]), Some([704, 1056]));
    }

    /// A lit wall that is overexposed has more saturated pixels than all lamps, and tells nothing.
    #[test]
    fn a_window_that_a_wall_fills_gives_way_to_others() {
        let mut lamps = Array2::from_elem((704, 2112), false);
        lamps.slice_mut(s![50..650, 20..620]).fill(true);
        lamps.slice_mut(s![300..400, 1710..1810]).fill(true);
        assert_eq!(window_of_lamps(&lamps, 1.0), Some([0, 0]));
        assert_eq!(window_of_lamps(&lamps, 0.1), Some([0, 1408]));
        // Where walls are all there is, they are looked at.
        lamps.slice_mut(s![.., 620..]).fill(true);
        assert!(window_of_lamps(&lamps, 0.1).is_some());
    }

    /// As far as it is added up lamp by lamp, corner by corner.
    #[test]
    fn lamps_count_by_their_distance_from_the_border_of_the_window() {
        let (height, width) = (720, 1100);
        let is_lamp = |y: usize, x: usize| (y * 7919 + x * 104_729) % 997 < 3 && x % 501 < 60 + y / 8;
        let lamps = Array2::from_shape_fn((height, width), |(y, x)| is_lamp(y, x));
        let near = |place: usize, start: usize| match place.checked_sub(start) {
            Some(at) if at < LARGEST_PX => (at + 1).min(LARGEST_PX - at) as u64,
            _ => 0,
        };
        let score = |top: usize, left: usize| -> u64 {
            let places = lamps.indexed_iter().filter(|(_, lamp)| **lamp);
            places.map(|((y, x), _)| near(y, top) * near(x, left)).sum()
        };
        let corners = [0, 16].into_iter().flat_map(|top| [0, 132, 264, 396].map(|left| [top, left]));
        let best = corners.max_by_key(|[top, left]| score(*top, *left));
        assert_eq!(window_of_lamps(&lamps, 1.0), best);
    }
}
