//! What things look like: their colour with a pattern, 1/f grain, and light that falls from one side.

use super::draw::Draw;
use super::film::Point;
use super::grain::Grain;
use super::light::{Rgb, blend, scale};

/// A regular pattern of two colours.
#[derive(Clone, Copy, Debug)]
enum Pattern {
    Plain,
    /// Hard stripes.
    Stripes,
    /// Stripes that fade into each other.
    Waves,
    Checks,
    /// Dots of the second colour.
    Dots,
}

/// How a thing shines back.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    colours: [Rgb; 2],
    pattern: Pattern,
    /// Repeats a pixel along the pattern's two axes.
    frequency: [Point; 2],
    /// Logarithmic amplitude of the grain, and its cells a pixel along two axes.
    grain: f32,
    cells: [Point; 2],
    offset: Point,
    /// Where the surface has its own brightness, and how that changes from there, a pixel.
    centre: Point,
    shading: Point,
}

impl Surface {
    /// One colour.
    pub(super) fn plain(colour: Rgb) -> Self {
        Self {
            colours: [colour; 2],
            pattern: Pattern::Plain,
            frequency: [[0.0; 2]; 2],
            grain: 0.0,
            cells: [[1.0, 0.0], [0.0, 1.0]],
            offset: [0.0; 2],
            centre: [0.0; 2],
            shading: [0.0; 2],
        }
    }

    /// One colour with grain of a logarithmic amplitude.
    pub(super) fn grainy(draw: &mut Draw, colour: Rgb, amplitude: f32) -> Self {
        let mut surface = Self::plain(colour);
        surface.grain = amplitude;
        let (angle, fineness) = (draw.angle(), draw.log(0.35, 1.1));
        // Some grain runs along one direction: wood, cloth, brushed metal.
        let stretch = if draw.chance(0.25) { draw.log(3.0, 20.0) } else { 1.0 };
        let (sin, cos) = angle.sin_cos();
        surface.cells =
            [[cos * fineness, sin * fineness], [-sin * fineness / stretch, cos * fineness / stretch]];
        surface.offset = [draw.uniform(0.0, 256.0), draw.uniform(0.0, 256.0)];
        surface
    }

    /// Some matter of the given colour, `radius` pixels large, around a centre.
    ///
    /// Grain is weak on most things and strong on few; one in six bears a pattern.
    pub(super) fn draw(draw: &mut Draw, colours: [Rgb; 2], centre: Point, radius: f32) -> Self {
        let amplitude = (0.10 * (0.8 * draw.normal()).exp()).min(0.6);
        let mut surface = Self::grainy(draw, colours[0], amplitude);
        surface.centre = centre;
        if radius > 4.0 && draw.chance(0.17) {
            surface.bear_pattern(draw, colours[1], radius);
        }
        let slope = draw.uniform(0.0, 0.6) / radius.max(1.0);
        let angle = draw.angle();
        surface.shading = [slope * angle.cos(), slope * angle.sin()];
        surface
    }

    fn bear_pattern(&mut self, draw: &mut Draw, second: Rgb, radius: f32) {
        self.colours[1] = second;
        self.pattern = draw.pick(&[Pattern::Stripes, Pattern::Waves, Pattern::Checks, Pattern::Dots]);
        let frequency = 1.0 / draw.log(2.5, radius.max(3.0));
        let (sin, cos) = draw.angle().sin_cos();
        self.frequency = [[cos * frequency, sin * frequency], [-sin * frequency, cos * frequency]];
    }

    /// A regular pattern of two colours with a period in pixels, at an angle: `kind` 0 stripes, 1 waves, 2 checks, else dots.
    pub(super) fn patterned(colours: [Rgb; 2], kind: usize, period: f32, angle: f32) -> Self {
        let (sin, cos) = angle.sin_cos();
        let pattern = match kind {
            0 => Pattern::Stripes,
            1 => Pattern::Waves,
            2 => Pattern::Checks,
            _ => Pattern::Dots,
        };
        let frequency = [[cos / period, sin / period], [-sin / period, cos / period]];
        Self { colours, pattern, frequency, ..Self::plain(colours[0]) }
    }

    /// The same, its brightness changing along x and y by shares a pixel, from a centre.
    pub(super) fn shaded(self, centre: Point, shading: Point) -> Self {
        Self { centre, shading, ..self }
    }

    /// The same in another light.
    pub(super) fn lit(self, level: f32) -> Self {
        Self { colours: self.colours.map(|colour| scale(&colour, level)), ..self }
    }

    /// The light that comes from a place of the surface.
    pub(super) fn at(&self, at: Point, grain: &Grain) -> Rgb {
        let along = |[a, b]: Point, [x, y]: Point| a * x + b * y;
        let from_centre = [at[0] - self.centre[0], at[1] - self.centre[1]];
        let colour = match self.pattern {
            Pattern::Plain => self.colours[0],
            _ => blend(&self.colours[0], &self.colours[1], self.share(from_centre)),
        };
        let mut level = (1.0 + along(self.shading, from_centre)).max(0.1);
        if self.grain > 0.0 {
            let [u, v] = self.cells.map(|axis| along(axis, at));
            level *= (self.grain * grain.at(u + self.offset[0], v + self.offset[1])).exp();
        }
        scale(&colour, level)
    }

    /// The second colour's share at a place of the pattern.
    fn share(&self, [x, y]: Point) -> f32 {
        let [u, v] = self.frequency.map(|[a, b]| a * x + b * y);
        let (u, v) = (u - u.floor(), v - v.floor());
        let hard = |is_second: bool| if is_second { 1.0 } else { 0.0 };
        match self.pattern {
            Pattern::Plain => 0.0,
            Pattern::Stripes => hard(u < 0.5),
            Pattern::Waves => 0.5 + 0.5 * (std::f32::consts::TAU * u).sin(),
            Pattern::Checks => hard((u < 0.5) != (v < 0.5)),
            Pattern::Dots => hard((u - 0.5).hypot(v - 0.5) < 0.32),
        }
    }
}
