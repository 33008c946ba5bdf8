//! Surfaces without outlines: stone, plaster, cloth, clouds. Noise with the spectrum of natural images, of log-normal light.

use super::easel::Easel;
use super::film::Point;
use super::leaves::daylight;
use super::light::Palette;

/// Side of the tile of noise in cells.
const TILE: f32 = 256.0;

pub(super) fn paint(easel: &mut Easel) {
    let light = daylight(&mut easel.draw);
    let palette = Palette::new(&mut easel.draw, 1, &light);
    let colour = palette.draw(&mut easel.draw);
    let draw = &mut easel.draw;
    let contrast = draw.log(0.25, 1.1);
    let (cell, period) = (draw.log(0.5, 3.0), draw.log(60.0, 400.0));
    // The part of the variance that the colours have in common.
    let common = if draw.chance(0.4) { 1.0 } else { draw.uniform(0.0, 1.0) };
    let places: [Point; 4] = std::array::from_fn(|_| draw.point([TILE, TILE], 0.0));
    let grain = &easel.grain;
    easel.film.all(|[x, y], sample| {
        let level = |[u, v]: Point| grain.deep(x / cell + u, y / cell + v, period / cell);
        let shared = common.sqrt() * level(places[3]);
        for (c, sample) in sample.iter_mut().enumerate() {
            let noise = shared + (1.0 - common).sqrt() * level(places[c]);
            *sample = colour[c] * (contrast * noise).exp();
        }
    });
    easel.expose(0.05, 0.4);
}
