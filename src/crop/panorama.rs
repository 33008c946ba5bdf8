//! Turns a direction in space into the light that an equirectangular panorama holds for it.

use std::f64::consts::{PI, TAU};

use super::view::Direction;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage};

/// An equirectangular panorama: columns are longitudes, rows are latitudes, in equal steps.
///
/// # Shapes
/// `[3, height, 2·height]`. The centre of column c lies at longitude `((c + ½)/width − ½)·360°`, positive to
/// the right of the image's centre; the centre of row r at latitude `(½ − (r + ½)/height)·180°`.
#[derive(Clone, Debug)]
pub struct Panorama {
    image: LinearImage,
}

impl Panorama {
    /// Takes an image as a full panorama.
    ///
    /// # Errors
    /// [`Error::Shape`] when the image is not twice as wide as high.
    pub fn new(image: LinearImage) -> Result<Self> {
        let (height, width) = (image.height(), image.width());
        if width != 2 * height {
            return Err(Error::shape(
                "panorama",
                "an equirectangular image, twice as wide as high",
                format!("{width} × {height}"),
            ));
        }
        Ok(Self { image })
    }

    /// Number of columns, which span 360°.
    pub fn width(&self) -> usize {
        self.image.width()
    }

    /// The light from `direction`, by bilinear interpolation; longitudes wrap around, and latitudes go on
    /// beyond a pole on its other side.
    pub(super) fn sample(&self, direction: Direction) -> [f64; CHANNELS] {
        let (height, width) = (self.image.height(), self.image.width());
        let [dx, dy, dz] = direction;
        let longitude = dx.atan2(dz);
        let latitude = dy.atan2((dx * dx + dz * dz).sqrt());
        let (left, share_right) = split((longitude / TAU + 0.5) * width as f64 - 0.5);
        let (above, share_below) = split((0.5 - latitude / PI) * height as f64 - 0.5);
        let mut light = [0.0; CHANNELS];
        for (row, row_share) in [(above, 1.0 - share_below), (above + 1, share_below)] {
            let (row, turn) = over_the_pole(row, height);
            for (column, share) in [(left, 1.0 - share_right), (left + 1, share_right)] {
                let index = row * width + wrap(column + turn, width);
                let plane = height * width;
                for (channel, light) in light.iter_mut().enumerate() {
                    let value = f64::from(self.image.as_slice()[channel * plane + index]);
                    *light += row_share * share * value;
                }
            }
        }
        light
    }

    /// The footprint of a ray that changes by `change`, to first order.
    pub(super) fn footprint(&self, direction: Direction, change: Direction) -> Footprint {
        let [x, y, z] = direction;
        let [cx, cy, cz] = change;
        let across_squared = x * x + z * z;
        if across_squared == 0.0 {
            return Footprint { texels: f64::INFINITY, texels_at_horizon: f64::INFINITY };
        }
        let across = across_squared.sqrt();
        let d_across = (x * cx + z * cz) / across;
        let d_longitude = (z * cx - x * cz) / across_squared;
        let d_latitude = (across * cy - y * d_across) / (across_squared + y * y);
        let texels_per_radian = self.image.height() as f64 / PI;
        let texels = d_longitude.hypot(d_latitude) * texels_per_radian;
        let angle = (d_longitude * across / (across_squared + y * y).sqrt()).hypot(d_latitude);
        Footprint { texels, texels_at_horizon: angle * texels_per_radian }
    }
}

/// How far the ray of a pixel moves on a panorama from one pixel to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Footprint {
    /// Distance on the panorama's grid; grows without bound towards a pole.
    pub(super) texels: f64,
    /// What the distance would be for the same angle on the horizon, where texels are square.
    pub(super) texels_at_horizon: f64,
}

/// The whole number at or below a position, and how far the position is past it.
#[expect(clippy::cast_possible_truncation, reason = "positions lie within a pixel of an image's sides")]
fn split(position: f64) -> (i64, f64) {
    let whole = position.floor();
    (whole as i64, position - whole)
}

/// The row that continues the grid across a pole, and the half turn that this takes.
#[expect(clippy::cast_sign_loss, reason = "sides of an image are far below 2⁶³")]
#[expect(clippy::cast_possible_truncation, reason = "the row lies within the image")]
fn over_the_pole(row: i64, height: usize) -> (usize, i64) {
    let height = height as i64;
    match row {
        row if row < 0 => ((-1 - row) as usize, height),
        row if row >= height => ((2 * height - 1 - row) as usize, height),
        row => (row as usize, 0),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the column lies within the image")]
fn wrap(column: i64, width: usize) -> usize {
    column.rem_euclid(width as i64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn numbered() -> Panorama {
        let planes = Array3::from_shape_fn((3, 4, 8), |(c, y, x)| (c * 100 + y * 10 + x) as f32);
        Panorama::new(LinearImage::from_planes(planes).unwrap()).unwrap()
    }

    fn towards(longitude_deg: f64, latitude_deg: f64) -> Direction {
        let (longitude, latitude) = (longitude_deg.to_radians(), latitude_deg.to_radians());
        [longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos()]
    }

    #[test]
    fn finds_each_pixel_at_its_centre() {
        for row in 0..4 {
            for column in 0..8 {
                let longitude = (f64::from(column) + 0.5) / 8.0 * 360.0 - 180.0;
                let latitude = 90.0 - (f64::from(row) + 0.5) / 4.0 * 180.0;
                let light = numbered().sample(towards(longitude, latitude));
                let expected = f64::from(row * 10 + column);
                for (channel, light) in light.into_iter().enumerate() {
                    assert!(
                        (light - expected - 100.0 * channel as f64).abs() < 1e-9,
                        "{row} {column}: {light}"
                    );
                }
            }
        }
    }

    #[test]
    fn joins_the_first_and_last_columns_and_both_sides_of_a_pole() {
        let seam = numbered().sample(towards(180.0, 22.5));
        assert!((seam[0] - (17.0 + 10.0) / 2.0).abs() < 1e-9, "{seam:?}");
        // Straight up, half way between longitude 22.5° (column 4) and the column opposite of it (0).
        let pole = numbered().sample(towards(22.5, 90.0 - 1e-9));
        assert!((pole[0] - 2.0).abs() < 1e-6, "{pole:?}");
    }

    #[test]
    fn measures_a_footprint_in_texels() {
        let panorama = numbered();
        let step = 1e-3;
        // On the horizon one radian is 8/2π pixels; at latitude 60° longitudes are twice as dense.
        let level = panorama.footprint([0.0, 0.0, 1.0], [step, 0.0, 0.0]);
        assert!((level.texels - step * 8.0 / TAU).abs() < 1e-12);
        assert!((level.texels_at_horizon - level.texels).abs() < 1e-12);
        let high = panorama.footprint(towards(0.0, 60.0), [step, 0.0, 0.0]);
        assert!((high.texels - 2.0 * level.texels).abs() < 1e-12);
        assert!((high.texels_at_horizon - level.texels).abs() < 1e-12);
        assert_eq!(panorama.footprint([0.0, 1.0, 0.0], [step, 0.0, 0.0]).texels, f64::INFINITY);
    }

    #[test]
    fn refuses_an_image_that_is_no_full_panorama() {
        let image = LinearImage::from_planes(Array3::zeros((3, 4, 9))).unwrap();
        assert!(Panorama::new(image).unwrap_err().to_string().contains("9 × 4"));
    }
}
