//! How neighbouring pixels of a scene are related: alike relative to their brightness, but for edges.

use ndarray::{Array2, Axis, Zip};
use rayon::prelude::*;

use super::super::objective::sum_of_rows;
use super::frame::row;
use super::sums::{add_scaled, dot};
use crate::kernels::vectorised;

/// Relative difference of neighbours, root mean square over the colours, from which on it is taken for an edge:
/// more than noise leaves of a surface, less than most outlines have.
const EDGE: f32 = 0.05;

/// Writes a row of the inverse of a scene's local brightness.
pub(super) type InverseBrightness<'a> = &'a (dyn Fn(usize, &mut [f32]) + Sync);

/// How much less the difference of a pixel to its next ones counts than that within a surface, from 0 to 1; one plane for
/// all colours, since edges are of things.
pub(super) struct Edges {
    /// None: all count in full.
    plane: Option<Array2<f32>>,
    mean: f32,
}

impl Edges {
    /// Those of a scene of which nothing is known.
    pub(super) fn unknown() -> Self {
        Self { plane: None, mean: 1.0 }
    }

    /// Those of a scene in several colours, each with what writes rows of the inverse of its local brightness.
    ///
    /// # Equation
    /// `e = (1 + (r/ε)²)^(−¾)`, r² the mean over the colours of `Σ (x − x′)²·max(v, v′)²` over the pixels to the right and below:
    /// the weights of the penalty `|r|^½` beyond ε. The outline of a lamp is relative to what is dark beside it.
    pub(super) fn of_scene(colors: &[(&Array2<f32>, InverseBrightness<'_>)]) -> Self {
        let (height, width) = colors.first().map_or((0, 0), |(x, _)| x.dim());
        #[expect(clippy::cast_precision_loss, reason = "three colours")]
        let share = 1.0 / (colors.len() as f32 * EDGE * EDGE);
        let mut edges = Array2::zeros((height, width));
        let rows = edges.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
        rows.for_each_init(Default::default, |[here, below]: &mut [Vec<f32>; 2], (y, mut edges)| {
            let edges = edges.as_slice_mut().expect("planes are contiguous");
            let next = (y + 1).min(height - 1);
            for (x, inverse_brightness) in colors {
                for (y, inverse) in [(y, &mut *here), (next, &mut *below)] {
                    inverse.resize(width, 0.0);
                    inverse_brightness(y, inverse);
                }
                add_squares(edges, [row(x, y), row(x, next)], [here, below]);
            }
            weights(edges, share);
        });
        let mean = mean(&edges);
        Self { plane: Some(edges), mean }
    }

    /// The weights, where any are known.
    pub(super) fn plane(&self) -> Option<&Array2<f32>> {
        self.plane.as_ref()
    }

    /// The mean weight.
    pub(super) fn mean(&self) -> f32 {
        self.mean
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "a mean of numbers up to 1")]
fn mean(edges: &Array2<f32>) -> f32 {
    let sum = sum_of_rows(edges.nrows(), |y| row(edges, y).iter().map(|e| f64::from(*e)).sum());
    (sum / edges.len() as f64) as f32
}

vectorised! {
    /// Turns sums of squares, times `share`, to weights.
    fn weights<'a>(edges: &'a mut [f32], share: f32) -> () {
        edges.iter_mut().for_each(|e| {
            // (1 + r²)^(−¾) by square roots.
            let root = (1.0 + *e * share).sqrt();
            *e = 1.0 / (root * root.sqrt());
        });
    }
}

vectorised! {
    /// Adds the squares of a row's differences to its right and to the row below.
    fn add_squares<'a>(sums: &'a mut [f32], rows: [&'a [f32]; 2], inverses: [&'a [f32]; 2]) -> () {
        let ([here, below], [v, w]) = (rows, inverses);
        let right = here[1..].iter().zip(&v[1..]);
        for ((sum, (x, v)), (right, of_right)) in sums.iter_mut().zip(here.iter().zip(v)).zip(right) {
            let along = (right - x) * v.max(*of_right);
            *sum += along * along;
        }
        for ((sum, (x, v)), (below, w)) in sums.iter_mut().zip(here.iter().zip(v)).zip(below.iter().zip(w)) {
            let along = (below - x) * v.max(*w);
            *sum += along * along;
        }
    }
}

/// The part of the weight of differences that saturated pixels have for being brighter than the level at which they saturate,
/// where nothing else tells their light: with a quarter of it, scenes that are clipped at 1 are restored 1 dB worse. It would take
/// a third of the light of a small lamp, which its flare tells.
const MODESTY: f32 = 4e-3;

/// The quadratic penalty `λ·(Σ e·v·v′·(x − x′)² + m·Σ v²·(x − level)²)` over pairs of neighbours and over saturated pixels, v the
/// inverse of the local brightness.
pub(super) struct Prior<'a> {
    pub(super) weight: f32,
    pub(super) edges: &'a Edges,
    pub(super) inverse_brightness: &'a Array2<f32>,
    /// What is presumed of saturated pixels beside, where their light was not measured.
    pub(super) lamps: Option<Modest<'a>>,
}

/// Saturated pixels are presumed to be little brighter than that.
#[derive(Clone, Copy)]
pub(super) struct Modest<'a> {
    /// D: zero at saturated pixels alone.
    pub(super) brightness: &'a Array2<f32>,
    /// The light at which pixels are saturated.
    pub(super) level: f32,
}

impl Prior<'_> {
    /// Takes half the slope of the penalty at x from `out`; `room` is as large.
    pub(super) fn take_slope(&self, x: &Array2<f32>, (out, room): (&mut Array2<f32>, &mut Array2<f32>)) {
        self.product(x, room);
        add_scaled(out, -1.0, room);
        if let Some(Modest { brightness, level }) = self.lamps {
            let scale = self.weight * MODESTY * level;
            Zip::from(out).and(brightness).and(self.inverse_brightness).par_for_each(|out, n, v| {
                if *n <= 0.0 {
                    *out += scale * v * v;
                }
            });
        }
    }

    /// Writes the matrix of the penalty times x; returns its inner product with x.
    pub(super) fn product(&self, x: &Array2<f32>, out: &mut Array2<f32>) -> f64 {
        let ones = vec![1.0; x.ncols()];
        let rows = out.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
        let energies = rows.map_init(
            || Pulls::new(x.ncols()),
            |pulls, (y, mut out)| {
                let out = out.as_slice_mut().expect("planes are contiguous");
                pull(self, pulls, (x, y), &ones, out)
            },
        );
        energies.collect::<Vec<f64>>().into_iter().sum()
    }
}

vectorised! {
    /// Writes a row of the matrix of the penalty times x; returns its part of the inner product with x. Unknown edges are `ones`.
    fn pull<'a>(prior: &'a Prior<'a>, pulls: &'a mut Pulls, place: (&'a Array2<f32>, usize), ones: &'a [f32], out: &'a mut [f32]) -> f64 {
        let (x, y) = place;
        let (v, weight) = (prior.inverse_brightness, prior.weight);
        let edge = |y: usize| match &prior.edges.plane {
            Some(edges) => row(edges, y),
            None => ones,
        };
        let mut energy = pulls.along(out, row(x, y), row(v, y), (edge(y), weight));
        if y + 1 < x.nrows() {
            energy +=
                pulls.across(out, [row(x, y), row(x, y + 1)], [row(v, y), row(v, y + 1)], (edge(y), weight));
        }
        if y > 0 {
            // Its energy is that of the row above.
            pulls.across(out, [row(x, y), row(x, y - 1)], [row(v, y), row(v, y - 1)], (edge(y - 1), weight));
        }
        if let Some(Modest { brightness, .. }) = prior.lamps {
            energy += pulls.down(out, row(x, y), (row(v, y), row(brightness, y)), weight);
        }
        energy
    }
}

/// What the pixels of a row are pulled with, and along which differences.
struct Pulls {
    pulls: Vec<f32>,
    differences: Vec<f32>,
}

impl Pulls {
    fn new(width: usize) -> Self {
        Self { pulls: vec![0.0; width], differences: vec![0.0; width] }
    }

    /// Writes the pulls within a row; returns `scale·Σ e·v·v′·(x − x′)²`.
    #[inline(always)]
    fn along(&mut self, out: &mut [f32], x: &[f32], v: &[f32], (e, scale): (&[f32], f32)) -> f64 {
        let last = out.len() - 1;
        let Self { pulls, differences } = self;
        let pairs = x.iter().zip(&x[1..]).zip(v.iter().zip(&v[1..])).zip(e);
        for ((pull, difference), (((x, right), (v, of_right)), e)) in
            pulls.iter_mut().zip(&mut *differences).zip(pairs)
        {
            *difference = x - right;
            *pull = scale * e * v * of_right * *difference;
        }
        out[0] = if last > 0 { pulls[0] } else { 0.0 };
        for ((out, pull), before) in out[1..].iter_mut().zip(&pulls[1..]).zip(&*pulls) {
            *out = pull - before;
        }
        if last > 0 {
            out[last] = -pulls[last - 1];
        }
        dot(&pulls[..last], &differences[..last])
    }

    /// Adds the pulls of another row; returns `scale·Σ e·v·w·(x − x′)²`.
    #[inline(always)]
    fn across(
        &mut self,
        out: &mut [f32],
        [here, there]: [&[f32]; 2],
        [v, w]: [&[f32]; 2],
        (e, scale): (&[f32], f32),
    ) -> f64 {
        let Self { pulls, differences } = self;
        let places = here.iter().zip(there).zip(v.iter().zip(w)).zip(e);
        for ((pull, difference), (((here, there), (v, w)), e)) in
            pulls.iter_mut().zip(&mut *differences).zip(places)
        {
            *difference = here - there;
            *pull = scale * e * v * w * *difference;
        }
        out.iter_mut().zip(&*pulls).for_each(|(out, pull)| *out += pull);
        dot(pulls, differences)
    }

    /// Adds the pulls of saturated pixels towards darkness; returns their `scale·m·Σ (v·x)²`.
    #[inline(always)]
    fn down(&mut self, out: &mut [f32], x: &[f32], (v, brightness): (&[f32], &[f32]), scale: f32) -> f64 {
        for ((((pull, out), x), v), n) in self.pulls.iter_mut().zip(out).zip(x).zip(v).zip(brightness) {
            *pull = if *n <= 0.0 { scale * MODESTY * v * v * x } else { 0.0 };
            *out += *pull;
        }
        dot(&self.pulls, x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(seed: usize) -> Array2<f32> {
        Array2::from_shape_fn((9, 11), |(y, x)| ((y * 31 + x * 17 + seed) % 23) as f32 / 23.0)
    }

    /// Of a quadratic form the difference quotient is exact but for rounding; that of the level is its linear term.
    #[test]
    fn the_slope_is_the_gradient_of_the_penalty() {
        const LEVEL: f32 = 3.0;
        let (x, d, inverse_brightness) = (plane(1), plane(9), plane(4));
        let brightness = plane(2).mapv(|n| (n - 0.5).max(0.0));
        let modest = Modest { brightness: &brightness, level: LEVEL };
        for (edges, lamps) in
            [(Edges::unknown(), None), (Edges { plane: Some(plane(6)), mean: 0.5 }, Some(modest))]
        {
            let prior = Prior { weight: 0.3, edges: &edges, inverse_brightness: &inverse_brightness, lamps };
            let mut slope = Array2::from_elem(x.dim(), 1.0);
            let mut room = Array2::zeros(x.dim());
            prior.take_slope(&x, (&mut slope, &mut room));
            let along = ((1.0 - &slope) * &d).sum();
            let pulled = Zip::from(&brightness)
                .and(&inverse_brightness)
                .and(&d)
                .fold(0.0, |sum, n, v, d| if *n <= 0.0 { sum + f64::from(v * v * d) } else { sum });
            let towards = lamps.map_or(0.0, |_| f64::from(0.3 * MODESTY * LEVEL) * pulled);
            let mut energy = |x: Array2<f32>| prior.product(&x, &mut room);
            let half_quotient = (energy(&x + &d) - energy(&x - &d)) / 4.0 - towards;
            assert!((f64::from(along) - half_quotient).abs() < 1e-4, "{along} {half_quotient}");
        }
    }

    /// Its first and its last pixel have the same edges, though its differences are small relative to its own light.
    #[test]
    fn the_outline_of_a_lamp_is_relative_to_the_dark_beside_it() {
        let is_lamp = |x: usize| (3..5).contains(&x);
        let scene = Array2::from_shape_fn((4, 8), |(_, x)| if is_lamp(x) { 50.0 } else { 0.1 });
        let inverse = |_: usize, out: &mut [f32]| {
            out.iter_mut().enumerate().for_each(|(x, v)| *v = if is_lamp(x) { 0.02 } else { 4.0 });
        };
        let edges = Edges::of_scene(&[(&scene, &inverse)]);
        let plane = edges.plane().unwrap();
        assert!(plane[[1, 2]] < 1e-5 && (plane[[1, 2]] - plane[[1, 4]]).abs() < 1e-7, "{plane}");
    }

    #[test]
    fn edges_are_where_any_colour_has_one() {
        let flat = Array2::from_elem((6, 8), 0.5);
        let step = Array2::from_shape_fn((6, 8), |(_, x)| if x < 4 { 0.5 } else { 1.0 });
        let ones = |_: usize, out: &mut [f32]| out.fill(1.0);
        let edges = Edges::of_scene(&[(&flat, &ones), (&step, &ones), (&flat, &ones)]);
        let plane = edges.plane().unwrap();
        let at_step = (1.0 + 0.25 / (3.0 * EDGE * EDGE)).powf(-0.75);
        for ((_, x), e) in plane.indexed_iter() {
            assert!((e - if x == 3 { at_step } else { 1.0 }).abs() < 1e-5, "{x}: {e}");
        }
        assert!((edges.mean() - (7.0 + at_step) / 8.0).abs() < 1e-5);
    }
}
