//! A notice board: rows of text, line gratings, a star target, colour patches, and a few small strong lamps.

use rand::RngExt as _;

use super::canvas::{Light, Region, Rgb, Shape, scale};
use crate::core::rng::Rng;

pub(super) fn shapes(rng: &mut Rng) -> Vec<Shape> {
    let cork = Light::Noise([0.16, 0.11, 0.06], rng.random_range(50.0..110.0), 0.8, rng.random());
    let mut shapes = vec![Shape::opaque(Region::All, cork)];
    for _ in 0..9 {
        sheet(rng, &mut shapes);
    }
    patches(rng, &mut shapes);
    let spot = Light::Glow([rng.random_range(0.2..0.8), rng.random_range(0.1..0.5), 0.3], [0.12, 0.11, 0.1]);
    shapes.push(Shape::additive(Region::All, spot));
    lamps(rng, &mut shapes);
    shapes
}

fn sheet(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    let (x, y) = (rng.random_range(-0.05..0.8), rng.random_range(0.02..0.75));
    let (w, h) = (rng.random_range(0.15..0.34), rng.random_range(0.14..0.3));
    let paper: Rgb = std::array::from_fn(|_| rng.random_range(0.3..0.5));
    let ink: Rgb = std::array::from_fn(|_| rng.random_range(0.02..0.08));
    shapes.push(Shape::opaque(Region::Rectangle([x, y, x + w, y + h]), Light::Flat(paper)));
    let inner = Region::Rectangle([x + 0.015, y + 0.015, x + w - 0.015, y + h - 0.015]);
    let content = match rng.random_range(0..5) {
        0 => Light::Stripes([ink, paper], rng.random_range(25.0..90.0), rng.random_range(0.0..3.1)),
        1 => Light::Star([ink, paper], [x + w / 2.0, y + h / 2.0], rng.random_range(10.0f32..28.0).round()),
        _ => Light::Text([ink, paper], [x + 0.02, y + 0.02], rng.random_range(0.02..0.045), rng.random()),
    };
    shapes.push(Shape::opaque(inner, content));
}

fn patches(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    let (left, top) = (rng.random_range(0.05..0.5), rng.random_range(0.8..0.88));
    for k in 0..8u8 {
        let colour: Rgb = std::array::from_fn(|_| rng.random_range(0.02..0.6));
        let x = left + 0.055 * f32::from(k);
        shapes.push(Shape::opaque(Region::Rectangle([x, top, x + 0.05, top + 0.05]), Light::Flat(colour)));
    }
}

fn lamps(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    for _ in 0..rng.random_range(2..5) {
        let centre =
            [rng.random_range(0.05..0.95), rng.random_range(0.04..0.95), rng.random_range(0.005..0.012)];
        let tint: Rgb = std::array::from_fn(|_| rng.random_range(0.5..1.0));
        let light = scale(&tint, rng.random_range(500.0..1500.0));
        shapes.push(Shape::opaque(Region::Disc(centre), Light::Flat(light)));
    }
}
