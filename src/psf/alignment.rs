//! Finds how far the camera moved between two exposures, by the phases of their spectra.

use ndarray::{Array2, Array3, Axis};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use crate::core::error::{Error, Result};
use crate::core::fft::{Boundary, Convolver};

/// A displacement of the whole picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Pixels downwards and to the right.
    pub shift_px: [f64; 2],
    /// How well the phases agree, from 0 (not at all) to 1.
    pub coherence: f64,
}

impl Motion {
    /// The length of the displacement in pixels.
    pub fn distance_px(&self) -> f64 {
        self.shift_px[0].hypot(self.shift_px[1])
    }
}

/// Pixels are compared in cells of 2 × 2, which holds every colour of a mosaic.
const CELL: usize = 2;
/// The side of the square, in cells, that is compared; larger ones tell no more.
const LARGEST_SIDE: usize = 1024;
/// Below this a square has too few frequencies to tell a displacement from chance.
const SMALLEST_SIDE: usize = 32;
/// Standard deviation of the frequencies that are trusted, in cycles per cell: noise rules the finer ones.
const FREQUENCIES: f64 = 0.1;
/// How many standard deviations of chance the agreement must exceed: of some 10⁴ places, the best of unrelated pictures
/// reaches four.
const ABOVE_CHANCE: f64 = 6.0;
/// Agreement below this is of a small part of the picture: something in it moved, or shines in one exposure only.
const COHERENT: f64 = 0.1;

/// The displacement of each exposure against the next longer one; none where too little is seen in both.
pub(super) fn motions(frames: &[Array3<f32>], times: &[f64], saturation: f64) -> Result<Vec<Option<Motion>>> {
    frames.windows(2).zip(times.windows(2)).map(|(pair, times)| motion(pair, times, saturation)).collect()
}

/// Refuses exposures that are further apart than allowed.
pub(super) fn check_motion(motions: &[Option<Motion>], numbers: &[usize], limit: Option<f64>) -> Result<()> {
    let Some(limit) = limit else { return Ok(()) };
    for (motion, pair) in motions.iter().zip(numbers.windows(2)) {
        if let Some(motion) = motion.filter(|motion| motion.distance_px() > limit) {
            let [down, right] = motion.shift_px;
            return Err(Error::Unsupported(format!(
                "picture {} of the bracket is displaced by {down:+.1} pixels down and {right:+.1} right against picture \
                 {}, more than {limit}; align them first, or pass --allow-motion",
                pair[1], pair[0]
            )));
        }
    }
    Ok(())
}

/// # Method
/// 1. Both exposures are brought to the same irradiance and clipped where the longer one saturates, so that they differ
///    by noise alone; cells of 2 × 2 pixels are summed over all channels.
/// 2. The phases of the cross spectrum are kept, its moduli replaced by a Gaussian of the frequency, so that the
///    correlation is a Gaussian about the displacement.
/// 3. Its maximum is found, and refined by the parabola through the logarithms of three neighbours, which is exact for a
///    Gaussian.
fn motion(pair: &[Array3<f32>], times: &[f64], saturation: f64) -> Result<Option<Motion>> {
    let (_, height, width) = pair[0].dim();
    let shorter_side = (height.min(width) / CELL).min(LARGEST_SIDE);
    let side = 1usize << shorter_side.max(1).ilog2();
    if side < SMALLEST_SIDE {
        return Ok(None);
    }
    let ceiling = saturation / times[0];
    let convolver = Convolver::new([side, side], [1, 1], Boundary::Periodic)?;
    let [long, short] =
        [0, 1].map(|k| convolver.plane_spectrum(cells(&pair[k], times[k], ceiling, side).view()));
    let Phases { filter, weight, chance } = phases(&long, &short, side);
    let surface = convolver.filter_plane(&vec![Complex64::new(1.0, 0.0); filter.len()], &filter);
    let (place, peak) = surface
        .indexed_iter()
        .map(|(place, value)| (place, f64::from(*value)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or_default();
    let coherence = peak / weight;
    if coherence <= COHERENT.max(ABOVE_CHANCE * chance) {
        return Ok(None);
    }
    let shift_px = [0, 1].map(|axis| CELL as f64 * refined(&surface, place, axis));
    Ok(Some(Motion { shift_px, coherence }))
}

/// The central square of cells, as irradiance up to `ceiling`, faded out towards its border.
fn cells(frame: &Array3<f32>, time: f64, ceiling: f64, side: usize) -> Array2<f32> {
    let (_, height, width) = frame.dim();
    let (top, left) = ((height - CELL * side) / 2 / CELL * CELL, (width - CELL * side) / 2 / CELL * CELL);
    let mut cells = Array2::<f32>::zeros((side, side));
    cells.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(row, mut cells)| {
        for (column, cell) in cells.iter_mut().enumerate() {
            let mut sum = 0.0;
            for plane in frame.outer_iter() {
                for pixel in 0..CELL * CELL {
                    let place = [top + CELL * row + pixel / CELL, left + CELL * column + pixel % CELL];
                    sum += (f64::from(plane[place]) / time).min(ceiling);
                }
            }
            #[expect(clippy::cast_possible_truncation, reason = "planes are 32-bit")]
            let sum = sum as f32;
            *cell = sum;
        }
    });
    let mean = cells.mean().unwrap_or(0.0);
    #[expect(clippy::cast_possible_truncation, reason = "a weight in [0, 1]")]
    let fade =
        |index: usize| (std::f64::consts::PI * (index as f64 + 0.5) / side as f64).sin().powi(2) as f32;
    cells.indexed_iter_mut().for_each(|((y, x), cell)| *cell = (*cell - mean) * fade(y) * fade(x));
    cells
}

/// The weighted phase differences of two half spectra.
struct Phases {
    filter: Vec<Complex64>,
    /// What their correlation reaches when all agree.
    weight: f64,
    /// The standard deviation of the share of it that they reach by chance.
    chance: f64,
}

fn phases(long: &[Complex64], short: &[Complex64], side: usize) -> Phases {
    let frequency = |k: usize| k.min(side - k) as f64 / side as f64;
    let (mut sum, mut squares) = (0.0, 0.0);
    let filter = long.iter().zip(short).enumerate().map(|(index, (a, b))| {
        let (kx, ky) = (index / side, index % side);
        let squared = frequency(kx).powi(2) + frequency(ky).powi(2);
        let cross = a.conj() * b;
        let modulus = cross.norm();
        // The mean says nothing about a displacement.
        let weight = if index == 0 { 0.0 } else { (-squared / (2.0 * FREQUENCIES * FREQUENCIES)).exp() };
        // Columns between the first and the last stand for their mirror images too.
        let is_alone = kx == 0 || 2 * kx == side;
        let times = if is_alone { 1.0 } else { 2.0 };
        sum += times * weight;
        squares += times * weight * weight;
        if modulus > 0.0 { cross * (weight / modulus) } else { Complex64::new(0.0, 0.0) }
    });
    let filter = filter.collect();
    Phases { filter, weight: sum / (side * side) as f64, chance: squares.sqrt() / sum }
}

/// The place of a maximum along one axis, to a fraction of a cell; from the middle on, places are negative.
fn refined(surface: &Array2<f32>, (y, x): (usize, usize), axis: usize) -> f64 {
    let side = surface.nrows();
    let value = |offset: usize| {
        let moved = |place: usize| (place + side + offset - 1) % side;
        let place = if axis == 0 { [moved(y), x] } else { [y, moved(x)] };
        f64::from(surface[place]).max(f64::MIN_POSITIVE).ln()
    };
    let [before, here, after] = [value(0), value(1), value(2)];
    let curvature = before - 2.0 * here + after;
    let fraction = if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
    let place = if axis == 0 { y } else { x };
    let signed = if 2 * place >= side { place as f64 - side as f64 } else { place as f64 };
    signed + fraction.clamp(-0.5, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng::stream;
    use rand::RngExt as _;

    const TIMES: [f64; 2] = [1.0, 1.0 / 16.0];

    /// Blurred lamps at places that no period explains, moved by (down, right).
    fn scene(down: f64, right: f64) -> Array3<f32> {
        let mut rng = stream(5, "lamps");
        let lamps: Vec<[f64; 4]> = (0..60).map(|_| std::array::from_fn(|_| rng.random::<f64>())).collect();
        Array3::from_shape_fn((1, 160, 180), |(_, y, x)| {
            let light = lamps.iter().map(|[cy, cx, size, power]| {
                let (dy, dx) = (y as f64 - 160.0 * cy - down, x as f64 - 180.0 * cx - right);
                let width = 2.0 + 6.0 * size;
                (20.0 * power * power) * (-(dy * dy + dx * dx) / (2.0 * width * width)).exp()
            });
            (0.05 + light.sum::<f64>()) as f32
        })
    }

    fn exposed(scene: &Array3<f32>, time: f64, label: &str) -> Array3<f32> {
        let mut rng = stream(6, label);
        scene.mapv(|v| {
            let noise = 0.002 * (rng.random::<f32>() - 0.5);
            (((v * time as f32 + noise) * 1023.0).round() / 1023.0).clamp(0.0, 1.0)
        })
    }

    fn found(down: f64, right: f64) -> Option<Motion> {
        let pair = [exposed(&scene(0.0, 0.0), TIMES[0], "a"), exposed(&scene(down, right), TIMES[1], "b")];
        motion(&pair, &TIMES, 0.99).unwrap()
    }

    /// Ten bits and a sixteenth of the time leave noise of about a hundredth of the light.
    #[test]
    fn finds_displacements_to_a_fifth_of_a_pixel() {
        for (down, right) in [(0.0, 0.0), (0.6, -0.4), (3.0, -5.5), (-1.2, 0.3)] {
            let Motion { shift_px: [y, x], .. } = found(down, right).expect("the scene is in both");
            assert!((y - down).abs() < 0.2 && (x - right).abs() < 0.2, "{y} {x} of {down} {right}");
        }
    }

    #[test]
    fn says_nothing_about_pictures_that_share_nothing() {
        let mut rng = stream(7, "noise");
        let mut noise = || Array3::from_shape_simple_fn((1, 160, 180), || rng.random::<f32>());
        assert_eq!(motion(&[noise(), noise()], &[1.0, 1.0], 2.0).unwrap(), None);
        let flat = || Array3::from_elem((3, 160, 180), 0.5);
        assert_eq!(motion(&[flat(), flat()], &[1.0, 1.0], 0.99).unwrap(), None);
        assert_eq!(
            motion(&[Array3::zeros((1, 20, 20)), Array3::zeros((1, 20, 20))], &TIMES, 0.99).unwrap(),
            None
        );
    }

    #[test]
    fn refuses_what_moved_further_than_allowed() {
        let motions = [None, found(3.0, -5.5)];
        let message = check_motion(&motions, &[3, 1, 2], Some(1.0)).unwrap_err().to_string();
        assert!(message.contains("picture 2") && message.contains("against picture 1"), "{message}");
        assert!(message.contains("--allow-motion"), "{message}");
        check_motion(&motions, &[3, 1, 2], None).unwrap();
        check_motion(&[found(0.5, 0.0)], &[1, 2], Some(1.0)).unwrap();
    }
}
