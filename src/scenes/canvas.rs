//! Turns a list of shining shapes into an image, by averaging a grid of samples in each pixel.
//!
//! Positions are in units of the image's side: x to the right, y downwards, both in `[0, 1]`.

use ndarray::Array3;
use rayon::prelude::*;

use super::script::is_ink;
use super::values::smooth_noise;
use crate::core::error::Result;
use crate::core::image::LinearImage;

/// Radiance of red, green and blue.
pub(super) type Rgb = [f32; 3];

/// Samples per pixel and axis: 3 × 3 leave no visible staircase after the panel's blur.
const SAMPLES: usize = 3;

/// Where a shape is.
#[derive(Clone, Debug)]
pub(super) enum Region {
    /// Everywhere.
    All,
    /// `[left, top, right, bottom]`.
    Rectangle([f32; 4]),
    /// Centre x, y and radius.
    Disc([f32; 3]),
    /// Corners in order, convex.
    Polygon(Vec<[f32; 2]>),
}

/// How a shape shines.
#[derive(Clone, Debug)]
pub(super) enum Light {
    /// The same everywhere.
    Flat(Rgb),
    /// From the first colour at the first height to the second colour at the second height.
    Vertical([f32; 2], [Rgb; 2]),
    /// Falls off with the square of the distance from x, y, measured in the given radius.
    Glow([f32; 3], Rgb),
    /// Multiplies a colour by smooth noise: cells per side, contrast, seed.
    Noise(Rgb, f32, f32, u32),
    /// Alternates two colours along an angle: cycles per side, angle in radians.
    Stripes([Rgb; 2], f32, f32),
    /// Alternates two colours in squares: squares per side.
    Checker([Rgb; 2], f32),
    /// Alternates two colours in sectors around x, y: a star with this many spokes.
    Star([Rgb; 2], [f32; 2], f32),
    /// Rows of letters from the left top corner x, y, of the given height, in the first colour on the
    /// second; the text is given by a seed.
    Text([Rgb; 2], [f32; 2], f32, u32),
}

/// One layer: light in a region, covering what is behind it, or added to it.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    pub(super) region: Region,
    pub(super) light: Light,
    /// Adds to the layers behind instead of covering them: glow, reflections.
    pub(super) additive: bool,
}

impl Shape {
    /// A shape that covers what is behind it.
    pub(super) fn opaque(region: Region, light: Light) -> Self {
        Self { region, light, additive: false }
    }

    /// A shape that adds its light to what is behind it.
    pub(super) fn additive(region: Region, light: Light) -> Self {
        Self { region, light, additive: true }
    }
}

/// Paints the shapes back to front on a square image.
///
/// # Errors
/// [`Error::Shape`](crate::core::error::Error::Shape) when `size_px` is zero.
#[expect(clippy::cast_precision_loss, reason = "sides are far below 2²⁴")]
pub(super) fn render(shapes: &[Shape], size_px: usize) -> Result<LinearImage> {
    let mut planes = Array3::zeros((3, size_px, size_px));
    let step = 1.0 / (size_px * SAMPLES) as f32;
    let rows: Vec<Vec<Rgb>> = (0..size_px)
        .into_par_iter()
        .map(|row| (0..size_px).map(|column| pixel(shapes, row, column, step)).collect())
        .collect();
    for (y, row) in rows.iter().enumerate() {
        for (x, rgb) in row.iter().enumerate() {
            for (channel, value) in rgb.iter().enumerate() {
                planes[[channel, y, x]] = *value;
            }
        }
    }
    LinearImage::from_planes(planes)
}

#[expect(clippy::cast_precision_loss, reason = "sides are far below 2²⁴")]
fn pixel(shapes: &[Shape], row: usize, column: usize, step: f32) -> Rgb {
    let mut sum = [0.0; 3];
    for sample in 0..SAMPLES * SAMPLES {
        let x = ((column * SAMPLES + sample % SAMPLES) as f32 + 0.5) * step;
        let y = ((row * SAMPLES + sample / SAMPLES) as f32 + 0.5) * step;
        let light = radiance(shapes, x, y);
        for channel in 0..3 {
            sum[channel] += light[channel] / (SAMPLES * SAMPLES) as f32;
        }
    }
    sum
}

fn radiance(shapes: &[Shape], x: f32, y: f32) -> Rgb {
    let mut added = [0.0; 3];
    for shape in shapes.iter().rev().filter(|shape| shape.region.covers(x, y)) {
        let light = shape.light.at(x, y);
        for channel in 0..3 {
            added[channel] += light[channel];
        }
        if !shape.additive {
            break;
        }
    }
    added
}

impl Region {
    fn covers(&self, x: f32, y: f32) -> bool {
        match self {
            Self::All => true,
            Self::Rectangle([left, top, right, bottom]) => {
                (*left..*right).contains(&x) && (*top..*bottom).contains(&y)
            }
            Self::Disc([cx, cy, radius]) => (x - cx).hypot(y - cy) < *radius,
            Self::Polygon(corners) => {
                let next = corners.iter().cycle().skip(1);
                let turn =
                    |a: &[f32; 2], b: &[f32; 2]| (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
                let mut turns = corners.iter().zip(next).map(|(a, b)| turn(a, b) >= 0.0);
                let first = turns.next();
                turns.all(|side| Some(side) == first)
            }
        }
    }
}

impl Light {
    fn at(&self, x: f32, y: f32) -> Rgb {
        match self {
            Self::Flat(colour) => *colour,
            Self::Vertical([from, to], [above, below]) => {
                mix(above, below, ((y - from) / (to - from)).clamp(0.0, 1.0))
            }
            Self::Glow([cx, cy, radius], colour) => {
                let distance = (x - cx).hypot(y - cy) / radius;
                scale(colour, 1.0 / (1.0 + distance * distance).powi(2))
            }
            Self::Noise(colour, cells, contrast, seed) => {
                scale(colour, 1.0 + contrast * (smooth_noise(x * cells, y * cells, *seed) - 0.5))
            }
            Self::Stripes(colours, cycles, angle) => {
                let phase = (x * angle.cos() + y * angle.sin()) * cycles;
                colours[usize::from(phase.rem_euclid(1.0) >= 0.5)]
            }
            Self::Checker(colours, squares) => {
                let parity = (x * squares).floor() + (y * squares).floor();
                colours[usize::from(parity.rem_euclid(2.0) >= 1.0)]
            }
            Self::Star(colours, [cx, cy], spokes) => {
                let turn = (y - cy).atan2(x - cx) / std::f32::consts::TAU * spokes;
                colours[usize::from(turn.rem_euclid(1.0) >= 0.5)]
            }
            Self::Text([ink, paper], [left, top], height, seed) => {
                if is_ink((x - left) / height, (y - top) / height, *seed) { *ink } else { *paper }
            }
        }
    }
}

/// Multiplies a colour by a factor.
pub(super) fn scale(colour: &Rgb, factor: f32) -> Rgb {
    colour.map(|value| value * factor)
}

fn mix(a: &Rgb, b: &Rgb, t: f32) -> Rgb {
    std::array::from_fn(|channel| a[channel] + (b[channel] - a[channel]) * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_covers_its_area() {
        let disc = Shape::opaque(Region::Disc([0.5, 0.5, 0.25]), Light::Flat([1.0; 3]));
        let image = render(&[disc], 100).unwrap();
        let area: f32 = image.channel(0).sum() / 1e4;
        // The rim's 157 pixels, each sampled on 3 × 3 points, err by less than a third of a pixel on average.
        assert!((area - std::f32::consts::PI / 16.0).abs() < 157.0 / 3.0 / 1e4, "{area}");
    }

    #[test]
    fn later_shapes_cover_and_additive_ones_add() {
        let flat = |value| Light::Flat([value; 3]);
        let left = Region::Rectangle([0.0, 0.0, 0.5, 1.0]);
        let shapes = [
            Shape::opaque(Region::All, flat(1.0)),
            Shape::opaque(left, flat(2.0)),
            Shape::additive(Region::All, flat(0.5)),
        ];
        let image = render(&shapes, 4).unwrap();
        // Nine samples are averaged, each rounded once.
        assert!((image.planes()[[0, 0, 0]] - 2.5).abs() < 9.0 * 2.5 * f32::EPSILON);
        assert!((image.planes()[[0, 0, 3]] - 1.5).abs() < 9.0 * 1.5 * f32::EPSILON);
    }

    #[test]
    fn polygons_of_either_orientation_are_filled() {
        let corners = vec![[0.1, 0.1], [0.9, 0.1], [0.5, 0.9]];
        let reversed = corners.iter().rev().copied().collect();
        for corners in [corners, reversed] {
            let region = Region::Polygon(corners);
            assert!(region.covers(0.5, 0.3) && !region.covers(0.1, 0.8));
        }
    }
}
