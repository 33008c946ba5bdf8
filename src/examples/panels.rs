//! Simulates the PSFs of panels, each once, and keeps them as files: `panels/NNN.exr`, and `panels/NNN-wide.exr` of twice
//! the support and another spectrum. A PSF that is given stands for a panel that cannot be simulated, and is as wide as it is.

use std::path::{Path, PathBuf};

use rand::RngExt as _;
use serde_json::json;

use super::config::ExamplesConfig;
use crate::core::error::Result;
use crate::core::progress::Progress;
use crate::core::provenance::Provenance;
use crate::core::psf::Psf;
use crate::core::rng::{self, Rng};
use crate::io::{self, WriteOptions};
use crate::psf::{DisplayConfig, random_display, simulate_psf};

/// The folder of the PSFs.
pub(super) const PANELS: &str = "panels";

/// The panels of a folder of examples.
pub(super) struct Panels<'a> {
    folder: PathBuf,
    config: &'a ExamplesConfig,
}

impl<'a> Panels<'a> {
    pub(super) fn new(root: &Path, config: &'a ExamplesConfig) -> Self {
        Self { folder: root.join(PANELS), config }
    }

    /// The seed that a panel is drawn from.
    pub(super) fn seed(&self, index: usize) -> u64 {
        // Short enough to be typed.
        u64::from(rng::stream(self.config.seed, &format!("panel/{index}")).random::<u32>())
    }

    /// Simulates a panel, or takes the one that is given, unless its files are there.
    pub(super) fn make(&self, index: usize, progress: &Progress) -> Result<()> {
        if let Some(given) = &self.config.panels.psf {
            return self.take(index, given);
        }
        let seed = self.seed(index);
        let simulate = |display: &DisplayConfig, path: &Path| {
            if path.exists() {
                return Ok(());
            }
            let psf = simulate_psf(display, &progress.without_bars())?.psf;
            let provenance = Some(Provenance::new("examples", display));
            // Another shard may be writing the same.
            io::write_psf(
                path,
                &psf,
                &WriteOptions { overwrite: true, provenance, ..WriteOptions::default() },
            )
        };
        let mut display = random_display(seed);
        display.sensor.size_px = self.config.panels.psf_side_px;
        io::create_folder(&self.folder)?;
        simulate(&display, &self.path(index))
            .and_then(|()| simulate(&self.widened(display, index), &self.wide_path(index)))
            .map_err(|error| error.while_doing(format!("simulating panel {index}, of seed {seed}")))
    }

    fn take(&self, index: usize, given: &Path) -> Result<()> {
        let path = self.path(index);
        if path.exists() {
            return Ok(());
        }
        io::create_folder(&self.folder)?;
        let provenance = Some(Provenance::new("examples", &json!({ "psf": given })));
        io::write_psf(
            &path,
            &io::read_psf(given)?,
            &WriteOptions { overwrite: true, provenance, ..WriteOptions::default() },
        )
    }

    /// The PSF of a panel.
    pub(super) fn read(&self, index: usize) -> Result<Psf> {
        io::read_psf(&self.path(index))
    }

    /// Its PSF of twice the support and another spectrum; of a panel that is given, there is but one.
    pub(super) fn read_wide(&self, index: usize) -> Result<Psf> {
        io::read_psf(&if self.config.panels.psf.is_some() { self.path(index) } else { self.wide_path(index) })
    }

    fn path(&self, index: usize) -> PathBuf {
        self.folder.join(format!("{index:03}.exr"))
    }

    fn wide_path(&self, index: usize) -> PathBuf {
        self.folder.join(format!("{index:03}-wide.exr"))
    }

    /// The same panel seen by a sensor of twice the sides, with the light of another lamp.
    fn widened(&self, mut display: DisplayConfig, index: usize) -> DisplayConfig {
        let mut rng = rng::stream(self.config.seed, &format!("panel/{index}/spectrum"));
        let spectrum = &mut display.spectrum;
        for lines in [&mut spectrum.red, &mut spectrum.green, &mut spectrum.blue] {
            shift(lines, self.config.harder.spectrum_shift_nm, &mut rng);
        }
        display.sensor.size_px = wide_side(self.config.panels.psf_side_px);
        display
    }
}

/// Twice a side, with a pixel in the middle where that has one.
pub(super) fn wide_side(side: usize) -> usize {
    2 * side - side % 2
}

/// Moves the lines of a channel together by up to `most_nm`, and weighs each by half to twice as much.
fn shift(lines: &mut [(f64, f64)], most_nm: f64, rng: &mut Rng) {
    let shift_nm = most_nm * (2.0 * rng.random::<f64>() - 1.0);
    for (wavelength_nm, weight) in lines {
        *wavelength_nm += shift_nm;
        *weight *= (2.0 * rng.random::<f64>() - 1.0).exp2();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panel_is_simulated_once_and_its_wide_psf_is_another() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = ExamplesConfig::default();
        config.panels.psf_side_px = 15;
        let panels = Panels::new(folder.path(), &config);
        panels.make(3, &Progress::default()).unwrap();
        let (psf, wide) = (panels.read(3).unwrap(), panels.read_wide(3).unwrap());
        assert_eq!(([psf.height(), psf.width()], [wide.height(), wide.width()]), ([15, 15], [29, 29]));
        let middle = Psf::from_energy(wide.planes().slice(ndarray::s![.., 7..22, 7..22]).to_owned()).unwrap();
        let apart: f32 = (&middle.planes() - &psf.planes()).mapv(f32::abs).sum();
        assert!(apart > 1e-3, "{apart}: another spectrum makes another PSF");

        let file = folder.path().join("panels/003.exr");
        let before = std::fs::metadata(&file).unwrap().modified().unwrap();
        panels.make(3, &Progress::default()).unwrap();
        assert_eq!(std::fs::metadata(&file).unwrap().modified().unwrap(), before);
        assert_ne!(panels.seed(3), panels.seed(4));
    }
}
