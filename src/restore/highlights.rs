//! Puts known highlights back: inside of large saturated areas the capture says more than a restoration.

use ndarray::{Array2, Array3, ArrayView2, Zip};
use serde::Serialize;

use super::levels::reached_levels;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, Domain, Image, LinearImage, ToneMappedImage};
use crate::core::saturation::saturated_from;

/// What is done where the capture is saturated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Highlights {
    /// What the network or the deconvolution made of them.
    #[default]
    Restored,
    /// The capture's own values in every saturated pixel.
    Keep,
    /// The capture's own values inside of saturated areas, fading to the restored ones at their edges.
    Blend,
}

/// Pixels from the edge of a saturated area inwards in which the capture is not believed: the glare around a lamp
/// saturates too and is not in the scene.
const MARGIN_PX: f32 = 2.0;
/// Pixels from the edge to where the capture is trusted alone.
///
/// On over-exposed windows and street lamps behind a simulated panel, 2 to 6 pixels gain the most (2.6 dB of tone-mapped
/// PSNR in saturated windows) of all that lose nothing around the lamps (half a decibel when all are kept).
const FADE_PX: f32 = 6.0;

/// Replaces restored values where the capture is saturated; all other values stay as they are, to the bit.
///
/// # Equation
/// `(1 − w)·restored + w·capture`, channel by channel, with `w = s²·(3 − 2s)` and `s` rising from 0 to 1
/// while the distance to the next unsaturated value goes from 2 to 6 pixels ([`Highlights::Blend`]), or w = 1
/// ([`Highlights::Keep`]). Each channel has its own level from which on it is saturated, in the domain of the images.
///
/// # Errors
/// Never: values between finite values are finite.
///
/// # Panics
/// When the images differ in size: a broken invariant of the caller.
pub fn blend_highlights<D: Domain>(
    restored: Image<D>,
    capture: &Image<D>,
    saturated_from: [f32; CHANNELS],
    highlights: Highlights,
) -> Result<Image<D>> {
    if highlights == Highlights::Restored {
        return Ok(restored);
    }
    let mut planes = restored.into_planes();
    assert_eq!(planes.dim(), capture.planes().dim(), "restored and captured images have one size");
    let captured = capture.planes();
    let channels = planes.outer_iter_mut().zip(captured.outer_iter()).zip(saturated_from);
    for ((mut plane, capture), saturated_from) in channels {
        if capture.iter().all(|&value| value < saturated_from) {
            continue;
        }
        let weights = match highlights {
            Highlights::Blend => {
                depth(capture, saturated_from).mapv(|d| smooth_step((d - MARGIN_PX) / (FADE_PX - MARGIN_PX)))
            }
            _ => capture.mapv(|v| if v >= saturated_from { 1.0 } else { 0.0 }),
        };
        Zip::from(&mut plane).and(capture).and(&weights).par_for_each(|value, &captured, &weight| {
            if weight > 0.0 {
                *value = (1.0 - weight) * *value + weight * captured;
            }
        });
    }
    Image::from_planes(planes)
}

fn smooth_step(s: f32) -> f32 {
    let s = s.clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

/// The distance in pixels of each saturated value to the next unsaturated one, 0 for those, up to the fade's length.
///
/// Chamfer distance with steps 1 and √2, at most 8 % above the Euclidean one. What lies beyond the frame is taken for
/// more of the same.
fn depth(plane: ArrayView2<'_, f32>, saturated_from: f32) -> Array2<f32> {
    let (height, width) = plane.dim();
    let mut depth = plane.mapv(|v| if v >= saturated_from { FADE_PX } else { 0.0 });
    const DIAGONAL: f32 = std::f32::consts::SQRT_2;
    let relax = |depth: &mut Array2<f32>, y: usize, x: usize, neighbours: [(isize, isize, f32); 4]| {
        let nearest = neighbours.iter().filter_map(|&(dy, dx, step)| {
            let place = (y.checked_add_signed(dy)?, x.checked_add_signed(dx)?);
            depth.get(place).map(|d| d + step)
        });
        let nearest = nearest.fold(depth[[y, x]], f32::min);
        depth[[y, x]] = nearest;
    };
    for y in 0..height {
        for x in 0..width {
            let before = [(-1, -1, DIAGONAL), (-1, 0, 1.0), (-1, 1, DIAGONAL), (0, -1, 1.0)];
            relax(&mut depth, y, x, before);
        }
    }
    for y in (0..height).rev() {
        for x in (0..width).rev() {
            let after = [(1, 1, DIAGONAL), (1, 0, 1.0), (1, -1, DIAGONAL), (0, 1, 1.0)];
            relax(&mut depth, y, x, after);
        }
    }
    depth
}

/// The light that each channel of a restored capture has at most: one of which the capture reaches what saturates it, what saturates the
/// brightest of those, as of white balanced colours that are clipped together; others have no such light.
pub(super) fn most_light(image: &LinearImage, saturation: [f32; CHANNELS], usual: f32) -> [f32; CHANNELS] {
    let reached = reached_levels(image, saturation);
    let brightest = reached.iter().flatten().copied().fold(0.0, f32::max);
    reached.map(|level| if level.is_some() { brightest } else { usual })
}

/// Cuts each channel at zero and at its own value.
pub(super) fn cut_off(image: ToneMappedImage, most: [f32; CHANNELS]) -> Result<ToneMappedImage> {
    let mut planes: Array3<f32> = image.into_planes();
    for (mut plane, most) in planes.outer_iter_mut().zip(most) {
        plane.par_mapv_inplace(|value| value.clamp(0.0, most));
    }
    ToneMappedImage::from_planes(planes)
}

/// A restored scene with the light of lamps where the capture is saturated.
pub(super) fn with_light(
    restored: LinearImage,
    capture: &LinearImage,
    light: &LinearImage,
    saturation: [f32; CHANNELS],
) -> Result<LinearImage> {
    let mut planes: Array3<f32> = restored.into_planes();
    for (channel, mut plane) in planes.outer_iter_mut().enumerate() {
        let from = saturated_from(saturation[channel]);
        let pixels = Zip::from(&mut plane).and(capture.channel(channel)).and(light.channel(channel));
        pixels.par_for_each(|restored, captured, light| {
            if *captured >= from {
                *restored = restored.max(*light);
            }
        });
    }
    LinearImage::from_planes(planes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::{Boundary, Convolver};
    use crate::core::image::{Linear, LinearImage};
    use crate::core::psf::Psf;
    use crate::core::saturation::saturated_from;
    use crate::core::tone::ToneCurve;
    use ndarray::Array3;

    const SIDE: usize = 128;
    const LAMP_PX: f32 = 26.0;

    fn from_lamp(y: usize, x: usize) -> f32 {
        (y as f32 - 64.0).hypot(x as f32 - 60.0)
    }

    /// Night texture and a lamp of 52 pixels, four times as bright as the sensor's saturation.
    fn scene() -> LinearImage {
        let planes = Array3::from_shape_fn((3, SIDE, SIDE), |(c, y, x)| {
            if from_lamp(y, x) < LAMP_PX {
                return 2000.0;
            }
            0.2 + 0.1 * ((y as f32) * 0.7 + c as f32).sin() * ((x as f32) * 0.5).cos()
        });
        LinearImage::from_planes(planes).unwrap()
    }

    /// A peak of some 3 pixels with two faint sidelobes.
    fn psf() -> Psf {
        let energy = Array3::from_shape_fn((3, 33, 33), |(_, y, x)| {
            let spot = |cy: f32, cx: f32| (-((y as f32 - cy).powi(2) + (x as f32 - cx).powi(2)) / 3.0).exp();
            spot(16.0, 16.0) + 0.02 * (spot(16.0, 4.0) + spot(16.0, 28.0))
        });
        Psf::from_energy(energy).unwrap()
    }

    fn captured(curve: ToneCurve) -> LinearImage {
        let psf = psf();
        let convolver = Convolver::new([SIDE; 2], [33; 2], Boundary::Replicate).unwrap();
        let spectrum = convolver.spectrum(&scene()).unwrap();
        let blurred = convolver.convolve(&spectrum, &convolver.otf(&psf).unwrap());
        curve.clip_image(&LinearImage::from_planes(blurred).unwrap())
    }

    /// Root mean square of tone-mapped errors where `inside` of the lamp, in decibels of the peak.
    fn psnr(image: &LinearImage, truth: &LinearImage, curve: ToneCurve, choose: impl Fn(f32) -> bool) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for ((c, y, x), value) in image.planes().indexed_iter() {
            if choose(from_lamp(y, x)) {
                let error = curve.compress(*value) - curve.compress(truth.planes()[[c, y, x]]);
                sum += f64::from(error).powi(2);
                count += 1;
            }
        }
        -10.0 * (sum / f64::from(count)).log10()
    }

    /// A network that restores nearly everything, and leaves a dark hole in a lamp larger than any that it has seen.
    fn restored(truth: &LinearImage, capture: &LinearImage, curve: ToneCurve) -> LinearImage {
        let planes = Array3::from_shape_fn(truth.planes().dim(), |(c, y, x)| {
            let hole = 0.9 * (-from_lamp(y, x).powi(2) / 60.0).exp();
            let [clean, seen] = [truth, capture].map(|image| curve.compress(image.planes()[[c, y, x]]));
            curve.expand((0.97 * clean + 0.03 * seen) * (1.0 - hole))
        });
        LinearImage::from_planes(planes).unwrap()
    }

    #[test]
    fn artefacts_inside_of_a_big_lamp_vanish_and_nothing_else_changes() {
        let curve = ToneCurve::default();
        let (capture, truth) = (captured(curve), curve.clip_image(&scene()));
        let restored = restored(&truth, &capture, curve);
        let level = saturated_from(curve.x_max);
        let blended = blend_highlights(restored.clone(), &capture, [level; 3], Highlights::Blend).unwrap();
        let inside = |image: &LinearImage| psnr(image, &truth, curve, |r| r < LAMP_PX - FADE_PX);
        let outside = |image: &LinearImage| psnr(image, &truth, curve, |r| r > LAMP_PX);
        assert!(inside(&blended) > inside(&restored) + 10.0, "{} {}", inside(&blended), inside(&restored));
        assert!(
            outside(&blended) > outside(&restored) - 0.05,
            "{} {}",
            outside(&blended),
            outside(&restored)
        );
        for (place, value) in blended.planes().indexed_iter() {
            assert!(capture.planes()[place] >= level || *value == restored.planes()[place]);
        }
        // The glare around the lamp saturates as well: keeping it costs where the lamp is not.
        let kept = blend_highlights(restored.clone(), &capture, [level; 3], Highlights::Keep).unwrap();
        assert!(outside(&kept) < outside(&blended) - 3.0, "{} {}", outside(&kept), outside(&blended));
    }

    #[test]
    fn leaves_small_lights_and_unsaturated_images_alone() {
        let mut planes = Array3::from_elem((3, 20, 20), 1.0f32);
        planes[[0, 5, 5]] = 500.0;
        let capture = Image::<Linear>::from_planes(planes).unwrap();
        let restored = Image::<Linear>::from_planes(Array3::from_elem((3, 20, 20), 2.0)).unwrap();
        let blended = blend_highlights(restored.clone(), &capture, [499.5; 3], Highlights::Blend).unwrap();
        assert_eq!(blended, restored, "one pixel is its own edge");
        let kept = blend_highlights(restored.clone(), &capture, [499.5; 3], Highlights::Keep).unwrap();
        assert_eq!((kept.planes()[[0, 5, 5]], kept.planes()[[0, 5, 6]]), (500.0, 2.0));
        let none = blend_highlights(restored.clone(), &capture, [501.0; 3], Highlights::Keep).unwrap();
        assert_eq!(none, restored);
        let network = blend_highlights(restored.clone(), &capture, [499.5; 3], Highlights::Restored).unwrap();
        assert_eq!(network, restored);
    }

    /// White-balanced channels saturate at other light each: a valid red below its own level is not put back because
    /// green saturates there.
    #[test]
    fn every_channel_saturates_at_its_own_level() {
        let planes = Array3::from_shape_fn((3, 4, 4), |(c, ..)| [1.5, 1.0, 1.6][c]);
        let capture = Image::<Linear>::from_planes(planes).unwrap();
        let restored = Image::<Linear>::from_planes(Array3::from_elem((3, 4, 4), 2.0)).unwrap();
        let level = [1.9, 1.0, 1.6].map(saturated_from);
        let kept = blend_highlights(restored, &capture, level, Highlights::Keep).unwrap();
        assert_eq!([0, 1, 2].map(|c| kept.planes()[[c, 2, 2]]), [2.0, 1.0, 1.6]);
    }

    #[test]
    fn depth_is_the_distance_to_the_edge() {
        let plane = Array2::from_shape_fn((41, 41), |(y, x)| {
            if (y as f32 - 20.0).hypot(x as f32 - 20.0) < 5.0 { 1.0 } else { 0.0 }
        });
        let depth = depth(plane.view(), 1.0);
        assert!((depth[[20, 20]] - 5.0).abs() <= 1.0 && depth[[20, 26]] == 0.0);
        let full = super::depth(Array2::ones((9, 9)).view(), 1.0);
        assert!(full.iter().all(|&d| d == FADE_PX));
    }

    /// A red lamp before what is dark; white balanced colours, of which the brightest clips last; and a capture that is nowhere clipped.
    #[test]
    fn light_is_cut_where_its_own_colour_saturates() {
        let image = |light: [f32; 3]| {
            LinearImage::from_planes(Array3::from_shape_fn((3, 2, 2), |(c, y, _)| light[c] * y as f32))
                .unwrap()
        };
        let [lamp, balanced] = [[1.0, 40.0, 40.0], [2.0, 1.0, 1.6]];
        assert_eq!(most_light(&image([1.0, 0.4, 0.4]), lamp, 40.0), [1.0, 40.0, 40.0]);
        assert_eq!(most_light(&image(balanced), balanced, 2.0), [2.0; 3]);
        assert_eq!(most_light(&image([0.9, 1.0, 0.9]), balanced, 2.0), [2.0, 1.0, 2.0]);
        assert_eq!(most_light(&image([0.5; 3]), [16.0; 3], 16.0), [16.0; 3]);
        let cut = cut_off(
            ToneMappedImage::from_planes(Array3::from_elem((3, 1, 1), 0.9)).unwrap(),
            [0.8, 1.0, 0.9],
        );
        assert_eq!(cut.unwrap().as_slice(), [0.8, 0.9, 0.9]);
    }
}
