//! Rows of an image by their number, whether they lie one after another or scattered.

use super::slots::Slots;

/// Read access to the rows of one image.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a> {
    memory: Memory<'a>,
    height: usize,
    row_len: usize,
}

#[derive(Clone, Copy)]
enum Memory<'a> {
    /// All rows, one after another.
    Whole(&'a [f32]),
    /// Some rows, `unit` of them in each slot: row `y` lies in slot `places[(y + shift) / unit]`.
    Scattered { slots: &'a Slots<'a>, places: &'a [usize], unit: usize, shift: usize },
}

impl<'a> Rows<'a> {
    /// Views a whole image.
    pub(crate) fn whole(data: &'a [f32], height: usize) -> Self {
        assert!(height > 0 && data.len().is_multiple_of(height), "{} floats in {height} rows", data.len());
        Self { memory: Memory::Whole(data), height, row_len: data.len() / height }
    }

    /// Views those rows of an image of `height` rows that the slots hold at the moment, `unit` in each but the
    /// first, which lacks `shift`.
    ///
    /// # Safety
    /// While the view and what it returns live, nobody writes the rows that are asked for.
    pub(crate) unsafe fn scattered(
        slots: &'a Slots<'a>,
        places: &'a [usize],
        (unit, shift): (usize, usize),
        (height, row_len): (usize, usize),
    ) -> Self {
        Self { memory: Memory::Scattered { slots, places, unit, shift }, height, row_len }
    }

    /// Floats per row.
    pub(crate) fn row_len(&self) -> usize {
        self.row_len
    }

    /// Row `y`, or nothing when it lies outside of the image.
    #[inline]
    pub(crate) fn row(&self, y: isize) -> Option<&'a [f32]> {
        let y = usize::try_from(y).ok().filter(|y| *y < self.height)?;
        Some(match self.memory {
            Memory::Whole(data) => &data[y * self.row_len..][..self.row_len],
            Memory::Scattered { slots, places, unit, shift } => {
                let (place, at) = (places[(y + shift) / unit], (y + shift) % unit * self.row_len);
                // SAFETY: what the view's maker promised.
                unsafe { slots.read(place, at..at + self.row_len) }
            }
        })
    }

    /// Row `y`, or the nearest one of the image: replicate padding.
    #[inline]
    pub(crate) fn nearest_row(&self, y: isize) -> &'a [f32] {
        let last = self.height.cast_signed() - 1;
        self.row(y.clamp(0, last)).expect("the image has rows")
    }
}
