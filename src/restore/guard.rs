//! Keeps a network's corrections to what the capture allows.

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Array3, ArrayView3, Axis, Zip};

use super::cells::{between, cells, interpolated};
use super::deconvolution::Border;
use super::gentle::gentle_edges;
use crate::core::error::Result;
use crate::core::fft::{Boundary, PlaneOperator, TransformPrecision, copy_row};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage, row_of};
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::kernels::vectorised;

/// How far a correction may move the blurred scene, as a multiple of what the deconvolution leaves of the capture nearby: what
/// noise and a PSF that is a little off leave open.
const MOST_MOVED: f32 = 3.0;

/// Relative residual that is none: a capture that is explained to 80 dB is explained.
const EXPLAINED: f32 = 1e-4;

/// How much brighter than the frame what lies beyond the border may be on average: a correction may take so much light from
/// the scene, which then came from there.
const BRIGHTEST_OUTSIDE: f32 = 4.0;

/// How large a correction may be, as a multiple of the deviation that the deconvolved image is told to have nearby. Of views of
/// panoramas and painted scenes without lamps, with the noise of a sensor, most gain by it, up to 1.9 dB; of demosaiced captures, and of
/// those with lamps, whose errors are other than they are told, most would lose, up to 0.9 dB.
const MOST_CORRECTED: f32 = 0.5;

/// Light in multiples of α from which on less of corrections is taken, and none: φ is so flat there that a network's least errors are large
/// parts of the light. Of 67 nights in light of which white is 1, where α is a hundredth of it and less, 24 are 0.3 dB worse than by
/// `constrained` from 64 and 256 on, and 14 so; of 72 others the means of three sets change by -0.02 to 0.03 dB.
const FLAT: [f32; 2] = [8.0, 32.0];

/// What is known of a capture that corrections have to agree with.
pub(super) struct Guard<'a> {
    pub(super) capture: &'a LinearImage,
    pub(super) psf: &'a Psf,
    /// [`Plane::Outside`](crate::network::Plane::Outside) of the capture, if it was made.
    pub(super) outside: Option<&'a ToneMappedImage>,
    /// [`Plane::Noise`](crate::network::Plane::Noise) of the capture, where it tells the errors of the deconvolved image.
    pub(super) deviation: Option<&'a ToneMappedImage>,
    /// What the deconvolution leaves of the capture.
    pub(super) left: &'a Left,
    /// Where what saturates is little brighter than that.
    pub(super) gentle: Gentle,
    pub(super) border: Border,
    pub(super) curve: ToneCurve,
    pub(super) saturation: [f32; CHANNELS],
}

/// The shares of edges of saturated areas that are gentle, by cells.
pub(super) struct Gentle([Array2<f32>; CHANNELS]);

impl Gentle {
    /// Of a capture and the scene that a deconvolution makes of it.
    pub(super) fn of(capture: &LinearImage, scene: &LinearImage, saturation: [f32; CHANNELS]) -> Self {
        let from = saturation.map(saturated_from);
        Self(std::array::from_fn(|channel| {
            gentle_edges(capture.channel(channel), scene.channel(channel), from[channel])
        }))
    }
}

/// The squares of what a deconvolution leaves of a capture, by cells.
pub(super) struct Left([Array2<f32>; CHANNELS]);

impl Left {
    /// Of a relative residual, zero where the capture is saturated.
    pub(super) fn of(residual: ArrayView3<'_, f32>) -> Self {
        Self(std::array::from_fn(|channel| {
            let residual = residual.index_axis(Axis(0), channel);
            let mut left = cells(residual.dim(), |y, out| {
                squares(out, row_of(residual, y));
                out.iter_mut().for_each(|square| *square -= EXPLAINED.powi(2));
            });
            left.mapv_inplace(|left| left.max(0.0));
            left
        }))
    }
}

impl Guard<'_> {
    /// Takes as much of the correction from `deconvolved` to `restored` as the capture allows, and of that the part `refine`.
    ///
    /// # Equation
    /// `d + ρ·t·(r − d)` in the tone-mapped domain, `t = min(1, 3e/q, σ/2c)` in each neighbourhood of each channel: e the root mean square
    /// of what the deconvolution leaves of the capture, `(y − A d)/(y + α)`, q that over the unsaturated pixels of
    /// `max(|A(r − d)| − 4o, 0)/(y + α)` in linear light, o the light that would come from outside if that were as bright as the
    /// frame: a correction within the noise is believed as a whole, one that contradicts a capture without noise is not, unless
    /// light from beyond the border explains it. A saturated pixel tells no more than that it is bright: its correction is taken
    /// whole, t = 1, and is not in A(r − d). σ and c are the root mean squares of the deviation and of the correction: a network
    /// that was trained with captures of all kinds corrects those too much that were deconvolved well. From 8 α on less is taken, from 32 α
    /// on nothing. Light is taken from the scene beside gentle edges of saturated areas in so far as they are not gentle.
    ///
    /// # Errors
    /// Never for images of one size.
    pub(super) fn refine(
        &self,
        deconvolved: &ToneMappedImage,
        restored: ToneMappedImage,
        refine: f32,
    ) -> Result<ToneMappedImage> {
        let shares = self.shares(deconvolved, &restored)?;
        let mut planes: Array3<f32> = restored.into_planes();
        for (channel, (shares, gentle)) in shares.iter().zip(&self.gentle.0).enumerate() {
            let [deconvolved, capture] = [deconvolved.channel(channel), self.capture.channel(channel)];
            let saturated_from = saturated_from(self.saturation[channel]);
            let mut plane = planes.index_axis_mut(Axis(0), channel);
            let columns: Vec<_> = (0..plane.ncols()).map(|x| between(x, shares.ncols())).collect();
            plane.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut row)| {
                let rows = between(y, shares.nrows());
                let values = row.iter_mut().zip(deconvolved.row(y)).zip(capture.row(y));
                for (((r, d), y), columns) in values.zip(&columns) {
                    let share = if *y < saturated_from {
                        let of_haze = if *r < *d { 1.0 - interpolated(gentle, rows, *columns) } else { 1.0 };
                        interpolated(shares, rows, *columns) * steep(*d) * of_haze
                    } else {
                        1.0
                    };
                    *r = d + refine * share * (*r - d);
                }
            });
        }
        ToneMappedImage::from_planes(planes)
    }

    /// The share of the correction that is taken in each cell of each channel.
    fn shares(
        &self,
        deconvolved: &ToneMappedImage,
        restored: &ToneMappedImage,
    ) -> Result<[Array2<f32>; CHANNELS]> {
        let boundary = match self.border {
            Border::Periodic => Boundary::Periodic,
            // Beyond the border nothing is corrected.
            Border::Zero | Border::Smooth => Boundary::Zero,
        };
        let size = [self.capture.height(), self.capture.width()];
        let of_psf = [self.psf.height(), self.psf.width()];
        let operator = PlaneOperator::new(size, of_psf, boundary, TransformPrecision::Single);
        let mut moved = Array2::zeros(size);
        let mut shares: [Array2<f32>; CHANNELS] = Default::default();
        for (channel, shares) in shares.iter_mut().enumerate() {
            let [restored, deconvolved] = [restored, deconvolved].map(|image| image.channel(channel));
            let capture = self.capture.channel(channel);
            let saturated_from = saturated_from(self.saturation[channel]);
            let light = |y: usize, out: &mut [f32]| {
                let rows = [restored, deconvolved, capture].map(|plane| row_of(plane, y));
                write_correction(out, rows, (self.curve, saturated_from));
            };
            let otf = operator.transfer_function(self.psf.channel(channel), |k| k)?;
            operator.convolve(&otf, (size[0], light), (&mut moved, copy_row));
            let outside = self.outside.map(|outside| outside.channel(channel));
            let moved = cells(moved.dim(), |y, out| {
                out.copy_from_slice(row_of(moved.view(), y));
                if let Some(outside) = outside {
                    take_outside(out, row_of(outside, y), self.curve);
                }
                square_unexplained(out, row_of(capture, y), (self.curve.alpha, saturated_from));
            });
            *shares = Zip::from(&moved)
                .and(&self.left.0[channel])
                .map_collect(|moved, left| share(*moved, MOST_MOVED * MOST_MOVED * left));
            if let Some(deviation) = self.deviation.map(|deviation| deviation.channel(channel)) {
                let corrected = cells(size.into(), |y, out| {
                    let values = row_of(restored, y).iter().zip(row_of(deconvolved, y));
                    out.iter_mut().zip(values).for_each(|(out, (r, d))| *out = (r - d).powi(2));
                });
                let deviation = cells(size.into(), |y, out| squares(out, row_of(deviation, y)));
                Zip::from(shares).and(&corrected).and(&deviation).for_each(|taken, corrected, deviation| {
                    *taken = taken.min(share(*corrected, MOST_CORRECTED * MOST_CORRECTED * deviation));
                });
            }
        }
        Ok(shares)
    }
}

vectorised! {
    /// Writes by how much a row of corrected light differs from the deconvolved one; nothing where the capture is saturated.
    fn write_correction<'a>(out: &'a mut [f32], rows: [&'a [f32]; 3], known: (ToneCurve, f32)) -> () {
        let ([restored, deconvolved, capture], (curve, saturated_from)) = (rows, known);
        for (((out, r), d), y) in out.iter_mut().zip(restored).zip(deconvolved).zip(capture) {
            let moved = curve.expand(*r) - curve.expand(*d);
            *out = if *y < saturated_from { moved } else { 0.0 };
        }
    }
}

vectorised! {
    /// Takes as much of a row of changes of the blurred scene as light from outside may explain.
    fn take_outside<'a>(moved: &'a mut [f32], outside: &'a [f32], curve: ToneCurve) -> () {
        for (moved, outside) in moved.iter_mut().zip(outside) {
            *moved = (moved.abs() - BRIGHTEST_OUTSIDE * curve.expand(*outside)).max(0.0);
        }
    }
}

vectorised! {
    /// Makes of a row of changes of the blurred scene their squares over `(y + α)²`; nothing where the capture is saturated.
    fn square_unexplained<'a>(moved: &'a mut [f32], capture: &'a [f32], known: (f32, f32)) -> () {
        let (alpha, saturated_from) = known;
        for (moved, y) in moved.iter_mut().zip(capture) {
            let relative = *moved / (y.max(0.0) + alpha);
            *moved = if *y < saturated_from { relative * relative } else { 0.0 };
        }
    }
}

vectorised! {
    fn squares<'a>(out: &'a mut [f32], of: &'a [f32]) -> () {
        out.iter_mut().zip(of).for_each(|(out, value)| *out = value * value);
    }
}

/// The share of a correction of this φ that is taken, for φ is not too flat there.
fn steep(tone_mapped: f32) -> f32 {
    let [from, to] = FLAT;
    let light = tone_mapped / (1.0 - tone_mapped).max(f32::EPSILON);
    if light <= from { 1.0 } else { ((to / light).ln() / (to / from).ln()).max(0.0) }
}

/// The share of something that leaves no more than is allowed, both squared.
fn share(found: f32, allowed: f32) -> f32 {
    if found <= allowed { 1.0 } else { (allowed / found).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 64;
    const CURVE: ToneCurve = ToneCurve { alpha: 0.25, x_max: 4.0 };

    /// An even capture and a PSF of one pixel.
    fn capture_and_psf() -> (LinearImage, Psf) {
        let capture = LinearImage::from_planes(Array3::from_elem((CHANNELS, SIDE, SIDE), 0.5)).unwrap();
        (capture, Psf::from_energy(Array3::ones((CHANNELS, 1, 1))).unwrap())
    }

    /// A residual of alternating sign.
    fn residual(deviation: impl Fn(usize) -> f32) -> Left {
        let value = |(_, y, x)| if (x + y) % 2 == 0 { deviation(x) } else { -deviation(x) };
        Left::of(Array3::from_shape_fn((CHANNELS, SIDE, SIDE), value).view())
    }

    fn guard<'a>((capture, psf): &'a (LinearImage, Psf), left: &'a Left) -> Guard<'a> {
        let (border, saturation) = (Border::Zero, [4.0; CHANNELS]);
        let gentle = Gentle::of(capture, capture, saturation);
        Guard { capture, psf, outside: None, deviation: None, left, gentle, border, curve: CURVE, saturation }
    }

    /// What is taken in the first row of a network's hundredth that is added everywhere.
    fn taken(guard: &Guard<'_>, refine: f32) -> Vec<f32> {
        let deconvolved = CURVE.tone_map(guard.capture);
        let refined = guard.refine(&deconvolved, deconvolved.map_values(|v| v + 0.01), refine).unwrap();
        let pairs = refined.as_slice().iter().zip(deconvolved.as_slice());
        pairs.map(|(after, before)| after - before).take(SIDE).collect()
    }

    #[test]
    fn a_correction_within_the_noise_is_taken_and_one_that_contradicts_the_capture_is_not() {
        let known = capture_and_psf();
        let taken = |noise| taken(&guard(&known, &residual(|_| noise)), 1.0);
        assert!(taken(0.05).iter().all(|taken| (taken - 0.01).abs() < 1e-6), "{:?}", taken(0.05));
        // Three times the noise, of which a hundredth of the explained is none, in the slope of φ.
        assert!(taken(2e-4).iter().all(|taken| (1e-5..3e-4).contains(taken)), "{:?}", taken(2e-4));
    }

    /// A capture that is explained to four digits asks nothing of a network.
    #[test]
    fn what_is_explained_is_not_corrected() {
        let known = capture_and_psf();
        assert!(taken(&guard(&known, &residual(|_| 9e-5)), 1.0).iter().all(|taken| *taken == 0.0));
    }

    #[test]
    fn each_neighbourhood_has_its_own_share() {
        let known = capture_and_psf();
        let left = residual(|x| if x < SIDE / 2 { 0.0 } else { 0.05 });
        let taken = taken(&guard(&known, &left), 1.0);
        assert!(taken[0] == 0.0 && taken[7] == 0.0, "{taken:?}");
        assert!((taken[SIDE - 1] - 0.01).abs() < 1e-6 && (taken[SIDE - 12] - 0.01).abs() < 1e-6, "{taken:?}");
        assert!(taken.is_sorted(), "between them lies no edge: {taken:?}");
    }

    /// A correction of a hundredth where the deconvolution is told to be wrong by as much, and by a tenth of that.
    #[test]
    fn a_correction_is_no_larger_than_half_of_the_deviation() {
        let known = capture_and_psf();
        let left = residual(|_| 0.05);
        for (told, expected) in [(0.03, 0.01), (0.01, 0.005), (0.001, 0.0005)] {
            let deviation = CURVE.tone_map(&known.0).map_values(|_| told);
            let taken = taken(&Guard { deviation: Some(&deviation), ..guard(&known, &left) }, 1.0);
            assert!(taken.iter().all(|taken| (taken - expected).abs() < 1e-6), "{told}: {taken:?}");
        }
    }

    /// Without noise, a correction of a hundredth is believed where that may have come from outside, and there alone.
    #[test]
    fn a_correction_that_light_from_outside_explains_is_taken() {
        let known = capture_and_psf();
        let left = residual(|_| 0.0);
        let taken = |light: f32| {
            let outside = CURVE.tone_map(&known.0).map_values(|_| light);
            taken(&Guard { outside: Some(&outside), border: Border::Smooth, ..guard(&known, &left) }, 1.0)
        };
        assert!(taken(0.1).iter().all(|taken| (taken - 0.01).abs() < 1e-6), "{:?}", taken(0.1));
        assert!(taken(0.0).iter().all(|taken| *taken == 0.0), "{:?}", taken(0.0));
    }

    /// What a saturated pixel has cannot contradict the capture: it is corrected as the network says, and takes nothing from its
    /// neighbours' corrections.
    #[test]
    fn saturated_pixels_are_corrected_whole() {
        const LAMP_PX: usize = 20;
        let value = |(_, _, x)| if x < LAMP_PX { 4.0 } else { 0.5 };
        let capture = LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, SIDE, SIDE), value)).unwrap();
        let known = (capture, Psf::from_energy(Array3::ones((CHANNELS, 3, 3))).unwrap());
        let deconvolved = CURVE.tone_map(&known.0);
        let lamp = CURVE.compress(4.0);
        let corrected = deconvolved.map_values(|v| if v >= lamp { v - 0.6 } else { v + 0.01 });
        let taken = |noise: f32, refine: f32| -> Vec<f32> {
            let left = residual(|_| noise);
            let refined = guard(&known, &left).refine(&deconvolved, corrected.clone(), refine).unwrap();
            let pairs = refined.as_slice().iter().zip(deconvolved.as_slice());
            pairs.map(|(after, before)| after - before).take(SIDE).collect()
        };
        for (x, taken) in taken(0.05, 0.5).iter().enumerate() {
            let expected = if x < LAMP_PX { -0.3 } else { 0.005 };
            assert!((taken - expected).abs() < 1e-6, "{x}: {taken}");
        }
        for (x, taken) in taken(0.0, 1.0).iter().enumerate() {
            let expected = if x < LAMP_PX { -0.6 } else { 0.0 };
            assert!((taken - expected).abs() < 1e-6, "{x}: {taken}");
        }
    }

    /// Of light that saturates gently, as snow: what a network takes from around it stays, and what it adds is taken.
    #[test]
    fn no_haze_is_taken_from_what_saturates_gently() {
        const LEVEL: f32 = 1.6;
        for (beside, of_haze) in [(1.5, 0.0), (0.4, 1.0)] {
            let value = |(_, _, x)| if x < SIDE / 2 { LEVEL } else { beside };
            let capture =
                LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, SIDE, SIDE), value)).unwrap();
            let known = (capture, Psf::from_energy(Array3::ones((CHANNELS, 1, 1))).unwrap());
            let (deconvolved, left) = (CURVE.tone_map(&known.0), residual(|_| 0.05));
            for (added, share) in [(-0.01, of_haze), (0.01, 1.0)] {
                let saturation = [LEVEL; CHANNELS];
                let gentle = Gentle::of(&known.0, &known.0, saturation);
                let guard = Guard { saturation, gentle, ..guard(&known, &left) };
                let corrected = deconvolved.map_values(|v| v + added);
                let refined = guard.refine(&deconvolved, corrected, 1.0).unwrap();
                let taken = refined.channel(1)[[9, SIDE / 2 + 4]] - deconvolved.channel(1)[[9, SIDE / 2 + 4]];
                assert!((taken - share * added).abs() < 1e-6, "{beside} {added}: {taken}");
            }
        }
    }

    #[test]
    fn half_of_a_correction_is_half_of_it_and_none_is_the_deconvolution() {
        let known = capture_and_psf();
        let left = residual(|_| 0.05);
        assert!(taken(&guard(&known, &left), 0.5).iter().all(|taken| (taken - 0.005).abs() < 1e-6));
        assert!(taken(&guard(&known, &left), 0.0).iter().all(|taken| *taken == 0.0));
    }

    #[test]
    fn images_smaller_than_a_cell_and_of_any_sides_are_refined() {
        for size in [(1, 1), (3, 50), (17, 16)] {
            let (_, psf) = capture_and_psf();
            let capture = Array3::from_elem((CHANNELS, size.0, size.1), 0.5);
            let left = Left::of(Array3::from_elem((CHANNELS, size.0, size.1), 0.05).view());
            let known = (LinearImage::from_planes(capture).unwrap(), psf);
            assert!(
                taken(&guard(&known, &left), 1.0).iter().all(|taken| (taken - 0.01).abs() < 1e-6),
                "{size:?}"
            );
        }
    }
}
