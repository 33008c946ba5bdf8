//! Says how a picture lies on the sensor, and puts it upright.

use std::fmt;
use std::str::FromStr;

use ndarray::{Array3, Axis};
use serde::{Deserialize, Serialize};

/// Where the top and the left of a picture lie in its samples, as TIFF and EXIF number it (TIFF 6.0, tag 274).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct Orientation(Placing);

/// The visual side of row 0, then that of column 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Placing {
    #[default]
    TopLeft = 1,
    TopRight,
    BottomRight,
    BottomLeft,
    LeftTop,
    RightTop,
    RightBottom,
    LeftBottom,
}

use Placing::{BottomLeft, BottomRight, LeftBottom, LeftTop, RightBottom, RightTop, TopLeft, TopRight};

impl Orientation {
    /// All eight, in the order of their numbers.
    pub const ALL: [Self; 8] = [
        Self(TopLeft),
        Self(TopRight),
        Self(BottomRight),
        Self(BottomLeft),
        Self(LeftTop),
        Self(RightTop),
        Self(RightBottom),
        Self(LeftBottom),
    ];

    /// The orientation of a number from 1 to 8; none for other numbers.
    pub fn from_exif(number: usize) -> Option<Self> {
        Self::ALL.get(number.checked_sub(1)?).copied()
    }

    /// The number, from 1 to 8.
    pub fn exif(self) -> u8 {
        self.0 as u8
    }

    /// Whether the samples lie as the picture is seen.
    pub fn is_upright(self) -> bool {
        self.0 == TopLeft
    }

    /// Puts planes `[channel, row, column]` upright; 5 to 8 exchange height and width.
    pub fn upright(self, planes: Array3<f32>) -> Array3<f32> {
        if self.is_upright() {
            return planes;
        }
        let mut view = planes.view();
        if matches!(self.0, LeftTop | RightTop | RightBottom | LeftBottom) {
            view.swap_axes(1, 2);
        }
        if matches!(self.0, BottomRight | BottomLeft | RightBottom | LeftBottom) {
            view.invert_axis(Axis(1));
        }
        if matches!(self.0, TopRight | BottomRight | RightTop | RightBottom) {
            view.invert_axis(Axis(2));
        }
        view.as_standard_layout().into_owned()
    }
}

impl FromStr for Orientation {
    type Err = String;

    /// Reads the number of EXIF.
    fn from_str(text: &str) -> Result<Self, String> {
        let number = text.parse().ok();
        number.and_then(Self::from_exif).ok_or_else(|| "write a number from 1 to 8".to_owned())
    }
}

impl fmt::Display for Orientation {
    /// What is to be done to put it upright.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            TopLeft => "upright",
            TopRight => "mirrored",
            BottomRight => "upside down",
            BottomLeft => "mirrored, upside down",
            LeftTop => "mirrored, to be turned left",
            RightTop => "to be turned right",
            RightBottom => "mirrored, to be turned right",
            LeftBottom => "to be turned left",
        })
    }
}

impl TryFrom<u8> for Orientation {
    type Error = String;

    fn try_from(number: u8) -> Result<Self, String> {
        Self::from_exif(usize::from(number)).ok_or_else(|| format!("{number} is no orientation from 1 to 8"))
    }
}

impl From<Orientation> for u8 {
    fn from(orientation: Orientation) -> Self {
        orientation.exif()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The letter F as the eight pictures of the TIFF and EXIF documentation show it, first row above.
    const STORED: [&str; 8] = [
        "##|#.|##|#.|#.",
        "##|.#|##|.#|.#",
        ".#|.#|##|.#|##",
        "#.|#.|##|#.|##",
        "#####|#.#..",
        "#.#..|#####",
        "..#.#|#####",
        "#####|..#.#",
    ];

    fn planes(text: &str) -> Array3<f32> {
        let rows: Vec<Vec<f32>> =
            text.split('|').map(|row| row.chars().map(|c| f32::from(u8::from(c == '#'))).collect()).collect();
        Array3::from_shape_fn((3, rows.len(), rows[0].len()), |(_, y, x)| rows[y][x])
    }

    #[test]
    fn is_read_as_the_number_of_exif() {
        assert_eq!("6".parse(), Ok(Orientation(RightTop)));
        assert!(["0", "9", "", "left"].iter().all(|text| text.parse::<Orientation>().is_err()));
    }

    #[test]
    fn all_eight_orientations_show_the_same_letter() {
        let upright = planes(STORED[0]);
        for (orientation, stored) in Orientation::ALL.into_iter().zip(STORED) {
            assert_eq!(orientation.upright(planes(stored)), upright, "{orientation:?}");
            assert_eq!(Orientation::from_exif(usize::from(orientation.exif())), Some(orientation));
        }
        assert_eq!((Orientation::from_exif(0), Orientation::from_exif(9)), (None, None));
    }
}
