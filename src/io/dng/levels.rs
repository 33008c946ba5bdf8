//! The levels of a raw image: which values stand for darkness and for a full photosite (DNG 1.7, chapter 5, "Mapping Raw
//! Values to Linear Reference Values").

use ndarray::Array3;

use crate::io::RawMetadata;
use crate::io::directory::{BITS, Directory};

const BLACK_LEVEL_REPEAT: u16 = 50713;
const BLACK_LEVEL: u16 = 50714;
const BLACK_LEVEL_OF_COLUMN: u16 = 50715;
const BLACK_LEVEL_OF_ROW: u16 = 50716;
const WHITE_LEVEL: u16 = 50717;

/// The levels that a file says, in the units of the planes.
struct Levels {
    /// Of each plane.
    whites: Vec<f64>,
    /// One for all, or one for each place of the pattern and each plane, the planes of a place together.
    blacks: Vec<f64>,
    /// Rows and columns of the pattern.
    pattern: [usize; 2],
    /// What each column and row adds to black.
    of_columns: Vec<f64>,
    of_rows: Vec<f64>,
}

/// Reads the levels, and brings every photosite to the same ones where there are several: a white level for each plane, a black
/// one for each place of a repeated pattern and plane, and what each column and row adds.
///
/// `largest` is what integers were divided by; none for floats, which may have any white level.
///
/// # Equation
/// `light = (value − black of the photosite) / (white of the plane − the highest black of the plane)`
///
/// # Errors
/// What is wrong with levels that do not fit to the image or to each other.
pub(super) fn levelled(
    planes: &mut Array3<f32>,
    raw: &Directory<'_>,
    largest: Option<f64>,
) -> Result<RawMetadata, String> {
    let levels = Levels::of(planes.dim(), raw, largest)?;
    let channels = levels.whites.len();
    let darkest: Vec<f64> = (0..channels).map(|channel| levels.highest_black(channel)).collect();
    let is_sound =
        |(white, darkest): &(&f64, &f64)| white.is_finite() && darkest.is_finite() && darkest < white;
    if let Some((white, darkest)) = levels.whites.iter().zip(&darkest).find(|pair| !is_sound(pair)) {
        return Err(format!("is damaged: black levels up to {darkest} do not lie below white {white}"));
    }
    let black = mean(&levels.blacks) + mean(&levels.of_columns) + mean(&levels.of_rows);
    let white = levels.whites.iter().copied().fold(f64::INFINITY, f64::min);
    if !levels.are_one() {
        let gains: Vec<f64> =
            levels.whites.iter().zip(&darkest).map(|(own, d)| (white - black) / (own - d)).collect();
        for ((channel, y, x), value) in planes.indexed_iter_mut() {
            let light = f64::from(*value) - levels.black([channel, y, x]);
            #[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
            let levelled = (black + light * gains[channel]) as f32;
            *value = levelled;
        }
    }
    Ok(RawMetadata { black, white, ..RawMetadata::default() })
}

impl Levels {
    fn of(
        (channels, height, width): (usize, usize, usize),
        raw: &Directory<'_>,
        largest: Option<f64>,
    ) -> Result<Self, String> {
        let unit = largest.unwrap_or(1.0);
        let in_planes = |levels: Vec<f64>| levels.into_iter().map(|level| level / unit).collect::<Vec<_>>();
        let pattern = match raw.numbers(BLACK_LEVEL_REPEAT).as_deref() {
            None => [1, 1],
            Some(&[rows, columns]) => [rows, columns],
            Some(_) => return Err("is damaged: its black levels have no repeat pattern".into()),
        };
        let added = |tag: u16, count: usize| {
            let levels = raw.reals(tag).map_or(vec![0.0; count], in_planes);
            (levels.len() == count && levels.iter().all(|level| level.is_finite()))
                .then_some(levels)
                .ok_or("is damaged: its black levels of rows or columns do not fit its size")
        };
        let mut levels = Self {
            whites: whites(raw, channels, largest),
            blacks: raw.reals(BLACK_LEVEL).map_or(vec![0.0], in_planes),
            pattern,
            of_columns: added(BLACK_LEVEL_OF_COLUMN, width)?,
            of_rows: added(BLACK_LEVEL_OF_ROW, height)?,
        };
        // Some writers give one level a channel and leave the repeat pattern out.
        let [rows, columns] = pattern;
        let count = rows.checked_mul(columns).and_then(|sites| sites.checked_mul(channels));
        let found = levels.blacks.len();
        if found > 0 && is_even(&levels.blacks) {
            levels.blacks.truncate(1);
        } else if levels.blacks.iter().any(|level| !level.is_finite()) {
            return Err("is damaged: its black levels are no numbers".into());
        } else if count != Some(found) {
            return Err(format!("is damaged: {found} black levels for {rows} × {columns} photosites"));
        }
        Ok(levels)
    }

    /// Whether all photosites have the same levels.
    fn are_one(&self) -> bool {
        [&self.whites, &self.blacks, &self.of_columns, &self.of_rows]
            .into_iter()
            .all(|levels| is_even(levels))
    }

    fn black(&self, [channel, y, x]: [usize; 3]) -> f64 {
        let [rows, columns] = self.pattern;
        let is_one = self.blacks.len() == 1;
        let site = if is_one { 0 } else { (y % rows * columns + x % columns) * self.whites.len() + channel };
        self.blacks[site] + self.of_columns[x] + self.of_rows[y]
    }

    /// The highest black level that a plane may have: of the pattern, of columns and of rows, as the specification's own
    /// program adds them.
    fn highest_black(&self, channel: usize) -> f64 {
        let is_one = self.blacks.len() == 1;
        let of_pattern = self.blacks.iter().skip(if is_one { 0 } else { channel }).step_by(self.whites.len());
        highest(of_pattern) + highest(self.of_columns.iter()) + highest(self.of_rows.iter())
    }
}

/// The white level of each plane: the largest number that the file's samples hold, where it says none or a higher one.
fn whites(raw: &Directory<'_>, channels: usize, largest: Option<f64>) -> Vec<f64> {
    let Some(largest) = largest else {
        let said = raw.reals(WHITE_LEVEL).unwrap_or_else(|| vec![1.0]);
        return of_planes(said, channels);
    };
    let whole =
        raw.number(BITS).filter(|bits| *bits < 16).map_or(largest, |bits| f64::from((1_u32 << bits) - 1));
    let said = raw.reals(WHITE_LEVEL).unwrap_or_else(|| vec![whole]);
    of_planes(said, channels).into_iter().map(|level| (level / largest).min(1.0)).collect()
}

/// A level for each plane; the lowest for all where the file has another number of them.
fn of_planes(levels: Vec<f64>, channels: usize) -> Vec<f64> {
    if levels.len() == channels {
        return levels;
    }
    vec![levels.into_iter().fold(f64::INFINITY, f64::min); channels]
}

fn highest<'a>(levels: impl Iterator<Item = &'a f64>) -> f64 {
    levels.copied().fold(f64::NEG_INFINITY, f64::max)
}

fn mean(levels: &[f64]) -> f64 {
    levels.iter().sum::<f64>() / levels.len() as f64
}

fn is_even(levels: &[f64]) -> bool {
    levels.iter().all(|&level| (level - levels[0]).abs() < f64::EPSILON)
}
