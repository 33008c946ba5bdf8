//! Takes flare away from a capture.

use ndarray::{Array2, Array3, Axis, Zip};

use super::super::DeconvolutionConfig;
use super::doubt::{Doubtful, replace_doubtful};
use super::known::local_brightness;
use super::smooth::paint;
use super::window::Window;
use crate::core::error::Result;
use crate::core::image::LinearImage;

/// The part of the light of saturation from which flare alone is taken to saturate a pixel.
const SATURATING: f32 = 0.5;

/// The part of a capture's brightness below which flare need not be known, and how far from more the scene is looked at, in pixels.
const LEAST_FLARE: f32 = 1e-3;
const AROUND_PX: usize = 128;

/// A capture with flare.
pub(super) struct Flared<'a> {
    pub(super) image: &'a LinearImage,
    /// Of each channel.
    pub(super) saturated: &'a [Array2<bool>],
    pub(super) config: &'a DeconvolutionConfig,
}

impl Flared<'_> {
    /// The capture without flare; where that alone saturates it, painted over.
    pub(super) fn without(&self, flare: &[Array2<f32>]) -> Result<LinearImage> {
        self.finish(self.rests(flare), flare)
    }

    /// The same, with the scene around in place of what errors of the flare drown.
    pub(super) fn without_doubtful(&self, flare: &[Array2<f32>]) -> Result<LinearImage> {
        let mut rests = self.rests(flare);
        let brightness: Vec<_> = (0..flare.len())
            .map(|channel| local_brightness(&self.image.channel(channel).to_owned(), self.config.alpha))
            .collect();
        let mut is_reached = Array2::default(rests[0].dim());
        for (flare, brightness) in flare.iter().zip(&brightness) {
            Zip::from(&mut is_reached).and(flare).and(brightness).par_for_each(
                |reached, flare, brightness| {
                    *reached |= *flare > LEAST_FLARE * brightness;
                },
            );
        }
        for window in Window::apart(&is_reached, [AROUND_PX; 2]) {
            let cut = |plane: &Array2<f32>| plane.slice(window.slices()).to_owned();
            let part = |channel: usize| Doubtful {
                rest: cut(&rests[channel]),
                flare: cut(&flare[channel]),
                known: self.saturated[channel].slice(window.slices()).mapv(|saturated| f32::from(!saturated)),
                brightness: cut(&brightness[channel]),
            };
            let found = replace_doubtful((0..flare.len()).map(part).collect(), self.config.alpha);
            for (rest, found) in rests.iter_mut().zip(found) {
                rest.slice_mut(window.slices()).assign(&found);
            }
        }
        self.finish(rests, flare)
    }

    /// What flare leaves of each channel; of saturated pixels all.
    fn rests(&self, flare: &[Array2<f32>]) -> Vec<Array2<f32>> {
        let rest = |(channel, flare): (usize, &Array2<f32>)| {
            Zip::from(self.image.channel(channel))
                .and(flare)
                .and(&self.saturated[channel])
                .par_map_collect(|y, flare, saturated| if *saturated { *y } else { y - flare })
        };
        flare.iter().enumerate().map(rest).collect()
    }

    /// Makes an image of what is left, in which nothing is darker than darkness, but for noise.
    fn finish(&self, rests: Vec<Array2<f32>>, flare: &[Array2<f32>]) -> Result<LinearImage> {
        let mut planes = Array3::zeros(self.image.planes().dim());
        for (channel, (mut rest, mut out)) in rests.into_iter().zip(planes.axis_iter_mut(Axis(0))).enumerate()
        {
            let (capture, saturated) = (self.image.channel(channel), &self.saturated[channel]);
            let level = self.config.saturation[channel];
            let mut known = Array2::ones(rest.dim());
            Zip::from(&mut rest)
                .and(capture)
                .and(&flare[channel])
                .and(saturated)
                .and(&mut known)
                .par_for_each(|rest, y, flare, saturated, known| match *saturated {
                    true if *flare >= SATURATING * level => *known = 0.0,
                    true => {}
                    false => *rest = rest.max(y.min(0.0)),
                });
            if known.iter().any(|known| *known == 0.0) {
                paint(&mut rest, &known);
            }
            out.assign(&rest);
        }
        LinearImage::from_planes(planes)
    }
}
