//! Fuses brackets of exposures.

use std::path::PathBuf;

use numpy::PyArray3;
use pyo3::prelude::*;

use udc::capture::{
    Developed, MergeRule, PSF_BRACKET, Pictures, SCENE_BRACKET, Told, ToldLevels, read_mask, uncorrected,
};
use udc::core::bayer::BayerPattern;
use udc::core::error::Result;
use udc::core::tone::ToneFlags;
use udc::psf::{MeasureConfig, Normalization, measure_psf};

use crate::error::to_python;
use crate::source::{Notices, choice, light_domain, to_array, warning};
use crate::work::run;

/// What is known of the pictures, and what to make of them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FuseSettings {
    exposures: Option<Vec<f64>>,
    estimate_exposures: bool,
    white: Option<f64>,
    black: Option<f64>,
    bayer: Option<String>,
    white_balance: Option<[f64; 3]>,
    merge: String,
    allow_motion: bool,
    dark: Option<Vec<PathBuf>>,
    dark_exposures: Option<Vec<f64>>,
    domain: Option<String>,
    mask: Option<PathBuf>,
    point_source: bool,
    size: Option<usize>,
    normalize: Option<String>,
}

impl FuseSettings {
    fn told(&self) -> Result<Told> {
        let patterns = [
            ("rggb", BayerPattern::Rggb),
            ("bggr", BayerPattern::Bggr),
            ("grbg", BayerPattern::Grbg),
            ("gbrg", BayerPattern::Gbrg),
        ];
        let merges = [("longest", MergeRule::Longest), ("weighted", MergeRule::Weighted)];
        let bayer = self.bayer.as_deref().map(|word| choice("bayer", word, &patterns)).transpose()?;
        let Self { white, black, white_balance, .. } = *self;
        Ok(Told {
            levels: ToldLevels { white, black, bayer, white_balance },
            domain: light_domain("domain", self.domain.as_deref())?,
            tone: ToneFlags::default(),
            exposures: self.exposures.clone(),
            default_times: Some(if self.point_source { PSF_BRACKET } else { SCENE_BRACKET }),
            estimate_exposures: self.estimate_exposures,
            merge: choice("merge", &self.merge, &merges)?,
            allow_motion: self.allow_motion,
            darks: self.dark.clone(),
            dark_exposures: self.dark_exposures.clone(),
            mask: self.mask.as_deref().map(read_mask).transpose()?,
            demosaic_linear: self.point_source,
        })
    }

    fn measure_config(&self) -> Result<Option<MeasureConfig>> {
        if !self.point_source {
            return Ok(None);
        }
        let names = [
            ("channel", Normalization::Channel),
            ("total", Normalization::Total),
            ("none", Normalization::None),
        ];
        let default = MeasureConfig::default();
        let normalize =
            self.normalize.as_deref().map(|word| choice("normalize", word, &names)).transpose()?;
        let size = self.size.unwrap_or(default.size);
        let config = MeasureConfig { size, normalize: normalize.unwrap_or(default.normalize) };
        config.check()?;
        Ok(Some(config))
    }
}

/// The light, what is known of its capture, and what there is to tell.
type FusedArray<'py> = (Bound<'py, PyArray3<f32>>, Option<String>, Notices);

/// Fuses the pictures of files.
#[pyfunction]
pub(crate) fn fuse<'py>(
    py: Python<'py>,
    files: Vec<PathBuf>,
    settings: FuseSettings,
) -> PyResult<FusedArray<'py>> {
    let measure = settings.measure_config().map_err(|error| to_python(&error))?;
    let (planes, info, notices) = run(py, |progress| {
        let told = settings.told()?;
        let mut pictures = Pictures::read(&files, &told, progress)?;
        let mut warnings = std::mem::take(&mut pictures.warnings);
        progress.check()?;
        let Developed { fused, info, raw, .. } = pictures.develop()?;
        progress.check()?;
        let measured = measure.as_ref().map(|measure| measure_psf(&fused.image, told.mask.as_ref(), measure));
        let measured = measured.transpose()?;
        warnings.extend(raw.as_ref().and_then(uncorrected));
        let saturated: usize = fused.saturated.iter().sum();
        if saturated > 0 {
            warnings.push(format!(
                "{saturated} values are saturated in every exposure and brighter than told; add a shorter exposure"
            ));
        }
        warnings.extend(fused.warnings());
        warnings.extend(measured.as_ref().and_then(|_| fused.core_is_narrow()));
        let info = measured.is_none().then(|| info.to_json());
        let planes = match measured {
            None => fused.image.into_planes(),
            Some(measured) => {
                warnings.extend(measured.warnings());
                match settings.normalize.as_deref() {
                    None | Some("channel") => measured.psf.planes().to_owned(),
                    Some(_) => measured.image.into_planes(),
                }
            }
        };
        Ok((planes, info, warnings.into_iter().map(warning).collect()))
    })?;
    Ok((to_array(py, planes)?, info, notices))
}
