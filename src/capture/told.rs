//! What the user says of pictures: levels and colours, exposure times, dark frames, how to fuse them.

use std::path::PathBuf;

use ndarray::Array2;

use super::fuse::{FuseConfig, MergeRule};
use crate::core::bayer::BayerPattern;
use crate::core::error::Result;
use crate::core::tone::ToneFlags;
use crate::io::{DomainTag, expand_inputs, sha256_of_input};

/// The exposure times of the paper's bracket of a PSF.
pub const PSF_BRACKET: [f64; 3] = [1.0, 1.0 / 32.0, 1.0 / 768.0];

/// The exposure times of the paper's bracket of a scene.
pub const SCENE_BRACKET: [f64; 3] = [1.0, 1.0 / 4.0, 1.0 / 16.0];

/// The levels and colours of raw pictures, as far as the user says them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToldLevels {
    /// The value of a full photosite; above 1 in the integers of the file.
    pub white: Option<f64>,
    /// The value of a dark photosite, in the same units.
    pub black: Option<f64>,
    /// The colours of a mosaic.
    pub bayer: Option<BayerPattern>,
    /// Gains of red, green and blue.
    pub white_balance: Option<[f64; 3]>,
}

/// What the user says of pictures; the default says nothing, so that they must say all themselves.
#[derive(Clone, Debug, Default)]
pub struct Told {
    /// Levels and colours.
    pub levels: ToldLevels,
    /// What the values are, where the files do not say it.
    pub domain: Option<DomainTag>,
    /// The tone curve of tone-mapped images, as far as the user says it against their files.
    pub tone: ToneFlags,
    /// Exposure times in the order of the files; only their ratios count.
    pub exposures: Option<Vec<f64>>,
    /// The exposure times of three pictures of which nobody says them; a picture alone has the time 1 then. Without,
    /// such pictures are refused.
    pub default_times: Option<[f64; 3]>,
    /// Whether the ratios of the exposure times are taken from the pictures.
    pub estimate_exposures: bool,
    /// How the exposures are combined.
    pub merge: MergeRule,
    /// Whether exposures are fused that moved by more than a pixel.
    pub allow_motion: bool,
    /// Pictures taken with the cap on: files, folders and patterns.
    pub darks: Option<Vec<PathBuf>>,
    /// Exposure times of the dark frames, in their order and the unit of `exposures`.
    pub dark_exposures: Option<Vec<f64>>,
    /// Good pixels; the others are filled from their neighbours.
    pub mask: Option<Array2<bool>>,
    /// Whether the pictures are of a point source: the energy of a mosaic must be kept, and the background be true.
    pub demosaic_linear: bool,
}

impl Told {
    /// Whether the user says that pictures are raw: in need of levels, dark frames, colours or balance.
    pub fn is_raw(&self) -> bool {
        self.levels != ToldLevels::default() || self.darks.is_some()
    }

    /// How to fuse pictures that say nothing themselves, the levels as the user gave them.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) for levels and gains that no picture has.
    pub fn config(&self) -> Result<FuseConfig> {
        let default = FuseConfig::default();
        let ToldLevels { white, black, bayer, white_balance } = self.levels;
        let config = FuseConfig {
            white: white.unwrap_or(default.white),
            black: black.unwrap_or(default.black),
            merge: self.merge,
            bayer,
            white_balance: white_balance.unwrap_or(default.white_balance),
            estimate_exposures: self.estimate_exposures,
            max_motion_px: if self.allow_motion { None } else { default.max_motion_px },
            demosaic_linear: self.demosaic_linear,
            finds_white: white.is_none(),
            ..default
        };
        // Where the user does not say white, the files may.
        FuseConfig { white: white.unwrap_or(f64::MAX), ..config.clone() }.check()?;
        Ok(config)
    }

    /// SHA-256 of the dark frames in their order, which are read for it; what is no file, such as a pipe, has none.
    ///
    /// # Errors
    /// [`Error::Io`](crate::core::error::Error::Io) for files that cannot be read.
    pub fn darks_sha256(&self) -> Result<Option<Vec<Option<String>>>> {
        let Some(named) = &self.darks else { return Ok(None) };
        expand_inputs(named)?.iter().map(|file| sha256_of_input(file)).collect::<Result<_>>().map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_level_colour_or_dark_frame_makes_pictures_raw() {
        assert!(!Told { exposures: Some(vec![1.0]), ..Told::default() }.is_raw());
        assert!(Told { darks: Some(vec!["dark.exr".into()]), ..Told::default() }.is_raw());
        let levels = ToldLevels { black: Some(0.0), ..ToldLevels::default() };
        assert!(Told { levels, ..Told::default() }.is_raw());
    }

    #[test]
    fn black_must_lie_below_white_where_both_are_said() {
        let told = |white, black| Told {
            levels: ToldLevels { white, black: Some(black), ..ToldLevels::default() },
            ..Told::default()
        };
        assert!(told(Some(1023.0), 64.0).config().is_ok());
        assert!(told(None, 64.0).config().is_ok(), "the files may say a white above it");
        assert!(told(Some(1.0), 64.0).config().is_err());
    }
}
