//! Reads and writes NumPy's `.npy`: the header here, elements as `f32` planes or as plain arrays.
//!
//! The format: magic, version, header length, then a Python dictionary with `descr` (the element type),
//! `fortran_order` and `shape`, then the elements.

use std::path::Path;

use half::f16;
use ndarray::{Array3, ArrayD, ArrayView3, IxDyn, ShapeBuilder};

use super::format::{Encoding, Format};
use super::{MAX_PIXELS, Pixels, planes};
use crate::core::error::{Error, Result};

/// The longest header that is believed; NumPy's own are 128 bytes unless the type is a long structure.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// The element types that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Element {
    F16,
    F32,
    F64,
    U8,
    U16,
    U32,
    U64,
    I8,
    I16,
    I32,
    I64,
    Bool,
}

impl Element {
    /// The type and whether it is big-endian, of a `descr` such as `<f4`.
    fn parse(descr: &str) -> Option<(Self, bool)> {
        let mut chars = descr.chars();
        let big_endian = match chars.next()? {
            '<' | '|' => false,
            '=' => cfg!(target_endian = "big"),
            '>' => true,
            _ => return None,
        };
        let element = match chars.as_str() {
            "f2" => Self::F16,
            "f4" => Self::F32,
            "f8" => Self::F64,
            "u1" => Self::U8,
            "u2" => Self::U16,
            "u4" => Self::U32,
            "u8" => Self::U64,
            "i1" => Self::I8,
            "i2" => Self::I16,
            "i4" => Self::I32,
            "i8" => Self::I64,
            "b1" => Self::Bool,
            _ => return None,
        };
        Some((element, big_endian))
    }

    fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 | Self::Bool => 1,
            Self::F16 | Self::U16 | Self::I16 => 2,
            Self::F32 | Self::U32 | Self::I32 => 4,
            Self::F64 | Self::U64 | Self::I64 => 8,
        }
    }

    /// Whether an image of this type is scaled to `[0, 1]`.
    fn is_image_integer(self) -> bool {
        matches!(self, Self::U8 | Self::U16)
    }

    fn name(self) -> &'static str {
        match self {
            Self::F16 => "half",
            Self::F32 => "float",
            Self::F64 => "double",
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::U32 => "uint32",
            Self::U64 => "uint64",
            Self::I8 => "int8",
            Self::I16 => "int16",
            Self::I32 => "int32",
            Self::I64 => "int64",
            Self::Bool => "bool",
        }
    }
}

/// A parsed file whose elements are still bytes.
#[derive(Debug)]
pub(super) struct Npy<'a> {
    element: Element,
    big_endian: bool,
    fortran_order: bool,
    shape: Vec<usize>,
    data: &'a [u8],
}

impl<'a> Npy<'a> {
    /// Splits a file into its header and exactly the bytes of its elements.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let (text, data) = split_header(bytes)?;
        let descr = quoted(entry(text, "descr")?).ok_or("holds a structured array; a plain one is needed")?;
        let (element, big_endian) = Element::parse(descr).ok_or_else(|| {
            format!("holds elements of type '{descr}', which is not a number that is read here")
        })?;
        let fortran_order = match entry(text, "fortran_order")? {
            value if value.starts_with("True") => true,
            value if value.starts_with("False") => false,
            _ => return Err("the header's fortran_order is neither True nor False".into()),
        };
        let shape = parse_shape(entry(text, "shape")?)?;
        let needed = shape
            .iter()
            .try_fold(element.bytes(), |product, &side| product.checked_mul(side))
            .ok_or_else(|| format!("the header declares the impossible shape {shape:?}"))?;
        if data.len() < needed {
            let found = data.len();
            return Err(format!("is truncated: shape {shape:?} needs {needed} bytes, found {found}"));
        }
        Ok(Self { element, big_endian, fortran_order, shape, data: &data[..needed] })
    }

    /// The elements as numbers, unscaled, in the logical order of the shape.
    pub(super) fn into_array(self) -> Result<ArrayD<f64>, String> {
        let values = match self.element {
            Element::F16 => self.map(|b| f64::from(f16::from_le_bytes(b))),
            Element::F32 => self.map(|b| f64::from(f32::from_le_bytes(b))),
            Element::F64 => self.map(f64::from_le_bytes),
            Element::U8 | Element::Bool => self.map(|b| f64::from(u8::from_le_bytes(b))),
            Element::U16 => self.map(|b| f64::from(u16::from_le_bytes(b))),
            Element::U32 => self.map(|b| f64::from(u32::from_le_bytes(b))),
            Element::U64 => self.map(|b| u64::from_le_bytes(b) as f64),
            Element::I8 => self.map(|b| f64::from(i8::from_le_bytes(b))),
            Element::I16 => self.map(|b| f64::from(i16::from_le_bytes(b))),
            Element::I32 => self.map(|b| f64::from(i32::from_le_bytes(b))),
            Element::I64 => self.map(|b| i64::from_le_bytes(b) as f64),
        };
        let shape = IxDyn(&self.shape).set_f(self.fortran_order);
        ArrayD::from_shape_vec(shape, values).map_err(|error| error.to_string())
    }

    /// The elements as image planes: integers are divided by their type's maximum.
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit; what overflows is refused")]
    fn into_planes(self) -> Result<Array3<f32>, String> {
        let layout = Layout::of_shape(&self.shape, self.fortran_order)?;
        match self.element {
            Element::F16 => Ok(self.gather(&layout, |b| f32::from(f16::from_le_bytes(b)))),
            Element::F32 => Ok(self.gather(&layout, f32::from_le_bytes)),
            Element::F64 => {
                let planes = self.gather(&layout, |b| f64::from_le_bytes(b) as f32);
                let overflows = |value: &f64| value.is_finite() && (*value as f32).is_infinite();
                let is_infinite = planes.iter().any(|value| value.is_infinite());
                match is_infinite.then(|| self.map(f64::from_le_bytes).into_iter().find(overflows)).flatten()
                {
                    Some(value) => {
                        Err(format!("holds {value:e}, and images are of 32-bit floats, up to {:e}", f32::MAX))
                    }
                    None => Ok(planes),
                }
            }
            Element::U8 => Ok(self.gather(&layout, |b| f32::from(u8::from_le_bytes(b)) / f32::from(u8::MAX))),
            Element::U16 => {
                Ok(self.gather(&layout, |b| f32::from(u16::from_le_bytes(b)) / f32::from(u16::MAX)))
            }
            other => Err(format!("holds {} elements; images are f2, f4, f8, u1 or u2", other.name())),
        }
    }

    fn gather<const N: usize>(
        &self,
        layout: &Layout,
        convert: impl Fn([u8; N]) -> f32 + Sync,
    ) -> Array3<f32> {
        let (elements, _) = self.data.as_chunks::<N>();
        if self.big_endian {
            planes::gather(elements, layout.strides, layout.shape, |bytes| convert(swapped(bytes)))
        } else {
            planes::gather(elements, layout.strides, layout.shape, convert)
        }
    }

    fn map<T, const N: usize>(&self, convert: impl Fn([u8; N]) -> T) -> Vec<T> {
        let (elements, _) = self.data.as_chunks::<N>();
        if self.big_endian {
            elements.iter().map(|&bytes| convert(swapped(bytes))).collect()
        } else {
            elements.iter().map(|&bytes| convert(bytes)).collect()
        }
    }
}

fn swapped<const N: usize>(mut bytes: [u8; N]) -> [u8; N] {
    bytes.reverse();
    bytes
}

/// Reads an image: `[H, W, 3]`, `[3, H, W]`, `[H, W]`, or packed Bayer with 4 for 3.
///
/// A shape that can be read in two ways, such as `[3, 5, 3]`, has its channels last.
pub(super) fn decode_image(path: &Path, bytes: &[u8]) -> Result<(Pixels, Encoding)> {
    let decode = || {
        let npy = Npy::parse(bytes)?;
        let encoding = Encoding { format: Format::Npy, sample_type: npy.element.name().to_owned() };
        let is_integer = npy.element.is_image_integer();
        Ok((Pixels { is_integer, ..Pixels::of_planes(npy.into_planes()?) }, encoding))
    };
    decode().map_err(|reason: String| Error::format(path, reason))
}

/// The height and width of the image in a file that starts with `bytes`, and whether its samples are integers; `None` where
/// it is none.
pub(super) fn size_of_head(bytes: &[u8]) -> Option<([usize; 2], bool)> {
    let (text, _) = split_header(bytes).ok()?;
    let (element, _) = Element::parse(quoted(entry(text, "descr").ok()?)?)?;
    let shape = parse_shape(entry(text, "shape").ok()?).ok()?;
    let (channels, height, width) = Layout::of_shape(&shape, false).ok()?.shape;
    [1, 3].contains(&channels).then_some(([height, width], element.is_image_integer()))
}

/// The bytes of the whole file that starts with `bytes`, as its header says; none where the header is not whole.
pub(super) fn length_of_head(bytes: &[u8]) -> Option<u64> {
    let (text, data) = split_header(bytes).ok()?;
    let (element, _) = Element::parse(quoted(entry(text, "descr").ok()?)?)?;
    let shape = parse_shape(entry(text, "shape").ok()?).ok()?;
    let elements =
        shape.iter().try_fold(element.bytes() as u64, |bytes, &side| bytes.checked_mul(side as u64))?;
    elements.checked_add((bytes.len() - data.len()) as u64)
}

/// Where an image array keeps its channels, rows and columns.
struct Layout {
    /// Channels, height, width.
    shape: (usize, usize, usize),
    /// Distances between channels, rows and columns, in elements.
    strides: [usize; 3],
}

impl Layout {
    fn of_shape(shape: &[usize], fortran_order: bool) -> Result<Self, String> {
        // The place of the channel, row and column axis in the shape; a grey image has no channel axis.
        let [channel, row, column] = match *shape {
            [_, _] => [None, Some(0), Some(1)],
            [_, _, 3] => [Some(2), Some(0), Some(1)],
            [3, _, _] => [Some(0), Some(1), Some(2)],
            [_, _, 4 | 1] => [Some(2), Some(0), Some(1)],
            [4 | 1, _, _] => [Some(0), Some(1), Some(2)],
            _ => {
                return Err(format!(
                    "has shape {shape:?}; an image is [H, W, 3], [3, H, W] or [H, W], packed Bayer [H, W, 4]"
                ));
            }
        };
        let length = |axis: Option<usize>| axis.map_or(1, |axis| shape[axis]);
        let stride = |axis: Option<usize>| match axis {
            None => 1,
            Some(axis) if fortran_order => shape[..axis].iter().product(),
            Some(axis) => shape[axis + 1..].iter().product(),
        };
        let layout = Self {
            shape: (length(channel), length(row), length(column)),
            strides: [stride(channel), stride(row), stride(column)],
        };
        match layout.shape.1.checked_mul(layout.shape.2) {
            Some(0) => Err(format!("has shape {shape:?}: it is empty")),
            Some(pixels) if pixels <= MAX_PIXELS => Ok(layout),
            _ => Err(format!("has shape {shape:?}, more than the limit of {MAX_PIXELS} pixels")),
        }
    }
}

/// Writes planes as `[H, W, C]`, a single plane as `[H, W]`, little-endian floats or halves.
pub(super) fn encode_image(planes: &ArrayView3<'_, f32>, half: bool) -> Result<Vec<u8>, String> {
    let (channels, height, width) = planes.dim();
    let shape = if channels == 1 { vec![height, width] } else { vec![height, width, channels] };
    if half {
        check_half(planes)?;
        let data = planes::to_interleaved(planes, |v| f16::from_f32(v).to_le_bytes());
        Ok([header("<f2", &shape), data].concat())
    } else {
        Ok([header("<f4", &shape), planes::to_interleaved(planes, f32::to_le_bytes)].concat())
    }
}

/// Writes an array of any shape as little-endian floats.
pub(super) fn encode_array(array: &ArrayD<f32>) -> Vec<u8> {
    let mut bytes = header("<f4", array.shape());
    bytes.extend(array.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

/// Refuses values that half floats would turn into infinities.
pub(super) fn check_half(planes: &ArrayView3<'_, f32>) -> Result<(), String> {
    let overflow = planes.iter().find(|v| v.is_finite() && !f16::from_f32(**v).is_finite());
    match overflow {
        None => Ok(()),
        Some(value) => Err(format!(
            "half floats end at 65504 and the image holds {value}; leave out --half, or scale or clip the image"
        )),
    }
}

fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let sides = if shape.len() == 1 { sides.trim_end() } else { sides.trim_end_matches(", ") };
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({sides}), }}");
    // Magic, version and length take 10 bytes; the data starts on a multiple of 64, after a newline.
    let padding = (64 - (10 + text.len() + 1) % 64) % 64;
    text.extend(std::iter::repeat_n(' ', padding));
    text.push('\n');
    let length = u16::try_from(text.len()).expect("the header of a plain array is short");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(length.to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

fn split_header(bytes: &[u8]) -> Result<(&str, &[u8]), String> {
    const TRUNCATED: &str = "is truncated inside of its header";
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or("is not a NumPy file")?;
    let (length, rest) = match rest {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        [version, _, ..] if !(1..=3).contains(version) => {
            return Err(format!("is of format version {version}; versions 1 to 3 are read"));
        }
        _ => return Err(TRUNCATED.into()),
    };
    if length > MAX_HEADER_BYTES {
        return Err(format!("declares a header of {length} bytes; it is damaged or no plain array"));
    }
    let (text, data) = rest.split_at_checked(length).ok_or(TRUNCATED)?;
    let text = std::str::from_utf8(text).map_err(|_| "the header is not text")?;
    Ok((text, data))
}

/// The text after `'key':` in the header's dictionary.
fn entry<'a>(text: &'a str, key: &str) -> Result<&'a str, String> {
    [format!("'{key}'"), format!("\"{key}\"")]
        .iter()
        .find_map(|quoted_key| text.split_once(quoted_key.as_str()))
        .and_then(|(_, after)| after.trim_start().strip_prefix(':'))
        .map(str::trim_start)
        .ok_or_else(|| format!("the header has no `{key}`"))
}

fn quoted(value: &str) -> Option<&str> {
    let quote = value.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    value[1..].split_once(quote).map(|(inside, _)| inside)
}

fn parse_shape(value: &str) -> Result<Vec<usize>, String> {
    let inside = value.strip_prefix('(').and_then(|rest| rest.split_once(')')).map(|(inside, _)| inside);
    let inside = inside.ok_or("the header's shape is not a tuple")?;
    let sides = inside.split(',').map(str::trim).filter(|side| !side.is_empty());
    sides.map(|side| side.parse().map_err(|_| format!("the header's shape holds '{side}'"))).collect()
}
