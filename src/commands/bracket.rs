//! The flags that say how raw pictures are read, shared by `udc fuse` and `udc restore`.

mod levels;
mod shots;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use ndarray::Array3;
use serde_json::{Value, json};

use udc::capture::{Bracket, FuseConfig, Fused, MergeRule, Uneven, relative_times, show_time};
use udc::core::bayer::BayerPattern;
use udc::core::error::Error;
use udc::io::{
    DomainTag, Encoding, Pixels, RawMetadata, expand_inputs, inspect_image, inspect_mosaic, sha256_of_file,
};

use super::{Session, text_of};
pub(crate) use levels::much_is_saturated;
use levels::{check_floats, check_reachable};
use shots::{Shot, differ, exposures, exposures_of_darks, gains_of_daylight, is_in_doubt, without_dark};

#[derive(Args, Debug)]
pub(crate) struct BracketArgs {
    /// Exposure times of a bracket, in the order of the files; only their ratios count [default: those in the files,
    /// else in `udc fuse` 1,1/4,1/16, with --psf 1,1/32,1/768]
    ///
    /// Files of one time, within 1 %, are averaged: 1,1,1,1/4,1/4,1/4. Seconds do as well as shares: 1/60,1/240,1/960 is the same bracket as 1,1/4,1/16. Irradiance 1 is white of the
    /// longest exposure.
    #[arg(long, value_name = "T,T,…", value_delimiter = ',', value_parser = parse_fraction)]
    pub(crate) exposures: Option<Vec<f64>>,
    /// Take the ratios of the exposure times from the pictures, where cameras round them
    #[arg(long)]
    estimate_exposures: bool,
    /// Value of a full photosite; above 1 in the integers of the file [default: what a DNG says, else 1]
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
    #[arg(long, value_enum, value_name = "PATTERN")]
    pub(crate) bayer: Option<Bayer>,
    /// Gains of red, green and blue [default: what a DNG says, else those of its camera's daylight, else 1,1,1]
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', value_parser = parse_fraction)]
    white_balance: Option<Vec<f64>>,
    /// Take the longest unsaturated exposure, or the mean of all weighted by time [default: longest]
    #[arg(long, value_enum, value_name = "RULE")]
    merge: Option<Merge>,
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

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Merge {
    Longest,
    Weighted,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Bayer {
    Rggb,
    Bggr,
    Grbg,
    Gbrg,
}

/// The pictures of a bracket as they were read.
pub(crate) struct Pictures {
    pub(crate) planes: Vec<Array3<f32>>,
    /// The exposures of the files, where all of them tell their time.
    pub(crate) times: Option<Vec<f64>>,
    /// How to fuse them, the levels in the units of the planes.
    pub(crate) config: FuseConfig,
    /// What the first file says, where it is a camera's raw one.
    pub(crate) raw: Option<RawMetadata>,
    /// What each picture tells of its exposure.
    shots: Vec<Shot>,
    /// Pictures without light, where there are any.
    darks: Vec<Array3<f32>>,
    /// Their exposures in the unit of `times`, where all files tell theirs.
    dark_times: Option<Vec<f64>>,
    dark_shots: Vec<Shot>,
    /// Whether files of dark frames tell times that contradict each other.
    darks_differ: bool,
}

impl Pictures {
    /// The exposures of the files, none where no file tells its time.
    ///
    /// # Errors
    /// When some files tell it and some do not, or some tell different sensitivities and some none.
    pub(crate) fn told_times(&self) -> Result<Option<&[f64]>> {
        if self.times.is_none() && self.shots.iter().any(|shot| shot.seconds.is_some()) {
            bail!(
                "not every picture says its exposure time: add --exposures T,T,… in the order of the files"
            );
        }
        if self.times.is_some() && is_in_doubt(&self.shots) {
            bail!(
                "not every picture says its ISO, and those that do say different ones: add --exposures T,T,… in the order of \
                 the files"
            );
        }
        Ok(self.times.as_deref())
    }
}

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

    /// Checks what clap cannot.
    pub(crate) fn config(&self) -> Result<FuseConfig> {
        let default = FuseConfig::default();
        let white_balance = match self.white_balance.as_deref() {
            None => default.white_balance,
            Some(&[red, green, blue]) => [red, green, blue],
            Some(gains) => {
                bail!("--white-balance takes three gains, red, green and blue; found {}", gains.len())
            }
        };
        let config = FuseConfig {
            white: self.white.unwrap_or(default.white),
            black: self.black.unwrap_or(default.black),
            merge: self.merge.map_or(default.merge, MergeRule::from),
            bayer: self.bayer.map(BayerPattern::from),
            white_balance,
            estimate_exposures: self.estimate_exposures,
            max_motion_px: if self.allow_motion { None } else { default.max_motion_px },
            ..default
        };
        // Without --white, the files may say it.
        FuseConfig { white: self.white.unwrap_or(f64::MAX), ..config.clone() }.check()?;
        Ok(config)
    }

    /// Reads the pictures of a bracket, unless the user asks to stop; of those of integers that no flag and no file declares
    /// raw, the user must have `told` the domain.
    pub(crate) fn read(
        &self,
        files: &[PathBuf],
        told: Option<DomainTag>,
        session: &Session,
    ) -> Result<Pictures> {
        let mut config = self.config()?;
        let dark_files = self.dark.as_deref().map_or(Ok(Vec::new()), expand_inputs)?;
        let mut raw: Option<RawMetadata> = None;
        let mut largest = None;
        let (mut planes, mut shots) = (Vec::with_capacity(files.len()), Vec::new());
        for (index, file) in files.iter().chain(&dark_files).enumerate() {
            session.progress.check()?;
            let (pixels, encoding) = self.read_picture(file, told, session)?;
            if index == 0 {
                raw.clone_from(&pixels.raw);
            }
            self.check_alike(file, raw.as_ref(), pixels.raw.as_ref())?;
            let scale = largest_integer(&encoding.sample_type);
            if self.in_integers(raw.as_ref()) && *largest.get_or_insert(scale) != scale {
                bail!(
                    "{} is stored in another type than the other pictures: give --white and --black for one type",
                    file.display()
                );
            }
            planes.push(pixels.planes);
            shots.push(Shot { seconds: pixels.exposure_s, iso: pixels.iso });
        }
        let largest = largest.flatten();
        for (flag, level) in [("--white", self.white), ("--black", self.black)] {
            level.map_or(Ok(()), |level| check_reachable(flag, level, largest))?;
        }
        if let (true, Some(largest)) = (self.in_integers(raw.as_ref()), largest) {
            (config.white, config.black) = (config.white / largest, config.black / largest);
        }
        if let Some(raw) = &raw {
            config.white = self.white.map_or(raw.white, |_| config.white);
            config.black = self.black.map_or(raw.black, |_| config.black);
            config.bayer = config.bayer.or(raw.bayer);
            if self.white_balance.is_none() {
                config.white_balance = gains_of(&files[0], raw, session).unwrap_or(config.white_balance);
            }
        }
        if self.white.is_none() && config.black >= config.white {
            let (black, white) = (config.black, config.white);
            bail!("black {black} does not lie below white {white}: give --white as well, in the same units");
        }
        let darks = planes.split_off(files.len());
        let count = files.len();
        if raw.is_none()
            && largest.is_none()
            && let Some(warning) = check_floats(&planes, self.white)?
        {
            session.warn(format_args!("{}: {warning}", names_of(files)));
        }
        let dark_shots = shots.split_off(count);
        let told: Vec<f64> = dark_shots.iter().filter_map(|shot| shot.seconds).collect();
        let darks_differ = differ(&told);
        let (times, dark_times) = (exposures(&shots), exposures_of_darks(&shots, &dark_shots));
        Ok(Pictures { planes, times, config, raw, shots, darks, dark_times, dark_shots, darks_differ })
    }

    /// Puts pictures, their times and the dark frames together.
    pub(crate) fn join(&self, pictures: &mut Pictures, times: &[f64]) -> Result<Bracket> {
        let bracket = Bracket::new(std::mem::take(&mut pictures.planes), times)?;
        if self.dark.is_none() {
            return Ok(bracket);
        }
        let times_are_told = self.exposures.is_none() && pictures.times.is_some();
        let dark_times =
            self.dark_exposures.clone().or(pictures.dark_times.take().filter(|_| times_are_told));
        if dark_times.is_none() && pictures.darks_differ {
            bail!(
                "the dark frames have different exposure times, and it is not known which pictures they belong to: give \
                 both --exposures and --dark-exposures, or dark frames of one time"
            );
        }
        if let (None, Some(dark_times)) = (&self.dark_exposures, &dark_times) {
            let shots = [&pictures.shots[..], &pictures.dark_shots];
            if let Some(reason) = without_dark([times, dark_times], &bracket.times(), shots) {
                bail!("{reason}");
            }
        }
        Ok(bracket.with_darks(std::mem::take(&mut pictures.darks), dark_times.as_deref())?)
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

    /// SHA-256 of the dark frames in their order, which are read for it; what is no file, such as a pipe, has none.
    pub(crate) fn darks_sha256(&self) -> Result<Option<Vec<Option<String>>>> {
        let Some(named) = &self.dark else { return Ok(None) };
        let of_file = |file: &PathBuf| file.is_file().then(|| sha256_of_file(file)).transpose();
        let found: Vec<Option<String>> =
            expand_inputs(named)?.iter().map(of_file).collect::<std::result::Result<_, _>>()?;
        Ok(Some(found))
    }

    fn read_picture(
        &self,
        file: &Path,
        told: Option<DomainTag>,
        session: &Session,
    ) -> Result<(Pixels, Encoding)> {
        let mut read = match self.bayer {
            Some(pattern) => inspect_mosaic(file, pattern.into())?,
            None => inspect_image(file)?,
        };
        let is_raw = read.0.raw.is_some() || self.declares_raw(&read.0, &read.1);
        if (is_raw || self.is_raw()) && told == Some(DomainTag::Srgb) {
            bail!(
                "{}: levels, dark frames, a mosaic and gains are of raw pictures, whose values are linear, and --domain says \
                 srgb: leave one of them out",
                file.display()
            );
        }
        if let Some(contradiction) = read.0.tell(file, told)? {
            session.warn(contradiction);
        }
        if !is_raw {
            self.check_told(file, &read.0)?;
        } else if let (None, None, Some(found)) =
            (told, &read.0.raw, read.0.contradictions(DomainTag::Linear))
        {
            session.warn(format!(
                "{}: {found}; as --white, --black or --bayer have it, the values are taken for linear light",
                file.display()
            ));
        }
        if let Some(tag @ (DomainTag::ToneMapped | DomainTag::Display)) = read.0.domain {
            let reason =
                format!("holds {} values, which add up to nothing; use the linear pictures", tag.name());
            return Err(Error::format(file, reason).into());
        }
        Ok(read)
    }

    /// Whether the flags make a file that is no camera's own a raw one: their levels do not of three channels of integers,
    /// which are a picture for the screen unless 16 bits with a white level of their own say that they are demosaicked.
    fn declares_raw(&self, pixels: &Pixels, encoding: &Encoding) -> bool {
        let is_picture = pixels.is_integer && pixels.planes.dim().0 == 3 && self.bayer.is_none();
        let is_demosaicked =
            self.white.is_some() && largest_integer(&encoding.sample_type) != Some(f64::from(u8::MAX));
        self.is_raw() && (!is_picture || is_demosaicked)
    }

    /// Asks what the values of a picture are, where neither it nor the user says it.
    fn check_told(&self, file: &Path, pixels: &Pixels) -> Result<()> {
        if pixels.must_be_told() && self.is_raw() {
            bail!(
                "{} does not say whether its values are linear or sRGB, and levels or gains of three colours do not either: \
                 add --domain linear to apply them, or leave them out and add --domain srgb",
                file.display()
            );
        }
        Ok(pixels.check_told_light(file)?)
    }

    /// Whether the levels of the flags are the file's own integers.
    fn in_integers(&self, raw: Option<&RawMetadata>) -> bool {
        self.white.map_or(raw.is_some(), |white| white > 1.0)
    }

    /// Refuses a raw file of other levels or colours than the first, unless flags give them.
    fn check_alike(
        &self,
        file: &Path,
        first: Option<&RawMetadata>,
        this: Option<&RawMetadata>,
    ) -> Result<()> {
        let levels = |raw: &RawMetadata| {
            let unless = |flag: bool, level: f64| (!flag).then_some(level);
            let (white, black) = (self.white.is_some(), self.black.is_some());
            let bayer = if self.bayer.is_some() { None } else { raw.bayer };
            (unless(white, raw.white), unless(black, raw.black), bayer)
        };
        if first.map(levels) != this.map(levels) {
            bail!(
                "{} says another black or white level or mosaic than the first picture; give --black, --white and \
                 --bayer",
                file.display()
            );
        }
        Ok(())
    }
}

/// The gains of a raw file, or those of daylight, as the user is told.
fn gains_of(file: &Path, raw: &RawMetadata, session: &Session) -> Option<[f64; 3]> {
    raw.white_balance.or_else(|| {
        let (gains, warning) = gains_of_daylight(file, raw);
        session.warn(warning);
        gains
    })
}

/// By what integers were divided when they were read; OpenEXR's are kept as they are.
fn largest_integer(sample_type: &str) -> Option<f64> {
    match sample_type {
        "uint8" => Some(f64::from(u8::MAX)),
        "uint16" => Some(f64::from(u16::MAX)),
        _ => None,
    }
}

/// What the user should look at in a fused bracket.
pub(crate) fn warnings_of(fused: &Fused) -> Vec<String> {
    let mut warnings = Vec::new();
    for (found, times) in fused.ratio_found.iter().zip(fused.times.windows(2)) {
        if let Some(found) = found.filter(|found| (found - 1.0).abs() > 0.1) {
            warnings.push(format!(
                "exposure {} is {found:.2} times as bright as {} lets expect; check the times, or pass \
                 --estimate-exposures",
                show_time(times[1]),
                show_time(times[0])
            ));
        }
    }
    for Uneven { pictures: [first, other], ratio } in &fused.uneven {
        warnings.push(format!(
            "picture {other} is {ratio:.2} times as bright as picture {first} of the same exposure time; check the times"
        ));
    }
    if fused.greens_look_swapped {
        warnings.push("the mosaic's greens look as if on the other diagonal; check --bayer".to_owned());
    }
    warnings
}

/// The names of files, for messages.
pub(crate) fn names_of(files: &[PathBuf]) -> String {
    files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(" ")
}

impl From<Merge> for MergeRule {
    fn from(merge: Merge) -> Self {
        match merge {
            Merge::Longest => Self::Longest,
            Merge::Weighted => Self::Weighted,
        }
    }
}

impl From<Bayer> for BayerPattern {
    fn from(bayer: Bayer) -> Self {
        match bayer {
            Bayer::Rggb => Self::Rggb,
            Bayer::Bggr => Self::Bggr,
            Bayer::Grbg => Self::Grbg,
            Bayer::Gbrg => Self::Gbrg,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use udc::core::progress::Progress;

    #[derive(clap::Parser)]
    struct Flags {
        #[command(flatten)]
        bracket: BracketArgs,
    }

    #[test]
    fn reads_no_further_picture_once_the_user_asks_to_stop() {
        let flags = <Flags as clap::Parser>::parse_from(["udc"]);
        let mut session = Session::silent(false);
        session.progress = Progress::new(None, std::sync::Arc::new(true.into()));
        let error = flags.bracket.read(&["missing.exr".into()], None, &session).err().unwrap();
        assert!(crate::commands::was_interrupted(&error), "{error:#}");
    }

    #[test]
    fn reads_numbers_and_fractions() {
        assert_eq!(parse_fraction("0.25"), Ok(0.25));
        assert_eq!(parse_fraction(" 1 / 32 "), Ok(0.03125));
        for text in ["", "1/", "1/0", "one", "1/2/3", "inf"] {
            assert!(parse_fraction(text).is_err(), "{text}");
        }
    }
}
