//! One channel of a capture on its way to the scene: what is presumed, and what is found.

use ndarray::{Array2, ArrayView2, ArrayViewMut2, Zip};

use super::super::objective::sum_of_rows;
use super::super::{constrained, objective};
use super::around::Around;
use super::conjugate::{Preconditioner, Room, System};
use super::effort::{
    SHARP_EFFORT, clean_effort, further_effort, is_explained_first, known_lamp_effort, lamp_effort,
    reduced_effort, takes_few_steps,
};
use super::frame::{Blur, Frame, row};
use super::known::Known;
use super::lamps::{Lamps, Light, Presumed};
use super::noise_level::{NOISE_FREE, NoiseLevel};
use super::prior::{Edges, Prior};
use super::uncertainty::NoiseGain;
use crate::core::error::Result;
use crate::core::fft::Damping;
use crate::core::image::row_of;
use crate::core::progress::Progress;
use crate::core::saturation::saturated_from;

/// The part of α that is added to the brightness that differences of neighbours are relative to: those of φ, which is what
/// counts, would be relative to 1.
const DARKNESS: f32 = 0.7;

/// λ over the standard deviation of the noise: of a scene of which nothing is known, and of one with known edges; the best of
/// powers of two around them.
const SMOOTHNESS: [f32; 2] = [1.5, 15.0];

/// Noise below which the prior gives way: a tenth of a photograph's, whose 10 bits leave 2 %.
const LOW_NOISE: f32 = 2e-3;

/// Rounds and steps that explain a capture with lamps to its last digit.
const EXACT_EFFORT: [usize; 2] = [8, 25];

/// The floor of |H|² in the inverse that a scene is refined from: three times as much restores the same, a tenth 0.1 dB worse.
const REFINED_POWER: f32 = 1e-2;

/// Samples of transforms up to which photographs without lamps are given three rounds of two steps instead of two of one: 0.3 dB on
/// scenes with much detail, 0.05 dB on others, a tenth of the time of 800 × 800 pixels.
const SWIFT_SAMPLES: usize = 2_000_000;

/// A channel in work.
pub(super) struct Channel<'a> {
    frame: &'a Frame,
    known: Known<'a>,
    /// The scene as far as it is found.
    pub(super) scene: Array2<f32>,
    /// D: the capture's local brightness, to which its noise is proportional, zero at saturated pixels.
    brightness: Array2<f32>,
    lamps: Option<Lamps>,
    noise: NoiseLevel,
    /// Whether the capture, which has no noise, is explained to its last digit.
    is_exact: bool,
    /// Whether the first scene is sharp enough to show its edges.
    is_sharp: bool,
    /// Whether large light was found around the frame.
    is_lit_around: bool,
    /// What the scene left unexplained of a capture without lamps when the last round began, and the one before; see [`Self::misfit`].
    misfits: [f64; 2],
    /// The pixels of the frame whose light is told.
    told: Option<Array2<bool>>,
}

/// What channels share, one after another.
pub(super) struct Workspace {
    room: Room,
    /// W, of the frame's size.
    weights: Array2<f32>,
    /// 1/n of a channel without lamps, once there is one.
    inverse_brightness: Array2<f32>,
}

impl Workspace {
    pub(super) fn new(frame: &Frame) -> Self {
        let weights = Array2::zeros(frame.size());
        Self { room: Room::new(frame), weights, inverse_brightness: Array2::default((0, 0)) }
    }
}

impl<'a> Channel<'a> {
    /// Sets a channel up. `pixels` are saturated, and `found` is their light, if there are any; `noise` is that of the capture.
    #[expect(clippy::too_many_lines, reason = "one struct, with lamps or without")]
    pub(super) fn new(
        frame: &'a Frame,
        known: Known<'a>,
        (pixels, found, noise, around): (Array2<bool>, Option<Light>, NoiseLevel, Option<&Around>),
        progress: &Progress,
    ) -> Result<Self> {
        progress.check()?;
        let Known { capture, psf, channel, config, is_guarded, .. } = known;
        if let Some(light) = found {
            // Found anew: planes of all channels would have to be kept while the light of the last is looked for.
            let mut brightness = known.brightness(&frame.surround(capture));
            let is_computed = noise.middle() <= NOISE_FREE && !frame.has_surrounding();
            let is_guarded = is_guarded && !is_computed;
            let darkness = DARKNESS * config.alpha;
            let saturated = known.saturated(frame, &pixels);
            let is_sharp = noise.middle() > NOISE_FREE
                && !known.is_reduced
                && light.is_coarse()
                && takes_few_steps(frame.transform_samples());
            let smoothness = is_sharp.then(|| first_smoothness(&noise));
            let given = Presumed { darkness, is_guarded, smoothness };
            let (lamps, mut scene) = saturated.start(light, &mut brightness, given)?;
            match noise.middle() <= NOISE_FREE {
                true => frame.cap_surrounding(&mut scene),
                false => frame.cap_by_border(&mut scene),
            }
            return Ok(Self {
                frame,
                known,
                scene,
                brightness,
                lamps: Some(lamps),
                noise,
                told: None,
                is_exact: false,
                is_sharp,
                is_lit_around: false,
                misfits: [f64::INFINITY; 2],
            });
        }
        let surrounded = frame.surround(capture);
        let brightness = known.brightness(&surrounded);
        let is_explained =
            !frame.has_surrounding() || !known.is_reduced && is_explained_first(frame.transform_samples());
        let scene = match around {
            Some(around) => around.scene(&frame.blur(psf)?, (&known, &brightness), first_smoothness(&noise)),
            None if noise.middle() <= NOISE_FREE && is_explained => {
                constrained::restore_surrounded(capture, psf, config, channel, progress)?
            }
            None => {
                let mut scene = match noise.middle() <= NOISE_FREE {
                    true => surrounded.mapv_into(|light| light.max(0.0)),
                    false => {
                        frame.blur(psf)?.first_inverse(&surrounded, &brightness, first_smoothness(&noise))
                    }
                };
                frame.cap_by_border(&mut scene);
                scene
            }
        };
        Ok(Self {
            frame,
            known,
            scene,
            brightness,
            lamps: None,
            noise,
            told: None,
            is_exact: false,
            is_sharp: true,
            is_lit_around: around.is_some(),
            misfits: [f64::INFINITY; 2],
        })
    }

    /// Rounds and steps in each: more where there is hardly any noise that would hide what they gain.
    ///
    /// The light of large lamps comes out of the haze around them slowly: five photographs of 384² with lamps have 29.1 dB after
    /// four rounds of five steps, 30.6 after four of 20, 31.2 after six and 32.0 after ten, so that as many are taken as time
    /// allows. A round holds other pixels at zero than the one before: eight of 25 steps gain 7 to 30 dB where there is no noise,
    /// and four of 40 nothing like it.
    pub(super) fn effort(&self) -> [usize; 2] {
        let sigma = self.sigma();
        let is_swift = self.frame.transform_samples() <= SWIFT_SAMPLES;
        match self.has_lamps() {
            true if self.known.is_reduced => reduced_effort(self.frame.transform_samples()),
            true if self.is_sharp => SHARP_EFFORT,
            true if self.lamps.as_ref().is_some_and(Lamps::has_coarse_light) => {
                known_lamp_effort(self.frame.transform_samples())
            }
            true => lamp_effort(self.frame.transform_samples()),
            false if sigma <= NOISE_FREE && !self.frame.has_surrounding() => [0, 0],
            false if sigma <= NOISE_FREE => clean_effort(self.frame.transform_samples()),
            false if sigma < LOW_NOISE => [3, 8],
            false if self.is_lit_around && is_swift => [3, 8],
            false if is_swift => [3, 2],
            false => [2, 1],
        }
    }

    /// Rounds and steps for a photograph without lamps that is not explained yet, where the last round explained more of it; or none.
    pub(super) fn further_effort(&self) -> [usize; 2] {
        if self.can_go_further() { further_effort(self.misfits) } else { [0, 0] }
    }

    fn can_go_further(&self) -> bool {
        let is_swift = self.frame.transform_samples() <= SWIFT_SAMPLES;
        is_swift && !self.has_lamps() && !self.known.is_reduced && self.is_noisy()
    }

    /// What an image A x leaves of the capture, over what noise leaves of it.
    ///
    /// # Equation
    /// `Σ ((y − A x)/D)² / Σ σ(D)²` over the pixels that are not saturated
    fn misfit(&self, image: &Array2<f32>) -> f64 {
        let brightness = self.frame.cut(&self.brightness);
        let known = |y: usize| row_of(brightness, y).iter().enumerate().filter(|(_, n)| **n > 0.0);
        let left = |y: usize| {
            let (capture, image) = (row_of(self.known.capture, y), row(image, y));
            known(y).map(|(x, n)| f64::from((capture[x] - image[x]) / n).powi(2)).sum()
        };
        let noise = |y: usize| known(y).map(|(_, n)| f64::from(self.noise.at(*n)).powi(2)).sum();
        sum_of_rows(image.nrows(), left) / sum_of_rows(image.nrows(), noise)
    }

    /// From here on, explains a capture with lamps that has no noise to its last digit, where nothing around it is unknown; returns
    /// rounds and steps for that, or none.
    ///
    /// Before, it is explained as if it had a little noise: without any, the least squares would be all, and what lamps hide is not told
    /// by these. Of twelve captures six have lamps: five of them are restored 7 to 22 dB better so than from the first round on, and one
    /// as before; 24 painted views gain 2 dB on average, three quarters of that by the last digits.
    pub(super) fn finish(&mut self) -> [usize; 2] {
        self.is_exact =
            self.has_lamps() && !self.is_noisy() && !self.known.is_reduced && !self.frame.has_surrounding();
        if self.is_exact { EXACT_EFFORT } else { [0, 0] }
    }

    /// Whether pixels are the means of blocks.
    pub(super) fn is_reduced(&self) -> bool {
        self.known.is_reduced
    }

    /// Whether edges can be looked for before the first round.
    pub(super) fn is_sharp(&self) -> bool {
        self.is_sharp
    }

    /// Whether pixels are saturated.
    pub(super) fn has_lamps(&self) -> bool {
        self.lamps.is_some()
    }

    /// Takes the `scene` in the frame for what is there, but where it is as bright as what saturates, and may be brighter: only light
    /// there and around the frame is looked for then.
    pub(super) fn learn(&mut self, scene: ArrayView2<'_, f32>) {
        let level = saturated_from(self.known.level());
        let told = scene.mapv(|light| light < level);
        Zip::from(self.frame.cut_mut(&mut self.scene)).and(scene).and(&told).for_each(
            |light, scene, told| {
                if *told {
                    *light = *scene;
                }
            },
        );
        self.told = Some(told);
    }

    /// Improves the scene.
    pub(super) fn improve(
        &mut self,
        (edges, steps): (&Edges, usize),
        workspace: &mut Workspace,
        progress: &Progress,
    ) -> Result<()> {
        if let Some(lamps) = &mut self.lamps {
            lamps.presume(&self.scene);
        }
        let Workspace { room, weights, inverse_brightness } = workspace;
        let blur = self.frame.blur(self.known.psf)?;
        let is_clean = self.lamps.is_none() && !self.is_noisy();
        let around = is_clean.then(|| {
            // Without lamps they are those of any scene.
            self.write_weights(room.image(), weights);
            self.inverse_majoriser(&blur, weights, room)
        });
        blur.apply(&self.scene, room.image());
        if self.can_go_further() {
            self.misfits = [self.misfit(room.image()), self.misfits[0]];
        }
        if !is_clean {
            self.write_weights(room.image(), weights);
        }
        let lamps = match &self.lamps {
            Some(lamps) => {
                let presumed = 4.0 * edges.mean() * self.smoothness();
                Some(lamps.preconditioner((self.frame, self.known.psf), weights, presumed)?)
            }
            None => None,
        };
        let inverse_brightness = match &self.lamps {
            Some(lamps) => &lamps.inverse_brightness,
            None => {
                if inverse_brightness.is_empty() {
                    *inverse_brightness = self.frame.plane();
                }
                Zip::indexed(inverse_brightness.rows_mut()).par_for_each(|y, mut row| {
                    self.write_inverse_brightness(y, row.as_slice_mut().expect("planes are contiguous"));
                });
                inverse_brightness
            }
        };
        let system = System {
            blur: &blur,
            capture: self.known.capture,
            weights,
            prior: Prior {
                weight: self.smoothness(),
                edges,
                inverse_brightness,
                lamps: self.lamps.as_ref().and_then(|lamps| lamps.modest(&self.brightness)),
            },
            told: self.told.as_ref(),
            preconditioner: match &around {
                Some(around) => Preconditioner::Framed { brightness: &self.brightness, around },
                None => {
                    let lamps = lamps.as_ref().map(|(pixels, inverse)| (*pixels, inverse));
                    Preconditioner::Convolution { brightness: &self.brightness, lamps }
                }
            },
        };
        system.descend(&mut self.scene, steps, (room, progress))
    }

    /// The inverse of a diagonal that is nowhere less curved than the least squares, for light around the frame.
    ///
    /// Steps along an inverse of the convolution throw all into that light that the scene does not explain yet, 4 dB with lamps just
    /// outside of the frame; within it they tell in three steps what steps along the diagonal do in thirty: two photographs of 8
    /// megapixels have 47.7 dB after three so, and 46.0 after three rounds of ten along the diagonal everywhere.
    ///
    /// # Equation
    /// `x̂/(AᵀW A x̂)` with the capture for x̂ (De Pierro 1995), as [`constrained`] has it.
    fn inverse_majoriser(&self, blur: &Blur<'_>, weights: &Array2<f32>, room: &mut Room) -> Array2<f32> {
        let alpha = self.known.config.alpha;
        let mut reference = self.frame.surround(self.known.capture);
        reference.par_mapv_inplace(|y| y.max(0.0) + constrained::DARKNESS * alpha);
        let image = room.image();
        blur.apply(&reference, image);
        Zip::from(&mut *image).and(weights).par_for_each(|image, weight| *image *= weight);
        let mut inverse = self.frame.plane();
        blur.transpose(image, &mut inverse);
        Zip::from(&mut inverse).and(&reference).par_for_each(|inverse, reference| {
            let unseen = objective::UNSEEN / (reference + alpha).powi(2);
            *inverse = 1.0 / (*inverse / reference).max(unseen);
        });
        inverse
    }

    /// Whether there is noise that a scene could be refined against.
    pub(super) fn is_noisy(&self) -> bool {
        self.noise.middle() > NOISE_FREE
    }

    /// The pixels that are saturated.
    pub(super) fn is_saturated(&self, place: [usize; 2]) -> bool {
        self.known.capture[place] >= saturated_from(self.known.level())
    }

    /// The scene with all detail that the capture has beyond it, and its noise: what the inverse with hardly a prior makes of
    /// the capture's rest is added, where pixels are not `hidden`. And the means of that noise's spectrum, for a capture of
    /// noise 1, over the bands of a block of so many pixels.
    pub(super) fn sharpened(
        &self,
        hidden: &Array2<bool>,
        bands: usize,
    ) -> Result<(Array2<f32>, Array2<f32>)> {
        let blur = self.frame.blur(self.known.psf)?;
        let mut rest = Array2::zeros(self.frame.size());
        blur.apply(&self.scene, &mut rest);
        let parts =
            Zip::from(&mut rest).and(self.known.capture).and(hidden).and(self.frame.cut(&self.brightness));
        parts.par_for_each(|rest, y, hidden, n| {
            *rest = if *hidden || *n <= 0.0 { 0.0 } else { (y - *rest) / n };
        });
        let mut added = self.frame.plane();
        let ones = Array2::ones(rest.dim());
        blur.invert(&rest, &ones, Damping { smoothness: 0.0, floor: REFINED_POWER }, &mut added);
        Zip::from(&mut rest)
            .and(self.frame.cut(&self.scene))
            .and(self.frame.cut(&added))
            .and(self.frame.cut(&self.brightness))
            .par_for_each(|out, x, added, n| *out = x + added * n);
        Ok((rest, blur.band_means(|power| power / (power + REFINED_POWER).powi(2), bands)))
    }

    /// Writes what the scene leaves of the capture, relative to its local brightness, where that is known; `image` is room for A x.
    pub(super) fn write_residual(&self, image: &mut Array2<f32>, out: ArrayViewMut2<'_, f32>) -> Result<()> {
        self.frame.blur(self.known.psf)?.apply(&self.scene, image);
        let pixels =
            Zip::from(out).and(self.known.capture).and(&*image).and(self.frame.cut(&self.brightness));
        pixels.par_for_each(|out, y, image, n| *out = if *n > 0.0 { (y - image) / n } else { 0.0 });
        Ok(())
    }

    /// Writes the standard deviation of the capture's noise at some pixels of a row; zero at lamps.
    pub(super) fn write_noise(&self, y: usize, columns: impl Iterator<Item = usize>, out: &mut [f32]) {
        let brightness = row(&self.brightness, y);
        out.iter_mut().zip(columns).for_each(|(out, x)| *out = brightness[x].max(0.0));
        self.noise.replace_by_deviations(out);
    }

    /// Adds the doubt about lamps and their flare to a deviation.
    pub(super) fn doubt(&self, deviation: ArrayViewMut2<'_, f32>) -> Result<()> {
        if let Some(lamps) = &self.lamps {
            let blur = self.frame.blur(self.known.psf)?;
            lamps.doubt(&blur, self.frame.cut(&self.scene), deviation);
        }
        Ok(())
    }

    /// Gives back what only the search for the scene needs, which is at its end.
    pub(super) fn settle(&mut self) {
        self.lamps.iter_mut().for_each(Lamps::settle);
    }

    /// The standard deviation of the noise of `log(y + α)` where the capture is of middling brightness.
    pub(super) fn relative_noise(&self) -> f32 {
        self.noise.middle()
    }

    /// The deviation that the capture is explained to: neither what lamps hide nor light around the frame is known so well that their
    /// flare could be told any better.
    fn sigma(&self) -> f32 {
        let least = if self.has_lamps() && !self.is_exact { LOW_NOISE } else { 0.0 };
        self.noise.middle().max(least)
    }

    /// λ of a scene with known edges.
    fn smoothness(&self) -> f32 {
        smoothness(SMOOTHNESS[1], self.sigma())
    }

    /// The standard deviation of the scene's error in the frame.
    ///
    /// # Equation
    /// `σ² = (D·σ(D)·g(e))² + (δ·flare)²`, g as in [`NoiseGain`]; of lamps, a part of their light.
    pub(super) fn deviation(&self, edges: &Edges) -> Result<Array2<f32>> {
        let gain = NoiseGain::new(&self.frame.blur(self.known.psf)?, self.smoothness());
        let mut deviation = gain.plane(edges, self.frame);
        Zip::from(&mut deviation).and(self.frame.cut(&self.brightness)).par_for_each(|gain, n| {
            if *n > 0.0 {
                *gain *= n * self.noise.at(*n);
            }
        });
        self.doubt(deviation.view_mut())?;
        Ok(deviation)
    }

    /// Writes a row of 1/n: the inverse of the scene's local brightness.
    pub(super) fn write_inverse_brightness(&self, y: usize, out: &mut [f32]) {
        match &self.lamps {
            Some(lamps) => out.copy_from_slice(row(&lamps.inverse_brightness, y)),
            None => {
                let brighter = (1.0 - DARKNESS) * self.known.config.alpha;
                out.iter_mut().zip(row(&self.brightness, y)).for_each(|(v, n)| *v = 1.0 / (n - brighter));
            }
        }
    }

    fn write_weights(&self, image: &Array2<f32>, weights: &mut Array2<f32>) {
        match &self.lamps {
            Some(lamps) => {
                let brightness = self.frame.cut(&self.brightness);
                lamps.weights((image, brightness), self.known.capture, weights);
            }
            None => Zip::from(weights)
                .and(self.frame.cut(&self.brightness))
                .par_for_each(|weight, n| *weight = 1.0 / (n * n)),
        }
    }
}

/// λ of a scene of which nothing is known.
pub(super) fn first_smoothness(noise: &NoiseLevel) -> f32 {
    smoothness(SMOOTHNESS[0], noise.middle())
}

/// λ for a deviation of the noise.
///
/// # Equation
/// `c·σ`, and `c·σ²/σ₀` below σ₀: the prior has to give way faster than noise where there is hardly any.
fn smoothness(factor: f32, sigma: f32) -> f32 {
    factor * sigma * (sigma / LOW_NOISE).min(1.0)
}
