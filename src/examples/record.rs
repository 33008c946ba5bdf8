//! Says of an example what it was made of: a line of `examples-I-of-N.jsonl`.

use serde::{Deserialize, Serialize};

use super::panoramas::PanoramaFile;
use super::recipe::{Recipe, SceneRecipe};
use crate::codes::MeasurementErrors;
use crate::core::image::CHANNELS;
use crate::dataset::Split;
use crate::restore::deconvolution::Border;

/// What an example was made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExampleRecord {
    /// Its name: the file `<id>.safetensors` holds it.
    pub id: String,
    /// What it is for.
    pub split: Split,
    /// What validations are scored by: `simulator` or `harder`, `noise-free` or `noisy`, `clipped` or `unclipped`, `exact`
    /// or `measured`, `painted` or `panorama`.
    pub tags: Vec<String>,
    /// Number of the panel.
    pub panel: usize,
    /// The seed that the panel is drawn from.
    pub panel_seed: u64,
    /// How far the panel is turned.
    pub angle_deg: f64,
    /// The errors of the PSF that was handed over; none where it is the true one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub errors: Option<MeasurementErrors>,
    /// The panorama, or the kind of a painted scene.
    pub scene: String,
    /// The seed of a painted scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene_seed: Option<u64>,
    /// Where a view looks: yaw and pitch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view_deg: Option<[f64; 2]>,
    /// The median of the scene's green light.
    pub brightness: f64,
    /// What lies beyond the border.
    pub border: Border,
    /// The value of a full photosite in each channel.
    pub saturation: [f32; CHANNELS],
    /// Electrons at white and standard deviation of the read-out noise; none without noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub electrons: Option<[f64; 2]>,
    /// The share of the light that is stray.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stray_light: Option<f64>,
}

/// What came out while an example was made.
pub(super) struct Found {
    pub(super) panel_seed: u64,
    pub(super) errors: Option<MeasurementErrors>,
    pub(super) saturation: [f32; CHANNELS],
    /// Whether any photosite is full.
    pub(super) is_clipped: bool,
}

impl ExampleRecord {
    pub(super) fn new(recipe: &Recipe, panoramas: &[PanoramaFile], found: Found) -> Self {
        let Found { panel_seed, errors, saturation, is_clipped } = found;
        let (scene, scene_seed, view_deg) = match &recipe.scene {
            SceneRecipe::Painted { kind, seed } => (kind.name().to_owned(), Some(*seed), None),
            SceneRecipe::Panorama { panorama, yaw_deg, pitch_deg, .. } => {
                (panoramas[*panorama].name.clone(), None, Some([*yaw_deg, *pitch_deg]))
            }
        };
        let tag = |holds: bool, [yes, no]: [&str; 2]| if holds { yes } else { no }.to_owned();
        Self {
            id: recipe.id(),
            split: recipe.split,
            tags: vec![
                tag(recipe.harder.is_some(), ["harder", "simulator"]),
                tag(recipe.sensor.is_none(), ["noise-free", "noisy"]),
                tag(is_clipped, ["clipped", "unclipped"]),
                tag(errors.is_none(), ["exact", "measured"]),
                tag(scene_seed.is_some(), ["painted", "panorama"]),
            ],
            panel: recipe.panel,
            panel_seed,
            angle_deg: recipe.angle_deg,
            errors,
            scene,
            scene_seed,
            view_deg,
            brightness: recipe.brightness,
            border: recipe.border,
            saturation,
            electrons: recipe.sensor.map(|sensor| [sensor.full_well_e, sensor.read_noise_e]),
            stray_light: recipe.harder.map(|harder| harder.stray_light),
        }
    }

    /// The name of the file that holds the example.
    pub fn file_name(&self) -> String {
        format!("{}.safetensors", self.id)
    }

    /// The line of a list.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub(super) fn to_line(&self) -> String {
        serde_json::to_string(self).expect("records are plain data")
    }

    /// Whether its name is a number, and no path to anywhere: a list may have been damaged.
    pub(super) fn has_number(&self) -> bool {
        !self.id.is_empty() && self.id.bytes().all(|byte| byte.is_ascii_digit())
    }
}
