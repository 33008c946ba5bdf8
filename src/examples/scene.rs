//! Turns a recipe into the light of a scene: a view out of a panorama, or a painting.

use super::panoramas::PanoramaFile;
use super::recipe::{Recipe, SceneRecipe};
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::crop::{Panorama, View, crop_with_margin};
use crate::scenes::natural::paint_natural;

/// The largest angle of a view with its margin: beyond it, pixels at the border see next to nothing.
const WIDEST_DEG: f64 = 160.0;

/// Makes the scene of an example, `margin` pixels larger than its frame of `side` pixels on each side, and scales its
/// light.
///
/// # Errors
/// Those of reading the panorama, and of painting.
pub(super) fn make_scene(
    recipe: &Recipe,
    panoramas: &[PanoramaFile],
    side: usize,
    margin: usize,
) -> Result<LinearImage> {
    let scene = match &recipe.scene {
        SceneRecipe::Panorama { panorama, yaw_deg, pitch_deg, texels_per_pixel } => {
            let panorama = panoramas[*panorama].read()?;
            let fov_deg = fov_deg(&panorama, *texels_per_pixel, [side, margin]);
            let view = View { yaw_deg: *yaw_deg, pitch_deg: *pitch_deg, fov_deg, size: side };
            view.check_margin(margin)?;
            crop_with_margin(&panorama, &view, margin)
        }
        SceneRecipe::Painted { kind, seed } => paint_natural(*kind, *seed, [side + 2 * margin; 2])?.image,
    };
    Ok(with_brightness(scene, [side, margin], recipe.brightness))
}

/// The field of view at which a pixel in the middle spans so many of the panorama's, or the widest that there is.
///
/// # Equation
/// Pixels of a view are steps of p on a plane at unit distance; in the middle, p is an angle, and one of a panorama of
/// width w is 2π/w. `size` pixels between the outermost centres span `2·atan(p·(size − 1)/2)`.
fn fov_deg(panorama: &Panorama, texels_per_pixel: f64, [side, margin]: [usize; 2]) -> f64 {
    let half_span = |size: usize| (size - 1) as f64 / 2.0;
    let widest = (WIDEST_DEG / 2.0).to_radians().tan() / half_span(side + 2 * margin);
    let step = (texels_per_pixel * std::f64::consts::TAU / panorama.width() as f64).min(widest);
    2.0 * (step * half_span(side)).atan().to_degrees()
}

/// Scales light so that the median of green in the frame is as wanted; where that is dark, the mean.
fn with_brightness(scene: LinearImage, [side, margin]: [usize; 2], brightness: f64) -> LinearImage {
    let frame = scene.channel(1);
    let frame = frame.slice(ndarray::s![margin..margin + side, margin..margin + side]);
    let mut values: Vec<f32> = frame.iter().copied().collect();
    let middle = values.len() / 2;
    let median = f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1);
    let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
    let level = [median, mean].into_iter().find(|&level| level > 0.0).unwrap_or(brightness);
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    let factor = (brightness / level) as f32;
    // A scene whose frame is all but black must not become infinite around it.
    scene.map_in_place(|value| (value * factor).min(BRIGHTEST))
}

/// More than the sun's 10⁶ times the light of a scene.
const BRIGHTEST: f32 = 1e8;

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn a_view_keeps_the_resolution_of_its_panorama_where_it_can() {
        let planes = Array3::from_elem((3, 512, 1024), 0.5);
        let panorama = Panorama::new(LinearImage::from_planes(planes).unwrap()).unwrap();
        let fov = fov_deg(&panorama, 1.0, [288, 200]);
        let step = 2.0 * (fov / 2.0).to_radians().tan() / 287.0;
        assert!((step - std::f64::consts::TAU / 1024.0).abs() < 1e-12);
        let view =
            View { yaw_deg: 0.0, pitch_deg: 0.0, fov_deg: fov_deg(&panorama, 9.0, [288, 400]), size: 288 };
        assert!((view.fov_with_margin_deg(400) - WIDEST_DEG).abs() < 1e-9);
        view.check_margin(400).unwrap();
    }

    #[test]
    fn light_is_scaled_by_the_frame_alone() {
        let planes = Array3::from_shape_fn((3, 9, 9), |(_, y, x)| {
            if (2..7).contains(&y) && (2..7).contains(&x) { (y * 5 + x) as f32 } else { 1e6 }
        });
        let scene = with_brightness(LinearImage::from_planes(planes).unwrap(), [5, 2], 0.25);
        assert_eq!(scene.planes()[[1, 4, 4]], 0.25);
        let black = LinearImage::from_planes(Array3::zeros((3, 9, 9))).unwrap();
        assert_eq!(with_brightness(black.clone(), [5, 2], 0.25), black);
    }
}
