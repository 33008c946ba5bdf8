//! How neighbouring pixels of a scene are related: alike relative to their brightness, but for edges.

use ndarray::{Array2, Axis, Zip};
use rayon::prelude::*;

use super::super::objective::sum_of_rows;
use super::frame::row;

/// Relative difference of neighbours, root mean square over the colours, from which on it is taken for an edge.
const EDGE: f32 = 0.05;

/// How much less the difference of a pixel to its next ones counts than that within a surface, from 0 to 1; one plane for
/// all colours, since edges are of things.
pub(super) struct Edges(Option<Array2<f32>>);

impl Edges {
    /// Those of a scene of which nothing is known.
    pub(super) fn unknown() -> Self {
        Self(None)
    }

    /// Those of a scene in several colours, each with the inverse of its local brightness.
    ///
    /// # Equation
    /// `e = (1 + (r/ε)²)^(−¾)`, r² the mean over the colours of `|∇x|²·v²`, forward differences: the weights of the penalty
    /// `|r|^½` beyond ε.
    pub(super) fn of_scene(colors: &[(&Array2<f32>, &Array2<f32>)]) -> Self {
        let (height, width) = colors.first().map_or((0, 0), |(x, _)| x.dim());
        #[expect(clippy::cast_precision_loss, reason = "three colours")]
        let share = 1.0 / (colors.len() as f32 * EDGE * EDGE);
        let mut edges = Array2::zeros((height, width));
        edges.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut edges)| {
            let edges = edges.as_slice_mut().expect("planes are contiguous");
            for (x, inverse) in colors {
                add_squares(edges, [row(x, y), row(x, (y + 1).min(height - 1))], row(inverse, y));
            }
            edges.iter_mut().for_each(|e| {
                // (1 + r²)^(−¾) by square roots.
                let root = (1.0 + *e * share).sqrt();
                *e = 1.0 / (root * root.sqrt());
            });
        });
        Self(Some(edges))
    }

    /// The weights, where any are known.
    pub(super) fn plane(&self) -> Option<&Array2<f32>> {
        self.0.as_ref()
    }

    /// The mean weight.
    pub(super) fn mean(&self) -> f32 {
        let Some(edges) = &self.0 else { return 1.0 };
        let sum = sum_of_rows(edges.nrows(), |y| row(edges, y).iter().map(|e| f64::from(*e)).sum());
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_precision_loss,
            reason = "a mean of numbers up to 1"
        )]
        let mean = (sum / edges.len() as f64) as f32;
        mean
    }
}

fn add_squares(sums: &mut [f32], [here, below]: [&[f32]; 2], inverse: &[f32]) {
    let last = here.len() - 1;
    for x in 0..=last {
        let along_x = here[(x + 1).min(last)] - here[x];
        let along_y = below[x] - here[x];
        sums[x] += (along_x * along_x + along_y * along_y) * inverse[x] * inverse[x];
    }
}

/// The quadratic penalty `λ·Σ e·v·v′·(x − x′)²` over pairs of neighbours, v the inverse of the local brightness and zero
/// where nothing is presumed.
pub(super) struct Prior<'a> {
    pub(super) weight: f32,
    pub(super) edges: &'a Edges,
    pub(super) inverse_brightness: &'a Array2<f32>,
}

impl Prior<'_> {
    /// Adds `sign` times half the slope of the penalty at x.
    pub(super) fn add_slope(&self, x: &Array2<f32>, sign: f32, out: &mut Array2<f32>) {
        let ones;
        let edges = if let Edges(Some(edges)) = self.edges {
            edges
        } else {
            ones = Array2::ones(x.dim());
            &ones
        };
        let (height, scale) = (x.nrows(), sign * self.weight);
        let v = self.inverse_brightness;
        Zip::indexed(out.rows_mut()).par_for_each(|y, mut out| {
            let out = out.as_slice_mut().expect("planes are contiguous");
            along_row(out, row(x, y), row(v, y), row(edges, y), scale);
            if y + 1 < height {
                across(out, [row(x, y), row(x, y + 1)], [row(v, y), row(v, y + 1)], row(edges, y), scale);
            }
            if y > 0 {
                across(out, [row(x, y), row(x, y - 1)], [row(v, y), row(v, y - 1)], row(edges, y - 1), scale);
            }
        });
    }
}

fn along_row(out: &mut [f32], x: &[f32], v: &[f32], e: &[f32], scale: f32) {
    let mut before = 0.0;
    let last = out.len() - 1;
    for i in 0..last {
        let pull = scale * e[i] * v[i] * v[i + 1] * (x[i] - x[i + 1]);
        out[i] += pull - before;
        before = pull;
    }
    out[last] -= before;
}

fn across(out: &mut [f32], [here, there]: [&[f32]; 2], [v, w]: [&[f32]; 2], e: &[f32], scale: f32) {
    for i in 0..out.len() {
        out[i] += scale * e[i] * v[i] * w[i] * (here[i] - there[i]);
    }
}
