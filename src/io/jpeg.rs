//! Tells a whole JPEG file from one that was cut off, which decoders fill up with grey, and how exact its values are.

/// The second byte of markers, after [`MARKER`] (ITU-T T.81, table B.1).
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_IMAGE: u8 = 0xd8;
const FIRST_RESTART: u8 = 0xd0;
/// Stands for a data byte of 0xff, and for an arithmetic coder's own use.
const STUFFED: u8 = 0x00;
const TEMPORARY: u8 = 0x01;
const MARKER: u8 = 0xff;
/// Of the segments that hold tables of quantisation, and that begin a frame, but for three others among their numbers.
const QUANTISATION: u8 = 0xdb;
const FRAMES: std::ops::RangeInclusive<u8> = 0xc0..=0xcf;
const NO_FRAMES: [u8; 3] = [0xc4, 0xc8, 0xcc];
const START_OF_SCAN: u8 = 0xda;

/// Coefficients of a block.
const COEFFICIENTS: usize = 64;

/// The largest encoded value.
const WHITE: f64 = 255.0;

/// Squares of what luma and the two chromas count in red, green and blue (ITU-T T.871, 7).
const SHARES: [[f64; 3]; 3] = [
    [1.0, 0.0, 1.402 * 1.402],
    [1.0, 0.344_136 * 0.344_136, 0.714_136 * 0.714_136],
    [1.0, 1.772 * 1.772, 0.0],
];

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

/// The standard deviation of what quantisation makes wrong in the encoded values of red, green and blue, of which white is 1; none
/// where the file does not say it.
///
/// # Equation
/// `σ² = mean(q²)/12` in each of luma and chromas, of their tables' steps q: as far as their coefficients do not all vanish.
pub(super) fn quantisation_error(bytes: &[u8]) -> Option<[f32; 3]> {
    let (mut tables, mut components) = ([None; 4], Vec::new());
    let mut place = 2;
    while let Some(&[MARKER, kind]) = bytes.get(place..)?.first_chunk() {
        if kind == MARKER {
            place += 1;
            continue;
        }
        let length = usize::from(u16::from_be_bytes(*bytes.get(place + 2..)?.first_chunk()?));
        let segment = bytes.get(place + 4..place + 2 + length)?;
        match kind {
            QUANTISATION => read_tables(segment, &mut tables)?,
            kind if FRAMES.contains(&kind) && !NO_FRAMES.contains(&kind) => {
                let of_components = segment.get(6..)?.chunks_exact(3);
                components = of_components.map(|component| usize::from(component[2])).collect();
            }
            START_OF_SCAN => break,
            _ => {}
        }
        place += 2 + length;
    }
    let variance = |component: usize| -> Option<f64> {
        let table = components.get(component).or(components.first())?;
        *tables.get(*table)?
    };
    let of_components = match components.len() {
        1 => [variance(0)?, 0.0, 0.0],
        3 => [variance(0)?, variance(1)?, variance(2)?],
        _ => return None,
    };
    Some(SHARES.map(|shares| {
        let variance: f64 = shares.iter().zip(of_components).map(|(share, variance)| share * variance).sum();
        narrow(variance.sqrt() / WHITE)
    }))
}

/// Reads the variances that the tables of a segment make, by their numbers.
fn read_tables(mut segment: &[u8], variances: &mut [Option<f64>; 4]) -> Option<()> {
    while let [head, rest @ ..] = segment {
        let bytes = if head >> 4 == 0 { 1 } else { 2 };
        let table = rest.get(..bytes * COEFFICIENTS)?;
        let squares = table.chunks_exact(bytes).map(|step| {
            let step = step.iter().fold(0u32, |step, byte| 256 * step + u32::from(*byte));
            f64::from(step).powi(2)
        });
        *variances.get_mut(usize::from(head & 15))? =
            Some(squares.sum::<f64>() / (12.0 * COEFFICIENTS as f64));
        segment = &rest[bytes * COEFFICIENTS..];
    }
    Some(())
}

#[expect(clippy::cast_possible_truncation, reason = "a deviation of three digits")]
fn narrow(value: f64) -> f32 {
    value as f32
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

    /// Tables of one step each, of luma and of chromas.
    fn file(luma: u8, chroma: u8, of_components: &[u8]) -> Vec<u8> {
        let table = |number: u8, step: u8| [&[0xff, 0xdb, 0, 67, number][..], &[step; 64]].concat();
        let frame = |tables: &[u8]| {
            let components: Vec<u8> = tables.iter().flat_map(|table| [1, 0x11, *table]).collect();
            let length = 8 + components.len() as u8;
            [&[0xff, 0xc0, 0, length, 8, 0, 8, 0, 8, tables.len() as u8][..], &components].concat()
        };
        let scan = [0xff, 0xda, 0, 2, 1, 2, 3];
        [&[0xff, 0xd8][..], &table(0, luma), &table(1, chroma), &frame(of_components), &scan].concat()
    }

    #[test]
    fn the_error_of_an_even_table_is_that_of_rounding_to_its_steps() {
        let of = |luma, chroma, tables: &[u8]| quantisation_error(&file(luma, chroma, tables)).unwrap();
        let step = |step: f32| step / 12f32.sqrt() / 255.0;
        let grey = of(6, 9, &[0]);
        assert!(grey.iter().all(|error| (error - step(6.0)).abs() < 1e-6), "{grey:?}");
        let [red, green, blue] = of(6, 9, &[0, 1, 1]);
        let expected = |share: f32| (step(6.0).powi(2) + share * step(9.0).powi(2)).sqrt();
        assert!(
            (red - expected(1.402f32.powi(2))).abs() < 1e-6
                && (blue - expected(1.772f32.powi(2))).abs() < 1e-6
        );
        assert!(step(6.0) < green && green < red && red < blue);
    }

    #[test]
    fn what_is_damaged_says_no_error() {
        let whole = file(6, 9, &[0, 1, 1]);
        for end in 0..whole.len() - 3 {
            let _ = quantisation_error(&whole[..end]);
        }
        assert_eq!(quantisation_error(&whole[..80]), None);
        assert_eq!(quantisation_error(&file(6, 9, &[0, 2, 2])), None);
    }
}
