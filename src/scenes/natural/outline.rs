//! Closed outlines of things, in pixels.

use super::draw::Draw;
use super::film::Point;

/// Corners of a round outline of the given radius: no corner shows.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before the cast")]
fn corners(radius: f32) -> usize {
    (8.0 + 1.5 * radius.max(0.0)).min(72.0) as usize
}

/// A closed curve around a centre, by its radius in each direction.
fn around(centre: Point, count: usize, radius: impl Fn(f32) -> f32) -> Vec<Point> {
    (0..count)
        .map(|i| {
            let angle = std::f32::consts::TAU * i as f32 / count as f32;
            let radius = radius(angle);
            [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
        })
        .collect()
}

/// Turns points around the origin, and moves them to a place.
fn placed(points: impl IntoIterator<Item = Point>, at: Point, angle: f32) -> Vec<Point> {
    let (sin, cos) = angle.sin_cos();
    let place = |[x, y]: Point| [at[0] + cos * x - sin * y, at[1] + sin * x + cos * y];
    points.into_iter().map(place).collect()
}

pub(super) fn disc(centre: Point, radius: f32) -> Vec<Point> {
    around(centre, corners(radius), |_| radius)
}

pub(super) fn ellipse(centre: Point, [a, b]: [f32; 2], angle: f32) -> Vec<Point> {
    let circle = around([0.0; 2], corners(a.max(b)), |_| 1.0);
    placed(circle.into_iter().map(|[x, y]| [a * x, b * y]), centre, angle)
}

/// A round thing with bulges.
pub(super) fn blob(draw: &mut Draw, centre: Point, radius: f32) -> Vec<Point> {
    let waves: [[f32; 2]; 4] = std::array::from_fn(|k| [0.28 * draw.normal() / (k + 1) as f32, draw.angle()]);
    around(centre, 2 * corners(radius), |angle| {
        let bulge: f32 =
            waves.iter().zip(2u8..).map(|([a, phase], k)| a * (f32::from(k) * angle + phase).sin()).sum();
        radius * (1.0 + bulge).max(0.15)
    })
}

/// A convex or slightly hollow thing with straight edges.
pub(super) fn polygon(draw: &mut Draw, centre: Point, radius: f32) -> Vec<Point> {
    let count = draw.count(3, 7);
    let start = draw.angle();
    let mut points = around([0.0; 2], count, |_| 1.0);
    for point in &mut points {
        let radius = radius * draw.uniform(0.65, 1.25);
        *point = point.map(|value| value * radius);
    }
    placed(points, centre, start)
}

/// A rectangle `[left, top, right, bottom]`.
pub(super) fn rectangle([left, top, right, bottom]: [f32; 4]) -> Vec<Point> {
    vec![[left, top], [right, top], [right, bottom], [left, bottom]]
}

/// A rectangle of half sides around a centre, turned.
pub(super) fn turned_rectangle(centre: Point, [a, b]: [f32; 2], angle: f32) -> Vec<Point> {
    placed(rectangle([-a, -b, a, b]), centre, angle)
}

/// A straight stroke that grows from one width to another.
pub(super) fn stroke(from: Point, to: Point, [first, last]: [f32; 2]) -> Vec<Point> {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length = dx.hypot(dy).max(1e-6);
    let (nx, ny) = (-dy / length / 2.0, dx / length / 2.0);
    let side = |[x, y]: Point, width: f32| [x + nx * width, y + ny * width];
    vec![side(from, first), side(to, last), side(to, -last), side(from, -first)]
}

/// The two halves of a pointed leaf along its midrib, from the base to the tip.
pub(super) fn leaf(base: Point, length: f32, width: f32, angle: f32) -> [Vec<Point>; 2] {
    let steps = (4.0 + length / 3.0).min(12.0).round();
    [1.0, -1.0].map(|side| {
        let rim = (0..=20u8).map(f32::from).take_while(|i| *i <= steps).map(|i| {
            let t = i / steps;
            // Widest before the middle, pointed at the tip.
            let shape = (std::f32::consts::PI * t.powf(0.8)).sin().max(0.0) * (1.0 - 0.35 * t);
            [length * t, side * 0.5 * width * shape]
        });
        placed(rim, base, angle)
    })
}

/// The area below a ragged line: heights at even distances over a width, down to a bottom.
pub(super) fn skyline(heights: &[f32], width: f32, bottom: f32) -> Vec<Point> {
    let last = (heights.len() - 1).max(1) as f32;
    let ridge = heights.iter().enumerate().map(|(i, y)| [-1.0 + (width + 2.0) * i as f32 / last, *y]);
    ridge.chain([[width + 1.0, bottom], [-1.0, bottom]]).collect()
}
