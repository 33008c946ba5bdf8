//! Stands in for what other modules are about to have.

use rand::RngExt as _;

use crate::core::error::Result;
use crate::core::psf::Psf;
use crate::core::rng::{self, Rng};
use crate::psf::DisplayConfig;
use crate::scenes::{PaintedScene, SceneKind, paint};

pub(super) fn random_display(seed: u64) -> DisplayConfig {
    let mut rng = rng::stream(seed, "display");
    let pitch = 60.0 + 60.0 * rng.random::<f64>();
    let text = include_str!("../../configs/display/pentile.toml");
    let mut display =
        DisplayConfig::parse(text, std::path::Path::new("pentile.toml")).expect("it is shipped");
    display.display.pitch_um = Some(pitch.round());
    display
}

#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MeasurementErrors {
    pub turn_deg: f64,
}

impl MeasurementErrors {
    pub(super) fn draw(rng: &mut Rng, _: usize) -> Self {
        Self { turn_deg: (rng.random::<f64>() - 0.3).max(0.0) }
    }

    pub(super) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn apply(&self, psf: &Psf, _: &mut Rng) -> Result<Psf> {
        crate::codes::rotate(psf, self.turn_deg)
    }
}

pub(super) fn natural(seed: u64, [height, width]: [usize; 2]) -> Result<PaintedScene> {
    let side = height.max(width);
    let scene = paint(SceneKind::ALL[(seed % 3) as usize], 0, side, seed)?;
    Ok(PaintedScene { image: scene.image.crop(0, 0, height, width), name: scene.name })
}
