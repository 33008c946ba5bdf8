//! Foliage against a bright sky: layers of twigs with small leaves, and gaps that the sky and the sun shine through.

use std::f32::consts::TAU;

use super::blur::defocus;
use super::draw::Draw;
use super::easel::Easel;
use super::film::Point;
use super::light::{Rgb, blend, hue, scale};
use super::outline;
use super::sky::{Sun, branch, heavens};
use super::surface::Surface;

/// Irradiance of a leaf in the shade, in units of which the exposure makes mid-tones.
const SHADE: f32 = 0.1;

/// The leaves of a tree.
struct Leaf {
    length: f32,
    /// Width over length: 0.05 for needles and grass, 0.6 for lime trees.
    aspect: f32,
    hue: f32,
    saturation: f32,
    /// Share of leaves that the sun shines on or through.
    sunlit: f32,
}

pub(super) fn paint(easel: &mut Easel) {
    let [height, width] = easel.film.size();
    let level = SHADE * easel.draw.log(4.0, 60.0);
    // Where the sky clips, there is less of it.
    let gaps = easel.draw.log(0.02, if level > 2.0 { 0.10 } else { 0.3 });
    let sun = easel.draw.chance(0.45).then(|| Sun::draw(&mut easel.draw, [height, width]));
    heavens(easel, level, height, sun);
    let layers = easel.draw.count(2, 4);
    let nearest = easel.side() * easel.draw.log(0.03, 0.16);
    let base = easel.draw.uniform(1.2, 2.3);
    let wind = easel.draw.angle();
    // Leaves at random places cover all but exp(−coverage).
    let coverage = -gaps.ln() / layers as f32;
    for layer in 0..layers {
        let nearness = (layer + 1) as f32 / layers as f32;
        let leaf = Leaf {
            length: (nearest * nearness.powf(1.3)).max(6.0),
            aspect: easel.draw.log(0.15, 0.75),
            hue: base + 0.15 * easel.draw.normal(),
            saturation: easel.draw.uniform(0.3, 0.75),
            sunlit: easel.draw.uniform(0.1, 0.6),
        };
        boughs(easel, nearness);
        grow(easel, &leaf, (coverage, nearness, level), wind);
        if layer + 1 < layers && easel.draw.chance(0.3) {
            let radius = easel.draw.count(1, 5);
            defocus(&mut easel.film, radius);
        }
    }
    easel.expose(0.06, 0.35);
}

/// Covers about the given share of a layer with twigs, where clumps of the tree are.
fn grow(easel: &mut Easel, leaf: &Leaf, (coverage, nearness, sky): (f32, f32, f32), wind: f32) {
    let size = easel.film.size();
    let wanted = coverage * size[0] * size[1];
    // Half of its bounding rectangle, which is narrower where the leaf is seen from the side.
    let per_leaf = 0.35 * leaf.aspect * leaf.length * leaf.length;
    let (offset, clump) = (easel.draw.uniform(0.0, 256.0), 12.0 / easel.side());
    let openness = easel.draw.uniform(-1.2, 0.3);
    let (mut covered, mut tried) = (0.0, 0.0);
    // Where nothing wants to grow, the sky stays open.
    while covered < wanted && tried < 4.0 * wanted {
        let start = easel.draw.point(size, 2.0 * leaf.length);
        let density = easel.grain.at(start[0] * clump + offset, start[1] * clump);
        let leaves = easel.draw.count(3, 11);
        tried += per_leaf * leaves as f32;
        if density > openness + 0.4 * easel.draw.normal() {
            covered += per_leaf * leaves as f32;
            let direction = wind + 1.1 * easel.draw.normal();
            // Within clumps it is darker, and boughs hang together in light or shade.
            let shade = (0.8 * easel.grain.at(0.7 * clump * start[1] + offset, 0.7 * clump * start[0])).exp();
            twig(easel, leaf, (start, direction, leaves), (nearness, sky, shade));
        }
    }
}

/// Leaves on both sides of a bending stem.
fn twig(
    easel: &mut Easel,
    leaf: &Leaf,
    (start, direction, leaves): (Point, f32, usize),
    (nearness, sky, light): (f32, f32, f32),
) {
    let (mut at, mut angle) = (start, direction);
    let bend = 0.2 * easel.draw.normal();
    let shade = light * (0.4 * easel.draw.normal()).exp();
    for i in 0..leaves {
        let step = 0.5 * leaf.length;
        let next = [at[0] + step * angle.cos(), at[1] + step * angle.sin()];
        let stem = scale(&[1.1, 0.9, 0.6], 0.4 * SHADE * shade);
        easel.shine(&outline::stroke(at, next, [(0.06 * leaf.length).clamp(0.5, 2.5); 2]), stem);
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        let turn = angle + side * easel.draw.uniform(0.4, 1.3);
        single(easel, leaf, (at, turn, shade), (nearness, sky));
        (at, angle) = (next, angle + bend);
    }
}

/// One leaf, its halves turned to the light by different amounts.
fn single(
    easel: &mut Easel,
    leaf: &Leaf,
    (base, angle, shade): (Point, f32, f32),
    (nearness, sky): (f32, f32),
) {
    let draw = &mut easel.draw;
    let length = leaf.length * draw.log(0.6, 1.3);
    // Leaves are seen under all angles.
    let width = leaf.aspect * length * draw.uniform(0.45, 1.0);
    let is_sunlit = draw.chance(leaf.sunlit);
    let level = shade * if is_sunlit { draw.log(1.2, 6.0) } else { draw.log(0.35, 1.4) };
    let green = hue(leaf.hue - if is_sunlit { 0.25 } else { 0.0 }, leaf.saturation + 0.05 * draw.normal());
    let colour = scale(&green, SHADE * level * nearness.powf(-0.3));
    let haze = scale(&hue(4.0, 0.15), 0.25 * sky);
    let colour = blend(&colour, &haze, 0.25 * (1.0 - nearness));
    for (half, light) in outline::leaf(base, length, width, angle).iter().zip([1.0, draw.log(0.55, 1.0)]) {
        let fall = draw.uniform(-0.4, 0.4) / length.max(1.0);
        let surface =
            Surface::plain(scale(&colour, light)).shaded(base, [fall * angle.cos(), fall * angle.sin()]);
        easel.film.fill(half, |at, sample| *sample = surface.at(at, &easel.grain));
    }
    if is_sunlit && length > 6.0 && draw.chance(0.06) {
        let spot = [base[0] + 0.5 * length * angle.cos(), base[1] + 0.5 * length * angle.sin()];
        let gloss: Rgb = [SHADE * draw.log(8.0, 120.0); 3];
        let size = [0.12 * length, 0.03 * length + 0.3];
        easel.shine(&outline::ellipse(spot, size, angle), gloss);
    }
}

/// A few boughs behind the leaves.
fn boughs(easel: &mut Easel, nearness: f32) {
    let [height, width] = easel.film.size();
    for _ in 0..easel.draw.count(0, 2) {
        let foot = edge_point(&mut easel.draw, [height, width]);
        let towards = (0.5 * height - foot[1]).atan2(0.5 * width - foot[0]) + 0.4 * easel.draw.normal();
        let length = 0.28 * height * nearness.sqrt();
        let bark = scale(&[1.15, 0.95, 0.8], SHADE * easel.draw.log(0.25, 0.8));
        branch(easel, foot, (length, towards.rem_euclid(TAU), 0.08 * length), bark);
    }
}

/// A point of the image's rim.
fn edge_point(draw: &mut Draw, [height, width]: [f32; 2]) -> Point {
    let along = draw.uniform(0.0, 1.0);
    match draw.count(0, 3) {
        0 => [0.0, along * height],
        1 => [width, along * height],
        2 => [along * width, 0.0],
        _ => [along * width, height],
    }
}
