//! Recognises image formats: by their first bytes when reading, by the extension when writing.

use std::io::Read;
use std::path::Path;

use super::archive;
use super::foreign::{foreign, foreign_tiff};
use super::layer::locate;
use crate::core::error::{Error, Result};

/// The image file formats that are read and written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR.
    Exr,
    /// NumPy array.
    Npy,
    /// Portable network graphics.
    Png,
    /// JPEG.
    Jpeg,
    /// TIFF.
    Tiff,
    /// Radiance RGBE.
    Hdr,
}

/// How an image file stores its samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoding {
    /// The file's format.
    pub format: Format,
    /// The stored type: `float`, `half`, `uint16`, ….
    pub sample_type: String,
}

/// The extensions of files that are taken for images in folders.
pub(super) const EXTENSIONS: [(&str, Format); 8] = [
    ("exr", Format::Exr),
    ("npy", Format::Npy),
    ("png", Format::Png),
    ("jpg", Format::Jpeg),
    ("jpeg", Format::Jpeg),
    ("tif", Format::Tiff),
    ("tiff", Format::Tiff),
    ("hdr", Format::Hdr),
];

impl Format {
    /// The format's usual name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exr => "OpenEXR",
            Self::Npy => "NumPy",
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::Tiff => "TIFF",
            Self::Hdr => "Radiance HDR",
        }
    }

    /// Whether samples are floats, and light far above white is kept.
    pub fn holds_light(self) -> bool {
        matches!(self, Self::Exr | Self::Npy | Self::Hdr)
    }

    /// The format that a path's extension stands for.
    ///
    /// # Errors
    /// [`Error::Format`] naming the extensions that are known.
    pub fn of_extension(path: &Path) -> Result<Self> {
        Self::known_extension(path).ok_or_else(|| {
            Error::format(path, "the name must end in .exr, .npy, .hdr, .png, .tif or .jpg to say the format")
        })
    }

    /// Whether a path's extension is an image's.
    pub(super) fn known_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        EXTENSIONS.iter().find(|(name, _)| *name == extension).map(|(_, format)| *format)
    }

    /// The format of a file by its first bytes.
    pub(super) fn of_contents(start: &[u8]) -> Option<Self> {
        const SIGNATURES: [(&[u8], Format); 9] = [
            (&[0x76, 0x2f, 0x31, 0x01], Format::Exr),
            (b"\x93NUMPY", Format::Npy),
            (b"\x89PNG\r\n\x1a\n", Format::Png),
            (&[0xff, 0xd8, 0xff], Format::Jpeg),
            (b"II*\0", Format::Tiff),
            (b"MM\0*", Format::Tiff),
            // BigTIFF, of positions of 64 bits.
            (b"II+\0", Format::Tiff),
            (b"MM\0+", Format::Tiff),
            (b"#?", Format::Hdr),
        ];
        SIGNATURES.iter().find(|(signature, _)| start.starts_with(signature)).map(|(_, format)| *format)
    }
}

/// Bytes that tell what a file is.
const START_BYTES: u64 = 32;

/// Reads a whole image file, and nothing of a file that is none.
pub(super) fn read_recognised(path: &Path) -> Result<(Format, Vec<u8>)> {
    let read_error = |source| Error::io("read", path, source);
    if path.is_dir() {
        return Err(Error::format(path, "is a folder where an image file is needed"));
    }
    let mut file = archive::open(locate(path).0).map_err(read_error)?;
    let mut bytes = Vec::new();
    file.by_ref().take(START_BYTES).read_to_end(&mut bytes).map_err(read_error)?;
    if let Some(reason) = foreign(path, &bytes) {
        return Err(Error::format(path, reason));
    }
    let Some(format) = Format::of_contents(&bytes) else {
        let reason = if bytes.is_empty() { "the file is empty" } else { "the contents are not an image" };
        return Err(Error::format(path, format!("{reason}; expected EXR, NPY, HDR, PNG, TIFF or JPEG")));
    };
    // What does not fit is refused when it is read.
    let left = usize::try_from(file.len()).unwrap_or(usize::MAX).saturating_sub(bytes.len());
    let _ = bytes.try_reserve_exact(left);
    file.read_to_end(&mut bytes).map_err(read_error)?;
    match foreign_tiff(path, &bytes).filter(|_| format == Format::Tiff) {
        Some(reason) => Err(Error::format(path, reason)),
        None => Ok((format, bytes)),
    }
}

/// Refuses a file to write whose name does not end as its only format does.
///
/// # Errors
/// [`Error::Unsupported`] with the name that it needs.
pub fn check_extension(path: &Path, extension: &str) -> Result<()> {
    if path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        return Ok(());
    }
    let reason = format!("{} is not written as {extension}; name it *.{extension}", path.display());
    Err(Error::Unsupported(reason))
}

/// Reads a whole file.
pub(super) fn read_all(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|source| Error::io("read", path, source))
}
