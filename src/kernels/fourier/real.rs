//! The Fourier transform of real lines by one of half as many complex numbers.

use super::butterfly::{add, sub, times};
use super::lines::{Direction, LinePlan, root};
use super::{COMPLEX, TILE, WIDE};
use crate::kernels::simd::{Isa, Kernel, Simd};

/// A plan for real lines of one even length N; of their spectra, the first N/2 + 1 numbers are kept.
///
/// # Equation
/// With `z[n] = x[2n] + i·x[2n + 1]`, Z its transform of M = N/2 numbers and w = exp(−2πi/N):
/// `X[k] = (Z[k] + Z̄[M − k])/2 − i·wᵏ·(Z[k] − Z̄[M − k])/2`, and back `Z[k] = (X[k] + X̄[M − k])/2 + i·w⁻ᵏ·(X[k] − X̄[M − k])/2`.
pub struct RealPlan {
    half: LinePlan,
    /// wᵏ for k up to M.
    roots: Vec<[f32; 2]>,
}

impl RealPlan {
    /// Plans for lines of a length.
    ///
    /// # Panics
    /// For odd lengths, and others than [`is_smooth`](super::is_smooth) tells.
    pub fn new(length: usize) -> Self {
        assert!(length.is_multiple_of(2), "{length} is odd");
        let half = length / 2;
        Self { half: LinePlan::new(half), roots: (0..=half).map(|k| root(k, length)).collect() }
    }

    /// Floats of tiles that hold the kept part of a spectrum.
    pub fn floats_of_tiles(&self) -> usize {
        self.roots.len().div_ceil(WIDE) * TILE
    }

    /// Transforms `lines`, `[place][line]`, to `tiles` of their spectra, `[k / 16][part][k mod 16][line]`; places beyond are zeros.
    /// `lines` and `room`, of as many floats, are written over.
    ///
    /// # Panics
    /// When a slice has not as many floats as this says.
    pub fn forward(&self, lines: &mut [f32], room: &mut [f32], tiles: &mut [f32]) {
        assert_eq!(tiles.len(), self.floats_of_tiles(), "tiles of a spectrum");
        let [lines, _] = self.half.transform(Direction::Forward, lines, room);
        Isa::current().run(Split { roots: &self.roots, lines, tiles });
    }

    /// Transforms `spectra`, `[k][part][line]`, back to lines, `[place][line]`, times `scale·N`, in `spectra` or `room`, of which it
    /// returns the begin; both are written over.
    ///
    /// # Panics
    /// When `spectra` holds less than N/2 + 1 numbers, or `room` less than N/2.
    pub fn inverse<'b>(&self, scale: f32, spectra: &'b mut [f32], room: &'b mut [f32]) -> &'b mut [f32] {
        let floats = self.half.length() * COMPLEX;
        let room = &mut room[..floats];
        Isa::current().run(Merge { roots: &self.roots, scale, spectra, lines: room });
        let [lines, _] = self.half.transform(Direction::Inverse, room, &mut spectra[..floats]);
        lines
    }
}

/// Makes the spectra of real lines of those of half as many complex numbers.
struct Split<'a> {
    roots: &'a [[f32; 2]],
    lines: &'a [f32],
    tiles: &'a mut [f32],
}

impl Kernel for Split<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { roots, lines, tiles } = self;
        let half = roots.len() - 1;
        assert!(
            lines.len() == half * COMPLEX && tiles.len() >= roots.len().div_ceil(WIDE) * TILE,
            "as planned"
        );
        for (k, [cos, sin]) in roots.iter().enumerate() {
            let [at, mirrored] = [k % half * COMPLEX, (half - k) % half * COMPLEX];
            let to = k / WIDE * TILE + k % WIDE * WIDE;
            // −i·wᵏ/2.
            let factor = [simd.splat(0.5 * sin), simd.splat(-0.5 * cos)];
            for lane in (0..WIDE).step_by(S::LANES) {
                // SAFETY: places below `half`, of 32 floats each, are lines, as was checked above; the lanes of a part are a multiple
                // of a vector's.
                let (a, b) = unsafe {
                    let [a, b] = [at + lane, mirrored + lane];
                    let b = [simd.load(lines, b), simd.sub(simd.splat(0.0), simd.load(lines, b + WIDE))];
                    ([simd.load(lines, a), simd.load(lines, a + WIDE)], b)
                };
                let (sum, turned) = (add(simd, a, b), times(simd, sub(simd, a, b), factor));
                let halved = simd.splat(0.5);
                // SAFETY: tile k / 16 is one of those there are, as was checked above, and holds 16 places of either part.
                unsafe {
                    simd.store(tiles, to + lane, simd.mul_add(sum[0], halved, turned[0]));
                    simd.store(tiles, to + lane + TILE / 2, simd.mul_add(sum[1], halved, turned[1]));
                }
            }
        }
        for k in roots.len()..roots.len().next_multiple_of(WIDE) {
            let to = k / WIDE * TILE + k % WIDE * WIDE;
            tiles[to..to + WIDE].fill(0.0);
            tiles[to + TILE / 2..to + TILE / 2 + WIDE].fill(0.0);
        }
    }
}

/// What [`Split`] made of, times `scale·N`.
struct Merge<'a> {
    roots: &'a [[f32; 2]],
    scale: f32,
    spectra: &'a [f32],
    lines: &'a mut [f32],
}

impl Kernel for Merge<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { roots, scale, spectra, lines } = self;
        let half = roots.len() - 1;
        assert!(spectra.len() >= roots.len() * COMPLEX && lines.len() == half * COMPLEX, "as planned");
        for (k, [cos, sin]) in roots[..half].iter().enumerate() {
            let [at, mirrored] = [k * COMPLEX, (half - k) * COMPLEX];
            // i·w⁻ᵏ.
            let factor = [simd.splat(scale * sin), simd.splat(scale * cos)];
            for lane in (0..WIDE).step_by(S::LANES) {
                // SAFETY: places up to `half`, of 32 floats each, are spectra, as was checked above; the lanes of a part are a
                // multiple of a vector's.
                let (a, b) = unsafe {
                    let [a, b] = [at + lane, mirrored + lane];
                    let b = [simd.load(spectra, b), simd.sub(simd.splat(0.0), simd.load(spectra, b + WIDE))];
                    ([simd.load(spectra, a), simd.load(spectra, a + WIDE)], b)
                };
                let (sum, turned) = (add(simd, a, b), times(simd, sub(simd, a, b), factor));
                let scale = simd.splat(scale);
                // SAFETY: places below `half` are lines, as was checked above.
                unsafe {
                    simd.store(lines, at + lane, simd.mul_add(sum[0], scale, turned[0]));
                    simd.store(lines, at + lane + WIDE, simd.mul_add(sum[1], scale, turned[1]));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::fourier::transpose;
    use crate::kernels::testing::on_every_isa;

    #[test]
    fn real_lines_have_the_spectra_of_the_definition_and_come_back() {
        for length in [2, 6, 16, 30, 64, 96, 240] {
            let plan = RealPlan::new(length);
            let value = |n: usize, i: usize| ((n * 31 + i * 17) % 23) as f32 / 23.0 - 0.4;
            let given: Vec<f32> = (0..length * WIDE).map(|at| value(at / WIDE, at % WIDE)).collect();
            let there_and_back = || {
                let (mut lines, mut room) = (given.clone(), vec![7.0; given.len()]);
                let mut tiles = vec![7.0; plan.floats_of_tiles()];
                plan.forward(&mut lines, &mut room, &mut tiles);
                // By lines, and by places again, as tiles are between transforms of columns.
                let mut spectra = vec![0.0; tiles.len()];
                for (tile, spectra) in tiles.chunks_exact(TILE).zip(spectra.chunks_exact_mut(TILE)) {
                    for part in 0..2 {
                        let mut by_lines = [0.0; TILE / 2];
                        transpose(&tile[part * TILE / 2..], WIDE, &mut by_lines, WIDE);
                        transpose(&by_lines, WIDE, &mut spectra[part * WIDE..], COMPLEX);
                    }
                }
                (tiles, plan.inverse(1.0 / length as f32, &mut spectra, &mut room).to_vec())
            };
            for (isa, (tiles, back)) in on_every_isa(there_and_back) {
                for (at, (back, given)) in back.iter().zip(&given).enumerate() {
                    assert!((back - given).abs() < 2e-6, "{} {length} {at}: {back} {given}", isa.name());
                }
                for k in 0..plan.floats_of_tiles() / COMPLEX {
                    let at = k / WIDE * TILE + k % WIDE * WIDE;
                    for lane in [0, 5, WIDE - 1] {
                        let found = [tiles[at + lane], tiles[at + TILE / 2 + lane]].map(f64::from);
                        if k > length / 2 {
                            assert_eq!(found, [0.0; 2]);
                            continue;
                        }
                        let (mut re, mut im) = (0.0, 0.0);
                        for n in 0..length {
                            let angle = -std::f64::consts::TAU * (n * k % length) as f64 / length as f64;
                            re += f64::from(value(n, lane)) * angle.cos();
                            im += f64::from(value(n, lane)) * angle.sin();
                        }
                        let error = (re - found[0]).hypot(im - found[1]);
                        assert!(
                            error < 2e-6 * (length as f64).sqrt(),
                            "{} {length} {k}: {error}",
                            isa.name()
                        );
                    }
                }
            }
        }
    }
}
