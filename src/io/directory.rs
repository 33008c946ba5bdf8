//! Reads the directories of TIFF files, of digital negatives and of EXIF: fields of a tag, a type, a count, and values or their
//! position.
//!
//! The file: byte order, 42, the position of the first directory (TIFF 6.0, section 2). A BigTIFF says 43 and 8, and has counts
//! and positions of 8 bytes. Nothing is believed that lies beyond the end of the file.

/// What kind of image a directory is of: bits of the newer tag, a number of the older.
const NEW_SUBFILE_TYPE: u16 = 254;
const SUBFILE_TYPE: u16 = 255;

pub(super) const WIDTH: u16 = 256;
pub(super) const HEIGHT: u16 = 257;
pub(super) const BITS: u16 = 258;
pub(super) const COMPRESSION: u16 = 259;
pub(super) const PHOTOMETRIC: u16 = 262;
pub(super) const FILL_ORDER: u16 = 266;
pub(super) const SAMPLES: u16 = 277;
/// Positions of directories inside of one: of smaller versions, or of the image that a preview is of.
pub(super) const SUB_DIRECTORIES: u16 = 330;

const DNG_VERSION: u16 = 50706;

/// Values of [`PHOTOMETRIC`]: black is zero; red, green and blue.
pub(super) const GREY: u16 = 1;
pub(super) const RGB: u16 = 2;

/// The number of BigTIFF, and the bytes of its positions, which it says behind that.
const BIG: u16 = 43;
const BIG_POSITION: usize = 8;

/// The types of numbers: bytes, 16 and 32 bits, fractions with and without sign, positions of directories; and of text and
/// data without a type. The last two are of BigTIFF, of 64 bits.
const BYTE: u16 = 1;
const ASCII: u16 = 2;
const UNDEFINED: u16 = 7;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const RATIONAL: u16 = 5;
const SRATIONAL: u16 = 10;
const IFD: u16 = 13;
const LONG8: u16 = 16;
const IFD8: u16 = 18;

/// The most directories of a field that are looked at: files have a raw image and a few previews.
const MAX_DIRECTORIES: usize = 32;

/// One directory of a file.
pub(super) struct Directory<'a> {
    bytes: &'a [u8],
    /// Its position in the file.
    start: usize,
    big_endian: bool,
    /// Bytes of a position: 4, or 8 in a BigTIFF. The position of the first directory stands behind as many.
    position_bytes: usize,
    /// Tag, type, count and the place of the value or of its position.
    fields: Vec<(u16, u16, usize, usize)>,
}

impl<'a> Directory<'a> {
    /// The first directory of a file.
    pub(super) fn first(bytes: &'a [u8]) -> Option<Self> {
        let big_endian = bytes.starts_with(b"MM");
        let mut file = Self { bytes, start: 0, big_endian, position_bytes: 4, fields: Vec::new() };
        if file.u16(2)? == BIG {
            file.position_bytes = file.u16(4).map(usize::from).filter(|bytes| *bytes == BIG_POSITION)?;
        }
        file.at(file.position(file.position_bytes)?)
    }

    /// Another directory of the same file.
    fn at(&self, start: usize) -> Option<Self> {
        let mut directory = Self { start, fields: Vec::new(), ..*self };
        let width = self.position_bytes;
        for index in 0..directory.count()? {
            let place = directory.place_of(index)?;
            directory.slice(place, 4 + 2 * width)?;
            let (tag, kind) = (directory.u16(place)?, directory.u16(place + 2)?);
            directory.fields.push((tag, kind, directory.position(place + 4)?, place + 4 + width));
        }
        Some(directory)
    }

    /// The directories whose positions a field lists, of which there are a few.
    pub(super) fn inner(&self, tag: u16) -> impl Iterator<Item = Self> + '_ {
        let places = self.numbers(tag).unwrap_or_default();
        places.into_iter().take(MAX_DIRECTORIES).filter_map(|start| self.at(start))
    }

    /// The directory behind this one.
    fn next(&self) -> Option<Self> {
        let next = self.position(self.place_of(self.count()?)?).filter(|next| *next > 0)?;
        self.at(next)
    }

    /// The images in full that this directory and those behind it hold: pages. Where all of these are previews, it is the
    /// pages inside of them.
    pub(super) fn pages(&self) -> Vec<Self> {
        let here = self.at(self.start);
        let row: Vec<Self> = std::iter::successors(here, Self::next).take(1 + MAX_DIRECTORIES).collect();
        if row.iter().any(Self::is_page) {
            return row.into_iter().filter(Self::is_page).collect();
        }
        row.iter().flat_map(|preview| preview.inner(SUB_DIRECTORIES)).filter(Self::is_page).collect()
    }

    /// Whether the directory is of an image in full, neither of a preview nor of a mask.
    fn is_page(&self) -> bool {
        const PREVIEW_OR_MASK: usize = 0b101;
        const OLD_PREVIEW: usize = 2;
        self.number(NEW_SUBFILE_TYPE).is_none_or(|kind| kind & PREVIEW_OR_MASK == 0)
            && self.number(SUBFILE_TYPE) != Some(OLD_PREVIEW)
    }

    /// Whether two directories of one file are the same.
    pub(super) fn is(&self, other: &Self) -> bool {
        self.start == other.start
    }

    /// Whether the file says that it is a digital negative.
    pub(super) fn has_dng_version(&self) -> bool {
        self.numbers(DNG_VERSION).is_some()
    }

    /// The text of a field: up to its first zero, without spaces around, what is no UTF-8 or controls left out.
    pub(super) fn text(&self, tag: u16) -> Option<String> {
        let bytes = self.bytes_of(tag)?.split(|byte| *byte == 0).next()?;
        let text: String = String::from_utf8_lossy(bytes).chars().filter(|c| !c.is_control()).collect();
        let text = text.trim();
        (!text.is_empty()).then(|| text.to_owned())
    }

    /// Length of the file in bytes.
    pub(super) fn file_len(&self) -> usize {
        self.bytes.len()
    }

    /// Number of the fields.
    fn count(&self) -> Option<usize> {
        if self.is_big() { self.position(self.start) } else { self.u16(self.start).map(usize::from) }
    }

    /// Where the field of an index begins, or what stands behind the last.
    fn place_of(&self, index: usize) -> Option<usize> {
        let count_bytes = if self.is_big() { BIG_POSITION } else { 2 };
        index.checked_mul(4 + 2 * self.position_bytes)?.checked_add(count_bytes)?.checked_add(self.start)
    }

    fn is_big(&self) -> bool {
        self.position_bytes == BIG_POSITION
    }

    /// A position or a count.
    fn position(&self, place: usize) -> Option<usize> {
        if self.is_big() { self.u64(place) } else { self.u32(place) }
    }

    fn u16(&self, place: usize) -> Option<u16> {
        let bytes = *self.bytes.get(place..)?.first_chunk::<2>()?;
        Some(if self.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    fn u32(&self, place: usize) -> Option<usize> {
        let bytes = *self.bytes.get(place..)?.first_chunk::<4>()?;
        let value = if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) };
        usize::try_from(value).ok()
    }

    fn u64(&self, place: usize) -> Option<usize> {
        let bytes = *self.bytes.get(place..)?.first_chunk::<8>()?;
        let value = if self.big_endian { u64::from_be_bytes(bytes) } else { u64::from_le_bytes(bytes) };
        usize::try_from(value).ok()
    }

    /// `length` bytes of the file from `start`.
    pub(super) fn slice(&self, start: usize, length: usize) -> Option<&'a [u8]> {
        self.bytes.get(start..start.checked_add(length)?)
    }

    /// Type, count and position of a field's values of `size` bytes each; all are there.
    fn values(&self, tag: u16, size_of: impl Fn(u16) -> Option<usize>) -> Option<(u16, usize, usize)> {
        let &(_, kind, count, place) = self.fields.iter().find(|field| field.0 == tag)?;
        let length = count.checked_mul(size_of(kind)?)?;
        let start = if length <= self.position_bytes { place } else { self.position(place)? };
        self.slice(start, length)?;
        Some((kind, count, start))
    }

    /// The bytes of a field of bytes, text or unnamed data.
    pub(super) fn bytes_of(&self, tag: u16) -> Option<&'a [u8]> {
        let (_, count, start) =
            self.values(tag, |kind| [BYTE, ASCII, UNDEFINED].contains(&kind).then_some(1))?;
        self.slice(start, count)
    }

    /// All values of a field of integers.
    pub(super) fn numbers(&self, tag: u16) -> Option<Vec<usize>> {
        let size_of = |kind| match kind {
            BYTE => Some(1),
            SHORT => Some(2),
            LONG | IFD => Some(4),
            LONG8 | IFD8 => Some(8),
            _ => None,
        };
        let (kind, count, start) = self.values(tag, size_of)?;
        let value = |index: usize| match kind {
            BYTE => self.bytes.get(start + index).copied().map(usize::from),
            SHORT => self.u16(start + 2 * index).map(usize::from),
            LONG8 | IFD8 => self.u64(start + 8 * index),
            _ => self.u32(start + 4 * index),
        };
        (0..count).map(value).collect()
    }

    /// The first value of a field of integers.
    pub(super) fn number(&self, tag: u16) -> Option<usize> {
        self.numbers(tag)?.first().copied()
    }

    /// All values of a field of integers or fractions; a fraction by zero is not finite.
    pub(super) fn reals(&self, tag: u16) -> Option<Vec<f64>> {
        if let Some(numbers) = self.numbers(tag) {
            return Some(numbers.into_iter().map(|number| number as f64).collect());
        }
        let (kind, count, start) =
            self.values(tag, |kind| [RATIONAL, SRATIONAL].contains(&kind).then_some(8))?;
        let part = |place: usize| {
            let bits = u32::try_from(self.u32(place)?).ok()?;
            Some(if kind == SRATIONAL { f64::from(bits.cast_signed()) } else { f64::from(bits) })
        };
        (0..count).map(|index| Some(part(start + 8 * index)? / part(start + 8 * index + 4)?)).collect()
    }

    /// The file with this directory as its first.
    pub(super) fn as_first(&self) -> Option<Vec<u8>> {
        let mut bytes = self.bytes.to_vec();
        self.put_position(&mut bytes, self.position_bytes, self.start)?;
        Some(bytes)
    }

    /// The file with this directory as its first, and its samples declared to be [`GREY`] or [`RGB`].
    pub(super) fn promoted(&self, photometric: u16) -> Option<Vec<u8>> {
        let (_, _, place) = self.values(PHOTOMETRIC, |kind| (kind == SHORT).then_some(2))?;
        let mut bytes = self.as_first()?;
        self.put_u16(&mut bytes, place, photometric);
        Some(bytes)
    }

    fn put_u16(&self, bytes: &mut [u8], place: usize, value: u16) {
        let value = if self.big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
        bytes[place..place + 2].copy_from_slice(&value);
    }

    fn put_position(&self, bytes: &mut [u8], place: usize, value: usize) -> Option<()> {
        let wide = value as u64;
        let narrow = u32::try_from(value);
        let value = match (self.is_big(), self.big_endian) {
            (true, true) => wide.to_be_bytes().to_vec(),
            (true, false) => wide.to_le_bytes().to_vec(),
            (false, true) => narrow.ok()?.to_be_bytes().to_vec(),
            (false, false) => narrow.ok()?.to_le_bytes().to_vec(),
        };
        bytes[place..place + value.len()].copy_from_slice(&value);
        Some(())
    }
}
