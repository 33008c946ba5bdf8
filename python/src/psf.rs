//! Simulates PSFs.

use std::path::{Path, PathBuf};

use numpy::PyArray3;
use pyo3::prelude::*;

use udc::codes::MeasurementErrors;
use udc::core::error::{Error, Result};
use udc::core::rng::stream;
use udc::io::{PsfOptions, inspect_psf};
use udc::psf::{DisplayConfig, random_display};
use udc::restore::Notice;

use crate::source::{Notices, light_domain, to_array, told, warning};
use crate::work::run;

/// Where a PSF comes from: a display file, a description of one as JSON, a seed, or the file of a PSF.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct PsfSettings {
    display: Option<PathBuf>,
    description: Option<String>,
    random: Option<u64>,
    from_: Option<PathBuf>,
    size: Option<usize>,
    domain: Option<String>,
    recenter: bool,
    turn: f64,
    scale: f64,
    defocus: f64,
    noise: f64,
    reach: Option<usize>,
    seed: u64,
}

impl PsfSettings {
    fn display(&self) -> Result<Option<DisplayConfig>> {
        if let Some(path) = &self.display {
            return DisplayConfig::read(path, self.size).map(Some);
        }
        if let Some(text) = &self.description {
            return display_of(text, self.size).map(Some);
        }
        Ok(self.random.map(|seed| {
            let mut display = random_display(seed);
            display.sensor.size_px = self.size.unwrap_or(display.sensor.size_px);
            display
        }))
    }

    fn errors(&self) -> MeasurementErrors {
        MeasurementErrors {
            turn_deg: self.turn,
            scale: self.scale,
            defocus_px: self.defocus,
            noise: self.noise,
            reach_px: self.reach,
        }
    }
}

/// A display of its description as JSON.
pub(crate) fn display_of(text: &str, size: Option<usize>) -> Result<DisplayConfig> {
    let parsed = serde_json::from_str(text);
    let mut display: DisplayConfig = parsed.map_err(|reason| Error::config("display", reason.to_string()))?;
    display.sensor.size_px = size.unwrap_or(display.sensor.size_px);
    display.check()?;
    Ok(display)
}

/// A PSF, the description of its display, and what there is to tell.
type Simulated<'py> = (Bound<'py, PyArray3<f32>>, Option<String>, Notices);

/// Simulates the PSF of a display, or gives one the errors of a measurement.
#[pyfunction]
pub(crate) fn simulate_psf<'py>(py: Python<'py>, settings: PsfSettings) -> PyResult<Simulated<'py>> {
    let (planes, display, notices) = run(py, |progress| {
        let mut notices = Notices::new();
        let display = settings.display()?;
        let psf = match &display {
            Some(display) => {
                if display.display.is_featureless() {
                    let lens =
                        "the panel has no sub-pixels, openings or wiring: its PSF is that of the bare lens";
                    notices.push(warning(lens.to_owned()));
                }
                let simulated = udc::psf::simulate_psf(display, progress)?;
                notices.push(("debug", simulated.geometry_in_words()));
                notices.extend(simulated.summary().into_iter().map(|line| ("info", line)));
                simulated.psf
            }
            None => {
                let domain = light_domain("domain", settings.domain.as_deref())?;
                let options = PsfOptions { domain, recenter: settings.recenter, ..PsfOptions::default() };
                let reading = inspect_psf(settings.from_.as_deref().unwrap_or(Path::new("")), options)?;
                notices.extend(Notice::of_psf(&reading).iter().map(told));
                reading.psf
            }
        };
        let psf = settings.errors().apply(&psf, &mut stream(settings.seed, "psf/errors"))?;
        let display = display.and_then(|display| serde_json::to_string(&display).ok());
        Ok((psf.planes().to_owned(), display, notices))
    })?;
    Ok((to_array(py, planes)?, display, notices))
}
