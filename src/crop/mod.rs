//! Turns an equirectangular panorama into perspective views, as a camera in its middle would see them.

mod cut;
mod estimate;
mod panorama;
mod view;

pub use cut::{Cut, CutCount, CutReport};
use panorama::Footprint;
pub use panorama::Panorama;
pub use view::{View, aimed_views, spread_views};

use ndarray::Array3;
use rayon::prelude::*;

use crate::core::image::{CHANNELS, LinearImage};
use view::Camera;

/// Most subsamples of a pixel along one axis; only pixels at a pole, which span all longitudes, want more.
const MOST_SUBSAMPLES: usize = 48;

/// Subsamples for each panorama pixel that an output pixel spans: dense enough that halving their spacing
/// moves the result by less than −50 dB on real panoramas.
const SUBSAMPLES_PER_TEXEL: f64 = 1.5;

/// Renders a view without aliasing.
///
/// Each output pixel is the mean of the panorama over the pixel's area, taken with a grid of bilinear
/// subsamples that follows the pixel's footprint on the panorama; see `Panorama::sample`. A view finer than
/// the panorama is bilinear interpolation alone.
///
/// # Panics
/// When the view does not pass [`View::check`].
pub fn crop(panorama: &Panorama, view: &View) -> LinearImage {
    crop_with_margin(panorama, view, 0)
}

/// As [`crop`], with `margin` pixels more on each side: at the same pitch of pixels, so that the middle of the image is
/// the view without a margin, to the bit.
///
/// # Panics
/// When the view does not pass [`View::check_margin`].
pub fn crop_with_margin(panorama: &Panorama, view: &View, margin: usize) -> LinearImage {
    assert!(view.check_margin(margin).is_ok(), "checked before the work, found {view:?} and {margin}");
    let camera = Camera::new(view);
    let size = view.size + 2 * margin;
    let at = |index: usize| index as f64 - margin as f64;
    let mut pixels = vec![[0f32; CHANNELS]; size * size];
    pixels.par_chunks_mut(size).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            *pixel = area_mean(panorama, &camera, at(y), at(x));
        }
    });
    let planes = Array3::from_shape_fn((CHANNELS, size, size), |(c, y, x)| pixels[y * size + x][c]);
    LinearImage::from_planes(planes).expect("means of finite values are finite")
}

fn area_mean(panorama: &Panorama, camera: &Camera, y: f64, x: f64) -> [f32; CHANNELS] {
    let direction = camera.direction(y, x);
    let columns = Subsamples::across(panorama.footprint(direction, camera.step_right()));
    let rows = Subsamples::across(panorama.footprint(direction, camera.step_down()));
    let mut sum = [0f64; CHANNELS];
    for dy in rows.offsets() {
        for dx in columns.offsets() {
            let sample = panorama.sample(camera.direction(y + dy, x + dx));
            sum.iter_mut().zip(sample).for_each(|(sum, value)| *sum += value);
        }
    }
    let count = (rows.count * columns.count) as f64;
    #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
    sum.map(|sum| (sum / count) as f32)
}

/// Positions of the subsamples along one axis of an output pixel.
#[derive(Clone, Copy, Debug)]
struct Subsamples {
    count: usize,
    /// Distance of neighbours, in output pixels.
    spacing: f64,
}

impl Subsamples {
    /// Chooses the subsamples of a pixel for its footprint along one axis.
    ///
    /// # Equation
    /// A pixel's area is a box of variance f²/12 for a span of f texels. Bilinear interpolation brings a blur
    /// of its own, of variance 1/6, of which 1/12 stands for the texel's own area; where f is near 1, adding
    /// the whole box would soften the view visibly. So n points at a distance s are laid out with the
    /// variance `s²·(n²−1)/12 = (f² − g)/12`, with g = 1 up to f = 1.3, falling to 0 at f = 2.3, from where
    /// on the mean is the plain one over the area.
    ///
    /// Towards a pole texels crowd together along the rows only, and a footprint is stretched that way along
    /// both axes of the pixel: n follows the geometric mean of f and of its value on the horizon, so that the
    /// number of subsamples follows the footprint's area.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before the cast")]
    fn across(footprint: Footprint) -> Self {
        // A footprint over a pole is infinite; any value that asks for the most subsamples serves.
        let texels = footprint.texels.min(1e4);
        let variance = (texels * texels - (2.3 - texels).clamp(0.0, 1.0)).max(0.0);
        if variance < 1e-9 {
            return Self { count: 1, spacing: 0.0 };
        }
        let span = (texels * footprint.texels_at_horizon.min(texels)).sqrt();
        let wanted = (SUBSAMPLES_PER_TEXEL * span.hypot(1.0)).ceil();
        let count = (wanted as usize).clamp(2, MOST_SUBSAMPLES);
        Self { count, spacing: (variance / (count * count - 1) as f64).sqrt() / texels }
    }

    fn offsets(self) -> impl Iterator<Item = f64> {
        let middle = (self.count - 1) as f64 / 2.0;
        (0..self.count).map(move |i| (i as f64 - middle) * self.spacing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level(texels: f64) -> Subsamples {
        Subsamples::across(Footprint { texels, texels_at_horizon: texels })
    }

    #[test]
    fn interpolates_only_where_the_panorama_is_coarser_than_the_view() {
        for texels in [0.0, 0.3, 1.0] {
            assert_eq!(level(texels).count, 1, "{texels}");
        }
    }

    #[test]
    fn covers_the_area_of_a_pixel() {
        for texels in [2.3f64, 3.26, 7.0, 1e6, f64::INFINITY] {
            let subsamples = level(texels);
            let offsets: Vec<f64> = subsamples.offsets().collect();
            let variance = offsets.iter().map(|o| o * o).sum::<f64>() / offsets.len() as f64;
            assert!((variance - 1.0 / 12.0).abs() < 1e-12, "{texels}: {variance}");
            assert!(offsets.iter().sum::<f64>().abs() < 1e-12);
            if texels < 30.0 {
                assert!(subsamples.spacing * texels < 1.0, "{texels}: texels fall between subsamples");
            }
        }
    }

    /// Four times the texels for each pixel near a pole: four times the subsamples on both axes together.
    #[test]
    fn spends_subsamples_by_the_area_of_the_footprint() {
        let stretched = Subsamples::across(Footprint { texels: 40.0, texels_at_horizon: 10.0 });
        assert_eq!((level(10.0).count, stretched.count), (16, 31));
    }
}
