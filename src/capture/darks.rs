//! Turns dark frames into what is subtracted from each exposure, and finds the pixels that shine in them.

use ndarray::parallel::prelude::{
    IndexedParallelIterator as _, IntoParallelIterator as _, ParallelIterator as _,
};
use ndarray::{Array2, Array3, ArrayView2, Axis, Zip};

use super::bracket::show_time;
use super::exposure_times::SAME_TIME;
use super::fuse::FuseConfig;
use super::scaling::{BELOW_BLACK, scaled_frames};
use crate::core::error::{Error, Result};

/// Pictures that were taken without light.
#[derive(Clone, Debug)]
pub(super) struct DarkFrames {
    frames: Vec<Array3<f32>>,
    /// As shares of the bracket's longest, where they are known.
    times: Option<Vec<f64>>,
}

/// What the sensor reads without light.
pub(super) struct Darks {
    /// One for all exposures, or one of each.
    darks: Vec<Dark>,
}

struct Dark {
    mean: Array3<f32>,
    /// The pixels that stand out of it.
    hot: Array3<bool>,
}

/// A frame whose median lies above this share of white, or of which more than this share is saturated, has seen light.
const BRIGHTEST_MEDIAN: f32 = 0.25;
const MOST_SATURATED: f64 = 0.01;
/// A pixel is hot that differs from its neighbours by so many standard deviations: of 10⁸ noisy pixels, none does.
const HOT: f32 = 8.0;
/// Less than this share of white does no harm once it is subtracted: some electrons, and their noise is smaller still.
const WARM: f32 = 1e-3;

impl DarkFrames {
    /// Checks that the frames fit to pictures of this shape.
    pub(super) fn new(
        frames: Vec<Array3<f32>>,
        times: Option<Vec<f64>>,
        shape @ (channels, height, width): (usize, usize, usize),
    ) -> Result<Self> {
        if frames.is_empty() {
            return Err(Error::shape("dark frames", "at least one", "none"));
        }
        for (number, frame) in (1..).zip(&frames) {
            if frame.dim() != shape {
                let (c, h, w) = frame.dim();
                return Err(Error::shape(
                    format!("dark frame {number}"),
                    format!("{channels} channels of {height} × {width} like the pictures"),
                    format!("{c} channels of {h} × {w}"),
                ));
            }
        }
        if let Some(times) = &times {
            if times.len() != frames.len() {
                let expected = format!("{}, one for each exposure time of theirs", times.len());
                return Err(Error::shape("dark frames", expected, format!("{}", frames.len())));
            }
            if let Some(time) = times.iter().find(|time| !(time.is_finite() && **time > 0.0)) {
                return Err(Error::config("dark-exposures", format!("must be positive times, found {time}")));
            }
        }
        Ok(Self { frames, times })
    }
}

impl Darks {
    /// Levels the frames like pictures, and averages those of each exposure time.
    ///
    /// # Errors
    /// [`Error::Config`] for frames that saw light, and for exposures without dark frame; [`Error::Unsupported`] for
    /// values that are not finite and that no mask discards.
    pub(super) fn of(
        darks: DarkFrames,
        times: &[f64],
        valid: Option<&Array2<bool>>,
        config: &FuseConfig,
    ) -> Result<Self> {
        let DarkFrames { frames, times: own_times } = darks;
        let mut frames = scaled_frames(frames, config)?;
        for (number, frame) in (1..).zip(&mut frames) {
            check_dark(frame, number, valid, config.saturation)?;
        }
        let dark = |frames: &[&Array3<f32>]| Dark::of(frames, if config.bayer.is_some() { 2 } else { 1 });
        let Some(own_times) = own_times else {
            return Ok(Self { darks: vec![dark(&frames.iter().collect::<Vec<_>>())] });
        };
        let of_time = |time: &f64| {
            let is_of_time = |(_, own): &(_, &f64)| (*own / time - 1.0).abs() <= SAME_TIME;
            let frames: Vec<_> =
                frames.iter().zip(&own_times).filter(is_of_time).map(|(frame, _)| frame).collect();
            if frames.is_empty() {
                return Err(Error::config(
                    "dark",
                    format!(
                        "no dark frame has the exposure time {} of the longest, they have {}; take dark frames with each \
                         exposure time of the pictures",
                        show_time(*time),
                        own_times.iter().map(|time| show_time(*time)).collect::<Vec<_>>().join(", ")
                    ),
                ));
            }
            Ok(dark(&frames))
        };
        Ok(Self { darks: times.iter().map(of_time).collect::<Result<_>>()? })
    }

    fn dark(&self, exposure: usize) -> &Dark {
        &self.darks[exposure.min(self.darks.len() - 1)]
    }

    /// Takes the dark frame off pictures of an exposure; saturated values stay, since they are at least as bright.
    ///
    /// # Errors
    /// [`Error::Config`] when that leaves less than nothing.
    pub(super) fn subtract(
        &self,
        pictures: &mut [Array3<f32>],
        exposure: usize,
        numbers: &[usize],
        saturation: f64,
    ) -> Result<()> {
        for (picture, number) in pictures.iter_mut().zip(numbers) {
            Zip::from(&mut *picture).and(&self.dark(exposure).mean).par_for_each(|value, dark| {
                if f64::from(*value) < saturation {
                    *value -= dark;
                }
            });
            let below = picture.iter().filter(|value| **value < -BELOW_BLACK).count();
            if 2 * below > picture.len() {
                let reason = format!(
                    "the dark frames are brighter than most of picture {number}; take them with its exposure time, ISO \
                     and warmth"
                );
                return Err(Error::config("dark", reason));
            }
        }
        Ok(())
    }

    /// Whether a value shines in the dark frame of an exposure.
    pub(super) fn is_hot(&self, exposure: usize, place: (usize, usize, usize)) -> bool {
        self.dark(exposure).hot[place]
    }

    /// How many pixels shine in a dark frame, of any exposure and in any channel.
    pub(super) fn hot_pixels(&self) -> usize {
        let (channels, height, width) = self.darks[0].hot.dim();
        let is_hot = |y, x| self.darks.iter().any(|dark| (0..channels).any(|c| dark.hot[[c, y, x]]));
        (0..height).map(|y| (0..width).filter(|&x| is_hot(y, x)).count()).sum()
    }
}

impl Dark {
    /// Averages frames and finds what stands out, photosites of one colour being `step` pixels apart.
    fn of(frames: &[&Array3<f32>], step: usize) -> Self {
        let mut mean = Array3::<f32>::zeros(frames[0].dim());
        Zip::indexed(&mut mean).par_for_each(|place, mean| {
            let sum: f64 = frames.iter().map(|frame| f64::from(frame[place])).sum();
            #[expect(clippy::cast_possible_truncation, reason = "a mean of 32-bit values")]
            let value = (sum / frames.len() as f64) as f32;
            *mean = value;
        });
        let mut hot = Array3::from_elem(mean.dim(), false);
        for (mut hot, plane) in hot.outer_iter_mut().zip(mean.outer_iter()) {
            hot.assign(&standing_out(plane, step));
        }
        Self { mean, hot }
    }
}

/// Refuses a frame that saw light or holds no numbers; what the mask discards becomes black.
fn check_dark(
    frame: &mut Array3<f32>,
    number: usize,
    valid: Option<&Array2<bool>>,
    saturation: f64,
) -> Result<()> {
    for ((c, y, x), value) in frame.indexed_iter_mut().filter(|(_, value)| !value.is_finite()) {
        if valid.is_none_or(|valid| valid[[y, x]]) {
            return Err(Error::Unsupported(format!(
                "dark frame {number} holds {value} at row {y}, column {x}, channel {c}; replace such pixels by numbers, or \
                 leave the frame out"
            )));
        }
        *value = 0.0;
    }
    let mut values: Vec<f32> = frame.iter().copied().collect();
    let saturated = values.iter().filter(|value| f64::from(**value) >= saturation).count();
    let middle = values.len() / 2;
    let median = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
    let how = if saturated as f64 > MOST_SATURATED * values.len() as f64 {
        format!("{:.0} % of it are saturated", 100.0 * saturated as f64 / values.len() as f64)
    } else if median > BRIGHTEST_MEDIAN {
        format!("half of it lies above {:.0} % of white", 100.0 * median)
    } else {
        return Ok(());
    };
    let reason = format!(
        "dark frame {number} has seen light: {how}; take it with the cap on, with the pictures' exposure time and ISO"
    );
    Err(Error::config("dark", reason))
}

/// The pixels that are brighter than their neighbours of the same colour by more than noise is, and by more than is harmless.
pub(super) fn standing_out(plane: ArrayView2<'_, f32>, step: usize) -> Array2<bool> {
    let excess = excess_over_neighbours(plane, step);
    let threshold = (HOT * spread(&excess)).max(WARM);
    excess.mapv(|excess| excess > threshold)
}

/// What a pixel is brighter by than the median of its neighbours of the same colour.
fn excess_over_neighbours(plane: ArrayView2<'_, f32>, step: usize) -> Array2<f32> {
    let mut excess = plane.to_owned();
    let reach = step.cast_signed();
    excess.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut row)| {
        let mut around = Vec::with_capacity(8);
        for (x, value) in row.iter_mut().enumerate() {
            around.clear();
            for (dy, dx) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)] {
                let place = (y.checked_add_signed(dy * reach), x.checked_add_signed(dx * reach));
                if let (Some(y), Some(x)) = place {
                    around.extend(plane.get((y, x)));
                }
            }
            if !around.is_empty() {
                let middle = around.len() / 2;
                *value -= *around.select_nth_unstable_by(middle, f32::total_cmp).1;
            }
        }
    });
    excess
}

/// The standard deviation of noise, hot pixels left out: by the median deviation, or where steps make it too small, by
/// the one that 99 % stay below.
fn spread(excess: &Array2<f32>) -> f32 {
    let mut deviations: Vec<f32> = excess.iter().map(|value| value.abs()).collect();
    let mut below = |count: usize| *deviations.select_nth_unstable_by(count, f32::total_cmp).1;
    let (half, most) = (below(excess.len() / 2), below(excess.len() * 99 / 100));
    (1.4826 * half).max(most / 2.576)
}
