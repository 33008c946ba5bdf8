//! The PSF of a bank at an angle: one that is named, or the one that explains a capture.

use std::borrow::Cow;
use std::time::Instant;

use super::super::capture::Capture;
use super::super::kernel::KernelKnowledge;
use super::super::restoration::Restoration;
use super::found::find_angle;
use super::{FoundAngle, search_angle};
use crate::codes::{interpolate_code, rotate};
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;
use crate::io::AnyImage;

/// Angles that differ by less are one: a ten-thousandth of a degree moves nothing by a hundredth of a pixel.
const SAME_ANGLE_DEG: f64 = 1e-4;

/// Degrees beside an angle at which kernels are looked at again, and how often at most: a turn of a few tenths is then found by lamps, and
/// costs little without.
const BESIDE_DEG: [f64; 5] = [-0.8, -0.4, 0.0, 0.4, 0.8];
const MOST_CLOSER_LOOKS: usize = 3;

/// A kernel of a bank, turned to an angle that the bank need not have.
#[derive(Clone, Debug)]
pub(in crate::restore) struct TurnedKernel {
    pub(in crate::restore) psf: Psf,
    /// The angle of the kernel that it was made of.
    pub(in crate::restore) nearest_deg: f64,
    /// By how much that was turned, if it was.
    pub(in crate::restore) turned_deg: Option<f64>,
    /// The smallest and the largest angle of the bank, where the wanted one is outside of them.
    pub(in crate::restore) beyond: Option<[f64; 2]>,
}

impl TurnedKernel {
    /// Of the kernel that is nearest to an angle.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when the bank knows no angles; those of [`rotate`].
    pub(in crate::restore) fn of(bank: &KernelBank, angle_deg: f64) -> Result<Self> {
        let Some(angles) = &bank.angles_deg else {
            let reason =
                "the kernel bank does not say at which angles its kernels are; name a PSF with --psf";
            return Err(Error::Unsupported(reason.to_owned()));
        };
        let apart = |index: &usize| (angles[*index] - angle_deg).abs();
        let nearest = (0..angles.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0);
        let (psf, nearest_deg) = (&bank.psfs[nearest], angles[nearest]);
        if apart(&nearest) < SAME_ANGLE_DEG {
            return Ok(Self { psf: psf.clone(), nearest_deg, turned_deg: None, beyond: None });
        }
        let turned_deg = angle_deg - nearest_deg;
        let bounds = range_of(angles);
        let is_within = (bounds[0] - SAME_ANGLE_DEG..=bounds[1] + SAME_ANGLE_DEG).contains(&angle_deg);
        Ok(Self {
            psf: rotate(psf, turned_deg)?,
            nearest_deg,
            turned_deg: Some(turned_deg),
            beyond: (!is_within).then_some(bounds),
        })
    }
}

impl Restoration {
    /// The same restoration with the PSF, and its code, of the angle of the kernels `bank` that explains a capture best.
    ///
    /// # Errors
    /// Those of [`search_angle`](super::search_angle), [`TurnedKernel::of`] and [`interpolate_code`].
    pub(in crate::restore) fn at_angle_of(
        &self,
        capture: &Capture,
        bank: &KernelBank,
        progress: &Progress,
    ) -> Result<(Self, FoundAngle)> {
        let light: Cow<'_, LinearImage> = match &capture.image {
            AnyImage::Linear(image) => Cow::Borrowed(image),
            AnyImage::ToneMapped(..) => Cow::Owned(capture.image.clone().into_linear(self.curve())),
        };
        let known = capture.info.as_ref().and_then(|info| info.saturation);
        let saturation = self.levels(&light, capture.image.curve(), known).saturation;
        let told = ToneCurve { x_max: saturation.into_iter().fold(0.0, f32::max), ..self.curve() };
        let curve = self.curve_of(told, &light, known.is_some());
        let seen = (curve.tone_map(&light), saturation.map(|x_max| ToneCurve { x_max, ..curve }));
        let coarse = find_angle(&seen.0, bank, seen.1, progress)?;
        let found = refined(coarse, (&seen.0, seen.1), bank, progress)?;
        let psf = TurnedKernel::of(bank, found.angle_deg)?.psf;
        let code = interpolate_code(&bank.to_codes(), found.angle_deg)?;
        Ok((self.with_kernel(KernelKnowledge::Psf { psf: psf.into(), code: Some(code) }), found))
    }
}

/// The smallest and the largest of some angles.
fn range_of<'a>(angles: impl IntoIterator<Item = &'a f64>) -> [f64; 2] {
    let none = [f64::INFINITY, f64::NEG_INFINITY];
    angles.into_iter().fold(none, |[low, high], angle| [low.min(*angle), high.max(*angle)])
}

/// Looks closer at an angle that was found among the kernels of a bank, with kernels turned to angles beside it, as long as the outermost
/// of them is the best.
fn refined(
    coarse: FoundAngle,
    (image, curves): (&ToneMappedImage, [ToneCurve; CHANNELS]),
    bank: &KernelBank,
    progress: &Progress,
) -> Result<FoundAngle> {
    let started = Instant::now();
    let mut angle_deg = coarse.angle_deg;
    let [low, high] = range_of(bank.angles_deg.iter().flatten());
    for _ in 0..MOST_CLOSER_LOOKS {
        let angles = BESIDE_DEG.map(|beside| angle_deg + beside);
        let psfs =
            angles.iter().map(|angle| Ok(TurnedKernel::of(bank, *angle)?.psf)).collect::<Result<_>>()?;
        let beside = KernelBank {
            psfs,
            angles_deg: Some(angles.to_vec()),
            ..KernelBank::single(bank.psfs[0].clone())
        };
        let search = search_angle(image, &beside, curves, progress)?;
        angle_deg = search.angle_deg.clamp(low, high);
        if (1..angles.len() - 1).contains(&search.best) {
            break;
        }
    }
    Ok(FoundAngle { angle_deg, seconds: coarse.seconds + started.elapsed().as_secs_f64(), ..coarse })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::kernel_code::CodeBasis;
    use ndarray::{Array1, Array2, Array3};

    fn bank(angles: &[f64]) -> KernelBank {
        let psf = |angle: f64| {
            let (sin, cos) = angle.to_radians().sin_cos();
            let light = |(_, y, x): (usize, usize, usize)| {
                let (y, x) = (y as f64 - 12.0, x as f64 - 12.0);
                let (along, across) = (cos * x - sin * y, sin * x + cos * y);
                (-along * along / 40.0 - across * across / 3.0).exp() as f32
            };
            Psf::from_energy(Array3::from_shape_fn((3, 25, 25), light)).unwrap()
        };
        let basis = CodeBasis {
            mean: Array1::zeros(3 * 25 * 25),
            components: Array2::zeros((0, 3 * 25 * 25)),
            explained_variance: Array1::zeros(0),
        };
        let psfs = angles.iter().map(|angle| psf(*angle)).collect();
        KernelBank::new(psfs, Array2::zeros((angles.len(), 0)), basis, Some(angles.to_vec())).unwrap()
    }

    #[test]
    fn the_nearest_kernel_is_turned_by_what_is_missing() {
        let kernels = bank(&[-6.0, 0.0, 6.0]);
        let at = |angle: f64| TurnedKernel::of(&kernels, angle).unwrap();
        let same = at(6.0);
        assert_eq!((&same.psf, same.turned_deg, same.beyond), (&kernels.psfs[2], None, None));
        let between = at(4.0);
        assert_eq!((between.nearest_deg, between.turned_deg, between.beyond), (6.0, Some(-2.0), None));
        let expected = bank(&[4.0]);
        let apart = (&between.psf.planes() - &expected.psfs[0].planes()).mapv(f32::abs);
        assert!(apart.iter().all(|apart| *apart < 4e-4), "{:?}", apart.iter().fold(0f32, |a, b| a.max(*b)));
        assert_eq!(at(-7.0).beyond, Some([-6.0, 6.0]));
        let nameless = KernelBank { angles_deg: None, ..kernels };
        assert!(TurnedKernel::of(&nameless, 0.0).is_err());
    }
}
