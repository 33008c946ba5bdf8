//! Reads and writes image files.

use std::path::PathBuf;

use numpy::PyArray3;
use pyo3::prelude::*;

use udc::core::capture::CaptureInfo;
use udc::core::image::{Linear, ToneMapped};
use udc::core::primaries::{ColorSpace, Primaries};
use udc::core::tone::ToneFlags;
use udc::io::{
    DomainTag, PixelOptions, Pixels, PsfOptions, WriteOptions, image_of, inspect_psf, write_image,
    write_pixels,
};
use udc::restore::Notice;

use crate::error::to_python;
use crate::source::{Given, Notices, Source, choice, domain, light_domain, planes_of, to_array, told};
use crate::work::run;

/// An image, its domain, what is known of its capture, and what there is to tell.
type Read<'py> = (Bound<'py, PyArray3<f32>>, &'static str, Option<String>, Notices);

/// Reads an image; a camera's raw file is developed to linear light.
#[pyfunction]
pub(crate) fn read_image<'py>(
    py: Python<'py>,
    path: PathBuf,
    domain_told: Option<&str>,
) -> PyResult<Read<'py>> {
    let domain = domain("domain", domain_told).map_err(|error| to_python(&error))?;
    let (capture, notices) = run(py, |progress| {
        let mut notices = Notices::new();
        Ok((Given::File(path).capture((domain, ToneFlags::default()), progress, &mut notices)?, notices))
    })?;
    let (planes, domain) = planes_of(capture.image);
    Ok((to_array(py, planes)?, domain, capture.info.map(|info| info.to_json()), notices))
}

/// Reads a PSF, non-negative and of unit sum.
#[pyfunction]
pub(crate) fn read_psf<'py>(
    py: Python<'py>,
    path: PathBuf,
    domain_told: Option<&str>,
    recenter: bool,
) -> PyResult<(Bound<'py, PyArray3<f32>>, Notices)> {
    let domain = light_domain("domain", domain_told).map_err(|error| to_python(&error))?;
    let options = PsfOptions { domain, recenter, ..PsfOptions::default() };
    let (planes, notices) = run(py, |_| {
        let reading = inspect_psf(&path, options)?;
        Ok((reading.psf.planes().to_owned(), Notice::of_psf(&reading).iter().map(told).collect()))
    })?;
    Ok((to_array(py, planes)?, notices))
}

/// How an image is written.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct WriteSettings {
    domain: String,
    half: bool,
    overwrite: bool,
    eight_bit: bool,
    color_space: String,
    info: Option<String>,
}

/// Writes an image in the format of the path's extension.
#[pyfunction]
pub(crate) fn write_image_file(
    py: Python<'_>,
    path: PathBuf,
    image: Source<'_>,
    settings: WriteSettings,
) -> PyResult<()> {
    let choices = [DomainTag::Linear, DomainTag::ToneMapped, DomainTag::Display].map(|tag| (tag.name(), tag));
    let domain = choice("domain", &settings.domain, &choices).map_err(|error| to_python(&error))?;
    let given = image.own(settings.info.as_deref())?;
    let spaces = [("srgb", ColorSpace::Srgb), ("display-p3", ColorSpace::DisplayP3)];
    let space = choice("color_space", &settings.color_space, &spaces).map_err(|error| to_python(&error))?;
    let WriteSettings { half, overwrite, eight_bit, .. } = settings;
    run(py, |_| {
        let (name, mut pixels) = given.pixels()?;
        let capture: Option<CaptureInfo> = pixels.capture.take();
        let options = WriteOptions { half, overwrite, capture, ..WriteOptions::default() };
        // The caller says the domain of integers too.
        let pixels = Pixels { domain: Some(domain), ..pixels };
        match domain {
            DomainTag::ToneMapped => write_image(&path, &image_of::<ToneMapped>(&name, pixels)?, &options),
            DomainTag::Display => {
                let primaries = Some(space.primaries()).filter(|found| *found != Primaries::SRGB);
                let info = CaptureInfo {
                    exif: options.capture.and_then(|info| info.exif),
                    primaries,
                    ..CaptureInfo::default()
                };
                let capture = (info != CaptureInfo::default()).then_some(info);
                let pixels = Pixels { capture, ..pixels };
                let color_space = Some(space);
                let options = PixelOptions {
                    half,
                    overwrite,
                    clip: true,
                    eight_bit,
                    color_space,
                    ..PixelOptions::default()
                };
                write_pixels(&path, &pixels, options)
            }
            DomainTag::Linear | DomainTag::Srgb => {
                write_image(&path, &image_of::<Linear>(&name, pixels)?, &options)
            }
        }
    })
}
