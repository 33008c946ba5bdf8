//! Noise with the spectrum of natural textures, on a tile that repeats without a seam.

use rand::RngExt as _;

use super::draw::Draw;

/// Side of the tile in cells.
const SIDE: usize = 256;

/// 1/f noise of mean 0 and variance 1 on a torus.
pub(super) struct Grain {
    cells: Vec<f32>,
}

impl Grain {
    /// Adds up value noise of octaves from half of the tile to single cells.
    ///
    /// # Equation
    /// An octave at frequency f of a power spectrum f⁻² holds ∫ f⁻² f df, the same for all; each octave's amplitude is
    /// therefore `roughness` times that of the coarser one: 1 for f⁻², less for smoother noise.
    pub(super) fn new(draw: &mut Draw, roughness: f32) -> Self {
        let mut cells = vec![0.0; SIDE * SIDE];
        let mut amplitude = 1.0;
        let mut period = SIDE / 2;
        while period >= 1 {
            let count = SIDE / period;
            let knots: Vec<f32> = (0..count * count).map(|_| draw.0.random::<f32>() - 0.5).collect();
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let at = [x as f32 / period as f32, y as f32 / period as f32];
                    cells[y * SIDE + x] += amplitude * interpolate(&knots, count, at, smooth);
                }
            }
            amplitude *= roughness;
            period /= 2;
        }
        let mean = cells.iter().sum::<f32>() / cells.len() as f32;
        let variance = cells.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / cells.len() as f32;
        cells.iter_mut().for_each(|v| *v = (*v - mean) / variance.sqrt());
        Self { cells }
    }

    /// The noise at a place in cells, interpolated.
    pub(super) fn at(&self, u: f32, v: f32) -> f32 {
        interpolate(&self.cells, SIDE, [u, v], |t| t)
    }

    /// Noise of all scales from `period` cells down to one, for areas larger than the tile.
    pub(super) fn deep(&self, u: f32, v: f32, period: f32) -> f32 {
        let coarse = SIDE as f32 / (2.0 * period);
        0.8 * self.at(u * coarse, v * coarse) + 0.35 * self.at(u * 0.9 + 71.0, v * 0.9 + 13.0)
    }
}

fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

#[expect(clippy::cast_possible_truncation, reason = "wrapped to the lattice")]
fn interpolate(knots: &[f32], side: usize, [u, v]: [f32; 2], ease: impl Fn(f32) -> f32) -> f32 {
    let (left, top) = (u.floor(), v.floor());
    let (tx, ty) = (ease(u - left), ease(v - top));
    let wrap = |at: f32, step: i64| (at as i64 + step).rem_euclid(side as i64) as usize;
    let (x0, x1) = (wrap(left, 0), wrap(left, 1));
    let (y0, y1) = (wrap(top, 0) * side, wrap(top, 1) * side);
    let above = knots[y0 + x0] + (knots[y0 + x1] - knots[y0 + x0]) * tx;
    let below = knots[y1 + x0] + (knots[y1 + x1] - knots[y1 + x0]) * tx;
    above + (below - above) * ty
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng;

    #[test]
    fn the_tile_has_no_seam_and_octaves_of_one_strength() {
        let grain = Grain::new(&mut Draw(rng::stream(3, "test")), 1.0);
        assert!((grain.at(3.2, 7.9) - grain.at(3.2 + 256.0, 7.9 - 512.0)).abs() < 1e-3);
        // Differences over a distance d have a variance that grows as ln d: slowly, unlike white noise or a slope.
        let spread = |distance: f32| {
            let change = |i: i16| {
                (grain.at(f32::from(i) * 1.7, 40.0) - grain.at(f32::from(i) * 1.7, 40.0 + distance)).powi(2)
            };
            (0..2000).map(change).sum::<f32>() / 2000.0
        };
        assert!(
            spread(4.0) > 1.2 * spread(1.0) && spread(32.0) < 5.0 * spread(4.0),
            "{} {}",
            spread(1.0),
            spread(4.0)
        );
    }
}
