//! Estimates how noisy a capture is, from its finest diagonal detail.

use std::f64::consts::TAU;

use ndarray::{Array2, ArrayView2, Axis, Zip};
use rustfft::num_complex::Complex64;

use crate::core::image::row_of;

/// The median of the modulus of a standard normal variable.
pub(super) const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// Taps, along rows and along columns, of a band of diagonal detail: none answers to a gradient.
pub(super) struct Band(&'static [f32]);

/// Fourth differences: all but blind to what is longer than three pixels.
const FINEST: Band = Band(&[1.0, -4.0, 6.0, -4.0, 1.0]);

/// Waves of three to four pixels.
const FINE: Band = Band(&[1.0, -1.0, -1.0, 1.0]);

/// Waves of five pixels: second differences of every other pixel, smoothed.
const MIDDLE: Band = Band(&[1.0, 2.0, -1.0, -4.0, -1.0, 2.0, 1.0]);

/// All bands, from the finest on.
pub(super) const BANDS: [Band; 3] = [FINEST, FINE, MIDDLE];

/// What a capture shows in one band.
#[derive(Clone, Copy)]
pub(super) struct Detail {
    /// The robust variance d², which white noise has alike in all bands.
    pub(super) variance: f64,
    /// κ, the mean of |H|²: the part of the scene's detail that is left.
    pub(super) left: f64,
}

/// Estimates the standard deviation of the noise of `log(capture + α)`, white from pixel to pixel.
///
/// # Equation
/// With d² the squared median modulus of a band's detail and κ the mean of |H|² over it, `d² = σ² + κ·s`, s being the
/// scene's detail. Natural scenes have less of it the finer it is, and the decrease itself does not end at once:
/// `s₁ ≤ s₂·√(s₂/s₃)` over the finest three bands, which gives `σ² = max(0, d₁² − κ₁·s₂·min(1, √(s₂/s₃)))` with
/// `sᵢ = max(0, dᵢ² − d₁²)/κᵢ`. Where the PSF leaves nothing of the finest band, this is d₁, whatever the scene; where
/// it leaves much, noise-free captures have σ = 0.
///
/// Demosaicing takes noise out of the finest band, where the next one, with `s₂ ≤ s₃` alone, still shows it: the
/// greater of both estimates counts.
pub(super) fn estimate(capture: ArrayView2<'_, f32>, otf: (&[Complex64], [usize; 2]), alpha: f32) -> f64 {
    let logarithm = capture.mapv(|v| (v.max(0.0) + alpha).ln());
    let detail =
        |band: &Band| Some(Detail { variance: band.spread(&logarithm)?.powi(2), left: band.part_left(otf) });
    let (Some(finest), Some(fine), Some(middle)) = (detail(&FINEST), detail(&FINE), detail(&MIDDLE)) else {
        return 0.0;
    };
    of_details([finest, fine, middle])
}

/// The standard deviation of the noise, of what the three bands show, from the finest on, as [`estimate`] says.
pub(super) fn of_details([finest, fine, middle]: [Detail; 3]) -> f64 {
    let of_finest = noise(finest, fine, Some(middle));
    of_finest.max(noise(fine, middle, None)).sqrt()
}

/// The variance of the noise in `band`; the scene has no more detail there than in `next`, and less as it has less in
/// `next` than in `beyond`.
fn noise(band: Detail, next: Detail, beyond: Option<Detail>) -> f64 {
    // What one band has more than its neighbour is a pattern, such as that of a mosaic, and no noise.
    let variance = band.variance.min(next.variance);
    let scene = |detail: Detail| (detail.variance - variance).max(0.0) / detail.left.max(f64::MIN_POSITIVE);
    let decrease = match beyond.map(scene) {
        Some(beyond) if beyond > 0.0 => (scene(next) / beyond).sqrt().min(1.0),
        _ => 1.0,
    };
    (variance - band.left * scene(next) * decrease).max(0.0)
}

impl Band {
    /// The detail, as large as white noise itself, of each place where the taps fit.
    fn details(&self, plane: &Array2<f32>) -> Option<Array2<f32>> {
        let taps = self.0;
        let (height, width) = plane.dim();
        if height < taps.len() || width < taps.len() {
            return None;
        }
        let scale = taps.iter().map(|tap| tap * tap).sum::<f32>();
        let mut details = Array2::<f32>::zeros((height - taps.len() + 1, width - taps.len() + 1));
        let rows = plane.axis_windows(Axis(0), taps.len());
        Zip::from(details.rows_mut()).and(rows).par_for_each(|mut details, rows| {
            let mut column = vec![0.0; width];
            for (row, tap) in rows.rows().into_iter().zip(taps) {
                column.iter_mut().zip(row).for_each(|(sum, value)| *sum += tap * value);
            }
            for (detail, window) in details.iter_mut().zip(column.windows(taps.len())) {
                let sum: f32 = window.iter().zip(taps).map(|(value, tap)| value * tap).sum();
                *detail = sum / scale;
            }
        });
        Some(details)
    }

    /// Gives the details of each row where the taps fit to `visit`, as large as white noise itself, with the place in the middle of the
    /// first one's taps.
    pub(super) fn visit(&self, plane: &Array2<f32>, mut visit: impl FnMut((usize, usize), &[f32])) {
        let half = self.0.len() / 2;
        let Some(details) = self.details(plane) else { return };
        for y in 0..details.nrows() {
            visit((y + half, half), row_of(details.view(), y));
        }
    }

    /// The robust standard deviation of the detail, as large as that of white noise itself; `None` for a plane that is
    /// smaller than the taps.
    fn spread(&self, plane: &Array2<f32>) -> Option<f64> {
        let mut details = self.details(plane)?.mapv_into(f32::abs).into_raw_vec_and_offset().0;
        let middle = details.len() / 2;
        let (_, median, _) = details.select_nth_unstable_by(middle, f32::total_cmp);
        Some(f64::from(*median) / MEDIAN_OF_NORMAL)
    }

    /// The squared modulus of the taps' transfer function at frequency `k` of so many samples.
    pub(super) fn response(&self, k: usize, samples: usize) -> f64 {
        let turn =
            |(i, tap): (usize, &f32)| Complex64::cis(TAU * (k * i) as f64 / samples as f64) * f64::from(*tap);
        self.0.iter().enumerate().map(turn).sum::<Complex64>().norm_sqr()
    }

    /// The mean of |H|² over the frequencies of the band, H given with its grid.
    fn part_left(&self, (otf, [height, width]): (&[Complex64], [usize; 2])) -> f64 {
        let response = |k: usize, samples: usize| self.response(k, samples);
        let along_y: Vec<f64> = (0..height).map(|ky| response(ky, height)).collect();
        let (mut energy, mut weight) = (0.0, 0.0);
        for (kx, spectrum) in otf.chunks_exact(height).enumerate() {
            let along_x = response(kx, width);
            for (h, along_y) in spectrum.iter().zip(&along_y) {
                energy += along_x * along_y * h.norm_sqr();
                weight += along_x * along_y;
            }
        }
        energy / weight.max(f64::MIN_POSITIVE)
    }
}
