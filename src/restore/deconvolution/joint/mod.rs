//! Solves for the scene and for the light that the sensor clipped together.
//!
//! One weighted least squares over all pixels: where the capture is known, it is the blurred scene; where it is saturated, it
//! bounds the blurred scene from below, and the light there is told by its flare over the rest of the frame.
//!
//! # Method
//! 1. The noise of the capture is estimated from its finest detail.
//! 2. Where nothing is saturated, a regularised inverse of the PSF, relative to the local brightness, is the first scene.
//!    Where something is, the flare of the clipped light is fitted and taken away, and what it hid is painted over.
//! 3. In each of a few rounds the edges of the scene are looked for in all colours together, and conjugate gradients lower the
//!    least squares with a penalty on differences of neighbours that spares those edges (iteratively reweighted least squares).
//!
//! Transforms are of 32 bits: on captures with suns 10⁴ times above saturation, those of 64 bits restore the same to 0.01 dB.

mod channel;
mod conjugate;
mod flare;
mod frame;
mod high_pass;
mod noise_level;
pub(super) mod pose;
mod prior;
mod smooth;
mod uncertainty;

use ndarray::{Array3, Axis};

use super::DeconvolutionConfig;
use crate::core::error::Result;
use crate::core::fft::TransformPrecision;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use channel::Channel;
use conjugate::Room;
use frame::Frame;
use prior::Edges;

/// What a capture tells of its scene.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The scene; where the capture is saturated, the light of the lamps, which may be far above.
    pub scene: LinearImage,
    /// The standard deviation of the scene's error as far as noise and the clipped flare make it, `[3, height, width]`.
    pub deviation: Array3<f32>,
    /// The standard deviation of the noise of `log(capture + α)` in each channel, where it is of middling brightness.
    pub relative_noise: [f32; CHANNELS],
}

/// Solves for the scene of which `image` is the convolution with `psf`, clipped at `config.saturation`.
pub(super) fn solve(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<Solution> {
    let size = [image.height(), image.width()];
    let of_psf = [psf.height(), psf.width()];
    let frame = Frame::new(size, of_psf, config.border, TransformPrecision::Single);
    let mut channels = Vec::with_capacity(CHANNELS);
    for channel in 0..CHANNELS {
        let planes = (image.channel(channel), psf.channel(channel));
        channels.push(Channel::new(&frame, planes, (config.saturation[channel], config.alpha), progress)?);
    }
    let mut room = Room::new(frame.plane_size());
    let mut edges = Edges::unknown();
    let has_lamps = channels.iter().any(Channel::has_lamps);
    let efforts: Vec<[usize; 2]> = channels.iter().map(|channel| channel.effort(&frame)).collect();
    let rounds = efforts.iter().map(|[rounds, _]| *rounds).max().unwrap_or(0);
    let bar = progress.bar((CHANNELS * rounds) as u64, "deconvolving");
    for round in 0..rounds {
        if round > 0 || !has_lamps {
            edges = edges_of(&channels);
        }
        for (index, channel) in channels.iter_mut().enumerate() {
            let [rounds, steps] = efforts[index];
            if round < rounds {
                let psf = psf.channel(index);
                channel.improve((&frame, psf), (&edges, steps), (&mut room, progress))?;
            }
            bar.inc(1);
        }
    }
    drop(room);
    let relative_noise = std::array::from_fn(|channel| channels[channel].relative_noise());
    let mut deviation = Array3::zeros((CHANNELS, size[0], size[1]));
    let mut scene = Array3::zeros((CHANNELS, size[0], size[1]));
    for (index, channel) in channels.into_iter().enumerate() {
        let blur = frame.blur(psf.channel(index))?;
        let of_channel = channel.deviation(&blur, &edges);
        deviation.index_axis_mut(Axis(0), index).assign(&frame.cut(&of_channel));
        scene.index_axis_mut(Axis(0), index).assign(&frame.cut(&channel.scene));
    }
    bar.finish_and_clear();
    Ok(Solution { scene: LinearImage::from_planes(scene)?, deviation, relative_noise })
}

fn edges_of(channels: &[Channel]) -> Edges {
    let colors: Vec<_> =
        channels.iter().map(|channel| (&channel.scene, &channel.inverse_brightness)).collect();
    Edges::of_scene(&colors)
}
