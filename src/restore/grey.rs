//! Captures of one colour, as grey files and monochrome cameras give them: three equal planes, seen through one kernel.

use std::borrow::Cow;
use std::sync::Arc;

use ndarray::{Array3, ArrayView3, Axis, Zip};

use super::kernel::KernelKnowledge;
use crate::core::color::LUMINANCE;
use crate::core::error::Result;
use crate::core::image::{Domain, Image};
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;
use crate::io::AnyImage;

/// Whether the colours of an image are the same in every pixel.
pub(super) fn is_grey(image: &AnyImage) -> bool {
    match image {
        AnyImage::Linear(image) => are_equal(image.planes()),
        AnyImage::ToneMapped(image, _) => are_equal(image.planes()),
    }
}

/// The PSF of grey light, by the shares of the colours in its luminance, if it differs between them: grey files are made by these, and a
/// sensor without filters sees nearly so.
pub(super) fn grey_kernel(kernel: &KernelKnowledge) -> Result<Option<KernelKnowledge>> {
    Ok(match kernel {
        KernelKnowledge::Psf { psf, code } => {
            grey_psf(psf)?.map(|psf| KernelKnowledge::Psf { psf: Arc::new(psf), code: code.clone() })
        }
        KernelKnowledge::Search { bank, sha256 } => {
            let grey = bank.psfs.iter().map(grey_psf).collect::<Result<Option<Vec<Psf>>>>()?;
            grey.map(|psfs| KernelKnowledge::Search {
                bank: Arc::new(KernelBank { psfs, ..KernelBank::clone(bank) }),
                sha256: sha256.clone(),
            })
        }
        KernelKnowledge::Nothing | KernelKnowledge::Code(_) | KernelKnowledge::Field { .. } => None,
    })
}

/// The PSF that an image is seen through: that of grey light, where its colours are the same everywhere.
///
/// # Errors
/// Those of [`Psf::from_energy`].
pub fn psf_seen<'a>(image: &AnyImage, psf: &'a Psf) -> Result<Cow<'a, Psf>> {
    let grey = if is_grey(image) { grey_psf(psf)? } else { None };
    Ok(grey.map_or(Cow::Borrowed(psf), Cow::Owned))
}

fn grey_psf(psf: &Psf) -> Result<Option<Psf>> {
    let differs = !are_equal(psf.planes());
    differs.then(|| Psf::from_energy(with_luminance(psf.planes().to_owned()))).transpose()
}

/// An image whose colours are its luminance.
pub(super) fn made_grey(image: AnyImage) -> Result<AnyImage> {
    Ok(match image {
        AnyImage::Linear(image) => AnyImage::Linear(grey_of(image)?),
        AnyImage::ToneMapped(image, curve) => AnyImage::ToneMapped(grey_of(image)?, curve),
    })
}

fn grey_of<D: Domain>(image: Image<D>) -> Result<Image<D>> {
    Image::from_planes(with_luminance(image.into_planes()))
}

fn are_equal(planes: ArrayView3<'_, f32>) -> bool {
    let [first, second, third] = [0, 1, 2].map(|channel| planes.index_axis(Axis(0), channel));
    first == second && first == third
}

fn with_luminance(mut planes: Array3<f32>) -> Array3<f32> {
    for mut rows in planes.axis_iter_mut(Axis(1)) {
        Zip::from(rows.lanes_mut(Axis(0))).par_for_each(|mut pixel| {
            let luminance = pixel.iter().zip(LUMINANCE).map(|(value, share)| value * share).sum();
            pixel.fill(luminance);
        });
    }
    planes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::{Boundary, Convolver};
    use crate::core::image::{CHANNELS, LinearImage};
    use crate::core::progress::Progress;
    use crate::restore::deconvolution::{DeconvolutionConfig, Method};
    use crate::restore::{Capture, Restoration};

    /// A core with a bright neighbour further out in each colour.
    fn psf() -> Psf {
        let value = |(c, y, x)| match (y, x) {
            (6, 6) => 1.0,
            (6, x) if x == 8 + c => 0.3,
            _ => 0.0,
        };
        Psf::from_energy(Array3::from_shape_fn((CHANNELS, 13, 13), value)).unwrap()
    }

    #[test]
    fn a_grey_capture_is_seen_through_all_colours_at_once_and_stays_grey() {
        let light = |y: usize, x: usize| 0.2 + 0.1 * ((y as f32 / 3.0).sin() + (x as f32 / 2.0).cos());
        let scene =
            LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, 40, 48), |(_, y, x)| light(y, x)));
        let convolver = Convolver::new([40, 48], [13, 13], Boundary::Periodic).unwrap();
        let scene = scene.unwrap();
        let blurred =
            convolver.convolve(&convolver.spectrum(&scene).unwrap(), &convolver.otf(&psf()).unwrap());
        let colored = LinearImage::from_planes(
            Array3::from_shape_vec((CHANNELS, 40, 48), blurred.into_iter().collect()).unwrap(),
        );
        let AnyImage::Linear(seen) = made_grey(AnyImage::Linear(colored.unwrap())).unwrap() else { panic!() };
        let config = DeconvolutionConfig {
            border: crate::restore::deconvolution::Border::Periodic,
            ..DeconvolutionConfig::of_method(Method::Wiener)
        };
        let restoration = Restoration::by_deconvolution(config, KernelKnowledge::of_psf(psf())).unwrap();
        let restored = restoration.restore(Capture::from(seen.clone()), &Progress::default()).unwrap();
        assert!(restored.through_grey && is_grey(&restored.image));
        let error = |image: &LinearImage| {
            let errors = image.as_slice().iter().zip(scene.as_slice()).map(|(a, b)| (a - b).powi(2));
            (errors.sum::<f32>() / scene.as_slice().len() as f32).sqrt()
        };
        let (before, after) = (error(&seen), error(&restored.into_linear()));
        assert!(after < 0.1 * before, "{after} of {before}");
    }

    #[test]
    fn one_pixel_of_another_colour_makes_a_capture_colored() {
        let mut planes = Array3::from_elem((CHANNELS, 4, 5), 0.5);
        assert!(is_grey(&AnyImage::Linear(LinearImage::from_planes(planes.clone()).unwrap())));
        planes[[2, 3, 4]] = 0.6;
        assert!(!is_grey(&AnyImage::Linear(LinearImage::from_planes(planes).unwrap())));
    }

    #[test]
    fn the_kernel_of_grey_light_is_that_of_its_luminance() {
        let KernelKnowledge::Psf { psf: grey, .. } =
            grey_kernel(&KernelKnowledge::of_psf(psf())).unwrap().expect("one of its own")
        else {
            panic!("no PSF")
        };
        let share = 0.3 / 1.3;
        for channel in 0..CHANNELS {
            let row = grey.channel(channel).row(6).to_owned();
            let expected = [(6, 1.0 - share), (8, 0.2126 * share), (9, 0.7152 * share), (10, 0.0722 * share)];
            expected.into_iter().for_each(|(x, energy)| assert!((row[x] - energy).abs() < 1e-6, "{row}"));
        }
        assert!(grey_kernel(&KernelKnowledge::Psf { psf: grey, code: None }).unwrap().is_none());
    }
}
