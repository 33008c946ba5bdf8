//! Tells rows and columns of a capture that hold nothing: bars above and below a picture, dead lines of a sensor.
//!
//! Behind a panel there is haze everywhere. A line that is zero from end to end was not seen through it, and no PSF explains what is
//! beside it.

use std::fmt;

use ndarray::{ArrayView3, Axis};
use serde::Serialize;

use crate::io::AnyImage;

/// Pixels that a line has at least for its zeros to tell anything.
const LEAST_PX: usize = 16;

/// The part of all other values that are not zero at least: of photons that are counted one by one, many lines are empty.
const LEAST_LIGHT: f64 = 0.2;

/// Rows and columns of a capture that are zero in all colours, as first and last ones.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct EmptyLines {
    /// From the top on, the first row being 0.
    pub rows: Vec<[usize; 2]>,
    /// From the left on.
    pub columns: Vec<[usize; 2]>,
}

impl fmt::Display for EmptyLines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines = [("row", &self.rows), ("column", &self.columns)];
        let lines: Vec<String> =
            lines.into_iter().filter_map(|(name, lines)| in_words(name, lines)).collect();
        write!(
            f,
            "its {} hold nothing and are taken for darkness, of which there is none behind a panel: what is near them is spoilt; cut bars \
             off, and fill dead lines from beside them",
            lines.join(" and ")
        )
    }
}

/// Lines of this kind, if there are any.
fn in_words(name: &str, lines: &[[usize; 2]]) -> Option<String> {
    /// Those that are named.
    const MOST_NAMED: usize = 4;
    let count: usize = lines.iter().map(|[first, last]| last + 1 - first).sum();
    let of_range = |[first, last]: &[usize; 2]| match first == last {
        true => first.to_string(),
        false => format!("{first} to {last}"),
    };
    let mut named: Vec<String> = lines.iter().take(MOST_NAMED).map(of_range).collect();
    if lines.len() > MOST_NAMED {
        named.push("others".to_owned());
    }
    let plural = if count == 1 { "" } else { "s" };
    (count > 0).then(|| format!("{name}{plural} {}", named.join(", ")))
}

impl EmptyLines {
    /// Those of a capture, if it has any, and light beside them.
    pub(super) fn of(image: &AnyImage) -> Option<Self> {
        match image {
            AnyImage::Linear(image) => Self::of_planes(image.planes()),
            AnyImage::ToneMapped(image, _) => Self::of_planes(image.planes()),
        }
    }

    fn of_planes(planes: ArrayView3<'_, f32>) -> Option<Self> {
        let (_, height, width) = planes.dim();
        let [rows, columns] = [(1, width), (2, height)].map(|(axis, length)| match length >= LEAST_PX {
            true => empty(planes, Axis(axis)),
            false => Vec::new(),
        });
        if rows.is_empty() && columns.is_empty() {
            return None;
        }
        let left = |lines: &[[usize; 2]], all: usize| {
            all - lines.iter().map(|[first, last]| last + 1 - first).sum::<usize>()
        };
        let others = planes.dim().0 * left(&rows, height) * left(&columns, width);
        let lit = planes.iter().filter(|value| **value != 0.0).count();
        (others > 0 && lit as f64 >= LEAST_LIGHT * others as f64).then_some(Self { rows, columns })
    }
}

/// The lines across an axis that are zero.
fn empty(planes: ArrayView3<'_, f32>, axis: Axis) -> Vec<[usize; 2]> {
    let mut ranges: Vec<[usize; 2]> = Vec::new();
    for (index, line) in planes.axis_iter(axis).enumerate() {
        if line.iter().any(|value| *value != 0.0) {
            continue;
        }
        match ranges.last_mut() {
            Some([_, last]) if *last + 1 == index => *last = index,
            _ => ranges.push([index, index]),
        }
    }
    ranges
}

#[cfg(test)]
mod tests {
    use ndarray::{Array3, s};

    use super::*;
    use crate::core::image::{CHANNELS, LinearImage};

    fn lines(planes: Array3<f32>) -> Option<EmptyLines> {
        EmptyLines::of(&AnyImage::Linear(LinearImage::from_planes(planes).unwrap()))
    }

    #[test]
    fn bars_and_dead_lines_are_told() {
        let mut planes = Array3::from_elem((CHANNELS, 40, 60), 0.3);
        assert_eq!(lines(planes.clone()), None);
        planes.slice_mut(s![.., ..5, ..]).fill(0.0);
        planes.slice_mut(s![.., 39, ..]).fill(0.0);
        planes.slice_mut(s![.., .., 17]).fill(0.0);
        let found = lines(planes.clone()).unwrap();
        assert_eq!((&found.rows[..], &found.columns[..]), (&[[0, 4], [39, 39]][..], &[[17, 17]][..]));
        assert!(found.to_string().starts_with("its rows 0 to 4, 39 and column 17 hold nothing"), "{found}");
    }

    #[test]
    fn lines_of_one_colour_darkness_and_few_pixels_are_none() {
        let mut planes = Array3::from_elem((CHANNELS, 40, 60), 0.3);
        planes.slice_mut(s![0, 3, ..]).fill(0.0);
        assert_eq!(lines(planes), None, "red alone");
        assert_eq!(lines(Array3::zeros((CHANNELS, 40, 60))), None);
        let mut few = Array3::from_elem((CHANNELS, 40, 9), 0.3);
        few.slice_mut(s![.., 3, ..]).fill(0.0);
        assert_eq!(lines(few), None);
        let counted = Array3::from_shape_fn((CHANNELS, 40, 60), |(_, y, x)| {
            if y % 5 == 0 && (x + y) % 16 == 0 { 1.0 } else { 0.0 }
        });
        assert_eq!(lines(counted), None, "photons");
    }
}
