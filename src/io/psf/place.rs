//! Finds where the peak of an energy map lies and moves it to the centre: by rolling it where it is in the layout of a
//! Fourier transform, else by whole pixels with zeros behind.

use ndarray::{Array2, Array3, ArrayView2, s};

use crate::core::broad_peak::{broad_peak, sums_around};
use crate::core::error::{Error, Result};

/// Values this close to the brightest, as a share of it, are as bright: the rounding of half floats is 2⁻¹¹, and a core
/// that saturates is as level.
const LEVEL: f64 = 1e-3;

/// Light lost off the edge, as a share of a colour's, that is not worth a word.
pub(super) const LOSS_TOLERANCE: f64 = 1e-3;

/// Light lost off the edge, as a share of a colour's, without which a PSF is another one.
pub(super) const MOST_LOSS: f64 = 0.02;

/// How far from the corner, in pixels, the peak of a PSF in the layout of a Fourier transform may lie.
const CORNER_REACH: isize = 2;

/// The share of a window's light around its middle that a PSF must have on both sides of it: a whole one has nearly all, a
/// quarter of one nothing.
const LEAST_SYMMETRY: f64 = 0.5;

/// How a peak comes to the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PsfMove {
    /// Rows down and columns to the right.
    pub by: (isize, isize),
    /// Whether what leaves the frame comes in on the other side; else it is lost, and zeros come in.
    pub is_rolled: bool,
    /// The light that is lost, as a share of that of the colour that loses most.
    pub lost: f64,
}

impl PsfMove {
    /// How the peak of all channels together comes to the centre; none where it is there.
    ///
    /// It is that of the sum of the channels, each divided by its own light, so that colours that lie apart stay so.
    pub(super) fn of(planes: &Array3<f32>) -> Option<Self> {
        let (_, height, width) = planes.dim();
        let mut light = Array2::<f64>::zeros((height, width));
        for plane in planes.outer_iter() {
            let sum: f64 = plane.iter().map(|&v| f64::from(v.max(0.0))).sum();
            let weight = if sum > 0.0 { 1.0 / sum } else { 0.0 };
            light.zip_mut_with(&plane, |light, &value| *light += weight * f64::from(value));
        }
        let ((down, right), is_cyclic) = locate(&light);
        let shifted = Self { by: (-down, -right), is_rolled: false, lost: loss(planes, (down, right)) };
        let is_rolled = is_cyclic && shifted.lost > LOSS_TOLERANCE;
        let lost = if is_rolled { 0.0 } else { shifted.lost };
        ((down, right) != (0, 0)).then_some(Self { is_rolled, lost, ..shifted })
    }

    /// The light that is lost in percent, where it is worth a word.
    pub fn lost_in_words(self) -> Option<String> {
        (self.lost > LOSS_TOLERANCE).then(|| show_share(self.lost))
    }

    fn apply(self, planes: &Array3<f32>) -> Array3<f32> {
        let (_, height, width) = planes.dim();
        let from = |index: usize, by: isize, length: usize| {
            if self.is_rolled { Some(wrap(index, -by, length)) } else { index.checked_add_signed(-by) }
        };
        Array3::from_shape_fn(planes.dim(), |(channel, y, x)| {
            let place = from(y, self.by.0, height).zip(from(x, self.by.1, width));
            place.and_then(|(y, x)| planes.get([channel, y, x]).copied()).unwrap_or(0.0)
        })
    }
}

/// Moves the peak to the centre, all channels together; says how, where it was not there.
///
/// # Errors
/// [`Error::Unsupported`] when more than 2 % of a channel's light would be lost.
pub(super) fn recenter(planes: Array3<f32>) -> Result<(Array3<f32>, Option<PsfMove>)> {
    let Some(how) = PsfMove::of(&planes) else { return Ok((planes, None)) };
    if how.lost > MOST_LOSS {
        return Err(Error::Unsupported(format!(
            "moving its peak to the centre, {}, would lose {} of its light off the edge: crop the PSF around its peak, or \
             measure it again with the peak in the middle",
            show_shift(how.by),
            show_share(how.lost)
        )));
    }
    let moved = how.apply(&planes);
    Ok((moved, Some(how)))
}

/// A share in percent.
pub(super) fn show_share(share: f64) -> String {
    if share < 0.1 { format!("{:.1} %", 100.0 * share) } else { format!("{:.0} %", 100.0 * share) }
}

/// Pixels down or up and right or left, in words; nothing for none.
pub fn show_shift((down, right): (isize, isize)) -> String {
    let part = |pixels: isize, ahead: &str, back: &str| {
        (pixels != 0)
            .then(|| format!("{} px {}", pixels.unsigned_abs(), if pixels > 0 { ahead } else { back }))
    };
    let parts = [part(down, "down", "up"), part(right, "right", "left")];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    parts.join(" and ")
}

fn wrap(index: usize, by: isize, length: usize) -> usize {
    (index.cast_signed() + by).rem_euclid(length.cast_signed()).cast_unsigned()
}

/// From the centre to the peak, rows down and columns to the right, and whether the light around it goes on at the other
/// side of the frame, as in the layout of a Fourier transform.
pub(super) fn locate(plane: &Array2<f64>) -> ((isize, isize), bool) {
    let (height, width) = plane.dim();
    let half = |length: usize| (length / 2).cast_signed();
    // The corner at row 0, column 0 comes to the centre.
    let at = |(y, x): (usize, usize)| [wrap(y, -half(height), height), wrap(x, -half(width), width)];
    let rolled = Array2::from_shape_fn((height, width), |place| plane[at(place)]);
    let peaks = Peaks::of(&rolled.view());
    let (down, right) = peaks.shift();
    let is_near = down.abs().max(right.abs()) <= CORNER_REACH;
    if is_near && is_gathered(&rolled, peaks.balance) {
        let offset = |by: isize, length: usize| wrap(0, by, length).cast_signed() - half(length);
        return ((offset(down, height), offset(right, width)), true);
    }
    (Peaks::of(&plane.view()).shift(), false)
}

/// Whether a point this far from the centre has most of the light around it, on all sides.
fn is_gathered(plane: &Array2<f64>, point: [f64; 2]) -> bool {
    let (height, width) = plane.dim();
    let centre = [height, width].map(|length| (length / 2).cast_signed());
    #[expect(clippy::cast_possible_truncation, reason = "pixels of a frame")]
    let twice = point.map(|offset| (2.0 * offset).round() as isize);
    let value = |[dy, dx]: [isize; 2]| {
        let (y, x) = (usize::try_from(centre[0] + dy).ok()?, usize::try_from(centre[1] + dx).ok()?);
        plane.get((y, x)).map(|value| value.max(0.0))
    };
    let reach = [height, width].map(|length| (length / 4).cast_signed());
    let (mut inside, mut around, mut paired) = (0.0, 0.0, 0.0);
    for dy in -reach[0]..=reach[0] {
        for dx in -reach[1]..=reach[1] {
            let (here, mirrored) = ([dy, dx], [twice[0] - dy, twice[1] - dx]);
            let light = value(here).unwrap_or(0.0);
            inside += light;
            if here != mirrored {
                around += light;
                paired += light.min(value(mirrored).unwrap_or(0.0));
            }
        }
    }
    let all: f64 = plane.iter().map(|value| value.max(0.0)).sum();
    inside > 0.5 * all && around > 0.0 && paired >= LEAST_SYMMETRY * around
}

/// The largest share of a channel's light that a shift from there to the centre brings out of the frame.
fn loss(planes: &Array3<f32>, (down, right): (isize, isize)) -> f64 {
    let (_, height, width) = planes.dim();
    let is_kept = |index: usize, by: isize, length: usize| {
        index.checked_add_signed(-by).is_some_and(|index| index < length)
    };
    let of_plane = |plane: ArrayView2<'_, f32>| {
        let (mut all, mut lost) = (0.0, 0.0);
        for ((y, x), &value) in plane.indexed_iter() {
            let light = f64::from(value.max(0.0));
            all += light;
            if !(is_kept(y, down, height) && is_kept(x, right, width)) {
                lost += light;
            }
        }
        if all > 0.0 { lost / all } else { 0.0 }
    };
    planes.outer_iter().map(of_plane).fold(0.0, f64::max)
}

/// The brightest pixels; of a broad peak, all that are half as bright.
struct Peaks {
    /// Whether the centre is one, or their middle.
    hold_centre: bool,
    /// From the centre to their point of balance, rows down and columns to the right.
    balance: [f64; 2],
}

impl Peaks {
    fn of(plane: &ArrayView2<'_, f64>) -> Self {
        let (height, width) = plane.dim();
        let centre = (height / 2, width / 2);
        if let Some([y, x]) = broad_peak(plane.view()) {
            let balance = [y - centre.0 as f64, x - centre.1 as f64];
            return Self { hold_centre: balance.map(nearest) == [0, 0], balance };
        }
        let spot = brightest_spot(plane);
        let inside = |(place, _): &((usize, usize), &f64)| spot[*place];
        let highest = plane.indexed_iter().filter(inside).map(|(_, v)| *v).fold(f64::NEG_INFINITY, f64::max);
        let is_as_bright = |value: f64| value >= highest - LEVEL * highest.abs();
        let peaks = plane.indexed_iter().filter(inside).filter(|(_, value)| is_as_bright(**value));
        let (mut count, mut sums) = (0.0, [0.0, 0.0]);
        for ((y, x), _) in peaks {
            count += 1.0;
            sums = [sums[0] + y as f64, sums[1] + x as f64];
        }
        let offset = |sum: f64, centre: usize| sum / f64::max(count, 1.0) - centre as f64;
        Self {
            hold_centre: spot[centre] && is_as_bright(plane[centre]),
            balance: [offset(sums[0], centre.0), offset(sums[1], centre.1)],
        }
    }

    /// From the centre to the peak in whole pixels: none where the centre is as bright.
    fn shift(&self) -> (isize, isize) {
        if self.hold_centre { (0, 0) } else { (nearest(self.balance[0]), nearest(self.balance[1])) }
    }
}

/// The nearest integer, of two the one nearer to zero.
#[expect(clippy::cast_possible_truncation, reason = "pixels of a frame")]
fn nearest(value: f64) -> isize {
    ((value.abs() - 0.5).ceil().max(0.0) as isize) * if value < 0.0 { -1 } else { 1 }
}

/// The pixels of the 3 × 3 neighbourhoods that hold as much light as the brightest.
fn brightest_spot(plane: &ArrayView2<'_, f64>) -> Array2<bool> {
    let (height, width) = plane.dim();
    let around = |y: usize, x: usize| {
        (y.saturating_sub(1)..(y + 2).min(height), x.saturating_sub(1)..(x + 2).min(width))
    };
    let sums = sums_around(plane.view());
    let highest = sums.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut spot = Array2::from_elem((height, width), false);
    for ((y, x), &sum) in sums.indexed_iter() {
        if sum >= highest - LEVEL * highest.abs() {
            let (rows, columns) = around(y, x);
            spot.slice_mut(s![rows, columns]).fill(true);
        }
    }
    spot
}
