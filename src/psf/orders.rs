//! Turns a repeating display into its diffraction orders, and these into the field at the lens.
//!
//! # Equation
//! A periodic transmittance is a Fourier series `t(ξ) = Σ T_mn exp(2πi ν_mn·ξ)` of plane waves. Each passes the
//! gap d′ between display and lens with no more than a phase,
//! `T_mn → T_mn · exp(−iπλd′|ν_mn|²)`, so that the propagation is exact: no guard band, no wrap-around, and
//! Parseval's theorem holds order by order. What the sensor cannot see is left out before, not aliased.

use std::f64::consts::PI;

use ndarray::Array2;
use rayon::prelude::*;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;

use super::layout::UnitCell;

/// The Fourier coefficients of a display, of orders −m…m along each axis.
///
/// # Shapes
/// `[2·m_y + 1, 2·m_x + 1]`, order (0, 0) in the middle.
#[derive(Clone, Debug)]
pub struct Orders {
    coefficients: Array2<Complex64>,
    frequency_per_m: [f64; 2],
    centre_m: [f64; 2],
}

impl Orders {
    /// Analyses a cell: all orders up to the spatial frequency `band_per_m` along each axis.
    ///
    /// The raster squares are taken as uniform, which the factor sinc(ν·side) expresses exactly: with its
    /// infinitely many orders the series would be the cell, square for square.
    pub fn of(cell: &UnitCell, band_per_m: f64) -> Self {
        let spectrum = transform(&cell.transmittance);
        let period_m = cell.period_m();
        let frequency_per_m = period_m.map(|period| 1.0 / period);
        let highest = period_m.map(|period| whole(band_per_m * period));
        let lengths = [cell.transmittance.nrows(), cell.transmittance.ncols()];
        // Along one axis: the index in the transform, and the factor of a uniform square around its centre.
        let along = |axis: usize| -> Vec<(usize, Complex64)> {
            let length = lengths[axis] as f64;
            (-highest[axis]..=highest[axis])
                .map(|order| {
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "in 0..length"
                    )]
                    let index = (order as f64).rem_euclid(length) as usize;
                    let turns = order as f64 * (0.5 - 0.5 / length);
                    (index, Complex64::cis(2.0 * PI * turns) * sinc(order as f64 / length) / length)
                })
                .collect()
        };
        let (rows, columns) = (along(0), along(1));
        let coefficients = Array2::from_shape_fn((rows.len(), columns.len()), |(y, x)| {
            spectrum[[rows[y].0, columns[x].0]] * rows[y].1 * columns[x].1
        });
        Self { coefficients, frequency_per_m, centre_m: cell.centre_m }
    }

    /// The bytes that making these orders of `cell` and a [`Field`] of them takes at its peak.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, and is positive")]
    pub fn memory_bytes(cell: &UnitCell, band_per_m: f64) -> usize {
        let complex = size_of::<Complex64>();
        let counts = cell.period_m().map(|period| 2.0 * (band_per_m * period).floor() + 1.0);
        let coefficients = (counts[0] * counts[1]) as usize * complex;
        // The cell, and its transform before and after it is turned over.
        let analysis = cell.transmittance.len() * (size_of::<f64>() + 2 * complex);
        // The orders and their copy for one wavelength; the field's raster, twice as fine, also twice.
        analysis.max(2 * coefficients + 2 * 4 * coefficients)
    }

    /// Σ|T_mn|²: the light that these orders carry, as a share of what falls on the display.
    pub fn power(&self) -> f64 {
        self.coefficients.iter().map(Complex64::norm_sqr).sum()
    }

    /// Keeps the orders for which `keep` holds; it is given their spatial frequencies (y, x) in 1/m.
    #[must_use]
    pub fn retain(mut self, keep: impl Fn(f64, f64) -> bool) -> Self {
        let frequencies = self.frequencies();
        for (index, value) in self.coefficients.indexed_iter_mut() {
            let [y, x] = frequencies(index);
            if !keep(y, x) {
                *value = Complex64::default();
            }
        }
        self
    }

    /// Sends the orders over a gap; their power stays.
    #[must_use]
    pub fn propagate(mut self, wavelength_m: f64, gap_m: f64) -> Self {
        let frequencies = self.frequencies();
        for (index, value) in self.coefficients.indexed_iter_mut() {
            let [y, x] = frequencies(index);
            *value *= Complex64::cis(-PI * wavelength_m * gap_m * (y * y + x * x));
        }
        self
    }

    fn frequencies(&self) -> impl Fn((usize, usize)) -> [f64; 2] + use<> {
        let (rows, columns) = self.coefficients.dim();
        let (middle_y, middle_x) = ((rows / 2) as f64, (columns / 2) as f64);
        let [fy, fx] = self.frequency_per_m;
        move |(y, x)| [(y as f64 - middle_y) * fy, (x as f64 - middle_x) * fx]
    }

    /// Prepares the field for evaluation at any point.
    pub fn field(&self) -> Field {
        Field::new(self)
    }
}

fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-12 { 1.0 } else { (PI * x).sin() / (PI * x) }
}

#[expect(clippy::cast_possible_truncation, reason = "saturates; such orders would not fit in memory anyway")]
fn whole(count: f64) -> i64 {
    count.floor() as i64
}

/// The discrete Fourier transform of a real array along both axes.
fn transform(values: &Array2<f64>) -> Array2<Complex64> {
    let (rows, columns) = values.dim();
    let mut planner = FftPlanner::new();
    let (along_rows, along_columns) = (planner.plan_fft_forward(columns), planner.plan_fft_forward(rows));
    let complex = values.mapv(|v| Complex64::new(v, 0.0));
    transform_lines(transform_lines(complex, along_rows.as_ref()).reversed_axes(), along_columns.as_ref())
        .reversed_axes()
}

fn transform_lines(values: Array2<Complex64>, fft: &dyn rustfft::Fft<f64>) -> Array2<Complex64> {
    let mut values =
        if values.is_standard_layout() { values } else { values.as_standard_layout().into_owned() };
    let length = values.ncols();
    let lines = values.as_slice_mut().expect("just made contiguous");
    lines.par_chunks_mut(length).for_each_init(
        || vec![Complex64::default(); fft.get_inplace_scratch_len()],
        |scratch, line| fft.process_with_scratch(line, scratch),
    );
    values
}

/// A band-limited periodic field, evaluated between the points of an oversampled raster of its period.
///
/// # Accuracy
/// A non-uniform Fourier transform with the kernel exp(β(√(1−z²) − 1)) of width 8 at twice the Nyquist rate
/// (Barnett, Magland, af Klinteberg 2019): relative error about 1e-7 of the largest field.
#[derive(Clone, Debug)]
pub struct Field {
    /// The raster, repeated at its borders by the kernel's width.
    raster: Array2<Complex64>,
    points_per_m: [f64; 2],
    lengths: [f64; 2],
    centre_m: [f64; 2],
    kernel: Vec<[f64; KERNEL_WIDTH]>,
}

/// Raster points under the kernel.
const KERNEL_WIDTH: usize = 8;
/// β of the kernel: 2.30 per point of its width at an oversampling of two.
const KERNEL_BETA: f64 = 2.3 * KERNEL_WIDTH as f64;

fn kernel(distance: f64) -> f64 {
    let z = distance * 2.0 / KERNEL_WIDTH as f64;
    let inside = 1.0 - z * z;
    if inside < 0.0 { 0.0 } else { (KERNEL_BETA * (inside.sqrt() - 1.0)).exp() }
}

/// Steps of a raster point at which the kernel is tabulated; linear interpolation between them errs by
/// φ″/8 ≈ 0.15 of the squared step, 1.4e-7.
const KERNEL_STEPS: usize = 1024;

/// The kernel at the raster points under it, for every step of the position between two points.
fn kernel_table() -> Vec<[f64; KERNEL_WIDTH]> {
    let half = KERNEL_WIDTH as f64 / 2.0;
    let row = |step: usize| {
        let place = step as f64 / KERNEL_STEPS as f64;
        std::array::from_fn(|index| kernel(place + half - 1.0 - index as f64))
    };
    (0..=KERNEL_STEPS).map(row).collect()
}

/// The Fourier transform of the kernel, at `frequency` periods per raster point.
///
/// The kernel falls to e^−β = 1e-8 at its ends, where the midpoint rule stops being exponentially accurate.
fn kernel_spectrum(frequency: f64) -> f64 {
    const POINTS: usize = 512;
    let step = KERNEL_WIDTH as f64 / POINTS as f64;
    let half = KERNEL_WIDTH as f64 / 2.0;
    (0..POINTS)
        .map(|index| {
            let x = (index as f64 + 0.5) * step - half;
            kernel(x) * (2.0 * PI * frequency * x).cos()
        })
        .sum::<f64>()
        * step
}

impl Field {
    fn new(orders: &Orders) -> Self {
        let (rows, columns) = orders.coefficients.dim();
        let lengths = [rows, columns].map(|count| fast_length((2 * count).max(2 * KERNEL_WIDTH)));
        // The place of each order in the transform, and what the kernel will take from it.
        let along = |count: usize, length: usize| -> Vec<(usize, f64)> {
            let middle = count / 2;
            (0..count)
                .map(|index| {
                    let frequency = (index as f64 - middle as f64) / length as f64;
                    ((index + length - middle) % length, 1.0 / kernel_spectrum(frequency))
                })
                .collect()
        };
        let (by_row, by_column) = (along(rows, lengths[0]), along(columns, lengths[1]));
        let mut spectrum = Array2::<Complex64>::zeros((lengths[0], lengths[1]));
        for ((y, x), value) in orders.coefficients.indexed_iter() {
            spectrum[[by_row[y].0, by_column[x].0]] = value * (by_row[y].1 * by_column[x].1);
        }
        let mut planner = FftPlanner::new();
        let (across, down) = (planner.plan_fft_inverse(lengths[1]), planner.plan_fft_inverse(lengths[0]));
        let raster =
            transform_lines(transform_lines(spectrum, across.as_ref()).reversed_axes(), down.as_ref())
                .reversed_axes();
        let margin = KERNEL_WIDTH;
        let repeated = Array2::from_shape_fn((lengths[0] + 2 * margin, lengths[1] + 2 * margin), |(y, x)| {
            raster[[(y + lengths[0] - margin) % lengths[0], (x + lengths[1] - margin) % lengths[1]]]
        });
        Self {
            raster: repeated,
            points_per_m: [0, 1].map(|axis| lengths[axis] as f64 * orders.frequency_per_m[axis]),
            lengths: lengths.map(|length| length as f64),
            centre_m: orders.centre_m,
            kernel: kernel_table(),
        }
    }

    /// The field at a point of the display plane, along the panel's own axes, in metres from the axis.
    ///
    /// # Panics
    /// Never: the raster is contiguous.
    pub fn at(&self, y_m: f64, x_m: f64) -> Complex64 {
        let (top, weights_y) = self.weights(0, y_m);
        let (left, weights_x) = self.weights(1, x_m);
        let mut sum = Complex64::default();
        for (row, weight_y) in weights_y.iter().enumerate() {
            let line = self.raster.row(top + row);
            let line = &line.as_slice().expect("the raster is contiguous")[left..left + KERNEL_WIDTH];
            let along: Complex64 = line.iter().zip(&weights_x).map(|(value, weight)| value * weight).sum();
            sum += along * weight_y;
        }
        sum
    }

    /// The first raster point under the kernel around a position, and the kernel at all of them.
    fn weights(&self, axis: usize, position_m: f64) -> (usize, [f64; KERNEL_WIDTH]) {
        let turns = (position_m - self.centre_m[axis]) * self.points_per_m[axis] / self.lengths[axis];
        let place = (turns - turns.floor()) * self.lengths[axis];
        let below = place.floor();
        let steps = (place - below) * KERNEL_STEPS as f64;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "not negative, and small"
        )]
        let (point, step) = (below as usize, steps as usize);
        let share = steps - step as f64;
        let (low, high) = (&self.kernel[step], &self.kernel[(step + 1).min(KERNEL_STEPS)]);
        let weights = std::array::from_fn(|index| low[index] + share * (high[index] - low[index]));
        // The raster repeats a kernel's width before its first point; the kernel starts half of it before.
        (point + KERNEL_WIDTH - (KERNEL_WIDTH / 2 - 1), weights)
    }
}

/// The next length that has no prime factor above 5, which transforms fastest.
pub fn fast_length(at_least: usize) -> usize {
    let smooth = |mut n: usize| {
        for prime in [2, 3, 5] {
            while n.is_multiple_of(prime) {
                n /= prime;
            }
        }
        n == 1
    };
    (at_least.max(1)..).find(|&n| smooth(n)).unwrap_or(at_least)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell() -> UnitCell {
        // An asymmetric cell of 12 × 10 squares.
        let transmittance =
            Array2::from_shape_fn((12, 10), |(y, x)| ((y * 7 + x * 3 + y * x) % 11) as f64 / 10.0);
        UnitCell { transmittance, raster_m: [2e-6, 3e-6], centre_m: [4e-6, -5e-6] }
    }

    /// All orders that the raster's transform has, once: Parseval on the raster, but for the factor sinc.
    #[test]
    fn orders_carry_the_power_of_the_cell() {
        let cell = cell();
        let power_to = |band| Orders::of(&cell, band).power();
        let total = cell.mean_power();
        // The tail of a Fourier series with jumps falls as 1/ν: within 2 % at 40 times the raster's Nyquist.
        let most = power_to(40.0 * 0.25e6);
        assert!(most < total && most > 0.98 * total, "{most} of {total}");
        assert!(power_to(0.25e6) < most);
    }

    #[test]
    fn propagation_conserves_power_order_by_order_and_undoes_itself() {
        let orders = Orders::of(&cell(), 1e6);
        let there = orders.clone().propagate(530e-9, 1e-3);
        assert!((there.power() / orders.power() - 1.0).abs() < 1e-14);
        let back = there.propagate(530e-9, -1e-3);
        let difference = (&back.coefficients - &orders.coefficients).mapv(|v| v.norm());
        assert!(difference.iter().all(|d| *d < 1e-12));
    }

    /// Talbot: every order has turned by whole periods at 2p²/λ, 2·(period of 24 µm and 30 µm)² being
    /// multiples of each other at 16 and 25 times 2·(6 µm)².
    #[test]
    fn a_grating_images_itself_at_the_talbot_distance() {
        let orders = Orders::of(&cell(), 0.7e6);
        let wavelength = 500e-9;
        let talbot = 2.0 * (16.0 * 25.0) * (6e-6f64).powi(2) / wavelength;
        let field = |gap| orders.clone().propagate(wavelength, gap).field();
        let (near, there, half) = (field(0.0), field(talbot), field(talbot / 3.0));
        let place = (3.3e-6, -8.1e-6);
        assert!((near.at(place.0, place.1) - there.at(place.0, place.1)).norm() < 1e-5);
        assert!((near.at(place.0, place.1) - half.at(place.0, place.1)).norm() > 1e-2);
    }

    /// The sum of the series, term by term, is the reference.
    #[test]
    fn the_field_is_the_sum_of_its_orders_anywhere() {
        let orders = Orders::of(&cell(), 0.7e6).propagate(610e-9, 0.2e-3);
        let field = orders.field();
        let frequencies = orders.frequencies();
        for (y, x) in [(0.0, 0.0), (1.3e-6, -7.7e-6), (1.234e-3, 0.777e-3), (-0.9e-3, 0.1e-6)] {
            let direct: Complex64 = orders
                .coefficients
                .indexed_iter()
                .map(|(index, value)| {
                    let [fy, fx] = frequencies(index);
                    value * Complex64::cis(2.0 * PI * (fy * (y - 4e-6) + fx * (x + 5e-6)))
                })
                .sum();
            assert!((field.at(y, x) - direct).norm() < 1e-6, "at {y}, {x}");
        }
    }

    /// Averaged over a raster square, the series with many orders gives the square's transmittance back.
    #[test]
    fn the_field_behind_the_display_is_its_transmittance() {
        let cell = cell();
        let field = Orders::of(&cell, 8e6).field();
        // Square (3, 6): rows 6…8 µm of 24, columns 18…21 µm of 30, from the cell's corner.
        let (y, x) = (7e-6 - 12e-6 + 4e-6, 19.5e-6 - 15e-6 - 5e-6);
        let found = field.at(y, x);
        // Gibbs ripples at the middle of a square, about 16 periods from its edges: 1/(π²·16).
        assert!((found - cell.transmittance[[3, 6]]).norm() < 0.02, "{found}");
    }

    #[test]
    fn a_bare_lens_has_one_order() {
        let uniform =
            UnitCell { transmittance: Array2::ones((1, 1)), raster_m: [1.0; 2], centre_m: [0.0; 2] };
        let orders = Orders::of(&uniform, 0.5);
        assert_eq!(orders.coefficients.dim(), (1, 1));
        assert!((orders.field().at(0.3e-3, 0.2e-3) - 1.0).norm() < 1e-6);
    }
}
