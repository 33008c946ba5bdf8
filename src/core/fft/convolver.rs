//! Convolution of images with PSFs through spectra that are computed once.

#![expect(clippy::needless_pass_by_value, reason = "views of arrays are values")]

use std::ops::Range;

use ndarray::{Array3, ArrayView2};
use rayon::prelude::*;
use rustfft::num_complex::{Complex, Complex32, Complex64};

use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::psf::Psf;

use super::Boundary;
use super::geometry::AxisGeometry;
use super::plane::PlaneSpectrum;
use super::real::Real;
use super::transform::{Transform, Window};

/// Convolves images of one size with PSFs of one size.
///
/// Plans and buffers are kept inside; share one convolver among threads and scenes.
///
/// # Equation
/// `out[y, x] = Σ psf[cy + dy, cx + dx] · image[y − dy, x − dx]` with (cy, cx) the index N // 2 of the PSF,
/// for every pixel of the image ('same' size); the [`Boundary`] says what the image is outside. A PSF may be
/// larger than the image.
///
/// # Accuracy
/// The error of a 32-bit transform is proportional to the root mean square of the image and, where rounding adds
/// up, to its peak, which the highlights of an HDR scene raise far above the dark pixels that matter. A channel is
/// therefore transformed in 32 bits only while it stays below [`SINGLE_RMS`] and [`SINGLE_PEAK`], which keeps the
/// error below 5·10⁻⁶ and 10⁻⁶ of the value, and in 64 bits, to the rounding of the result, where it does not.
/// [`Convolver::convolve_plane`] and its kin, which iterative solvers repeat many times, always take 64 bits.
pub struct Convolver {
    pub(super) rows: AxisGeometry,
    pub(super) columns: AxisGeometry,
    pub(super) transform: Transform<f64>,
    single: Transform<f32>,
    boundary: Boundary,
}

/// The greatest root mean square, over the samples of the transform, of a channel that is convolved in 32 bits.
///
/// Rounding errors that do not know of each other leave near √(log₂ N) · 2⁻²⁴ of it after transforms of N samples
/// there and back, 3·10⁻⁷ for a million. A PSF has unit sum, hence an OTF that nowhere exceeds 1.
pub const SINGLE_RMS: f64 = 2.0;

/// The brightest pixel of a channel that is convolved in 32 bits.
///
/// A lamp lights all frequencies alike, and the rounding of the twiddle factors, the same for all of them, adds up
/// elsewhere to about 2⁻²³ of it.
pub const SINGLE_PEAK: f32 = 32.0;

/// The optical transfer function: the transform of a PSF about its centre, for one [`Convolver`].
#[derive(Clone, Debug)]
pub struct Otf {
    channels: [SplitSpectrum; CHANNELS],
}

/// A spectrum of 64 bits as the sum of its 32-bit rounding and of the 32-bit rounding of what that leaves: either
/// precision reads no more than it needs.
#[derive(Clone, Debug, Default)]
struct SplitSpectrum {
    high: Vec<Complex32>,
    low: Vec<Complex32>,
}

/// The transform of an image with its border, for one [`Convolver`].
#[derive(Clone, Debug)]
pub struct Spectrum {
    channels: [ChannelSpectrum; CHANNELS],
}

#[derive(Clone, Debug)]
enum ChannelSpectrum {
    Single(Vec<Complex32>),
    Double(PlaneSpectrum),
}

impl Convolver {
    /// Plans the convolution of `[height, width]` images with `[height, width]` PSFs.
    ///
    /// # Errors
    /// [`Error::Shape`] when a side is zero.
    pub fn new(image: [usize; 2], psf: [usize; 2], boundary: Boundary) -> Result<Self> {
        for (what, size) in [("image", image), ("PSF", psf)] {
            if size.contains(&0) {
                return Err(Error::shape(what, "at least 1 × 1", describe(size)));
            }
        }
        let rows = AxisGeometry::new(image[0], psf[0], boundary);
        let columns = AxisGeometry::new(image[1], psf[1], boundary);
        let transform = Transform::new(rows.transform, columns.transform);
        let single = Transform::new(rows.transform, columns.transform);
        Ok(Self { rows, columns, transform, single, boundary })
    }

    /// The `[height, width]` of images.
    pub fn image_size(&self) -> [usize; 2] {
        [self.rows.scene, self.columns.scene]
    }

    /// The `[height, width]` of PSFs.
    pub fn psf_size(&self) -> [usize; 2] {
        [self.rows.kernel, self.columns.kernel]
    }

    /// The `[height, width]` of the transforms.
    pub fn transform_size(&self) -> [usize; 2] {
        [self.rows.transform, self.columns.transform]
    }

    /// The boundary of this convolver.
    pub fn boundary(&self) -> Boundary {
        self.boundary
    }

    /// Bytes of one [`Otf`] or [`Spectrum`].
    pub fn spectrum_bytes(&self) -> usize {
        CHANNELS * self.transform.spectrum_len() * size_of::<Complex64>()
    }

    /// Bytes that stand between the two passes of the transform of one plane.
    pub fn intermediate_bytes(&self) -> usize {
        self.rows.extended * (self.columns.transform / 2 + 1) * size_of::<Complex64>()
    }

    /// Transforms a PSF.
    ///
    /// # Errors
    /// [`Error::Shape`] when the PSF is not of this convolver's size.
    pub fn otf(&self, psf: &Psf) -> Result<Otf> {
        require_size("PSF", self.psf_size(), [psf.height(), psf.width()])?;
        Ok(Otf {
            channels: each_channel(|channel| {
                let spectrum = self.transform_kernel(psf.channel(channel));
                let split = SplitSpectrum::new(&spectrum);
                self.transform.reuse(spectrum);
                split
            }),
        })
    }

    /// Transforms an image with its border.
    ///
    /// # Errors
    /// [`Error::Shape`] when the image is not of this convolver's size.
    pub fn spectrum(&self, image: &LinearImage) -> Result<Spectrum> {
        require_size("image", self.image_size(), [image.height(), image.width()])?;
        Ok(Spectrum { channels: each_channel(|channel| self.channel_spectrum(image.channel(channel))) })
    }

    fn channel_spectrum(&self, plane: ArrayView2<'_, f32>) -> ChannelSpectrum {
        // Rows one after another, so that the choice does not depend on the number of threads.
        let row_energy = |row: usize| -> f64 {
            let row = plane.row(self.rows.source(row));
            self.columns.sources().map(|x| f64::from(row[x]).powi(2)).sum()
        };
        let energy: f64 = (0..self.rows.extended).map(row_energy).sum();
        let samples = self.rows.transform as f64 * self.columns.transform as f64;
        let peak = plane.iter().fold(0.0, |peak: f32, value| peak.max(value.abs()));
        if energy <= SINGLE_RMS.powi(2) * samples && peak <= SINGLE_PEAK {
            ChannelSpectrum::Single(self.transform_plane(&self.single, plane))
        } else {
            ChannelSpectrum::Double(self.transform_plane(&self.transform, plane))
        }
    }

    /// Transforms a plane with its border in the precision of `transform`.
    pub(super) fn transform_plane<T: Real>(
        &self,
        transform: &Transform<T>,
        plane: ArrayView2<'_, f32>,
    ) -> Vec<Complex<T>> {
        let sources: Vec<usize> = self.columns.sources().collect();
        let rows = 0..self.rows.extended;
        transform.forward(std::slice::from_ref(&rows), |row, samples| {
            let source = plane.row(self.rows.source(row));
            for (sample, &x) in samples.iter_mut().zip(&sources) {
                *sample = T::from(source[x]);
            }
        })
    }

    /// Convolves: the product of both transforms, back to planes `[3, height, width]`.
    ///
    /// # Panics
    /// When the spectrum or the OTF is of another convolver.
    pub fn convolve(&self, image: &Spectrum, otf: &Otf) -> Array3<f32> {
        let [height, width] = self.image_size();
        let mut out = Array3::zeros((CHANNELS, height, width));
        self.convolve_into(image, otf, out.as_slice_mut().expect("new arrays are contiguous"));
        out
    }

    /// As [`convolve`](Self::convolve), but for the middle: without `margin` pixels on each side.
    ///
    /// # Panics
    /// When the margin leaves nothing, or the spectrum or the OTF is of another convolver.
    pub fn convolve_middle(&self, image: &Spectrum, otf: &Otf, margin: usize) -> Array3<f32> {
        let [height, width] = self.image_size();
        assert!(2 * margin < height.min(width), "a margin of {margin} leaves nothing of {height} × {width}");
        let (height, width) = (height - 2 * margin, width - 2 * margin);
        let mut out = Array3::zeros((CHANNELS, height, width));
        let (top, left) = (self.rows.lead + margin, self.columns.lead + margin);
        let window = Window { top, left, height, width };
        self.convolve_window(image, otf, window, out.as_slice_mut().expect("new arrays are contiguous"));
        out
    }

    /// Convolves into planes `[3, height, width]` that exist already.
    ///
    /// # Panics
    /// When `out` has another length, or the spectrum or the OTF is of another convolver.
    pub fn convolve_into(&self, image: &Spectrum, otf: &Otf, out: &mut [f32]) {
        let [height, width] = self.image_size();
        assert_eq!(out.len(), CHANNELS * height * width, "the output has the image's size");
        let window = Window { top: self.rows.lead, left: self.columns.lead, height, width };
        self.convolve_window(image, otf, window, out);
    }

    /// Convolves, and keeps a window of the extended scene.
    fn convolve_window(&self, image: &Spectrum, otf: &Otf, window: Window, out: &mut [f32]) {
        let plane = window.height * window.width;
        let spectra = image.channels.iter().zip(&otf.channels);
        for ((spectrum, SplitSpectrum { high, low }), out) in spectra.zip(out.chunks_exact_mut(plane)) {
            assert_eq!(high.len(), self.transform.spectrum_len(), "the OTF belongs to this convolver");
            match spectrum {
                ChannelSpectrum::Single(spectrum) => {
                    let otf = |range: Range<usize>| high[range].iter().copied();
                    self.single.inverse(self.product(spectrum, otf), window, out);
                }
                ChannelSpectrum::Double(spectrum) => {
                    let otf = |range: Range<usize>| {
                        high[range.clone()]
                            .iter()
                            .zip(&low[range])
                            .map(|(high, low)| widen(high) + widen(low))
                    };
                    self.transform.inverse(self.product(spectrum, otf), window, out);
                }
            }
        }
    }

    /// Takes a spectrum that is no longer needed, so that the next one is written in its place.
    pub fn reuse(&self, spectrum: Spectrum) {
        for channel in spectrum.channels {
            match channel {
                ChannelSpectrum::Single(channel) => self.single.reuse(channel),
                ChannelSpectrum::Double(channel) => self.transform.reuse(channel),
            }
        }
    }

    /// The columns of a spectrum times a filter, for [`Transform::inverse`]; `filter` gives its values at some indices.
    pub(super) fn product<T: Real, I: Iterator<Item = Complex<T>>>(
        &self,
        spectrum: &[Complex<T>],
        filter: impl Fn(Range<usize>) -> I + Sync,
    ) -> impl Fn(usize, &mut [Complex<T>]) + Sync {
        let (len, height) = (self.transform.spectrum_len(), self.transform.height());
        assert_eq!(spectrum.len(), len, "the spectrum belongs to this convolver");
        move |kx, column| {
            let range = kx * height..(kx + 1) * height;
            for ((out, x), h) in column.iter_mut().zip(&spectrum[range.clone()]).zip(filter(range)) {
                *out = *x * h;
            }
        }
    }

    pub(super) fn transform_kernel(&self, kernel: ArrayView2<'_, f32>) -> PlaneSpectrum {
        let columns = self.columns.kernel_places();
        // A periodic kernel larger than the image wraps onto itself: several samples share a place.
        let mut sources = vec![Vec::new(); self.rows.transform];
        for (sample, place) in self.rows.kernel_places() {
            sources[place].push(sample);
        }
        let occupied = occupied_ranges(&sources);
        self.transform.forward(&occupied, |row, samples| {
            for &source in &sources[row] {
                let source = kernel.row(source);
                for &(sample, place) in &columns {
                    samples[place] += f64::from(source[sample]);
                }
            }
        })
    }
}

impl SplitSpectrum {
    fn new(spectrum: &[Complex64]) -> Self {
        let high: Vec<Complex32> = spectrum.iter().map(|&z| narrow(z)).collect();
        let low = spectrum.iter().zip(&high).map(|(&z, high)| narrow(z - widen(high))).collect();
        Self { high, low }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "rounding is what it is for")]
fn narrow(z: Complex64) -> Complex32 {
    Complex::new(z.re as f32, z.im as f32)
}

fn widen(z: &Complex32) -> Complex64 {
    Complex::new(f64::from(z.re), f64::from(z.im))
}

fn each_channel<T: Send>(make: impl Fn(usize) -> T + Sync) -> [T; CHANNELS] {
    let mut channels: [Option<T>; CHANNELS] = Default::default();
    channels.par_iter_mut().enumerate().for_each(|(channel, out)| *out = Some(make(channel)));
    channels.map(|channel| channel.expect("every channel was made"))
}

pub(super) fn occupied_ranges(sources: &[Vec<usize>]) -> Vec<Range<usize>> {
    let mut ranges: Vec<Range<usize>> = Vec::new();
    for (place, samples) in sources.iter().enumerate() {
        match ranges.last_mut() {
            _ if samples.is_empty() => {}
            Some(range) if range.end == place => range.end = place + 1,
            _ => ranges.push(place..place + 1),
        }
    }
    ranges
}

pub(super) fn require_size(what: &str, expected: [usize; 2], found: [usize; 2]) -> Result<()> {
    if expected == found { Ok(()) } else { Err(Error::shape(what, describe(expected), describe(found))) }
}

fn describe([height, width]: [usize; 2]) -> String {
    format!("{height} × {width}")
}
