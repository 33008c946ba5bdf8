//! Turns images and PSFs into 8-bit pictures, encoded as PNG.

use image::{ImageEncoder, Rgb, RgbImage};
use ndarray::{Array3, ArrayView3, s};

use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::psf::Psf;

/// Encodes a tone-mapped image, values 0 to 1, one picture pixel an image pixel.
///
/// The tone-mapped domain is close to perceptual lightness, so that its values are shown as they are.
pub fn tone_mapped(image: &ToneMappedImage) -> Vec<u8> {
    encode(image.planes(), |_, value| value)
}

/// Encodes a PSF on a logarithmic stretch: the peak of each channel is white, `decades` below it is black.
pub fn log_psf(psf: &Psf, decades: f32) -> Vec<u8> {
    let peaks: Vec<f32> =
        (0..3).map(|channel| psf.channel(channel).iter().copied().fold(0.0, f32::max)).collect();
    encode(psf.planes(), |channel, value| 1.0 + (value / peaks[channel]).max(1e-30).log10() / decades)
}

/// Encodes values of either sign: zero is mid-grey, the largest amount of each channel black or white; in between, the
/// square root of the amount, so that faint structure is seen.
pub fn signed(planes: ArrayView3<'_, f32>) -> Vec<u8> {
    let largest = |channel: usize| {
        let plane = planes.index_axis(ndarray::Axis(0), channel);
        plane.iter().map(|value| value.abs()).fold(f32::MIN_POSITIVE, f32::max)
    };
    let largest: Vec<f32> = (0..CHANNELS).map(largest).collect();
    encode(planes, |channel, value| 0.5 + 0.5 * (value.abs() / largest[channel]).sqrt().copysign(value))
}

/// Encodes the mean absolute difference of the channels of two images, `full_scale` and above being white.
///
/// # Panics
/// When the images differ in size.
pub fn difference(a: &ToneMappedImage, b: &ToneMappedImage, full_scale: f32) -> Vec<u8> {
    assert_eq!(a.planes().dim(), b.planes().dim(), "a difference needs images of one size");
    let mut mean = Array3::zeros(a.planes().dim());
    for channel in 0..3 {
        for source in 0..3 {
            let difference = (&a.channel(source) - &b.channel(source)).mapv(f32::abs) / (3.0 * full_scale);
            let mut plane = mean.index_axis_mut(ndarray::Axis(0), channel);
            plane += &difference;
        }
    }
    encode(mean.view(), |_, value| value)
}

/// White pixels between the pictures of a grid.
const GAP: usize = 6;

/// Encodes tone-mapped images of one size as one picture, row by row, with white between them.
///
/// # Panics
/// When the rows differ in length, or the images in size.
pub fn grid<R: AsRef<[ToneMappedImage]>>(rows: &[R]) -> Vec<u8> {
    let rows: Vec<&[ToneMappedImage]> = rows.iter().map(AsRef::as_ref).collect();
    let (_, height, width) = rows[0][0].planes().dim();
    let side = |count: usize, side: usize| count * (side + GAP) - GAP;
    let mut picture = Array3::ones((CHANNELS, side(rows.len(), height), side(rows[0].len(), width)));
    for (row, images) in rows.iter().enumerate() {
        assert_eq!(images.len(), rows[0].len(), "every row of a grid is as long as the first");
        for (column, image) in images.iter().enumerate() {
            let (top, left) = (row * (height + GAP), column * (width + GAP));
            picture.slice_mut(s![.., top..top + height, left..left + width]).assign(&image.planes());
        }
    }
    encode(picture.view(), |_, value| value)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range of a byte")]
fn encode(planes: ArrayView3<'_, f32>, stretch: impl Fn(usize, f32) -> f32) -> Vec<u8> {
    let (_, height, width) = planes.dim();
    let byte = |channel: usize, y: u32, x: u32| {
        let value = stretch(channel, planes[[channel, y as usize, x as usize]]);
        (value.clamp(0.0, 1.0) * 255.0).round() as u8
    };
    let picture = RgbImage::from_fn(width as u32, height as u32, |x, y| {
        Rgb([byte(0, y, x), byte(1, y, x), byte(2, y, x)])
    });
    let mut png = Vec::new();
    image::codecs::png::PngEncoder::new(&mut png)
        .write_image(picture.as_raw(), picture.width(), picture.height(), image::ExtendedColorType::Rgb8)
        .expect("encoding to memory cannot fail");
    png
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(png: &[u8]) -> RgbImage {
        image::load_from_memory(png).unwrap().to_rgb8()
    }

    #[test]
    fn shows_values_at_their_place() {
        let planes =
            Array3::from_shape_fn((3, 2, 3), |(c, y, x)| if (c, y, x) == (2, 1, 0) { 1.0 } else { 0.2 });
        let picture = decode(&tone_mapped(&ToneMappedImage::from_planes(planes).unwrap()));
        assert_eq!(picture.dimensions(), (3, 2));
        assert_eq!(picture.get_pixel(0, 1).0, [51, 51, 255]);
    }

    #[test]
    fn a_grid_has_its_images_in_their_cells() {
        let flat = |value| ToneMappedImage::from_planes(Array3::from_elem((3, 2, 3), value)).unwrap();
        let (a, b, c) = (flat(0.0), flat(0.2), flat(0.4));
        let picture = decode(&grid(&[[a, b.clone()], [b, c]]));
        assert_eq!(picture.dimensions(), (3 + 6 + 3, 2 + 6 + 2));
        let at = |x, y| picture.get_pixel(x, y).0[0];
        assert_eq!([at(0, 0), at(9, 1), at(2, 8), at(11, 9), at(4, 0)], [0, 51, 51, 102, 255]);
    }

    #[test]
    fn signed_values_lie_around_grey() {
        let planes = Array3::from_shape_fn((3, 1, 3), |(_, _, x)| [-4.0, 0.0, 1.0][x]);
        let picture = decode(&signed(planes.view()));
        assert_eq!([0, 1, 2].map(|x| picture.get_pixel(x, 0).0[0]), [0, 128, 191]);
    }

    #[test]
    fn the_log_stretch_spans_the_decades() {
        let energy = Array3::from_shape_fn((3, 1, 3), |(_, _, x)| [1.0, 0.01, 1e-4][x]);
        let picture = decode(&log_psf(&Psf::from_energy(energy).unwrap(), 4.0));
        let row: Vec<u8> = (0..3).map(|x| picture.get_pixel(x, 0).0[0]).collect();
        assert_eq!(row, [255, 128, 0]);
    }
}
