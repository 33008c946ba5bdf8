//! Reads the pictures of a capture, one or a bracket, with its dark frames, and what the files say of them.

use std::path::{Path, PathBuf};

use ndarray::{Array2, Array3};

use super::alike::{Said, check_levels, check_scene};
use super::bracket::Bracket;
use super::exposure_times::SAME_TIME;
use super::fuse::FuseConfig;
use super::levels::{Kind, Levels, Samples, Unit};
use super::plausible::{check_floats, check_reachable, check_white};
use super::shots::{Shot, differ, exposures, exposures_of_darks, is_in_doubt, without_dark};
use super::told::Told;
use crate::core::capture::CaptureInfo;
use crate::core::coded::raise_doubtful;
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::core::progress::Progress;
use crate::io::{DomainTag, Pixels, RawMetadata, expand_inputs, inspect_image, inspect_mosaic, read_pixels};

/// The pictures of a capture as they were read.
#[derive(Debug)]
pub struct Pictures {
    /// What the user should look at, each naming its file.
    pub warnings: Vec<String>,
    /// What the user said of them.
    pub(super) told: Told,
    /// How to fuse them, the levels in the units of the planes.
    pub(super) config: FuseConfig,
    /// What the first file says, where it is a camera's raw one.
    pub(super) raw: Option<RawMetadata>,
    /// What the first file says of its capture, where it is no raw one.
    pub(super) said: Option<CaptureInfo>,
    /// By what the channels of developed pictures were divided, so that white is 1 in each: the light at which their files say that they
    /// saturate.
    pub(super) divided_by: Option<[f64; CHANNELS]>,
    lights: Group,
    darks: Group,
}

/// Pictures in the order of their files, and what each tells of its exposure.
#[derive(Debug, Default)]
struct Group {
    planes: Vec<Array3<f32>>,
    shots: Vec<Shot>,
    /// Which were coded with losses.
    coded: Vec<bool>,
}

impl Group {
    /// Raises to `white` what coding may have made darker of saturated pixels, where a shorter exposure tells them; those of the shortest
    /// are made whole as it is restored.
    fn raise_doubtful(&mut self, times: &[f64], white: f64) {
        #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
        let white = white as f32;
        let shortest = times.iter().copied().fold(f64::INFINITY, f64::min);
        for ((planes, is_coded), &time) in self.planes.iter_mut().zip(&self.coded).zip(times) {
            if *is_coded && time * (1.0 - SAME_TIME) > shortest {
                raise_doubtful(planes, white);
            }
        }
    }

    fn divide(&mut self, levels: [f64; CHANNELS]) {
        #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
        let factors = levels.map(|level| level.recip() as f32);
        for planes in &mut self.planes {
            for (mut plane, factor) in planes.outer_iter_mut().zip(factors) {
                plane.par_mapv_inplace(|value| value * factor);
            }
        }
    }
}

/// The light at which a developed picture saturates, where its file says that this is another than 1.
fn own_levels(said: &CaptureInfo) -> Option<[f64; CHANNELS]> {
    let levels = said.saturation?.map(f64::from);
    levels.iter().any(|level| (level - 1.0).abs() > f64::from(f32::EPSILON)).then_some(levels)
}

impl Pictures {
    /// Reads the pictures, unless the user asks to stop.
    ///
    /// # Errors
    /// Those of reading files; what the user said that the files contradict, or did not say and must; levels that no
    /// picture has; [`Error::Interrupted`].
    ///
    /// # Panics
    /// Never: there is at least one picture.
    pub fn read(files: &[PathBuf], told: &Told, progress: &Progress) -> Result<Self> {
        let config = told.config()?;
        let Some(first) = files.first() else {
            return Err(Error::shape("capture", "at least one picture", "none"));
        };
        let dark_files = told.darks.as_deref().map_or(Ok(Vec::new()), expand_inputs)?;
        let mut reader = Reader { told, first: None, said: None, warnings: Vec::new() };
        let mut lights = reader.read_group(files, false, progress)?;
        let mut darks = reader.read_group(&dark_files, true, progress)?;
        let Reader { first: of_first, said, mut warnings, .. } = reader;
        let (raw, samples) = of_first.expect("at least one picture was read");

        let unit = Unit::of(told.levels.white, samples);
        for (flag, level) in [("--white", told.levels.white), ("--black", told.levels.black)] {
            level.map_or(Ok(()), |level| check_reachable(flag, level, unit))?;
        }
        let levels = Levels::of(&told.levels, unit, raw.as_ref());
        warnings.extend(levels.warning(first));
        warnings.extend(levels.doubt(first, raw.as_ref()));
        let Levels { white, black, bayer, white_balance, .. } = levels;
        if told.levels.white.is_none() && black >= white {
            return Err(Error::Unsupported(format!(
                "black {black} does not lie below white {white}: give --white as well, in the same units"
            )));
        }
        let is_light = raw.is_none() && unit == Unit::Planes && bayer.is_none();
        let divided_by =
            said.as_ref().filter(|_| is_light && told.levels.white.is_none()).and_then(own_levels);
        if let Some(levels) = divided_by {
            [&mut lights, &mut darks].into_iter().for_each(|group| group.divide(levels));
        }
        if raw.is_none()
            && unit == Unit::Planes
            && let Some(warning) = check_floats(&lights.planes, told.levels.white)?
        {
            warnings.push(format!("{}: {warning}", names_of(files)));
        }
        let surpassed = told.levels.white.and_then(|gave| check_white(&lights.planes, white, gave));
        warnings.extend(surpassed.map(|warning| format!("{}: {warning}", names_of(files))));
        let config = FuseConfig { white, black, bayer, white_balance, ..config };
        Ok(Self { warnings, told: told.clone(), config, raw, said, divided_by, lights, darks })
    }

    /// The exposures in the order of the files: of the user, else of the files, else the default ones.
    pub(super) fn times(&self) -> Result<Vec<f64>> {
        if let Some(times) = &self.told.exposures {
            return Ok(times.clone());
        }
        if let Some(times) = self.told_by_files()? {
            return Ok(times);
        }
        match (self.told.default_times, self.lights.planes.len()) {
            (None, _) => Err(untold_times()),
            (Some(_), 1) => Ok(vec![1.0]),
            (Some(times), 3) => Ok(times.to_vec()),
            (Some(times), pictures) => Err(Error::Unsupported(format!(
                "{pictures} pictures do not say their exposure times, and a published bracket has {}: add --exposures \
                 T,T,… in the order of the files",
                times.len()
            ))),
        }
    }

    /// The exposures of the files, none where no file tells its time.
    fn told_by_files(&self) -> Result<Option<Vec<f64>>> {
        let shots = &self.lights.shots;
        let times = exposures(shots);
        if times.is_none() && shots.iter().any(|shot| shot.seconds.is_some()) {
            return Err(untold_times());
        }
        if times.is_some() && is_in_doubt(shots) {
            return Err(Error::Unsupported(
                "not every picture says its ISO, and those that do say different ones: add --exposures T,T,… in the order of \
                 the files"
                    .to_owned(),
            ));
        }
        Ok(times)
    }

    /// Puts pictures, their times, the mask and the dark frames together.
    pub(super) fn join(&mut self, times: &[f64]) -> Result<Bracket> {
        self.lights.raise_doubtful(times, self.config.white);
        let mut bracket = Bracket::new(std::mem::take(&mut self.lights.planes), times)?;
        if self.told.darks.is_some() {
            let dark_times = self.dark_times(times, &bracket)?;
            bracket = bracket.with_darks(std::mem::take(&mut self.darks.planes), dark_times.as_deref())?;
        }
        match self.told.mask.take() {
            Some(mask) => bracket.with_mask(mask),
            None => Ok(bracket),
        }
    }

    /// The exposures of the dark frames, of the user, else of the files; none where one dark frame is for all pictures.
    fn dark_times(&self, times: &[f64], bracket: &Bracket) -> Result<Option<Vec<f64>>> {
        if let Some(times) = &self.told.dark_exposures {
            return Ok(Some(times.clone()));
        }
        let shots = [&self.lights.shots[..], &self.darks.shots];
        let times_are_of_files = self.told.exposures.is_none() && exposures(shots[0]).is_some();
        let dark_times = exposures_of_darks(shots[0], shots[1]).filter(|_| times_are_of_files);
        let seconds: Vec<f64> = shots[1].iter().filter_map(|shot| shot.seconds).collect();
        match &dark_times {
            None if differ(&seconds) => Err(Error::Unsupported(
                "the dark frames have different exposure times, and it is not known which pictures they belong to: give \
                 both --exposures and --dark-exposures, or dark frames of one time"
                    .to_owned(),
            )),
            None => Ok(None),
            Some(dark) => match without_dark([times, dark], &bracket.times(), shots) {
                Some(reason) => Err(Error::Unsupported(reason)),
                None => Ok(dark_times),
            },
        }
    }
}

fn untold_times() -> Error {
    let reason = "not every picture says its exposure time: add --exposures T,T,… in the order of the files";
    Error::Unsupported(reason.to_owned())
}

/// Reads pictures that must be alike.
struct Reader<'a> {
    told: &'a Told,
    /// What the first file says.
    first: Option<(Option<RawMetadata>, Samples)>,
    /// What the first file says of its capture.
    said: Option<CaptureInfo>,
    warnings: Vec<String>,
}

impl Reader<'_> {
    fn read_group(&mut self, files: &[PathBuf], are_dark: bool, progress: &Progress) -> Result<Group> {
        let mut group = Group::default();
        for file in files {
            progress.check()?;
            let pixels = self.read(file)?;
            if !are_dark {
                self.check_scene(file, &pixels)?;
            }
            group.coded.push(pixels.capture.is_some_and(|info| info.coding_error.is_some()));
            group.planes.push(pixels.planes);
            group.shots.push(Shot { seconds: pixels.exposure_s, iso: pixels.iso });
        }
        Ok(group)
    }

    fn read(&mut self, file: &Path) -> Result<Pixels> {
        let (mut pixels, encoding) = match self.told.levels.bayer {
            Some(pattern) => inspect_mosaic(file, pattern)?,
            None => inspect_image(file)?,
        };
        if self.told.demosaic_linear && pixels.without_data > 0 {
            // Darkness there would pass for the background of the source.
            return Err(Error::format(
                file,
                "has pixels without data, for its data window does not cover its display window: the background of a point \
                 source would be measured there; crop the file to its data window",
            ));
        }
        let samples = Samples::of(&pixels, &encoding);
        self.settle_domain(file, &mut pixels, Kind::of(samples, &self.told.levels, self.told.is_raw()))?;
        if self.first.is_none() {
            self.said = pixels.capture.clone();
        }
        let (raw, of_first) = self.first.get_or_insert_with(|| (pixels.raw.clone(), samples));
        check_levels(file, self.told, raw.as_ref(), pixels.raw.as_ref())?;
        let is_of_integers = Unit::is_of_integers(self.told.levels.white, of_first.is_camera_raw);
        if is_of_integers && of_first.largest != samples.largest {
            return Err(Error::Unsupported(format!(
                "{} is stored in another type than the other pictures: give --white and --black for one type",
                file.display()
            )));
        }
        Ok(pixels)
    }

    /// Compares what a picture says of its colours with what the first one says.
    fn check_scene(&mut self, file: &Path, pixels: &Pixels) -> Result<()> {
        let raw = self.first.as_ref().and_then(|(raw, _)| raw.as_ref());
        let first = Said { raw, capture: self.said.as_ref() };
        let this = Said { raw: pixels.raw.as_ref(), capture: pixels.capture.as_ref() };
        self.warnings.extend(check_scene(file, self.told, first, this)?);
        Ok(())
    }

    /// Takes the user's word for the domain, which must be told of integers that nobody declares raw, and must be light.
    fn settle_domain(&mut self, file: &Path, pixels: &mut Pixels, kind: Kind) -> Result<()> {
        let (domain, is_raw) = (self.told.domain, kind != Kind::Picture);
        if (is_raw || self.told.is_raw()) && domain == Some(DomainTag::Srgb) {
            return Err(Error::format(
                file,
                "levels, dark frames, a mosaic and gains are of raw pictures, whose values are linear, and --domain says \
                 srgb: leave one of them out",
            ));
        }
        self.warnings.extend(pixels.tell(file, domain)?);
        match (kind, domain) {
            (Kind::Picture, _) => self.check_told(file, pixels)?,
            (Kind::DeclaredRaw, None) => {
                let found = pixels.contradictions(DomainTag::Linear);
                self.warnings.extend(found.map(|found| {
                    format!(
                        "{}: {found}; as --white, --black or --bayer have it, the values are taken for linear light",
                        file.display()
                    )
                }));
            }
            (Kind::DeclaredRaw, Some(_)) | (Kind::CameraRaw, _) => {}
        }
        match pixels.domain {
            Some(tag @ (DomainTag::ToneMapped | DomainTag::Display)) => Err(Error::format(
                file,
                format!("holds {} values, which add up to nothing; use the linear pictures", tag.name()),
            )),
            Some(DomainTag::Linear | DomainTag::Srgb) | None => Ok(()),
        }
    }

    /// Asks what the values of a picture are, where neither it nor the user says it.
    fn check_told(&self, file: &Path, pixels: &Pixels) -> Result<()> {
        if pixels.must_be_told() && self.told.is_raw() {
            return Err(Error::Unsupported(format!(
                "{} does not say whether its values are linear or sRGB, and levels or gains of three colours do not either: \
                 add --domain linear to apply them, or leave them out and add --domain srgb",
                file.display()
            )));
        }
        pixels.check_told_light(file)
    }
}

/// The names of files, for messages.
pub fn names_of(files: &[PathBuf]) -> String {
    files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(" ")
}

/// Reads a mask: the good pixels of a picture that is no light, which is black where pixels are to be discarded.
///
/// # Errors
/// As [`read_pixels`].
pub fn read_mask(file: &Path) -> Result<Array2<bool>> {
    let planes = read_pixels(file)?.planes;
    let (_, height, width) = planes.dim();
    let good = |place: (usize, usize)| planes.outer_iter().all(|plane| plane[place] >= 0.5);
    Ok(Array2::from_shape_fn((height, width), good))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_no_further_picture_once_the_user_asks_to_stop() {
        let progress = Progress::new(None, std::sync::Arc::new(true.into()));
        let error = Pictures::read(&["missing.exr".into()], &Told::default(), &progress).unwrap_err();
        assert!(matches!(error, Error::Interrupted), "{error}");
    }

    #[test]
    fn a_capture_without_pictures_is_refused() {
        let told = Told { darks: Some(vec!["dark.exr".into()]), ..Told::default() };
        let error = Pictures::read(&[], &told, &Progress::default()).unwrap_err();
        assert!(matches!(error, Error::Shape { .. }), "{error}");
    }

    /// Pictures of `count` files that say nothing.
    fn silent(count: usize, told: Told) -> Pictures {
        let shots = vec![Shot { seconds: None, iso: None }; count];
        let lights =
            Group { planes: vec![Array3::zeros((3, 4, 4)); count], shots, coded: vec![false; count] };
        let config = FuseConfig::default();
        Pictures {
            warnings: Vec::new(),
            told,
            config,
            raw: None,
            said: None,
            divided_by: None,
            lights,
            darks: Group::default(),
        }
    }

    #[test]
    fn times_that_nobody_says_are_those_of_the_published_bracket_where_they_may_be() {
        let published = || Told { default_times: Some([1.0, 0.25, 0.0625]), ..Told::default() };
        assert_eq!(silent(1, published()).times().unwrap(), [1.0]);
        assert_eq!(silent(3, published()).times().unwrap(), [1.0, 0.25, 0.0625]);
        assert!(
            silent(2, published()).times().unwrap_err().to_string().contains("a published bracket has 3")
        );
        assert!(silent(3, Told::default()).times().unwrap_err().to_string().contains("--exposures"));
        let told = Told { exposures: Some(vec![2.0, 1.0]), ..published() };
        assert_eq!(silent(2, told).times().unwrap(), [2.0, 1.0]);
    }

    #[test]
    fn what_coding_darkened_is_told_by_a_shorter_exposure() {
        let mut pictures = silent(3, Told::default());
        let values = [[0.86, 0.84], [0.86, 0.9], [0.86, 0.9]];
        for (planes, values) in pictures.lights.planes.iter_mut().zip(values) {
            planes[[0, 0, 0]] = values[0];
            planes[[1, 2, 3]] = values[1];
        }
        pictures.lights.coded = vec![true; 3];
        pictures.lights.raise_doubtful(&[4.0, 1.0, 1.001], 1.0);
        let found: Vec<_> =
            pictures.lights.planes.iter().map(|planes| [planes[[0, 0, 0]], planes[[1, 2, 3]]]).collect();
        assert_eq!(found, [[1.0, 0.84], [0.86, 0.9], [0.86, 0.9]]);
        pictures.lights.planes[0][[0, 0, 0]] = 0.86;
        pictures.lights.coded = vec![false; 3];
        pictures.lights.raise_doubtful(&[4.0, 1.0, 1.001], 1.0);
        assert!(
            pictures.lights.planes[0][[0, 0, 0]] < 0.9,
            "what was not coded is as bright as it was measured"
        );
    }
}
