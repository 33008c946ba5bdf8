//! Finds the tone curve that two folders of images are to be compared under: as their files say.
//!
//! An EXR of `udc restore`, `udc tonemap` or `udc synth` says it in its provenance, that of a capture also where it clips, and
//! files of a dataset's folder that say nothing themselves by the dataset's `dataset.toml`.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::FilePair;
use crate::core::error::{Error, Result};
use crate::core::provenance::Provenance;
use crate::core::tone::{ToneCurve, ToneFlags};
use crate::dataset::{CONFIG_FILE, DatasetConfig};
use crate::io;

/// How many folders above an image may describe the dataset that it is of: `degraded/<kernel>/` lies two below.
const DATASET_DEPTH: usize = 3;

/// A tone curve with whoever said it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct ToneSource {
    /// The curve.
    pub curve: ToneCurve,
    /// Who said it.
    pub said_by: ToneSpeaker,
}

/// Who said what a tone curve is, in words that finish "as … said".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ToneSpeaker {
    /// The images' files.
    #[serde(rename = "the files")]
    Files,
    /// The user.
    #[serde(rename = "the flags")]
    Flags,
    /// The user said one of its numbers, and the files the other.
    #[serde(rename = "the flags and the files")]
    FlagsAndFiles,
    /// Nothing and nobody did.
    #[serde(rename = "nobody (it is the published one)")]
    Nobody,
}

impl ToneSpeaker {
    /// The words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Files => "the files",
            Self::Flags => "the flags",
            Self::FlagsAndFiles => "the flags and the files",
            Self::Nobody => "nobody (it is the published one)",
        }
    }
}

impl ToneSource {
    /// The curve of pairs of files: that of the flags, of the files, or where neither says anything, the published one.
    ///
    /// # Errors
    /// [`Error::Config`] when files say different curves and the flags do not decide; [`Error::Format`] when a dataset of
    /// the files is damaged.
    pub fn of_pairs(pairs: &[FilePair], flags: ToneFlags) -> Result<Self> {
        let given = |curve: ToneCurve| flags.over(curve);
        let default = given(ToneCurve::default())?;
        if flags.alpha.is_some() && flags.x_max.is_some() {
            return Ok(Self { curve: default, said_by: ToneSpeaker::Flags });
        }
        let mut first: Option<(&Path, ToneCurve)> = None;
        for path in pairs.iter().flat_map(|pair| [&pair.restored, &pair.ground_truth]) {
            let Some(curve) = curve_of_file(path, io::read_provenance(path)?.as_ref())? else { continue };
            let curve = given(below_saturation(curve, path)?)?;
            match first {
                Some((other, known)) if known != curve => {
                    return Err(disagreement((other, known), (path, curve)));
                }
                Some(_) => {}
                None => first = Some((path, curve)),
            }
        }
        Ok(match first {
            Some((_, curve)) => {
                let is_given = flags != ToneFlags::default();
                Self {
                    curve,
                    said_by: if is_given { ToneSpeaker::FlagsAndFiles } else { ToneSpeaker::Files },
                }
            }
            None if flags != ToneFlags::default() => Self { curve: default, said_by: ToneSpeaker::Flags },
            None => Self { curve: default, said_by: ToneSpeaker::Nobody },
        })
    }
}

fn disagreement(first: (&Path, ToneCurve), second: (&Path, ToneCurve)) -> Error {
    let show = |(path, curve): (&Path, ToneCurve)| {
        format!("{} says alpha {} and x-max {}", path.display(), curve.alpha, curve.x_max)
    };
    let reason = format!(
        "{}, {}: images of two curves cannot be compared; name the one to measure with by --alpha and --x-max",
        show(first),
        show(second)
    );
    Error::config("tone curve", reason)
}

/// What a file of this provenance says of its curve, or else the dataset that it is of.
pub(super) fn curve_of_file(path: &Path, provenance: Option<&Provenance>) -> Result<Option<ToneCurve>> {
    match provenance.and_then(Provenance::tone_curve) {
        Some(curve) => Ok(Some(curve)),
        None => curve_of_dataset(path),
    }
}

/// The curve without light that the capture could not hold, whatever the restoration was told.
fn below_saturation(curve: ToneCurve, path: &Path) -> Result<ToneCurve> {
    let saturation = io::read_capture_info(path)?.and_then(|info| info.saturation);
    let most = saturation.map(|levels| levels.into_iter().fold(0.0, f32::max));
    Ok(ToneCurve { x_max: most.map_or(curve.x_max, |most| curve.x_max.min(most)), ..curve })
}

fn curve_of_dataset(path: &Path) -> Result<Option<ToneCurve>> {
    let absolute: PathBuf = std::path::absolute(path).map_err(|error| Error::io("find", path, error))?;
    let root = absolute.ancestors().skip(1).take(DATASET_DEPTH).find(|root| root.join(CONFIG_FILE).is_file());
    root.map(|root| DatasetConfig::read(root)?.formation.curve()).transpose()
}
