//! Describes what a TOML file configures, told by the keys that each kind of file has.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Inspection;
use super::model::NetworkDescription;
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::dataset::SensorConfig;
use crate::io::{read_configuration, read_field};
use crate::network::Architecture;
use crate::plan::Study;
use crate::psf::DisplayConfig;
use crate::restore::{Pose, read_pose};
use crate::train::TrainConfig;

/// The description of a display, of which PSFs are simulated.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DisplayDescription {
    /// The display with its lens, sensor and light.
    pub display: DisplayConfig,
}

/// The PSFs of several places of the frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FieldDescription {
    /// Number of places from top to bottom.
    pub rows: usize,
    /// Number of places from left to right.
    pub columns: usize,
}

/// By how much a panel is turned and scaled against its PSF.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseDescription {
    /// The pose.
    #[serde(flatten)]
    pub pose: Pose,
}

/// A sensor, for its noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SensorDescription {
    /// The sensor.
    pub sensor: SensorConfig,
    /// The irradiance that fills it in its longest exposure.
    pub white_irradiance: f64,
    /// The irradiance that fills it in its shortest exposure.
    pub x_max: f64,
    #[serde(skip)]
    file: PathBuf,
    /// The file as it is written.
    #[serde(skip)]
    text: String,
}

/// The configuration of a training: the network that it asks for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrainingDescription {
    /// The network.
    #[serde(flatten)]
    pub network: NetworkDescription,
    #[serde(skip)]
    architecture: Architecture,
}

/// What a study combines.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StudyDescription {
    /// The study.
    #[serde(flatten)]
    pub study: Study,
    /// The file, to be planned.
    #[serde(skip)]
    file: PathBuf,
}

/// Keys that a sensor has and a training has not.
const SENSOR_KEYS: [&str; 8] = [
    "full-well-e",
    "read-noise-e",
    "bits",
    "black-level-dn",
    "exposures",
    "channel-gains",
    "white-irradiance",
    "electrons-per-unit",
];

/// Looks at a configuration file.
pub(super) fn inspect_configuration(file: &Path) -> Result<Inspection> {
    let text = read_configuration(file)?;
    // What is no TOML at all is told as what most of these files are.
    let table: toml::Table = parse_toml(&text).unwrap_or_default();
    let has = |keys: &[&str]| keys.iter().any(|key| table.contains_key(*key));
    if has(&["display", "optics", "spectrum", "sampling", "sensor"]) {
        let display = DisplayConfig::parse(&text, file)?;
        return Ok(Inspection::Display(DisplayDescription { display }));
    }
    if has(&["psfs"]) {
        let (grid, _) = read_field(file)?;
        return Ok(Inspection::PsfField(FieldDescription { rows: grid.rows(), columns: grid.columns() }));
    }
    if has(&["turn-deg", "turn-sigma-deg"]) {
        return Ok(Inspection::Pose(PoseDescription { pose: read_pose(file)? }));
    }
    if has(&SENSOR_KEYS) {
        return SensorDescription::new(file, text).map(Inspection::Sensor);
    }
    if has(&["panels", "rotations"]) {
        let study = Study::read(file)?;
        return Ok(Inspection::Study(StudyDescription { study, file: file.to_owned() }));
    }
    let config = TrainConfig::from_toml(&text, &[]).map_err(|error| {
        error.while_doing(format!("reading {} as a training's configuration", file.display()))
    })?;
    let architecture = config.architecture;
    let network = (&architecture).into();
    Ok(Inspection::TrainingConfiguration(TrainingDescription { network, architecture }))
}

impl SensorDescription {
    fn new(file: &Path, text: String) -> Result<Self> {
        let sensor: SensorConfig = parse_toml(&text).map_err(|reason| Error::format(file, reason))?;
        let (white_irradiance, x_max) = (sensor.white_irradiance(), sensor.saturation());
        Ok(Self { sensor, white_irradiance, x_max, file: file.to_owned(), text })
    }
}

impl fmt::Display for DisplayDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kind, size) = (self.display.display.kind.name(), self.display.sensor.size_px);
        write!(f, "display file, for `udc psf --display`: layout {kind}, a PSF of {size} × {size} pixels")
    }
}

impl fmt::Display for FieldDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PSFs of {} × {} places of the frame, for --field", self.rows, self.columns)
    }
}

impl fmt::Display for PoseDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { pose } = self;
        write!(f, "pose, for `udc restore --pose`: {pose}\n  of the PSF {}", pose.psf_sha256)
    }
}

impl fmt::Display for SensorDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "sensor, for --noise sensor:{}: full at an irradiance of {:.4} in the longest exposure and of {:.4} (x-max) in \
             the shortest\n{}",
            self.file.display(),
            self.white_irradiance,
            self.x_max,
            self.text.trim_end()
        )
    }
}

impl fmt::Display for StudyDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { study, file } = self;
        let names =
            |names: Vec<&String>| names.into_iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        writeln!(
            f,
            "study, for `udc plan {}` and workflow/Snakefile: {} datasets, {} trainings",
            file.display(),
            study.datasets(),
            study.datasets() * study.networks.len()
        )?;
        writeln!(f, "  panels     {}", names(study.panels.keys().collect()))?;
        writeln!(f, "  rotations  {}", study.rotations.angles)?;
        writeln!(f, "  noise      {}", names(study.noise.keys().collect()))?;
        writeln!(f, "  networks   {}", names(study.networks.keys().collect()))?;
        write!(f, "  output     {}", study.output)
    }
}

impl fmt::Display for TrainingDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "training configuration\n{}", self.architecture.describe())
    }
}
