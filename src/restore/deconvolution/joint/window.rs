//! The part of a frame that matters to some of its pixels.

use std::ops::Range;

use ndarray::{Array2, ArrayView1, ArrayView2, Dim, SliceInfo, SliceInfoElem, s};

/// Rows and columns of a plane, as a slice.
pub(super) type Slices = SliceInfo<[SliceInfoElem; 2], Dim<[usize; 2]>, Dim<[usize; 2]>>;

/// Rows and columns of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Window {
    rows: Range<usize>,
    columns: Range<usize>,
}

impl Window {
    /// All of a frame.
    pub(super) fn whole([height, width]: [usize; 2]) -> Self {
        Self { rows: 0..height, columns: 0..width }
    }

    /// The rows and columns that are at most so many pixels from those of a member of a set, if it has any.
    pub(super) fn around(set: &Array2<bool>, [above, beside]: [usize; 2]) -> Option<Self> {
        let of_row = |(y, row): (usize, ArrayView1<'_, bool>)| {
            let first = row.iter().position(|member| *member)?;
            Some([[y, y], [first, row.iter().rposition(|member| *member)?]])
        };
        let of_rows = set.rows().into_iter().enumerate().filter_map(of_row);
        let [rows, columns] = of_rows.reduce(|a, b| {
            std::array::from_fn(|axis| [a[axis][0].min(b[axis][0]), a[axis][1].max(b[axis][1])])
        })?;
        let grown = |[first, last]: [usize; 2], pixels: usize, length: usize| {
            first.saturating_sub(pixels)..(last + 1 + pixels).min(length)
        };
        Some(Self { rows: grown(rows, above, set.nrows()), columns: grown(columns, beside, set.ncols()) })
    }

    /// Height and width.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.rows.len(), self.columns.len()]
    }

    /// The place in it of a place of the frame.
    pub(super) fn place(&self, [y, x]: [usize; 2]) -> [usize; 2] {
        [y - self.rows.start, x - self.columns.start]
    }

    pub(super) fn slices(&self) -> Slices {
        let Self { rows, columns } = self.clone();
        s![rows, columns]
    }

    /// What a plane of the frame's size has there.
    pub(super) fn cut<'p, T>(&self, plane: ArrayView2<'p, T>) -> ArrayView2<'p, T> {
        plane.slice_move(self.slices())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_has_what_is_near_to_a_set() {
        let mut set = Array2::from_elem((60, 80), false);
        assert_eq!(Window::around(&set, [4, 2]), None);
        set[[20, 33]] = true;
        set[[24, 31]] = true;
        let window = Window::around(&set, [5, 3]).unwrap();
        assert_eq!(window, Window { rows: 15..30, columns: 28..37 });
        assert_eq!((window.size(), window.place([20, 33])), ([15, 9], [5, 5]));
        assert_eq!(window.cut(set.view()).iter().filter(|member| **member).count(), 2);
        set[[0, 79]] = true;
        assert_eq!(Window::around(&set, [5, 3]), Some(Window { rows: 0..30, columns: 28..80 }));
        assert_eq!(Window::around(&set, [400, 400]), Some(Window::whole([60, 80])));
    }
}
