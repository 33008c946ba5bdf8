//! Tells images that were written to their end from what a full disk or a crash left of them, without reading their pixels.

mod radiance;

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::exr::{BlockTable, block_table_of_head};
use super::format::Format;
use super::{HEAD_BYTES, npy, tiff};
use crate::core::error::{Error, Result};

/// Enough for most headers; where it is not, as much is read as for any.
const USUAL_HEAD_BYTES: u64 = 1 << 13;

/// How a PNG ends: an empty chunk IEND with its checksum.
const END_OF_PNG: [u8; 12] = [0, 0, 0, 0, b'I', b'E', b'N', b'D', 0xae, 0x42, 0x60, 0x82];

/// How a JPEG ends: the marker EOI.
const END_OF_JPEG: [u8; 2] = [0xff, 0xd9];

/// Whether an image file, of the format that its name says, goes on to its end: it is not empty, and NumPy arrays are as long
/// as their headers say, OpenEXR files reach to the end of their last block, TIFF files hold all strips or tiles, Radiance files
/// all scan lines, PNG and JPEG end as such files do. What is no file, such as a pipe, is taken for whole.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read.
pub fn is_whole(path: &Path) -> Result<bool> {
    let look = || -> io::Result<bool> {
        let mut file = File::open(path)?;
        let metadata = file.metadata()?;
        if !metadata.is_file() {
            return Ok(true);
        }
        match (metadata.len(), Format::known_extension(path)) {
            (0, _) => Ok(false),
            (length, Some(Format::Npy)) => is_whole_npy(&mut file, length),
            (length, Some(Format::Exr)) => is_whole_exr(&mut file, length),
            (length, Some(Format::Png)) => ends_with(&mut file, length, &END_OF_PNG),
            (length, Some(Format::Jpeg)) => ends_with(&mut file, length, &END_OF_JPEG),
            (length, Some(Format::Tiff)) => tiff::is_whole(BufReader::new(file), length),
            (_, Some(Format::Hdr)) => radiance::is_whole(BufReader::new(file)),
            (_, None) => Ok(true),
        }
    };
    look().map_err(|source| Error::io("read", path, source))
}

fn is_whole_npy(file: &mut File, length: u64) -> io::Result<bool> {
    let whole = with_head(file, npy::length_of_head)?;
    Ok(whole.is_some_and(|whole| whole <= length))
}

fn is_whole_exr(file: &mut File, length: u64) -> io::Result<bool> {
    let Some(BlockTable { start, blocks, before_length }) = with_head(file, block_table_of_head)? else {
        // Of a header that is longer than any of ours nothing is known.
        return Ok(length > HEAD_BYTES);
    };
    let table_bytes = blocks as u64 * size_of::<u64>() as u64;
    let mut table = Vec::new();
    file.seek(SeekFrom::Start(start))?;
    file.by_ref().take(table_bytes).read_to_end(&mut table)?;
    let places = table.as_chunks::<8>().0;
    let last = places.iter().map(|place| u64::from_le_bytes(*place)).max().unwrap_or(0);
    if places.len() < blocks || places.contains(&[0; 8]) || last >= length {
        return Ok(false);
    }
    let Some(before) = before_length else { return Ok(true) };
    let mut block_length = Vec::new();
    file.seek(SeekFrom::Start(last + before))?;
    file.by_ref().take(size_of::<u32>() as u64).read_to_end(&mut block_length)?;
    let block_length = block_length.first_chunk().map(|bytes| u64::from(u32::from_le_bytes(*bytes)));
    Ok(block_length.is_some_and(|bytes| last + before + size_of::<u32>() as u64 + bytes <= length))
}

fn ends_with(file: &mut File, length: u64, end: &[u8]) -> io::Result<bool> {
    let mut found = Vec::new();
    file.seek(SeekFrom::Start(length.saturating_sub(end.len() as u64)))?;
    file.read_to_end(&mut found)?;
    Ok(found == end)
}

/// What `find` finds in the beginning of a file, of which more is read where little does not suffice.
fn with_head<T>(file: &mut File, find: impl Fn(&[u8]) -> Option<T>) -> io::Result<Option<T>> {
    let mut head = Vec::new();
    for bytes in [USUAL_HEAD_BYTES, HEAD_BYTES - USUAL_HEAD_BYTES] {
        file.by_ref().take(bytes).read_to_end(&mut head)?;
        if let Some(found) = find(&head) {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use ndarray::Array3;

    use super::*;
    use crate::core::image::LinearImage;
    use crate::core::provenance::Provenance;
    use crate::io::{PixelOptions, Pixels, WriteOptions, write_image, write_pixels};

    /// With an origin that is longer than what is read of most files.
    fn write_light(path: &Path, origin: &str) {
        let planes = Array3::from_shape_fn((3, 70, 20), |(c, y, x)| ((c * 13 + y * 7 + x) % 17) as f32);
        let provenance = Some(Provenance::new("scenes", &origin));
        let options = WriteOptions { provenance, ..WriteOptions::default() };
        write_image(path, &LinearImage::from_planes(planes).unwrap(), &options).unwrap();
    }

    #[test]
    fn what_lacks_its_end_is_not_whole() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["a.exr", "b.exr", "a.npy", "a.hdr", "a.png", "a.jpg", "a.tif"];
        let files = names.map(|name| folder.path().join(name));
        write_light(&files[0], "short");
        write_light(&files[1], &"long".repeat(5000));
        write_light(&files[2], "");
        write_light(&files[3], "");
        for file in &files[4..] {
            let planes = Array3::from_shape_fn((3, 40, 30), |(_, y, x)| ((y * x) % 9) as f32 / 9.0);
            write_pixels(file, &Pixels::of_planes(planes), PixelOptions::default()).unwrap();
        }
        for file in &files {
            let bytes = fs::read(file).unwrap();
            assert!(is_whole(file).unwrap(), "{}", file.display());
            for kept in [bytes.len() - 1, bytes.len() / 2, 40, 3, 0] {
                fs::write(file, &bytes[..kept]).unwrap();
                assert!(!is_whole(file).unwrap(), "{kept} bytes of {}", file.display());
            }
        }
        let other = folder.path().join("a.txt");
        fs::write(&other, "").unwrap();
        assert!(!is_whole(&other).unwrap());
        fs::write(&other, "II").unwrap();
        assert!(is_whole(&other).unwrap() && is_whole(folder.path()).unwrap());
    }
}
