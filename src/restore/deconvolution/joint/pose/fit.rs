//! Fits the light of lamps to their flare, whatever else a few given planes explain.

use ndarray::{Array2, Zip};

use super::super::fit::largest;
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
        let least = (LEAST_CURVATURE * largest(diagonal.view())).max(f32::MIN_POSITIVE);
        let inverse = Zip::from(&diagonal)
            .and(&scene.lamps)
            .par_map_collect(|value, lamp| if *lamp { 1.0 / value.max(least) } else { 0.0 });
        Self { inverse, progress }
    }

    /// Spreads light over all lamps that gain by some, by steps of conjugate gradients.
    ///
    /// # Equation
    /// Minimises `|w h(y − A x)|²` over x ≥ 0 at lamps.
    pub(super) fn spread(
        &self,
        (scene, blur): (&Scene, &Blur<'_>),
        light: &mut Array2<f32>,
        steps: usize,
    ) -> Result<()> {
        let mut residual = scene.left(blur, light);
        let mut gradient = scene.frame.plane();
        scene.high_pass.back(blur, &residual, &mut gradient);
        let mut inverse = self.inverse.clone();
        Zip::from(&mut inverse).and(&gradient).and(&*light).par_for_each(|inverse, gradient, light| {
            if *gradient <= 0.0 && *light <= 0.0 {
                *inverse = 0.0;
            }
        });
        self.descend((scene, blur), (&[], &inverse), (&mut residual, light), steps)
    }

    /// Lets light gather where its flare tells it to be, by steps of conjugate gradients that are in proportion to it.
    ///
    /// # Equation
    /// Minimises `|Q w h(y − A x)|²` over x ≥ 0 at lamps, Q taking away what the orthonormal `columns` explain: the light that is best
    /// when the columns have what they ask for. Preconditioned by [`gathering`](Self::gathering).
    pub(super) fn gather(
        &self,
        (scene, blur): (&Scene, &Blur<'_>),
        columns: &[Array2<f32>],
        light: &mut Array2<f32>,
        steps: usize,
    ) -> Result<()> {
        let mut residual = scene.left(blur, light);
        Scene::project_out(&mut residual, columns);
        let inverse = Self::gathering((scene, blur), light, scene.seed);
        self.descend((scene, blur), (columns, &inverse), (&mut residual, light), steps)
    }

    /// What no light of the lamps that shine in `light` explains of a plane of `w·h(…)`.
    pub(super) fn unexplained(
        &self,
        (scene, blur): (&Scene, &Blur<'_>),
        mut plane: Array2<f32>,
        light: &Array2<f32>,
        steps: usize,
    ) -> Result<Array2<f32>> {
        let inverse = Self::gathering((scene, blur), light, 0.0);
        // What is taken away may be less than no light.
        let mut taken = scene.frame.plane();
        self.steps((scene, blur), (&[], &inverse), (&mut plane, &mut taken), steps)?;
        Ok(plane)
    }

    /// `s/(AᵀW²A s)` of a light s at lamps, a `seed` included (De Pierro 1995).
    fn gathering((scene, blur): (&Scene, &Blur<'_>), light: &Array2<f32>, seed: f32) -> Array2<f32> {
        let mut light = light.clone();
        Zip::from(&mut light).and(&scene.lamps).par_for_each(|light, lamp| {
            *light = if *lamp { *light + seed } else { 0.0 };
        });
        let (mut image, mut curvature) = (Array2::zeros(scene.frame.size()), scene.frame.plane());
        blur.apply(&light, &mut image);
        Zip::from(&mut image).and(&scene.high_pass.weights).par_for_each(|image, w| *image *= w * w);
        blur.transpose(&image, &mut curvature);
        let least = (LEAST_CURVATURE * largest(curvature.view())).max(f32::MIN_POSITIVE);
        Zip::from(&mut light).and(&curvature).par_for_each(|light, c| *light /= c.max(least));
        light
    }

    /// As [`steps`](Self::steps), to a light that is none below zero.
    fn descend(
        &self,
        of: (&Scene, &Blur<'_>),
        known: (&[Array2<f32>], &Array2<f32>),
        (residual, light): (&mut Array2<f32>, &mut Array2<f32>),
        steps: usize,
    ) -> Result<()> {
        self.steps(of, known, (residual, &mut *light), steps)?;
        light.par_mapv_inplace(|light| light.max(0.0));
        Ok(())
    }

    fn steps(
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
