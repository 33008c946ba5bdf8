//! Rows of an image by their number, whether all of them are held or only a rolling window.

/// Read access to the rows of one image.
///
/// Row `y` lies in slot `y % slots` of `data`: with as many slots as rows this is a whole image, with fewer a
/// window that rolls down the image.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a> {
    data: &'a [f32],
    slots: usize,
    height: usize,
    row_len: usize,
}

impl<'a> Rows<'a> {
    /// Views a whole image.
    pub(crate) fn whole(data: &'a [f32], height: usize) -> Self {
        Self::window(data, height, height)
    }

    /// Views a window of `slots` rows on an image of `height` rows.
    pub(crate) fn window(data: &'a [f32], slots: usize, height: usize) -> Self {
        assert!(slots > 0 && data.len().is_multiple_of(slots), "{} floats in {slots} rows", data.len());
        Self { data, slots, height, row_len: data.len() / slots }
    }

    /// Floats per row.
    pub(crate) fn row_len(&self) -> usize {
        self.row_len
    }

    /// Row `y`, or nothing when it lies outside of the image.
    #[inline]
    pub(crate) fn row(&self, y: isize) -> Option<&'a [f32]> {
        let y = usize::try_from(y).ok().filter(|y| *y < self.height)?;
        let start = y % self.slots * self.row_len;
        Some(&self.data[start..start + self.row_len])
    }

    /// Row `y`, or the nearest one of the image: replicate padding.
    #[inline]
    pub(crate) fn nearest_row(&self, y: isize) -> &'a [f32] {
        let last = self.height.cast_signed() - 1;
        self.row(y.clamp(0, last)).expect("the image has rows")
    }
}
