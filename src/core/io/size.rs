//! Finds the size of an image from the start of its file.

use std::path::Path;

use super::format::Format;
use super::plain::read_head;
use super::{DomainTag, HEAD_BYTES, exr, image_of, npy, raster, read_pixels};
use crate::core::error::{Error, Result};
use crate::core::image::Domain;

/// Finds the height and width of the image that [`read_image`](super::read_image) would read.
///
/// The file's header says it, but for TIFF, whose header may be anywhere: such a file, and one whose header is not
/// understood, is read as a whole.
///
/// # Errors
/// As [`read_image`](super::read_image), as far as the header shows it.
pub fn read_image_size<D: Domain>(path: &Path) -> Result<[usize; 2]> {
    let head = read_head(path, HEAD_BYTES)?;
    let found = match Format::of_contents(&head) {
        Some(Format::Exr) => {
            let file = path.metadata().map_err(|source| Error::io("read", path, source))?;
            let fits = |domain: Option<DomainTag>| domain.is_none_or(|tag| tag.name() == D::NAME);
            exr::size_of_head(path, &head, file.len()).and_then(|(size, domain)| fits(domain).then_some(size))
        }
        Some(Format::Npy) => npy::size_of_head(&head),
        Some(format @ (Format::Png | Format::Jpeg | Format::Hdr)) => raster::size_of_head(&head, format),
        Some(Format::Tiff) | None => None,
    };
    match found {
        Some(size) => Ok(size),
        None => image_of::<D>(path, read_pixels(path)?).map(|image| [image.height(), image.width()]),
    }
}
