//! A room seen against the light: papered walls, furniture, pictures, a lamp, and a window onto a bright day.

use rand::RngExt as _;

use super::canvas::{Light, Region, Rgb, Shape, scale};
use crate::core::rng::Rng;

/// Height at which the wall meets the floor.
const FLOOR: f32 = 0.78;

pub(super) fn shapes(rng: &mut Rng) -> Vec<Shape> {
    let wall = pastel(rng, 0.12);
    let mut shapes = vec![
        Shape::opaque(Region::All, Light::Vertical([0.0, FLOOR], [scale(&wall, 0.7), wall])),
        Shape::opaque(
            Region::Rectangle([0.0, FLOOR, 1.0, 1.0]),
            Light::Stripes([[0.10, 0.06, 0.035], [0.07, 0.04, 0.025]], rng.random_range(9.0..20.0), 1.2),
        ),
    ];
    pictures(rng, &mut shapes);
    let window = window(rng, &mut shapes);
    furniture(rng, &mut shapes);
    lamp(rng, &mut shapes);
    // The window lights the room around it.
    let daylight = Light::Glow([window[0], window[1], 0.45], [0.10, 0.12, 0.15]);
    shapes.push(Shape::additive(Region::All, daylight));
    shapes
}

fn pastel(rng: &mut Rng, level: f32) -> Rgb {
    std::array::from_fn(|_| level * rng.random_range(0.7..1.4))
}

fn pictures(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    for _ in 0..rng.random_range(2..5) {
        let (x, y) = (rng.random_range(0.02..0.8), rng.random_range(0.08..0.45));
        let (w, h) = (rng.random_range(0.08..0.18), rng.random_range(0.08..0.18));
        let frame = Region::Rectangle([x, y, x + w, y + h]);
        shapes.push(Shape::opaque(frame, Light::Flat([0.03, 0.02, 0.015])));
        let canvas = Region::Rectangle([x + 0.012, y + 0.012, x + w - 0.012, y + h - 0.012]);
        let picture = match rng.random_range(0..3) {
            0 => Light::Noise(pastel(rng, 0.3), rng.random_range(20.0..60.0), 1.6, rng.random()),
            1 => Light::Star([pastel(rng, 0.4), pastel(rng, 0.08)], [x + w / 2.0, y + h / 2.0], 9.0),
            _ => Light::Checker([pastel(rng, 0.35), pastel(rng, 0.05)], rng.random_range(30.0..70.0)),
        };
        shapes.push(Shape::opaque(canvas, picture));
    }
}

/// Paints the window and returns its centre.
fn window(rng: &mut Rng, shapes: &mut Vec<Shape>) -> [f32; 2] {
    let (left, top) = (rng.random_range(0.15..0.5), rng.random_range(0.08..0.2));
    let (right, bottom) = (left + rng.random_range(0.28..0.42), top + rng.random_range(0.34..0.46));
    let outside = |x0, y0, x1, y1| Region::Rectangle([x0, y0, x1, y1]);
    let day = rng.random_range(12.0..50.0);
    let sky: [Rgb; 2] = [scale(&[0.55, 0.75, 1.0], day), scale(&[0.95, 0.97, 1.0], day)];
    shapes.push(Shape::opaque(outside(left, top, right, bottom), Light::Vertical([top, bottom], sky)));
    let sun = [rng.random_range(left + 0.05..right - 0.05), top + 0.06, rng.random_range(0.012..0.02)];
    let glare = rng.random_range(600.0..3000.0);
    shapes.push(Shape::opaque(Region::Disc(sun), Light::Flat([glare, 0.95 * glare, 0.85 * glare])));
    let hills = scale(&[0.25, 0.4, 0.15], day * 0.6);
    let hedge = Light::Noise(hills, rng.random_range(40.0..90.0), 1.2, rng.random());
    shapes.push(Shape::opaque(outside(left, bottom - 0.12, right, bottom), hedge));
    let bar = Light::Flat([0.06, 0.055, 0.05]);
    let middle = [(left + right) / 2.0, (top + bottom) / 2.0];
    for region in [
        outside(middle[0] - 0.008, top, middle[0] + 0.008, bottom),
        outside(left, middle[1] - 0.006, right, middle[1] + 0.006),
        outside(left - 0.015, top, left, bottom),
        outside(right, top, right + 0.015, bottom),
        outside(left - 0.015, top - 0.015, right + 0.015, top),
        outside(left - 0.025, bottom, right + 0.025, bottom + 0.02),
    ] {
        shapes.push(Shape::opaque(region, bar.clone()));
    }
    middle
}

fn furniture(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    for _ in 0..3 {
        let (x, width) = (rng.random_range(0.0..0.8), rng.random_range(0.12..0.3));
        let (top, bottom) = (rng.random_range(0.6..0.74), rng.random_range(0.84..0.97));
        let wood: Rgb = scale(&[1.0, 0.6, 0.35], rng.random_range(0.03..0.15));
        let grain = Light::Stripes([wood, scale(&wood, 0.75)], rng.random_range(40.0..90.0), 1.5);
        shapes.push(Shape::opaque(Region::Rectangle([x, top, x + width, bottom]), grain));
        let label = Region::Rectangle([x + 0.02, top + 0.03, x + width - 0.02, top + 0.07]);
        let text = Light::Text([[0.02; 3], [0.28; 3]], [x + 0.025, top + 0.037], 0.026, rng.random());
        shapes.push(Shape::opaque(label, text));
    }
}

fn lamp(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    let (x, y) = (rng.random_range(0.08..0.92), rng.random_range(0.5..0.62));
    let shade =
        vec![[x - 0.03, y - 0.05], [x + 0.03, y - 0.05], [x + 0.055, y + 0.03], [x - 0.055, y + 0.03]];
    shapes.push(Shape::opaque(Region::Polygon(shade), Light::Flat([3.5, 2.4, 1.2])));
    shapes.push(Shape::opaque(Region::Disc([x, y + 0.03, 0.011]), Light::Flat([260.0, 200.0, 120.0])));
    shapes.push(Shape::additive(Region::All, Light::Glow([x, y, 0.12], [0.5, 0.32, 0.14])));
}
