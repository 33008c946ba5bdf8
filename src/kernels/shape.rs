//! The extent of a batch of images.

/// Extent of an NHWC tensor: images, rows, columns, channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of images.
    pub images: usize,
    /// Rows of each.
    pub height: usize,
    /// Columns of each.
    pub width: usize,
    /// Numbers per pixel.
    pub channels: usize,
}

impl Shape {
    /// Names the four extents in memory order.
    pub fn new(images: usize, height: usize, width: usize, channels: usize) -> Self {
        Self { images, height, width, channels }
    }

    /// Counts the tensor's numbers.
    ///
    /// # Panics
    /// When no memory could hold so many, as [`Shape::image_len`] and [`Shape::row_len`] do.
    pub fn len(&self) -> usize {
        self.product(self.images, self.image_len())
    }

    /// Tells whether there is no pixel or no channel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Counts the numbers of one image.
    ///
    /// # Panics
    /// When no memory could hold so many.
    pub fn image_len(&self) -> usize {
        self.product(self.height, self.row_len())
    }

    /// Counts the numbers of one row.
    ///
    /// # Panics
    /// When no memory could hold so many.
    pub fn row_len(&self) -> usize {
        self.product(self.width, self.channels)
    }

    /// A count that has not wrapped around: slices are checked against it before they are read without checks.
    fn product(&self, a: usize, b: usize) -> usize {
        a.checked_mul(b).unwrap_or_else(|| panic!("{self:?} has more numbers than memory has places"))
    }

    /// Counts the pixels of all images.
    pub fn pixels(&self) -> usize {
        self.images * self.height * self.width
    }

    /// The same images with another number of channels.
    pub fn with_channels(self, channels: usize) -> Self {
        Self { channels, ..self }
    }
}
