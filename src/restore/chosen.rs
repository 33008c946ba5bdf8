//! Chooses between the pose that lamps tell and that of the PSF as it is given, where no noise hides which of the two is right.

use std::borrow::Cow;

use super::PoseConfig;
use super::deconvolution::{Border, noise_of_capture, window_of_pose};
use super::guided::{Posed, Whole};
use super::planes::PlaneConfig;
use super::restoration::Restoration;
use super::solved::Solved;
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::progress::Progress;
use crate::core::psf::Psf;

/// Times the pixels of the part that tells the pose from which on a capture is not solved for twice: that part is.
const LARGE: usize = 3;

impl Restoration {
    /// Solves for the scene of a capture, or of a part of one, by the PSF as it is posed there, unless what is left of a capture without
    /// noise tells that it was right before.
    pub(super) fn solved<'s>(
        &'s self,
        image: &LinearImage,
        posed: &mut Posed<'s>,
        Whole { planes, parted, .. }: &Whole<'_>,
        progress: &Progress,
    ) -> Result<Solved> {
        let noise = parted.as_ref().map(|parted| &parted.noise);
        let own =
            Posed { psf: Cow::Borrowed(self.kernel().needed_psf()?), pose: None, has_none_outside: false };
        let part = posed.pose.as_ref().and_then(|_| part_of_pose(image, planes));
        if let Some(part) = &part
            && is_right_before((part, planes), [&own.psf, &posed.psf], &progress.without_bars())?
        {
            *posed = own;
            return Solved::of((image, &posed.psf), (planes, false), noise, progress);
        }
        let solved = Solved::of((image, &posed.psf), (planes, posed.has_none_outside), noise, progress)?;
        if part.is_none() && posed.pose.is_some() && solved.solution.is_clean() {
            let unmoved = Solved::of((image, &own.psf), (planes, false), noise, progress)?;
            if unmoved.left() < solved.left() {
                *posed = own;
                return Ok(unmoved);
            }
        }
        Ok(solved)
    }
}

/// The part of a large capture that tells the pose.
fn part_of_pose(image: &LinearImage, planes: &PlaneConfig) -> Option<LinearImage> {
    let config =
        PoseConfig { alpha: planes.curve.alpha, saturation: planes.saturation, least_move: [0.0; 2] };
    let window = window_of_pose(image, &config)?;
    let is_large = image.height() * image.width() > LARGE * window.height * window.width;
    is_large.then(|| image.crop(window.top, window.left, window.height, window.width))
}

/// Whether a part of a capture has no noise, and less is left of it by the first PSF than by the second.
fn is_right_before(
    (part, planes): (&LinearImage, &PlaneConfig),
    [before, posed]: [&Psf; 2],
    progress: &Progress,
) -> Result<bool> {
    // Whatever is around the capture, there is more of it around the part.
    let planes = PlaneConfig { border: Border::Smooth, ..*planes };
    let noise = noise_of_capture(part, before, &planes.deconvolution(), [part.height(), part.width()])?;
    if !noise.is_clean() {
        return Ok(false);
    }
    let left = |psf: &Psf| Ok(Solved::of((part, psf), (&planes, true), Some(&noise), progress)?.left());
    Ok(left(before)? < left(posed)?)
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3};
    use rand::RngExt as _;

    use super::*;
    use crate::codes::MeasurementErrors;
    use crate::core::fft::{Boundary, Convolver};
    use crate::core::image::CHANNELS;
    use crate::core::rng::stream;
    use crate::core::tone::ToneCurve;

    /// Of a capture without noise, and of a part of a large one; one with some is not asked.
    #[test]
    fn what_is_left_of_a_clean_capture_tells_the_right_psf() {
        let plane = Array2::from_shape_fn((65, 65), |(y, x)| {
            let squares = (y as f32 - 32.0).powi(2) + (x as f32 - 32.0).powi(2);
            let is_order = y.abs_diff(32) % 8 == 0 && x.abs_diff(32) % 8 == 0;
            (-squares / 0.8).exp() + if is_order { 1e-3 } else { 1e-5 } * (-squares.sqrt() / 12.0).exp()
        });
        let of_channels = |plane: Array2<f32>| {
            Array3::from_shape_fn((CHANNELS, plane.nrows(), plane.ncols()), |(_, y, x)| plane[[y, x]])
        };
        let psf = Psf::from_energy(of_channels(&plane / plane.sum())).unwrap();
        let errors = MeasurementErrors { scale: 0.002, ..MeasurementErrors::default() };
        let moved = errors.apply(&psf, &mut stream(0, "moved")).unwrap();
        let scene = Array2::from_shape_fn((96, 96), |(y, x)| match (y, x) {
            (20..40, 50..80) => 1.5,
            (60..63, 30..33) => 40.0,
            _ => 0.2 + 0.05 * ((y as f32 / 9.0).sin() + (x as f32 / 7.0).cos()),
        });
        let convolver = Convolver::new([96, 96], [65, 65], Boundary::Zero).unwrap();
        let seen =
            convolver.convolve_plane(scene.view(), &convolver.kernel_spectrum(psf.channel(0)).unwrap());
        let image = LinearImage::from_planes(of_channels(seen)).unwrap();
        let curve = ToneCurve::default();
        let planes = PlaneConfig {
            curve,
            border: Border::Zero,
            saturation: [curve.x_max; CHANNELS],
            noise: None,
            coding_error: None,
        };
        let solved =
            |psf: &Psf| Solved::of((&image, psf), (&planes, false), None, &Progress::default()).unwrap();
        let (right, wrong) = (solved(&psf), solved(&moved));
        assert!(right.solution.is_clean());
        assert!(right.left() < wrong.left(), "{} {}", right.left(), wrong.left());

        let is_right_before =
            |image, psfs| is_right_before((image, &planes), psfs, &Progress::default()).unwrap();
        assert!(is_right_before(&image, [&psf, &moved]) && !is_right_before(&image, [&moved, &psf]));
        let mut random = stream(0, "noise");
        let noisy = image
            .planes()
            .to_owned()
            .mapv_into(|light| light * (1.0 + 0.03 * (random.random::<f32>() - 0.5)));
        assert!(!is_right_before(&LinearImage::from_planes(noisy).unwrap(), [&psf, &moved]));
    }

    /// Captures of 1.5 million pixels are solved for once.
    #[test]
    fn large_captures_are_judged_by_a_part() {
        let of_lamp = |[height, width]: [usize; 2]| {
            let light =
                |(_, y, x)| if (100..104).contains(&y) && (900..904).contains(&x) { 20.0 } else { 0.1 };
            LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, height, width), light)).unwrap()
        };
        let curve = ToneCurve::default();
        let saturation = [16.0; CHANNELS];
        let planes = PlaneConfig { curve, border: Border::Zero, saturation, noise: None, coding_error: None };
        assert!(part_of_pose(&of_lamp([600, 1000]), &planes).is_none());
        let part = part_of_pose(&of_lamp([1400, 1200]), &planes).unwrap();
        assert_eq!([part.height(), part.width()], [704; 2]);
        assert!(part.max() > 16.0, "the lamp is in it");
    }
}
