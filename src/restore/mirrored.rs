//! Restores a capture by a network as it stands and mirrored: each result has errors of its own, of which their mean has less.

use super::memory::MemoryPlan;
use super::network::{Conditioning, NetworkOperator};
use super::restoration::Restoration;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::orientation::Orientation;
use crate::core::progress::Progress;
use crate::network::{Model, Planes};

/// Pixels that a network may restore of one capture, all results of it together: 800 × 800, which another result would take a quarter longer,
/// are restored as they stand.
const MOST_PIXELS: usize = 1_200_000;

/// How the capture is mirrored, by the numbers of EXIF: upside down, that is both ways; one way; the other. Each undoes itself.
const MIRRORED: [usize; 3] = [3, 2, 4];

/// Floats of every pixel that are kept beside what one result takes: a result, and the capture mirrored.
const FLOATS_OF_PIXEL: usize = 2 * CHANNELS;

/// The ways in which a network restores a capture of `[height, width]` beside as it stands.
fn mirrored(model: &Model, [height, width]: [usize; 2]) -> impl Iterator<Item = Orientation> + use<> {
    let results = MOST_PIXELS / (height * width).max(1);
    // What a code tells of a PSF does not hold of it mirrored.
    let count = if model.architecture().reads_code() { 0 } else { results.saturating_sub(1) };
    MIRRORED.into_iter().take(count).filter_map(Orientation::from_exif)
}

/// Floats of every pixel that a capture's restoration keeps beside those of a result as it stands.
pub(super) fn mirrored_floats_of_pixel(model: &Model, size: [usize; 2]) -> usize {
    mirrored(model, size).next().map_or(0, |_| FLOATS_OF_PIXEL)
}

impl Restoration {
    /// Restores a capture with its planes by a network, as it stands and mirrored as often as its size allows: the mean of the results,
    /// each mirrored back. Says the sides of windows where a device had no memory for those of the plan.
    ///
    /// # Errors
    /// Those of the network.
    pub(super) fn restore_mirrored(
        &self,
        (model, plan): (&Model, &MemoryPlan),
        (image, planes): (&ToneMappedImage, &mut Planes),
        conditioning: Conditioning,
        progress: &Progress,
    ) -> Result<(ToneMappedImage, Option<[usize; 2]>)> {
        let operator = NetworkOperator::new(model).told(conditioning)?.with_planes(planes);
        let (restored, smaller_windows) = self.restore_windows(image, plan, operator, progress)?;
        let size = [image.height(), image.width()];
        let (mut sum, mut count) = (restored.into_planes(), 1.0);
        for orientation in mirrored(model, size) {
            let image = ToneMappedImage::from_planes(orientation.upright(image.planes().to_owned()))?;
            *planes = std::mem::take(planes).upright(orientation)?;
            let operator = NetworkOperator::new(model).with_planes(planes);
            let (restored, _) = self.restore_windows(&image, plan, operator, progress)?;
            *planes = std::mem::take(planes).upright(orientation)?;
            sum += &orientation.upright(restored.into_planes());
            count += 1.0;
        }
        sum.mapv_inplace(|value| value / count);
        Ok((ToneMappedImage::from_planes(sum)?, smaller_windows))
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;
    use crate::core::psf::Psf;
    use crate::network::weights::Weights;
    use crate::network::{Architecture, Condition, Initialisation, Kind, Origin, Parameters, testing};
    use crate::restore::KernelKnowledge;

    fn model(kind: Kind, condition: Condition) -> Model {
        let architecture = Architecture { kind, condition, features: 4, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Paper, 6);
        Model::new(Weights { architecture, parameters, origin: Origin::default() })
    }

    #[test]
    fn a_mirrored_capture_is_restored_to_the_mirrored_result() {
        let value = |(c, y, x)| ((c * 7919 + y * 104_729 + x * 1299) % 1000) as f32 / 1000.0;
        let image = ToneMappedImage::from_planes(Array3::from_shape_fn((CHANNELS, 48, 80), value)).unwrap();
        let model = model(Kind::Guided, Condition::None);
        let psf = Psf::from_energy(Array3::ones((CHANNELS, 3, 3))).unwrap();
        let restoration = Restoration::guided(KernelKnowledge::of_psf(psf)).unwrap();
        let plan = restoration.plan([48, 80]).unwrap();
        let planes = testing::planes_of(&image);
        let restored = |orientation: Orientation| {
            let turned = |image: ToneMappedImage| {
                ToneMappedImage::from_planes(orientation.upright(image.into_planes())).unwrap()
            };
            let planes = planes.clone().upright(orientation).unwrap();
            let mut given = planes.clone();
            let (restored, _) = restoration
                .restore_mirrored(
                    (&model, &plan),
                    (&turned(image.clone()), &mut given),
                    Conditioning::None,
                    &Progress::default(),
                )
                .unwrap();
            assert_eq!(given, planes, "planes are as they were");
            turned(restored)
        };
        let upright = restored(Orientation::default());
        for orientation in MIRRORED.into_iter().filter_map(Orientation::from_exif) {
            let pairs = upright
                .as_slice()
                .iter()
                .zip(restored(orientation).into_planes())
                .map(|(a, b)| (a - b).abs());
            let error = pairs.fold(0.0, f32::max);
            assert!(error < 1e-4, "{orientation}: {error:e}");
        }
    }

    #[test]
    fn large_captures_and_networks_that_read_codes_see_no_mirrors() {
        let count = |model: &Model, size| mirrored(model, size).count();
        let guided = model(Kind::Guided, Condition::None);
        assert_eq!([[400, 600], [700, 800], [800, 800]].map(|size| count(&guided, size)), [3, 1, 0]);
        assert_eq!(count(&model(Kind::Discnet, Condition::ImagePsf), [400, 600]), 0);
    }
}
