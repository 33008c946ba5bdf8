//! What Python hands over and is handed back: images as arrays or files, choices as words.

use std::path::{Path, PathBuf};

use ndarray::{Array3, Array4};
use numpy::{PyArray3, PyArray4, PyArrayMethods as _, PyReadonlyArray3, ToPyArray as _};
use pyo3::prelude::*;

use udc::capture::Told;
use udc::core::capture::CaptureInfo;
use udc::core::error::{Error, Result};
use udc::core::progress::Progress;
use udc::core::tone::ToneFlags;
use udc::io::{AnyImage, DomainTag, ImageReading, Pixels, any_image_of, read_pixels};
use udc::restore::{Capture, Notice};

use crate::error::misuse;

/// An image: planes, whether they were integers, and what it is called in messages; or a file.
#[derive(FromPyObject)]
pub(crate) enum Source<'py> {
    Planes(PyReadonlyArray3<'py, f32>, bool, String),
    File(PathBuf),
}

/// The same in memory of its own, so that Python may go on.
pub(crate) enum Given {
    Pixels(PathBuf, Box<Pixels>),
    File(PathBuf),
}

/// What there is to tell: how much it matters, and the text.
pub(crate) type Notices = Vec<(&'static str, String)>;

impl Source<'_> {
    /// Copies an array, once; `info` is what is known of its capture.
    pub(crate) fn own(self, info: Option<&str>) -> PyResult<Given> {
        let info = info
            .map(CaptureInfo::from_json)
            .transpose()
            .map_err(|reason| misuse(&format!("info: {reason}")))?;
        Ok(match self {
            Self::File(path) => Given::File(path),
            Self::Planes(planes, is_integer, name) => {
                let planes = planes.as_array().as_standard_layout().into_owned();
                let pixels = Pixels { is_integer, capture: info, ..Pixels::of_planes(planes) };
                Given::Pixels(name.into(), Box::new(pixels))
            }
        })
    }
}

impl Given {
    /// The name in messages, and the pixels.
    pub(crate) fn pixels(self) -> Result<(PathBuf, Pixels)> {
        match self {
            Self::Pixels(name, pixels) => Ok((name, *pixels)),
            Self::File(path) => read_pixels(&path).map(|pixels| (path, pixels)),
        }
    }

    /// An image in a domain of light; `tone` is what the user says of its tone curve.
    pub(crate) fn image(
        self,
        told: Option<DomainTag>,
        tone: ToneFlags,
        notices: &mut Notices,
    ) -> Result<(AnyImage, Option<CaptureInfo>)> {
        let (path, pixels) = self.pixels()?;
        let darkness = pixels.describe_darkness(&path);
        let ImageReading { image, info, contradictions, .. } = any_image_of(&path, pixels, told, tone)?;
        notices.extend(darkness.into_iter().chain(contradictions).map(warning));
        Ok((image, info))
    }

    /// A capture, which may be a camera's raw file.
    pub(crate) fn capture(
        self,
        (told, tone): (Option<DomainTag>, ToneFlags),
        progress: &Progress,
        notices: &mut Notices,
    ) -> Result<Capture> {
        if let Self::File(path) = &self {
            let told = Told { domain: told, tone, ..Told::default() };
            let (capture, warnings) = Capture::open(path, &told, progress)?;
            notices.extend(warnings.into_iter().map(warning));
            return Ok(capture);
        }
        let (image, info) = self.image(told, tone, notices)?;
        Ok(Capture { image, info })
    }
}

/// What the user should look at.
pub(crate) fn warning(text: String) -> (&'static str, String) {
    ("warning", text)
}

/// What a stage has to tell.
pub(crate) fn told(notice: &Notice) -> (&'static str, String) {
    let level = match notice {
        Notice::Detail(_) => "debug",
        Notice::Note(_) => "info",
        Notice::Warning(_) => "warning",
    };
    (level, notice.to_string())
}

/// Planes `[3, H, W]` as an array `[H, W, 3]`, in the same memory.
pub(crate) fn to_array<T: numpy::Element>(
    py: Python<'_>,
    planes: Array3<T>,
) -> PyResult<Bound<'_, PyArray3<T>>> {
    PyArray3::from_owned_array(py, planes).permute(Some([1, 2, 0]))
}

/// Planes `[K, 3, H, W]` as an array `[K, H, W, 3]`, in the same memory.
pub(crate) fn to_arrays(py: Python<'_>, planes: Array4<f32>) -> PyResult<Bound<'_, PyArray4<f32>>> {
    PyArray4::from_owned_array(py, planes).permute(Some([0, 2, 3, 1]))
}

/// Numbers of any shape, copied.
pub(crate) fn to_numbers<'py, D: ndarray::Dimension>(
    py: Python<'py>,
    numbers: &ndarray::Array<f32, D>,
) -> Bound<'py, numpy::PyArray<f32, D>> {
    numbers.to_pyarray(py)
}

/// The planes of an image of either domain, and the name of the domain.
pub(crate) fn planes_of(image: AnyImage) -> (Array3<f32>, &'static str) {
    let domain = image.domain().name();
    let planes = match image {
        AnyImage::Linear(image) => image.into_planes(),
        AnyImage::ToneMapped(image, _) => image.into_planes(),
    };
    (planes, domain)
}

/// What a file is called in messages.
pub(crate) fn name_of(path: &Path) -> String {
    path.display().to_string()
}

/// The value of a word.
pub(crate) fn choice<T: Copy>(key: &str, word: &str, choices: &[(&str, T)]) -> Result<T> {
    let found = choices.iter().find(|(name, _)| *name == word).map(|(_, value)| *value);
    found.ok_or_else(|| {
        let names: Vec<_> = choices.iter().map(|(name, _)| *name).collect();
        Error::config(key, format!("must be one of {}, found {word:?}", names.join(", ")))
    })
}

/// What an image holds, where the user says it.
pub(crate) fn domain(key: &str, word: Option<&str>) -> Result<Option<DomainTag>> {
    let choices = [DomainTag::Linear, DomainTag::ToneMapped, DomainTag::Srgb].map(|tag| (tag.name(), tag));
    word.map(|word| choice(key, word, &choices)).transpose()
}

/// The same where linear light is needed.
pub(crate) fn light_domain(key: &str, word: Option<&str>) -> Result<Option<DomainTag>> {
    let choices = [DomainTag::Linear, DomainTag::Srgb].map(|tag| (tag.name(), tag));
    word.map(|word| choice(key, word, &choices)).transpose()
}
