//! Things that may stand in front of any scene: signs, wires, branches, glints, lamps.

use super::easel::Easel;
use super::glints::{share_of_pixels, sprinkle};
use super::lettering::{Alphabet, Type};
use super::light::{glowing, hue, scale};
use super::outline;
use super::sky::branch;

/// Adds some of them, or none.
pub(super) fn add(easel: &mut Easel) {
    if easel.draw.chance(0.15) {
        sign(easel);
    }
    if easel.draw.chance(0.15) {
        wires(easel);
    }
    if easel.draw.chance(0.08) {
        twigs(easel);
    }
    if easel.draw.chance(0.12) {
        let count = share_of_pixels(easel, 2e-5, 4e-4);
        let brightest = easel.draw.log(10.0, 3e3);
        sprinkle(easel, count, (brightest, 1.0), &[1.0, 0.97, 0.92]);
    }
    if easel.draw.chance(0.2) {
        lamps(easel);
    }
}

/// A board with one to four lines.
fn sign(easel: &mut Easel) {
    let size = easel.film.size();
    let median = easel.film.median();
    let alphabet = Alphabet::new(&mut easel.draw);
    let [x, y] = easel.draw.point(size, 0.0);
    let (height, lines) = (easel.draw.log(5.0, 0.12 * easel.side().max(60.0)), easel.draw.count(1, 4));
    let (length, angle) = (height * easel.draw.uniform(3.0, 9.0), 0.08 * easel.draw.normal());
    let levels = if easel.draw.chance(0.5) { [0.3, 3.0] } else { [3.0, 0.3] };
    let [board, ink] = levels.map(|level| {
        let colour = hue(easel.draw.angle(), easel.draw.uniform(0.0, 0.8));
        scale(&colour, median * level)
    });
    let (sin, cos) = f32::sin_cos(angle);
    let pitch = 1.6 * height;
    let half = [0.5 * length + 0.5 * height, 0.5 * pitch * lines as f32 + 0.3 * height];
    easel.shine(&outline::turned_rectangle([x, y], half, angle), board);
    for line in 0..lines {
        let (u, v) = (-0.5 * length, pitch * (line as f32 - 0.5 * lines as f32) + 0.3 * height);
        let at = [x + cos * u - sin * v, y + sin * u + cos * v];
        alphabet.write(easel, at, length, Type { height, weight: 0.13 * height, angle, ink });
    }
}

/// Dark or shining wires across the image.
fn wires(easel: &mut Easel) {
    let [height, width] = easel.film.size();
    let median = easel.film.median();
    let colour = [median * easel.draw.log(0.05, 4.0); 3];
    let (left, right) = (easel.draw.uniform(-0.2, 1.0) * height, easel.draw.uniform(-0.2, 1.0) * height);
    let (thick, gap) = (easel.draw.log(0.4, 2.5), easel.draw.log(4.0, 40.0));
    let sag = easel.draw.uniform(0.0, 0.1) * width;
    for wire in 0..easel.draw.count(1, 5) {
        let at = |i: u8| {
            let t = f32::from(i) / 24.0;
            let y = left + t * (right - left) + 4.0 * sag * t * (1.0 - t) + gap * wire as f32;
            [t * width, y]
        };
        (0..24).for_each(|i| easel.shine(&outline::stroke(at(i), at(i + 1), [thick; 2]), colour));
    }
}

fn twigs(easel: &mut Easel) {
    let [height, width] = easel.film.size();
    let median = easel.film.median();
    let foot = [easel.draw.uniform(0.0, width), if easel.draw.chance(0.5) { 0.0 } else { height }];
    let towards = (0.5 * height - foot[1]).atan2(0.5 * width - foot[0]);
    let length = 0.22 * height * easel.draw.uniform(0.6, 1.3);
    let bark = scale(&[1.1, 0.95, 0.8], median * easel.draw.log(0.1, 0.6));
    branch(easel, foot, (length, towards, 0.07 * length), bark);
}

/// Lamps that hang in front of the scene.
fn lamps(easel: &mut Easel) {
    let size = easel.film.size();
    let largest = (0.04 * easel.side()).clamp(0.6, 15.0);
    for _ in 0..easel.draw.count(1, 4) {
        let radius = easel.draw.log(0.5, largest);
        let colour = glowing(easel.draw.log(2200.0, 8000.0), 5000.0);
        let level = easel.draw.log(16.0, 1e5);
        let centre = easel.draw.point(size, 0.0);
        easel.lamp(centre, radius, scale(&colour, level));
    }
}
