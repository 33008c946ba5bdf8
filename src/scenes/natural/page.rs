//! Pages of text, line patterns and test targets, lying over each other on a desk.

use super::easel::Easel;
use super::film::Point;
use super::leaves::daylight;
use super::lettering::{Alphabet, Type};
use super::light::{Rgb, blend, hue, reflectance, scale, tint};
use super::outline;
use super::surface::Surface;

/// A sheet of paper: its centre, half sides, direction and colours.
struct Sheet {
    centre: Point,
    half: Point,
    angle: f32,
    paper: Rgb,
    ink: Rgb,
}

impl Sheet {
    /// A place on the sheet by its coordinates from the left top corner.
    fn at(&self, [x, y]: Point) -> Point {
        let (sin, cos) = self.angle.sin_cos();
        let (x, y) = (x - self.half[0], y - self.half[1]);
        [self.centre[0] + cos * x - sin * y, self.centre[1] + sin * x + cos * y]
    }
}

pub(super) fn paint(easel: &mut Easel) {
    let light = daylight(&mut easel.draw);
    let colour = tint(&reflectance(&mut easel.draw), &light);
    let desk = Surface::grainy(&mut easel.draw, colour, 0.3);
    easel.prime(&desk);
    for _ in 0..easel.draw.count(3, 12) {
        let sheet = sheet(easel, &light);
        easel.shadow(sheet.centre, sheet.half[0].max(sheet.half[1]), 0.4);
        let outline = outline::turned_rectangle(sheet.centre, sheet.half, sheet.angle);
        let paper = Surface::grainy(&mut easel.draw, sheet.paper, 0.03);
        easel.paint(&outline, &paper);
        match easel.draw.count(0, 7) {
            0 => lines(easel, &sheet),
            1 => star(easel, &sheet),
            2 => pattern(easel, &sheet),
            _ => text(easel, &sheet),
        }
    }
    uneven_light(easel);
    easel.expose(0.08, 0.5);
}

fn sheet(easel: &mut Easel, light: &Rgb) -> Sheet {
    let side = easel.side();
    let size = easel.film.size();
    let draw = &mut easel.draw;
    let is_dark = draw.chance(0.25);
    let pale: Rgb = scale(&hue(draw.angle(), 0.3 * draw.uniform(0.0, 1.0).powi(2)), draw.uniform(0.5, 0.85));
    let dark: Rgb = scale(&hue(draw.angle(), draw.uniform(0.0, 0.6)), draw.log(0.02, 0.1));
    let (paper, ink) = if is_dark { (dark, pale) } else { (pale, dark) };
    Sheet {
        centre: draw.point(size, 0.0),
        half: [side * draw.log(0.12, 0.5), side * draw.log(0.12, 0.5)],
        angle: 0.25 * draw.normal(),
        paper: tint(&paper, light),
        ink: tint(&ink, light),
    }
}

fn text(easel: &mut Easel, sheet: &Sheet) {
    let alphabet = Alphabet::new(&mut easel.draw);
    let body = easel.draw.log(5.0, 0.06 * easel.side().max(150.0));
    let heavy = easel.draw.uniform(0.09, 0.2);
    let [width, height] = sheet.half.map(|half| 2.0 * half);
    let margin = 0.06 * width;
    let mut y = margin;
    while y + body < height - margin {
        let is_title = easel.draw.chance(0.07);
        let size = if is_title { 1.9 * body } else { body };
        let short = if easel.draw.chance(0.2) { easel.draw.uniform(0.3, 0.9) } else { 1.0 };
        let style =
            Type { height: size, weight: (heavy * size).max(0.6), angle: sheet.angle, ink: sheet.ink };
        if y + size < height - margin {
            alphabet.write(easel, sheet.at([margin, y]), (width - 2.0 * margin) * short, style);
        }
        y += size * if easel.draw.chance(0.08) { 2.8 } else { 1.65 };
    }
}

/// Groups of lines, finer from group to group.
fn lines(easel: &mut Easel, sheet: &Sheet) {
    let [width, height] = sheet.half.map(|half| 2.0 * half);
    let mut period = easel.draw.log(6.0, 24.0);
    let mut y = 0.05 * height;
    let row = 0.12 * height;
    while y + row < 0.95 * height {
        let share = easel.draw.uniform(0.35, 0.6);
        let mut x = 0.06 * width;
        while x < 0.94 * width {
            let stroke = outline::stroke(sheet.at([x, y]), sheet.at([x, y + row]), [share * period; 2]);
            easel.shine(&stroke, sheet.ink);
            x += period;
        }
        period = (0.8 * period).max(2.0);
        y += 1.25 * row;
    }
}

/// A star of sectors that meet in its centre.
fn star(easel: &mut Easel, sheet: &Sheet) {
    let spokes = easel.draw.count(9, 36);
    let radius = 0.85 * sheet.half[0].min(sheet.half[1]);
    for spoke in 0..spokes {
        let corner = |part: f32| {
            let angle = std::f32::consts::TAU * (spoke as f32 + part) / spokes as f32 + sheet.angle;
            [sheet.centre[0] + radius * angle.cos(), sheet.centre[1] + radius * angle.sin()]
        };
        easel.shine(&[sheet.centre, corner(0.0), corner(0.25), corner(0.5)], sheet.ink);
    }
}

fn pattern(easel: &mut Easel, sheet: &Sheet) {
    let half = sheet.half.map(|half| 0.88 * half);
    let area = outline::turned_rectangle(sheet.centre, half, sheet.angle);
    let (kind, period) = (easel.draw.count(0, 3), easel.draw.log(2.2, 40.0));
    let second = blend(&sheet.paper, &sheet.ink, easel.draw.uniform(0.2, 1.0));
    let angle = sheet.angle + if easel.draw.chance(0.5) { easel.draw.angle() } else { 0.0 };
    easel.paint(&area, &Surface::patterned([sheet.paper, second], kind, period, angle));
}

/// A desk lamp or a window lights one side more.
fn uneven_light(easel: &mut Easel) {
    let size = easel.film.size();
    let bright = easel.draw.point(size, 0.3 * size[0]);
    let (reach, least) = (size[0].max(size[1]) * easel.draw.uniform(0.3, 1.0), easel.draw.uniform(0.1, 0.6));
    easel.film.all(|[x, y], sample| {
        let distance = ((x - bright[0]).powi(2) + (y - bright[1]).powi(2)) / (reach * reach);
        let light = least + (1.0 - least) / (1.0 + distance);
        *sample = sample.map(|value| value * light);
    });
}
