//! Writes pictures as TIFF files, with the profile of their colours and what their camera says.

use std::io::{Cursor, Seek, Write};

use tiff::Directory;
use tiff::TiffError;
use tiff::encoder::colortype::{ColorType, Gray8, Gray16, RGB8, RGB16};
use tiff::encoder::{DirectoryEncoder, TiffEncoder, TiffKindStandard, TiffValue};
use tiff::tags::{Tag, Type};

use crate::core::exif::Exif;
use crate::core::primaries::ColorSpace;
use crate::io::exif::{Field, Picture, fields_of_tiff};
use crate::io::icc;

type Fields<'a, W> = DirectoryEncoder<'a, W, TiffKindStandard>;

/// The samples of a picture, those of a pixel together.
pub(in crate::io) enum Samples {
    /// Of 8 bits.
    Bytes(Vec<u8>),
    /// Of 16 bits.
    Words(Vec<u16>),
}

/// Encodes samples of one or three channels without compression.
pub(in crate::io) fn encode(
    samples: &Samples,
    channels: usize,
    picture: Picture,
    space: Option<ColorSpace>,
    exif: Option<&Exif>,
) -> Result<Vec<u8>, String> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file).map_err(|error| error.to_string())?;
    let beside = || Beside { picture, space, exif };
    let written = match (samples, channels) {
        (Samples::Bytes(samples), 1) => write::<Gray8>(&mut encoder, samples, beside()),
        (Samples::Bytes(samples), _) => write::<RGB8>(&mut encoder, samples, beside()),
        (Samples::Words(samples), 1) => write::<Gray16>(&mut encoder, samples, beside()),
        (Samples::Words(samples), _) => write::<RGB16>(&mut encoder, samples, beside()),
    };
    written.map_err(|error| error.to_string())?;
    Ok(file.into_inner())
}

/// What stands beside the samples.
struct Beside<'a> {
    picture: Picture,
    space: Option<ColorSpace>,
    exif: Option<&'a Exif>,
}

fn write<C: ColorType>(
    encoder: &mut TiffEncoder<&mut Cursor<Vec<u8>>>,
    samples: &[C::Inner],
    beside: Beside<'_>,
) -> Result<(), TiffError>
where
    [C::Inner]: TiffValue,
{
    let [first, inner, position] =
        beside.exif.map_or_else(Default::default, |exif| fields_of_tiff(exif, beside.picture));
    let mut places = Vec::new();
    for (tag, fields) in [(Tag::ExifDirectory, inner), (Tag::GpsDirectory, position)] {
        if !fields.is_empty() {
            let mut directory = encoder.extra_directory()?;
            write_fields(&mut directory, &fields)?;
            places.push((tag, directory.finish_with_offsets()?.offset));
        }
    }
    let mut image = encoder.new_image::<C>(beside.picture.width, beside.picture.height)?;
    for (tag, place) in places {
        image.encoder().write_tag(tag, place)?;
    }
    write_fields(image.encoder(), &first)?;
    if let Some(space) = beside.space {
        image.encoder().write_tag(Tag::IccProfile, &icc::profile_of(space)[..])?;
    }
    image.write_data(samples)
}

fn write_fields<W: Write + Seek>(directory: &mut Fields<'_, W>, fields: &[Field]) -> Result<(), TiffError> {
    let mut entries = Directory::empty();
    for field in fields {
        let kind = Type::from_u16(field.kind).expect("a type of TIFF 6.0");
        let entry = directory.write_entry_bytes(kind, &field.bytes)?;
        entries.extend([(Tag::from_u16_exhaustive(field.tag), entry)]);
    }
    directory.extend_from(&entries);
    Ok(())
}
