//! Degrades scenes by the image formation model.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use numpy::PyArray3;
use pyo3::prelude::*;

use udc::core::capture::{CaptureInfo, is_level};
use udc::core::error::{Error, Result};
use udc::core::fft::{Boundary, Convolver, Otf};
use udc::core::image::{CHANNELS, Linear};
use udc::core::kernel_code::KernelBank;
use udc::dataset::{FormationConfig, NoiseConfig};
use udc::io::{PsfOptions, image_of, inspect_psf};
use udc::restore::Notice;
use udc::synth::Formation;

use crate::bank;
use crate::error::{misuse, to_python};
use crate::source::{Given, Notices, Source, choice, light_domain, to_array, told, warning};
use crate::work::run;

/// The image formation model, as `udc synth` takes it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct DegradeSettings {
    psf: Option<PathBuf>,
    psf_domain: Option<String>,
    recenter: bool,
    preset: String,
    x_max: Option<f32>,
    alpha: Option<f32>,
    border: Option<String>,
    margin: usize,
    clip_ground_truth: bool,
    noise: String,
    seed: u64,
    domain: Option<String>,
}

impl DegradeSettings {
    fn formation(&self) -> Result<FormationConfig> {
        let presets: [(&str, fn() -> FormationConfig); 2] =
            [("paper", FormationConfig::default), ("released", FormationConfig::released)];
        let borders =
            [("zero", Boundary::Zero), ("replicate", Boundary::Replicate), ("reflect", Boundary::Reflect)];
        let preset = choice("preset", &self.preset, &presets)?();
        let border = self.border.as_deref().map(|word| choice("border", word, &borders)).transpose()?;
        let noise = NoiseConfig::parse(&self.noise)?;
        let x_max = match &noise {
            NoiseConfig::Sensor(sensor) => sensor.x_max(),
            NoiseConfig::None | NoiseConfig::Gaussian { .. } => preset.x_max,
        };
        Ok(FormationConfig {
            x_max: self.x_max.unwrap_or(x_max),
            alpha: self.alpha.unwrap_or(preset.alpha),
            boundary: border.unwrap_or(preset.boundary),
            margin: self.margin,
            clip_ground_truth: self.clip_ground_truth || preset.clip_ground_truth,
            noise,
        })
    }

    fn read_psf(&self, notices: &mut Notices) -> Result<KernelBank> {
        let path = self.psf.as_ref().ok_or_else(|| Error::config("psf", "name a psf or a bank"))?;
        let domain = light_domain("psf_domain", self.psf_domain.as_deref())?;
        let options = PsfOptions { domain, domain_flag: "--psf-domain", recenter: self.recenter };
        let reading = inspect_psf(path, options)?;
        notices.extend(Notice::of_psf(&reading).iter().map(told));
        Ok(KernelBank::single(reading.psf))
    }
}

/// Degrades scenes through the kernels of a bank; keeps what is transformed of the kernels for scenes of the same size.
#[pyclass(frozen, module = "udc._native")]
pub(crate) struct Degrader {
    bank: Arc<KernelBank>,
    formation: Formation,
    seed: u64,
    domain: Option<String>,
    prepared: Mutex<HashMap<[usize; 2], Arc<Prepared>>>,
}

/// Most sizes of scenes of which transforms are kept.
const KEPT_SIZES: usize = 4;

/// What is kept for scenes of one size.
struct Prepared {
    convolver: Convolver,
    otfs: Vec<OnceLock<Otf>>,
}

impl Degrader {
    fn prepared(&self, size: [usize; 2]) -> Result<Arc<Prepared>> {
        let mut kept = self.prepared.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = kept.get(&size) {
            return Ok(Arc::clone(found));
        }
        let psf = &self.bank.psfs[0];
        let convolver = self.formation.convolver(size, [psf.height(), psf.width()])?;
        let otfs = self.bank.psfs.iter().map(|_| OnceLock::new()).collect();
        if kept.len() >= KEPT_SIZES {
            kept.clear();
        }
        let made = Arc::new(Prepared { convolver, otfs });
        kept.insert(size, Arc::clone(&made));
        Ok(made)
    }

    fn degrade(&self, scene: Given, kernel: usize, name: &str) -> Result<(ndarray::Array3<f32>, Notices)> {
        let domain = light_domain("domain", self.domain.as_deref())?;
        let (path, mut pixels) = scene.pixels()?;
        let notices = pixels.tell(&path, domain)?.map(warning).into_iter().collect();
        pixels.check_told_light(&path)?;
        let scene = image_of::<Linear>(&path, pixels)?;
        let prepared = self.prepared([scene.height(), scene.width()])?;
        let (convolver, otf) = (&prepared.convolver, &prepared.otfs[kernel]);
        if otf.get().is_none() {
            // Whichever thread is first keeps it.
            let _ = otf.set(convolver.otf(&self.bank.psfs[kernel])?);
        }
        let otf = otf.get().expect("was set");
        let spectrum = convolver.spectrum(&self.formation.scene(&scene))?;
        let irradiance = self.formation.irradiance(convolver, &spectrum, otf);
        convolver.reuse(spectrum);
        let label = format!("{name}/{}", self.bank.kernel_name(kernel));
        Ok((self.formation.record(irradiance, &label)?.into_planes(), notices))
    }
}

#[pymethods]
impl Degrader {
    #[new]
    fn new(
        py: Python<'_>,
        bank: Option<&bank::KernelBank>,
        settings: DegradeSettings,
        notices: &Bound<'_, pyo3::types::PyList>,
    ) -> PyResult<Self> {
        let bank = bank.map(|bank| Arc::clone(&bank.0));
        let (made, told) = run(py, |_| {
            let mut told = Notices::new();
            let bank = match bank {
                Some(bank) => bank,
                None => Arc::new(settings.read_psf(&mut told)?),
            };
            let config = settings.formation()?;
            told.extend(config.scale_warning(Some("x_max")).map(warning));
            let formation = Formation::new(config, settings.seed)?;
            let DegradeSettings { seed, domain, .. } = settings;
            Ok((Self { bank, formation, seed, domain, prepared: Mutex::default() }, told))
        })?;
        told.into_iter().try_for_each(|notice| notices.append(notice))?;
        Ok(made)
    }

    /// Number of kernels.
    fn __len__(&self) -> usize {
        self.bank.len()
    }

    /// The seed of the noise.
    #[getter]
    fn seed(&self) -> u64 {
        self.seed
    }

    /// The names of the kernels.
    #[getter]
    fn names(&self) -> Vec<String> {
        (0..self.bank.len()).map(|index| self.bank.kernel_name(index)).collect()
    }

    /// What is known of the images that it makes, as JSON.
    #[getter]
    fn info(&self) -> String {
        let x_max = self.formation.config().x_max;
        let saturation = is_level(x_max).then_some([x_max; CHANNELS]);
        CaptureInfo { saturation, ..CaptureInfo::default() }.to_json()
    }

    /// C(x∗k + n) of a scene x; `name` and the kernel's name decide the noise, with the seed.
    fn degrade_by<'py>(
        &self,
        py: Python<'py>,
        scene: Source<'_>,
        kernel: usize,
        name: &str,
    ) -> PyResult<(Bound<'py, PyArray3<f32>>, Notices)> {
        if kernel >= self.bank.len() {
            let count = self.bank.len();
            return Err(misuse(&format!(
                "kernel: must be below {count}, the number of kernels, found {kernel}"
            )));
        }
        let scene = scene.own(None)?;
        let (planes, notices) = run(py, |_| self.degrade(scene, kernel, name))?;
        Ok((to_array(py, planes)?, notices))
    }

    /// C(x) of the frame: the ground truth of a scene.
    fn ground_truth<'py>(&self, py: Python<'py>, scene: Source<'_>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let scene = scene.own(None)?;
        let domain = light_domain("domain", self.domain.as_deref()).map_err(|error| to_python(&error))?;
        let planes = run(py, |_| {
            let (path, mut pixels) = scene.pixels()?;
            pixels.tell(&path, domain)?;
            let scene = image_of::<Linear>(&path, pixels)?;
            Ok(self.formation.ground_truth(&scene)?.into_planes())
        })?;
        to_array(py, planes)
    }
}
