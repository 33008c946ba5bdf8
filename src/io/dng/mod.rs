//! Reads the raw image of a digital negative (DNG 1.7): the values of the photosites, and what the file says of them.
//!
//! The raw image lies in the first directory or in one inside of it, beside previews. Where it is stored as a grey or RGB
//! TIFF image is, but for what its samples are declared to be, it is decoded as such; where it is packed, or compressed
//! as lossless JPEG, by [`samples`]. Then it is made linear, cut to its active area, every photosite brought to the
//! same levels, and the shading of the lens corrected by [`opcodes`]. The picture stays as it lies on the sensor.

mod color;
mod gains;
mod levels;
mod lossless_jpeg;
mod opcodes;
mod reader;
mod samples;

use std::path::Path;

use ndarray::{Array3, s};

use super::directory::{
    BITS, COMPRESSION, Directory, GREY, PHOTOMETRIC, RGB, SAMPLES, SUB_DIRECTORIES, WIDTH,
};
use super::exif::Said;
use super::format::{Encoding, Format};
use super::pixels::doubt_of_shape;
use super::{Pixels, RawMetadata, raster};
use crate::core::bayer::BayerPattern;
use crate::core::capture::is_exposure;
use crate::core::error::{Error, Result};
use crate::core::orientation::Orientation;
use color::Fields;
use opcodes::Corrections;

const ORIENTATION: u16 = 274;
const CFA_REPEAT: u16 = 33421;
const CFA_PATTERN: u16 = 33422;
const EXPOSURE_TIME: u16 = 33434;
const ISO: u16 = 34855;
const EXIF: u16 = 34665;
const LINEARIZATION_TABLE: u16 = 50712;
const DEFAULT_SCALE: u16 = 50718;
const BASELINE_EXPOSURE: u16 = 50730;
const ACTIVE_AREA: u16 = 50829;

/// Values of [`PHOTOMETRIC`]: a mosaic, and its colours interpolated.
pub(super) const CFA: usize = 32803;
const LINEAR_RAW: usize = 34892;

/// Values of [`COMPRESSION`]: none, LZW, deflate by two names; lossy JPEG and JPEG XL.
const DECODED: [usize; 4] = [1, 5, 8, 32946];
const LOSSY: [usize; 2] = [34892, 52546];

/// Whether a TIFF file says that it is a digital negative, or holds a mosaic as one does.
pub(super) fn is_dng(bytes: &[u8]) -> bool {
    Directory::first(bytes)
        .is_some_and(|root| root.has_dng_version() || root.number(PHOTOMETRIC) == Some(CFA))
}

/// The raw image `[1, height, width]`, or `[3, height, width]` where the file holds it interpolated.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<(Pixels, Encoding)> {
    let damaged = |reason: String| Error::format(path, reason);
    let root = Directory::first(bytes).ok_or_else(|| damaged("is damaged: it has no directory".into()))?;
    let inner = root.inner(SUB_DIRECTORIES);
    let raw = raw_of(std::iter::once(Directory::first(bytes)).flatten().chain(inner).collect())
        .ok_or_else(|| damaged("is a DNG without a raw image; export it from the camera again".into()))?;
    check_encoding(&raw).map_err(damaged)?;
    let is_mosaic = raw.number(PHOTOMETRIC) == Some(CFA);
    let (mut planes, mut encoding) = if samples::are_known(&raw) {
        let planes = samples::decode(&raw).map_err(damaged)?.mapv(|value| f32::from(value) / WHOLE);
        (planes, Encoding { format: Format::Tiff, sample_type: "uint16".to_owned() })
    } else {
        let promoted = raw.promoted(if is_mosaic { GREY } else { RGB });
        let promoted =
            promoted.ok_or_else(|| damaged("is damaged: its raw directory is incomplete".into()))?;
        let (pixels, encoding) = raster::decode(path, &promoted, Format::Tiff, false)?;
        (pixels.planes, encoding)
    };
    if let Some(table) = raw.numbers(LINEARIZATION_TABLE) {
        linearise(&mut planes, &table, largest_value(&encoding).unwrap_or(1.0)).map_err(damaged)?;
        encoding.sample_type = "uint16".to_owned();
    }
    let mut planes = active_area(planes, &raw).map_err(damaged)?;
    let metadata = levels::levelled(&mut planes, &raw, largest_value(&encoding)).map_err(damaged)?;
    let bayer = if is_mosaic { pattern_of(&raw).map_err(damaged)? } else { None };
    let corrections = Corrections::of(&raw).map_err(damaged)?;
    corrections.apply(&mut planes, [metadata.black, metadata.white], bayer);
    let fields = Fields(&raw, &root);
    let color = fields.color();
    let white_balance = fields.gains(color.as_ref());
    let stops = |directory: &Directory<'_>| directory.reals(BASELINE_EXPOSURE)?.first().copied();
    let baseline_exposure_ev = stops(&raw).or_else(|| stops(&root)).filter(|stops| is_exposure(*stops));
    let in_exif =
        |tag| positive(&root, tag).or_else(|| root.inner(EXIF).find_map(|exif| positive(&exif, tag)));
    let scale = doubt_of_scale(&raw);
    let raw = Some(RawMetadata {
        bayer,
        white_balance,
        color,
        orientation: root.number(ORIENTATION).and_then(Orientation::from_exif).unwrap_or_default(),
        baseline_exposure_ev,
        corrections: corrections.applied,
        ignored: corrections.ignored,
        exif: Said::of(&root).exif,
        ..metadata
    });
    let (exposure_s, iso) = (in_exif(EXPOSURE_TIME), in_exif(ISO));
    let doubts = scale.into_iter().chain(fields.doubt_of_third_light()).collect();
    Ok((Pixels { exposure_s, iso, raw, doubts, ..Pixels::of_planes(planes) }, encoding))
}

/// What to tell of pixels that are to be made square by scales across and down.
fn doubt_of_scale(raw: &Directory<'_>) -> Option<String> {
    let [across, down] = raw.reals(DEFAULT_SCALE)?.try_into().ok()?;
    doubt_of_shape(across / down, "DefaultScale")
}

/// The widest raw image; a file may hold smaller versions of it.
fn raw_of(directories: Vec<Directory<'_>>) -> Option<Directory<'_>> {
    let is_raw = |directory: &Directory<'_>| {
        directory.number(PHOTOMETRIC).is_some_and(|kind| [CFA, LINEAR_RAW].contains(&kind))
    };
    directories.into_iter().filter(is_raw).max_by_key(|directory| directory.number(WIDTH))
}

fn check_encoding(raw: &Directory<'_>) -> Result<(), String> {
    let compression = raw.number(COMPRESSION).unwrap_or(1);
    let samples = raw.number(SAMPLES).unwrap_or(1);
    let needed = if raw.number(PHOTOMETRIC) == Some(CFA) { 1 } else { 3 };
    if samples != needed {
        return Err(format!(
            "is a DNG of {samples} samples a pixel, where {needed} are read; write it as a mosaic"
        ));
    }
    if LOSSY.contains(&compression) {
        return Err("is a DNG compressed as lossy JPEG or JPEG XL, which is not read; convert it to an uncompressed DNG \
                    (in Adobe DNG Converter: compatibility custom, uncompressed)"
            .into());
    }
    if samples::are_known(raw) {
        return Ok(());
    }
    if !DECODED.contains(&compression) {
        return Err(format!(
            "is a DNG of compression {compression}, which is not read; write it uncompressed"
        ));
    }
    if let Some(bits) = raw.number(BITS).filter(|bits| ![8, 16, 32].contains(bits)) {
        return Err(format!("is a DNG of {bits} bits a sample, which is not read; write it with 16"));
    }
    Ok(())
}

/// Replaces integers by their entries in a table, the last one for those behind it.
fn linearise(planes: &mut Array3<f32>, table: &[usize], largest: f64) -> Result<(), String> {
    let entry = |&value: &usize| u16::try_from(value).ok().map(|value| f32::from(value) / WHOLE);
    let table = table.iter().map(entry).collect::<Option<Vec<_>>>();
    let Some((table, last)) = table.as_ref().and_then(|table| Some((table, table.last()?))) else {
        return Err("is damaged: its linearisation table is not of 16 bits".to_owned());
    };
    planes.mapv_inplace(|value| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an integer of 16 bits")]
        let index = (f64::from(value) * largest).round() as usize;
        *table.get(index).unwrap_or(last)
    });
    Ok(())
}

/// The number that integers of 16 bits are divided by.
const WHOLE: f32 = u16::MAX as f32;

/// What integers were divided by; none for floats.
fn largest_value(encoding: &Encoding) -> Option<f64> {
    match encoding.sample_type.as_str() {
        "uint8" => Some(f64::from(u8::MAX)),
        "uint16" => Some(f64::from(WHOLE)),
        _ => None,
    }
}

/// Cuts away the masked photosites at the borders.
fn active_area(planes: Array3<f32>, raw: &Directory<'_>) -> Result<Array3<f32>, String> {
    let Some(area) = raw.numbers(ACTIVE_AREA) else { return Ok(planes) };
    let (_, height, width) = planes.dim();
    match area[..] {
        [top, left, bottom, right] if top < bottom && bottom <= height && left < right && right <= width => {
            Ok(planes.slice(s![.., top..bottom, left..right]).to_owned())
        }
        _ => Err(format!("is damaged: its active area {area:?} lies outside of {height} × {width}")),
    }
}

/// The colours of the first two rows; none where the file does not say them.
fn pattern_of(raw: &Directory<'_>) -> Result<Option<BayerPattern>, String> {
    let Some(sites) = raw.numbers(CFA_PATTERN) else { return Ok(None) };
    let repeats = raw.numbers(CFA_REPEAT).is_none_or(|repeat| repeat == [2, 2]);
    let pattern = <[usize; 4]>::try_from(sites).ok().filter(|_| repeats).and_then(BayerPattern::of_sites);
    let reason = "is a DNG whose mosaic is no Bayer pattern; it cannot be demosaiced here";
    pattern.map(Some).ok_or_else(|| reason.to_owned())
}

/// The first number of a field, where it is positive.
fn positive(directory: &Directory<'_>, tag: u16) -> Option<f64> {
    let value = *directory.reals(tag)?.first()?;
    (value.is_finite() && value > 0.0).then_some(value)
}
