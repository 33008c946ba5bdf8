//! Turns images into compressed pictures and half floats, as a page holds them.

use half::f16;
use half::slice::HalfFloatSliceExt as _;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _, RgbImage};
use ndarray::{Array2, ArrayView3};

use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::experiment::{Region, Regions};

/// Encodes tone-mapped values, 0 to 1, as they are, without subsampling the colours.
pub(super) fn jpeg_of(image: &ToneMappedImage, quality: u8) -> Vec<u8> {
    jpeg(&bytes_of(image.planes(), |value| value), quality)
}

/// Encodes display values.
///
/// # Panics
/// Never: encoding to memory cannot fail.
pub(super) fn jpeg(picture: &RgbImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::Rgb8)
        .expect("encoding to memory cannot fail");
    bytes
}

/// The bytes of what `show` makes of values, which is clipped to 0 to 1; what is no number is magenta.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range of a byte")]
pub(super) fn bytes_of(planes: ArrayView3<'_, f32>, show: impl Fn(f32) -> f32) -> RgbImage {
    let (_, height, width) = planes.dim();
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let values = [0, 1, 2].map(|channel: usize| planes[[channel, y as usize, x as usize]]);
        if values.iter().any(|value| value.is_nan()) {
            return image::Rgb([255, 0, 255]);
        }
        image::Rgb(values.map(|value| (show(value).clamp(0.0, 1.0) * 255.0).round() as u8))
    })
}

/// The light of an image as half floats, little-endian, red, green and blue of each pixel after each other; finite values
/// beyond the largest half float become that.
pub(super) fn half_floats(planes: ArrayView3<'_, f32>) -> Vec<u8> {
    let (_, height, width) = planes.dim();
    let largest = f16::MAX.to_f32();
    let mut bytes = Vec::with_capacity(2 * CHANNELS * height * width);
    let (mut row, mut halves) = (vec![0.0f32; CHANNELS * width], vec![f16::ZERO; CHANNELS * width]);
    for y in 0..height {
        for (at, value) in row.iter_mut().enumerate() {
            let stored = planes[[at % CHANNELS, y, at / CHANNELS]];
            *value = if stored.is_finite() { stored.clamp(-largest, largest) } else { stored };
        }
        halves.convert_from_f32_slice(&row);
        bytes.extend(halves.iter().flat_map(|value| value.to_le_bytes()));
    }
    bytes
}

/// Regions as the viewer reads them: a PNG of 255 for highlights, 128 for flare, 0 for the rest.
///
/// # Panics
/// Never: encoding to memory cannot fail.
pub(super) fn png_of_regions(regions: &Regions) -> Vec<u8> {
    let [highlights, flare] = [Region::Highlights, Region::Flare].map(|region| regions.mask(region));
    let (height, width) = highlights.dim();
    let codes = Array2::from_shape_fn((height, width), |at| match (highlights[at], flare[at]) {
        (true, _) => 255u8,
        (false, true) => 128,
        (false, false) => 0,
    });
    let mut png = Vec::new();
    #[expect(clippy::cast_possible_truncation, reason = "sides of images fit 32 bits")]
    PngEncoder::new(&mut png)
        .write_image(codes.as_slice().unwrap_or_default(), width as u32, height as u32, ExtendedColorType::L8)
        .expect("encoding to memory cannot fail");
    png
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::LinearImage;
    use crate::core::tone::ToneCurve;
    use ndarray::Array3;

    #[test]
    fn halves_are_the_pixels_row_by_row() {
        let planes = Array3::from_shape_fn((3, 2, 2), |(c, y, x)| (100 * c + 10 * y + x) as f32);
        let bytes = half_floats(planes.view());
        let values: Vec<f32> =
            bytes.chunks(2).map(|pair| f16::from_le_bytes([pair[0], pair[1]]).to_f32()).collect();
        assert_eq!(values, [0.0, 100.0, 200.0, 1.0, 101.0, 201.0, 10.0, 110.0, 210.0, 11.0, 111.0, 211.0]);
    }

    #[test]
    fn what_half_floats_cannot_hold_stays_what_it_is_as_far_as_can_be() {
        let planes = Array3::from_shape_vec((3, 1, 1), vec![f32::NAN, 1e9, f32::INFINITY]).unwrap();
        let bytes = half_floats(planes.view());
        let values: Vec<f32> =
            bytes.chunks(2).map(|pair| f16::from_le_bytes([pair[0], pair[1]]).to_f32()).collect();
        assert!(values[0].is_nan() && values[1] == 65504.0 && values[2] == f32::INFINITY, "{values:?}");
        assert_eq!(bytes_of(planes.view(), |value| value).get_pixel(0, 0).0, [255, 0, 255]);
    }

    #[test]
    fn a_jpeg_is_within_its_loss_of_the_image_and_smaller_with_less_quality() {
        let planes = Array3::from_shape_fn((3, 40, 50), |(c, y, x)| {
            ((c + y) as f32 * 0.01 + x as f32 * 0.01).min(1.0)
        });
        let image = ToneMappedImage::from_planes(planes).unwrap();
        let [good, poor] = [92, 40].map(|quality| jpeg_of(&image, quality));
        assert!(poor.len() < good.len());
        let decoded = image::load_from_memory(&good).unwrap().to_rgb8();
        for (x, y, pixel) in decoded.enumerate_pixels() {
            let expected = 255.0 * image.planes()[[1, y as usize, x as usize]];
            assert!((f32::from(pixel.0[1]) - expected).abs() < 6.0, "{x} {y}");
        }
    }

    #[test]
    fn regions_keep_their_places() {
        let light = |values: [f32; 3]| {
            LinearImage::from_planes(Array3::from_shape_fn((3, 1, 3), |(_, _, x)| values[x])).unwrap()
        };
        let (clean, degraded) = (light([600.0, 0.05, 0.05]), light([600.0, 90.0, 0.05]));
        let regions = Regions::divide(&clean, &degraded, ToneCurve::default());
        let png = image::load_from_memory(&png_of_regions(&regions)).unwrap().to_luma8();
        assert_eq!(png.into_raw(), [255, 128, 0]);
    }
}
