//! Finds what is wrong with an energy map that is to be a PSF, and moves a peak that is off the centre there.

use ndarray::{Array2, Array3, ArrayView2, Axis, s};

use crate::core::error::{Error, Result};

/// Values this close to the brightest, as a share of it, are as bright: the rounding of half floats is 2⁻¹¹, and a core
/// that saturates is as level.
const LEVEL: f64 = 1e-3;

/// A sum this close to one is one: each half float is off by at most 2⁻¹¹ of itself, and so is their sum.
const SUM_TOLERANCE: f64 = 1.0 / (1 << 11) as f64;

/// Negative energy, as a share of the positive, that is not worth a word.
const NEGATIVE_TOLERANCE: f64 = 1e-4;

const NAMES: [&str; 3] = ["red", "green", "blue"];

/// What is wrong with an energy map as a PSF, channel by channel: red, green, blue.
#[derive(Clone, Debug, PartialEq)]
pub struct PsfFaults {
    /// Height and width.
    pub size: [usize; 2],
    /// Rows down and columns to the right from the centre, index N // 2, to the peak.
    pub shifts: [(isize, isize); 3],
    /// What the channel sums to; a PSF's to one.
    pub sums: [f64; 3],
    /// The energy below zero, as a share of that above.
    pub negative_shares: [f64; 3],
    /// Whether the peak was moved to the centre, as far as all channels can be moved together.
    pub recentered: bool,
}

impl PsfFaults {
    /// Looks at an energy map, `[3, height, width]`.
    ///
    /// The peak is the brightest pixel of the brightest 3 × 3 neighbourhood, so that a lone hot pixel does not pass for one;
    /// the centre's pixel, if none there is brighter by more than a thousandth.
    ///
    /// # Errors
    /// [`Error::Unsupported`] naming the first pixel that is NaN or infinite; [`Error::Shape`] unless there are three
    /// channels of at least one pixel.
    pub fn of(planes: &Array3<f32>) -> Result<Self> {
        let (channels, height, width) = planes.dim();
        if channels != 3 || height == 0 || width == 0 {
            let found = format!("{channels} channels of {height} × {width}");
            return Err(Error::shape("PSF", "3 channels of at least 1 × 1", found));
        }
        check_finite(planes)?;
        let of_channel = |channel: usize| planes.index_axis(Axis(0), channel);
        let shift = |channel: usize| shift_of(&of_channel(channel).mapv(f64::from).view());
        let part = |channel: usize, is_counted: fn(f64) -> bool| {
            of_channel(channel).iter().map(|&v| f64::from(v)).filter(|&v| is_counted(v)).sum::<f64>()
        };
        let negative = |channel: usize| {
            let (below, above) = (part(channel, |v| v < 0.0), part(channel, |v| v > 0.0));
            if above > 0.0 { -below / above } else { 0.0 }
        };
        Ok(Self {
            size: [height, width],
            shifts: [0, 1, 2].map(shift),
            sums: [0, 1, 2].map(|channel| part(channel, |_| true)),
            negative_shares: [0, 1, 2].map(negative),
            recentered: false,
        })
    }

    /// All that is wrong as one sentence that says what mends it; none without a fault.
    pub fn describe(&self) -> Option<String> {
        let faults: Vec<String> = [self.describe_shifts(), self.describe_sums(), self.describe_negatives()]
            .into_iter()
            .flatten()
            .collect();
        (!faults.is_empty()).then(|| faults.join("; "))
    }

    fn describe_shifts(&self) -> Option<String> {
        let [height, width] = self.size;
        let is_off = |channel: usize| self.shifts[channel] != (0, 0);
        let found = by_channel(is_off, |channel| format!("lies {}", show_shift(self.shifts[channel])))?;
        let centre = format!("the centre (row {}, column {})", height / 2, width / 2);
        Some(if self.recentered {
            format!(
                "its colours lie apart: with the peak of all at {centre}, that of {found}; --recenter moves all colours \
                 together"
            )
        } else {
            format!(
                "its peak is off {centre}: {found}; every image would be shifted by as much, add --recenter to move it \
                 there"
            )
        })
    }

    fn describe_sums(&self) -> Option<String> {
        let is_off = |channel: usize| (self.sums[channel] - 1.0).abs() > SUM_TOLERANCE;
        let found = by_channel(is_off, |channel| format!("sums to {}", show_number(self.sums[channel])))?;
        Some(format!("{found} instead of 1 (each colour is divided by its sum)"))
    }

    fn describe_negatives(&self) -> Option<String> {
        let share = |channel: usize| format!("has {:.2} %", 100.0 * self.negative_shares[channel]);
        let found = by_channel(|channel| self.negative_shares[channel] > NEGATIVE_TOLERANCE, share)?;
        Some(format!(
            "{found} of negative energy, which is set to zero: subtract less background, or measure with `udc fuse --psf`"
        ))
    }
}

/// What is said of the channels that are off: of all at once where it is the same.
fn by_channel(is_off: impl Fn(usize) -> bool, say: impl Fn(usize) -> String) -> Option<String> {
    let said: Vec<(usize, String)> = (0..3).filter(|&c| is_off(c)).map(|c| (c, say(c))).collect();
    let (_, first) = said.first()?;
    if said.len() == 3 && said.iter().all(|(_, text)| text == first) {
        return Some(format!("every colour {first}"));
    }
    Some(
        said.iter()
            .map(|(channel, text)| format!("{} {text}", NAMES[*channel]))
            .collect::<Vec<_>>()
            .join(", "),
    )
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

fn show_number(value: f64) -> String {
    if (1e-3..1e6).contains(&value.abs()) { format!("{value:.4}") } else { format!("{value:.3e}") }
}

fn check_finite(planes: &Array3<f32>) -> Result<()> {
    match planes.indexed_iter().find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some(((channel, y, x), value)) => Err(Error::Unsupported(format!(
            "holds {value} at row {y}, column {x} in {}; a PSF needs finite values: replace such pixels by numbers",
            NAMES[channel]
        ))),
    }
}

/// From the centre to the peak, rows down and columns to the right.
fn shift_of(plane: &ArrayView2<'_, f64>) -> (isize, isize) {
    let (height, width) = plane.dim();
    let centre = (height / 2, width / 2);
    let spot = brightest_spot(plane);
    let inside = |(place, _): &((usize, usize), &f64)| spot[*place];
    let highest = plane.indexed_iter().filter(inside).map(|(_, v)| *v).fold(f64::NEG_INFINITY, f64::max);
    let offset = |index: usize, origin: usize| index.cast_signed() - origin.cast_signed();
    let from_centre = |(y, x): (usize, usize)| (offset(y, centre.0), offset(x, centre.1));
    let is_as_bright = |value: f64| value >= highest - LEVEL * highest.abs();
    if spot[centre] && is_as_bright(plane[centre]) {
        return (0, 0);
    }
    let peaks = plane.indexed_iter().filter(inside).filter(|(_, value)| **value >= highest);
    peaks.map(|(place, _)| from_centre(place)).min_by_key(|(dy, dx)| dy * dy + dx * dx).unwrap_or((0, 0))
}

/// The pixels of the 3 × 3 neighbourhoods that hold as much light as the brightest.
fn brightest_spot(plane: &ArrayView2<'_, f64>) -> Array2<bool> {
    let (height, width) = plane.dim();
    let around = |y: usize, x: usize| {
        (y.saturating_sub(1)..(y + 2).min(height), x.saturating_sub(1)..(x + 2).min(width))
    };
    let sums = Array2::from_shape_fn((height, width), |(y, x)| {
        let (rows, columns) = around(y, x);
        plane.slice(s![rows, columns]).sum()
    });
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

/// Moves the peak to the centre by whole pixels, all channels together, with zeros behind; returns by how much it moved,
/// rows down and columns to the right.
///
/// The peak is that of the sum of the channels, each divided by its own light, so that colours that lie apart stay so.
pub fn recenter(planes: Array3<f32>) -> (Array3<f32>, Option<(isize, isize)>) {
    let (_, height, width) = planes.dim();
    let mut light = Array2::<f64>::zeros((height, width));
    for plane in planes.outer_iter() {
        let sum: f64 = plane.iter().map(|&v| f64::from(v.max(0.0))).sum();
        let weight = if sum > 0.0 { 1.0 / sum } else { 0.0 };
        light.zip_mut_with(&plane, |light, &value| *light += weight * f64::from(value));
    }
    let (down, right) = shift_of(&light.view());
    if (down, right) == (0, 0) {
        return (planes, None);
    }
    let moved = Array3::from_shape_fn(planes.dim(), |(channel, y, x)| {
        let from = (y.checked_add_signed(down), x.checked_add_signed(right));
        match from {
            (Some(y), Some(x)) => planes.get([channel, y, x]).copied().unwrap_or(0.0),
            _ => 0.0,
        }
    });
    (moved, Some((-down, -right)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian spot of unit sum around a pixel.
    fn spot(size: usize, (y, x): (f64, f64)) -> Array3<f32> {
        let value = |row: usize, column: usize| {
            let (dy, dx) = (row as f64 - y, column as f64 - x);
            (-(dy * dy + dx * dx) / 4.0).exp()
        };
        let plane = Array2::from_shape_fn((size, size), |(row, column)| value(row, column));
        let sum = plane.sum();
        Array3::from_shape_fn((3, size, size), |(_, row, column)| (plane[[row, column]] / sum) as f32)
    }

    #[test]
    fn a_psf_in_its_place_has_no_fault() {
        for size in [20, 21] {
            let middle = (size / 2) as f64;
            assert_eq!(PsfFaults::of(&spot(size, (middle, middle))).unwrap().describe(), None);
            let flat = Array3::from_elem((3, size, size), 1.0 / (size * size) as f32);
            assert_eq!(PsfFaults::of(&flat).unwrap().describe(), None, "a level core is where its centre is");
        }
        // The lopsided core of a PSF whose true peak lies between two pixels.
        assert_eq!(PsfFaults::of(&spot(20, (10.3, 9.6))).unwrap().shifts, [(0, 0); 3]);
    }

    #[test]
    fn a_shift_is_named_down_and_right() {
        let faults = PsfFaults::of(&spot(20, (11.0, 8.0))).unwrap();
        assert_eq!(faults.shifts, [(1, -2); 3]);
        let said = faults.describe().unwrap();
        assert!(said.contains("every colour lies 1 px down and 2 px left"), "{said}");
        assert!(said.contains("row 10, column 10") && said.contains("--recenter"), "{said}");
    }

    #[test]
    fn a_hot_pixel_is_no_peak() {
        let mut planes = spot(20, (10.0, 10.0));
        planes.slice_mut(s![.., 3, 3]).fill(0.1);
        assert!(planes[[0, 3, 3]] > planes[[0, 10, 10]]);
        assert_eq!(PsfFaults::of(&planes).unwrap().shifts, [(0, 0); 3]);
    }

    #[test]
    fn sums_and_negative_lobes_are_named_and_rounding_is_not() {
        let halves = spot(64, (32.0, 32.0)).mapv(|v| half::f16::from_f32(v).to_f32());
        assert_eq!(PsfFaults::of(&halves).unwrap().describe(), None);
        let mut planes = spot(20, (10.0, 10.0));
        planes.index_axis_mut(Axis(0), 2).mapv_inplace(|v| 0.87 * v);
        planes[[0, 2, 2]] = -0.05;
        let said = PsfFaults::of(&planes).unwrap().describe().unwrap();
        assert!(said.contains("red sums to 0.9500, blue sums to 0.8700 instead of 1"), "{said}");
        assert!(said.contains("red has 5.00 % of negative energy"), "{said}");
    }

    #[test]
    fn a_nan_is_named_with_its_place() {
        let mut planes = spot(20, (10.0, 10.0));
        planes[[1, 4, 5]] = f32::NAN;
        let said = PsfFaults::of(&planes).unwrap_err().to_string();
        assert!(said.contains("NaN at row 4, column 5 in green"), "{said}");
    }

    /// What leaves the frame is lost, what comes in is dark; the rest is the same to the bit.
    #[test]
    fn recentering_moves_by_whole_pixels() {
        let planes = spot(20, (12.0, 7.0));
        let (moved, by) = recenter(planes.clone());
        assert_eq!(by, Some((-2, 3)));
        assert_eq!(moved.slice(s![.., ..18, 3..]), planes.slice(s![.., 2.., ..17]));
        assert!(moved.slice(s![.., 18.., ..]).iter().all(|&v| v == 0.0));
        assert_eq!(PsfFaults::of(&moved).unwrap().shifts, [(0, 0); 3]);
        let (same, by) = recenter(moved.clone());
        assert_eq!((same, by), (moved, None));
    }

    #[test]
    fn colours_that_lie_apart_stay_apart() {
        let mut planes = spot(21, (10.0, 10.0));
        planes.index_axis_mut(Axis(0), 2).assign(&spot(21, (10.0, 11.0)).index_axis(Axis(0), 2));
        let (kept, by) = recenter(planes.clone());
        assert_eq!((by, &kept), (None, &planes));
        let said = PsfFaults { recentered: true, ..PsfFaults::of(&kept).unwrap() }.describe().unwrap();
        assert!(said.contains("blue lies 1 px right") && said.contains("apart"), "{said}");
    }
}
