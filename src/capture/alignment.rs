//! Finds how far the camera moved between two exposures, by the phases of their spectra.

use ndarray::{Array2, Array3, Axis, s};
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
/// How many standard deviations the light must gain by undoing a displacement: of some 10⁴ noisy pictures that stood
/// still, the best gains less.
const ABOVE_NOISE: f64 = 4.0;

/// The displacement of each exposure against the next longer one; none where too little is seen in both.
pub(super) fn motions(frames: &[Array3<f32>], times: &[f64], saturation: f64) -> Result<Vec<Option<Motion>>> {
    let pairs = frames.windows(2).zip(times.windows(2));
    pairs.map(|(pair, times)| motion([&pair[0], &pair[1]], times, saturation)).collect()
}

/// The displacement of each picture of one exposure time against the first.
pub(super) fn motions_within(frames: &[Array3<f32>], saturation: f64) -> Result<Vec<Option<Motion>>> {
    frames[1..].iter().map(|frame| motion([&frames[0], frame], &[1.0; 2], saturation)).collect()
}

/// Refuses exposures that are further apart than allowed; each motion is that of the second of a pair of pictures.
pub(super) fn check_motion(
    motions: &[Option<Motion>],
    pairs: impl IntoIterator<Item = [usize; 2]>,
    limit: Option<f64>,
) -> Result<()> {
    let Some(limit) = limit else { return Ok(()) };
    for (motion, pair) in motions.iter().zip(pairs) {
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
/// 4. Phases count alike whether light or noise made them. A displacement that is one in whole pixels is therefore
///    believed only where the light itself [confirms](is_confirmed) it.
fn motion(pair: [&Array3<f32>; 2], times: &[f64], saturation: f64) -> Result<Option<Motion>> {
    let (_, height, width) = pair[0].dim();
    let shorter_side = (height.min(width) / CELL).min(LARGEST_SIDE);
    let side = 1usize << shorter_side.max(1).ilog2();
    if side < SMALLEST_SIDE {
        return Ok(None);
    }
    let ceiling = saturation / times[0];
    let convolver = Convolver::new([side, side], [1, 1], Boundary::Periodic)?;
    let [long, short] =
        [0, 1].map(|k| convolver.plane_spectrum(cells(pair[k], times[k], ceiling, side).view()));
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
    #[expect(clippy::cast_possible_truncation, reason = "places in a picture")]
    let whole = shift_px.map(|shift| shift.round() as isize);
    let is_believed = whole == [0, 0] || is_confirmed(pair, saturation, whole);
    Ok(is_believed.then_some(Motion { shift_px, coherence }))
}

/// Whether the exposures are more alike, beyond noise, once a displacement in whole pixels is undone.
///
/// # Equation
/// Over the same cells, the shorter exposure is explained by a line through the longer one, as it is and moved, which
/// leaves residuals a and b. A line, because wrong times and levels, and a ramp that is moved, are no displacement.
/// With d = a² − b², Σd/√Σd² is the gain in standard deviations. In pictures that stood still it is that of noise, or
/// negative; and no single cell can make it large.
fn is_confirmed(pair: [&Array3<f32>; 2], saturation: f64, shift: [isize; 2]) -> bool {
    let cells = jointly_exposed(pair, saturation, shift);
    let [still, moved] = [1, 2].map(|which| residuals(&cells, which));
    let gains = still.iter().zip(&moved).map(|(still, moved)| still * still - moved * moved);
    let (sum, squares) = gains.fold((0.0, 0.0), |(sum, squares), gain| (sum + gain, squares + gain * gain));
    sum > ABOVE_NOISE * f64::sqrt(squares)
}

/// The sums of all cells that are saturated nowhere: in the shorter exposure, in the longer one, and in the longer one
/// where the cell was before the displacement.
fn jointly_exposed(pair: [&Array3<f32>; 2], saturation: f64, [down, right]: [isize; 2]) -> Vec<[f64; 3]> {
    let (_, height, width) = pair[0].dim();
    let span = |shift: isize, length: usize| {
        (shift.max(0).unsigned_abs(), length.saturating_sub(shift.unsigned_abs()) / CELL)
    };
    let ((top, rows), (left, columns)) = (span(down, height), span(right, width));
    let sums = |index: usize| {
        let here = [top + CELL * (index / columns), left + CELL * (index % columns)];
        let before = [here[0].checked_add_signed(-down)?, here[1].checked_add_signed(-right)?];
        let [long, short] = pair.map(|frame| move |place| exposed_cell(frame, place, saturation));
        Some([short(here)?, long(here)?, long(before)?])
    };
    (0..rows * columns).into_par_iter().filter_map(sums).collect()
}

/// The sum of a cell over all channels, unless it is saturated.
fn exposed_cell(frame: &Array3<f32>, [top, left]: [usize; 2], saturation: f64) -> Option<f64> {
    let cell = frame.slice(s![.., top..top + CELL, left..left + CELL]);
    cell.iter().try_fold(0.0, |sum, &value| {
        let value = f64::from(value);
        (value < saturation).then_some(sum + value)
    })
}

/// What a line through column `which` leaves of the first column.
fn residuals(cells: &[[f64; 3]], which: usize) -> Vec<f64> {
    let mean = |column: usize| cells.iter().map(|cell| cell[column]).sum::<f64>() / cells.len() as f64;
    let (mean_short, mean_long) = (mean(0), mean(which));
    let (mut covariance, mut variance) = (0.0, 0.0);
    for cell in cells {
        let long = cell[which] - mean_long;
        covariance += long * (cell[0] - mean_short);
        variance += long * long;
    }
    let slope = if variance > 0.0 { covariance / variance } else { 0.0 };
    cells.iter().map(|cell| cell[0] - mean_short - slope * (cell[which] - mean_long)).collect()
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
        motion([&pair[0], &pair[1]], &TIMES, 0.99).unwrap()
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
        assert_eq!(motion([&noise(), &noise()], &[1.0, 1.0], 2.0).unwrap(), None);
        let flat = || Array3::from_elem((3, 160, 180), 0.5);
        assert_eq!(motion([&flat(), &flat()], &[1.0, 1.0], 0.99).unwrap(), None);
        assert_eq!(
            motion([&Array3::zeros((1, 20, 20)), &Array3::zeros((1, 20, 20))], &TIMES, 0.99).unwrap(),
            None
        );
    }

    /// Light without a place of its own: ramps of any direction, level light, lone spots off the centre.
    fn smooth(rng: &mut impl rand::Rng, kind: usize) -> Array3<f32> {
        let [a, b, brightness]: [f64; 3] = std::array::from_fn(|_| rng.random());
        Array3::from_shape_fn((3, 96, 96), |(_, y, x)| {
            let (y, x) = (y as f64 / 96.0, x as f64 / 96.0);
            let light = match kind {
                0 => 5.0 * x,
                1 => 3.0 * brightness * (a * y + b * x),
                2 => brightness,
                _ => 600.0 / (1.0 + 5000.0 * ((y - a).powi(2) + (x - b).powi(2))).powf(1.5),
            };
            light as f32
        })
    }

    /// 14 bits, read noise of 0.15 % of white, shot noise of 5000 electrons.
    fn noisy(rng: &mut impl rand::Rng, scene: &Array3<f32>, time: f64) -> Array3<f32> {
        scene.mapv(|light| {
            let value = f64::from(light) * time;
            let normal = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            let value = value + normal * (0.0015f64.powi(2) + value.min(1.0) / 5000.0).sqrt();
            ((value * 16383.0).round() / 16383.0).clamp(0.0, 1.0) as f32
        })
    }

    #[test]
    fn noise_moves_no_picture_that_stood_still() {
        let mut suspected = 0;
        for seed in 0..48 {
            let mut rng = stream(seed, "smooth");
            let scene = smooth(&mut rng, seed as usize % 4);
            let times = [[1.0, 1.0 / 4.0, 1.0 / 16.0], [1.0, 1.0 / 32.0, 1.0 / 768.0]][seed as usize / 4 % 2];
            let frames = times.map(|time| noisy(&mut rng, &scene, time));
            // A time that is wrong by a tenth moves nothing either.
            for wrong in [1.0, 1.1] {
                let told = [times[0], times[1] * wrong, times[2]];
                let motions = motions(&frames, &told, 0.99).unwrap();
                suspected += motions.iter().filter(|motion| motion.is_none()).count();
                check_motion(&motions, [[1, 2], [2, 3]], Some(1.0))
                    .unwrap_or_else(|error| panic!("{seed}: {error}"));
            }
        }
        assert!(suspected > 40, "{suspected} displacements were tempting, too few to test anything");
    }

    #[test]
    fn noise_hides_no_displacement_of_texture() {
        for seed in 0..12 {
            let mut rng = stream(seed, "texture");
            let (down, right) = [(1.5, -1.0), (-4.0, 3.0), (0.0, 9.0)][seed as usize % 3];
            let frames =
                [noisy(&mut rng, &scene(0.0, 0.0), 1.0), noisy(&mut rng, &scene(down, right), 1.0 / 16.0)];
            let motions = motions(&frames, &TIMES, 0.99).unwrap();
            assert!(check_motion(&motions, [[1, 2]], Some(1.0)).is_err(), "{seed}: {motions:?}");
        }
    }

    #[test]
    fn refuses_what_moved_further_than_allowed() {
        let motions = [None, found(3.0, -5.5)];
        let message = check_motion(&motions, [[3, 1], [1, 2]], Some(1.0)).unwrap_err().to_string();
        assert!(message.contains("picture 2") && message.contains("against picture 1"), "{message}");
        assert!(message.contains("--allow-motion"), "{message}");
        check_motion(&motions, [[3, 1], [1, 2]], None).unwrap();
        check_motion(&[found(0.5, 0.0)], [[1, 2]], Some(1.0)).unwrap();
    }
}
