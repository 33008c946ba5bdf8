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
    pub fn len(&self) -> usize {
        self.images * self.image_len()
    }

    /// Tells whether there is no pixel or no channel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Counts the numbers of one image.
    pub fn image_len(&self) -> usize {
        self.height * self.row_len()
    }

    /// Counts the numbers of one row.
    pub fn row_len(&self) -> usize {
        self.width * self.channels
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
