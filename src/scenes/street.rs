//! A street at night: sky, two rows of facades with lit windows, a wet road, street lamps, head lights.

use rand::RngExt as _;

use super::canvas::{Light, Region, Rgb, Shape, scale};
use crate::core::rng::Rng;

/// Sodium, warm white and cold white lamps, as relative radiance.
const LAMP_COLOURS: [Rgb; 3] = [[1.0, 0.62, 0.25], [1.0, 0.85, 0.6], [0.8, 0.95, 1.0]];

/// Height of the road's edge.
const HORIZON: f32 = 0.62;

pub(super) fn shapes(rng: &mut Rng) -> Vec<Shape> {
    let night: Rgb = [0.02, 0.03, 0.06];
    let dusk: Rgb = [0.10, 0.08, 0.10];
    let mut shapes = vec![Shape::opaque(Region::All, Light::Vertical([0.0, HORIZON], [night, dusk]))];
    facades(rng, &mut shapes);
    road(rng, &mut shapes);
    lamps(rng, &mut shapes);
    head_lights(rng, &mut shapes);
    shapes
}

fn facades(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    let mut left = -0.05;
    while left < 1.0 {
        let width = rng.random_range(0.14..0.3);
        let top = rng.random_range(0.08..0.42);
        let wall = [0.09, 0.075, 0.065].map(|value: f32| value * rng.random_range(0.6..1.6));
        let bricks = Light::Noise(wall, rng.random_range(40.0..120.0), 0.7, rng.random());
        shapes.push(Shape::opaque(Region::Rectangle([left, top, left + width, HORIZON]), bricks));
        windows(rng, shapes, [left, top, left + width]);
        left += width;
    }
}

fn windows(rng: &mut Rng, shapes: &mut Vec<Shape>, [left, top, right]: [f32; 3]) {
    let pitch = rng.random_range(0.035..0.06);
    let mut y = top + 0.4 * pitch;
    while y + 0.7 * pitch < HORIZON {
        let mut x = left + 0.3 * pitch;
        while x + 0.6 * pitch < right {
            let pane = Region::Rectangle([x, y, x + 0.55 * pitch, y + 0.65 * pitch]);
            let light = if rng.random_bool(0.35) {
                let warmth = rng.random_range(0.45..0.9);
                scale(&[1.0, warmth, warmth * warmth], rng.random_range(0.8..9.0))
            } else {
                [0.02, 0.025, 0.035]
            };
            shapes.push(Shape::opaque(pane, Light::Flat(light)));
            x += pitch;
        }
        y += pitch;
    }
}

fn road(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    let asphalt = Light::Noise([0.07, 0.07, 0.075], rng.random_range(30.0..90.0), 0.9, rng.random());
    shapes.push(Shape::opaque(Region::Rectangle([0.0, HORIZON, 1.0, 1.0]), asphalt));
    let vanishing = rng.random_range(0.35..0.65);
    for k in 0..5u8 {
        // The far end of a dash of the centre line and its near end, in perspective.
        let (far, near) = (0.05 + 0.2 * f32::from(k), 0.15 + 0.2 * f32::from(k));
        let edge = |depth: f32, side: f32| {
            [vanishing + (side * 0.03 + (0.5 - vanishing) * 0.4) * depth, HORIZON + (1.0 - HORIZON) * depth]
        };
        let dash = Region::Polygon(vec![edge(far, -1.0), edge(far, 1.0), edge(near, 1.0), edge(near, -1.0)]);
        shapes.push(Shape::opaque(dash, Light::Flat([0.35, 0.35, 0.32])));
    }
}

fn lamps(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    for _ in 0..rng.random_range(2..5) {
        let (x, y) = (rng.random_range(0.08..0.92), rng.random_range(0.12..0.45));
        let radius = rng.random_range(0.006..0.013);
        let colour = LAMP_COLOURS[rng.random_range(0..LAMP_COLOURS.len())];
        let peak = rng.random_range(150.0..900.0);
        let pole = Region::Rectangle([x - 0.003, y, x + 0.003, HORIZON + 0.04]);
        shapes.push(Shape::opaque(pole, Light::Flat([0.02; 3])));
        let pool = Light::Glow([x, HORIZON + 0.06, 0.08], scale(&colour, 0.5));
        shapes.push(Shape::additive(Region::Rectangle([0.0, HORIZON, 1.0, 1.0]), pool));
        shapes.push(Shape::opaque(Region::Disc([x, y, radius]), Light::Flat(scale(&colour, peak))));
    }
}

fn head_lights(rng: &mut Rng, shapes: &mut Vec<Shape>) {
    for _ in 0..rng.random_range(1..3) {
        let (x, y) = (rng.random_range(0.15..0.8), rng.random_range(0.66..0.85));
        let size = 0.02 + 0.1 * (y - HORIZON);
        let body = Region::Rectangle([x - 0.4 * size, y - 1.2 * size, x + 3.4 * size, y + 0.6 * size]);
        shapes.push(Shape::opaque(body, Light::Flat([0.03, 0.03, 0.05])));
        for side in [0.0, 3.0] {
            let centre = [x + side * size, y, 0.25 * size];
            let peak = rng.random_range(120.0..500.0);
            shapes.push(Shape::opaque(Region::Disc(centre), Light::Flat([peak, peak, 0.9 * peak])));
            let streak =
                Region::Rectangle([centre[0] - 0.2 * size, y + 0.6 * size, centre[0] + 0.2 * size, 1.0]);
            let reflection = Light::Vertical([y, y + 0.25], [[1.2, 1.2, 1.0], [0.0; 3]]);
            shapes.push(Shape::additive(streak, reflection));
        }
    }
}
