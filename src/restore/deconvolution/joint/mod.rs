//! Solves for the scene and for the light that the sensor clipped together.
//!
//! One weighted least squares over all pixels: where the capture is known, it is the blurred scene; where it is saturated, it
//! bounds the blurred scene from below, and the light there is told by its flare over the rest of the frame.
//!
//! # Method
//! 1. The noise of the capture is estimated from its finest detail.
//! 2. Where nothing is saturated, a regularised inverse of the PSF, relative to the local brightness, is the first scene.
//!    Where something is, the clipped light is found at half the resolution, by all of these steps ([`coarse`]), and by a fit
//!    of its flare as far as that reaches ([`window`]), which in large captures begins with what half the resolution tells; whichever
//!    explains that flare better, the former if in doubt, is taken away, and what it hid is painted over; in large captures, of which every step takes long, that is
//!    inverted in turn, and steps are few. Where there is neither noise nor a lamp, [`constrained`](super::constrained) solves to many
//!    digits if nothing is unknown around the frame, and small captures begin from what it makes of them if something is.
//! 3. In each of a few rounds the edges of the scene are looked for in all colours together, and conjugate gradients lower the
//!    least squares with a penalty on differences of neighbours that spares those edges (iteratively reweighted least squares). Where
//!    nothing saturates, further rounds follow while the scene leaves more of the capture than noise does ([`effort`]).
//! 4. Where there is noise, the spectra of its own neighbourhoods refine the scene ([`refine`]).
//!
//! Transforms are of 32 bits: on captures with suns 10⁴ times above saturation, those of 64 bits restore the same to 0.01 dB.

mod apart;
mod around;
pub(super) mod beyond;
mod capture_noise;
mod channel;
mod coarse;
mod conjugate;
mod cosines;
mod diagonal;
mod doubt;
mod effort;
mod enlarged;
mod fit;
mod flare;
mod frame;
mod high_pass;
mod interpolation;
mod known;
mod lamps;
mod members;
mod noise_level;
mod places;
pub(super) mod pose;
mod prior;
mod refine;
mod relief;
mod seen;
mod smooth;
mod sums;
mod uncertainty;
mod window;

use ndarray::{Array2, Array3, Axis, Zip};
use rayon::prelude::*;

use super::DeconvolutionConfig;
use crate::core::error::Result;
use crate::core::fft::TransformPrecision;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use around::Around;
pub(in crate::restore) use capture_noise::CaptureNoise;
pub use capture_noise::DoubtedNoise;
use capture_noise::noise_levels;
use channel::{Channel, Workspace};
use coarse::Half;
use effort::further_rounds;
use frame::Frame;
use interpolation::Finest;
use known::Known;
pub(in crate::restore) use noise_level::NOISE_FREE;
use noise_level::NoiseLevel;
use prior::{Edges, InverseBrightness};
use refine::{Pilot, Refined, refine};
pub(in crate::restore) use smooth::local_mean;

/// The share of a channel that is clipped, from which clipped light of small captures is first found at lower resolutions.
const LEAST_CLIPPED: f64 = 5e-3;

/// What a capture tells of its scene.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The scene; where the capture is saturated, the light of the lamps, which may be far above.
    pub scene: LinearImage,
    /// The standard deviation of the scene's error as far as noise and the clipped flare make it, `[3, height, width]`.
    pub deviation: Array3<f32>,
    /// What the scene, with the light that was found around it, leaves of the capture, over its local brightness and α, which is
    /// as the noise is; zero at saturated pixels; `[3, height, width]`.
    pub residual: Array3<f32>,
    /// The standard deviation of the noise of `log(capture + α)` in each channel, where it is of middling brightness.
    pub relative_noise: [f32; CHANNELS],
    /// Whether the deviation is that of the error: of captures whose noise shows that pixels were measured, as it is white, and that of one
    /// colour tells nothing of another's, and of those with detail that all colours share, finer than noise. Nothing is shown by captures
    /// without noise, and of other demosaiced ones the error is larger.
    pub is_told: bool,
}

impl Solution {
    /// Whether the capture has no noise, as computed ones have none.
    pub fn is_clean(&self) -> bool {
        self.relative_noise.iter().all(|sigma| *sigma <= NOISE_FREE)
    }
}

/// Estimates the scene of which `image` is the convolution with `psf`, clipped at `config.saturation`.
pub(super) fn restore(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<LinearImage> {
    let frame = frame_of(image, psf, config);
    let mut colors = Colors::solve(&frame, (image, psf), (config, None), progress)?;
    let scene = match colors.refined(progress)? {
        Some(Refined { scene, .. }) => scene,
        None => colors.scene(),
    };
    LinearImage::from_planes(scene)
}

/// As [`restore`], with what is known of the errors; of a window of a capture, whose noise is that of all of it.
pub(super) fn solve(
    (image, psf): (&LinearImage, &Psf),
    config: &DeconvolutionConfig,
    noise: Option<&CaptureNoise>,
    progress: &Progress,
) -> Result<Solution> {
    let frame = frame_of(image, psf, config);
    let mut colors = Colors::solve(&frame, (image, psf), (config, noise), progress)?;
    let relative_noise = std::array::from_fn(|channel| colors.channels[channel].relative_noise());
    let (scene, deviation) = match colors.refined(progress)? {
        Some(Refined { scene, deviation }) => (scene, deviation),
        None => {
            let deviation = colors.deviation()?;
            (colors.scene(), deviation)
        }
    };
    let is_noisy = colors.channels.iter().any(Channel::is_noisy);
    let finest = || match noise {
        Some(noise) => noise.finest,
        None => Finest::of(image, config.alpha, config.saturation.map(saturated_from)),
    };
    let is_told = is_noisy && finest().is_measured;
    let residual = colors.residual(&scene)?;
    Ok(Solution { scene: LinearImage::from_planes(scene)?, deviation, residual, relative_noise, is_told })
}

/// Rounds that look for the light that a scene does not tell, and steps in each.
const UNTOLD: [usize; 2] = [4, 10];

/// Filters a capture of a known `scene` by the true spectra of its neighbourhoods; light around the frame, and where the scene is as
/// bright as what saturates, is estimated, all else being known.
pub(super) fn filter_by_truth(
    (image, scene): (&LinearImage, &LinearImage),
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<LinearImage> {
    let frame = frame_of(image, psf, config);
    let mut colors = Colors::solve(&frame, (image, psf), (config, None), progress)?;
    for (index, channel) in colors.channels.iter_mut().enumerate() {
        channel.learn(scene.channel(index));
    }
    let ([rounds, steps], mut workspace) = (UNTOLD, Workspace::new(&frame));
    for _ in 0..rounds {
        colors.find_edges();
        let Colors { channels, edges, .. } = &mut colors;
        for channel in channels {
            channel.improve((edges, steps), &mut workspace, progress)?;
        }
    }
    let refined = refine(&frame, &mut colors.channels, Pilot::Truth, progress)?;
    LinearImage::from_planes(refined.scene)
}

fn frame_of(image: &LinearImage, psf: &Psf, config: &DeconvolutionConfig) -> Frame {
    let (size, of_psf) = ([image.height(), image.width()], [psf.height(), psf.width()]);
    Frame::new(size, of_psf, config.border, TransformPrecision::Single)
}

/// Bytes of an image with saturated pixels in work, by the pixels of the frame and of a plane and the samples of a transform.
pub(super) fn bytes(frame: u64, plane: u64, samples: u64) -> u64 {
    // The image, W and A x; of bits, what is saturated and what is held; and what stands between.
    let of_frame = CHANNELS as u64 + 4;
    // Scene, D and 1/n of each channel; the gradient, the direction, what they are turned to, 1/n, edges, and what stands between.
    let of_plane = CHANNELS as u64 * 3 + 6;
    // The transfer function, what stands between rows and columns, and what is still mapped of others.
    let of_samples = 3;
    let usual = of_frame * frame + of_plane * plane + of_samples * samples;
    // Captures without noise: scenes and D of the channels before, and what `constrained` takes for one.
    let computed = (2 * CHANNELS as u64 + 2) * frame + 12 * plane + 8 * samples;
    4 * usual.max(computed)
}

/// A capture, at full or at a reduced resolution.
struct Given<'a> {
    image: &'a LinearImage,
    psf: &'a Psf,
    config: &'a DeconvolutionConfig,
    /// Saturated pixels, of each channel.
    saturated: Vec<Array2<bool>>,
    /// Whether pixels beside saturated ones may have been interpolated from them.
    is_guarded: bool,
    /// The noise of the whole capture, where this is a window of it.
    whole: Option<&'a CaptureNoise>,
    /// The noise at full resolution, where this one is reduced: below it, the means of blocks are not explained either.
    noise: Option<&'a [NoiseLevel]>,
}

impl<'a> Given<'a> {
    fn known(&self, channel: usize) -> Known<'a> {
        let Self { image, psf, config, is_guarded, .. } = *self;
        let is_reduced = self.noise.is_some();
        let (capture, psf) = (image.channel(channel), psf.channel(channel));
        Known { capture, psf, channel, config, is_guarded, is_reduced }
    }

    fn start(self, frame: &'a Frame, progress: &Progress) -> Result<Colors<'a>> {
        let noise = self.noise_levels(frame)?;
        let coarse = self.coarse_scene(frame, &noise, progress)?;
        let known: Vec<_> = (0..CHANNELS).map(|channel| self.known(channel)).collect();
        let is_whole = self.noise.is_none() && self.whole.is_none();
        let around = if is_whole { Around::of(frame, (&known, &noise), progress)? } else { None };
        let find_light = |channel: usize| {
            let coarse = coarse.as_ref().map(|scene| scene.index_axis(Axis(0), channel));
            known[channel].find_light(frame, (&self.saturated, coarse), progress)
        };
        // Where pixels are the means of blocks, planes are small, and channels are worked on side by side. Where they are large, that of
        // all channels is found before any has other planes.
        let is_reduced = self.noise.is_some();
        let found: Result<Vec<_>> = match is_reduced {
            true => (0..CHANNELS).into_par_iter().map(find_light).collect(),
            false => (0..CHANNELS).map(find_light).collect(),
        };
        drop(coarse);
        let given: Vec<_> = known
            .iter()
            .zip(self.saturated)
            .zip(found?)
            .zip(noise)
            .map(|(((known, saturated), found), noise)| (*known, (saturated, found, noise, around.as_ref())))
            .collect();
        let channel = |(known, found)| Channel::new(frame, known, found, progress);
        let channels: Result<_> = match is_reduced {
            true => given.into_par_iter().map(channel).collect(),
            false => given.into_iter().map(channel).collect(),
        };
        Ok(Colors { frame, channels: channels?, edges: Edges::unknown() })
    }

    /// The noise of all channels.
    fn noise_levels(&self, frame: &Frame) -> Result<Vec<NoiseLevel>> {
        match (self.noise, self.whole) {
            (Some(noise), _) => Ok(noise.to_vec()),
            (None, Some(whole)) => Ok(whole.levels.clone()),
            (None, None) => noise_levels(frame, (self.image, self.config), |channel| self.known(channel)),
        }
    }

    /// The scene in the frame at half the resolution, `[3, ⌈height/2⌉, ⌈width/2⌉]`, of a capture that is large, or of which much
    /// is clipped: in small ones the light of few pixels is found sooner at full resolution, and as well.
    fn coarse_scene(
        &self,
        frame: &Frame,
        noise: &[NoiseLevel],
        progress: &Progress,
    ) -> Result<Option<Array3<f32>>> {
        let clipped = |saturated: &Array2<bool>| {
            let clipped = saturated.iter().filter(|saturated| **saturated).count();
            clipped as f64 / saturated.len() as f64
        };
        let clipped = self.saturated.iter().map(clipped).fold(0.0, f64::max);
        let least = if lamps::is_large(frame) { f64::MIN_POSITIVE } else { LEAST_CLIPPED };
        if clipped < least {
            return Ok(None);
        }
        let Some(half) = Half::of(self.image, self.psf, &self.saturated)? else { return Ok(None) };
        let Half { image, psf, saturated } = half;
        let frame = frame_of(&image, &psf, self.config);
        let (image, psf) = (&image, &psf);
        let (config, noise) = (self.config, Some(noise));
        let given = Given { image, psf, config, saturated, is_guarded: false, whole: None, noise };
        let progress = progress.without_bars();
        Ok(Some(given.start(&frame, &progress)?.restore(&progress)?.scene()))
    }
}

/// All channels in work.
struct Colors<'a> {
    frame: &'a Frame,
    channels: Vec<Channel<'a>>,
    edges: Edges,
}

impl<'a> Colors<'a> {
    /// The scenes of all channels, as far as the capture tells them.
    fn solve(
        frame: &'a Frame,
        (image, psf): (&'a LinearImage, &'a Psf),
        (config, whole): (&'a DeconvolutionConfig, Option<&'a CaptureNoise>),
        progress: &Progress,
    ) -> Result<Self> {
        Self::start(frame, (image, psf), (config, whole), progress)?.restore(progress)
    }

    fn start(
        frame: &'a Frame,
        (image, psf): (&'a LinearImage, &'a Psf),
        (config, whole): (&'a DeconvolutionConfig, Option<&'a CaptureNoise>),
        progress: &Progress,
    ) -> Result<Self> {
        let from = config.saturation.map(saturated_from);
        let saturated =
            |channel: usize| Zip::from(image.channel(channel)).par_map_collect(|y: &f32| *y >= from[channel]);
        let saturated: Vec<_> = (0..CHANNELS).map(saturated).collect();
        let has_lamps = saturated.iter().flatten().any(|saturated| *saturated);
        let is_guarded = has_lamps
            && whole.map_or_else(|| Finest::of(image, config.alpha, from), |whole| whole.finest).is_guarded;
        Given { image, psf, config, saturated, is_guarded, whole, noise: None }.start(frame, progress)
    }

    fn restore(mut self, progress: &Progress) -> Result<Self> {
        let efforts: Vec<_> = self.channels.iter().map(Channel::effort).collect();
        self.improve(&efforts, progress)?;
        for _ in 0..further_rounds(self.frame.transform_samples()) {
            let efforts: Vec<_> = self.channels.iter().map(Channel::further_effort).collect();
            self.improve(&efforts, progress)?;
        }
        let efforts: Vec<_> = self.channels.iter_mut().map(Channel::finish).collect();
        self.improve(&efforts, progress)?;
        Ok(self)
    }

    /// Improves the scenes of all channels, each by rounds of some steps.
    fn improve(&mut self, efforts: &[[usize; 2]], progress: &Progress) -> Result<()> {
        let are_sharp = self.channels.iter().all(Channel::is_sharp);
        let rounds = efforts.iter().map(|[rounds, _]| *rounds).max().unwrap_or(0);
        if rounds == 0 {
            return Ok(());
        }
        let bar = progress.bar((CHANNELS * rounds) as u64, "rounds of deconvolution");
        // Where pixels are the means of blocks, planes are small, and channels are worked on side by side.
        let is_reduced = self.channels.iter().all(Channel::is_reduced);
        let workspaces = if is_reduced { CHANNELS } else { 1 };
        let mut workspaces: Vec<_> = (0..workspaces).map(|_| Workspace::new(self.frame)).collect();
        for round in 0..rounds {
            if round > 0 || are_sharp {
                self.find_edges();
            }
            let Self { channels, edges, .. } = &mut *self;
            let improve =
                |channel: &mut Channel<'_>, [rounds, steps]: [usize; 2], workspace: &mut Workspace| {
                    if round < rounds {
                        channel.improve((edges, steps), workspace, progress)?;
                    }
                    bar.inc(1);
                    Ok(())
                };
            match &mut workspaces[..] {
                [workspace] => {
                    let channels = channels.iter_mut().zip(efforts);
                    channels
                        .into_iter()
                        .try_for_each(|(channel, effort)| improve(channel, *effort, workspace))?;
                }
                workspaces => {
                    let channels = channels.par_iter_mut().zip(efforts).zip(workspaces);
                    channels.try_for_each(|((channel, effort), workspace)| {
                        improve(channel, *effort, workspace)
                    })?;
                }
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    fn find_edges(&mut self) {
        // The old ones go before the new ones are made.
        self.edges = Edges::unknown();
        let inverses: Vec<_> = self
            .channels
            .iter()
            .map(|channel| move |y: usize, out: &mut [f32]| channel.write_inverse_brightness(y, out))
            .collect();
        let scenes = self.channels.iter().map(|channel| &channel.scene);
        let colors: Vec<_> =
            scenes.zip(&inverses).map(|(scene, inverse)| (scene, inverse as InverseBrightness<'_>)).collect();
        self.edges = Edges::of_scene(&colors);
    }

    /// The scene refined by its own local spectra, where there is noise.
    fn refined(&mut self, progress: &Progress) -> Result<Option<Refined>> {
        if !self.channels.iter().any(Channel::is_noisy) {
            return Ok(None);
        }
        self.settle();
        self.edges = Edges::unknown();
        refine(self.frame, &mut self.channels, Pilot::Estimate, progress).map(Some)
    }

    /// Lets planes make room that only the search for the scene needs.
    fn settle(&mut self) {
        self.channels.iter_mut().for_each(Channel::settle);
    }

    /// The standard deviation of the scene's error where there is no noise, after all else has been asked of the edges.
    fn deviation(&mut self) -> Result<Array3<f32>> {
        self.settle();
        let [height, width] = self.frame.size();
        let mut deviation = Array3::zeros((CHANNELS, height, width));
        for (channel, mut out) in self.channels.iter().zip(deviation.axis_iter_mut(Axis(0))) {
            out.assign(&channel.deviation(&self.edges)?);
        }
        self.edges = Edges::unknown();
        Ok(deviation)
    }

    fn scene(&self) -> Array3<f32> {
        let [height, width] = self.frame.size();
        let mut scene = Array3::zeros((CHANNELS, height, width));
        for (channel, mut out) in self.channels.iter().zip(scene.axis_iter_mut(Axis(0))) {
            out.assign(&self.frame.cut(&channel.scene));
        }
        scene
    }

    /// What a scene leaves of the capture; the light around it stays as it was found.
    fn residual(self, scene: &Array3<f32>) -> Result<Array3<f32>> {
        let mut residual = Array3::zeros(scene.dim());
        let mut image = Array2::zeros(self.frame.size());
        // Each channel's planes go before the next residual comes.
        for (index, mut channel) in self.channels.into_iter().enumerate() {
            self.frame.cut_mut(&mut channel.scene).assign(&scene.index_axis(Axis(0), index));
            channel.write_residual(&mut image, residual.index_axis_mut(Axis(0), index))?;
        }
        Ok(residual)
    }
}

#[cfg(test)]
mod tests;
