//! How pictures shall look, before they are seen: settings of which some are chosen from each picture.

use serde_json::{Value, json};

use super::{ClaheConfig, Curve, FinishConfig, Look, NoiseFloor, RollOff, automatic_curve};
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::primaries::ColorSpace;

/// The light above which pictures are clipped before their colour matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Clip {
    /// That of [`FinishConfig::default`]; none where the exposure is chosen from the picture, which needs no limit beside.
    #[default]
    Usual,
    /// This light.
    At(f32),
    /// None.
    Nowhere,
}

/// How pictures shall look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Where light is clipped.
    pub clip: Clip,
    /// How light becomes display values. Without one, the exposure is chosen from the picture, or the curve is that of
    /// [`FinishConfig::default`] where a reference says how bright the picture is.
    pub curve: Option<Curve>,
    /// How the curve is applied to colours. Without one, the hue is kept where the exposure is chosen from the picture, and
    /// each channel has the curve elsewhere, as in the published pictures.
    pub roll_off: Option<RollOff>,
    /// The colours of pictures.
    pub color_space: ColorSpace,
    /// Local contrast. Its noise counts where [`noise`](Self::noise) says it.
    pub clahe: Option<ClaheConfig>,
    /// The noise whose contrast is not raised. Without, it is estimated where the exposure is chosen from the picture, and
    /// ignored elsewhere, as in the published pictures.
    pub noise: Option<NoiseFloor>,
    /// The stops by which displays with headroom may show highlights brighter.
    pub hdr_stops: Option<f32>,
}

impl Default for Style {
    /// An exposure that is chosen from the picture, and local contrast.
    fn default() -> Self {
        Self {
            clip: Clip::Usual,
            curve: None,
            roll_off: None,
            color_space: ColorSpace::default(),
            clahe: Some(ClaheConfig::default()),
            noise: None,
            hdr_stops: None,
        }
    }
}

impl Style {
    /// Checks that every setting is in range.
    ///
    /// # Errors
    /// As [`FinishConfig::check`].
    pub fn check(&self) -> Result<()> {
        let config = self.published(false);
        // What is asked for beyond white depends on the curve, which may be chosen from the picture.
        FinishConfig { hdr_stops: config.hdr_stops.filter(|_| self.curve.is_some()), ..config }.check()
    }

    /// Whether the exposure of a picture is chosen from it.
    pub fn is_automatic(&self, has_reference: bool) -> bool {
        self.curve.is_none() && !has_reference
    }

    /// The settings of a picture, whose exposure is chosen from it where that is asked for; `ceiling` is the light at which
    /// captures of unknown levels clip.
    pub fn config_of(&self, image: &LinearImage, look: &Look, eight_bit: bool, ceiling: f32) -> FinishConfig {
        if self.is_automatic(look.reference_means.is_some()) {
            let curve = automatic_curve(image, look, ceiling);
            FinishConfig { curve, ..self.photographic(eight_bit) }
        } else {
            self.published(eight_bit)
        }
    }

    /// The settings as far as they are known before a picture is seen.
    pub(super) fn describe(&self, has_reference: bool, eight_bit: bool) -> Value {
        if !self.is_automatic(has_reference) {
            return json!(self.published(eight_bit));
        }
        let mut described = json!(self.photographic(eight_bit));
        described["curve"] = json!("automatic");
        described
    }

    /// The settings that are not given as the published pictures have them.
    fn published(&self, eight_bit: bool) -> FinishConfig {
        let clip = if self.clip == Clip::Usual { FinishConfig::default().clip } else { self.clip.light() };
        self.config_with(clip, RollOff::Channels, NoiseFloor::Ignored, eight_bit)
    }

    /// Those that are not given as photographs have them, but for the curve.
    fn photographic(&self, eight_bit: bool) -> FinishConfig {
        self.config_with(self.clip.light(), RollOff::Hue, NoiseFloor::Estimated, eight_bit)
    }

    fn config_with(
        &self,
        clip: Option<f32>,
        roll_off: RollOff,
        noise: NoiseFloor,
        eight_bit: bool,
    ) -> FinishConfig {
        let noise = self.noise.unwrap_or(noise);
        FinishConfig {
            clip,
            curve: self.curve.unwrap_or(FinishConfig::default().curve),
            roll_off: self.roll_off.unwrap_or(roll_off),
            color_space: self.color_space,
            clahe: self.clahe.map(|clahe| ClaheConfig { noise, ..clahe }),
            hdr_stops: self.hdr_stops,
            eight_bit,
        }
    }
}

impl Clip {
    /// The light that is told.
    fn light(self) -> Option<f32> {
        match self {
            Self::At(light) => Some(light),
            Self::Usual | Self::Nowhere => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn a_chosen_exposure_has_no_limit_beside_but_the_one_that_is_given() {
        let image = LinearImage::from_planes(Array3::from_elem((3, 4, 4), 0.2)).unwrap();
        let alone = Look::default();
        let compared = Look { reference_means: Some([0.5; 3]), ..alone };
        let config = |style: Style, look: &Look| style.config_of(&image, look, true, 500.0);
        let style = Style::default();
        assert_eq!(config(style, &alone).curve, automatic_curve(&image, &alone, 500.0));
        assert_eq!(config(style, &alone).clip, None);
        assert_eq!(config(style, &alone).roll_off, RollOff::Hue);
        assert_eq!(config(style, &alone).clahe.unwrap().noise, NoiseFloor::Estimated);
        assert_eq!(config(style, &compared), FinishConfig::default());
        let given = Style { clip: Clip::At(3.0), ..style };
        assert_eq!(config(given, &alone).clip, Some(3.0));
        assert_eq!(config(given, &compared).clip, Some(3.0));
        let none = Style { clip: Clip::Nowhere, curve: Some(Curve::Srgb { max: 2.0 }), ..style };
        assert_eq!((config(none, &alone).clip, config(none, &alone).curve), (None, Curve::Srgb { max: 2.0 }));
    }

    #[test]
    fn a_description_says_which_exposures_are_chosen() {
        let style = Style::default();
        assert_eq!(style.describe(false, true)["curve"], json!("automatic"));
        assert_eq!(style.describe(false, true)["clip"], Value::Null);
        assert_eq!(
            style.describe(true, false),
            json!(FinishConfig { eight_bit: false, ..Default::default() })
        );
        assert!(Style { clip: Clip::At(-1.0), ..style }.check().is_err() && style.check().is_ok());
    }
}
