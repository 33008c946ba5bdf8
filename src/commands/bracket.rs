//! The flags that say how raw pictures are read, shared by `udc fuse` and `udc restore`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use serde_json::{Value, json};

use udc::capture::{FuseConfig, MergeRule, Told, ToldLevels, relative_times};
use udc::core::bayer::BayerPattern;
use udc::io::DomainTag;

use super::choices::Choices;
use super::text_of;

#[derive(Args, Debug)]
pub(crate) struct BracketArgs {
    /// Exposure times of a bracket, in the order of the files; only their ratios count [default: those in the files,
    /// else in `udc fuse` 1,1/4,1/16, with --point-source 1,1/32,1/768]
    ///
    /// Files of one time, within 1 %, are averaged: 1,1,1,1/4,1/4,1/4. Seconds do as well as shares: 1/60,1/240,1/960 is the same bracket as 1,1/4,1/16. Irradiance 1 is white of the
    /// longest exposure.
    #[arg(long, value_name = "T,T,…", value_delimiter = ',', value_parser = parse_fraction)]
    pub(crate) exposures: Option<Vec<f64>>,
    /// Take the ratios of the exposure times from the pictures, where cameras round them
    #[arg(long)]
    estimate_exposures: bool,
    /// Value of a full photosite as the file stores it; above 1 in the integers of the file [default: what a DNG says, or what the values of its mosaic alone end at, else 1]
    #[arg(long, value_name = "W", value_parser = parse_fraction)]
    white: Option<f64>,
    /// Value of a dark photosite, in the same units [default: what a DNG says, else 0]
    #[arg(long, value_name = "B", value_parser = parse_fraction)]
    black: Option<f64>,
    /// Colours of the first two rows of a mosaic [default: what a DNG says]
    ///
    /// A mosaic is one channel, or four channels of half its size, one for each photosite: channels R, G1, G2, B or
    /// R, Gr, Gb, B of an EXR; the channels of an RGBA PNG, TIFF or EXR, or the last axis of a .npy, in reading order.
    /// Greens on the wrong diagonal are noticed; red and blue exchanged look like another scene.
    #[arg(long, value_name = "PATTERN", value_parser = MOSAICS)]
    pub(crate) bayer: Option<BayerPattern>,
    /// Gains of red, green and blue [default: what a DNG says, else those of its camera's daylight, else 1,1,1]
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', value_parser = parse_fraction)]
    white_balance: Option<Vec<f64>>,
    /// Take the longest unsaturated exposure, or the mean of all weighted by time [default: longest]
    #[arg(long, value_name = "RULE", value_parser = MERGES)]
    merge: Option<MergeRule>,
    /// Fuse exposures even if the camera moved by more than a pixel between them
    #[arg(long)]
    allow_motion: bool,
    /// Pictures taken with the cap on: subtracted, and pixels that shine in them filled from their neighbours
    ///
    /// Where the files tell their exposure times, or --exposures and --dark-exposures do, each exposure needs dark frames of
    /// its own time, and takes their mean. Without times, the mean of all is taken off every picture. They are levelled
    /// as the pictures are.
    #[arg(long, value_name = "DARK", num_args = 1..)]
    dark: Option<Vec<PathBuf>>,
    /// Exposure times of the dark frames, in their order and the unit of --exposures
    #[arg(
        long, value_name = "T,T,…", value_delimiter = ',', value_parser = parse_fraction,
        requires_all = ["dark", "exposures"]
    )]
    dark_exposures: Option<Vec<f64>>,
}

const MERGES: Choices<MergeRule> =
    Choices(&[("longest", MergeRule::Longest, ""), ("weighted", MergeRule::Weighted, "")]);

const MOSAICS: Choices<BayerPattern> = Choices(&[
    ("rggb", BayerPattern::Rggb, ""),
    ("bggr", BayerPattern::Bggr, ""),
    ("grbg", BayerPattern::Grbg, ""),
    ("gbrg", BayerPattern::Gbrg, ""),
]);

/// Reads `0.5`, `1/32`, `16383/65535`.
pub(crate) fn parse_fraction(text: &str) -> std::result::Result<f64, String> {
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    let value = match text.split_once('/') {
        Some((above, below)) => number(above).zip(number(below)).map(|(above, below)| above / below),
        None => number(text),
    };
    value
        .filter(|value| value.is_finite())
        .ok_or_else(|| "write a number or a fraction such as 1/32".to_owned())
}

impl BracketArgs {
    /// The dark frames that are named.
    pub(super) fn dark_frames(&self) -> &[PathBuf] {
        self.dark.as_deref().unwrap_or_default()
    }

    /// Whether a flag says that the input is raw: in need of levels, dark frames, colours or balance.
    pub(crate) fn is_raw(&self) -> bool {
        let levels = self.white.is_some() || self.black.is_some() || self.dark.is_some();
        levels || self.bayer.is_some() || self.white_balance.is_some()
    }

    /// A flag that says how exposures are joined, where one was given.
    pub(crate) fn flag_of_brackets(&self) -> Option<&'static str> {
        let flags = [
            (self.estimate_exposures, "--estimate-exposures"),
            (self.merge.is_some(), "--merge"),
            (self.allow_motion, "--allow-motion"),
        ];
        flags.into_iter().find_map(|(given, flag)| given.then_some(flag))
    }

    /// What the flags say of pictures, of which the user also says the domain.
    pub(crate) fn told(&self, domain: Option<DomainTag>) -> Result<Told> {
        let white_balance = match self.white_balance.as_deref() {
            None => None,
            Some(&[red, green, blue]) => Some([red, green, blue]),
            Some(gains) => {
                bail!("--white-balance takes three gains, red, green and blue; found {}", gains.len())
            }
        };
        let bayer = self.bayer;
        Ok(Told {
            levels: ToldLevels { white: self.white, black: self.black, bayer, white_balance },
            domain,
            exposures: self.exposures.clone(),
            estimate_exposures: self.estimate_exposures,
            merge: self.merge.unwrap_or_default(),
            allow_motion: self.allow_motion,
            darks: self.dark.clone(),
            dark_exposures: self.dark_exposures.clone(),
            ..Told::default()
        })
    }

    /// Checks what clap cannot.
    pub(crate) fn config(&self) -> Result<FuseConfig> {
        Ok(self.told(None)?.config()?)
    }

    /// What the flags say of dark frames, their files aside.
    pub(crate) fn describe_darks(&self) -> Option<Value> {
        self.dark.as_ref()?;
        let of_longest = |times: &Vec<f64>| {
            let pictures = self.exposures.as_deref().unwrap_or_default();
            relative_times(&[pictures, times].concat()).split_off(pictures.len())
        };
        Some(json!({"exposures": self.dark_exposures.as_ref().map(of_longest)}))
    }

    /// Where the dark frames lie, as the flags name them.
    pub(crate) fn dark_files(&self) -> Option<Vec<String>> {
        Some(self.dark.as_ref()?.iter().map(|file| text_of(file)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_numbers_and_fractions() {
        assert_eq!(parse_fraction("0.25"), Ok(0.25));
        assert_eq!(parse_fraction(" 1 / 32 "), Ok(0.03125));
        for text in ["", "1/", "1/0", "one", "1/2/3", "inf"] {
            assert!(parse_fraction(text).is_err(), "{text}");
        }
    }
}
