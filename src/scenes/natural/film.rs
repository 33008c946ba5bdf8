//! Turns filled outlines into an image: a grid of samples finer than the pixels, averaged when the film is developed.
//!
//! Positions are `[x, y]` in pixels, x to the right and y downwards, from the image's left top corner.

use ndarray::Array3;

use super::light::{Rgb, luminance};
use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage};

/// A position: x and y in pixels.
pub(super) type Point = [f32; 2];

/// Samples per pixel and axis.
pub(super) const SAMPLES: usize = 2;

/// Light that falls on a grid of samples.
pub(super) struct Film {
    height: usize,
    width: usize,
    /// Rows of samples.
    pub(super) samples: Vec<Rgb>,
    crossings: Vec<f32>,
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "indices of samples are far below 2²⁴, and clamped to the film"
)]
impl Film {
    /// A dark film for an image of height and width.
    pub(super) fn new([height, width]: [usize; 2]) -> Self {
        let samples = vec![[0.0; CHANNELS]; height * width * SAMPLES * SAMPLES];
        Self { height, width, samples, crossings: Vec::new() }
    }

    /// Height and width in pixels.
    pub(super) fn size(&self) -> [f32; 2] {
        [self.height as f32, self.width as f32]
    }

    /// Rows and columns of samples.
    pub(super) fn grid(&self) -> [usize; 2] {
        [self.height * SAMPLES, self.width * SAMPLES]
    }

    /// The samples from one position to another along an axis of `count` samples.
    fn range(from: f32, to: f32, count: usize) -> std::ops::Range<usize> {
        let index = |at: f32| ((at * SAMPLES as f32 - 0.5).ceil().max(0.0) as usize).min(count);
        index(from)..index(to)
    }

    /// The luminance at a position, 0 outside of the film.
    pub(super) fn brightness(&self, [x, y]: Point) -> f32 {
        let [rows, columns] = self.grid();
        let (row, column) = (y * SAMPLES as f32, x * SAMPLES as f32);
        let is_inside = (0.0..rows as f32).contains(&row) && (0.0..columns as f32).contains(&column);
        if is_inside { luminance(&self.samples[row as usize * columns + column as usize]) } else { 0.0 }
    }

    /// Changes every sample within `[left, top, right, bottom]`, given its position.
    pub(super) fn within(
        &mut self,
        [left, top, right, bottom]: [f32; 4],
        mut change: impl FnMut(Point, &mut Rgb),
    ) {
        let [rows, columns] = self.grid();
        for row in Self::range(top, bottom, rows) {
            let y = (row as f32 + 0.5) / SAMPLES as f32;
            for column in Self::range(left, right, columns) {
                change(
                    [(column as f32 + 0.5) / SAMPLES as f32, y],
                    &mut self.samples[row * columns + column],
                );
            }
        }
    }

    /// Changes every sample.
    pub(super) fn all(&mut self, change: impl FnMut(Point, &mut Rgb)) {
        let [height, width] = self.size();
        self.within([0.0, 0.0, width, height], change);
    }

    /// Changes every sample inside of a closed outline, by the even–odd rule.
    pub(super) fn fill(&mut self, outline: &[Point], mut change: impl FnMut(Point, &mut Rgb)) {
        let [rows, columns] = self.grid();
        let bound =
            |value: f32, [_, y]: &Point, least: bool| if least { value.min(*y) } else { value.max(*y) };
        let top = outline.iter().fold(f32::INFINITY, |value, point| bound(value, point, true));
        let bottom = outline.iter().fold(f32::NEG_INFINITY, |value, point| bound(value, point, false));
        let mut crossings = std::mem::take(&mut self.crossings);
        for row in Self::range(top, bottom, rows) {
            let y = (row as f32 + 0.5) / SAMPLES as f32;
            crossings.clear();
            let mut last = outline[outline.len() - 1];
            for &point in outline {
                if (last[1] <= y) != (point[1] <= y) {
                    crossings.push(last[0] + (y - last[1]) / (point[1] - last[1]) * (point[0] - last[0]));
                }
                last = point;
            }
            crossings.sort_unstable_by(f32::total_cmp);
            for span in crossings.chunks_exact(2) {
                for column in Self::range(span[0], span[1], columns) {
                    let at = [(column as f32 + 0.5) / SAMPLES as f32, y];
                    change(at, &mut self.samples[row * columns + column]);
                }
            }
        }
        self.crossings = crossings;
    }

    /// The brightness below which a share of the samples lies; one sample in seven is looked at.
    pub(super) fn quantile(&self, share: f32, brightness: impl Fn(&Rgb) -> f32) -> f32 {
        let mut values: Vec<f32> = self.samples.iter().step_by(7).map(brightness).collect();
        let at = ((values.len() - 1) as f32 * share) as usize;
        *values.select_nth_unstable_by(at, f32::total_cmp).1
    }

    /// The median luminance.
    pub(super) fn median(&self) -> f32 {
        self.quantile(0.5, luminance)
    }

    /// Multiplies all light.
    pub(super) fn scale(&mut self, factor: f32) {
        self.samples.iter_mut().for_each(|sample| *sample = sample.map(|value| value * factor));
    }

    /// Averages the samples to pixels.
    ///
    /// # Equation
    /// Along each axis a pixel takes its two samples with the weight 1 and the nearest sample of each neighbour with the
    /// weight `softness`: the pixel's area alone at 0, and the steeper fall towards the Nyquist frequency of a lens at
    /// 1/3, which is linear interpolation between pixels.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::core::error::Error::Shape) when a side is zero.
    pub(super) fn develop(&self, softness: f32, brightest: f32) -> Result<LinearImage> {
        let [rows, columns] = self.grid();
        let weights = [softness, 1.0, 1.0, softness].map(|weight| weight / (2.0 + 2.0 * softness));
        let mut planes = Array3::zeros((CHANNELS, self.height, self.width));
        let near =
            |at: usize, tap: usize, count: usize| (at * SAMPLES + tap).saturating_sub(1).min(count - 1);
        for y in 0..self.height {
            for x in 0..self.width {
                let mut sum = [0.0; CHANNELS];
                for (i, down) in weights.iter().enumerate() {
                    let row = &self.samples[near(y, i, rows) * columns..][..columns];
                    for (j, across) in weights.iter().enumerate() {
                        let sample = row[near(x, j, columns)];
                        (0..CHANNELS).for_each(|c| sum[c] += down * across * sample[c].min(brightest));
                    }
                }
                (0..CHANNELS).for_each(|c| planes[[c, y, x]] = sum[c]);
            }
        }
        LinearImage::from_planes(planes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_covers_its_area_and_nothing_beyond_the_film() {
        let mut film = Film::new([20, 30]);
        let triangle = [[-10.0, 4.0], [20.0, 4.0], [20.0, 16.0]];
        film.fill(&triangle, |_, sample| *sample = [1.0; 3]);
        let lit = film.samples.iter().filter(|sample| sample[0] > 0.0).count() as f32;
        // The triangle's area of 180 without the corner left of the film, 10 wide and 4 high; a rim of 58 pixels, which
        // errs by less than a tenth of a pixel each on average.
        assert!((lit / 4.0 - 160.0).abs() < 5.8, "{lit}");
    }

    #[test]
    fn developing_keeps_the_light() {
        for softness in [0.0, 0.3] {
            let mut film = Film::new([8, 9]);
            film.within([3.0, 3.0, 4.5, 5.0], |_, sample| *sample = [1.0, 2.0, 4.0]);
            let image = film.develop(softness, 1e6).unwrap();
            for (channel, value) in [3.0, 6.0, 12.0].into_iter().enumerate() {
                assert!((image.channel(channel).sum() - value).abs() < 1e-5, "{softness} {channel}");
            }
        }
    }

    #[test]
    fn a_share_of_the_samples_lies_below_its_quantile() {
        let mut film = Film::new([64, 64]);
        film.all(|[x, _], sample| *sample = [x; 3]);
        assert!((film.median() - 32.0).abs() < 0.5);
        assert!((film.quantile(0.9, |sample| sample[1]) - 57.6).abs() < 0.7);
    }
}
