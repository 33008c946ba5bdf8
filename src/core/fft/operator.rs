//! The convolution of one plane as a matrix with its transpose, row by row from whatever makes the rows: what solvers
//! that multiply by weights between the transforms need.

#![expect(clippy::needless_pass_by_value, reason = "views of arrays are values")]

use std::f32::consts::PI;

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::Boundary;
use super::convolver::require_size;
use super::geometry::AxisGeometry;
use super::lanes::{LaneSpectrum, LaneTransform};
use super::real::Real;
use super::transform::{Keep, Transform, Window};
use crate::core::error::Result;
use crate::kernels::fourier::{COMPLEX, Response, WIDE};

/// The numbers that transforms compute with; planes are of 32 bits in either case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransformPrecision {
    /// 32 bits: errors of about 10⁻⁷ of a plane's peak.
    Single,
    /// 64 bits, for planes of which the peak is far above what matters.
    Double,
}

/// Columns of a spectrum that tell the mean over all to a percent.
const MEAN_COLUMNS: usize = 256;

/// Convolves planes of one size, dark outside or periodic, with kernels of one size.
pub struct PlaneOperator {
    rows: AxisGeometry,
    columns: AxisGeometry,
    transform: EitherTransform,
    /// The squared moduli of the transfer functions of differences along rows and columns: `4·sin²(π·k/N)`.
    laplacian: [Vec<f32>; 2],
}

enum EitherTransform {
    /// 32 bits, where sides are what is transformed line beside line.
    Lanes(LaneTransform),
    /// 32 bits, for any side.
    Single(Transform<f32>),
    Double(Transform<f64>),
}

/// The transform of a kernel about its centre, for one [`PlaneOperator`].
#[derive(Clone, Debug)]
pub struct TransferFunction(EitherSpectrum);

#[derive(Clone, Debug)]
enum EitherSpectrum {
    Lanes(LaneSpectrum),
    Single(Vec<Complex<f32>>),
    Double(Vec<Complex<f64>>),
}

impl PlaneOperator {
    /// Plans for `[height, width]` planes and `[height, width]` kernels.
    ///
    /// # Panics
    /// For a boundary that is made of the plane, of which the transpose is no correlation.
    pub fn new(
        plane: [usize; 2],
        kernel: [usize; 2],
        boundary: Boundary,
        precision: TransformPrecision,
    ) -> Self {
        assert!(
            matches!(boundary, Boundary::Zero | Boundary::Periodic),
            "{boundary:?} has no transpose here"
        );
        let rows = AxisGeometry::new(plane[0], kernel[0], boundary);
        let columns = AxisGeometry::new(plane[1], kernel[1], boundary);
        let (height, width) = (rows.transform, columns.transform);
        let transform = match precision {
            TransformPrecision::Single if LaneTransform::serves(height, width) => {
                EitherTransform::Lanes(LaneTransform::new(height, width))
            }
            TransformPrecision::Single => EitherTransform::Single(Transform::new(height, width)),
            TransformPrecision::Double => EitherTransform::Double(Transform::new(height, width)),
        };
        let laplacian = [differences(height, height), differences(width, width / 2 + 1)];
        Self { rows, columns, transform, laplacian }
    }

    /// Height and width of the planes.
    pub fn plane_size(&self) -> [usize; 2] {
        [self.rows.scene, self.columns.scene]
    }

    /// Height and width of the transforms.
    pub fn transform_size(&self) -> [usize; 2] {
        [self.rows.transform, self.columns.transform]
    }

    /// Transforms a kernel about its centre N // 2, every sample through `of_sample`.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::core::error::Error::Shape) when the kernel is not of the size that was planned for.
    pub fn transfer_function(
        &self,
        kernel: ArrayView2<'_, f32>,
        of_sample: impl Fn(f32) -> f32 + Sync,
    ) -> Result<TransferFunction> {
        require_size("kernel", [self.rows.kernel, self.columns.kernel], [kernel.nrows(), kernel.ncols()])?;
        // A periodic kernel larger than the plane wraps onto itself: several samples share a place.
        let mut sources = vec![Vec::new(); self.rows.transform];
        for (sample, place) in self.rows.kernel_places() {
            sources[place].push(sample);
        }
        let columns = self.columns.kernel_places();
        let rows = super::convolver::occupied_ranges(&sources);
        let samples_of = |row: usize| {
            let of_source = |source: usize| {
                let source = kernel.row(source);
                columns.iter().map(move |&(sample, place)| (place, source[sample]))
            };
            sources[row].iter().flat_map(move |source| of_source(*source))
        };
        Ok(TransferFunction(match &self.transform {
            EitherTransform::Lanes(transform) => {
                EitherSpectrum::Lanes(transform.forward(&rows, |row, samples| {
                    samples_of(row).for_each(|(place, sample)| samples[place] += of_sample(sample));
                }))
            }
            EitherTransform::Single(transform) => {
                EitherSpectrum::Single(transform.forward(&rows, |row, samples| {
                    samples_of(row).for_each(|(place, sample)| samples[place] += of_sample(sample));
                }))
            }
            EitherTransform::Double(transform) => {
                EitherSpectrum::Double(transform.forward(&rows, |row, samples| {
                    samples_of(row)
                        .for_each(|(place, sample)| samples[place] += f64::from(of_sample(sample)));
                }))
            }
        }))
    }

    /// Takes the room of what [`transfer_function`](Self::transfer_function) made for the next one; what is left is of no use.
    pub(crate) fn take_back(&self, kernel: &mut TransferFunction) {
        if let (EitherTransform::Lanes(transform), EitherSpectrum::Lanes(spectrum)) =
            (&self.transform, &mut kernel.0)
        {
            transform.take_back(std::mem::take(spectrum));
        }
    }

    /// A x: `fill(row, samples)` writes the first `rows` rows of x, which come as zeros as the others are; `keep(row, samples,
    /// out)` takes the rows of the result to those of `out`, which may be smaller than a plane and takes its top left. The sum of
    /// what `keep` returns is returned, added in the order of the rows; [`copy_row`](super::copy_row) does no more than its name
    /// says.
    ///
    /// # Panics
    /// When there are more rows, or `out` is larger, than those of the planes, or the transfer function is of another
    /// operator.
    pub fn convolve(
        &self,
        kernel: &TransferFunction,
        (rows, fill): (usize, impl Fn(usize, &mut [f32]) + Sync),
        into: (&mut Array2<f32>, impl Fn(usize, &[f32], &mut [f32]) -> f64 + Sync),
    ) -> f64 {
        self.filter(kernel, Response::Convolution, (rows, fill), into)
    }

    /// Aᵀ x, as [`convolve`](Self::convolve).
    ///
    /// # Panics
    /// As [`convolve`](Self::convolve).
    pub fn correlate(
        &self,
        kernel: &TransferFunction,
        (rows, fill): (usize, impl Fn(usize, &mut [f32]) + Sync),
        into: (&mut Array2<f32>, impl Fn(usize, &[f32], &mut [f32]) -> f64 + Sync),
    ) -> f64 {
        self.filter(kernel, Response::Correlation, (rows, fill), into)
    }

    /// Multiplies the spectrum of x by a response of the transfer function and of the Laplacian's; as [`convolve`](Self::convolve).
    ///
    /// # Panics
    /// As [`convolve`](Self::convolve).
    pub fn filter(
        &self,
        kernel: &TransferFunction,
        response: Response,
        (rows, fill): (usize, impl Fn(usize, &mut [f32]) + Sync),
        into: (&mut Array2<f32>, impl Fn(usize, &[f32], &mut [f32]) -> f64 + Sync),
    ) -> f64 {
        let from = (rows, &fill);
        match (&self.transform, &kernel.0, response) {
            (EitherTransform::Lanes(transform), EitherSpectrum::Lanes(otf), response) => {
                self.apply_lanes((transform, otf), from, into, response)
            }
            (EitherTransform::Single(transform), EitherSpectrum::Single(otf), response) => {
                self.apply((transform, otf), from, into, |h, laplacian| factor(response, h, laplacian))
            }
            (EitherTransform::Double(transform), EitherSpectrum::Double(otf), Response::Convolution) => {
                self.apply((transform, otf), from, into, |h, _| h)
            }
            (EitherTransform::Double(transform), EitherSpectrum::Double(otf), Response::Correlation) => {
                self.apply((transform, otf), from, into, |h, _| h.conj())
            }
            (EitherTransform::Double(transform), EitherSpectrum::Double(otf), response) => {
                self.apply((transform, otf), from, into, |h, laplacian| {
                    let factor = factor(response, narrow(h), laplacian);
                    Complex::new(f64::from(factor.re), f64::from(factor.im))
                })
            }
            _ => panic!("the transfer function belongs to this operator"),
        }
    }

    /// The mean over all frequencies of `of(|H|², L)` with the weight `along_y(ky) · along_x(kx)`, kx and ky counted from 0;
    /// L is the Laplacian's transfer function.
    ///
    /// # Accuracy
    /// Of wide transforms every so many-th kx is read, 256 of them at least: a kernel that fills a part of a
    /// plane has a transfer function that changes over several frequencies.
    pub fn mean(
        &self,
        kernel: &TransferFunction,
        of: impl Fn(f32, f32) -> f32 + Sync,
        [along_y, along_x]: [&dyn Fn(usize) -> f64; 2],
    ) -> f64 {
        let [of_y, of_x] = &self.laplacian;
        let along_y: Vec<f64> = (0..of_y.len()).map(along_y).collect();
        let along_x: Vec<f64> = (0..of_x.len()).map(along_x).collect();
        let of_column = |kx: usize| -> f64 {
            let terms = along_y.iter().zip(of_y).enumerate();
            terms.map(|(ky, (w, l))| w * f64::from(of(self.power(kernel, kx, ky), l + of_x[kx]))).sum::<f64>()
                * along_x[kx]
        };
        let read = || (0..of_x.len()).step_by((of_x.len() / MEAN_COLUMNS).max(1));
        let columns: Vec<f64> = read().collect::<Vec<_>>().into_par_iter().map(of_column).collect();
        let weight = along_y.iter().sum::<f64>() * read().map(|kx| along_x[kx]).sum::<f64>();
        columns.into_iter().sum::<f64>() / weight.max(f64::MIN_POSITIVE)
    }

    /// The means of `of(|H|²)` over bands of frequencies: those nearest to row/2n and column/2n of a pixel's, n × n of them,
    /// as the cosines of an n × n block have.
    ///
    /// # Accuracy
    /// As [`mean`](Self::mean); a band without any frequency has that of the whole.
    pub fn band_means(
        &self,
        kernel: &TransferFunction,
        of: impl Fn(f32) -> f32 + Sync,
        bands: usize,
    ) -> Array2<f32> {
        let height = self.rows.transform;
        let columns = self.laplacian[1].len();
        // Nearest, halves up: 2n·k/N + 1/2.
        let band = |k: usize, length: usize| ((4 * bands * k + length) / (2 * length)).min(bands - 1);
        let read: Vec<usize> = (0..columns).step_by((columns / MEAN_COLUMNS).max(1)).collect();
        let of_columns: Vec<Vec<f64>> = read
            .par_iter()
            .map(|kx| {
                let mut sums = vec![0.0; bands];
                for ky in 0..height {
                    sums[band(ky.min(height - ky), height)] += f64::from(of(self.power(kernel, *kx, ky)));
                }
                sums
            })
            .collect();
        let mut rows = vec![0.0; bands];
        (0..height).for_each(|ky| rows[band(ky.min(height - ky), height)] += 1.0);
        let (mut sums, mut counts) =
            (Array2::<f64>::zeros((bands, bands)), Array2::<f64>::zeros((bands, bands)));
        for (kx, of_column) in read.iter().zip(of_columns) {
            let column = band(*kx, self.columns.transform);
            for (row, (sum, count)) in of_column.into_iter().zip(&rows).enumerate() {
                sums[[row, column]] += sum;
                counts[[row, column]] += count;
            }
        }
        let whole = sums.sum() / counts.sum();
        #[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
        let mean = |sum: &f64, count: &f64| (if *count > 0.0 { sum / count } else { whole }) as f32;
        ndarray::Zip::from(&sums).and(&counts).map_collect(mean)
    }

    /// |H|² at a frequency of the half spectrum.
    fn power(&self, kernel: &TransferFunction, kx: usize, ky: usize) -> f32 {
        let index = kx * self.rows.transform + ky;
        match (&self.transform, &kernel.0) {
            (EitherTransform::Lanes(transform), EitherSpectrum::Lanes(otf)) => {
                let [re, im] = transform.place(kx, ky).map(|place| otf[place]);
                Complex::new(re, im).norm_sqr()
            }
            (_, EitherSpectrum::Single(otf)) => otf[index].norm_sqr(),
            (_, EitherSpectrum::Double(otf)) => narrow(otf[index]).norm_sqr(),
            _ => panic!("the transfer function belongs to this operator"),
        }
    }

    fn apply_lanes(
        &self,
        (transform, otf): (&LaneTransform, &[f32]),
        (rows, fill): (usize, &(impl Fn(usize, &mut [f32]) + Sync)),
        (out, keep): (&mut Array2<f32>, impl Keep),
        response: Response,
    ) -> f64 {
        assert_eq!(otf.len(), transform.spectrum_len(), "the transfer function belongs to this operator");
        let [height, width] = self.plane_size();
        assert!(rows <= height && out.nrows() <= height && out.ncols() <= width, "planes are larger");
        let [along_y, along_x] = &self.laplacian;
        let of_columns = self.rows.transform * COMPLEX;
        let multiply = |column: usize, lines: &mut [f32]| {
            let at = |lane: usize| along_x.get(column * WIDE + lane).copied().unwrap_or(0.0);
            response.multiply(
                lines,
                &otf[column * of_columns..][..of_columns],
                (along_y, &std::array::from_fn(at)),
            );
        };
        let fill = |row: usize, samples: &mut [f32]| fill(row, &mut samples[..width]);
        let width_out = out.ncols();
        let out = out.as_slice_mut().expect("planes are contiguous");
        transform.filter((rows, fill), multiply, (out, width_out), keep)
    }

    fn apply<T: Real>(
        &self,
        (transform, otf): (&Transform<T>, &[Complex<T>]),
        (rows, fill): (usize, &(impl Fn(usize, &mut [f32]) + Sync)),
        (out, keep): (&mut Array2<f32>, impl Keep),
        response: impl Fn(Complex<T>, f32) -> Complex<T> + Sync,
    ) -> f64 {
        assert_eq!(otf.len(), transform.spectrum_len(), "the transfer function belongs to this operator");
        let [height, width] = self.plane_size();
        let window = Window { top: 0, left: 0, height: out.nrows(), width: out.ncols() };
        assert!(rows <= height && window.height <= height && window.width <= width, "planes are larger");
        let tall = self.rows.transform;
        let [along_y, along_x] = &self.laplacian;
        let fill = |row: usize, samples: &mut [T]| {
            T::fill(&mut samples[..width], |samples| fill(row, samples));
        };
        let multiply = |kx: usize, column: &mut [Complex<T>]| {
            let otf = &otf[kx * tall..(kx + 1) * tall];
            for ((x, h), of_y) in column.iter_mut().zip(otf).zip(along_y) {
                *x = *x * response(*h, along_x[kx] + of_y);
            }
        };
        let out = out.as_slice_mut().expect("planes are contiguous");
        transform.filter((rows, fill), multiply, window, (out, keep))
    }
}

fn factor(response: Response, h: Complex<f32>, laplacian: f32) -> Complex<f32> {
    let [re, im] = response.of([h.re, h.im], laplacian);
    Complex::new(re, im)
}

fn narrow<T: Real>(z: Complex<T>) -> Complex<f32> {
    let part = |x: T| x.to_f32().expect("a float is rounded");
    Complex::new(part(z.re), part(z.im))
}

/// `4·sin²(π·k/N)` of the first frequencies.
#[expect(clippy::cast_precision_loss, reason = "sides of images are far below 2²⁴")]
fn differences(length: usize, count: usize) -> Vec<f32> {
    (0..count).map(|k| 4.0 * (PI * k as f32 / length as f32).sin().powi(2)).collect()
}

#[cfg(test)]
mod tests;
