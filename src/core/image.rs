//! Turns raw planes of numbers into images whose type states their domain.
//!
//! An [`Image`] is RGB, planar, `[3, height, width]`, 32-bit float, finite and never empty. A linear image
//! and a tone-mapped one are different types, so that a metric taken in the wrong domain does not compile.

use std::marker::PhantomData;

use ndarray::{Array3, ArrayView2, ArrayView3, Axis, s};
use rayon::prelude::*;

use super::error::{Error, Result};

/// Number of colour channels of every image: red, green, blue.
pub const CHANNELS: usize = 3;

/// The meaning of an image's values; implemented by [`Linear`] and [`ToneMapped`] only.
pub trait Domain: Copy + Send + Sync + std::fmt::Debug + 'static {
    /// The name written to files and shown to users.
    const NAME: &'static str;
}

/// Scene light on the sensor, proportional to irradiance, unbounded above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Linear;

/// Linear light compressed by φ(x) = x/(x+α) to `[0, 1)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToneMapped;

impl Domain for Linear {
    const NAME: &'static str = "linear";
}

impl Domain for ToneMapped {
    const NAME: &'static str = "tone-mapped";
}

/// A finite, non-empty RGB image of domain `D`.
///
/// # Shapes
/// `[3, height, width]`, C-contiguous.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<D> {
    planes: Array3<f32>,
    domain: PhantomData<D>,
}

/// Linear irradiance.
pub type LinearImage = Image<Linear>;

/// An image after the tone mapping φ.
pub type ToneMappedImage = Image<ToneMapped>;

impl<D: Domain> Image<D> {
    /// Takes planes over as an image.
    ///
    /// # Errors
    /// [`Error::Shape`] when there are not three channels or a side is zero; [`Error::Unsupported`] naming
    /// the first pixel that is NaN or infinite.
    pub fn from_planes(planes: Array3<f32>) -> Result<Self> {
        let (channels, height, width) = planes.dim();
        if channels != CHANNELS || height == 0 || width == 0 {
            let found = format!("{channels} channels of {height} × {width}");
            return Err(Error::shape("image", "3 channels of at least 1 × 1", found));
        }
        let planes = into_standard_layout(planes);
        if let Some(((c, y, x), value)) = first_non_finite(&planes) {
            return Err(Error::Unsupported(format!(
                "the image holds {value} at row {y}, column {x}, channel {c}; replace such pixels by numbers \
                 before using it"
            )));
        }
        Ok(Self { planes, domain: PhantomData })
    }

    /// Computes a new image of another (or the same) domain, value by value.
    ///
    /// # Panics
    /// When `f` makes a finite value non-finite: a broken invariant of the caller.
    pub fn map_values<E: Domain>(&self, f: impl Fn(f32) -> f32 + Sync + Send) -> Image<E> {
        self.clone().map_in_place(f)
    }

    /// As [`map_values`](Self::map_values), in the memory of this image.
    ///
    /// # Panics
    /// As [`map_values`](Self::map_values).
    pub fn map_in_place<E: Domain>(self, f: impl Fn(f32) -> f32 + Sync + Send) -> Image<E> {
        let mut planes = self.planes;
        planes.par_mapv_inplace(f);
        debug_assert!(planes.iter().all(|v| v.is_finite()), "a value map must keep values finite");
        Image { planes, domain: PhantomData }
    }

    /// The image's planes, `[3, height, width]`.
    pub fn planes(&self) -> ArrayView3<'_, f32> {
        self.planes.view()
    }

    /// One channel, `[height, width]`; 0 is red.
    pub fn channel(&self, channel: usize) -> ArrayView2<'_, f32> {
        self.planes.index_axis(Axis(0), channel)
    }

    /// All values in `[3, height, width]` order.
    ///
    /// # Panics
    /// Never: images are kept C-contiguous.
    pub fn as_slice(&self) -> &[f32] {
        self.planes.as_slice().expect("images are kept C-contiguous")
    }

    /// Gives the planes back.
    pub fn into_planes(self) -> Array3<f32> {
        self.planes
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.planes.dim().1
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.planes.dim().2
    }

    /// The largest value of any channel.
    pub fn max(&self) -> f32 {
        self.as_slice().iter().copied().fold(f32::NEG_INFINITY, f32::max)
    }

    /// Copies the window of `height` × `width` pixels whose first pixel is (`top`, `left`).
    ///
    /// # Panics
    /// When the window reaches outside of the image.
    pub fn crop(&self, top: usize, left: usize, height: usize, width: usize) -> Self {
        let window = self.planes.slice(s![.., top..top + height, left..left + width]);
        Self { planes: window.to_owned(), domain: PhantomData }
    }
}

/// A row of a plane.
///
/// # Panics
/// For planes whose rows do not lie in memory as they are.
pub(crate) fn row_of<'a, T>(plane: ArrayView2<'a, T>, y: usize) -> &'a [T] {
    plane.slice_move(s![y, ..]).to_slice().expect("rows are contiguous")
}

/// Whether no value is NaN or infinite.
pub(crate) fn all_finite(values: &[f32]) -> bool {
    const SHARE: usize = 1 << 14;
    // Without an early end, so that whole vectors are looked at.
    values
        .par_chunks(SHARE)
        .all(|values| values.iter().fold(true, |finite, value| finite & value.is_finite()))
}

fn into_standard_layout(planes: Array3<f32>) -> Array3<f32> {
    if planes.is_standard_layout() { planes } else { planes.as_standard_layout().into_owned() }
}

pub(crate) fn first_non_finite(planes: &Array3<f32>) -> Option<((usize, usize, usize), f32)> {
    if planes.as_slice().is_some_and(all_finite) {
        return None;
    }
    planes.indexed_iter().find(|(_, v)| !v.is_finite()).map(|(index, v)| (index, *v))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_the_first_pixel_that_is_not_finite() {
        let mut planes = Array3::zeros((3, 4, 5));
        planes[[1, 2, 3]] = f32::NAN;
        let message = LinearImage::from_planes(planes).unwrap_err().to_string();
        assert!(message.contains("NaN at row 2, column 3, channel 1"), "{message}");
    }

    #[test]
    fn refuses_an_empty_image() {
        assert!(LinearImage::from_planes(Array3::zeros((3, 0, 4))).is_err());
        assert!(LinearImage::from_planes(Array3::zeros((4, 4, 4))).is_err());
    }

    #[test]
    fn crops_the_window_asked_for() {
        let planes = Array3::from_shape_fn((3, 6, 7), |(c, y, x)| (c * 100 + y * 10 + x) as f32);
        let window = LinearImage::from_planes(planes).unwrap().crop(2, 3, 2, 4);
        assert_eq!((window.height(), window.width()), (2, 4));
        assert_eq!(window.planes()[[1, 0, 0]], 123.0);
    }
}
