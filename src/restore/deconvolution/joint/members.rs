//! Numbers of the members of a set of pixels: a few percent of a plane.

use ndarray::{Array2, Axis};
use rayon::prelude::*;

use super::frame::row;

/// A number for each member of a set, row by row.
#[derive(Clone, Default)]
pub(super) struct OfMembers {
    /// Where the numbers of each row end.
    ends: Vec<usize>,
    numbers: Vec<f32>,
}

impl OfMembers {
    /// Those of a function of the members' places.
    pub(super) fn new(set: &Array2<bool>, number: impl Fn([usize; 2]) -> f32 + Sync) -> Self {
        let of_row = |y: usize| members(row(set, y)).map(|x| number([y, x])).collect::<Vec<_>>();
        let rows: Vec<_> = (0..set.nrows()).into_par_iter().map(of_row).collect();
        let sum = |end: &mut usize, numbers: &Vec<f32>| {
            *end += numbers.len();
            Some(*end)
        };
        Self { ends: rows.iter().scan(0, sum).collect(), numbers: rows.concat() }
    }

    /// Other numbers of the same members, each of its place and of what it was.
    pub(super) fn map(&self, set: &Array2<bool>, number: impl Fn([usize; 2], f32) -> f32) -> Self {
        let of_row = |y: usize| members(row(set, y)).zip(self.row(y)).map(move |(x, was)| ([y, x], *was));
        let numbers = (0..set.nrows()).flat_map(of_row).map(|(place, was)| number(place, was)).collect();
        Self { ends: self.ends.clone(), numbers }
    }

    /// The largest number, or zero.
    pub(super) fn largest(&self) -> f32 {
        self.numbers.iter().fold(0.0, |most: f32, number| most.max(*number))
    }

    /// The numbers of a row's members, from left to right.
    pub(super) fn row(&self, y: usize) -> &[f32] {
        let start = if y == 0 { 0 } else { self.ends[y - 1] };
        &self.numbers[start..self.ends[y]]
    }

    /// Gives the numbers of the `set` to its members in a plane that begins as the set does, and may be larger.
    pub(super) fn write(&self, set: &Array2<bool>, plane: &mut Array2<f32>) {
        let rows = plane.axis_iter_mut(Axis(0)).into_par_iter().take(set.nrows()).enumerate();
        rows.for_each(|(y, mut out)| {
            for (x, number) in members(row(set, y)).zip(self.row(y)) {
                out[x] = *number;
            }
        });
    }
}

/// Pixels of a row that are looked at side by side for members: most have none.
const TOGETHER: usize = 64;

/// The members of a row.
pub(super) fn members(row: &[bool]) -> impl Iterator<Item = usize> {
    let parts = row.chunks(TOGETHER).zip((0..).step_by(TOGETHER)).filter(|(part, _)| has_members(part));
    parts.flat_map(|(part, first)| {
        part.iter().enumerate().filter(|(_, is_member)| **is_member).map(move |(x, _)| first + x)
    })
}

/// Whether some pixels have a member among them; all are looked at, as many at once as there is place for.
pub(super) fn has_members(pixels: &[bool]) -> bool {
    pixels.iter().fold(false, |any, is_member| any | is_member)
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn members_have_their_numbers() {
        let set = array![[false, true, true], [false, false, false], [true, false, false]];
        let of_members = OfMembers::new(&set, |[y, x]| (10 * y + x) as f32);
        assert_eq!([0, 1, 2].map(|y| of_members.row(y).to_vec()), [vec![1.0, 2.0], vec![], vec![20.0]]);
        let mapped = of_members.map(&set, |[y, x], was| was + 1000.0 * y as f32 + 100.0 * x as f32);
        assert_eq!(mapped.numbers, [101.0, 202.0, 2020.0]);
        let mut plane = Array2::from_elem((4, 5), 7.0);
        of_members.write(&set, &mut plane);
        assert_eq!(
            plane,
            array![
                [7.0, 1.0, 2.0, 7.0, 7.0],
                [7.0, 7.0, 7.0, 7.0, 7.0],
                [20.0, 7.0, 7.0, 7.0, 7.0],
                [7.0, 7.0, 7.0, 7.0, 7.0],
            ]
        );
    }
}
