//! The least squares that tell the light of some places by the flare that it throws over a capture.

use ndarray::{Array2, ArrayView1, ArrayView2, Axis, Zip};
use rayon::prelude::*;

use super::frame::{Blur, row};
use super::high_pass::HighPass;
use super::smooth::reach_of;
use super::sums::{add_scaled, dot, inner};
use crate::core::error::Result;
use crate::core::fft::{Loan, Pool};
use crate::core::progress::Progress;
use crate::kernels::vectorised;

/// Standard deviation of the high pass, in pixels: what is smoother is taken for the scene, what is finer for the spikes of
/// flare.
const HIGH_PASS_PX: f32 = 6.0;

/// Pixels around saturated ones that are not believed either: interpolated values, and the steepest flare.
const GUARD_PX: usize = 2;

/// The part of the largest curvature that each pixel has at least: below, light is told by rounding alone (10⁻⁷ squared,
/// with the 10² of brightness to spare).
const LEAST_CURVATURE: f32 = 1e-12;

/// The steepness that ends the iteration: there is nothing left to explain.
const LEAST_SLOPE: f64 = 1e-12;

/// Where light is looked for. Planes of light are of the size of `may_shine`: the frame, or a plane that goes on around it.
#[derive(Clone, Copy)]
pub(super) struct Places<'a> {
    pub(super) may_shine: &'a Array2<bool>,
    /// The light of those places at least.
    pub(super) at_least: f32,
    /// What is added to the light above that where it gathers, so that places can shine that were dark before.
    pub(super) seed: f32,
}

/// Minimises `|w·h(y − A s)|²` over the light s of some places: w relative to the brightness, h the high pass `r − G(M r)/G(M)`
/// over the believed pixels M. A high pass that is not normalised by M would leak the saturated core into its surroundings, and
/// find a third of the light.
pub(super) struct Fit<'a> {
    blur: &'a Blur<'a>,
    /// y, of the frame's size.
    capture: ArrayView2<'a, f32>,
    places: Places<'a>,
    high_pass: HighPass,
    /// Planes of the frame's size and of the places' that are written over: new ones come from the system page by page.
    frames: Pool<Array2<f32>>,
    planes: Pool<Array2<f32>>,
}

/// How far from a pixel others are that its high pass depends on.
pub(super) fn high_pass_reach() -> usize {
    reach_of(HIGH_PASS_PX)
}

impl<'a> Fit<'a> {
    /// Of a capture, which of its pixels are saturated, and its local brightness, all of the frame's size.
    pub(super) fn new(
        blur: &'a Blur<'a>,
        (capture, saturated, brightness): (ArrayView2<'a, f32>, &Array2<bool>, ArrayView2<'_, f32>),
        places: Places<'a>,
    ) -> Self {
        let known = Zip::from(&believed(saturated)).par_map_collect(|known| if *known { 1.0 } else { 0.0 });
        let high_pass = HighPass::new(known, brightness, HIGH_PASS_PX);
        Self { blur, capture, places, high_pass, frames: Pool::new(), planes: Pool::new() }
    }

    /// Lends a plane of the frame's size, of which stale contents are to be overwritten.
    pub(super) fn lend_frame(&self) -> Loan<'_, Array2<f32>> {
        self.frames.lend(|| Array2::zeros(self.capture.dim()))
    }

    /// Lends a plane of the places' size.
    pub(super) fn lend_plane(&self) -> Loan<'_, Array2<f32>> {
        self.planes.lend(|| Array2::zeros(self.places.may_shine.dim()))
    }

    /// The sum of squares.
    pub(super) fn misfit(&self, light: &Array2<f32>) -> f64 {
        self.residual(light).1
    }

    /// Spreads light over all places that gain by some: conjugate gradients with the exact diagonal of AᵀW²A, of which `squared` is
    /// A with the squares of the PSF.
    pub(super) fn spread(
        &self,
        light: &mut Array2<f32>,
        (steps, squared): (usize, &Blur<'_>),
        progress: &Progress,
    ) -> Result<()> {
        self.improve(light, (steps, 0.0, |slope| self.inverse_curvature(squared, slope)), progress)?;
        Ok(())
    }

    /// Lets light gather: conjugate gradients preconditioned by [`gathering`](Self::gathering), by which steps are in proportion to
    /// the light.
    pub(super) fn gather(
        &self,
        light: &mut Array2<f32>,
        (steps, gathering): (usize, &Array2<f32>),
        progress: &Progress,
    ) -> Result<()> {
        self.improve(light, (steps, 0.0, |_| gathering), progress)?;
        Ok(())
    }

    /// Lets light gather in rounds of some steps; a round ends as soon as a step lowers the misfit by less than a part of it. Returns
    /// the misfit before, and after the steps, which is that of the light but for places that these took below the least.
    pub(super) fn gather_in_rounds(
        &self,
        light: &mut Array2<f32>,
        (rounds, steps, least): (usize, usize, f64),
        progress: &Progress,
    ) -> Result<[f64; 2]> {
        let mut misfits: Option<[f64; 2]> = None;
        for _ in 0..rounds {
            let gathering = self.gathering(light);
            let [before, after] = self.improve(light, (steps, least, |_| &gathering), progress)?;
            misfits = Some([misfits.map_or(before, |[before, _]| before), after]);
        }
        Ok(misfits.unwrap_or_else(|| [self.misfit(light); 2]))
    }

    /// `s/(AᵀW²A s)` of the light s above the least (De Pierro 1995).
    pub(super) fn gathering(&self, light: &Array2<f32>) -> Array2<f32> {
        let Places { may_shine, at_least, seed } = self.places;
        let mut above = self.lend_plane();
        Zip::from(&mut *above).and(light).and(may_shine).par_for_each(|above, light, may_shine| {
            *above = if *may_shine { light - at_least + seed } else { 0.0 };
        });
        let mut image = self.lend_frame();
        self.blur.apply(&above, &mut image);
        Zip::from(&mut *image).and(&self.high_pass.weights).par_for_each(|image, w| *image *= w * w);
        let mut curvature = self.lend_plane();
        self.blur.transpose(&image, &mut curvature);
        let most = largest(curvature.view());
        let least = (LEAST_CURVATURE * most).max(f32::MIN_POSITIVE);
        Zip::from(&*above).and(&*curvature).par_map_collect(|above, c| above / c.max(least))
    }

    /// The norm of the weighted flare of unit light at each place: how well it is seen. `squared` is A with the squares of the PSF.
    pub(super) fn visibility(&self, squared: &Blur<'_>) -> Array2<f32> {
        let weights = &self.high_pass.weights;
        let mut squares = Array2::zeros(self.places.may_shine.dim());
        squared.transpose(&(weights * weights), &mut squares);
        squares.par_mapv_inplace(|square| square.max(0.0).sqrt());
        squares
    }

    /// `w·h(A s)`.
    pub(super) fn seen(&self, light: &Array2<f32>) -> Loan<'_, Array2<f32>> {
        let [mut image, mut seen] = [(); 2].map(|()| self.lend_frame());
        self.blur.apply(light, &mut image);
        self.high_pass.pass(&image, &mut seen);
        seen
    }

    /// `w·h(y − A s)`, and the sum of its squares.
    pub(super) fn residual(&self, light: &Array2<f32>) -> (Loan<'_, Array2<f32>>, f64) {
        let mut residual = self.lend_frame();
        let misfit = self.write_residual(light, &mut residual);
        (residual, misfit)
    }

    /// Writes `w·h(y − A s)`; returns the sum of its squares.
    pub(super) fn write_residual(&self, light: &Array2<f32>, residual: &mut Array2<f32>) -> f64 {
        let mut left = self.lend_frame();
        self.blur.apply(light, &mut left);
        Zip::from(&mut *left).and(self.capture).par_for_each(|left, y| *left = y - *left);
        self.high_pass.pass(&left, residual)
    }

    /// Takes some steps with one preconditioner, which may depend on the slope at the first; the one that lowers the misfit by less
    /// than the `least` part of it is the last. Returns the misfit before and after the steps.
    fn improve<P: std::borrow::Borrow<Array2<f32>>>(
        &self,
        light: &mut Array2<f32>,
        (steps, least, preconditioner): (usize, f64, impl FnOnce(&Array2<f32>) -> P),
        progress: &Progress,
    ) -> Result<[f64; 2]> {
        let blur = self.blur;
        let (mut residual, before) = self.residual(light);
        let mut misfit = before;
        let [mut turned, mut direction] = [(); 2].map(|()| self.lend_plane());
        self.high_pass.back(blur, &residual, &mut turned);
        let inverse = preconditioner(&turned);
        let inverse = inverse.borrow();
        Zip::from(&mut *direction).and(inverse).and(&*turned).par_for_each(|d, p, g| *d = p * g);
        let mut slope = inner(&turned, &direction);
        let [mut image, mut passed] = [(); 2].map(|()| self.lend_frame());
        for step in 1..=steps {
            progress.check()?;
            blur.apply(&direction, &mut image);
            let curvature = self.high_pass.pass(&image, &mut passed);
            if !(slope > LEAST_SLOPE && curvature > 0.0) {
                break;
            }
            let (length, gain) = (narrow(slope / curvature), slope * slope / curvature);
            let is_last = step == steps || gain < least * misfit;
            misfit -= gain;
            if is_last {
                add_scaled(light, length, &direction);
                break;
            }
            add_scaled(&mut residual, -length, &passed);
            let turn = |y: usize, gradient: &[f32], out: &mut [f32]| turn(out, gradient, row(inverse, y));
            let next = self.high_pass.back_into(blur, &residual, (&mut turned, turn));
            let kept = narrow(next / slope);
            Zip::from(&mut *light).and(&mut *direction).and(&*turned).par_for_each(|light, d, z| {
                *light += length * *d;
                *d = z + kept * *d;
            });
            slope = next;
        }
        let Places { may_shine, at_least, .. } = self.places;
        Zip::from(light).and(may_shine).par_for_each(|light, may_shine| {
            if *may_shine {
                *light = light.max(at_least);
            }
        });
        Ok([before, misfit])
    }

    /// The inverse of the diagonal of AᵀW²A, which is the correlation of w² with k², at the places that gain by some light.
    fn inverse_curvature(&self, squared: &Blur<'_>, slope: &Array2<f32>) -> Array2<f32> {
        let (weights, places) = (&self.high_pass.weights, self.places.may_shine);
        let mut inverse = Array2::zeros(places.dim());
        squared.transpose(&(weights * weights), &mut inverse);
        let least = (LEAST_CURVATURE * largest(inverse.view())).max(f32::MIN_POSITIVE);
        Zip::from(&mut inverse).and(places).and(slope).par_for_each(|curvature, may_shine, slope| {
            *curvature = if *may_shine && *slope > 0.0 { 1.0 / curvature.max(least) } else { 0.0 };
        });
        inverse
    }
}

vectorised! {
    /// Writes a row of the gradient times what is known of the inverse; returns its part of their inner product.
    fn turn<'a>(out: &'a mut [f32], gradient: &'a [f32], inverse: &'a [f32]) -> f64 {
        out.iter_mut().zip(gradient).zip(inverse).for_each(|((z, g), p)| *z = p * g);
        dot(out, gradient)
    }
}

/// The pixels of a capture that tell flare, of those that are saturated.
pub(super) fn believed(saturated: &Array2<bool>) -> Array2<bool> {
    let mut around = grown(saturated, GUARD_PX);
    around.par_mapv_inplace(|is_around| !is_around);
    around
}

/// The largest number of a plane, or zero.
pub(super) fn largest(plane: ArrayView2<'_, f32>) -> f32 {
    let of_row = |row: ArrayView1<'_, f32>| row.iter().fold(0.0, |most: f32, value| most.max(*value));
    plane.axis_iter(Axis(0)).into_par_iter().map(of_row).reduce(|| 0.0, f32::max)
}

/// A set with the pixels that are at most so many steps along rows and columns away.
pub(super) fn grown(set: &Array2<bool>, steps: usize) -> Array2<bool> {
    let mut grown = set.clone();
    let mut once_more = Array2::default((0, 0));
    for step in 0..steps {
        let before = if step == 0 {
            set
        } else {
            once_more.clone_from(&grown);
            &once_more
        };
        Zip::indexed(grown.rows_mut()).par_for_each(|y, mut out| {
            let (here, out) = (row(before, y), out.as_slice_mut().expect("planes are contiguous"));
            unite(&mut out[1..], here);
            unite(out, &here[1..]);
            for beside in [y.checked_sub(1), (y + 1 < before.nrows()).then_some(y + 1)].into_iter().flatten()
            {
                unite(out, row(before, beside));
            }
        });
    }
    grown
}

fn unite(members: &mut [bool], with: &[bool]) {
    members.iter_mut().zip(with).for_each(|(member, other)| *member |= other);
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_grows_by_steps_along_rows_and_columns() {
        let mut set = Array2::from_elem((5, 7), false);
        set[[0, 3]] = true;
        let found = grown(&set, 2);
        assert!(found.indexed_iter().all(|((y, x), member)| *member == (y + x.abs_diff(3) <= 2)), "{found}");
    }
}
