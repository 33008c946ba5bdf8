//! Restores captures.

use std::path::PathBuf;

use numpy::PyArray3;
use pyo3::prelude::*;
use serde_json::json;

use udc::core::bytes::parse_bytes;
use udc::core::error::{Error, Result};
use udc::core::tone::ToneFlags;
use udc::dataset::NoiseConfig;
use udc::io::{AnyImage, DomainTag, PsfOptions};
use udc::network::Backend;
use udc::restore::deconvolution::{Border, DeconvolutionConfig, Method};
use udc::restore::{
    Angle, FoundAngle, Highlights, KernelFiles, MemoryBudget, MethodConfig, PoseSource, Precision,
    RestorationConfig, Restored, is_guided,
};

use crate::error::to_python;
use crate::source::{Notices, Source, choice, domain, light_domain, planes_of, to_array, told, warning};
use crate::work::run;

/// How to restore, as `udc restore` takes it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct RestoreSettings {
    psf: Option<PathBuf>,
    bank: Option<PathBuf>,
    angle: Option<f64>,
    search_angle: bool,
    field: Option<PathBuf>,
    code: Option<PathBuf>,
    psf_domain: Option<String>,
    recenter: bool,
    model: Option<PathBuf>,
    method: Option<String>,
    refine: Option<f32>,
    true_highlights: bool,
    pose: Option<PathBuf>,
    pose_of_psf: bool,
    noise: Option<String>,
    balance: Option<f32>,
    border: Option<String>,
    iterations: Option<usize>,
    mask_saturated: bool,
    seed: Option<u64>,
    domain: Option<String>,
    output_domain: Option<String>,
    highlights: String,
    precision: String,
    tile: Option<usize>,
    max_memory: String,
    alpha: Option<f32>,
    x_max: Option<f32>,
}

const METHODS: [Method; 5] =
    [Method::Wiener, Method::WienerOrieux, Method::RichardsonLucy, Method::Constrained, Method::Joint];

impl RestoreSettings {
    fn config(&self) -> Result<RestorationConfig> {
        let methods = METHODS.map(|method| (method.name(), method));
        let method = self.method.as_deref().map(|word| choice("method", word, &methods)).transpose()?;
        let precisions = [Precision::F32, Precision::Bf16].map(|precision| (precision.name(), precision));
        let precision = choice("precision", &self.precision, &precisions)?;
        let is_guided = method.is_none() && self.model.as_deref().is_none_or(is_guided);
        self.check(method, is_guided)?;
        let method = match (method, &self.model) {
            (Some(method), _) => MethodConfig::Deconvolution(Box::new(self.deconvolution(method)?)),
            (None, Some(model)) if !is_guided => {
                MethodConfig::Network { model: model.clone(), precision, tile: self.tile }
            }
            (None, model) => MethodConfig::Guided {
                model: model.clone(),
                refine: self.refine.unwrap_or(1.0),
                true_highlights: self.true_highlights,
                pose: self.pose(),
                border: self.border()?.unwrap_or_default(),
                precision,
                tile: self.tile,
            },
        };
        let highlights =
            [("restored", Highlights::Restored), ("keep", Highlights::Keep), ("blend", Highlights::Blend)];
        let limit_bytes = parse_bytes(&self.max_memory)
            .map_err(|reason| Error::config("max_memory", reason.to_string()))?;
        let config = RestorationConfig {
            method,
            kernel: self.kernel()?,
            alpha: self.alpha,
            x_max: self.x_max,
            highlights: choice("highlights", &self.highlights, &highlights)?,
            noise: self.noise.as_deref().map(NoiseConfig::parse).transpose()?,
            backend: Backend::default(),
            memory: MemoryBudget { limit_bytes, ..MemoryBudget::default() },
        };
        config.curve(None)?;
        Ok(config)
    }

    /// Refuses what would be ignored.
    fn check(&self, method: Option<Method>, is_guided: bool) -> Result<()> {
        use Method::{Constrained, RichardsonLucy, Wiener, WienerOrieux};
        let of_method = |methods: &[Method]| method.is_some_and(|method| methods.contains(&method));
        let is_given = [
            ("model", self.model.is_some(), method.is_none()),
            ("refine", self.refine.is_some(), is_guided),
            ("true_highlights", self.true_highlights, is_guided),
            ("pose", self.pose.is_some() || self.pose_of_psf, is_guided),
            ("noise", self.noise.is_some(), is_guided || of_method(&[Method::Joint])),
            ("tile", self.tile.is_some(), method.is_none()),
            ("bank", self.bank.is_some(), method.is_none() && !(is_guided && self.psf.is_some())),
            ("code", self.code.is_some(), method.is_none() && self.bank.is_none() && self.psf.is_none()),
            ("angle", self.angle.is_some() || self.search_angle, self.bank.is_some() && self.psf.is_none()),
            ("field", self.field.is_some(), self.bank.is_some() && self.psf.is_none()),
            ("border", self.border.is_some(), is_guided || method.is_some()),
            ("balance", self.balance.is_some(), of_method(&[Wiener])),
            ("iterations", self.iterations.is_some(), of_method(&[RichardsonLucy, Constrained])),
            ("mask_saturated", self.mask_saturated, of_method(&[Wiener, WienerOrieux])),
            ("seed", self.seed.is_some(), of_method(&[WienerOrieux])),
        ];
        if let Some((key, ..)) = is_given.into_iter().find(|(_, is_given, suits)| *is_given && !suits) {
            let reason = "does not belong to what is asked for, which would ignore it: leave it out (the docstring says what it \
                          belongs to)";
            return Err(Error::config(key, reason));
        }
        if self.true_highlights && self.output_domain.as_deref() == Some(DomainTag::ToneMapped.name()) {
            let reason = "is light above what saturates, which a tone-mapped image does not hold: leave out output_domain";
            return Err(Error::config("true_highlights", reason));
        }
        if self.true_highlights && self.highlights != "restored" {
            let reason = "gives lamps the light that their flare tells, and highlights the capture's own: leave one of them out";
            return Err(Error::config("true_highlights", reason));
        }
        Ok(())
    }

    fn deconvolution(&self, method: Method) -> Result<DeconvolutionConfig> {
        let default = DeconvolutionConfig::of_method(method);
        Ok(DeconvolutionConfig {
            balance: self.balance.unwrap_or(default.balance),
            border: self.border()?.unwrap_or(default.border),
            iterations: self.iterations.unwrap_or(default.iterations),
            mask_saturated: self.mask_saturated,
            seed: self.seed.unwrap_or(default.seed),
            ..default
        })
    }

    fn border(&self) -> Result<Option<Border>> {
        let borders = [("smooth", Border::Smooth), ("periodic", Border::Periodic), ("zero", Border::Zero)];
        self.border.as_deref().map(|word| choice("border", word, &borders)).transpose()
    }

    fn pose(&self) -> PoseSource {
        match (&self.pose, self.pose_of_psf) {
            (Some(file), _) => PoseSource::File(file.clone()),
            (None, true) => PoseSource::Psf,
            (None, false) => PoseSource::Capture,
        }
    }

    fn kernel(&self) -> Result<KernelFiles> {
        let domain = light_domain("psf_domain", self.psf_domain.as_deref())?;
        let angle = if self.search_angle { Some(Angle::Search) } else { self.angle.map(Angle::Degrees) };
        Ok(KernelFiles {
            bank: self.bank.clone(),
            angle,
            psf: self.psf.clone(),
            field: self.field.clone(),
            code: self.code.clone(),
            psf_options: PsfOptions { domain, domain_flag: "--psf-domain", recenter: self.recenter },
        })
    }
}

/// The image, its domain, what is known of the capture, what was found in it, and what there is to tell.
type RestoredArray<'py> = (Bound<'py, PyArray3<f32>>, &'static str, Option<String>, String, Notices);

/// Restores a capture.
#[pyfunction]
pub(crate) fn restore<'py>(
    py: Python<'py>,
    capture: Source<'_>,
    info: Option<&str>,
    settings: RestoreSettings,
) -> PyResult<RestoredArray<'py>> {
    let resolve = || {
        let told = domain("domain", settings.domain.as_deref())?;
        Ok((told, domain("output_domain", settings.output_domain.as_deref())?))
    };
    let (domain_told, output) = resolve().map_err(|error| to_python(&error))?;
    let capture = capture.own(info)?;
    let tone = ToneFlags { alpha: settings.alpha, x_max: settings.x_max };
    let (image, info, found, notices) = run(py, |progress| {
        let mut notices = Notices::new();
        let (restoration, of_files) = settings.config()?.open()?;
        notices.extend(of_files.iter().map(told));
        let capture = capture.capture((domain_told, tone), progress, &mut notices)?;
        let usual = if settings.true_highlights { DomainTag::Linear } else { capture.image.domain() };
        let restored = restoration.restore(capture, progress)?;
        notices.extend(restored.doubt().map(warning));
        notices.extend(restored.empty_lines.as_ref().map(|lines| warning(lines.to_string())));
        notices.extend(restored.floor.map(|floor| warning(floor.to_string())));
        notices.extend(restored.doubted_noise.map(|noise| warning(noise.to_string())));
        notices.extend(restored.doubt_psf().map(warning));
        let Restored { image, info, angle, curve, lamps, levels, pose, .. } = restored;
        notices.extend(angle.as_ref().and_then(FoundAngle::warning).map(|text| warning(text.to_owned())));
        let found = json!({
            "angle": angle.map(|angle| angle.to_string()),
            "levels": levels,
            "lamps": lamps,
            "pose": pose.map(|pose| json!({"turn": pose.turn_deg, "scale": pose.scale})),
        });
        let image = match output.unwrap_or(usual) {
            DomainTag::ToneMapped => AnyImage::ToneMapped(image.into_tone_mapped(curve), Some(curve)),
            DomainTag::Linear | DomainTag::Display | DomainTag::Srgb => {
                AnyImage::Linear(image.into_linear(curve))
            }
        };
        Ok((image, info.map(|info| info.to_json()), found.to_string(), notices))
    })?;
    let (planes, domain) = planes_of(image);
    Ok((to_array(py, planes)?, domain, info, found, notices))
}
