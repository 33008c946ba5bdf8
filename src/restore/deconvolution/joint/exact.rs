//! Inverts captures without noise and without light from outside.

use ndarray::{Array2, ArrayView2, Zip};

use super::conjugate::inner;
use super::frame::Blur;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Steps at most.
const STEPS: usize = 20;

/// Relative misfit, root mean square, at which a noise-free capture is explained: 80 dB.
const EXPLAINED: f64 = 1e-4;

/// The floor of |H|² in the inverse, which is at most 1/(2√ε) = 50 times a residual.
const LEAST_POWER: f32 = 1e-4;

/// `x ← max(0, x + B(y − A x))`, B the regularised inverse, as long as that explains the capture better.
///
/// Where there is neither noise nor light from outside, some steps of it solve to many digits.
pub(super) fn exact_inverse(
    blur: &Blur<'_>,
    capture: ArrayView2<'_, f32>,
    brightness: &Array2<f32>,
    progress: &Progress,
) -> Result<Array2<f32>> {
    let ones = Array2::ones(capture.dim());
    let mut scene = capture.mapv(|y| y.max(0.0));
    let (mut best, mut least) = (scene.clone(), f64::INFINITY);
    let [mut residual, mut step] = [(); 2].map(|()| Array2::zeros(capture.dim()));
    for _ in 0..STEPS {
        progress.check()?;
        blur.apply(&scene, &mut residual);
        Zip::from(&mut residual).and(capture).par_for_each(|r, y| *r = y.max(0.0) - *r);
        Zip::from(&mut step).and(&residual).and(brightness).par_for_each(|relative, r, n| *relative = r / n);
        let misfit = inner(&step, &step);
        if misfit >= least {
            break;
        }
        least = misfit;
        best.assign(&scene);
        if misfit <= EXPLAINED.powi(2) * capture.len() as f64 {
            break;
        }
        blur.invert(&residual, &ones, |power, _| 1.0 / (power + LEAST_POWER), &mut step);
        Zip::from(&mut scene).and(&step).par_for_each(|x, step| *x = (*x + step).max(0.0));
    }
    Ok(best)
}
