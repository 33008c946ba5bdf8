//! Develops a capture: the whole way from files of raw pictures to one image of linear light.

use std::path::PathBuf;

use super::bracket::Bracket;
use super::exposure_times::relative_times;
use super::fuse::{FuseConfig, Fused, fuse};
use super::pictures::Pictures;
use super::told::Told;
use super::warnings::uncorrected;
use crate::core::capture::{CaptureInfo, is_level};
use crate::core::error::{Error, Result};
use crate::core::progress::Progress;
use crate::io::RawMetadata;

/// A capture in linear light, and what is known of it.
#[derive(Clone, Debug)]
pub struct Developed {
    /// The image, and where its values come from.
    pub fused: Fused,
    /// What finishing needs to know of the capture.
    pub info: CaptureInfo,
    /// What the first file says, where it is a camera's raw one.
    pub raw: Option<RawMetadata>,
    /// How the pictures were fused, levels as shares of the largest integer or as the floats of the files.
    pub config: FuseConfig,
    /// The exposures in the order of the files, as shares of the longest.
    pub exposures: Vec<f64>,
    /// The longest of them, in the unit in which the user or the files say it.
    pub longest_exposure: f64,
    /// What the user should look at: those of [`Pictures::warnings`] that were left there, then those of the fusion.
    pub warnings: Vec<String>,
}

/// Reads pictures of one scene, one or a bracket, and makes one image of linear light of them.
///
/// # Errors
/// As [`Pictures::read`] and [`Pictures::develop`].
pub fn develop(files: &[PathBuf], told: &Told, progress: &Progress) -> Result<Developed> {
    let pictures = Pictures::read(files, told, progress)?;
    progress.check()?;
    pictures.develop()
}

impl Pictures {
    /// Levels the pictures, takes dark frames off, fuses them to one image and interpolates the colours of a mosaic.
    ///
    /// # Errors
    /// Exposure times that nobody says or that contradict the pictures, dark frames that belong to other pictures, and those
    /// of [`fuse`].
    pub fn develop(mut self) -> Result<Developed> {
        let times = self.times()?;
        let bracket = self.join(&times).map_err(|error| self.blame_times(error))?;
        self.fuse(bracket, &times)
    }

    fn fuse(self, bracket: Bracket, times: &[f64]) -> Result<Developed> {
        let Self { mut warnings, config, raw, said, divided_by, .. } = self;
        let gains = config.white_balance;
        let [r, g, b] = divided_by.unwrap_or([1.0; 3]);
        let white_balance = [gains[0] * r, gains[1] * g, gains[2] * b];
        // The white of other files is that of their integers, or 1.
        let finds_white = config.finds_white && raw.is_some();
        let config = FuseConfig { white_balance, finds_white, ..config };
        let fused = fuse(bracket, &config)?;
        warnings.extend(fused.much_is_saturated());
        warnings.extend(fused.warnings());
        warnings.extend(raw.as_ref().and_then(uncorrected));
        let info = info_of(&fused, raw.as_ref(), said, gains);
        let longest_exposure = times.iter().copied().fold(0.0, f64::max);
        let (exposures, config) = (relative_times(times), FuseConfig { white_balance: gains, ..config });
        Ok(Developed { fused, info, raw, config, exposures, longest_exposure, warnings })
    }

    /// Says that the times are the files' own, where nobody else has any.
    fn blame_times(&self, error: Error) -> Error {
        if self.told.exposures.is_some() || self.told.default_times.is_some() {
            return error;
        }
        Error::Unsupported(format!(
            "the exposure times are the files' own; to give others, add --exposures T,T,…: {error}"
        ))
    }
}

/// What finishing needs to know of a capture that was read from raw files, or of a fused bracket, to which these gains were applied, of
/// developed pictures beside their own.
fn info_of(
    fused: &Fused,
    raw: Option<&RawMetadata>,
    said: Option<CaptureInfo>,
    gains: [f64; 3],
) -> CaptureInfo {
    #[expect(clippy::cast_possible_truncation, reason = "an irradiance in f32")]
    let levels = fused.saturation.map(|white| white as f32);
    // Of others, files say nothing.
    let saturation = levels.iter().all(|level| is_level(*level)).then_some(levels);
    let said = said.unwrap_or_default();
    let own = said.white_balance.unwrap_or([1.0; 3]);
    let white_balance = Some(std::array::from_fn(|channel| own[channel] * gains[channel]));
    let info = CaptureInfo { saturation, white_balance, ..said };
    match raw {
        None => info,
        Some(raw) => CaptureInfo {
            white_balance: Some(gains),
            orientation: Some(raw.orientation),
            baseline_exposure_ev: raw.baseline_exposure_ev,
            color: raw.color.clone(),
            exif: raw.exif.clone(),
            ..info
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::ToldLevels;
    use crate::core::bayer::BayerPattern;
    use crate::core::image::LinearImage;
    use crate::io::{WriteOptions, write_array, write_image};
    use ndarray::Array3;

    /// Floats of a mosaic of grey light, black 10 and white 110, the shorter exposure a quarter of the longer.
    #[test]
    fn a_bracket_of_files_becomes_its_light() {
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = ["long.npy", "short.npy"].map(|name| folder.path().join(name)).into();
        let light = |y: usize| 0.02 * y as f32;
        for (file, time) in files.iter().zip([1.0, 0.25]) {
            let mosaic =
                Array3::from_shape_fn((1, 64, 64), |(_, y, _)| 10.0 + 100.0 * (light(y) * time).min(1.0));
            write_array(file, &mosaic.into_dyn(), false).unwrap();
        }
        let levels = ToldLevels {
            white: Some(110.0),
            black: Some(10.0),
            bayer: Some(BayerPattern::Rggb),
            white_balance: None,
        };
        let told = Told { levels, exposures: Some(vec![4.0, 1.0]), ..Told::default() };
        let developed = develop(&files, &told, &Progress::default()).unwrap();
        assert_eq!((developed.exposures, developed.warnings), (vec![1.0, 0.25], vec![]));
        assert_eq!(developed.info.saturation, Some([4.0; 3]));
        let planes = developed.fused.image.planes();
        for y in [10, 30, 60] {
            // Of 32-bit floats around 100, and of an interpolation that is exact on ramps but for compressing light.
            assert!((planes[[1, y, 31]] - light(y)).abs() < 2e-3, "{} of {}", planes[[1, y, 31]], light(y));
        }
    }

    #[test]
    fn files_are_blamed_for_times_that_they_alone_say() {
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = ["a.npy", "b.npy"].map(|name| folder.path().join(name)).into();
        for (file, side) in files.iter().zip([8, 9]) {
            write_array(file, &Array3::<f32>::zeros((3, side, side)).into_dyn(), false).unwrap();
        }
        let error = |exposures| {
            let told = Told { exposures, ..Told::default() };
            develop(&files, &told, &Progress::default()).unwrap_err().to_string()
        };
        assert!(error(Some(vec![2.0, 1.0])).starts_with("picture 2 of the bracket"));
        assert!(error(None).contains("--exposures"));
    }

    /// Files of such levels would be refused by whoever reads them.
    #[test]
    fn levels_that_no_sensor_has_are_not_told() {
        let folder = tempfile::tempdir().unwrap();
        let files = [folder.path().join("a.npy")];
        write_array(&files[0], &Array3::from_elem((3, 8, 8), 0.5f32).into_dyn(), false).unwrap();
        let saturation = |gain: f64| {
            let levels = ToldLevels { white_balance: Some([gain, 1.0, 1.0]), ..ToldLevels::default() };
            let told = Told { levels, exposures: Some(vec![1.0]), ..Told::default() };
            develop(&files, &told, &Progress::default()).unwrap().info.saturation
        };
        assert_eq!((saturation(2.0), saturation(1e-7)), (Some([2.0, 1.0, 1.0]), None));
    }

    /// As files of one capture each become one of all: by the light at which each channel is full, and in the camera's colours.
    #[test]
    fn developed_pictures_keep_their_levels_and_colours() {
        let folder = tempfile::tempdir().unwrap();
        let levels = [2.0f32, 1.0, 1.5];
        let light = |channel: usize, y: usize| levels[channel] * 0.06 * y as f32;
        let info = CaptureInfo {
            saturation: Some(levels),
            white_balance: Some([2.0, 1.0, 1.5]),
            baseline_exposure_ev: Some(0.5),
            ..CaptureInfo::default()
        };
        let files: Vec<PathBuf> = ["long.exr", "short.exr"].map(|name| folder.path().join(name)).into();
        let write = |file: &PathBuf, time: f32, info: &CaptureInfo| {
            let planes = Array3::from_shape_fn((3, 64, 64), |(c, y, _)| (light(c, y) * time).min(levels[c]));
            let options =
                WriteOptions { capture: Some(info.clone()), overwrite: true, ..WriteOptions::default() };
            write_image(file, &LinearImage::from_planes(planes).unwrap(), &options).unwrap();
        };
        write(&files[0], 1.0, &info);
        write(&files[1], 0.25, &info);
        let told = Told { exposures: Some(vec![1.0, 0.25]), ..Told::default() };
        let developed = develop(&files, &told, &Progress::default()).unwrap();
        for ((channel, y, _), found) in developed.fused.image.planes().indexed_iter() {
            assert!(
                (found - light(channel, y)).abs() <= 1e-5 * light(channel, y),
                "{found} {}",
                light(channel, y)
            );
        }
        let expected = CaptureInfo { saturation: Some(levels.map(|level| 4.0 * level)), ..info.clone() };
        assert_eq!(developed.info, expected);
        write(&files[1], 0.25, &CaptureInfo { saturation: Some([1.0; 3]), ..info });
        let error = develop(&files, &told, &Progress::default()).unwrap_err().to_string();
        assert!(error.contains("short.exr says that it saturates at another light"), "{error}");
    }
}
