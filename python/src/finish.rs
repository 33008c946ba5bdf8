//! Finishes restored light for viewing.

use std::path::PathBuf;

use ndarray::Array3;
use pyo3::prelude::*;

use udc::core::capture::{CaptureInfo, is_exposure, is_level};
use udc::core::error::{Error, Result};
use udc::core::orientation::Orientation;
use udc::core::primaries::ColorSpace;
use udc::core::tone::{ToneCurve, ToneFlags};
use udc::finish::{
    ClaheConfig, Clip, ColorMatrix, Curve, CurveKind, Look, NoiseFloor, RollOff, Style, channel_means,
    finish as finish_light, read_color_matrix,
};

use crate::error::to_python;
use crate::source::{Given, Notices, Source, choice, domain, to_array, warning};
use crate::work::run;

/// How pictures shall look, as `udc finish` takes it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FinishSettings {
    domain: Option<String>,
    ccm: Option<PathBuf>,
    no_ccm: bool,
    orientation: Option<usize>,
    saturation: Option<[f32; 3]>,
    baseline_exposure: Option<f64>,
    clip: Option<f32>,
    no_clip: bool,
    curve: Option<String>,
    gamma: Option<f32>,
    max: Option<f32>,
    roll_off: Option<String>,
    color_space: String,
    noise: Option<f32>,
    estimate_noise: bool,
    clip_limit: Option<f64>,
    grid: Option<usize>,
    no_clahe: bool,
    bits: u8,
    alpha: Option<f32>,
    x_max: Option<f32>,
}

impl FinishSettings {
    fn check(&self, has_reference: bool) -> Result<()> {
        let refuse = |key: &str, reason: &str| Err(Error::config(key, reason));
        if self.baseline_exposure.is_some() && (has_reference || self.says_curve()) {
            return refuse(
                "baseline_exposure",
                "belongs to the automatic exposure: leave out reference, and curve, gamma and max",
            );
        }
        if self.no_ccm && self.ccm.is_some() {
            return refuse("no_ccm", "contradicts ccm: leave one of them out");
        }
        if self.no_clip && self.clip.is_some() {
            return refuse("no_clip", "contradicts clip: leave one of them out");
        }
        if self.no_clahe && (self.clip_limit.is_some() || self.grid.is_some() || self.noise.is_some()) {
            return refuse("no_clahe", "contradicts clip_limit, grid and noise: leave them out");
        }
        if self.saturation.iter().flatten().any(|level| !is_level(*level)) {
            return refuse("saturation", "must be three numbers from 1e-6 to 1e9, for red, green and blue");
        }
        if self.baseline_exposure.is_some_and(|stops| !is_exposure(stops)) {
            return refuse("baseline_exposure", "must be a number of stops from -10 to 10");
        }
        choice("bits", &self.bits.to_string(), &[("8", ()), ("16", ()), ("32", ())])
    }

    fn says_curve(&self) -> bool {
        self.curve.is_some() || self.gamma.is_some() || self.max.is_some()
    }

    fn style(&self) -> Result<Style> {
        let clip = match self.clip {
            Some(light) => Clip::At(light),
            None if self.no_clip => Clip::Nowhere,
            None => Clip::Usual,
        };
        let default = ClaheConfig::default();
        let clahe = ClaheConfig {
            clip_limit: self.clip_limit.unwrap_or(default.clip_limit),
            grid: self.grid.map(|side| [side; 2]).or(default.grid),
            ..default
        };
        let kinds = [
            ("gamma", CurveKind::Gamma),
            ("srgb", CurveKind::Srgb),
            ("aces", CurveKind::Aces),
            ("none", CurveKind::None),
        ];
        let kind = self.curve.as_deref().map(|word| choice("curve", word, &kinds)).transpose()?;
        let curve = || Curve::of_kind(kind.unwrap_or_default(), self.gamma, self.max);
        let curve =
            self.says_curve().then(curve).transpose().map_err(|reason| Error::config("curve", reason))?;
        let roll_offs = [("hue", RollOff::Hue), ("channels", RollOff::Channels)];
        let spaces = [("srgb", ColorSpace::Srgb), ("display-p3", ColorSpace::DisplayP3)];
        let style = Style {
            clip,
            curve,
            roll_off: self
                .roll_off
                .as_deref()
                .map(|word| choice("roll_off", word, &roll_offs))
                .transpose()?,
            color_space: choice("color_space", &self.color_space, &spaces)?,
            clahe: (!self.no_clahe).then_some(clahe),
            noise: self.noise_floor()?,
            ..Style::default()
        };
        style.check()?;
        Ok(style)
    }

    fn noise_floor(&self) -> Result<Option<NoiseFloor>> {
        match self.noise {
            _ if self.estimate_noise => Ok(Some(NoiseFloor::Estimated)),
            None => Ok(None),
            Some(codes) if !(0.0..=255.0).contains(&codes) => {
                let reason = format!("must be \"auto\" or a number of codes from 0 to 255, found {codes}");
                Err(Error::config("noise", reason))
            }
            Some(codes) if codes > 0.0 => Ok(Some(NoiseFloor::Told(codes))),
            Some(_) => Ok(Some(NoiseFloor::Ignored)),
        }
    }

    fn look(&self, said: CaptureInfo, reference: Option<Given>, notices: &mut Notices) -> Result<Look> {
        let of_number = |number: usize| {
            Orientation::from_exif(number).ok_or_else(|| {
                Error::config("orientation", format!("must be a number from 1 to 8, found {number}"))
            })
        };
        let mut look = Look::of_capture(&CaptureInfo {
            saturation: self.saturation.or(said.saturation),
            orientation: self.orientation.map(of_number).transpose()?.or(said.orientation),
            baseline_exposure_ev: self.baseline_exposure.or(said.baseline_exposure_ev),
            ..said
        });
        look.ccm = look.ccm.filter(|_| !self.no_ccm);
        if let Some(path) = &self.ccm {
            let ccm: ColorMatrix = read_color_matrix(path)?;
            if ccm.looks_transposed() {
                notices.push(warning(
                    "the columns of ccm sum to one, not its rows, so that grey becomes coloured; it may be transposed"
                        .to_owned(),
                ));
            }
            look.ccm = Some(ccm);
        }
        if let Some(reference) = reference {
            // Not light but a look: its values are compared with those that are shown.
            let (path, pixels) = reference.pixels()?;
            if pixels.planes.dim().0 != 3 {
                return Err(Error::format(path, "is grey; a reference picture has three channels"));
            }
            look.reference_means = Some(channel_means(&pixels.planes));
        }
        Ok(look)
    }
}

/// Finishes an image: integers of 8 or 16 bits, or floats.
#[pyfunction]
pub(crate) fn finish<'py>(
    py: Python<'py>,
    image: Source<'_>,
    info: Option<&str>,
    reference: Option<Source<'_>>,
    settings: FinishSettings,
) -> PyResult<(Bound<'py, PyAny>, Notices)> {
    settings.check(reference.is_some()).map_err(|error| to_python(&error))?;
    let image = image.own(info)?;
    let reference = reference.map(|reference| reference.own(None)).transpose()?;
    let (planes, notices) = run(py, |_| {
        let mut notices = Notices::new();
        let style = settings.style()?;
        let told = ToneFlags { alpha: settings.alpha, x_max: settings.x_max };
        let tone = told.over(ToneCurve::default())?;
        let (image, said) = image.image(domain("domain", settings.domain.as_deref())?, told, &mut notices)?;
        let look = settings.look(said.unwrap_or_default(), reference, &mut notices)?;
        let x_max = image.curve().unwrap_or(tone).x_max;
        let image = image.into_linear(tone);
        let config = style.config_of(&image, &look, settings.bits == 8, x_max);
        if let Curve::Photographic { grey, white } = config.curve {
            notices.push(("debug", format!("middle grey at light {grey:.4}, white at {white:.4}")));
        }
        Ok((finish_light(image, &look, &config)?, notices))
    })?;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "rounded within the range of the type"
    )]
    let array = match settings.bits {
        8 => to_array(py, rounded(&planes, f32::from(u8::MAX), |value| value as u8))?.into_any(),
        16 => to_array(py, rounded(&planes, f32::from(u16::MAX), |value| value as u16))?.into_any(),
        _ => to_array(py, planes)?.into_any(),
    };
    Ok((array, notices))
}

/// Display values as integers, as files hold them.
fn rounded<T>(planes: &Array3<f32>, most: f32, to: impl Fn(f32) -> T) -> Array3<T> {
    planes.map(|value| to((value.clamp(0.0, 1.0) * most).round()))
}
