//! Convolution of images with PSFs through spectra that are computed once.

#![expect(clippy::needless_pass_by_value, reason = "views of arrays are values")]

use std::ops::Range;

use ndarray::{Array3, ArrayView2};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::psf::Psf;

use super::Boundary;
use super::geometry::AxisGeometry;
use super::plane::PlaneSpectrum;
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
/// Transforms are 64-bit, so that a result is correct to the rounding of f32 even where a dark pixel stands
/// beside highlights that are 10⁶ times as bright.
pub struct Convolver {
    pub(super) rows: AxisGeometry,
    pub(super) columns: AxisGeometry,
    pub(super) transform: Transform,
    boundary: Boundary,
}

/// The optical transfer function: the transform of a PSF about its centre, for one [`Convolver`].
#[derive(Clone, Debug)]
pub struct Otf {
    channels: [PlaneSpectrum; CHANNELS],
}

/// The transform of an image with its border, for one [`Convolver`].
#[derive(Clone, Debug)]
pub struct Spectrum {
    channels: [PlaneSpectrum; CHANNELS],
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
        Ok(Self { rows, columns, transform, boundary })
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
        Ok(Otf { channels: each_channel(|channel| self.transform_kernel(psf.channel(channel))) })
    }

    /// Transforms an image with its border.
    ///
    /// # Errors
    /// [`Error::Shape`] when the image is not of this convolver's size.
    pub fn spectrum(&self, image: &LinearImage) -> Result<Spectrum> {
        require_size("image", self.image_size(), [image.height(), image.width()])?;
        Ok(Spectrum { channels: each_channel(|channel| self.plane_spectrum(image.channel(channel))) })
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

    /// Convolves into planes `[3, height, width]` that exist already.
    ///
    /// # Panics
    /// When `out` has another length, or the spectrum or the OTF is of another convolver.
    pub fn convolve_into(&self, image: &Spectrum, otf: &Otf, out: &mut [f32]) {
        let [height, width] = self.image_size();
        assert_eq!(out.len(), CHANNELS * height * width, "the output has the image's size");
        let window = Window { top: self.rows.lead, left: self.columns.lead, height, width };
        let spectra = image.channels.iter().zip(&otf.channels);
        for ((spectrum, otf), out) in spectra.zip(out.chunks_exact_mut(height * width)) {
            self.transform.inverse(self.product(spectrum, otf, &|x, h| x * h), window, out);
        }
    }

    /// Takes a spectrum that is no longer needed, so that the next one is written in its place.
    pub fn reuse(&self, spectrum: Spectrum) {
        for channel in spectrum.channels {
            self.transform.reuse(channel);
        }
    }

    /// The columns of the product of two spectra, for [`Transform::inverse`].
    pub(super) fn product<'a>(
        &self,
        spectrum: &'a [Complex64],
        otf: &'a [Complex64],
        response: &'a (impl Fn(Complex64, Complex64) -> Complex64 + Sync),
    ) -> impl Fn(usize, &mut [Complex64]) + Sync {
        let (len, height) = (self.transform.spectrum_len(), self.transform.height());
        assert_eq!((spectrum.len(), otf.len()), (len, len), "spectra belong to this convolver");
        move |kx, column| {
            let x = &spectrum[kx * height..][..height];
            let h = &otf[kx * height..][..height];
            for ((out, x), h) in column.iter_mut().zip(x).zip(h) {
                *out = response(*x, *h);
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

impl Otf {
    /// The half spectrum of one channel, `[kx][ky]`.
    pub fn channel(&self, channel: usize) -> &[Complex64] {
        &self.channels[channel]
    }
}

impl Spectrum {
    /// The half spectrum of one channel, `[kx][ky]`.
    pub fn channel(&self, channel: usize) -> &[Complex64] {
        &self.channels[channel]
    }
}

fn each_channel<T: Default + Send>(make: impl Fn(usize) -> T + Sync) -> [T; CHANNELS] {
    let mut channels: [T; CHANNELS] = Default::default();
    channels.par_iter_mut().enumerate().for_each(|(channel, out)| *out = make(channel));
    channels
}

fn occupied_ranges(sources: &[Vec<usize>]) -> Vec<Range<usize>> {
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
