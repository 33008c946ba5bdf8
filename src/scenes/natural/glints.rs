//! Many small highlights on dark textures: gravel, crumpled foil, and water under a low sun.

use super::draw::{Draw, mean_disc_area};
use super::easel::Easel;
use super::leaves::daylight;
use super::light::{Palette, Rgb, glowing, scale};
use super::outline;
use super::surface::Surface;

pub(super) fn paint(easel: &mut Easel) {
    let light = daylight(&mut easel.draw);
    if easel.draw.chance(0.5) {
        gravel(easel, &light);
    } else {
        water(easel, &light);
    }
    easel.expose(0.05, 0.25);
    let brightest = easel.draw.log(30.0, 3e4);
    let sun = glowing(easel.draw.log(3000.0, 6500.0), 5500.0);
    let across = if easel.draw.chance(0.5) { easel.draw.log(1.0, 3.0) } else { 1.0 };
    let count = share_of_pixels(easel, 0.003, 0.025);
    sprinkle(easel, count, (brightest, across), &sun);
}

/// Stones of power-law sizes, each with light from above.
fn gravel(easel: &mut Easel, light: &Rgb) {
    let palette = Palette::new(&mut easel.draw, 6, light);
    let radii = [easel.draw.log(1.0, 3.0), 0.1 * easel.side().max(40.0)];
    let ground = palette.draw(&mut easel.draw);
    let soil = Surface::grainy(&mut easel.draw, ground, 0.5);
    easel.prime(&soil);
    let [height, width] = easel.film.size();
    let mut left = easel.draw.uniform(1.0, 2.5) * height * width / mean_disc_area(radii);
    while left > 0.0 {
        left -= 1.0;
        let radius = easel.draw.power_law(radii);
        let centre = easel.draw.point([height, width], radius);
        if radius > 2.0 {
            easel.shadow([centre[0] + 0.3 * radius, centre[1] + 0.35 * radius], 1.1 * radius, 0.6);
        }
        let colour = palette.draw(&mut easel.draw);
        let stone = Surface::grainy(&mut easel.draw, colour, 0.25);
        let stone = stone.shaded(centre, [-0.3 / radius, -0.45 / radius]);
        let outline = outline::blob(&mut easel.draw, centre, radius);
        easel.paint(&outline, &stone);
    }
}

/// Waves in perspective under a sky, dark between their crests.
fn water(easel: &mut Easel, light: &Rgb) {
    let [height, _] = easel.film.size();
    let (offset, length) = (easel.draw.uniform(0.0, 256.0), easel.draw.log(0.2, 0.9));
    let (depth, contrast) = (easel.draw.uniform(1.5, 5.0), easel.draw.uniform(0.4, 1.0));
    let grain = &easel.grain;
    easel.film.all(|[x, y], sample| {
        let far = depth + (1.0 - depth) * y / height;
        let (u, v) = (0.35 * length * x * far.sqrt() + offset, length * y * far);
        let slope = grain.at(u, v) + 0.5 * grain.at(2.9 * u, 2.9 * v + 40.0);
        let level = 0.08 * (contrast * slope).exp();
        *sample = scale(&[0.75 * light[0], light[1], 1.3 * light[2]], level);
    });
}

/// A number of things that is a share of the image's pixels, drawn between two.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the film's pixels")]
pub(super) fn share_of_pixels(easel: &mut Easel, least: f32, most: f32) -> usize {
    let [height, width] = easel.film.size();
    (easel.draw.log(least, most) * height * width).ceil() as usize
}

/// Scatters highlights 0.5 to 3 pixels wide around a few places; few are bright, most weak.
///
/// # Equation
/// Levels have a density of level⁻², between 1 and `brightest`: each decade of them holds as much light.
pub(super) fn sprinkle(easel: &mut Easel, count: usize, (brightest, across): (f32, f32), sun: &Rgb) {
    let [height, width] = easel.film.size();
    let centre = easel.draw.point([height, width], 0.0);
    let spread = [width * easel.draw.log(0.08, 0.6), height * easel.draw.log(0.2, 1.0)];
    let median = easel.film.median();
    for _ in 0..count {
        let draw = &mut easel.draw;
        let at = [centre[0] + spread[0] * draw.normal(), centre[1] + spread[1] * draw.normal()];
        // They sit where the waves and stones already turn to the light.
        if easel.film.brightness(at) < median && draw.chance(0.8) {
            continue;
        }
        let level = 1.0 / draw.uniform(1.0 / brightest, 1.0);
        let radius = draw.log(0.3, 1.1);
        let angle = slant(draw, across);
        let spot = outline::ellipse(at, [radius * across, radius], angle);
        easel.shine(&spot, scale(sun, level));
    }
}

/// Stretched highlights lie along the waves, round ones anyhow.
fn slant(draw: &mut Draw, across: f32) -> f32 {
    if across > 1.0 { 0.1 * draw.normal() } else { draw.angle() }
}
