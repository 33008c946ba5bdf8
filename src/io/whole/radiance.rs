//! Follows the scan lines of a Radiance HDR file to its end, without the light that they hold.
//!
//! After Ward's `color.c` of Radiance: a scan line begins with 2, 2 and a byte below 128 where each of its four components is
//! stored for itself, as runs of one byte and as single bytes; otherwise it is pixels, and runs of the pixel before.

use std::io::{self, BufRead, ErrorKind, Read};

/// Longer than a line of a header is.
const LONGEST_LINE: u64 = 1 << 16;

/// From here on a count is of a run, of so much less.
const RUN: u8 = 128;

/// Whether a file goes on to the end of its last scan line.
pub(super) fn is_whole(mut file: impl BufRead) -> io::Result<bool> {
    match follow(&mut file) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
        followed => followed,
    }
}

/// Whether there are a header and as many scan lines as it says.
fn follow(file: &mut impl BufRead) -> io::Result<bool> {
    while !matches!(line(file)?.as_str(), "" | "\n") {}
    // As in `-Y 480 +X 640`: scan lines, and pixels of each.
    let sides: Vec<usize> = line(file)?.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let &[lines, width] = &sides[..] else { return Ok(false) };
    for _ in 0..lines {
        if !follow_scan_line(file, width)? {
            return Ok(false);
        }
    }
    Ok(true)
}

fn line(file: &mut impl BufRead) -> io::Result<String> {
    let mut bytes = Vec::new();
    file.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn follow_scan_line(file: &mut impl BufRead, width: usize) -> io::Result<bool> {
    if !matches!(bytes(file)?, [2, 2, 0..128, _]) {
        return follow_pixels(file, width);
    }
    for _ in 0..4 {
        let mut place = 0;
        while place < width {
            let [count] = bytes(file)?;
            let mut values = [0; RUN as usize];
            let (pixels, stored) = if count > RUN { (count - RUN, 1) } else { (count, count) };
            file.read_exact(&mut values[..usize::from(stored)])?;
            place += usize::from(pixels);
        }
        if place != width {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Pixels behind the first of a scan line; 1, 1, 1 and a count are a run, whose higher bytes may follow as another.
fn follow_pixels(file: &mut impl BufRead, width: usize) -> io::Result<bool> {
    let (mut place, mut unit) = (1, 1_usize);
    while place < width {
        let (pixels, next_unit) = match bytes(file)? {
            [1, 1, 1, count] => (usize::from(count).saturating_mul(unit), unit.saturating_mul(256)),
            _ => (1, 1),
        };
        place = usize::saturating_add(place, pixels);
        unit = next_unit;
    }
    Ok(place == width)
}

fn bytes<const N: usize>(file: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(size: &str, data: &[u8]) -> Vec<u8> {
        [format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{size}\n").as_bytes(), data].concat()
    }

    fn holds(size: &str, data: &[u8]) -> bool {
        is_whole(&file(size, data)[..]).unwrap()
    }

    #[test]
    fn runs_of_both_kinds_are_followed() {
        let component = [&[128 + 5, 7][..], &[3, 1, 2, 3]].concat();
        let new = [&[2, 2, 0, 8][..], &component.repeat(4)].concat();
        assert!(holds("-Y 1 +X 8", &new) && holds("-Y 2 +X 8", &new.repeat(2)));
        assert!(!holds("-Y 1 +X 8", &new[..new.len() - 1]) && !holds("-Y 3 +X 8", &new.repeat(2)));
        assert!(!holds("-Y 1 +X 7", &new), "a run leads beyond the line");
        let old = [[9, 9, 9, 128], [1, 1, 1, 4], [1, 1, 1, 1], [8, 8, 8, 128]].concat();
        assert!(holds("-Y 1 +X 262", &old) && !holds("-Y 1 +X 263", &old) && !holds("-Y 1 +X 260", &old));
    }

    #[test]
    fn what_has_no_size_is_not_whole() {
        assert!(!holds("+X 3", &[0; 99]) && !holds("", &[]));
        assert!(!is_whole(&b"#?RADIANCE\nFORMAT"[..]).unwrap());
    }
}
