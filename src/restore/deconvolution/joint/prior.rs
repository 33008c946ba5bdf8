//! How neighbouring pixels of a scene are related: alike relative to their brightness, but for edges.

use ndarray::{Array2, Axis};
use rayon::prelude::*;

use super::super::objective::sum_of_rows;
use super::frame::row;
use super::sums::sum;
use crate::kernels::vectorised;

/// Relative difference of neighbours, root mean square over the colours, from which on it is taken for an edge:
/// more than noise leaves of a surface, less than most outlines have.
const EDGE: f32 = 0.05;

/// Rows that are worked on one after another, each with what the one before left.
const BAND: usize = 16;

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
        let bands = edges.axis_chunks_iter_mut(Axis(0), BAND).into_par_iter().enumerate();
        bands.for_each_init(Default::default, |[here, below]: &mut [Vec<f32>; 2], (band, mut edges)| {
            here.resize(width, 0.0);
            below.resize(width, 0.0);
            for (x, inverse_brightness) in colors {
                inverse_brightness(band * BAND, below);
                for (mut edges, y) in edges.rows_mut().into_iter().zip(band * BAND..) {
                    std::mem::swap(here, below);
                    let next = (y + 1).min(height - 1);
                    inverse_brightness(next, below);
                    let edges = edges.as_slice_mut().expect("planes are contiguous");
                    add_squares(edges, [row(x, y), row(x, next)], [here, below]);
                }
            }
            edges.rows_mut().into_iter().for_each(|mut edges| {
                weights(edges.as_slice_mut().expect("planes are contiguous"), share);
            });
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
    /// Writes a row of `slope` less half that of the penalty at x, of which [`product`](Self::product) wrote `pulled`.
    pub(super) fn take_slope(&self, y: usize, [slope, pulled]: [&[f32]; 2], out: &mut [f32]) {
        out.iter_mut().zip(slope).zip(pulled).for_each(|((out, slope), pulled)| *out = slope - pulled);
        if let Some(Modest { brightness, level }) = self.lamps {
            let scale = self.weight * MODESTY * level;
            for ((out, n), v) in out.iter_mut().zip(row(brightness, y)).zip(row(self.inverse_brightness, y)) {
                *out += if *n <= 0.0 { scale * v * v } else { 0.0 };
            }
        }
    }

    /// Writes the matrix of the penalty times x; returns its inner product with x.
    pub(super) fn product(&self, x: &Array2<f32>, out: &mut Array2<f32>) -> f64 {
        let ones = vec![1.0; x.ncols()];
        let bands = out.axis_chunks_iter_mut(Axis(0), BAND).into_par_iter().enumerate();
        let energies = bands.map_init(
            || Pulls::new(x.ncols()),
            |pulls, (band, mut out)| {
                let first = band * BAND;
                pulls.begin(self, (x, first), &ones);
                let rows = out.rows_mut().into_iter().zip(first..);
                rows.map(|(mut out, y)| {
                    let out = out.as_slice_mut().expect("planes are contiguous");
                    pull(self, pulls, (x, y), &ones, out)
                })
                .sum::<f64>()
            },
        );
        energies.collect::<Vec<f64>>().into_iter().sum()
    }

    /// The weights of a row's differences; unknown ones are `ones`.
    fn edges_of<'r>(&'r self, y: usize, ones: &'r [f32]) -> &'r [f32] {
        self.edges.plane.as_ref().map_or(ones, |edges| row(edges, y))
    }
}

vectorised! {
    /// Writes a row of the matrix of the penalty times x; returns its part of the inner product with x. Unknown edges are `ones`; the row
    /// above was the last one, or is what [`Pulls::begin`] was told of.
    fn pull<'a>(prior: &'a Prior<'a>, pulls: &'a mut Pulls, place: (&'a Array2<f32>, usize), ones: &'a [f32], out: &'a mut [f32]) -> f64 {
        let (x, y) = place;
        let (v, edges) = (prior.inverse_brightness, (prior.edges_of(y, ones), prior.weight));
        // The last row is beside itself, from which nothing pulls it.
        let below = (y + 1).min(x.nrows() - 1);
        pulls.across(out, [row(x, y), row(x, below)], [row(v, y), row(v, below)], edges);
        pulls.along(out, row(x, y), row(v, y), edges);
        let energy = sum(&pulls.energies);
        match prior.lamps {
            Some(Modest { brightness, .. }) => {
                energy + pulls.down(out, row(x, y), (row(v, y), row(brightness, y)), prior.weight)
            }
            None => energy,
        }
    }
}

/// What the pixels of a row are pulled with.
struct Pulls {
    /// By the row above; once that of a row is written, by it those of the next one.
    above: Vec<f32>,
    along: Vec<f32>,
    /// Their products with the differences.
    energies: Vec<f32>,
}

impl Pulls {
    fn new(width: usize) -> Self {
        let [above, along, energies] = [(); 3].map(|()| vec![0.0; width]);
        Self { above, along, energies }
    }

    /// Begins with a row: with what the one above pulls it with, whose energy is that of that row.
    fn begin(&mut self, prior: &Prior<'_>, (x, y): (&Array2<f32>, usize), ones: &[f32]) {
        let Some(above) = y.checked_sub(1) else { return self.above.fill(0.0) };
        let (v, e) = (prior.inverse_brightness, prior.edges_of(above, ones));
        let places = row(x, above).iter().zip(row(x, y)).zip(row(v, above).iter().zip(row(v, y))).zip(e);
        for (pull, (((here, there), (v, w)), e)) in self.above.iter_mut().zip(places) {
            *pull = prior.weight * e * v * w * (here - there);
        }
    }

    /// Writes the pulls of the rows above and below, and `scale·e·v·w·(x − x′)²` of the one below.
    #[inline(always)]
    fn across(
        &mut self,
        out: &mut [f32],
        [here, there]: [&[f32]; 2],
        [v, w]: [&[f32]; 2],
        (e, scale): (&[f32], f32),
    ) {
        let places = here.iter().zip(there).zip(v.iter().zip(w)).zip(e);
        let pulls = out.iter_mut().zip(&mut self.above).zip(&mut self.energies);
        for (((out, above), energy), (((here, there), (v, w)), e)) in pulls.zip(places) {
            let difference = here - there;
            let pull = scale * e * v * w * difference;
            *out = pull - *above;
            *above = pull;
            *energy = pull * difference;
        }
    }

    /// Adds the pulls within a row, and their `scale·e·v·v′·(x − x′)²`.
    #[inline(always)]
    fn along(&mut self, out: &mut [f32], x: &[f32], v: &[f32], (e, scale): (&[f32], f32)) {
        let last = out.len() - 1;
        let Self { along, energies, .. } = self;
        let pairs = x.iter().zip(&x[1..]).zip(v.iter().zip(&v[1..])).zip(e);
        for ((pull, energy), (((x, right), (v, of_right)), e)) in along.iter_mut().zip(energies).zip(pairs) {
            let difference = x - right;
            *pull = scale * e * v * of_right * difference;
            *energy += *pull * difference;
        }
        // The last one has none to its right.
        along[last] = 0.0;
        out[0] += along[0];
        for ((out, pull), before) in out[1..].iter_mut().zip(&along[1..]).zip(&*along) {
            *out += pull - before;
        }
    }

    /// Adds the pulls of saturated pixels towards darkness; returns their `scale·m·Σ (v·x)²`.
    #[inline(always)]
    fn down(&mut self, out: &mut [f32], x: &[f32], (v, brightness): (&[f32], &[f32]), scale: f32) -> f64 {
        for ((((energy, out), x), v), n) in self.energies.iter_mut().zip(out).zip(x).zip(v).zip(brightness) {
            let pull = if *n <= 0.0 { scale * MODESTY * v * v * x } else { 0.0 };
            *out += pull;
            *energy = pull * x;
        }
        sum(&self.energies)
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Zip;

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
            let mut room = Array2::zeros(x.dim());
            prior.product(&x, &mut room);
            let mut slope = Array2::zeros(x.dim());
            for (y, mut slope) in slope.rows_mut().into_iter().enumerate() {
                let ones = vec![1.0; x.ncols()];
                prior.take_slope(y, [&ones, row(&room, y)], slope.as_slice_mut().unwrap());
            }
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
