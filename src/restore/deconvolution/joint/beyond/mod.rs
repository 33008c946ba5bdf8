//! Lamps beyond the border: their light is not in the frame, but their flare is.
//!
//! The diffraction orders of a sun just outside of the frame fall into it, a field of coloured dots that a deconvolution has to
//! take for scene. Fitted to the light of all surroundings, flare finds such a sun, and thousands of weak sources beside it that
//! explain the scene's own detail. One place that explains much in all colours is believed, and few pixels that explain more, which may be
//! several lamps, and nothing else: what is taken for a lamp and is none costs up to 18 dB.

mod axis;
mod blocks;
mod suspect;

use std::borrow::Cow;
use std::fmt;

use ndarray::{Array2, Zip};
use rayon::prelude::*;
use serde::Serialize;

use super::super::{Border, DeconvolutionConfig};
use super::coarse::Half;
use super::fit::{Places, grown, largest};
use super::frame::Frame;
use super::known::local_brightness;
use super::relief::Flared;
use crate::core::error::Result;
use crate::core::fft::TransformPrecision;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use axis::PlaneAxis;
use blocks::Blocks;
use suspect::{FRAME_PX, Known, MOST_PX, ROUNDS, STEPS, Suspect, keep_visible};

/// Samples of a transform up to which lamps are looked for, and up to which their light is measured: larger captures are halved.
const SEARCHED_SAMPLES: usize = 250_000;
const MEASURED_SAMPLES: usize = 2_000_000;

/// Samples of a transform up to which channels are worked on side by side, each with planes of its own.
const ABREAST_SAMPLES: usize = 700_000;

/// All channels.
const ALL: [usize; CHANNELS] = [0, 1, 2];

/// Pixels, along rows and columns, by which the places where each colour sees most are apart at most where it is one lamp that they see,
/// though more pixels shine around it: a PSF turned by 0.3° spreads a sun's light over 174 of them. Of 192 captures, suns have 0 to 2
/// by exact PSFs and by such ones.
const APART_PX: usize = 2;

/// The part of the misfit that few pixels leave at most where colours see different places, the geometric mean of the colours: several
/// lamps leave 0.39 to 0.62, and a scene's own detail, which costs 2 to 5 dB as a lamp, 0.73.
const LEFT_OF_SEVERAL: f64 = 0.65;

/// Pixels of a lamp around its brightest, along rows and columns, where it is looked for.
const LAMP_PX: usize = 8;

/// The parts of the misfit that a lamp leaves at most, the geometric mean of the colours and that of each: suns leave a mean of 0.14
/// to 0.83, what is none 0.89 and more.
const EXPLAINED: f64 = 0.85;
const EXPLAINED_OF_EACH: f64 = 0.97;

/// The part of the misfit that it leaves at most at twice the resolution at which it was looked for, where dots are finer, the geometric
/// mean of the colours: in 21 captures true lamps leave 0.08 to 0.89, and detail of a room, taken for a lamp, which costs 9 dB, 0.94.
const EXPLAINED_AGAIN: f64 = 0.92;

/// The part of the misfit by which a step lowers it at least where steps are long. Six captures of 800 × 800 have 31.7 dB with and without:
/// a sky through one panel loses 0.5 dB, through another it gains 0.3.
const LEAST_GAIN: f64 = 2e-3;

/// Lamps that are looked for, one after another.
const MOST_LAMPS: usize = 4;

/// What surroundings shine with at least as light gathers, over α and over the brightest.
const SEEDS: [f32; 2] = [4e-3, 1e-3];

/// A lamp outside of the frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct LampOutside {
    /// Row and column of the middle of its light, the frame's first pixel being 0.
    pub position: [f64; 2],
    /// Pixels that shine.
    pub pixels: usize,
    /// The sum of its light in each channel.
    pub light: [f64; CHANNELS],
}

impl fmt::Display for LampOutside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [y, x] = self.position;
        let [red, green, blue] = self.light;
        write!(
            f,
            "lamp outside of the frame, at row {y:.0}, column {x:.0}: {red:.0}, {green:.0} and {blue:.0} of light in red, green and \
             blue"
        )
    }
}

/// A capture without the flare of lamps outside of it.
#[derive(Clone, Debug)]
pub struct Relieved {
    /// The capture; where that flare saturated it, or is not known well enough, painted like what is around.
    pub image: LinearImage,
    /// The lamps, the most visible first.
    pub lamps: Vec<LampOutside>,
}

/// Takes the flare of lamps outside of the frame away, if there are any that explain much of the capture.
///
/// # Method
/// At a low resolution, light of all surroundings is fitted to the fine detail of each colour by weighted least squares; around the
/// pixel whose flare is seen best in all colours together it is fitted alone. If it explains much in every colour, not only in few places,
/// and so it does at twice that resolution, it is a lamp: its light is measured, its flare taken from the capture, and the next one looked for. Where errors of all that
/// flare drown the scene, the scene around takes its place.
///
/// # Errors
/// [`Error::Shape`](crate::core::error::Error::Shape) for a PSF that does not suit the image, and
/// [`Error::Interrupted`](crate::core::error::Error::Interrupted).
pub fn without_lamps_outside(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<Option<Relieved>> {
    if config.border != Border::Smooth || !has_room(image) {
        return Ok(None);
    }
    let (mut lamps, mut flare) = (Vec::new(), Vec::new());
    let mut relieved: Option<LinearImage> = None;
    for _ in 0..MOST_LAMPS {
        let full = View::new(relieved.as_ref().unwrap_or(image), psf, config.saturation);
        let Some(measured) = full.measure((config.alpha, &ALL), progress)? else { break };
        let lamp = full.lamp(&measured);
        if !would_outshine(&lamp, psf, (image, config)) {
            break;
        }
        let of_lamp = full.flare(&measured)?;
        let without = full.flared(config).without(&of_lamp)?;
        lamps.push(lamp);
        match flare.is_empty() {
            true => flare = of_lamp,
            false => flare.iter_mut().zip(of_lamp).for_each(|(flare, of_lamp)| *flare += &of_lamp),
        }
        relieved = Some(without);
    }
    if lamps.is_empty() {
        return Ok(None);
    }
    drop(relieved);
    let image = View::new(image, psf, config.saturation).flared(config).without_doubtful(&flare)?;
    Ok(Some(Relieved { image, lamps }))
}

/// Whether a frame is so large that light which explains it is told by more pixels than it has.
pub(super) fn has_room(image: &LinearImage) -> bool {
    image.height() * image.width() >= FRAME_PX * MOST_PX
}

/// Whether a lamp would saturate a pixel of the frame, or be brighter than all of it where nothing shows what saturates: dimmer light is
/// found by any deconvolution as light around the frame, while what takes its flare away leaves more than it takes.
fn would_outshine(
    lamp: &LampOutside,
    psf: &Psf,
    (image, config): (&LinearImage, &DeconvolutionConfig),
) -> bool {
    lamp.light.iter().enumerate().any(|(channel, light)| {
        let most = largest(psf.channel(channel));
        let brightest = largest(image.channel(channel));
        light * f64::from(most) >= f64::from(config.saturation[channel].min(brightest))
    })
}

/// A capture at some resolution.
pub(super) struct View<'a> {
    pub(super) image: Cow<'a, LinearImage>,
    pub(super) psf: Cow<'a, Psf>,
    frame: Frame,
    /// Of each channel.
    pub(super) saturated: Vec<Array2<bool>>,
}

/// Light around a frame, of each channel, on planes.
pub(super) type Light = Vec<Array2<f32>>;

impl<'a> View<'a> {
    pub(super) fn new(image: &'a LinearImage, psf: &'a Psf, saturation: [f32; CHANNELS]) -> Self {
        let saturated = |channel: usize| {
            let from = saturated_from(saturation[channel]);
            Zip::from(image.channel(channel)).par_map_collect(|y| *y >= from)
        };
        let saturated = (0..CHANNELS).map(saturated).collect();
        Self {
            image: Cow::Borrowed(image),
            psf: Cow::Borrowed(psf),
            frame: frame_around(image, psf, TransformPrecision::Single),
            saturated,
        }
    }

    pub(super) fn half(&self) -> Result<Option<View<'static>>> {
        let Some(Half { image, psf, saturated }) = Half::of(&self.image, &self.psf, &self.saturated)? else {
            return Ok(None);
        };
        let frame = frame_around(&image, &psf, TransformPrecision::Single);
        Ok(Some(View { image: Cow::Owned(image), psf: Cow::Owned(psf), frame, saturated }))
    }

    /// Samples of a transform.
    pub(super) fn samples(&self) -> usize {
        self.frame.transform_samples()
    }

    /// The light of lamps around the frame, found at lower resolutions and measured in these channels at this one unless it is high.
    pub(super) fn measure(
        &self,
        (alpha, channels): (f32, &[usize]),
        progress: &Progress,
    ) -> Result<Option<Light>> {
        let samples = self.frame.transform_samples();
        let coarse = match samples > SEARCHED_SAMPLES {
            true => self.half()?,
            false => None,
        };
        let Some(coarse) = coarse else { return self.search(alpha, progress) };
        let Some(light) = coarse.measure((alpha, channels), progress)? else { return Ok(None) };
        let light = self.refined(&light, &coarse);
        if samples > MEASURED_SAMPLES {
            return Ok(Some(light));
        }
        let (light, left) = self.improve(light, (alpha, channels), progress)?;
        let was_searched = coarse.samples() <= SEARCHED_SAMPLES;
        Ok((!was_searched || left <= EXPLAINED_AGAIN).then_some(light))
    }

    /// Looks for a lamp in all surroundings.
    fn search(&self, alpha: f32, progress: &Progress) -> Result<Option<Light>> {
        // Most lamps are seen a thousand times fainter than they would be in the frame.
        let frame = frame_around(&self.image, &self.psf, TransformPrecision::Double);
        let surroundings = self.surroundings();
        let (mut channels, mut suspects) = (Vec::with_capacity(CHANNELS), Vec::with_capacity(CHANNELS));
        let frame_px = self.image.height() * self.image.width();
        // Green sees lamps best, and where it sees none, or what is large, there is none: two gatherings of light are spared.
        for of_turn in [&[1][..], &[0, 2]] {
            let suspect = |channel: &usize| {
                let known = self.known(*channel, &frame, alpha)?;
                let suspect = known.suspect(&surroundings, SEEDS[0] * alpha, progress)?;
                Ok((*channel, known, suspect))
            };
            for found in of_turn.par_iter().map(suspect).collect::<Vec<Result<_>>>() {
                let (channel, known, Some(suspect)) = found? else { return Ok(None) };
                channels.push((channel, known));
                suspects.push(suspect);
            }
            if suspects.len() == 1 && !Suspect::are_small(&suspects, frame_px) {
                return Ok(None);
            }
        }
        if !self.may_be_lamp(&suspects) {
            return Ok(None);
        }
        let mut seen = self.frame.plane();
        for Suspect { flare, .. } in &suspects {
            let most = brightest(flare).max(f32::MIN_POSITIVE);
            seen.zip_mut_with(flare, |seen, flare| *seen += (flare / most).powi(2));
        }
        let may_shine = self.around(self.place_of_most(&seen), &surroundings);
        let gather = |(known, Suspect { mut light, .. }): (&Known<'_>, Suspect)| {
            let fit = known.fit(Places { may_shine: &may_shine, at_least: 0.0, seed: SEEDS[0] * alpha });
            light.zip_mut_with(&may_shine, |light, may_shine| {
                if !*may_shine {
                    *light = 0.0;
                }
            });
            fit.gather_in_rounds(&mut light, (ROUNDS - 1, STEPS, 0.0), progress)?;
            keep_visible(&mut light, &fit.visibility(&known.squared));
            let shines = light.mapv(|light| light > 0.0);
            let fit = known.fit(Places { may_shine: &shines, at_least: 0.0, seed: 0.0 });
            fit.gather_in_rounds(&mut light, (ROUNDS - 1, STEPS, 0.0), progress)?;
            let dark = fit.residual(&self.frame.plane()).0;
            let (residual, misfit) = fit.residual(&light);
            Ok((light, misfit / known.before, Blocks::of([&dark, &residual], known.before)))
        };
        let gathered: Result<Vec<_>> =
            channels.par_iter().map(|(_, known)| known).zip(suspects).map(gather).collect();
        Ok(self.believed(channels.iter().map(|(channel, _)| *channel).zip(gathered?)))
    }

    /// The light of each channel, if it explains much of all of them, and not only in few places; with it is the part of the misfit that it
    /// leaves.
    fn believed(&self, gathered: impl Iterator<Item = (usize, (Array2<f32>, f64, Blocks))>) -> Option<Light> {
        let (mut found, mut left) = (vec![self.frame.plane(); CHANNELS], 1.0);
        let mut blocks: Option<Blocks> = None;
        for (channel, (light, left_of_channel, of_channel)) in gathered {
            if left_of_channel > EXPLAINED_OF_EACH {
                return None;
            }
            left *= left_of_channel;
            found[channel] = light;
            blocks = Some(match blocks {
                Some(blocks) => blocks.and(&of_channel),
                None => of_channel,
            });
        }
        let is_lamp = left <= EXPLAINED.powi(3) && blocks.is_some_and(Blocks::are_explained);
        is_lamp.then_some(found)
    }

    fn known<'k>(&'k self, channel: usize, frame: &'k Frame, alpha: f32) -> Result<Known<'k>> {
        let psf = self.psf.channel(channel);
        let brightness = local_brightness(&self.image.channel(channel).to_owned(), alpha);
        let mut known = Known {
            capture: self.image.channel(channel),
            saturated: &self.saturated[channel],
            blur: frame.blur(psf)?,
            squared: frame.squared_blur(psf)?,
            brightness,
            before: 0.0,
        };
        let nowhere = Array2::default(self.frame.plane_size());
        known.before =
            known.fit(Places { may_shine: &nowhere, at_least: 0.0, seed: 0.0 }).misfit(&self.frame.plane());
        Ok(known)
    }

    /// Whether all colours see most at one place, or few pixels explain much.
    fn may_be_lamp(&self, suspects: &[Suspect]) -> bool {
        let places: Vec<_> = suspects.iter().map(|suspect| self.place_of_most(&suspect.flare)).collect();
        let agree = (0..2).all(|axis| {
            let along = places.iter().map(|place| place[axis]);
            let (first, last) = (along.clone().min().unwrap_or(0), along.max().unwrap_or(0));
            first.abs_diff(last) <= APART_PX
        });
        let frame_px = self.image.height() * self.image.width();
        agree || Suspect::are_small(suspects, frame_px) && Suspect::left_by(suspects) <= LEFT_OF_SEVERAL
    }

    /// The place of most light, the frame's first pixel being 0.
    fn place_of_most(&self, light: &Array2<f32>) -> [isize; 2] {
        let (mut most, mut place) = (0.0, [0; 2]);
        for (at, light) in light.indexed_iter() {
            if *light > most {
                (most, place) = (*light, [at.0, at.1]);
            }
        }
        [0, 1].map(|axis| self.axis(axis).offset(place[axis]))
    }

    /// The surroundings that are near a place.
    fn around(&self, place: [isize; 2], surroundings: &Array2<bool>) -> Array2<bool> {
        let [rows, columns] = [0, 1].map(|axis| self.axis(axis));
        Zip::indexed(surroundings).par_map_collect(|(y, x), is_outside| {
            let apart = rows.offset(y).abs_diff(place[0]).max(columns.offset(x).abs_diff(place[1]));
            *is_outside && apart <= LAMP_PX
        })
    }

    /// Measures the light of some channels in and next to where it was found at half the resolution; returns the part of the misfit that it
    /// leaves, too, the geometric mean of these.
    fn improve(
        &self,
        light: Light,
        (alpha, channels): (f32, &[usize]),
        progress: &Progress,
    ) -> Result<(Light, f64)> {
        let mut may_shine = grown(&shining(&light), 2);
        let surroundings = self.surroundings();
        may_shine.zip_mut_with(&surroundings, |may_shine, is_outside| *may_shine &= *is_outside);
        let is_large = self.samples() > ABREAST_SAMPLES;
        let least = if is_large { LEAST_GAIN } else { 0.0 };
        let improve = |(channel, mut light): (usize, Array2<f32>)| {
            if !channels.contains(&channel) {
                return Ok((light, 1.0));
            }
            let known = self.known(channel, &self.frame, alpha)?;
            let seed = SEEDS[1] * brightest(&light);
            let fit = known.fit(Places { may_shine: &may_shine, at_least: 0.0, seed });
            let [_, misfit] = fit.gather_in_rounds(&mut light, (ROUNDS - 1, STEPS, least), progress)?;
            Ok((light, misfit / known.before))
        };
        let improved: Result<Vec<_>> = match is_large {
            true => light.into_iter().enumerate().map(improve).collect(),
            false => light.into_par_iter().enumerate().map(improve).collect(),
        };
        let (light, left): (Light, Vec<f64>) = improved?.into_iter().unzip();
        Ok((light, left.iter().product::<f64>().powf(1.0 / channels.len() as f64)))
    }

    /// Light that was found at half the resolution, each pixel's shared by the four of its block.
    fn refined(&self, light: &Light, coarse: &View<'_>) -> Light {
        let of_axis = |axis: usize| -> Vec<Vec<usize>> {
            let [fine, coarse] = [self.axis(axis), coarse.axis(axis)];
            let places = 0..coarse.plane;
            places
                .map(|index| {
                    let offset = 2 * coarse.offset(index);
                    [offset, offset + 1].into_iter().filter_map(|offset| fine.index(offset)).collect()
                })
                .collect()
        };
        let [rows, columns] = [0, 1].map(of_axis);
        let refine = |light: &Array2<f32>| {
            let mut fine = self.frame.plane();
            for ((y, x), light) in light.indexed_iter().filter(|(_, light)| **light > 0.0) {
                for y in &rows[y] {
                    for x in &columns[x] {
                        fine[[*y, *x]] += light / 4.0;
                    }
                }
            }
            fine
        };
        light.iter().map(refine).collect()
    }

    fn flare(&self, light: &Light) -> Result<Vec<Array2<f32>>> {
        let of_channel = |(channel, light): (usize, &Array2<f32>)| {
            let mut flare = Array2::zeros(self.frame.size());
            self.frame.blur(self.psf.channel(channel))?.apply(light, &mut flare);
            Ok(flare)
        };
        light.iter().enumerate().map(of_channel).collect()
    }

    fn flared<'f>(&'f self, config: &'f DeconvolutionConfig) -> Flared<'f> {
        Flared { image: &self.image, saturated: &self.saturated, config }
    }

    fn lamp(&self, light: &Light) -> LampOutside {
        let mut lamp = LampOutside { position: [0.0; 2], pixels: 0, light: [0.0; CHANNELS] };
        for (place, shines) in shining(light).indexed_iter() {
            if !shines {
                continue;
            }
            lamp.pixels += 1;
            for (channel, light) in light.iter().enumerate() {
                let light = f64::from(light[place]);
                lamp.light[channel] += light;
                for (axis, index) in [place.0, place.1].into_iter().enumerate() {
                    lamp.position[axis] += light * self.axis(axis).offset(index) as f64;
                }
            }
        }
        let total: f64 = lamp.light.iter().sum();
        lamp.position = lamp.position.map(|moment| moment / total.max(f64::MIN_POSITIVE));
        lamp
    }

    pub(super) fn surroundings(&self) -> Array2<bool> {
        let [height, width] = self.frame.size();
        Array2::from_shape_fn(self.frame.plane_size(), |(y, x)| y >= height || x >= width)
    }

    fn axis(&self, axis: usize) -> PlaneAxis {
        PlaneAxis { frame: self.frame.size()[axis], plane: self.frame.plane_size()[axis] }
    }
}

/// A frame with unknown surroundings.
fn frame_around(image: &LinearImage, psf: &Psf, precision: TransformPrecision) -> Frame {
    let (size, of_psf) = ([image.height(), image.width()], [psf.height(), psf.width()]);
    Frame::new(size, of_psf, Border::Smooth, precision)
}

pub(super) fn brightest(light: &Array2<f32>) -> f32 {
    light.iter().fold(0.0, |most: f32, light| most.max(*light))
}

/// Where there is light in some channel.
pub(super) fn shining(light: &Light) -> Array2<bool> {
    let mut shining = Array2::default(light[0].dim());
    for light in light {
        shining.zip_mut_with(light, |shines, light| *shines |= *light > 0.0);
    }
    shining
}

#[cfg(test)]
mod tests;
