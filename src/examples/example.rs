//! Makes one example: a capture, what it should be, and the planes that a restoration makes of the capture and the PSF
//! that it is told.

use std::collections::BTreeMap;

use super::capture::{Recorded, record, with_stray_light};
use super::config::{ExamplesConfig, PanelsConfig};
use super::panels::{Panels, wide_side};
use super::panoramas::PanoramaFile;
use super::recipe::Recipe;
use super::record::{ExampleRecord, Found};
use super::scene::make_scene;
use crate::codes::{MeasurementErrors, rotate};
use crate::core::error::Result;
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::rng;
use crate::core::saturation::saturated_from;
use crate::io::TensorData;
use crate::network::Plane;
use crate::restore::deconvolution::Border;
use crate::restore::{PlaneConfig, make_planes};

/// The tensor of the tone-mapped capture.
pub const CAPTURE: &str = "capture";

/// The tensor of the tone-mapped ground truth.
pub const GROUND_TRUTH: &str = "ground-truth";

/// What examples are made of.
pub(super) struct Ingredients<'a> {
    pub(super) config: &'a ExamplesConfig,
    pub(super) panoramas: &'a [PanoramaFile],
    pub(super) panels: Panels<'a>,
}

/// An example as its file holds it.
pub(super) struct Example {
    pub(super) tensors: BTreeMap<String, TensorData<'static>>,
    pub(super) record: ExampleRecord,
}

/// The PSFs of an example.
struct Psfs {
    /// What degrades the scene.
    truth: Psf,
    /// What the restoration is told.
    told: Psf,
    /// How they differ, beside what makes an example harder.
    errors: Option<MeasurementErrors>,
}

impl Ingredients<'_> {
    /// The recipe of an example.
    pub(super) fn recipe(&self, index: usize) -> Recipe {
        Recipe::draw(self.config, self.panoramas, index)
    }

    /// Makes an example; its panel was simulated before.
    pub(super) fn make(&self, recipe: &Recipe, progress: &Progress) -> Result<Example> {
        progress.check()?;
        let (config, side) = (self.config, self.config.side_px);
        let Psfs { truth, told, errors } = self.psfs(recipe)?;
        let margin = self.margin(recipe);
        let scene = make_scene(recipe, self.panoramas, side, margin)?;
        let recorded = record(recipe, (&scene, margin), &truth, config.alpha, config.seed)?;
        drop((scene, truth));
        let Recorded { capture, ground_truth, curve, saturation } = recorded;
        let border = recipe.border;
        let plane_config = PlaneConfig { curve, border, saturation, noise: None, coding_error: None };
        let progress = progress.without_bars();
        let planes = make_planes(&Plane::ALL, &capture, &told, &plane_config, &progress)?;
        let is_clipped = (0..)
            .zip(saturation.map(saturated_from))
            .any(|(channel, full)| capture.channel(channel).iter().any(|&value| value >= full));
        let found = Found { panel_seed: self.panels.seed(recipe.panel), errors, saturation, is_clipped };
        let mut tensors = BTreeMap::from([
            (CAPTURE.to_owned(), tensor(curve.tone_map_in_place(capture))),
            (GROUND_TRUTH.to_owned(), tensor(curve.tone_map_in_place(ground_truth))),
        ]);
        for plane in Plane::ALL {
            let image = planes.get(plane).expect("it was asked for");
            tensors.insert(plane.name().to_owned(), tensor(image.clone()));
        }
        Ok(Example { tensors, record: ExampleRecord::new(recipe, self.panoramas, found) })
    }

    /// Pixels around the frame from which light reaches it.
    fn margin(&self, recipe: &Recipe) -> usize {
        let PanelsConfig { psf_side_px: side, psf, .. } = &self.config.panels;
        match (recipe.border, recipe.harder) {
            (Border::Zero | Border::Periodic, _) => 0,
            (Border::Smooth, Some(_)) if psf.is_none() => wide_side(*side) / 2,
            (Border::Smooth, _) => side / 2,
        }
    }

    /// The true PSF, and the one that is handed over.
    fn psfs(&self, recipe: &Recipe) -> Result<Psfs> {
        let measured = rotate(&self.panels.read(recipe.panel)?, recipe.angle_deg)?;
        let mut rng = rng::stream(self.config.seed, &format!("errors/{}", recipe.index));
        let errors = MeasurementErrors::draw(&mut rng, self.config.panels.psf_side_px);
        let told = errors.apply(&measured, &mut rng)?;
        let truth = match recipe.harder {
            Some(harder) => {
                with_stray_light(&rotate(&self.panels.read_wide(recipe.panel)?, recipe.angle_deg)?, harder)?
            }
            None => measured,
        };
        Ok(Psfs { truth, told, errors: (!errors.is_none()).then_some(errors) })
    }
}

fn tensor(image: ToneMappedImage) -> TensorData<'static> {
    let shape = vec![CHANNELS, image.height(), image.width()];
    (shape, image.into_planes().into_raw_vec_and_offset().0.into())
}
