//! What tells the data of one training from those of another.

use std::collections::BTreeMap;

use crate::core::error::{Error, Result};
use crate::core::tone::ToneCurve;

/// The part that names a list of images.
const IMAGES: &str = "images-sha256";

/// The part that knows scenes by what they hold.
const SCENES: &str = "scenes-sha256";

/// What tells the data of one training from those of another.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataIdentity {
    /// SHA-256 of the list of images.
    pub images_sha256: Option<String>,
    /// SHA-256 of the kernel bank behind the codes, where there is one.
    pub kernel_bank_sha256: Option<String>,
    /// SHA-256 of the kernel codes, where no bank is behind them.
    pub codes_sha256: Option<String>,
    /// SHA-256 of the contents of the clean images, where they are degraded as they are drawn.
    pub scenes_sha256: Option<String>,
    /// φ∘C of the images.
    pub tone_curve: ToneCurve,
}

impl DataIdentity {
    /// Every part by its name, as a training's state keeps it.
    pub(super) fn parts(&self) -> BTreeMap<String, String> {
        let ToneCurve { alpha, x_max } = self.tone_curve;
        let parts = [
            (IMAGES, self.images_sha256.clone()),
            ("kernel-bank-sha256", self.kernel_bank_sha256.clone()),
            ("codes-sha256", self.codes_sha256.clone()),
            (SCENES, self.scenes_sha256.clone()),
            ("tone-curve", Some(format!("alpha {alpha}, x-max {x_max}"))),
        ];
        parts.into_iter().filter_map(|(name, part)| Some((name.to_owned(), part?))).collect()
    }

    /// Refuses to go on with other data than those of which a state kept these parts; states of older versions kept
    /// none.
    pub(super) fn check_same(&self, kept: &BTreeMap<String, String>) -> Result<()> {
        let parts = self.parts();
        let Some((name, was)) = kept.iter().find(|(name, was)| parts.get(*name) != Some(was)) else {
            return Ok(());
        };
        if name == IMAGES && !parts.contains_key(IMAGES) && !kept.contains_key(SCENES) {
            let reason = "the run's checkpoint is of an older version, which knew clean images by their names alone: they \
                          may be others by now; begin a new run, with the checkpoint's weights as --init to go on from them";
            return Err(Error::config("data", reason));
        }
        let is = parts.get(name).map_or("absent", String::as_str);
        let reason = format!(
            "these are other data than the run learned from: {name} is {is} and was {was}; resume with its own, or \
             begin a new run"
        );
        Err(Error::config("data", reason))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_data_are_told_by_the_part_that_differs() {
        let data = DataIdentity { images_sha256: Some("ab".to_owned()), ..DataIdentity::default() };
        data.check_same(&data.parts()).unwrap();
        data.check_same(&BTreeMap::new()).unwrap();
        let other = DataIdentity { images_sha256: Some("cd".to_owned()), ..data.clone() };
        let message = other.check_same(&data.parts()).unwrap_err().to_string();
        assert!(message.contains("images-sha256 is cd and was ab"), "{message}");
        let other = DataIdentity { tone_curve: ToneCurve { alpha: 0.5, x_max: 500.0 }, ..data.clone() };
        let message = other.check_same(&data.parts()).unwrap_err().to_string();
        assert!(message.contains("tone-curve is alpha 0.5, x-max 500 and was alpha 0.25"), "{message}");
    }

    #[test]
    fn a_checkpoint_that_knew_scenes_by_their_names_alone_says_so() {
        let data = DataIdentity { scenes_sha256: Some("ab".to_owned()), ..DataIdentity::default() };
        let mut kept = data.parts();
        data.check_same(&kept).unwrap();
        kept.remove(SCENES);
        kept.insert(IMAGES.to_owned(), "cd".to_owned());
        let message = data.check_same(&kept).unwrap_err().to_string();
        assert!(message.contains("names alone") && message.contains("--init"), "{message}");
    }
}
