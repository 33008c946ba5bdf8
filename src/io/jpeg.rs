//! Tells a whole JPEG file from one that was cut off, which decoders fill up with grey.

/// The second byte of markers, after [`MARKER`] (ITU-T T.81, table B.1).
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_IMAGE: u8 = 0xd8;
const FIRST_RESTART: u8 = 0xd0;
/// Stands for a data byte of 0xff, and for an arithmetic coder's own use.
const STUFFED: u8 = 0x00;
const TEMPORARY: u8 = 0x01;
const MARKER: u8 = 0xff;

/// Whether the image ends by its own marker; more may follow, as some cameras append.
///
/// All other segments say their length, so that the end of a thumbnail inside of one is passed over. In the data of a
/// scan no other marker than restarts appears.
pub(super) fn is_whole(bytes: &[u8]) -> bool {
    let mut place = 0;
    while let Some(&[first, second]) = bytes.get(place..).and_then(|rest| rest.first_chunk()) {
        place += match (first, second) {
            (MARKER, END_OF_IMAGE) => return true,
            (MARKER, STUFFED | TEMPORARY | FIRST_RESTART..=START_OF_IMAGE) => 2,
            (MARKER, MARKER) => 1,
            (MARKER, _) => match bytes.get(place + 2..).and_then(|rest| rest.first_chunk()) {
                Some(length) => 2 + usize::from(u16::from_be_bytes(*length)),
                None => return false,
            },
            _ => 1,
        };
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_end_of_the_image_itself_makes_it_whole() {
        let thumbnail = [0xff, 0xe1, 0, 6, 0xff, 0xd8, 0xff, 0xd9];
        let scan = [0xff, 0xda, 0, 3, 1, 7, 0xff, 0, 0xff, 0xd3, 8, 0xff, 0xff];
        let mut file = [&[0xff, 0xd8][..], &thumbnail, &scan].concat();
        assert!(!is_whole(&file));
        file.push(0xd9);
        assert!(is_whole(&file));
        assert!(!is_whole(&file[..file.len() - 1]));
        file.extend([1, 2, 3]);
        assert!(is_whole(&file));
        assert!(!is_whole(&[0xff, 0xd8, 0xff, 0xe1]));
    }
}
