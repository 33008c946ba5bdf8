//! Streets at night: facades with lit windows, lamps and their pools of light, neon, cars, a wet road.

use super::draw::Draw;
use super::easel::Easel;
use super::film::Point;
use super::lettering::{Alphabet, Type};
use super::light::{Rgb, glowing, hue, luminance, scale, tint};
use super::outline;
use super::surface::Surface;

/// A lamp and the light that it throws on what is around it.
struct Lamp {
    centre: Point,
    radius: f32,
    colour: Rgb,
}

pub(super) fn paint(easel: &mut Easel) {
    let [height, width] = easel.film.size();
    let road = height * easel.draw.uniform(0.55, 0.85);
    let lamps = lamps(easel, road);
    let top = scale(&hue(4.0, 0.5), easel.draw.log(0.003, 0.04));
    easel.prime(&Surface::plain(top).shaded([0.0, road], [0.0, 0.8 / height]));
    let mut panes = Vec::new();
    let mut left = -0.1 * width;
    while left < width {
        let right = left + width * easel.draw.log(0.1, 0.4);
        let top = height * easel.draw.uniform(-0.2, 0.4);
        facade(easel, [left, top, right, road], &mut panes);
        left = right;
    }
    let asphalt = Surface::grainy(&mut easel.draw, [0.09, 0.088, 0.085], 0.3);
    easel.paint(&outline::rectangle([-1.0, road, width + 1.0, height + 1.0]), &asphalt);
    illuminate(easel, &lamps);
    easel.expose(0.04, 0.16);
    let windows = easel.draw.log(0.5, 8.0);
    lit_windows(easel, &panes, windows);
    for _ in 0..easel.draw.count(0, 3) {
        neon(easel, road);
    }
    for lamp in &lamps {
        post(easel, lamp, road);
        easel.lamp(lamp.centre, lamp.radius, lamp.colour);
    }
    strings(easel);
    for _ in 0..easel.draw.count(0, 4) {
        car(easel, road);
    }
    if easel.draw.chance(0.6) {
        wet(easel, road);
    }
}

/// Lamps 1 to 30 pixels wide at 10 to 10⁵.
fn lamps(easel: &mut Easel, road: f32) -> Vec<Lamp> {
    let [_, width] = easel.film.size();
    let kelvin = easel.draw.log(1900.0, 6000.0);
    let largest = (0.06 * easel.side()).clamp(0.6, 15.0);
    (0..easel.draw.count(1, 8))
        .map(|_| {
            let draw = &mut easel.draw;
            let colour = glowing(kelvin * draw.log(0.85, 1.2), 3800.0);
            let radius = draw.log(0.5, largest);
            // Large lamps are seldom the brightest ones.
            let level = draw.log(10.0, 1e5 / radius.max(1.0));
            let centre = [draw.uniform(0.02, 0.98) * width, draw.uniform(0.05, 0.8) * road];
            Lamp { centre, radius, colour: scale(&colour, level) }
        })
        .collect()
}

fn facade(easel: &mut Easel, [left, top, right, bottom]: [f32; 4], panes: &mut Vec<[f32; 4]>) {
    let draw = &mut easel.draw;
    let colour = scale(&hue(draw.uniform(0.0, 1.5), draw.uniform(0.0, 0.5)), draw.log(0.06, 0.4));
    let grain = draw.log(0.08, 0.35);
    let wall = Surface::grainy(draw, colour, grain);
    easel.paint(&outline::rectangle([left, top, right, bottom]), &wall);
    if easel.draw.chance(0.6) {
        // Courses of brick or stone.
        let pitch = easel.draw.log(3.0, 14.0);
        let mut y = top + pitch;
        while y < bottom {
            easel.shine(&outline::rectangle([left, y, right, y + 0.18 * pitch]), scale(&colour, 0.5));
            y += pitch;
        }
    }
    let pitch = [easel.draw.log(10.0, 48.0), easel.draw.log(12.0, 56.0)];
    let dark = scale(&[0.8, 0.9, 1.1], 0.02);
    grid([left, top, right, bottom], pitch, |pane| {
        let sill = [pane[0] - 1.0, pane[3], pane[2] + 1.0, pane[3] + 1.0];
        easel.shine(&outline::rectangle(sill), scale(&colour, 1.4));
        easel.shine(&outline::rectangle(pane), dark);
        panes.push(pane);
    });
}

/// Calls for each pane of a wall that is divided with the given pitches.
fn grid([left, top, right, bottom]: [f32; 4], [across, down]: [f32; 2], mut pane: impl FnMut([f32; 4])) {
    let mut y = top + 0.4 * down;
    while y + 0.6 * down < bottom {
        let mut x = left + 0.3 * across;
        while x + 0.5 * across < right {
            pane([x, y, x + 0.5 * across, y + 0.6 * down]);
            x += across;
        }
        y += down;
    }
}

/// Multiplies what is painted by the light of the sky and of all lamps.
fn illuminate(easel: &mut Easel, lamps: &[Lamp]) {
    let sky = scale(&hue(4.0, 0.4), easel.draw.log(0.02, 0.2));
    let reach = 0.25 * easel.side();
    easel.film.all(|[x, y], sample| {
        let mut light = sky;
        for lamp in lamps {
            // Lamps shine downwards, so that their pools lie below them.
            let (dx, dy) = ((x - lamp.centre[0]) / reach, (y - lamp.centre[1]) / reach - 0.4);
            let share = (1.0 + 2.0 * dx * dx + dy * dy).powi(-2) / luminance(&lamp.colour);
            (0..light.len()).for_each(|c| light[c] += share * lamp.colour[c]);
        }
        *sample = tint(sample, &light);
    });
}

/// Windows with somebody at home: curtains, blinds and lamps behind them.
fn lit_windows(easel: &mut Easel, panes: &[[f32; 4]], level: f32) {
    let share = easel.draw.uniform(0.05, 0.45);
    for &pane in panes {
        let draw = &mut easel.draw;
        if !draw.chance(share) {
            continue;
        }
        let colour = scale(&glowing(draw.log(2400.0, 4500.0), 3800.0), level * draw.log(0.3, 3.0));
        let centre = [draw.uniform(pane[0], pane[2]), draw.uniform(pane[1], pane[3])];
        let surface = match draw.count(0, 2) {
            0 => Surface::patterned([colour, scale(&colour, 0.4)], 0, draw.log(2.0, 6.0), 1.571),
            1 => Surface::patterned([colour, scale(&colour, 0.6)], 1, draw.log(3.0, 8.0), 0.0),
            _ => Surface::grainy(draw, colour, 0.5),
        };
        easel.paint(&outline::rectangle(pane), &surface.shaded(centre, [0.0, -0.8 / (pane[3] - pane[1])]));
        if pane[2] - pane[0] > 6.0 {
            let bar = (pane[0] + pane[2]) / 2.0;
            easel.shine(&outline::rectangle([bar - 0.5, pane[1], bar + 0.5, pane[3]]), [0.03; 3]);
        }
    }
}

/// A word in bright tubes.
fn neon(easel: &mut Easel, road: f32) {
    let [_, width] = easel.film.size();
    let alphabet = Alphabet::new(&mut easel.draw);
    let height = easel.side() * easel.draw.log(0.04, 0.16);
    let level = easel.draw.log(3.0, 200.0);
    let ink = scale(&hue(easel.draw.angle(), easel.draw.uniform(0.5, 1.0)), level);
    let at = [easel.draw.uniform(-0.1, 0.8) * width, easel.draw.uniform(0.1, 0.85) * road];
    let length = height * easel.draw.uniform(2.0, 7.0);
    let middle = [at[0] + 0.5 * length, at[1] + 0.5 * height];
    easel.glow(middle, length, scale(&ink, 0.02 / level.sqrt()));
    let style = Type { height, weight: (0.08 * height).max(0.7), angle: 0.03 * easel.draw.normal(), ink };
    alphabet.write(easel, at, length, style);
}

fn post(easel: &mut Easel, lamp: &Lamp, road: f32) {
    if easel.draw.chance(0.6) {
        let width = (0.3 * lamp.radius).max(0.8);
        let foot = [lamp.centre[0], road + 4.0];
        easel.shine(&outline::stroke(lamp.centre, foot, [width, 2.0 * width]), [0.01; 3]);
    }
}

/// Strings of many small lamps.
fn strings(easel: &mut Easel) {
    for _ in 0..easel.draw.count(0, 2) {
        let size = easel.film.size();
        let (from, to) = (easel.draw.point(size, 10.0), easel.draw.point(size, 10.0));
        let sag = easel.draw.uniform(0.0, 0.2) * size[0];
        let (radius, level) = (easel.draw.log(0.4, 1.5), easel.draw.log(5.0, 3e3));
        let count = easel.draw.count(8, 40);
        for i in 0..count {
            let t = i as f32 / count as f32;
            let x = from[0] + t * (to[0] - from[0]);
            let y = from[1] + t * (to[1] - from[1]) + sag * 4.0 * t * (1.0 - t);
            let colour = hue(easel.draw.angle(), easel.draw.uniform(0.0, 0.8));
            let colour = scale(&colour, level * easel.draw.log(0.5, 1.5));
            easel.lamp([x, y], radius, colour);
        }
    }
}

/// A car's body with two head or tail lights.
fn car(easel: &mut Easel, road: f32) {
    let [height, width] = easel.film.size();
    let draw = &mut easel.draw;
    let at: Point = [draw.uniform(0.0, width), draw.uniform(road, 0.5 * (road + height))];
    let size = (0.04 + 0.12 * (at[1] - road) / height) * height.min(width);
    let body: Rgb = scale(&hue(draw.angle(), 0.5), draw.log(0.01, 0.1));
    let is_front = draw.chance(0.6);
    let colour = if is_front { glowing(draw.log(3200.0, 6000.0), 3800.0) } else { hue(0.0, 1.0) };
    let level = if is_front { draw.log(50.0, 3e4) } else { draw.log(4.0, 100.0) };
    let outline = outline::ellipse([at[0], at[1] - 0.2 * size], [1.1 * size, 0.6 * size], 0.0);
    easel.shine(&outline, body);
    for side in [-0.75, 0.75] {
        let radius = (0.13 * size).max(0.6);
        easel.lamp([at[0] + side * size, at[1]], radius, scale(&colour, level));
    }
}

/// What is above the road, mirrored in water: stretched, broken up and dimmer.
fn wet(easel: &mut Easel, road: f32) {
    let [height, width] = easel.film.size();
    let [rows, columns] = easel.film.grid();
    let (strength, ripple) = (easel.draw.log(0.02, 0.3), draw_ripple(&mut easel.draw));
    let samples = easel.film.samples.clone();
    let fine = (rows as f32 / height.max(1.0), columns as f32 / width.max(1.0));
    let grain = &easel.grain;
    easel.film.within([0.0, road, width, height], |[x, y], sample| {
        let (wave, puddle) = (grain.at(0.15 * x, 1.1 * y), grain.at(0.05 * x + 90.0, 0.2 * y));
        let mirrored = 2.0 * road - y - ripple * (y - road).max(2.0) * wave.abs();
        let row = index(mirrored * fine.0, rows);
        let column = index((x + 0.5 * ripple * wave) * fine.1, columns);
        let share = strength * (0.6 * puddle).exp();
        let seen = samples[row * columns + column];
        // A rough mirror spreads the light of lamps over more than their size.
        (0..sample.len()).for_each(|c| sample[c] += share * seen[c].min(300.0));
    });
}

fn draw_ripple(draw: &mut Draw) -> f32 {
    draw.uniform(0.2, 1.4)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the film")]
fn index(at: f32, count: usize) -> usize {
    (at.max(0.0) as usize).min(count - 1)
}
