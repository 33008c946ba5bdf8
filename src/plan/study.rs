//! Reads a study: which panels, rotations, scenes, noise and networks are combined, and what is measured.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::codes::parse_angles;
use crate::core::bytes::parse_bytes;
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::io;
use crate::scenes::MOST_SCENES;

/// A study, as `study.toml` holds it: every panel with every noise is a dataset, on which every network is trained and
/// everything is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Study {
    /// The folder of all results.
    #[serde(default = "usual_output")]
    pub output: String,
    /// The seed of scenes, noise and the division into training and testing.
    #[serde(default)]
    pub seed: u64,
    /// The scenes.
    pub scenes: Scenes,
    /// By name: the layout of a panel (`.toml`), or a measured PSF.
    pub panels: BTreeMap<String, PathBuf>,
    /// The rotations of the panels.
    pub rotations: Rotations,
    /// By name: noise as `udc synth` takes it.
    pub noise: BTreeMap<String, String>,
    /// By name: the configuration of a training.
    #[serde(default)]
    pub networks: BTreeMap<String, PathBuf>,
    /// What all trainings change.
    #[serde(default)]
    pub training: Training,
    /// What is measured.
    #[serde(default)]
    pub evaluation: Evaluation,
    /// Into how many parts stages are divided.
    #[serde(default)]
    pub shards: Shards,
}

/// The scenes of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Scenes {
    /// How many are painted.
    pub painted: usize,
    /// Files or patterns of panoramas.
    pub panoramas: Vec<PathBuf>,
    /// Views of each panorama.
    pub views: usize,
    /// Side of the frame in pixels.
    pub size: usize,
    /// Pixels more on each side.
    pub margin: usize,
    /// Whether half floats are written.
    pub half: bool,
    /// The size of the tar archives that keep a dataset's images, as `udc synth --tar` takes it; each has its own file without.
    pub tar: Option<String>,
    /// Share of the sources that is for testing.
    pub test_fraction: f64,
}

impl Default for Scenes {
    fn default() -> Self {
        Self {
            painted: 0,
            panoramas: Vec::new(),
            views: 18,
            size: 512,
            margin: 0,
            half: false,
            tar: None,
            test_fraction: 0.15,
        }
    }
}

/// The rotations of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rotations {
    /// As `udc codes --angles` takes them.
    pub angles: String,
    /// Length of the kernel codes.
    #[serde(default = "usual_dim")]
    pub dim: usize,
}

/// What all trainings of a study change.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Training {
    /// `KEY.PATH=VALUE`, one after the other.
    #[serde(default)]
    pub set: Vec<String>,
}

/// What a study measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Evaluation {
    /// Restorations beside the networks, as `udc eval --method` takes them.
    pub methods: Vec<String>,
    /// As `udc eval --metrics` takes them.
    pub metrics: Vec<String>,
}

impl Default for Evaluation {
    fn default() -> Self {
        Self { methods: Vec::new(), metrics: ["psnr", "ssim"].map(str::to_owned).into() }
    }
}

/// Into how many jobs stages are divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Shards {
    /// Painting scenes and cutting views.
    pub scenes: usize,
    /// The synthesis of each dataset.
    pub synth: usize,
    /// The evaluation on each dataset.
    pub eval: usize,
}

impl Default for Shards {
    fn default() -> Self {
        Self { scenes: 1, synth: 1, eval: 1 }
    }
}

fn usual_output() -> String {
    "study".to_owned()
}

fn usual_dim() -> usize {
    5
}

impl Study {
    /// Reads and checks a study.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no study, or one that combines nothing.
    pub fn read(path: &Path) -> Result<Self> {
        let study: Self = parse_toml(&io::read_text(path)?).map_err(|reason| Error::format(path, reason))?;
        study.check().map_err(|reason| Error::format(path, reason))?;
        Ok(study)
    }

    fn check(&self) -> Result<(), String> {
        let angles = parse_angles(&self.rotations.angles).map_err(|error| error.to_string())?.len();
        let Shards { scenes, synth, eval } = self.shards;
        let Scenes { painted, panoramas, size, test_fraction, tar, .. } = &self.scenes;
        if let Some(size) = tar {
            parse_bytes(size).map_err(|error| format!("[scenes] tar: {error}"))?;
        }
        let faults = [
            (*painted == 0 && panoramas.is_empty(), "[scenes] has neither painted scenes nor panoramas"),
            (*painted > MOST_SCENES, "[scenes] painted is more than 1000000"),
            (*size < 16, "[scenes] size is less than 16 pixels"),
            (!(0.0..=1.0).contains(test_fraction), "[scenes] test-fraction is no share between 0 and 1"),
            (self.panels.is_empty(), "[panels] names none"),
            (self.noise.is_empty(), "[noise] names none; `clean = \"none\"` is one"),
            (self.rotations.dim >= angles, "[rotations] dim must be less than the number of angles"),
            ([scenes, synth, eval].contains(&0), "[shards] divides into no part; 1 is the least"),
        ];
        match faults.into_iter().find(|(is_fault, _)| *is_fault) {
            Some((_, fault)) => Err(fault.to_owned()),
            None => Ok(()),
        }
    }

    /// The angles of the rotations in degrees.
    ///
    /// # Errors
    /// As [`parse_angles`], which reading the study has checked.
    pub fn angles(&self) -> Result<Vec<f64>> {
        parse_angles(&self.rotations.angles)
    }

    /// The number of datasets.
    pub fn datasets(&self) -> usize {
        self.panels.len() * self.noise.len()
    }

    /// The number of scenes, given that of the panoramas.
    pub fn scene_count(&self, panoramas: usize) -> usize {
        self.scenes.painted + panoramas * self.scenes.views
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_example_is_a_study() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let study = Study::read(&root.join("workflow/study.toml")).unwrap();
        assert_eq!((study.datasets(), study.angles().unwrap().len()), (2, 9));
        assert_eq!(study.scene_count(3), 400 + 3 * 18);
        assert!(study.networks.values().chain(study.panels.values()).all(|file| root.join(file).is_file()));
        Study::read(&root.join("tests/cluster/study.toml")).unwrap();
    }

    #[test]
    fn says_what_a_study_lacks() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("study.toml");
        let whole = "[scenes]\npainted = 3\n[panels]\na = \"a.toml\"\n[rotations]\nangles = \"0,3\"\ndim = 1\n[noise]\nb = \"none\"\n";
        let refusal = |from: &str, to: &str| {
            std::fs::write(&path, whole.replace(from, to)).unwrap();
            Study::read(&path).unwrap_err().to_string()
        };
        for (from, to, expected) in [
            ("painted = 3", "", "neither painted scenes nor panoramas"),
            ("painted", "paintd", "unknown field `paintd`"),
            ("painted = 3", "painted = 1000000000000", "painted is more than 1000000"),
            ("painted", "tar = \"big\"\npainted", "[scenes] tar"),
            ("a = \"a.toml\"", "", "[panels] names none"),
            ("dim = 1", "dim = 2", "less than the number of angles"),
            ("0,3", "0,3:", "study.toml"),
            ("[noise]", "[shards]\nsynth = 0\n[noise]", "1 is the least"),
        ] {
            let message = refusal(from, to);
            assert!(message.contains(expected) && message.contains("study.toml"), "{message}");
        }
        std::fs::write(&path, whole).unwrap();
        assert_eq!(Study::read(&path).unwrap().evaluation.metrics, ["psnr", "ssim"]);
    }
}
