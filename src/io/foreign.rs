//! Recognises pictures of formats that are not read, cameras' raw files above all, to name what converts them.

use std::path::Path;

use super::directory::{Directory, PHOTOMETRIC, SUB_DIRECTORIES};
use super::dng::{CFA, is_dng};

/// A camera's raw format.
struct Raw {
    /// Who calls it what.
    name: &'static str,
    /// Its files' extensions.
    extensions: &'static [&'static str],
    /// How they start: bytes from a place on. None for those that are TIFF files as others are.
    signature: Option<(usize, &'static [u8])>,
}

const fn raw(
    name: &'static str,
    extensions: &'static [&'static str],
    signature: Option<(usize, &'static [u8])>,
) -> Raw {
    Raw { name, extensions, signature }
}

const RAWS: [Raw; 17] = [
    raw("Canon CR3", &["cr3"], Some((4, b"ftypcrx "))),
    raw("Canon CR2", &["cr2"], Some((8, b"CR\x02"))),
    raw("Canon CRW", &["crw"], Some((6, b"HEAPCCDR"))),
    raw("Fujifilm RAF", &["raf"], Some((0, b"FUJIFILMCCD-RAW"))),
    raw("Olympus ORF", &["orf"], Some((0, b"IIRO"))),
    raw("Olympus ORF", &["orf"], Some((0, b"IIRS"))),
    raw("Olympus ORF", &["orf"], Some((0, b"MMOR"))),
    raw("Panasonic RW2", &["rw2", "rwl"], Some((0, b"IIU\0"))),
    raw("Minolta MRW", &["mrw"], Some((0, b"\0MRM"))),
    raw("Sigma X3F", &["x3f"], Some((0, b"FOVb"))),
    raw("Nikon NEF", &["nef", "nrw"], None),
    raw("Sony ARW", &["arw", "sr2", "srf"], None),
    raw("Pentax PEF", &["pef"], None),
    raw("Samsung SRW", &["srw"], None),
    raw("Hasselblad 3FR", &["3fr", "fff"], None),
    raw("Phase One IIQ", &["iiq"], None),
    raw("Kodak or Epson raw", &["dcr", "kdc", "erf", "mef", "mos"], None),
];

/// Other pictures: the name, how they start, and a command that converts one to a format that is read.
const OTHERS: [(&str, usize, &[u8], &str); 15] = [
    ("HEIC", 4, b"ftypheic", HEIF),
    ("HEIC", 4, b"ftypheix", HEIF),
    ("HEIC", 4, b"ftypheim", HEIF),
    ("HEIC", 4, b"ftyphevc", HEIF),
    ("HEIF", 4, b"ftypmif1", HEIF),
    ("HEIF", 4, b"ftypmsf1", HEIF),
    ("AVIF", 4, b"ftypavif", "`avifdec in.avif out.png` (libavif)"),
    ("JPEG XL", 0, b"\xff\x0a", JXL),
    ("JPEG XL", 4, b"JXL \r\n\x87\n", JXL),
    ("JPEG 2000", 4, b"jP  \r\n\x87\n", "`opj_decompress -i in.jp2 -o out.png` (OpenJPEG)"),
    ("WebP", 8, b"WEBP", "`dwebp in.webp -o out.png` (libwebp)"),
    ("Photoshop", 0, b"8BPS", "its own export as 16-bit TIFF, or `magick in.psd[0] out.tif` (ImageMagick)"),
    ("GIF", 0, b"GIF8", "`magick in.gif out.png` (ImageMagick)"),
    ("BMP", 0, b"BM", "`magick in.bmp out.png` (ImageMagick)"),
    ("PDF", 0, b"%PDF-", "`pdftoppm -png in.pdf out` (Poppler)"),
];

const HEIF: &str = "`heif-convert in.heic out.png` (libheif), or `sips -s format png in.heic --out out.png` on macOS; \
                    the camera's DNG holds more light";
const JXL: &str = "`djxl in.jxl out.png` (libjxl)";

/// What to do with a file that starts so and is of no format that is read; none of other files.
pub(super) fn foreign(path: &Path, start: &[u8]) -> Option<String> {
    let begins = |(place, signature): (usize, &[u8])| {
        start.get(place..).is_some_and(|start| start.starts_with(signature))
    };
    if let Some(raw) = RAWS.iter().find(|raw| raw.signature.is_some_and(begins)) {
        return Some(convert_raw(path, raw.name));
    }
    let (name, .., converter) =
        OTHERS.iter().find(|(_, place, signature, _)| begins((*place, *signature)))?;
    Some(format!("is a {name} file, which is not read; convert it first, for example by {converter}"))
}

/// What to do with a TIFF file that is a camera's raw one, but no DNG: read as a picture it would be a preview.
pub(super) fn foreign_tiff(path: &Path, bytes: &[u8]) -> Option<String> {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let is_of = |raw: &&Raw| raw.extensions.iter().any(|known| extension.eq_ignore_ascii_case(known));
    let root = Directory::first(bytes)?;
    if root.has_dng_version() {
        return None;
    }
    let name = match RAWS.iter().find(is_of) {
        Some(raw) => raw.name,
        None if is_dng(bytes) => return None,
        None => {
            let holds_mosaic = |inner: Directory<'_>| inner.number(PHOTOMETRIC) == Some(CFA);
            root.inner(SUB_DIRECTORIES).any(holds_mosaic).then_some("camera's raw")?
        }
    };
    Some(convert_raw(path, name))
}

fn convert_raw(path: &Path, name: &str) -> String {
    let name_of = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (from, to) = (name_of(path), name_of(&path.with_extension("dng")));
    format!(
        "is a {name} file, and of raw files DNG alone is read; convert it by `dnglab convert {from} {to}` or Adobe DNG \
         Converter"
    )
}

/// The extensions of cameras' raw files that are not read.
pub(super) fn is_foreign_raw(extension: &str) -> bool {
    RAWS.iter().flat_map(|raw| raw.extensions).any(|known| extension.eq_ignore_ascii_case(known))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_files_and_pictures_of_other_formats_are_told_what_converts_them() {
        let said = |name: &str, start: &[u8]| foreign(Path::new(name), start).unwrap_or_default();
        let canon = said("photos/IMG_1.CR3", b"\0\0\0\x18ftypcrx \0\0\0\x01");
        assert!(
            canon.contains("Canon CR3") && canon.contains("`dnglab convert IMG_1.CR3 IMG_1.dng`"),
            "{canon}"
        );
        assert!(said("a.raf", b"FUJIFILMCCD-RAW 0201").contains("Fujifilm RAF"));
        assert!(said("a.rw2", b"IIU\0\x18\0\0\0").contains("Panasonic RW2"));
        assert!(said("a.orf", b"IIRO\x08\0\0\0").contains("Olympus ORF"));
        assert!(said("a.cr2", b"II*\0\x10\0\0\0CR\x02\0").contains("Canon CR2"));
        assert!(said("a.heic", b"\0\0\0\x18ftypheic").contains("heif-convert"));
        assert!(said("a.jpg", b"RIFF\x10\0\0\0WEBPVP8 ").contains("dwebp"));
        for known in [&b"II*\0\x08\0\0\0"[..], b"\xff\xd8\xff\xe0", b"\x89PNG\r\n\x1a\n", b"", b"MM\0*"] {
            assert_eq!(foreign(Path::new("a.tif"), known), None);
        }
    }
}
