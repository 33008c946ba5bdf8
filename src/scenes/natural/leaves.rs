//! Dead leaves: things of power-law sizes that cover each other, evenly lit or under a low light with shadows.

use super::blur::defocus;
use super::draw::{Draw, mean_disc_area};
use super::easel::Easel;
use super::film::Point;
use super::light::{Palette, glowing};
use super::outline;
use super::surface::Surface;

/// Shares of discs, ellipses, blobs and polygons.
struct Forms([f32; 4]);

impl Forms {
    /// Some scenes hold all forms, others mostly one.
    fn new(draw: &mut Draw) -> Self {
        let mut shares = std::array::from_fn(|_| draw.uniform(0.0, 1.0).powi(3) + 0.02);
        let sum: f32 = shares.iter().sum();
        shares.iter_mut().for_each(|share| *share /= sum);
        Self(shares)
    }

    fn outline(&self, draw: &mut Draw, centre: Point, radius: f32) -> Vec<Point> {
        let mut chosen = draw.uniform(0.0, 1.0);
        let form = self.0.iter().position(|share| {
            chosen -= share;
            chosen < 0.0
        });
        match form {
            Some(0) => outline::disc(centre, radius),
            Some(1) => outline::ellipse(centre, [radius, radius * draw.log(0.15, 0.9)], draw.angle()),
            Some(2) if radius > 3.0 => outline::blob(draw, centre, radius),
            _ => outline::polygon(draw, centre, radius),
        }
    }
}

/// Evenly lit.
pub(super) fn flat(easel: &mut Easel) {
    let light = daylight(&mut easel.draw);
    let palette_size = easel.draw.count(5, 14);
    let palette = Palette::new(&mut easel.draw, palette_size, &light);
    let forms = Forms::new(&mut easel.draw);
    let side = easel.side();
    let radii = [easel.draw.log(1.0, 3.5), side * easel.draw.log(0.2, 0.45)];
    prime(easel, &palette, &forms, side);
    for _ in 0..leaf_count(easel, radii) {
        let radius = easel.draw.power_law(radii);
        let centre = easel.draw.point(easel.film.size(), radius);
        leaf(easel, &palette, &forms, (centre, radius, 1.0));
    }
    easel.expose(0.07, 0.4);
}

/// Deep leaves in the dark, near ones in the light, each with a shadow on what is below it.
pub(super) fn lit(easel: &mut Easel) {
    let light = daylight(&mut easel.draw);
    let palette_size = easel.draw.count(5, 14);
    let palette = Palette::new(&mut easel.draw, palette_size, &light);
    let forms = Forms::new(&mut easel.draw);
    let side = easel.side();
    let radii = [easel.draw.log(1.0, 3.5), side * easel.draw.log(0.15, 0.4)];
    prime(easel, &palette, &forms, side);
    let direction = easel.draw.angle();
    let (deepest, contrast) = (easel.draw.log(0.04, 0.3), easel.draw.uniform(0.35, 0.85));
    let count = leaf_count(easel, radii);
    let focused_at = if easel.draw.chance(0.4) { easel.draw.count(count / 5, 2 * count / 3) } else { 0 };
    for i in 0..count {
        if i > 0 && i == focused_at {
            let radius = easel.draw.count(1, 7);
            defocus(&mut easel.film, radius);
        }
        let nearness = i as f32 / count as f32;
        let radius = easel.draw.power_law(radii);
        let centre = easel.draw.point(easel.film.size(), radius);
        if radius > 1.8 {
            let reach = 0.35 * radius;
            let below = [centre[0] + reach * direction.cos(), centre[1] + reach * direction.sin()];
            easel.shadow(below, 1.1 * radius, contrast);
        }
        let slant = (0.35 * easel.draw.normal()).exp();
        leaf(easel, &palette, &forms, (centre, radius, slant * deepest.powf(1.0 - nearness)));
        if radius > 4.0 && easel.draw.chance(0.03) {
            gloss(easel, centre, radius);
        }
    }
    sunlight_patches(easel);
    easel.expose(0.06, 0.3);
}

/// The light of the day against a camera balanced for another.
pub(super) fn daylight(draw: &mut Draw) -> [f32; 3] {
    let white = draw.log(4500.0, 7000.0);
    if draw.chance(0.2) {
        glowing(draw.log(2600.0, 3500.0), white.min(4500.0))
    } else {
        glowing(draw.log(4800.0, 8500.0), white)
    }
}

/// Covers everything with large leaves, so that no hole is left.
fn prime(easel: &mut Easel, palette: &Palette, forms: &Forms, side: f32) {
    let colour = palette.draw(&mut easel.draw);
    let ground = Surface::grainy(&mut easel.draw, colour, 0.2);
    easel.prime(&ground);
    for _ in 0..25 {
        let radius = side * easel.draw.log(0.12, 0.4);
        let centre = easel.draw.point(easel.film.size(), 0.0);
        leaf(easel, palette, forms, (centre, radius, 1.0));
    }
}

/// As many leaves as cover the film a few times.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the film's pixels")]
fn leaf_count(easel: &mut Easel, radii: [f32; 2]) -> usize {
    let [height, width] = easel.film.size();
    let coverage = easel.draw.log(0.8, 3.5);
    (coverage * height * width / mean_disc_area(radii)) as usize
}

fn leaf(easel: &mut Easel, palette: &Palette, forms: &Forms, (centre, radius, level): (Point, f32, f32)) {
    let draw = &mut easel.draw;
    let colours = [palette.draw(draw), palette.draw(draw)];
    let surface = Surface::draw(draw, colours, centre, radius).lit(level);
    let outline = forms.outline(draw, centre, radius);
    easel.paint(&outline, &surface);
}

/// A reflection of the light on something smooth.
fn gloss(easel: &mut Easel, centre: Point, radius: f32) {
    let size = radius * easel.draw.log(0.05, 0.2);
    let level = easel.draw.log(1.0, 12.0);
    let angle = easel.draw.angle();
    let spot = outline::ellipse(centre, [size, 0.5 * size], angle);
    easel.film.fill(&spot, |_, sample| *sample = sample.map(|value| value + level));
}

/// Light that falls through gaps far above: the whole scene is multiplied by a smooth pattern.
fn sunlight_patches(easel: &mut Easel) {
    let depth = easel.draw.uniform(0.0, 0.9);
    let scale = easel.draw.log(0.03, 0.12);
    let offset = easel.draw.uniform(0.0, 256.0);
    let grain = &easel.grain;
    easel.film.all(|[x, y], sample| {
        let light = (depth * grain.at(x * scale + offset, y * scale)).exp();
        *sample = sample.map(|value| value * light);
    });
}
