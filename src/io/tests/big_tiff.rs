//! BigTIFF files, whose positions are of 64 bits: they are read as those of 32 bits are, and refused where those are.

use std::io::Cursor;

use ::tiff::encoder::colortype::{ColorType, Gray16, RGB8};
use ::tiff::encoder::{TiffEncoder, TiffKind, TiffValue};
use ::tiff::tags::Tag;

use super::*;
use crate::core::orientation::Orientation;

const SIZE: [u32; 2] = [9, 7];

/// The samples of an image, and fields beside them.
type Written<'a, S> = (&'a [S], &'a [(u16, u32)]);

/// One directory for each image.
fn file<C: ColorType, K: TiffKind>(images: &[Written<'_, C::Inner>]) -> Vec<u8>
where
    [C::Inner]: TiffValue,
{
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::<_, K>::new_generic(&mut file).unwrap();
    for (samples, fields) in images {
        let mut image = encoder.new_image::<C>(SIZE[0], SIZE[1]).unwrap();
        for (tag, value) in *fields {
            image.encoder().write_tag(Tag::from_u16_exhaustive(*tag), *value).unwrap();
        }
        image.write_data(samples).unwrap();
    }
    file.into_inner()
}

fn big<C: ColorType>(images: &[Written<'_, C::Inner>]) -> Vec<u8>
where
    [C::Inner]: TiffValue,
{
    file::<C, ::tiff::encoder::TiffKindBig>(images)
}

fn read(bytes: &[u8]) -> Result<Pixels> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("big.tif");
    std::fs::write(&path, bytes).unwrap();
    read_pixels(&path)
}

fn refusal(bytes: &[u8]) -> String {
    read(bytes).unwrap_err().to_string()
}

fn grey(first: u16) -> Vec<u16> {
    (0..63).map(|i| first + 900 * i).collect()
}

#[test]
fn they_are_read_as_others_are() {
    const TURNED_RIGHT: (u16, u32) = (274, 6);
    let (grey, colours) = (grey(5), (0..189).collect::<Vec<u8>>());
    let (one, other) = (
        read(&big::<Gray16>(&[(&grey, &[TURNED_RIGHT])])).unwrap(),
        read(&file::<Gray16, ::tiff::encoder::TiffKindStandard>(&[(&grey, &[TURNED_RIGHT])])).unwrap(),
    );
    assert_eq!(one.planes, other.planes);
    assert_eq!(one.capture.as_ref().unwrap().orientation, Orientation::from_exif(6));
    assert_eq!(one.capture, other.capture);
    let colours = read(&big::<RGB8>(&[(&colours, &[])])).unwrap().planes;
    assert_eq!((colours.dim(), colours[[1, 0, 1]]), ((3, 7, 9), 4.0 / 255.0));
}

/// In files of some scanners and editors the preview comes first.
#[test]
fn the_page_is_found_behind_a_preview_and_several_are_refused() {
    const PREVIEW: &[(u16, u32)] = &[(254, 1)];
    let (page, preview) = (grey(3), grey(99));
    let found = read(&big::<Gray16>(&[(&preview, PREVIEW), (&page, &[])])).unwrap().planes;
    assert_eq!(found[[0, 0, 0]], 3.0 / 65535.0);
    let said = refusal(&big::<Gray16>(&[(&page, &[]), (&preview, &[])]));
    assert!(said.contains("2 pages"), "{said}");
    let said = refusal(&big::<Gray16>(&[(&page, &[(266, 2)])]));
    assert!(said.contains("FillOrder 2"), "{said}");
}

#[test]
fn what_is_cut_off_or_absurd_is_refused() {
    let whole = big::<Gray16>(&[(&grey(0), &[])]);
    for kept in [4, 12, 16, whole.len() / 2, whole.len() - 10] {
        let said = refusal(&whole[..kept]);
        assert!(said.contains("cannot be decoded") || said.contains("damaged"), "{kept}: {said}");
    }
    // The width, a field of 16 bits, as one of 64.
    let at = whole.windows(4).rposition(|field| field == [0, 1, 4, 0]).expect("the width, of 32 bits");
    let mut wide = whole.clone();
    wide[at + 12..at + 16].copy_from_slice(&0x1000_0000_u32.to_le_bytes());
    let said = refusal(&wide);
    assert!(said.contains("do not fit") || said.contains("the limit is"), "{said}");
}
