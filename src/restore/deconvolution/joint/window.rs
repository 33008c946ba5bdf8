//! The part of a frame that matters to some of its pixels.

use std::ops::Range;

use ndarray::{Array2, ArrayView1, ArrayView2, Dim, SliceInfo, SliceInfoElem, s};

use super::members::has_members;

/// Rows and columns of a plane, as a slice.
pub(super) type Slices = SliceInfo<[SliceInfoElem; 2], Dim<[usize; 2]>, Dim<[usize; 2]>>;

/// Side of the cells that members of a set are gathered in before windows are, in pixels.
const CELL_PX: usize = 64;

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
    #[cfg(test)]
    pub(super) fn around(set: &Array2<bool>, near: [usize; 2]) -> Option<Self> {
        Some(Self::of_members(set.view())?.grown(near, set.dim()))
    }

    /// Windows that have all that is at most so many pixels along rows and columns from a member of a set, and share no pixel.
    pub(super) fn apart(set: &Array2<bool>, near: [usize; 2]) -> Vec<Self> {
        let starts = |length: usize| (0..length).step_by(CELL_PX);
        let cells = starts(set.nrows()).flat_map(|y| starts(set.ncols()).map(move |x| [y, x]));
        let mut apart: Vec<Self> = Vec::new();
        for [y, x] in cells {
            let cell = set.slice(s![y..set.nrows().min(y + CELL_PX), x..set.ncols().min(x + CELL_PX)]);
            let Some(members) = Self::of_members(cell) else { continue };
            let mut window = members.moved([y, x]).grown(near, set.dim());
            // What it now meets may meet others in turn.
            while let Some(met) = apart.iter().position(|other| other.meets(&window)) {
                window = window.united(&apart.swap_remove(met));
            }
            apart.push(window);
        }
        apart
    }

    /// The least that has all members of a set, if it has any.
    fn of_members(set: ArrayView2<'_, bool>) -> Option<Self> {
        let of_row = |(y, row): (usize, ArrayView1<'_, bool>)| {
            if row.to_slice().is_some_and(|row| !has_members(row)) {
                return None;
            }
            let first = row.iter().position(|member| *member)?;
            let last = row.iter().rposition(|member| *member)?;
            Some(Self { rows: y..y + 1, columns: first..last + 1 })
        };
        set.rows().into_iter().enumerate().filter_map(of_row).reduce(|a, b| a.united(&b))
    }

    fn moved(&self, [down, along]: [usize; 2]) -> Self {
        let moved = |range: &Range<usize>, by: usize| range.start + by..range.end + by;
        Self { rows: moved(&self.rows, down), columns: moved(&self.columns, along) }
    }

    /// With so many pixels more on every side, as far as the frame goes.
    fn grown(&self, [above, beside]: [usize; 2], (height, width): (usize, usize)) -> Self {
        let grown = |range: &Range<usize>, pixels: usize, length: usize| {
            range.start.saturating_sub(pixels)..(range.end + pixels).min(length)
        };
        Self { rows: grown(&self.rows, above, height), columns: grown(&self.columns, beside, width) }
    }

    fn meets(&self, other: &Self) -> bool {
        let meet = |a: &Range<usize>, b: &Range<usize>| a.start < b.end && b.start < a.end;
        meet(&self.rows, &other.rows) && meet(&self.columns, &other.columns)
    }

    /// The least window that has both.
    fn united(&self, other: &Self) -> Self {
        let united = |a: &Range<usize>, b: &Range<usize>| a.start.min(b.start)..a.end.max(b.end);
        Self { rows: united(&self.rows, &other.rows), columns: united(&self.columns, &other.columns) }
    }

    /// Height and width.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.rows.len(), self.columns.len()]
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
        assert_eq!(window.size(), [15, 9]);
        assert_eq!(window.cut(set.view()).iter().filter(|member| **member).count(), 2);
        set[[0, 79]] = true;
        assert_eq!(Window::around(&set, [5, 3]), Some(Window { rows: 0..30, columns: 28..80 }));
        assert_eq!(Window::around(&set, [400, 400]), Some(Window::whole([60, 80])));
    }

    #[test]
    fn windows_that_share_no_pixel_have_what_is_near_to_any_member() {
        let mut set = Array2::from_elem((300, 400), false);
        assert_eq!(Window::apart(&set, [4, 2]), []);
        for place in [[10, 10], [12, 70], [200, 317], [205, 326], [100, 100], [299, 0]] {
            set[place] = true;
        }
        let near = [5, 3];
        let windows = Window::apart(&set, near);
        // Two are nearer to one another than that, one of each in another cell.
        assert_eq!(windows.len(), 6, "{windows:?}");
        assert_eq!(Window::apart(&set, [5, 5]).len(), 5);
        // One that meets two unites them.
        assert_eq!(Window::apart(&set, [60, 40]).len(), 3);
        for (at, window) in windows.iter().enumerate() {
            assert!(windows[..at].iter().all(|other| !other.meets(window)));
        }
        let count = |window: &Window| window.cut(set.view()).iter().filter(|member| **member).count();
        assert_eq!(windows.iter().map(count).sum::<usize>(), 6);
        assert_eq!(Window::apart(&set, [400, 400]), [Window::whole([300, 400])]);
    }
}
