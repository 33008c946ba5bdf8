//! Fits the light of lamps to their flare, whatever else a few given planes explain.

use ndarray::{Array2, Zip};

use super::super::frame::Blur;
use super::super::sums::{add_scaled, inner};
use super::scene::Scene;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// The part of the largest curvature below which a pixel's light is not told by the flare.
const LEAST_CURVATURE: f32 = 1e-12;

/// The least squares of lamps in a scene.
pub(super) struct LampFit<'a> {
    /// The inverse of the diagonal of AᵀW²A at lamps, zero elsewhere.
    inverse: Array2<f32>,
    progress: &'a Progress,
}

impl<'a> LampFit<'a> {
    /// Prepares fits; `squared` blurs by the squares of the PSF, near enough to that of each fit.
    pub(super) fn new(scene: &Scene, squared: &Blur<'_>, progress: &'a Progress) -> Self {
        let weights = &scene.high_pass.weights;
        let mut diagonal = scene.frame.plane();
        squared.transpose(&(weights * weights), &mut diagonal);
        let most = diagonal.iter().fold(f32::MIN_POSITIVE, |most, value| most.max(*value));
        let inverse = Zip::from(&diagonal)
            .and(&scene.lamps)
            .par_map_collect(|value, lamp| if *lamp { 1.0 / value.max(LEAST_CURVATURE * most) } else { 0.0 });
        Self { inverse, progress }
    }

    /// Improves `light`, which is no less than the scene's base, by steps of conjugate gradients.
    ///
    /// # Equation
    /// Minimises `|Q w h(y − A x)|²` over x ≥ base at lamps, Q taking away what the orthonormal `columns` explain: the light that
    /// is best when the columns have what they ask for.
    pub(super) fn improve(
        &self,
        (scene, blur): (&Scene, &Blur<'_>),
        columns: &[Array2<f32>],
        light: &mut Array2<f32>,
        steps: usize,
    ) -> Result<()> {
        let mut residual = scene.left(blur, light);
        Scene::project_out(&mut residual, columns);
        let mut gradient = scene.frame.plane();
        scene.high_pass.back(blur, &residual, &mut gradient);
        let mut inverse = self.inverse.clone();
        Zip::from(&mut inverse).and(&gradient).and(&*light).and(&scene.base).par_for_each(
            |inverse, gradient, light, base| {
                if *gradient <= 0.0 && light <= base {
                    *inverse = 0.0;
                }
            },
        );
        self.descend((scene, blur), (columns, &inverse), (&mut residual, light), steps)?;
        Zip::from(light).and(&scene.base).par_for_each(|light, base| *light = light.max(*base));
        Ok(())
    }

    /// What no light of the lamps that shine in `light` explains of a plane of `w·h(…)`.
    pub(super) fn unexplained(
        &self,
        (scene, blur): (&Scene, &Blur<'_>),
        mut plane: Array2<f32>,
        light: &Array2<f32>,
        steps: usize,
    ) -> Result<Array2<f32>> {
        let shines = |inverse: &f32, light: &f32, base: &f32| if light > base { *inverse } else { 0.0 };
        let inverse = Zip::from(&self.inverse).and(light).and(&scene.base).par_map_collect(shines);
        self.descend((scene, blur), (&[], &inverse), (&mut plane, &mut scene.frame.plane()), steps)?;
        Ok(plane)
    }

    fn descend(
        &self,
        (scene, blur): (&Scene, &Blur<'_>),
        (columns, inverse): (&[Array2<f32>], &Array2<f32>),
        (residual, light): (&mut Array2<f32>, &mut Array2<f32>),
        steps: usize,
    ) -> Result<()> {
        let mut gradient = scene.frame.plane();
        scene.high_pass.back(blur, residual, &mut gradient);
        let mut direction = inverse * &gradient;
        let mut slope = inner(&gradient, &direction);
        for _ in 0..steps {
            self.progress.check()?;
            let mut image = scene.seen(blur, &direction);
            Scene::project_out(&mut image, columns);
            let curvature = inner(&image, &image);
            if !(slope > 0.0 && curvature > 0.0) {
                break;
            }
            let length = narrow(slope / curvature);
            add_scaled(light, length, &direction);
            add_scaled(residual, -length, &image);
            scene.high_pass.back(blur, residual, &mut gradient);
            let turned = Zip::from(inverse).and(&gradient).par_map_collect(|p, g| p * g);
            let next = inner(&gradient, &turned);
            let kept = narrow(next / slope);
            Zip::from(&mut direction).and(&turned).par_for_each(|d, z| *d = z + kept * *d);
            slope = next;
        }
        Ok(())
    }
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}
