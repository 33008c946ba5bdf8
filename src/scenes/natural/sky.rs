//! Skies by day with sun, clouds and haze over a landscape of hills, woods and houses.

use std::f32::consts::TAU;

use super::draw::{Draw, mean_disc_area};
use super::easel::{BRIGHTEST, Easel};
use super::film::Point;
use super::light::{Rgb, blend, glowing, hue, luminance, scale, tint};
use super::outline;
use super::surface::Surface;

/// The sun in a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sun {
    pub(super) centre: Point,
    pub(super) radius: f32,
    pub(super) colour: Rgb,
}

impl Sun {
    /// A disc 2 to 20 pixels wide at 10³ to 10⁶ within the upper part of an image, `height` being that part's.
    pub(super) fn draw(draw: &mut Draw, [height, width]: [f32; 2]) -> Self {
        let radius = draw.log(1.0, 10.0).min(0.12 * height.min(width) + 0.5);
        let level = draw.log(1e3, 0.7 * BRIGHTEST);
        let colour = scale(&glowing(draw.log(2800.0, 6500.0), 5500.0), level);
        Self { centre: [draw.uniform(0.03, 0.97) * width, draw.uniform(0.04, 0.95) * height], radius, colour }
    }

    /// The disc, and the light that is scattered around it.
    pub(super) fn paint(&self, easel: &mut Easel, sky: f32) {
        let level = luminance(&self.colour);
        let aureole = scale(&self.colour, sky * easel.draw.log(1.5, 12.0) / level);
        let wide = self.radius * easel.draw.log(3.0, 14.0);
        easel.glow(self.centre, wide, aureole);
        let near = scale(&self.colour, sky * easel.draw.log(5.0, 40.0) / level);
        easel.glow(self.centre, 1.6 * self.radius, near);
        easel.shine(&outline::disc(self.centre, self.radius), self.colour);
    }
}

/// Paints a sky of about a given luminance above the height `horizon`, the sun behind its clouds.
pub(super) fn heavens(easel: &mut Easel, level: f32, horizon: f32, sun: Option<Sun>) {
    let draw = &mut easel.draw;
    let is_grey = draw.chance(0.3);
    let zenith = if is_grey { hue(4.2, 0.05) } else { hue(4.0, draw.uniform(0.25, 0.75)) };
    let low =
        if draw.chance(0.3) { hue(draw.uniform(0.3, 0.9), draw.uniform(0.2, 0.7)) } else { hue(4.0, 0.1) };
    let (zenith, low) = (scale(&zenith, level * draw.uniform(0.4, 0.9)), scale(&low, level * 1.2));
    let [_, width] = easel.film.size();
    let whole = [0.0, 0.0, width, horizon];
    easel.film.within(whole, |[_, y], sample| *sample = blend(&zenith, &low, (y / horizon).clamp(0.0, 1.0)));
    if let Some(sun) = sun {
        sun.paint(easel, level);
    }
    if easel.draw.chance(0.85) {
        clouds(easel, level, horizon);
    }
}

/// Clouds of 1/f noise in perspective: flatter and denser towards the horizon; thin ones let the sun through.
fn clouds(easel: &mut Easel, level: f32, horizon: f32) {
    let [height, width] = easel.film.size();
    let draw = &mut easel.draw;
    let (threshold, steepness) = (draw.uniform(-0.8, 1.0), draw.log(0.5, 2.0));
    let (offset, period) = (draw.uniform(0.0, 256.0), draw.uniform(0.5, 1.2) * height.max(width));
    let flatness = draw.uniform(1.0, 3.5);
    let white = scale(&hue(draw.uniform(0.0, TAU), 0.05), level * draw.log(1.2, 3.0));
    let grey = scale(&hue(4.2, 0.12), level * draw.log(0.15, 0.8));
    let grain = &easel.grain;
    easel.film.within([0.0, 0.0, width, horizon], |[x, y], sample| {
        let depth = 1.0 + (flatness - 1.0) * y / horizon;
        let (u, v) = ((x - 0.5 * width) * depth.sqrt() + offset, y * depth + offset);
        let density = steepness * (grain.deep(u, v, period) - threshold);
        if density > 0.0 {
            let cover = 1.0 - (-2.5 * density).exp();
            // The sun's own light wanes in the cloud by Beer–Lambert, and lights the cloud instead.
            let through = sample.map(|value| value * (-6.0 * density).exp());
            let lit = blend(&white, &grey, (0.8 * density).min(1.0));
            (0..sample.len()).for_each(|c| sample[c] = through[c] + cover * lit[c]);
        }
    });
}

/// A landscape under a sky, mostly with the sun in it.
pub(super) fn landscape(easel: &mut Easel) {
    let [height, width] = easel.film.size();
    let ground = 0.18 * easel.draw.log(0.3, 1.0);
    let level = ground * easel.draw.log(2.0, 14.0);
    let horizon = height * easel.draw.uniform(0.35, 0.8);
    let sun = easel.draw.chance(0.8).then(|| Sun::draw(&mut easel.draw, [horizon, width]));
    heavens(easel, level, horizon + 0.1 * height, sun);
    let haze = scale(&hue(4.0, 0.15), 0.7 * level);
    let ridges = easel.draw.count(1, 4);
    for i in 0..ridges {
        let nearness = (i + 1) as f32 / ridges as f32;
        let top = horizon + (height - horizon) * 0.35 * (nearness - 1.0 / ridges as f32);
        ridge(easel, top, nearness, (haze, ground));
    }
    let near = easel.draw.uniform(0.0, 1.0);
    if near < 0.45 {
        houses(easel, horizon + 0.25 * (height - horizon), ground);
    } else if near < 0.7 {
        bare_trees(easel, ground);
    }
    easel.expose(0.08, 0.5);
}

/// Hills with a wooded crest and fields of grain, in haze where they are far.
fn ridge(easel: &mut Easel, top: f32, nearness: f32, (haze, ground): (Rgb, f32)) {
    let [height, width] = easel.film.size();
    let steps = easel.film.grid()[1].max(2);
    let (seed, rough) = (easel.draw.uniform(0.0, 256.0), easel.draw.log(0.01, 0.06) * height);
    let crest = easel.draw.log(0.5, 4.0) * nearness;
    let heights: Vec<f32> = (0..steps)
        .map(|i| {
            let u = i as f32 / steps as f32 * width;
            let hill = easel.grain.at(seed + u * 20.0 / width, seed);
            let trees = easel.grain.at(seed + 0.7 * u, 3.0 * seed);
            top - rough * hill - crest * trees
        })
        .collect();
    let colour = tint(&hue(easel.draw.uniform(0.9, 2.4), easel.draw.uniform(0.1, 0.6)), &[ground; 3]);
    let colour = blend(&colour, &haze, 0.75 * (1.0 - nearness));
    let surface = Surface::grainy(&mut easel.draw, colour, 0.2 + 0.5 * nearness);
    let surface = surface.shaded([0.0, top], [0.0, -0.4 / height]);
    easel.paint(&outline::skyline(&heights, width, height + 1.0), &surface);
    if easel.draw.chance(0.7) {
        growth(easel, &heights, nearness, colour);
    }
}

/// Bushes, trees and stones on a slope, of power-law sizes, denser in some places.
fn growth(easel: &mut Easel, crest: &[f32], nearness: f32, colour: Rgb) {
    let [height, width] = easel.film.size();
    let radii = [0.6 + nearness, 0.05 * height * nearness + 3.0];
    let area = (height - crest[0]).max(1.0) * width;
    let mut left = easel.draw.log(0.1, 1.2) * area / mean_disc_area(radii);
    while left > 0.0 {
        left -= 1.0;
        let radius = easel.draw.power_law(radii);
        let along = easel.draw.uniform(0.0, 0.999);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the crest")]
        let top = crest[(along * crest.len() as f32) as usize];
        let centre = [along * width, easel.draw.uniform(top, height)];
        let level = (0.5 * easel.draw.normal()).exp() * easel.draw.log(0.4, 1.3);
        let leaves = Surface::grainy(&mut easel.draw, scale(&colour, level), 0.4);
        let leaves = leaves.shaded(centre, [-0.2 / radius, -0.4 / radius]);
        let outline = outline::blob(&mut easel.draw, centre, radius);
        easel.paint(&outline, &leaves);
    }
}

/// A row of houses with windows.
fn houses(easel: &mut Easel, ground_y: f32, ground: f32) {
    let [height, width] = easel.film.size();
    let mut left = easel.draw.uniform(-0.1, 0.6) * width;
    let mut count = easel.draw.count(1, 7);
    while left < width && count > 0 {
        count -= 1;
        let right = left + easel.draw.log(0.05, 0.25) * width;
        let top = ground_y - easel.draw.log(0.08, 0.5) * height;
        let colour = tint(&hue(easel.draw.uniform(0.0, 1.2), 0.3), &[ground * easel.draw.log(0.2, 3.0); 3]);
        let wall = Surface::grainy(&mut easel.draw, colour, 0.12);
        easel.paint(&outline::rectangle([left, top, right, height + 1.0]), &wall);
        if easel.draw.chance(0.6) {
            let roof =
                [[left - 2.0, top], [(left + right) / 2.0, top - 0.35 * (right - left)], [right + 2.0, top]];
            let tiles = Surface::grainy(&mut easel.draw, scale(&colour, 0.5), 0.25);
            easel.paint(&roof, &tiles);
        }
        panes(easel, [left, top, right, height], scale(&colour, 0.25));
        left = right + easel.draw.uniform(0.0, 0.1) * width;
    }
}

fn panes(easel: &mut Easel, [left, top, right, bottom]: [f32; 4], colour: Rgb) {
    let pitch = easel.draw.log(5.0, 26.0);
    let size = [easel.draw.uniform(0.3, 0.7) * pitch, easel.draw.uniform(0.3, 0.75) * pitch];
    let mut y = top + 0.4 * pitch;
    while y + size[1] < bottom {
        let mut x = left + 0.3 * pitch;
        while x + size[0] < right {
            let pane = scale(&colour, easel.draw.log(0.5, 2.0));
            easel.shine(&outline::rectangle([x, y, x + size[0], y + size[1]]), pane);
            x += pitch;
        }
        y += pitch;
    }
}

/// Trees without leaves against the sky, down to twigs of a pixel.
fn bare_trees(easel: &mut Easel, ground: f32) {
    let [height, width] = easel.film.size();
    for _ in 0..easel.draw.count(1, 4) {
        let foot = [easel.draw.uniform(0.0, width), height];
        let length = height * easel.draw.uniform(0.15, 0.3);
        let bark = scale(&[1.0, 0.8, 0.65], ground * easel.draw.log(0.1, 0.5));
        branch(easel, foot, (length, -TAU / 4.0, length * 0.09), bark);
    }
}

/// A branch and what grows from it, until twigs are thinner than half a pixel.
pub(super) fn branch(easel: &mut Easel, from: Point, (length, angle, width): (f32, f32, f32), bark: Rgb) {
    let to = [from[0] + length * angle.cos(), from[1] + length * angle.sin()];
    easel.shine(&outline::stroke(from, to, [width, 0.7 * width]), bark);
    if width < 0.6 || length < 3.0 {
        return;
    }
    for _ in 0..easel.draw.count(2, 3) {
        let turn = angle + 0.45 * easel.draw.normal();
        let shorter = length * easel.draw.uniform(0.6, 0.88);
        let thinner = width * easel.draw.uniform(0.5, 0.72);
        branch(easel, to, (shorter, turn, thinner), bark);
    }
}
