//! One channel of a capture on its way to the scene: what is known, what is presumed, what is found.

use ndarray::{Array2, ArrayView2, Zip};

use super::conjugate::{Preconditioner, Room, System, inner};
use super::flare::{Clipped, grown};
use super::frame::{Blur, Frame};
use super::noise_level::NoiseLevel;
use super::prior::{Edges, Prior};
use super::smooth::{local_mean, paint};
use super::uncertainty::NoiseGain;
use crate::core::error::Result;
use crate::core::progress::Progress;
use crate::core::saturation::saturated_from;

/// Pixels around saturated ones whose values are not believed.
const GUARD_PX: usize = 1;

/// The part of the largest curvature that a lamp's pixel has at least.
const LEAST_CURVATURE: f32 = 1e-9;

/// Standard deviation of the bell that local brightness is taken over, in pixels: wide enough to commute with the core of a
/// PSF, narrow enough to tell a window from its wall.
const NEAR_PX: f32 = 4.0;

/// The part of α that is added to the brightness that differences of neighbours are relative to.
const DARKNESS: f32 = 0.7;

/// λ over the standard deviation of the noise: of a scene of which nothing is known, and of one with known edges.
const SMOOTHNESS: [f32; 2] = [1.5, 15.0];

/// How far the steps of lamps go beside those of other pixels.
const LAMP_BOOST: f32 = 0.3;

/// Noise below which the prior gives way: a tenth of a photograph's.
const LOW_NOISE: f32 = 2e-3;

/// Noise below which a capture is a computed one.
const NOISE_FREE: f32 = 3e-4;

/// Steps to the exact inverse at most.
const EXACT_STEPS: usize = 20;

/// Relative misfit, root mean square, at which a noise-free capture is explained: 80 dB.
const EXPLAINED: f32 = 1e-4;

/// The floor of |H|² in the first inverse.
const LEAST_POWER: f32 = 1e-4;

/// The part of the flare that was taken away that may be wrong.
const FLARE_DOUBT: f32 = 0.03;

/// The part of a lamp's light that may be wrong.
const LAMP_DOUBT: f32 = 0.2;

/// A channel in work.
pub(super) struct Channel {
    /// y, continued into the surrounding of the frame.
    capture: Array2<f32>,
    /// The scene as far as it is found.
    pub(super) scene: Array2<f32>,
    /// 1/n: the inverse of the scene's local brightness, zero at saturated pixels.
    pub(super) inverse_brightness: Array2<f32>,
    /// D: the capture's local brightness, to which its noise is proportional, zero at saturated pixels.
    brightness: Array2<f32>,
    lamps: Option<Lamps>,
    level: f32,
    noise: NoiseLevel,
}

/// What there is where pixels are saturated.
struct Lamps {
    saturated: Array2<bool>,
    /// The inverse of D² where the capture is known, zero elsewhere.
    known: Array2<f32>,
    /// The inverse of D² of saturated pixels.
    bounds: Array2<f32>,
    /// The capture's part that comes from saturated pixels.
    flare: Array2<f32>,
}

impl Channel {
    /// Sets a channel up, and measures the light of its saturated pixels.
    pub(super) fn new(
        frame: &Frame,
        (capture, psf): (ArrayView2<'_, f32>, ArrayView2<'_, f32>),
        (level, alpha): (f32, f32),
        progress: &Progress,
    ) -> Result<Self> {
        let mut capture = frame.surround(capture);
        capture.mapv_inplace(|y| y.max(0.0));
        let mut brightness = local_mean(&capture, NEAR_PX);
        brightness.mapv_inplace(|mean| mean + alpha);
        let from = saturated_from(level);
        let blur = frame.blur(psf)?;
        let noise = NoiseLevel::estimate(frame.cut(&capture), (alpha, from), blur.parts_left());
        let sigma = noise.middle();
        let saturated =
            Array2::from_shape_fn(capture.dim(), |(y, x)| frame.contains(y, x) && capture[[y, x]] >= from);
        if !saturated.iter().any(|saturated| *saturated) {
            let inverse_brightness = local_mean(&capture, NEAR_PX).mapv(|n| 1.0 / (n + DARKNESS * alpha));
            let smoothness = smoothness(SMOOTHNESS[0], sigma);
            let mut scene = frame.plane();
            if sigma <= NOISE_FREE && !frame.has_surrounding() {
                scene = exact_inverse(&blur, &capture, &brightness, progress)?;
            } else {
                let inverse = brightness.mapv(|n| 1.0 / n);
                let response =
                    |power: f32, laplacian: f32| 1.0 / (power + smoothness * laplacian + LEAST_POWER);
                blur.invert(&capture, &inverse, response, &mut scene);
                Zip::from(&mut scene).and(&brightness).par_for_each(|x, n| *x = (*x * n).max(0.0));
            }
            return Ok(Self { capture, scene, inverse_brightness, brightness, lamps: None, level, noise });
        }
        Self::with_lamps(frame, (capture, brightness, saturated), (psf, level, alpha), (noise, progress))
    }

    fn with_lamps(
        frame: &Frame,
        (capture, mut brightness, saturated): (Array2<f32>, Array2<f32>, Array2<bool>),
        (psf, level, alpha): (ArrayView2<'_, f32>, f32, f32),
        (noise, progress): (NoiseLevel, &Progress),
    ) -> Result<Self> {
        let (blur, squared) = (frame.blur(psf)?, frame.squared_blur(psf)?);
        let clipped = Clipped {
            frame,
            blur: &blur,
            squared: &squared,
            capture: &capture,
            saturated: &saturated,
            brightness: &brightness,
            level,
        };
        let mut light = clipped.measure(progress)?;
        Zip::from(&mut light).and(&saturated).par_for_each(|light, saturated| {
            if *saturated {
                *light += level;
            }
        });
        let mut flare = frame.plane();
        blur.apply(&light, &mut flare);
        let mut rest = Zip::from(&flare).and(&capture).par_map_collect(|flare, y| (y - flare).max(0.0));
        let guarded = grown(&saturated, GUARD_PX);
        let seen = guarded.mapv(|guarded| if guarded { 0.0 } else { 1.0 });
        paint(&mut rest, &seen);
        let inverse_brightness =
            Zip::from(&local_mean(&rest, NEAR_PX)).and(&saturated).par_map_collect(|mean, saturated| {
                if *saturated { 0.0 } else { 1.0 / (mean + DARKNESS * alpha) }
            });
        let scene = Zip::from(&saturated)
            .and(&light)
            .and(&rest)
            .par_map_collect(|saturated, light, rest| if *saturated { *light } else { *rest });
        let known = Array2::from_shape_fn(seen.dim(), |(y, x)| {
            if frame.contains(y, x) { seen[[y, x]] * brightness[[y, x]].powi(-2) } else { 0.0 }
        });
        let bounds = Zip::from(&saturated)
            .and(&brightness)
            .par_map_collect(|saturated, n| if *saturated { n.powi(-2) } else { 0.0 });
        Zip::from(&mut brightness).and(&saturated).par_for_each(|n, saturated| {
            if *saturated {
                *n = 0.0;
            }
        });
        let lamps = Some(Lamps { saturated, known, bounds, flare });
        Ok(Self { capture, scene, inverse_brightness, brightness, lamps, level, noise })
    }

    /// Rounds and steps in each: more where there is hardly any noise that would hide what they gain.
    pub(super) fn effort(&self, frame: &Frame) -> [usize; 2] {
        let is_low = self.noise.middle() < LOW_NOISE;
        match (self.has_lamps(), is_low) {
            (true, false) => [3, 8],
            (true, true) => [4, 20],
            (false, false) => [2, 1],
            (false, true) if self.noise.middle() <= NOISE_FREE && !frame.has_surrounding() => [0, 0],
            (false, true) => [3, 8],
        }
    }

    /// Whether pixels are saturated.
    pub(super) fn has_lamps(&self) -> bool {
        self.lamps.is_some()
    }

    /// Improves the scene.
    pub(super) fn improve(
        &mut self,
        (frame, psf): (&Frame, ArrayView2<'_, f32>),
        (edges, steps): (&Edges, usize),
        (room, progress): (&mut Room, &Progress),
    ) -> Result<()> {
        let blur = frame.blur(psf)?;
        blur.apply(&self.scene, room.image());
        let weights = self.weights(frame, room.image());
        let lamps = self.lamps_preconditioner(frame, psf, &weights)?;
        let system = System {
            blur: &blur,
            weights: &weights,
            prior: Prior { weight: self.smoothness(), edges, inverse_brightness: &self.inverse_brightness },
            preconditioner: Preconditioner { brightness: &self.brightness, lamps: lamps.as_ref() },
        };
        system.descend(&mut self.scene, &self.capture, steps, (room, progress))
    }

    /// The standard deviation of the noise of `log(y + α)` where the capture is of middling brightness.
    pub(super) fn relative_noise(&self) -> f32 {
        self.noise.middle()
    }

    /// λ of a scene with known edges.
    fn smoothness(&self) -> f32 {
        smoothness(SMOOTHNESS[1], self.noise.middle())
    }

    /// The standard deviation of the scene's error.
    ///
    /// # Equation
    /// `σ² = (D·σ(D)·g(e))² + (δ·flare)²`, g as in [`NoiseGain`]; of lamps, a part of their light.
    pub(super) fn deviation(&self, blur: &Blur<'_>, edges: &Edges) -> Array2<f32> {
        let mut deviation = NoiseGain::new(blur, self.smoothness()).plane(edges, blur.frame.plane_size());
        Zip::from(&mut deviation).and(&self.brightness).par_for_each(|gain, n| {
            if *n > 0.0 {
                *gain *= n * self.noise.at(*n);
            }
        });
        if let Some(lamps) = &self.lamps {
            let parts = Zip::from(&mut deviation).and(&lamps.flare).and(&lamps.saturated).and(&self.scene);
            parts.par_for_each(|deviation, flare, saturated, scene| {
                *deviation =
                    if *saturated { LAMP_DOUBT * scene } else { deviation.hypot(FLARE_DOUBT * flare) };
            });
        }
        deviation
    }

    /// W: where a saturated pixel is brighter than what the scene explains, no more is known of it.
    fn weights(&self, frame: &Frame, image: &Array2<f32>) -> Array2<f32> {
        match &self.lamps {
            None => Array2::from_shape_fn(image.dim(), |(y, x)| {
                if frame.contains(y, x) { self.brightness[[y, x]].powi(-2) } else { 0.0 }
            }),
            Some(lamps) => Zip::from(&lamps.known).and(&lamps.bounds).and(image).par_map_collect(
                |known, bound, image| {
                    if *image < self.level { known + bound } else { *known }
                },
            ),
        }
    }

    fn lamps_preconditioner(
        &self,
        frame: &Frame,
        psf: ArrayView2<'_, f32>,
        weights: &Array2<f32>,
    ) -> Result<Option<Array2<f32>>> {
        let Some(lamps) = &self.lamps else { return Ok(None) };
        let ones = Array2::ones(weights.dim());
        let mut diagonal = frame.plane();
        frame.squared_blur(psf)?.transpose(weights, &ones, &mut diagonal);
        let least = LEAST_CURVATURE * diagonal.iter().fold(0.0, |most: f32, value| most.max(*value));
        Ok(Some(Zip::from(&diagonal).and(&lamps.saturated).par_map_collect(|value, saturated| {
            if *saturated { LAMP_BOOST / value.max(least) } else { 0.0 }
        })))
    }
}

/// λ for a deviation of the noise.
///
/// # Equation
/// `c·σ`, and `c·σ²/σ₀` below σ₀: the prior has to give way faster than noise where there is hardly any.
fn smoothness(factor: f32, sigma: f32) -> f32 {
    factor * sigma * (sigma / LOW_NOISE).min(1.0)
}

/// `x ← max(0, x + B(y − A x))`, B the regularised inverse, as long as that explains the capture better.
///
/// Where there is neither noise nor light from outside, some steps of it solve to many digits.
fn exact_inverse(
    blur: &Blur<'_>,
    capture: &Array2<f32>,
    brightness: &Array2<f32>,
    progress: &Progress,
) -> Result<Array2<f32>> {
    let ones = Array2::ones(capture.dim());
    let inverse = |power: f32, _| 1.0 / (power + LEAST_POWER);
    let (mut scene, mut best) = (capture.clone(), (f64::INFINITY, capture.clone()));
    let [mut residual, mut step] = [(); 2].map(|()| Array2::zeros(capture.dim()));
    for _ in 0..EXACT_STEPS {
        progress.check()?;
        blur.apply(&scene, &mut residual);
        Zip::from(&mut residual).and(capture).par_for_each(|r, y| *r = y - *r);
        let relative = &residual / brightness;
        let misfit = inner(&relative, &relative);
        if misfit >= best.0 {
            break;
        }
        best = (misfit, scene.clone());
        if misfit <= f64::from(EXPLAINED).powi(2) * capture.len() as f64 {
            break;
        }
        blur.invert(&residual, &ones, inverse, &mut step);
        Zip::from(&mut scene).and(&step).par_for_each(|x, step| *x = (*x + step).max(0.0));
    }
    Ok(best.1)
}
