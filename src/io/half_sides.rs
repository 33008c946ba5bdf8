//! Keeps what is saturated, and nothing else, saturated in half floats.
//!
//! Half floats lie up to a 1000th of their value apart, and of tone-mapped light more: the nearest one to φ(495) and those to all light
//! from 341 on are the same, which maps back to 500.

use half::f16;
use ndarray::{Array3, Axis};

use super::DomainTag;
use super::write::Contents;
use crate::core::image::CHANNELS;
use crate::core::provenance::Provenance;
use crate::core::saturation::saturated_from;

/// The values of a channel from which on it is saturated, and from which on its light ends: no curve maps back to more.
#[derive(Clone, Copy, Debug)]
struct Levels {
    saturated: f32,
    end: f32,
}

impl Levels {
    /// What stands for a value in half floats: the nearest one, unless that lies on the other side of a level, and is the next one on
    /// the value's own side then.
    fn half_of(self, value: f32) -> f32 {
        let nearest = f16::from_f32(value);
        let level = if value >= self.end { self.end } else { self.saturated };
        let next = |step: i16| f16::from_bits(nearest.to_bits().wrapping_add_signed(step)).to_f32();
        match (value >= level, nearest.to_f32() >= level) {
            // No number, or so large that half floats end there.
            _ if !(nearest.is_finite() && nearest < f16::MAX) => value,
            (true, false) => next(1),
            (false, true) => next(-1),
            _ => value,
        }
    }

    fn is_crossed(self, value: f32) -> bool {
        self.half_of(value).total_cmp(&value).is_ne()
    }
}

/// The planes of an image some of whose values half floats would round across the light from which on they count as saturated, with
/// the next half float on their own side in their place; so a lamp that is clipped stays where its curve says that light ends. None
/// where there are no such values, and of an image that does not say where it saturates.
pub(super) fn beside_levels(contents: &Contents<'_>) -> Option<Array3<f32>> {
    let levels = levels_of(contents)?;
    let of = |channel: usize| levels[channel.min(CHANNELS - 1)];
    let planes = contents.planes.axis_iter(Axis(0)).enumerate();
    if !planes.into_iter().any(|(channel, plane)| plane.iter().any(|value| of(channel).is_crossed(*value))) {
        return None;
    }
    let mut planes = contents.planes.to_owned();
    for (channel, mut plane) in planes.axis_iter_mut(Axis(0)).enumerate() {
        plane.mapv_inplace(|value| of(channel).half_of(value));
    }
    Some(planes)
}

/// The levels that an image says: its capture's, or where its curve ends, in the image's own domain.
fn levels_of(contents: &Contents<'_>) -> Option<[Levels; CHANNELS]> {
    let curve = contents.provenance.and_then(Provenance::tone_curve);
    let said = contents.capture.and_then(|capture| capture.saturation);
    let light = said.or(curve.map(|curve| [curve.x_max; CHANNELS]));
    match contents.domain? {
        DomainTag::Linear => {
            Some(light?.map(|white| Levels { saturated: saturated_from(white), end: f32::INFINITY }))
        }
        DomainTag::ToneMapped => {
            let curve = curve?;
            let end = curve.compress(curve.x_max);
            Some(light?.map(|white| Levels { saturated: curve.compress(saturated_from(white)), end }))
        }
        DomainTag::Display | DomainTag::Srgb => None,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::core::capture::CaptureInfo;
    use crate::core::image::{Domain, Image, Linear, LinearImage, ToneMapped};
    use crate::core::tone::ToneCurve;
    use crate::io::{WriteOptions, read_image, write_image};

    /// What a file of half floats holds of an image whose origin says a curve.
    fn written<D: Domain>(
        image: &Image<D>,
        curve: ToneCurve,
        saturation: Option<[f32; CHANNELS]>,
    ) -> Image<D> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let capture = saturation.map(|levels| CaptureInfo { saturation: Some(levels), ..Default::default() });
        let provenance = Some(Provenance::new("tonemap", &json!({ "tone": curve })));
        let options = WriteOptions { half: true, provenance, capture, ..WriteOptions::default() };
        write_image(&path, image, &options).unwrap();
        read_image::<D>(&path).unwrap()
    }

    /// Light in steps that are finer than half floats, around the level of each channel.
    fn around(levels: [f32; CHANNELS]) -> LinearImage {
        let value = |(c, _, x): (usize, usize, usize)| levels[c] * (0.5 + x as f32 / 6000.0);
        LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, 1, 4000), value)).unwrap()
    }

    fn saturated(image: &LinearImage, levels: [f32; CHANNELS]) -> Vec<bool> {
        let planes = image.planes();
        let values = planes.indexed_iter();
        values.map(|((channel, ..), value)| *value >= saturated_from(levels[channel])).collect()
    }

    #[test]
    fn light_stays_on_its_side_of_saturation() {
        let curve = ToneCurve { alpha: 0.25, x_max: 499.9 };
        for saturation in [None, Some([1.3, 499.9, 16.03])] {
            let levels = saturation.unwrap_or([curve.x_max; CHANNELS]);
            let light = around(levels);
            let found = written(&light, curve, saturation);
            assert_eq!(saturated(&found, levels), saturated(&light, levels));
            let step = |value: f32| value * 2f32.powi(-10);
            let near = |(a, b): (&f32, &f32)| (a - b).abs() <= step(*b);
            assert!(found.as_slice().iter().zip(light.as_slice()).all(near), "within one half float");
        }
    }

    #[test]
    fn tone_mapped_light_stays_on_its_side_and_what_is_clipped_where_light_ends() {
        for x_max in [1.0, 16.0, 300.0, 500.0] {
            let curve = ToneCurve { alpha: 0.25, x_max };
            let levels = [x_max; CHANNELS];
            let light = around(levels);
            let mapped: Image<ToneMapped> = curve.tone_map(&light);
            let found = curve.inverse_tone_map(&written(&mapped, curve, None));
            let from = curve.compress(saturated_from(x_max));
            let expected: Vec<bool> = mapped.as_slice().iter().map(|value| *value >= from).collect();
            assert!(expected.contains(&true) && expected.contains(&false));
            assert_eq!(saturated(&found, levels), expected, "{x_max}");
            let ends = light.as_slice().iter().zip(found.as_slice()).filter(|(light, _)| **light >= x_max);
            assert!(ends.map(|(_, found)| found / x_max).all(|share| (share - 1.0).abs() < 1e-3), "{x_max}");
        }
    }

    #[test]
    fn what_does_not_say_where_it_saturates_is_rounded_to_the_nearest() {
        let light = around([500.0; CHANNELS]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        write_image(&path, &light, &WriteOptions { half: true, ..WriteOptions::default() }).unwrap();
        let found = read_image::<Linear>(&path).unwrap();
        assert_eq!(found, light.map_values(|value| f16::from_f32(value).to_f32()));
    }
}
