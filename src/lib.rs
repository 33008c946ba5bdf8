//! Under-display camera imaging: from a measured panel to a restored photograph.
//!
//! Data flows one way: [`capture`]s become a [`psf`], whose [`codes`] and kernels [`synth`] applies to [`crop`]s; of the
//! triplets [`train`] makes models, with which [`restore`] turns captures into images, for [`finish`] to develop and for
//! [`experiment`] to measure and [`report`] to show.
//!
//! The modules from the ground up; each imports only what stands before it:
//! - [`kernels`]: the loops that networks and transforms spend their time in;
//! - [`core`]: values and the mathematics that all share;
//! - [`io`]: the only opener of files; [`dataset`]: a folder of triplets as a value; [`batch`]: work through many files;
//! - [`network`]: the networks made of kernels;
//! - [`capture`], [`psf`], [`codes`], [`crop`], [`scenes`], [`synth`], [`finish`]: the stages before and after a network;
//! - [`perceptual`]: what trained eyes see;
//! - [`restore`]; [`examples`] to learn restoring any panel from; [`train`]; [`experiment`], [`report`];
//! - [`plan`]: a study on many machines;
//! - [`inspect`]: what a file or folder of the project holds; [`doctor`]: what is wrong with it, and what mends that.
//!
//! The binary's commands turn flags into configurations of these.
//!
//! # A capture restored
//! ```
//! use udc::capture::Told;
//! use udc::core::progress::Progress;
//! use udc::io::{DomainTag, WriteOptions, read_psf};
//! use udc::restore::deconvolution::{DeconvolutionConfig, Method};
//! use udc::restore::{Capture, Highlights, KernelKnowledge, Restoration};
//! # fn main() -> udc::core::error::Result<()> {
//! # let folder = tempfile::tempdir().expect("a folder for the example");
//! # let folder = folder.path();
//! # let light = |y, x| if y % 9 == 4 && x % 11 == 5 { 20.0 } else { 0.2 };
//! # let scene = ndarray::Array3::from_shape_fn((3, 40, 48), |(_, y, x)| light(y, x));
//! # let scene = udc::core::image::LinearImage::from_planes(scene)?;
//! # let spread = |y: usize, x: usize| (-(y as f32 - 4.0).hypot(x as f32 - 4.0)).exp();
//! # let psf = udc::core::psf::Psf::from_energy(ndarray::Array3::from_shape_fn((3, 9, 9), |(_, y, x)| spread(y, x)))?;
//! # let convolver = udc::core::fft::Convolver::new([40, 48], [9, 9], udc::core::fft::Boundary::Replicate)?;
//! # let seen = convolver.convolve(&convolver.spectrum(&scene)?, &convolver.otf(&psf)?);
//! # let seen = udc::core::image::LinearImage::from_planes(seen)?;
//! # udc::io::write_image(&folder.join("capture.exr"), &seen, &WriteOptions::default())?;
//! # udc::io::write_psf(&folder.join("psf.exr"), &psf, &WriteOptions::default())?;
//!
//! // The capture may be a camera's raw file as well, and a network restores it in the same way:
//! // `Restoration::by_network(Model::load(file)?, KernelKnowledge::Code(code))?`.
//! let progress = Progress::default();
//! let (capture, warnings) = Capture::open(&folder.join("capture.exr"), &Told::default(), &progress)?;
//! let kernel = KernelKnowledge::of_psf(read_psf(&folder.join("psf.exr"))?);
//! let method = DeconvolutionConfig { iterations: 20, ..DeconvolutionConfig::of_method(Method::Constrained) };
//! let restoration = Restoration::by_deconvolution(method, kernel)?.with_highlights(Highlights::Blend);
//!
//! let plan = restoration.plan(capture.image.size())?; // 40 × 48: memory up to 25 MiB
//! let restored = restoration.restore(capture, &progress)?;
//! restored.clone().write(&folder.join("restored.exr"), DomainTag::Linear, &WriteOptions::default())?;
//! restored.into_photograph()?.write(&folder.join("photo.jpg"), &WriteOptions::default())?;
//! # assert!(warnings.is_empty() && plan.to_string().starts_with("40 × 48: memory up to"));
//! # assert!(folder.join("photo.jpg").is_file());
//! # let restored = udc::io::read_image::<udc::core::image::Linear>(&folder.join("restored.exr"))?;
//! # let error = |image: &udc::core::image::LinearImage| (&image.planes() - &scene.planes()).mapv(f32::abs).sum();
//! # assert!(error(&restored) < 0.9 * error(&seen), "{} of {}", error(&restored), error(&seen));
//! # Ok(())
//! # }
//! ```
//!
//! # Axes and units
//! Images are RGB, planar, `[channel, height, width]`; batches `[item, channel, height, width]`; positions
//! are (row y, column x), row 0 on top. Physical quantities carry their unit in their name.
//!
//! # Scope
//! Still captures through a panel whose PSF does not change over the exposure; networks on the CPU or on GPUs, all else on
//! the CPU.
//! Out of scope: video, autofocus, panel design.

#![cfg_attr(
    test,
    allow(
        clippy::float_cmp,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "tests compare what must be equal to the bit, and count in small numbers"
    )
)]

pub mod batch;
pub mod capture;
pub mod codes;
pub mod core;
pub mod crop;
pub mod dataset;
pub mod doctor;
pub mod examples;
pub mod experiment;
pub mod finish;
pub mod inspect;
pub mod io;
pub mod kernels;
pub mod network;
pub mod perceptual;
pub mod plan;
pub mod psf;
pub mod report;
pub mod restore;
pub mod scenes;
pub mod synth;
pub mod train;
