//! Frames bytes as records of a TFRecord file, and finds the records of such a file again.
//!
//! A record is its length (u64), the length's checksum (u32), the bytes, and their checksum (u32), all
//! little-endian. Checksums are CRC-32C (Castagnoli), "masked" so that a record within a record does not check
//! itself: rotated right by 15 bits, plus 0xa282ead8.

/// The polynomial of CRC-32C, bit-reversed (RFC 3720, appendix B.4, names it in its usual order 0x1EDC6F41).
const POLYNOMIAL: u32 = 0x82f6_3b78;

/// What masking adds.
const MASK_DELTA: u32 = 0xa282_ead8;

/// Bytes before the contents: the length and its checksum.
const HEADER: usize = 12;

/// Bytes after the contents: their checksum.
const FOOTER: usize = 4;

/// The remainder of each byte.
const TABLE: [u32; 256] = table();

#[expect(clippy::cast_possible_truncation, reason = "an index of 256 entries")]
const fn table() -> [u32; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut remainder = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            remainder = if remainder & 1 == 1 { (remainder >> 1) ^ POLYNOMIAL } else { remainder >> 1 };
            bit += 1;
        }
        table[byte] = remainder;
        byte += 1;
    }
    table
}

/// The CRC-32C of bytes.
pub(super) fn crc32c(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| TABLE[((crc ^ u32::from(*byte)) & 0xff) as usize] ^ (crc >> 8);
    !bytes.iter().fold(!0, step)
}

fn masked(bytes: &[u8]) -> u32 {
    crc32c(bytes).rotate_right(15).wrapping_add(MASK_DELTA)
}

/// One record with these contents.
pub(super) fn frame(contents: &[u8]) -> Vec<u8> {
    let length = (contents.len() as u64).to_le_bytes();
    let mut record = Vec::with_capacity(HEADER + contents.len() + FOOTER);
    record.extend(length);
    record.extend(masked(&length).to_le_bytes());
    record.extend(contents);
    record.extend(masked(contents).to_le_bytes());
    record
}

/// The contents of the first record and what follows it; none when the bytes begin with no whole, sound record.
pub(super) fn split_first(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    let (check, rest) = rest.split_first_chunk::<4>()?;
    if u32::from_le_bytes(*check) != masked(length) {
        return None;
    }
    let (contents, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    let (check, rest) = rest.split_first_chunk::<4>()?;
    (u32::from_le_bytes(*check) == masked(contents)).then_some((contents, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The vectors of RFC 3720 (iSCSI), appendix B.4, and the check value of the CRC catalogues.
    #[test]
    fn checksums_are_those_of_the_standard() {
        let ascending: Vec<u8> = (0..32).collect();
        let descending: Vec<u8> = (0..32).rev().collect();
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
        assert_eq!(crc32c(&ascending), 0x46dd_794e);
        assert_eq!(crc32c(&descending), 0x113f_db5c);
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(crc32c(b""), 0);
    }

    #[test]
    fn records_are_found_again_up_to_the_first_that_is_damaged() {
        let file = [frame(b"first"), frame(b""), frame(b"third")].concat();
        let (first, rest) = split_first(&file).unwrap();
        let (second, rest) = split_first(rest).unwrap();
        assert_eq!((first, second), (&b"first"[..], &b""[..]));
        assert_eq!(split_first(rest).unwrap(), (&b"third"[..], &b""[..]));
        assert!(split_first(&rest[..rest.len() - 1]).is_none(), "cut off");
        for at in 0..rest.len() {
            let mut damaged = rest.to_vec();
            damaged[at] ^= 0x10;
            assert!(split_first(&damaged).is_none(), "byte {at}");
        }
    }
}
