//! Turns light that noise hides into its local mean, so that clipping it at zero lifts nothing.

use ndarray::{Array2, ArrayView2, Zip};

/// How many standard deviations a pixel or a square must reach to stand out of the noise: of 10⁶ noisy pixels, 32 do by
/// chance, and what they hold too much of the others hold too little.
const STANDS_OUT: f64 = 4.0;
/// Over how many grids of squares the result is averaged, so that no border of squares is seen.
const GRIDS: usize = 16;
/// How far grids are shifted at most; larger squares hold light that changes less.
const LARGEST_SHIFT: f64 = 256.0;

/// The noise of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Noise {
    /// Standard deviation of a pixel.
    pub(crate) of_pixel: f64,
    /// That of a mean of n pixels, times √n: more than a pixel's where neighbours have noise in common, as
    /// demosaicing leaves it.
    pub(crate) of_means: f64,
}

/// Replaces light below the noise by its mean over the smallest square in which that mean stands out.
///
/// Clipped at zero pixel by pixel, noise of standard deviation σ lifts faint light by up to σ/√2π. The sum over a square
/// is not lifted; clipping is left to where even that is negative.
///
/// # Method
/// 1. Pixels above 4 σ stay as they are.
/// 2. Of all others, the sum over squares of 2 × 2 is looked at, then over 4 × 4, and so on. Where the n pixels of a
///    square that are left have a sum above 4 σ √n, each becomes their mean, and leaves.
/// 3. What stands out nowhere becomes the mean of all of that, or zero where it is negative.
/// 4. The results of 16 grids of squares that are shifted against each other are averaged.
///
/// Each step keeps the sum of the light that it changes, but for the last clip.
pub(crate) fn average_below_noise(light: ArrayView2<'_, f64>, noise: Noise) -> Array2<f64> {
    let stays = light.mapv(|value| value > STANDS_OUT * noise.of_pixel && value > 0.0);
    let mut means = Array2::zeros(light.dim());
    for index in 0..GRIDS {
        // Multiples of powers of the plastic number: places that are spread evenly, however many there are.
        let shift = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2].map(|step| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 256")]
            let shift = ((index as f64 * step).fract() * LARGEST_SHIFT) as usize;
            shift
        });
        add_means_of_squares(&mut means, (light, &stays), shift, STANDS_OUT * noise.of_means);
    }
    Zip::from(&mut means).and(light).and(&stays).for_each(|mean, &value, &stays| {
        *mean = if stays { value } else { *mean / GRIDS as f64 };
    });
    means
}

/// Replaces light below white noise of standard deviation `deviation` by local means, as a measurement does.
pub(crate) fn without_noise(light: ArrayView2<'_, f64>, deviation: f64) -> Array2<f64> {
    average_below_noise(light, Noise { of_pixel: deviation, of_means: deviation })
}

/// Adds to every pixel that does not stay the mean of its square, on one grid.
fn add_means_of_squares(
    means: &mut Array2<f64>,
    (light, stays): (ArrayView2<'_, f64>, &Array2<bool>),
    [down, right]: [usize; 2],
    threshold: f64,
) {
    let (height, width) = light.dim();
    let mut left = Array2::from_elem((down + height, right + width), (0.0, 0));
    for ((y, x), &value) in light.indexed_iter().filter(|(place, _)| !stays[*place]) {
        left[[down + y, right + x]] = (value, 1);
    }
    // The means that squares of each size became, from 2 × 2 on.
    let mut levels: Vec<Array2<Option<f64>>> = Vec::new();
    while left.len() > 1 {
        left = joined(&left);
        let is_last = left.len() == 1;
        let became = |(sum, count): &mut (f64, u32)| {
            let stands_out = *sum > 0.0 && *sum > threshold * f64::from(*count).sqrt();
            let mean = (*count > 0 && (stands_out || is_last)).then(|| (*sum / f64::from(*count)).max(0.0));
            if mean.is_some() {
                (*sum, *count) = (0.0, 0);
            }
            mean
        };
        let flat = left.iter_mut().map(became).collect();
        levels.push(Array2::from_shape_vec(left.dim(), flat).expect("one mean of each square"));
    }
    for ((y, x), sum) in means.indexed_iter_mut().filter(|(place, _)| !stays[*place]) {
        let mut sizes = (1..).zip(&levels);
        let mean = sizes.find_map(|(k, level)| level[[(down + y) >> k, (right + x) >> k]]);
        *sum += mean.unwrap_or_else(|| light[[y, x]].max(0.0));
    }
}

/// The sums and numbers of squares twice as large.
fn joined(left: &Array2<(f64, u32)>) -> Array2<(f64, u32)> {
    let (height, width) = left.dim();
    let mut joined = Array2::from_elem((height.div_ceil(2), width.div_ceil(2)), (0.0, 0));
    for ((y, x), &(sum, count)) in left.indexed_iter() {
        let (total, pixels) = &mut joined[[y / 2, x / 2]];
        *total += sum;
        *pixels += count;
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng::stream;
    use rand_distr::{Distribution as _, Normal};

    const NOISE: Noise = Noise { of_pixel: 1.0, of_means: 1.0 };

    /// Haze of half the noise in a disc, a lobe of four pixels, darkness around.
    fn light(y: usize, x: usize) -> f64 {
        let squared = (y as f64 - 150.0).powi(2) + (x as f64 - 140.0).powi(2);
        let haze = if squared < 100.0 * 100.0 { 0.5 } else { 0.0 };
        if (60..62).contains(&y) && (70..72).contains(&x) { 25.0 } else { haze }
    }

    fn noisy(seed: u64) -> Array2<f64> {
        let mut rng = stream(seed, "haze");
        let normal = Normal::new(0.0, 1.0).unwrap();
        Array2::from_shape_fn((300, 280), |(y, x)| light(y, x) + normal.sample(&mut rng))
    }

    #[test]
    fn the_sum_of_light_is_kept_and_nothing_is_negative() {
        for seed in 0..4 {
            let noisy = noisy(seed);
            let averaged = average_below_noise(noisy.view(), NOISE);
            assert!(averaged.iter().all(|value| *value >= 0.0));
            // What is below 4 σ by chance is at most some ten pixels of 4 σ, of a sum of 15 700.
            let [before, after] = [noisy.sum(), averaged.sum()];
            assert!((after / before - 1.0).abs() < 0.003, "{after} instead of {before}");
            let clipped = noisy.mapv(|v| v.max(0.0)).sum();
            assert!(clipped > 1.8 * before, "clipping alone makes {clipped} of {before}");
        }
    }

    #[test]
    fn a_lobe_above_the_noise_stays_as_it_is() {
        let noisy = noisy(9);
        let averaged = average_below_noise(noisy.view(), NOISE);
        for place in [[60, 70], [60, 71], [61, 70], [61, 71]] {
            assert_eq!(averaged[place], noisy[place]);
        }
        // 64 pixels of half the noise stand out: within the disc the mean of some hundred pixels is left of noise.
        let inside = averaged.slice(ndarray::s![120..180, 110..170]);
        let deviation = inside.mapv(|v| (v - 0.5).powi(2)).mean().unwrap().sqrt();
        assert!(deviation < 0.15, "{deviation}");
    }

    #[test]
    fn light_without_noise_stays_but_for_what_is_negative() {
        let light = Array2::from_shape_fn((37, 23), |(y, x)| (y as f64 * 0.3).sin() + x as f64 * 0.1);
        let averaged = average_below_noise(light.view(), Noise { of_pixel: 0.0, of_means: 0.0 });
        let is_clipped = |(found, light): (&f64, &f64)| *found == light.max(0.0);
        assert!(averaged.iter().zip(&light).all(is_clipped));
    }
}
