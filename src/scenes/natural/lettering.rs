//! Text in an invented alphabet, drawn with strokes: print, signs and neon tubes.

use super::draw::Draw;
use super::easel::Easel;
use super::film::Point;
use super::light::Rgb;
use super::outline;

/// Width of a letter's cell, in heights.
const ADVANCE: f32 = 0.68;

/// The letters of a script: strokes between points of a grid one high and 0.5 wide, y downwards.
pub(super) struct Alphabet {
    letters: Vec<Vec<[Point; 2]>>,
}

/// How text is set.
#[derive(Clone, Copy, Debug)]
pub(super) struct Type {
    /// Height of the letters and width of their strokes in pixels.
    pub(super) height: f32,
    pub(super) weight: f32,
    /// Direction of a line in radians.
    pub(super) angle: f32,
    pub(super) ink: Rgb,
}

impl Alphabet {
    pub(super) fn new(draw: &mut Draw) -> Self {
        Self { letters: (0..24).map(|_| letter(draw)).collect() }
    }

    /// Writes a line of words of at most the given length in pixels, its top at a point.
    pub(super) fn write(&self, easel: &mut Easel, at: Point, length: f32, style: Type) {
        let (sin, cos) = style.angle.sin_cos();
        let place = |x: f32, y: f32| [at[0] + cos * x - sin * y, at[1] + sin * x + cos * y];
        let mut x = 0.0;
        while x + ADVANCE * style.height <= length {
            for _ in 0..easel.draw.count(1, 9) {
                let letter = easel.draw.count(0, self.letters.len() - 1);
                for stroke in &self.letters[letter] {
                    let [from, to] = stroke.map(|[u, v]| place(x + u * style.height, v * style.height));
                    let quad = outline::stroke(from, to, [style.weight; 2]);
                    easel.shine(&quad, style.ink);
                }
                x += ADVANCE * style.height;
                if x + ADVANCE * style.height > length {
                    return;
                }
            }
            x += 0.5 * style.height;
        }
    }
}

/// Two to four strokes: mostly a stem, then bars, diagonals and bows.
fn letter(draw: &mut Draw) -> Vec<[Point; 2]> {
    let levels = [0.0f32, 0.5, 1.0];
    let mut strokes = Vec::new();
    if draw.chance(0.7) {
        let x = draw.pick(&[0.0, 0.0, 0.25, 0.5]);
        strokes.push([[x, 0.0], [x, 1.0]]);
    }
    for _ in 0..draw.count(1, 3) {
        let y = draw.pick(&levels);
        match draw.count(0, 3) {
            0 => strokes.push([[0.0, y], [0.5, y]]),
            1 => strokes.push([[draw.pick(&[0.0, 0.5]), draw.pick(&levels)], [draw.pick(&[0.25, 0.5]), y]]),
            2 => strokes.push([[0.5, y.min(0.5)], [0.5, y.min(0.5) + 0.5]]),
            _ => bow(&mut strokes, [0.0, y.min(0.5)], draw.chance(0.5)),
        }
    }
    strokes
}

/// Half a ring, half as high as a letter.
fn bow(strokes: &mut Vec<[Point; 2]>, [x, y]: Point, is_closed: bool) {
    let at = |i: u8| {
        let angle = std::f32::consts::PI * (f32::from(i) / 5.0 - 0.5);
        [x + 0.5 * angle.cos(), y + 0.25 + 0.25 * angle.sin()]
    };
    strokes.extend((0..5).map(|i| [at(i), at(i + 1)]));
    if is_closed {
        strokes.push([[x, y], [x, y + 0.5]]);
    }
}
