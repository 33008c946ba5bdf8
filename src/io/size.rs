//! Finds the size of an image from the start of its file.

use std::path::Path;

use super::archive;
use super::format::Format;
use super::layer::locate;
use super::plain::read_head;
use super::{DomainTag, HEAD_BYTES, exr, inspect_any_image, npy, raster, read_image_told};
use crate::core::error::{Error, Result};
use crate::core::image::Domain;
use crate::core::tone::ToneFlags;

/// Finds the height and width of the image that [`read_image_told`] would read.
///
/// The file's header says it, but for TIFF, whose header may be anywhere: such a file, one whose header is not understood,
/// and one of integers of which nobody has `told` what they are, is read as a whole.
///
/// # Errors
/// As [`read_image_told`], as far as the header shows it.
pub fn read_image_size<D: Domain>(path: &Path, told: Option<DomainTag>) -> Result<[usize; 2]> {
    let fits = |domain: Option<DomainTag>| match told {
        Some(told) => domain.is_none() && told.name() == D::NAME || domain == Some(told),
        None => domain.is_none_or(|tag| tag.name() == D::NAME),
    };
    match size_of_head(path, told, fits)? {
        Some(size) => Ok(size),
        None => read_image_told::<D>(path, told).map(|(image, _)| [image.height(), image.width()]),
    }
}

/// As [`read_image_size`], of the image that [`inspect_any_image`] would read: light in either domain.
///
/// # Errors
/// As [`inspect_any_image`], as far as the header shows it.
pub fn read_any_image_size(path: &Path, told: Option<DomainTag>) -> Result<[usize; 2]> {
    let is_light = |tag| matches!(tag, DomainTag::Linear | DomainTag::ToneMapped);
    let fits = |domain: Option<DomainTag>| match told {
        Some(told) => is_light(told) && domain.is_none_or(|tag| tag == told),
        None => domain.is_none_or(is_light),
    };
    match size_of_head(path, told, fits)? {
        Some(size) => Ok(size),
        None => inspect_any_image(path, told, ToneFlags::default()).map(|reading| reading.image.size()),
    }
}

/// The size that a header says of an image that is known to be one of the domain that is asked for.
fn size_of_head(
    path: &Path,
    told: Option<DomainTag>,
    fits: impl Fn(Option<DomainTag>) -> bool,
) -> Result<Option<[usize; 2]>> {
    let head = read_head(path, HEAD_BYTES)?;
    Ok(match Format::of_contents(&head) {
        Some(Format::Exr) => {
            let file = archive::open(locate(path).0).map_err(|source| Error::io("read", path, source))?;
            exr::size_of_head(path, &head, file.len()).and_then(|(size, domain)| fits(domain).then_some(size))
        }
        Some(Format::Npy) => npy::size_of_head(&head)
            .and_then(|(size, is_integer)| (told.is_some() || !is_integer).then_some(size)),
        Some(format @ Format::Hdr) => raster::size_of_head(&head, format),
        Some(format @ (Format::Png | Format::Jpeg)) if told.is_some() => raster::size_of_head(&head, format),
        Some(Format::Png | Format::Jpeg | Format::Tiff) | None => None,
    })
}
