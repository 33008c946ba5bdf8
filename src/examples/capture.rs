//! Records a scene through a panel: Eq. 1 with the sensor of a recipe, or a camera's whole way from light to linear
//! colours.

use ndarray::{Array2, Array3, Axis};

use super::recipe::{HarderRecipe, Recipe, SensorRecipe};
use crate::capture::bayer::{BayerPattern, demosaic_scene};
use crate::core::error::Result;
use crate::core::fft::{Boundary, Convolver};
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;
use crate::dataset::{NoiseConfig, SensorConfig};
use crate::synth::add_noise;

/// The largest step from one exposure of a bracket to the next.
const LARGEST_STEP: f64 = 4.0;

/// The black level of a converter of so many bits.
const BLACK_DN: (f64, u32) = (64.0, 10);

/// What a camera recorded, and should have.
#[derive(Clone, Debug)]
pub(super) struct Recorded {
    /// The capture.
    pub(super) capture: LinearImage,
    /// The scene as a camera without panel and noise would have recorded it.
    pub(super) ground_truth: LinearImage,
    /// φ∘C; x_max is the saturation of the least sensitive channel.
    pub(super) curve: ToneCurve,
    /// The value of a full photosite in each channel.
    pub(super) saturation: [f32; CHANNELS],
}

/// Records a scene with a margin of so many pixels around the frame; `seed` decides the noise.
///
/// # Equation
/// `C(x∗k + n)` of Eq. 1, beyond the scene's border darkness. For a harder example k has stray light, each channel
/// saturates at its own gain's multiple of x_max, only a third of the colours is recorded and the others are interpolated.
///
/// # Errors
/// Those of [`Convolver::new`]; for a frame smaller than 4 × 4.
pub(super) fn record(
    recipe: &Recipe,
    (scene, margin): (&LinearImage, usize),
    psf: &Psf,
    alpha: f32,
    seed: u64,
) -> Result<Recorded> {
    let gains = recipe.harder.map_or([1.0; CHANNELS], |harder| harder.gains);
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    let saturation = gains.map(|gain| (gain * recipe.x_max) as f32);
    let curve = ToneCurve::new(alpha, saturation.into_iter().fold(0.0, f32::max))?;
    let (height, width) = (scene.height(), scene.width());
    let convolver = Convolver::new([height, width], [psf.height(), psf.width()], Boundary::Zero)?;
    let spectrum = convolver.spectrum(scene)?;
    let mut light = convolver.convolve_middle(&spectrum, &convolver.otf(psf)?, margin);
    drop(spectrum);
    if let Some(sensor) = recipe.sensor {
        let noise = NoiseConfig::Sensor(sensor_config(sensor, recipe.x_max, gains));
        add_noise(&mut light, &noise, seed, &format!("example/{}", recipe.id()));
    }
    for (mut plane, full) in light.axis_iter_mut(Axis(0)).zip(saturation) {
        plane.mapv_inplace(|value| value.min(full));
    }
    let light = match recipe.harder {
        // Noise around black may be negative, as in what cameras give.
        Some(_) => remosaicked(&light)?,
        None => light.mapv_into(|value| value.max(0.0)),
    };
    let frame = scene.crop(margin, margin, height - 2 * margin, width - 2 * margin);
    let ground_truth = frame.map_in_place(|value| curve.clip(value));
    Ok(Recorded { capture: LinearImage::from_planes(light)?, ground_truth, curve, saturation })
}

/// A bracket whose longest exposure is white at 1 in green and whose shortest is at `x_max`; a channel of a higher gain is
/// less sensitive.
fn sensor_config(sensor: SensorRecipe, x_max: f64, gains: [f64; CHANNELS]) -> SensorConfig {
    let SensorRecipe { full_well_e, read_noise_e, bits } = sensor;
    SensorConfig {
        full_well_e,
        read_noise_e,
        bits,
        black_level_dn: BLACK_DN.0 * f64::from(bits.cast_signed() - BLACK_DN.1.cast_signed()).exp2(),
        electrons_per_unit: full_well_e,
        exposures: exposures(x_max),
        channel_gains: gains.map(f64::recip),
    }
}

/// As few exposures as the largest step allows, in equal steps from 1 to 1/x_max.
fn exposures(x_max: f64) -> Vec<f64> {
    let steps = (x_max.ln() / LARGEST_STEP.ln() - 1e-9).ceil().max(0.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small whole number")]
    let count = steps as u32;
    (0..=count).map(|step| x_max.powf(-f64::from(step) / steps.max(1.0))).collect()
}

/// What is left of three full planes by a sensor of a Bayer mosaic and our own demosaicing.
fn remosaicked(planes: &Array3<f32>) -> Result<Array3<f32>> {
    const PATTERN: BayerPattern = BayerPattern::Rggb;
    let (_, height, width) = planes.dim();
    let mosaic = Array2::from_shape_fn((height, width), |(y, x)| planes[[PATTERN.channel(y, x), y, x]]);
    demosaic_scene(mosaic.view(), PATTERN)
}

/// A PSF that spreads a share of the light over its whole support: half of it evenly, half of it in a broad lobe, as
/// reflections between lens, panel and sensor do.
///
/// # Errors
/// Never for a share below 1: the PSF keeps its light.
pub(super) fn with_stray_light(psf: &Psf, HarderRecipe { stray_light, .. }: HarderRecipe) -> Result<Psf> {
    /// The lobe's standard deviation as a share of the PSF's side.
    const LOBE: f64 = 0.2;
    let (height, width) = (psf.height(), psf.width());
    let (centre_y, centre_x) = psf.centre();
    let lobe = Array2::from_shape_fn((height, width), |(y, x)| {
        let distance =
            |at: usize, centre: usize, side: usize| (at as f64 - centre as f64) / (LOBE * side as f64);
        (-0.5 * (distance(y, centre_y, height).powi(2) + distance(x, centre_x, width).powi(2))).exp()
    });
    let (evenly, of_lobe) = (0.5 / (height * width) as f64, 0.5 / lobe.sum());
    let mut planes = psf.planes().to_owned();
    for mut plane in planes.axis_iter_mut(Axis(0)) {
        ndarray::Zip::from(&mut plane).and(&lobe).for_each(|value, lobe| {
            let stray = stray_light * (evenly + of_lobe * lobe);
            #[expect(clippy::cast_possible_truncation, reason = "PSFs are kept in 32 bit")]
            let kept = ((1.0 - stray_light) * f64::from(*value) + stray) as f32;
            *value = kept;
        });
    }
    Psf::from_energy(planes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Split;
    use crate::examples::recipe::SceneRecipe;
    use crate::restore::deconvolution::Border;
    use crate::scenes::natural::NaturalKind;

    fn recipe(harder: bool) -> Recipe {
        Recipe {
            index: 3,
            split: Split::Train,
            panel: 0,
            angle_deg: 0.0,
            scene: SceneRecipe::Painted { kind: NaturalKind::Leaves, seed: 0 },
            brightness: 0.2,
            border: Border::Smooth,
            x_max: 8.0,
            sensor: Some(SensorRecipe { full_well_e: 6000.0, read_noise_e: 2.0, bits: 12 }),
            harder: harder.then_some(HarderRecipe { gains: [2.0, 1.0, 1.5], stray_light: 0.02 }),
        }
    }

    fn point() -> Psf {
        let mut energy = Array3::zeros((CHANNELS, 5, 5));
        energy.slice_mut(ndarray::s![.., 2, 2]).fill(1.0);
        Psf::from_energy(energy).unwrap()
    }

    fn flat(value: f32) -> LinearImage {
        LinearImage::from_planes(Array3::from_elem((CHANNELS, 24, 28), value)).unwrap()
    }

    #[test]
    fn brackets_reach_from_one_to_x_max_in_small_steps() {
        assert_eq!(exposures(1.0), [1.0]);
        assert_eq!(exposures(16.0), [1.0, 0.25, 0.0625]);
        for x_max in [1.3, 4.0, 31.0, 500.0] {
            let exposures = exposures(x_max);
            assert!((exposures.last().unwrap() * x_max - 1.0).abs() < 1e-12);
            assert!(exposures.windows(2).all(|pair| pair[0] > pair[1] && pair[0] <= 4.0001 * pair[1]));
        }
    }

    /// 24 · 28 pixels of 6000 · 0.5 electrons: means are known to 0.1 %.
    #[test]
    fn a_simulated_capture_is_the_light_with_the_sensors_noise() {
        let recorded = record(&recipe(false), (&flat(0.5), 4), &point(), 0.25, 1).unwrap();
        assert_eq!((recorded.capture.height(), recorded.capture.width()), (16, 20));
        assert_eq!((recorded.saturation, recorded.curve.x_max), ([8.0; 3], 8.0));
        assert_eq!(recorded.ground_truth, flat(0.5).crop(4, 4, 16, 20));
        let values = recorded.capture.as_slice();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        assert!((mean - 0.5).abs() < 2e-3 && values.iter().any(|&value| value != mean), "{mean}");
        let clipped = record(&recipe(false), (&flat(20.0), 0), &point(), 0.25, 1).unwrap();
        assert!(clipped.capture.as_slice().iter().all(|value| (value / 8.0 - 1.0).abs() < 0.01));
        assert_eq!(clipped.ground_truth.max(), 8.0);
    }

    #[test]
    fn a_harder_capture_clips_each_channel_at_its_own_gain() {
        let recorded = record(&recipe(true), (&flat(20.0), 0), &point(), 0.25, 1).unwrap();
        assert_eq!((recorded.saturation, recorded.curve.x_max), ([16.0, 8.0, 12.0], 16.0));
        for (channel, full) in [16.0, 8.0, 12.0].into_iter().enumerate() {
            // The middle: demosaicing mirrors the frame at its border.
            let value = recorded.capture.channel(channel)[[12, 12]];
            assert!((value / full - 1.0).abs() < 0.02, "{channel}: {value}");
        }
        assert_eq!(recorded.ground_truth.max(), 16.0);
    }

    #[test]
    fn stray_light_is_taken_from_the_light_and_spread() {
        let harder = HarderRecipe { gains: [1.0; 3], stray_light: 0.1 };
        let psf = with_stray_light(&point(), harder).unwrap();
        for plane in psf.planes().outer_iter() {
            assert!((plane.sum() - 1.0).abs() < 1e-6);
            assert!(plane[[2, 2]] > 0.9 && plane[[2, 2]] < 0.92, "{}", plane[[2, 2]]);
            // Half of a tenth over 25 pixels, and the lobe's rest.
            assert!(plane[[0, 0]] >= 0.002 && plane[[0, 0]] < plane[[1, 2]]);
        }
    }
}
