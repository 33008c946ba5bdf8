//! Lateral colour: red and blue that a lens draws a little larger or smaller than green.
//!
//! A network for any panel takes what one colour lacks from the others where they are, and has seen no colours that lie apart. Where they
//! do, it is shown red and blue as they would lie on green, and what it corrects in them is brought back to where they are: corrections
//! alone are resampled, not the image.

mod field;
mod resample;
mod shifts;

use std::fmt;

use ndarray::{Array2, Axis, Zip};
use serde::Serialize;

use self::field::Field;
use self::resample::{Sampling, resampled};
use self::shifts::Pair;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::saturation::saturated_from;
use crate::network::{Plane, Planes};

/// The colours that are brought to green.
const COLOURS: [usize; 2] = [0, 2];
const GREEN: usize = 1;

/// Pixels from green from which on a colour is brought to it: resampling costs what less would lose.
const LEAST_PX: f64 = 0.3;

/// Standard deviations that this has to be.
const SURE: f64 = 4.0;

/// How far red and blue lie from green across a frame.
#[derive(Clone, Debug)]
pub(super) struct Lateral {
    /// Of red and blue; none of one that lies on green as far as is seen.
    fields: [Option<Field>; 2],
}

/// The greatest distances of red and blue from green in a frame, in pixels; 0 where a colour lies on green as far as is seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct LateralColour {
    /// Of red.
    pub red_px: f64,
    /// Of blue.
    pub blue_px: f64,
}

/// What brings back the result of a network that was shown aligned colours.
pub(super) struct Aligned {
    lateral: Lateral,
    /// Red and blue of the deconvolved image where they lie.
    deconvolved: [Option<Array2<f32>>; 2],
}

impl Lateral {
    /// Measures it in the deconvolved image of a capture, where that is not saturated; none where the colours lie on each other as far as
    /// is seen.
    pub(super) fn find(
        deconvolved: &ToneMappedImage,
        capture: &LinearImage,
        saturation: [f32; CHANNELS],
    ) -> Option<Self> {
        let from = saturation.map(saturated_from);
        let of_channel =
            |channel: usize| (deconvolved.channel(channel), capture.channel(channel), from[channel]);
        let fields = COLOURS.map(|colour| {
            let found = Pair { green: of_channel(GREEN), colour: of_channel(colour) }.field()?;
            found.is_further_than(LEAST_PX, SURE).then_some(found)
        });
        fields.iter().any(Option::is_some).then_some(Self { fields })
    }

    /// How far the colours lie apart at most.
    pub(super) fn furthest(&self) -> LateralColour {
        let [red_px, blue_px] =
            [0, 1].map(|colour| self.fields[colour].as_ref().map_or(0.0, |field| field.furthest()[0]));
        LateralColour { red_px, blue_px }
    }

    /// Brings red and blue of a capture and its planes to where green is.
    ///
    /// # Errors
    /// Never for planes of the capture's size.
    pub(super) fn align(
        self,
        capture: ToneMappedImage,
        planes: &mut Planes,
    ) -> Result<(ToneMappedImage, Aligned)> {
        let image = self.towards_green(capture, Sampling::Cubic)?;
        let deconvolved = [0, 1].map(|colour| {
            let plane = planes.get(Plane::Deconvolved)?;
            self.fields[colour].as_ref().map(|_| plane.channel(COLOURS[colour]).to_owned())
        });
        let mut aligned = Vec::new();
        for plane in Plane::ALL {
            let Some(image) = planes.take(plane) else { continue };
            let sampling = if plane == Plane::Deconvolved { Sampling::Cubic } else { Sampling::Nearest };
            aligned.push((plane, self.towards_green(image, sampling)?));
        }
        *planes = aligned.into_iter().collect();
        Ok((image, Aligned { lateral: self, deconvolved }))
    }

    fn towards_green(&self, image: ToneMappedImage, sampling: Sampling) -> Result<ToneMappedImage> {
        let mut planes = image.into_planes();
        for (field, colour) in self.fields.iter().zip(COLOURS) {
            let Some(field) = field else { continue };
            let mut plane = planes.index_axis_mut(Axis(0), colour);
            let mut moved = resampled(plane.view(), |y, x| field.on_colour(y, x), sampling);
            moved.par_mapv_inplace(|value| value.max(0.0));
            plane.assign(&moved);
        }
        ToneMappedImage::from_planes(planes)
    }
}

impl Aligned {
    /// Brings what a network made of an aligned capture, and the aligned deconvolved image, back to where the colours lie.
    ///
    /// # Errors
    /// Never for images of the capture's size.
    pub(super) fn bring_back(
        self,
        restored: ToneMappedImage,
        deconvolved: ToneMappedImage,
    ) -> Result<[ToneMappedImage; 2]> {
        let [mut restored, mut deconvolved] = [restored, deconvolved].map(ToneMappedImage::into_planes);
        let colours = self.lateral.fields.iter().zip(COLOURS).zip(self.deconvolved);
        for ((field, colour), own) in colours {
            let (Some(field), Some(own)) = (field, own) else { continue };
            let mut corrected = restored.index_axis_mut(Axis(0), colour);
            let mut deconvolved = deconvolved.index_axis_mut(Axis(0), colour);
            corrected -= &deconvolved;
            let correction = resampled(corrected.view(), |y, x| field.on_green(y, x), Sampling::Cubic);
            Zip::from(&mut corrected).and(&own).and(&correction).par_for_each(|restored, own, correction| {
                *restored = own + correction;
            });
            deconvolved.assign(&own);
        }
        Ok([ToneMappedImage::from_planes(restored)?, ToneMappedImage::from_planes(deconvolved)?])
    }
}

impl fmt::Display for LateralColour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the lens draws red up to {:.1} and blue up to {:.1} pixels from green; the network sees them where green is, and the result \
             has them where they are",
            self.red_px, self.blue_px
        )
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    const SIZE: [usize; 2] = [160, 192];
    const SATURATION: [f32; CHANNELS] = [1.0; CHANNELS];

    /// Detail of some pixels.
    fn detail(y: f64, x: f64) -> f32 {
        let waves =
            [(0.37, 0.21, 0.3), (0.11, -0.43, 1.7), (-0.29, 0.33, 2.9), (0.52, 0.08, 4.1), (0.05, 0.61, 5.3)];
        let sum: f64 = waves.iter().map(|(a, b, phase)| (a * y + b * x + phase).sin()).sum();
        (0.4 + 0.05 * sum) as f32
    }

    /// An image whose red is `larger` than its green, about the middle.
    fn image(larger: f64) -> ToneMappedImage {
        let [cy, cx] = SIZE.map(|side| (side - 1) as f64 / 2.0);
        let planes = Array3::from_shape_fn((CHANNELS, SIZE[0], SIZE[1]), |(channel, y, x)| {
            let (y, x) = (y as f64, x as f64);
            match channel {
                0 => 0.8 * detail(cy + (y - cy) / (1.0 + larger), cx + (x - cx) / (1.0 + larger)),
                1 => detail(y, x),
                _ => 1.3 * detail(y, x),
            }
        });
        ToneMappedImage::from_planes(planes).unwrap()
    }

    fn found(image: &ToneMappedImage) -> Option<Lateral> {
        let capture = LinearImage::from_planes(image.planes().to_owned()).unwrap();
        Lateral::find(image, &capture, SATURATION)
    }

    #[test]
    fn red_that_is_drawn_larger_is_brought_to_green_and_corrections_back() {
        let (image, aligned_image) = (image(0.012), image(0.0));
        let lateral = found(&image).expect("red lies beside green");
        let LateralColour { red_px, blue_px } = lateral.furthest();
        // Of 124 pixels from the middle to a corner.
        assert!((red_px - 1.5).abs() < 0.15 && blue_px == 0.0, "{red_px} {blue_px}");
        let mut planes: Planes = std::iter::once((Plane::Deconvolved, image.clone())).collect();
        let (shown, aligned) = lateral.align(image.clone(), &mut planes).unwrap();
        let inner = |image: &ToneMappedImage, other: &ToneMappedImage| {
            let pairs = image.planes().slice(ndarray::s![0, 8..152, 8..184]).to_owned()
                - other.planes().slice(ndarray::s![0, 8..152, 8..184]);
            (pairs.iter().map(|error| error * error).sum::<f32>() / pairs.len() as f32).sqrt()
        };
        let [before, after] = [inner(&image, &aligned_image), inner(&shown, &aligned_image)];
        assert!(after < 0.15 * before, "{before} {after}");
        // What a network makes where green is.
        let deconvolved = planes.take(Plane::Deconvolved).unwrap();
        let corrected = |image: &ToneMappedImage| image.map_values(|value| 1.05 * value);
        let [restored, own] = aligned.bring_back(corrected(&deconvolved), deconvolved.clone()).unwrap();
        assert_eq!(own, image, "as it was, bit by bit");
        assert!(inner(&restored, &corrected(&image)) < 0.05 * inner(&restored, &image));
    }

    #[test]
    fn colours_that_lie_on_each_other_are_left_where_they_are() {
        assert!(found(&image(0.0)).is_none());
        assert!(found(&image(0.001)).is_none(), "an eighth of a pixel");
        let flat = ToneMappedImage::from_planes(Array3::from_elem((CHANNELS, 96, 96), 0.3)).unwrap();
        assert!(found(&flat).is_none());
        let small = ToneMappedImage::from_planes(Array3::from_elem((CHANNELS, 5, 7), 0.3)).unwrap();
        assert!(found(&small).is_none());
    }

    #[test]
    fn saturated_pixels_tell_nothing() {
        let image = image(0.012);
        let capture = LinearImage::from_planes(Array3::from_elem((CHANNELS, SIZE[0], SIZE[1]), 1.0)).unwrap();
        assert!(Lateral::find(&image, &capture, SATURATION).is_none());
    }
}
