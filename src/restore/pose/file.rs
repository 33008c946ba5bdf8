//! The file of a pose: versioned TOML.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::Pose;
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::io;

const FORMAT: &str = "udc-pose";
const VERSION: u32 = 1;

/// The turn in degrees and the share of scale that no pose of one panel goes beyond.
const FURTHEST_TURN_DEG: f64 = 180.0;
const FURTHEST_SCALE: f64 = 0.5;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct PoseFile {
    format: String,
    version: u32,
    turn_deg: f64,
    scale: f64,
    turn_sigma_deg: f64,
    scale_sigma: f64,
    psf_sha256: String,
}

/// Reads the pose that [`write_pose`] wrote.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no pose, damaged, of another version, or its numbers
/// are out of range.
pub fn read_pose(path: &Path) -> Result<Pose> {
    let PoseFile { format, version, turn_deg, scale, turn_sigma_deg, scale_sigma, psf_sha256 } =
        parse_toml(&io::read_text(path)?).map_err(|reason| Error::format(path, reason))?;
    if (format.as_str(), version) != (FORMAT, VERSION) {
        let reason =
            format!("is {format} of version {version}; this program reads {FORMAT} of version {VERSION}");
        return Err(Error::format(path, reason));
    }
    for (key, value, furthest) in
        [("turn-deg", turn_deg, FURTHEST_TURN_DEG), ("scale", scale, FURTHEST_SCALE)]
    {
        if value.is_nan() || value.abs() >= furthest {
            return Err(Error::format(
                path,
                format!("{key} must be between -{furthest} and {furthest}, found {value}"),
            ));
        }
    }
    for (key, value) in [("turn-sigma-deg", turn_sigma_deg), ("scale-sigma", scale_sigma)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(Error::format(path, format!("{key} must be a positive number, found {value}")));
        }
    }
    Ok(Pose { turn_deg, scale, turn_sigma_deg, scale_sigma, psf_sha256 })
}

/// Writes a pose as TOML.
///
/// # Errors
/// [`Error::Io`] when the file exists and `overwrite` is not set, or cannot be written.
///
/// # Panics
/// Never: numbers and text are plain data.
pub fn write_pose(path: &Path, pose: &Pose, overwrite: bool) -> Result<()> {
    let Pose { turn_deg, scale, turn_sigma_deg, scale_sigma, psf_sha256 } = pose.clone();
    let format = FORMAT.to_owned();
    let file =
        PoseFile { format, version: VERSION, turn_deg, scale, turn_sigma_deg, scale_sigma, psf_sha256 };
    let text = toml::to_string(&file).expect("numbers and text are plain data");
    io::write_atomically(path, overwrite, |out| out.write_all(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::super::tests::psf;
    use super::*;
    use std::fs;

    fn pose() -> Pose {
        let psf_sha256 = psf().sha256();
        Pose { turn_deg: 0.301_2, scale: -3.7e-3, turn_sigma_deg: 0.004, scale_sigma: 2e-4, psf_sha256 }
    }

    #[test]
    fn a_pose_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.toml");
        write_pose(&path, &pose(), false).unwrap();
        assert_eq!(read_pose(&path).unwrap(), pose());
        assert!(fs::read_to_string(&path).unwrap().starts_with("format = \"udc-pose\"\nversion = 1\n"));
        assert!(write_pose(&path, &pose(), false).is_err(), "an existing file is refused");
    }

    #[test]
    fn refuses_other_files_versions_and_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.toml");
        write_pose(&path, &pose(), false).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        for (from, to, why) in [
            ("udc-pose", "udc-dataset", "udc-dataset of version 1"),
            ("version = 1", "version = 2", "of version 2"),
            ("scale = -0.0037", "scale = nan", "scale must be between"),
            ("turn-deg = 0.3012", "turn-deg = 181", "turn-deg must be between"),
            ("scale-sigma = 0.0002", "scale-sigma = 0", "scale-sigma must be a positive number"),
            ("scale = ", "skale = ", "skale"),
        ] {
            assert!(text.contains(from), "{from} in {text}");
            fs::write(&path, text.replace(from, to)).unwrap();
            let message = read_pose(&path).unwrap_err().to_string();
            assert!(message.contains(why), "{message}");
        }
    }
}
