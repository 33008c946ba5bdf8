//! Makes up for the noise of dark captures that their files hold nothing of below zero.
//!
//! Where light is less than the noise, up to half of the values of a sensor are below its black level. A file that holds zeros in their
//! place tells more light than there is, by up to 0.4 of the noise's standard deviation, and the darkness is restored grey.
//!
//! # Method
//! Values are those of a normal variable, censored at zero (Tobin 1958). In each neighbourhood the share of zeros and the mean tell its
//! light and its noise, which is one over all of the darkness, and zeros become what lies below them on average.

use std::ops::Range;
use std::sync::LazyLock;

use ndarray::{Array2, ArrayView2, Axis, Zip, s};

use super::deconvolution::local_mean;
use crate::core::error::Result;
use crate::core::image::LinearImage;

/// The shares of zeros in a channel between which they count: half of the values of noise alone are such, and there is no light that they
/// would tell too bright.
const ZEROS: [f64; 2] = [0.02, 0.48];

/// Standard deviation of the bell over which zeros are counted, in pixels: 200 pixels tell a share of a half to 0.04.
const NEAR_PX: f32 = 4.0;

/// The share of zeros near a pixel above which they are no noise: of darkness half of the values are below zero.
const MOST_NEAR: f32 = 0.6;

/// The part of a channel's zeros that may be noise at least.
const LEAST_OF_NOISE: f64 = 0.5;

/// How much more often than by chance the next pixel of a zero is one, too, at most: noise of pixels that were measured is independent. Of
/// eleven captures at night it is by -0.02 to 0.02.
const MOST_MORE: f64 = 0.1;

/// Pixels of which the noise is told, at most.
const MOST_SAMPLES: usize = 1 << 18;

/// Which of all deviations that neighbourhoods tell is the noise's, since what is bright beside darkness raises most of them: of nine
/// captures whose noise is more than three steps, what lies below zero is told to 7 % by it, and up to 34 % too far by the median.
const ONE_OF: usize = 10;

/// The most light, in standard deviations of the noise, whose share of zeros is told from none.
const MOST_LIGHT: f64 = 3.7;

/// What a share of zeros tells.
#[derive(Clone, Copy)]
struct Told {
    zeros: f32,
    /// The standard deviation of the noise, over the mean of the values.
    deviation: f32,
    /// The mean of what lies below zero, over the standard deviation.
    below: f32,
}

/// From the most light to none, by the share of zeros.
///
/// # Equation
/// Of light `μ = t·σ` the share of zeros is `p = Φ(−t)`, the mean of the values `σ·(t·Φ(t) + φ(t))`, and that of what lies below zero
/// `σ·(t − φ(t)/p)`.
static TOLD: LazyLock<Vec<Told>> = LazyLock::new(|| {
    const STEPS: i32 = 400;
    let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
    let step = MOST_LIGHT / f64::from(STEPS);
    // Φ(t), by Simpson's rule from the middle of the bell on.
    let mut up_to = 0.5;
    let mut table: Vec<Told> = (0..=STEPS)
        .map(|index| {
            let t = f64::from(index) * step;
            if index > 0 {
                up_to += step / 6.0 * (density(t - step) + 4.0 * density(t - 0.5 * step) + density(t));
            }
            let zeros = 1.0 - up_to;
            let of_deviation = t * up_to + density(t);
            #[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
            let [zeros, deviation, below] =
                [zeros, of_deviation.recip(), t - density(t) / zeros].map(|value| value as f32);
            Told { zeros, deviation, below }
        })
        .collect();
    table.reverse();
    table
});

impl Told {
    /// By a share of zeros; by more than darkness has, as by those of darkness.
    fn by(zeros: f32) -> Self {
        let at = TOLD.partition_point(|told| told.zeros < zeros);
        let (Some(before), Some(after)) = (at.checked_sub(1).map(|at| TOLD[at]), TOLD.get(at)) else {
            return TOLD[at.min(TOLD.len() - 1)];
        };
        let part = (zeros - before.zeros) / (after.zeros - before.zeros);
        let between = |before: f32, after: f32| before + part * (after - before);
        let deviation = between(before.deviation, after.deviation);
        Self { zeros, deviation, below: between(before.below, after.below) }
    }
}

/// The capture with what its noise has below zero, as far as it tells it.
pub(super) fn with_darkness(image: LinearImage) -> Result<LinearImage> {
    let mut planes = image.into_planes();
    for mut plane in planes.axis_iter_mut(Axis(0)) {
        let Some(noise) = Noise::of(plane.view()) else { continue };
        for Band { rows, around } in bands(plane.nrows()) {
            // Those of the band before are below zero by now.
            let near = Near::of(plane.slice(s![around.clone(), ..])).zeros;
            let near = near.slice_move(s![rows.start - around.start.., ..]);
            let band = plane.slice_mut(s![rows.clone(), ..]);
            Zip::from(band).and(near.slice(s![..rows.len(), ..])).par_for_each(|value, near| {
                if *value <= 0.0 {
                    *value = noise.below(*near);
                }
            });
        }
    }
    LinearImage::from_planes(planes)
}

/// Rows that are worked on at once, and those that these are looked at with: a large capture has no room for planes of its size.
struct Band {
    rows: Range<usize>,
    around: Range<usize>,
}

fn bands(height: usize) -> impl Iterator<Item = Band> {
    const ROWS: usize = 256;
    /// More than a bell reaches.
    const REACH: usize = 24;
    (0..height.div_ceil(ROWS)).map(move |band| {
        let rows = band * ROWS..((band + 1) * ROWS).min(height);
        let around = rows.start.saturating_sub(REACH)..(rows.end + REACH).min(height);
        Band { rows, around }
    })
}

/// What there is around each pixel: the share of zeros, and the mean of the values.
struct Near {
    zeros: Array2<f32>,
    means: Array2<f32>,
}

impl Near {
    fn of(plane: ArrayView2<'_, f32>) -> Self {
        let zeros = local_mean(&plane.mapv(|value| if value <= 0.0 { 1.0 } else { 0.0 }), NEAR_PX);
        Self { zeros, means: local_mean(&plane.mapv(|value| value.max(0.0)), NEAR_PX) }
    }
}

/// The noise that zeros are of.
struct Noise {
    deviation: f32,
    /// The largest value that became zero by rounding.
    rounded: f32,
}

impl Noise {
    /// That of a plane, if its zeros are of noise.
    fn of(plane: ArrayView2<'_, f32>) -> Option<Self> {
        let is_cut = plane.iter().all(|value| *value >= 0.0);
        let count = plane.iter().filter(|value| **value <= 0.0).count();
        let share = count as f64 / plane.len() as f64;
        if !is_cut || !(ZEROS[0]..ZEROS[1]).contains(&share) {
            return None;
        }
        let (mut zeros, mut deviations) = (Zeros::default(), Vec::new());
        for Band { rows, around } in bands(plane.nrows()) {
            let near = Near::of(plane.slice(s![around.clone(), ..]));
            for y in rows {
                zeros.count((plane, y), (&near, around.start));
            }
            let places = plane.slice(s![around, ..]);
            let places = places.iter().zip(&near.zeros).zip(&near.means);
            let of_noise = places
                .step_by(plane.len() / MOST_SAMPLES + 1)
                .filter(|((value, zeros), _)| **value <= 0.0 && **zeros <= MOST_NEAR)
                .map(|((_, zeros), mean)| Told::by(*zeros).deviation * *mean);
            deviations.extend(of_noise);
        }
        if deviations.is_empty() || !zeros.are_noise(count) {
            return None;
        }
        let place = deviations.len() / ONE_OF;
        let deviation = *deviations.select_nth_unstable_by(place, f32::total_cmp).1;
        let least = plane.iter().copied().filter(|value| *value > 0.0).fold(f32::INFINITY, f32::min);
        Some(Self { deviation, rounded: 0.5 * least })
    }

    /// What a zero stands for where there are so many.
    fn below(&self, near: f32) -> f32 {
        let below = self.rounded + Told::by(near).below * self.deviation;
        if near > MOST_NEAR { 0.0 } else { below.min(0.0) }
    }
}

/// How zeros lie, which are no more than there are values below zero.
#[derive(Default)]
struct Zeros {
    of_noise: usize,
    /// Pixels beside them, how many of those are zeros, and how many would be by chance.
    pairs: usize,
    together: f64,
    expected: f64,
}

impl Zeros {
    /// Adds those of a row; what is near is known of rows from `first` on.
    fn count(&mut self, (plane, y): (ArrayView2<'_, f32>, usize), (near, first): (&Near, usize)) {
        let (height, width) = plane.dim();
        for x in 0..width {
            if plane[[y, x]] > 0.0 || near.zeros[[y - first, x]] > MOST_NEAR {
                continue;
            }
            self.of_noise += 1;
            for [y, x] in [[y, x + 1], [y + 1, x]] {
                if y < height && x < width {
                    self.pairs += 1;
                    self.together += if plane[[y, x]] <= 0.0 { 1.0 } else { 0.0 };
                    self.expected += f64::from(near.zeros[[y - first, x]]);
                }
            }
        }
    }

    /// Whether they are noise, of so many zeros in all: most are near others as noise is, and they do not lie together.
    fn are_noise(&self, count: usize) -> bool {
        self.of_noise as f64 >= LEAST_OF_NOISE * count as f64
            && self.together - self.expected <= MOST_MORE * self.pairs as f64
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::core::image::CHANNELS;
    use crate::core::rng;

    const SIDE: usize = 96;
    const NOISE: f32 = 0.02;

    fn image(value: impl FnMut() -> f32) -> LinearImage {
        LinearImage::from_planes(Array3::from_shape_simple_fn((CHANNELS, SIDE, SIDE), value)).unwrap()
    }

    fn noisy(light: f32) -> LinearImage {
        let mut rng = rng::stream(4, "censored");
        image(|| {
            let normal: f32 = StandardNormal.sample(&mut rng);
            light + NOISE * normal
        })
    }

    fn cut(image: &LinearImage) -> LinearImage {
        image.map_values(|value| value.max(0.0))
    }

    #[test]
    fn the_mean_of_censored_noise_is_the_light() {
        for light in [0.003, 0.005, 0.01, 0.02, 0.03] {
            let cut = cut(&noisy(light));
            let mean = |image: &LinearImage| image.channel(1).mean().unwrap();
            let (before, after) = (mean(&cut), mean(&with_darkness(cut.clone()).unwrap()));
            assert!((after - light).abs() < 0.0015, "{light}: {before} {after}");
            assert!(light > 0.02 || before - light > 0.0016, "{light}: {before}");
        }
    }

    #[test]
    fn what_was_not_cut_or_is_no_noise_stays() {
        let whole = noisy(0.0);
        assert_eq!(with_darkness(whole.clone()).unwrap(), whole, "nothing was cut");
        let nothing = cut(&whole);
        assert_eq!(with_darkness(nothing.clone()).unwrap(), nothing, "noise alone");
        let bright = noisy(0.2);
        assert_eq!(with_darkness(bright.clone()).unwrap(), bright);
        let dark = image(|| 0.0);
        assert_eq!(with_darkness(dark.clone()).unwrap(), dark);
        // A picture of black and white, without noise and with bars above and below.
        let of = |light: fn(usize, usize) -> f32| {
            LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, SIDE, SIDE), |(_, y, x)| light(y, x)))
                .unwrap()
        };
        for picture in [
            of(|y, x| if (y / 5 + x / 7) % 2 == 0 { 0.0 } else { 0.8 }),
            of(|y, _| if (20..70).contains(&y) { 0.5 } else { 0.0 }),
        ] {
            assert_eq!(with_darkness(picture.clone()).unwrap(), picture);
        }
        // Pixels that were copied beside each other.
        let mut copied = cut(&noisy(0.005)).into_planes();
        for mut plane in copied.axis_iter_mut(Axis(0)) {
            for x in (1..SIDE).step_by(2) {
                let before = plane.column(x - 1).to_owned();
                plane.column_mut(x).assign(&before);
            }
        }
        let copied = LinearImage::from_planes(copied).unwrap();
        assert_eq!(with_darkness(copied.clone()).unwrap(), copied);
    }

    /// A wall in noise beside darkness that holds zeros alone: bars that were added later.
    #[test]
    fn bars_stay_black() {
        let mut planes = cut(&noisy(0.01)).into_planes();
        planes.slice_mut(ndarray::s![.., ..20, ..]).fill(0.0);
        let found = with_darkness(LinearImage::from_planes(planes).unwrap()).unwrap();
        assert!(found.planes().slice(ndarray::s![.., ..8, ..]).iter().all(|value| *value == 0.0));
        let wall = found.planes().slice(ndarray::s![.., 40.., ..]).mean().unwrap();
        assert!((wall - 0.01).abs() < 0.0015, "{wall}");
    }
}
