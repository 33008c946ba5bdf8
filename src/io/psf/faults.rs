//! Finds what is wrong with an energy map that is to be a PSF.

use ndarray::{Array3, Axis};

use super::floor::{FLOOR_TOLERANCE, floor_of};
use super::levels::{below_steps, saturated_core};
use super::lone::lone_pixel;
use super::noise::noise_of;
use super::place::{LOSS_TOLERANCE, MOST_LOSS, PsfMove, locate, show_share, show_shift};
use crate::core::error::{Error, Result};

/// A sum this close to one is one: each half float is off by at most 2⁻¹¹ of itself, and so is their sum.
const SUM_TOLERANCE: f64 = 1.0 / (1 << 11) as f64;

/// Negative energy, as a share of the positive, that is not worth a word.
const NEGATIVE_TOLERANCE: f64 = 1e-4;

/// Light below the least step, as a share of all, that is not worth a word. Of PSFs of two panels in steps of 8, 10, 12 and 14 bits the
/// least step has 0.075 to 0.11, 0.04 to 0.05, 0.026 to 0.04 and 0.024 to 0.027, and restorations lose 3.4, 2.5, 1.7 and 1.0 dB; of one
/// in steps of 16 bits 0.029, and 0.5 dB. Of those that are measured with several exposures it has none.
const STEP_TOLERANCE: f64 = 0.02;

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
    /// The standard deviation of noise around zero, where there is some; what that hides is replaced by local means.
    pub noise: [Option<f64>; 3],
    /// A pixel that stands alone as a hot one does: channel, row and column, and its light as a share of the peak.
    pub lone: Option<([usize; 3], f32)>,
    /// The light that all pixels would have if each had no more than the darkest of the edge, or than the darkest block there where that is
    /// plainly light, as a share of all light: a background that was not subtracted.
    pub floors: [f64; 3],
    /// Pixels of a core that is level as one that was saturated.
    pub saturated_cores: [Option<usize>; 3],
    /// About the light that is missing below the least step that the map has, as a share of all: what one exposure does not hold.
    pub below_steps: [f64; 3],
    /// How the peak of all channels together would come to the centre; none where it is there.
    pub recentring: Option<PsfMove>,
    /// Whether the peak was moved to the centre, as far as all channels can be moved together.
    pub recentered: bool,
}

impl PsfFaults {
    /// Looks at an energy map, `[3, height, width]`.
    ///
    /// The peak is the brightest pixel of the brightest 3 × 3 neighbourhood, so that a lone hot pixel does not pass for one;
    /// the centre's pixel, if none there is brighter by more than a thousandth. Of several as bright it is the point of
    /// balance.
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
        let shift = |channel: usize| locate(&of_channel(channel).mapv(f64::from)).0;
        let part = |channel: usize, is_counted: fn(f64) -> bool| {
            of_channel(channel).iter().map(|&v| f64::from(v)).filter(|&v| is_counted(v)).sum::<f64>()
        };
        let negative = |channel: usize| {
            let (below, above) = (part(channel, |v| v < 0.0), part(channel, |v| v > 0.0));
            if above > 0.0 { -below / above } else { 0.0 }
        };
        let (shifts, recentring) = rayon::join(
            || {
                let (red, (green, blue)) = rayon::join(|| shift(0), || rayon::join(|| shift(1), || shift(2)));
                [red, green, blue]
            },
            || PsfMove::of(planes),
        );
        let noise = [0, 1, 2].map(|channel| noise_of(of_channel(channel)));
        Ok(Self {
            size: [height, width],
            shifts,
            sums: [0, 1, 2].map(|channel| part(channel, |_| true)),
            negative_shares: [0, 1, 2].map(negative),
            lone: lone_pixel(planes, noise),
            noise,
            floors: [0, 1, 2].map(|channel| floor_of(of_channel(channel))),
            saturated_cores: [0, 1, 2].map(|channel| saturated_core(of_channel(channel))),
            below_steps: [0, 1, 2].map(|channel| below_steps(of_channel(channel))),
            recentring,
            recentered: false,
        })
    }

    /// All that is wrong as one sentence that says what mends it; none without a fault.
    pub fn describe(&self) -> Option<String> {
        let faults: Vec<String> = [
            self.describe_shifts(),
            self.describe_sums(),
            self.describe_negatives(),
            self.describe_noise(),
            self.describe_floors(),
            self.describe_lone(),
            self.describe_saturated_cores(),
            self.describe_steps(),
        ]
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
        Some(match self.recentring {
            _ if self.recentered => format!(
                "its colours lie apart: with the peak of all at {centre}, that of {found}; --recenter moves all colours \
                 together"
            ),
            None => format!(
                "its colours lie apart: with the peak of all at {centre}, that of {found}; every image would be fringed by \
                 as much, and --recenter, which moves all colours together, cannot mend it: measure or align each colour"
            ),
            Some(how) => {
                let apart = if self.shifts.iter().all(|shift| *shift == self.shifts[0]) {
                    ""
                } else {
                    "; colours that lie apart stay so"
                };
                format!(
                    "its peak is off {centre}: {found}; every image would be shifted by as much, {}{apart}",
                    advise(how)
                )
            }
        })
    }

    fn describe_sums(&self) -> Option<String> {
        let is_off = |channel: usize| (self.sums[channel] - 1.0).abs() > SUM_TOLERANCE;
        let found = by_channel(is_off, |channel| format!("sums to {}", show_number(self.sums[channel])))?;
        Some(format!("{found} instead of 1 (each colour is divided by its sum)"))
    }

    fn describe_negatives(&self) -> Option<String> {
        let share = |channel: usize| format!("has {:.2} %", 100.0 * self.negative_shares[channel]);
        let is_off = |channel: usize| self.has_wrong_negatives(channel);
        let found = by_channel(is_off, share)?;
        Some(format!(
            "{found} of negative energy, which is set to zero: subtract less background, or measure with `udc fuse --point-source`"
        ))
    }

    /// Whether more of a channel's energy is negative than is worth no word, and it is no noise around zero.
    pub fn has_wrong_negatives(&self, channel: usize) -> bool {
        self.negative_shares[channel] > NEGATIVE_TOLERANCE && self.noise[channel].is_none()
    }

    /// What is to be told of noise; none where there is none.
    pub fn describe_noise(&self) -> Option<String> {
        let is_noisy = |channel: usize| {
            self.noise[channel].is_some() && self.negative_shares[channel] > NEGATIVE_TOLERANCE
        };
        let share = |channel: usize| {
            let deviation = self.noise[channel].unwrap_or_default() / self.sums[channel];
            format!("has noise of {deviation:.1e} of its light around zero")
        };
        let found = by_channel(is_noisy, share)?;
        Some(format!(
            "{found}: what it hides is replaced by local means; `udc fuse --point-source` of several exposures has less"
        ))
    }

    /// What is to be told of a pixel that stands alone; none where there is none.
    pub fn describe_lone(&self) -> Option<String> {
        let ([channel, y, x], share) = self.lone?;
        Some(format!(
            "its pixel at row {y}, column {x} has {:.1} % of the peak in {}, and neither what is beside it nor what is opposite has light, as \
             of a hot pixel, which would make ghosts: set it to its neighbours' light",
            100.0 * share,
            NAMES[channel]
        ))
    }

    /// What is to be told of a core that was saturated; none where there is none.
    pub fn describe_saturated_cores(&self) -> Option<String> {
        let pixels = |channel: usize| {
            let pixels = self.saturated_cores[channel].unwrap_or_default();
            format!("is level over {pixels} pixels")
        };
        let found = by_channel(|channel| self.saturated_cores[channel].is_some(), pixels)?;
        Some(format!(
            "its core was saturated as it was measured, as it seems ({found}), so that its flare is too strong beside it, and images lose \
             5 dB and more: measure with shorter exposures too (`udc fuse --point-source`)"
        ))
    }

    /// What is to be told of light below the least step; none where there is little.
    pub fn describe_steps(&self) -> Option<String> {
        let share = |channel: usize| format!("about {:.0} %", 100.0 * self.below_steps[channel]);
        let found = by_channel(|channel| self.below_steps[channel] > STEP_TOLERANCE, share)?;
        Some(format!(
            "it has the steps of one exposure, and what is fainter than the least of them is missing ({found} of its light, of which lamps make \
             haze): measure with longer exposures too (`udc fuse --point-source`)"
        ))
    }

    /// What is to be told of a background; none where there is none.
    pub fn describe_floors(&self) -> Option<String> {
        let share = |channel: usize| format!("{:.1} %", 100.0 * self.floors[channel]);
        let found = by_channel(|channel| self.floors[channel] > FLOOR_TOLERANCE, share)?;
        Some(format!(
            "its edge is nowhere dark, as if a background were left in it ({found} of its light): subtract it, or measure with `udc fuse \
             --point-source`; restored images would be too dark"
        ))
    }
}

/// What mends a peak that is off the centre.
fn advise(how: PsfMove) -> String {
    let lost = show_share(how.lost);
    if how.is_rolled {
        "as in the layout of a Fourier transform, which begins with the centre: add --recenter to roll it to the middle, \
         which loses nothing"
            .to_owned()
    } else if how.lost > MOST_LOSS {
        format!(
            "and --recenter is no help, since {lost} of its light would leave the frame: crop the PSF around its peak, or \
             measure it again with the peak in the middle"
        )
    } else if how.lost > LOSS_TOLERANCE {
        format!("add --recenter to move it there, where {lost} of its light leaves the frame and is lost")
    } else {
        "add --recenter to move it there".to_owned()
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

#[cfg(test)]
mod tests {
    use ndarray::{Array2, s};

    use super::super::place::recenter;
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

    fn by(how: Option<PsfMove>) -> Option<(isize, isize)> {
        how.map(|how| how.by)
    }

    /// What leaves the frame is lost, what comes in is dark; the rest is the same to the bit.
    #[test]
    fn recentering_moves_by_whole_pixels() {
        let planes = spot(20, (12.0, 7.0));
        let (moved, how) = recenter(planes.clone()).unwrap();
        assert_eq!(by(how), Some((-2, 3)));
        assert_eq!(moved.slice(s![.., ..18, 3..]), planes.slice(s![.., 2.., ..17]));
        assert!(moved.slice(s![.., 18.., ..]).iter().all(|&v| v == 0.0));
        assert_eq!(PsfFaults::of(&moved).unwrap().shifts, [(0, 0); 3]);
        let (same, how) = recenter(moved.clone()).unwrap();
        assert_eq!((same, how), (moved, None));
    }

    /// As `numpy.fft.ifftshift` writes it: the centre, index N // 2, comes to row 0 and column 0.
    fn with_centre_first(planes: &Array3<f32>) -> Array3<f32> {
        let (_, height, width) = planes.dim();
        Array3::from_shape_fn(planes.dim(), |(channel, y, x)| {
            planes[[channel, (y + height / 2) % height, (x + width / 2) % width]]
        })
    }

    #[test]
    fn a_psf_in_the_layout_of_a_fourier_transform_is_rolled_and_loses_nothing() {
        // A point between pixels has a core whose four pixels lie in all four corners.
        for (size, at) in [(20, 0.0), (21, 0.0), (20, 1.0), (21, -2.0), (64, -0.5)] {
            let middle = (size / 2) as f64;
            let whole = spot(size, (middle, middle + at));
            let corner = with_centre_first(&whole);
            let said = PsfFaults::of(&corner).unwrap().describe().unwrap();
            assert!(said.contains("--recenter to roll it"), "{size}: {said}");
            let (rolled, how) = recenter(corner).unwrap();
            assert!(how.is_some_and(|how| how.is_rolled && how.lost == 0.0), "{size}, {at}: {how:?}");
            let expected = recenter(whole.clone()).unwrap().0;
            assert!((rolled.sum() - whole.sum()).abs() < 1e-5, "{size}, {at}");
            let difference = (&rolled - &expected).mapv(f32::abs);
            assert!(difference.iter().all(|&v| v < 1e-3), "{size}, {at}: the tails alone may differ");
        }
        let mut level = Array3::zeros((3, 20, 20));
        level.slice_mut(s![.., 9..11, 9..11]).fill(0.25);
        let corner = with_centre_first(&level);
        assert!(
            PsfFaults::of(&corner).unwrap().describe().is_some(),
            "four equal corners balance in the middle"
        );
        assert_eq!(recenter(corner).unwrap().0, level);
    }

    #[test]
    fn recentering_that_would_cut_off_light_is_refused_and_not_advised() {
        // Nine rows leave the frame as row 1 comes to row 10: 160 pixels of 0.001.
        let mut planes = spot(20, (1.0, 10.0));
        planes.slice_mut(s![.., 12.., ..]).fill(1e-3);
        let said = PsfFaults::of(&planes).unwrap().describe().unwrap();
        assert!(said.contains("--recenter is no help") && said.contains("crop the PSF"), "{said}");
        let refused = recenter(planes).unwrap_err().to_string();
        assert!(
            refused.contains("would lose") && refused.contains("crop the PSF around its peak"),
            "{refused}"
        );

        // Moved two pixels down, row 19 leaves the frame and row 0 does not.
        for (row, lost) in [(0, 0.0), (19, 0.01 / 1.01)] {
            let mut planes = spot(20, (8.0, 10.0));
            planes.slice_mut(s![.., row, 10]).fill(0.01);
            let said = PsfFaults::of(&planes).unwrap().describe().unwrap();
            assert_eq!(said.contains("to move it there, where 1.0 % of its light"), lost > 0.0, "{said}");
            let how = recenter(planes).unwrap().1.unwrap();
            assert!((how.lost - lost).abs() < 1e-4, "{how:?}");
        }
    }

    /// A grating's two orders, of one brightness: their middle is the centre.
    #[test]
    fn a_symmetric_double_peak_around_the_centre_is_no_fault() {
        for (size, columns) in [(21, [9, 11]), (21, [4, 16]), (20, [8, 12])] {
            let mut planes = Array3::zeros((3, size, size));
            columns.iter().for_each(|&column| planes.slice_mut(s![.., size / 2, column]).fill(0.5_f32));
            assert_eq!(PsfFaults::of(&planes).unwrap().describe(), None, "{columns:?} of {size}");
            assert_eq!(recenter(planes.clone()).unwrap(), (planes, None));
        }
        let mut planes = Array3::zeros((3, 21, 21));
        [12, 14].iter().for_each(|&column| planes.slice_mut(s![.., 10, column]).fill(0.5_f32));
        assert_eq!(PsfFaults::of(&planes).unwrap().shifts, [(0, 3); 3]);
        let (moved, how) = recenter(planes).unwrap();
        assert_eq!((by(how), moved[[0, 10, 9]], moved[[0, 10, 11]]), (Some((0, -3)), 0.5, 0.5));
    }

    #[test]
    fn colours_that_lie_apart_stay_apart() {
        let mut planes = spot(21, (10.0, 10.0));
        planes.index_axis_mut(Axis(0), 2).assign(&spot(21, (10.0, 11.0)).index_axis(Axis(0), 2));
        let (kept, how) = recenter(planes.clone()).unwrap();
        assert_eq!((how, &kept), (None, &planes));
        let before = PsfFaults::of(&planes).unwrap().describe().unwrap();
        assert!(before.contains("blue lies 1 px right") && before.contains("cannot mend it"), "{before}");
        let said = PsfFaults { recentered: true, ..PsfFaults::of(&kept).unwrap() }.describe().unwrap();
        assert!(said.contains("blue lies 1 px right") && said.contains("apart"), "{said}");
    }

    /// A tenth of all light is even, or all of it; and an edge that is dark in some corner, and a core that fills its frame.
    #[test]
    fn a_background_that_was_left_in_is_told() {
        let lobe = |side: usize, width: f32| {
            Array3::from_shape_fn((3, side, side), |(_, y, x)| {
                let centre = (side / 2) as f32;
                (-(y as f32 - centre).hypot(x as f32 - centre) / width).exp()
            })
        };
        let normalised = |planes: Array3<f32>| {
            let sum = planes.sum() / 3.0;
            planes / sum
        };
        let whole = normalised(lobe(41, 2.0));
        assert_eq!(PsfFaults::of(&whole).unwrap().describe(), None);
        let background = normalised(&whole + 0.1 / (41.0 * 41.0));
        let faults = PsfFaults::of(&background).unwrap();
        assert!(faults.floors.iter().all(|floor| (floor - 0.0909).abs() < 2e-3), "{:?}", faults.floors);
        assert!(faults.describe().unwrap().contains("every colour 9.1 %"), "{:?}", faults.describe());
        let mut cut = background.clone();
        cut.slice_mut(s![.., 0..8, 0..8]).fill(0.0);
        assert_eq!(PsfFaults::of(&cut).unwrap().floors, [0.0; 3]);
        // As of noise that was cut at zero.
        let mut noisy = background;
        noisy.slice_mut(s![.., ..;3, ..;2]).fill(0.0);
        let floors = PsfFaults::of(&noisy).unwrap().floors;
        assert!(floors.iter().all(|floor| (0.06..0.1).contains(floor)), "{floors:?}");
        assert_eq!(PsfFaults::of(&normalised(lobe(21, 20.0))).unwrap().floors, [0.0; 3]);
        let even = PsfFaults::of(&normalised(Array3::ones((3, 41, 41)))).unwrap();
        assert!(even.describe().unwrap().contains("every colour 100.0 %"), "{:?}", even.describe());
    }
}
