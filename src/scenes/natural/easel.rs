//! What painters of natural scenes share: the film, choices, grain, and the ways to put light onto the film.

use super::draw::Draw;
use super::film::{Film, Point};
use super::grain::Grain;
use super::light::{Rgb, luminance, scale};
use super::outline;
use super::surface::Surface;
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::rng::Rng;

/// The brightest light of a scene.
pub(super) const BRIGHTEST: f32 = 1e6;

/// Irradiance at which exposures clip that are to show mid-tones well.
pub(super) const CLIPPING: f32 = 16.0;

/// Largest share of the image that may lie above [`CLIPPING`].
const MOST_CLIPPED: f32 = 0.17;

/// A scene in the making.
pub(super) struct Easel {
    pub(super) film: Film,
    pub(super) draw: Draw,
    pub(super) grain: Grain,
}

impl Easel {
    pub(super) fn new(size: [usize; 2], rng: Rng) -> Self {
        let mut draw = Draw(rng);
        let roughness = draw.uniform(0.75, 1.0);
        let grain = Grain::new(&mut draw, roughness);
        Self { film: Film::new(size), draw, grain }
    }

    /// The shorter side in pixels.
    pub(super) fn side(&self) -> f32 {
        let [height, width] = self.film.size();
        height.min(width)
    }

    /// Covers an outline with a surface.
    pub(super) fn paint(&mut self, outline: &[Point], surface: &Surface) {
        let grain = &self.grain;
        self.film.fill(outline, |at, sample| *sample = surface.at(at, grain));
    }

    /// Covers the whole film.
    pub(super) fn prime(&mut self, surface: &Surface) {
        let grain = &self.grain;
        self.film.all(|at, sample| *sample = surface.at(at, grain));
    }

    /// Makes an outline shine in one colour.
    pub(super) fn shine(&mut self, outline: &[Point], colour: Rgb) {
        self.film.fill(outline, |_, sample| *sample = colour);
    }

    /// Adds light that falls off from a place: colour/(1 + (d/radius)²)².
    pub(super) fn glow(&mut self, [x, y]: Point, radius: f32, colour: Rgb) {
        // Beyond it less than a thousandth of the mid-tones is left.
        let peak = luminance(&colour).max(1e-6);
        let reach = radius * (peak / 2e-4).powf(0.25).max(1.0);
        self.film.within([x - reach, y - reach, x + reach, y + reach], |at, sample| {
            let distance = ((at[0] - x).powi(2) + (at[1] - y).powi(2)) / (radius * radius);
            let share = (1.0 + distance).powi(-2);
            (0..sample.len()).for_each(|c| sample[c] += share * colour[c]);
        });
    }

    /// A round lamp with the light that it spreads in the air and the lens around it.
    pub(super) fn lamp(&mut self, centre: Point, radius: f32, colour: Rgb) {
        let level = luminance(&colour).max(1e-6);
        // The haze holds about a thousandth of the lamp's light.
        let haze = (1.5e-4 * level).min(0.6 * level.sqrt() / 10.0);
        self.glow(centre, 4.0 * radius, scale(&colour, haze / level));
        self.shine(&outline::disc(centre, radius), colour);
    }

    /// Darkens what lies below a thing: a soft round shadow.
    pub(super) fn shadow(&mut self, [x, y]: Point, radius: f32, strength: f32) {
        let reach = 1.35 * radius;
        self.film.within([x - reach, y - reach, x + reach, y + reach], |at, sample| {
            let distance = (at[0] - x).hypot(at[1] - y) / radius;
            let t = ((1.35 - distance) / 0.6).clamp(0.0, 1.0);
            let light = 1.0 - strength * t * t * (3.0 - 2.0 * t);
            *sample = sample.map(|value| value * light);
        });
    }

    /// Exposes what is painted so far for its median, which is to be a mid-tone; returns the factor.
    pub(super) fn expose(&mut self, from: f32, to: f32) -> f32 {
        let factor = self.draw.log(from, to) / self.film.median().max(1e-6);
        self.film.scale(factor);
        factor
    }

    /// Develops the film, darker where too much of it would clip.
    ///
    /// # Errors
    /// As [`Film::develop`].
    pub(super) fn develop(mut self) -> Result<LinearImage> {
        let bright =
            self.film.quantile(1.0 - MOST_CLIPPED, |sample| sample.iter().fold(0.0, |a, b| b.max(a)));
        if bright > CLIPPING {
            self.film.scale(CLIPPING / bright);
        }
        let softness = self.draw.uniform(0.0, 0.33);
        self.film.develop(softness, BRIGHTEST)
    }
}
