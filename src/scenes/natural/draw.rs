//! Turns a stream of random numbers into a painter's choices: sizes, counts, places.

use rand::RngExt as _;

use super::film::Point;
use crate::core::rng::Rng;

/// The choices of one scene, in the order in which they are asked for.
pub(super) struct Draw(pub(super) Rng);

impl Draw {
    /// A number between two others, whichever is the larger.
    pub(super) fn uniform(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.0.random::<f32>()
    }

    /// A positive number, its logarithm uniform between those of two others.
    pub(super) fn log(&mut self, from: f32, to: f32) -> f32 {
        self.uniform(from.ln(), to.ln()).exp()
    }

    /// A radius of density r⁻³, which covers as much area in every octave: the law of natural objects' sizes.
    ///
    /// # Source
    /// Lee, Mumford & Huang, "Occlusion models for natural images", IJCV 41 (2001).
    pub(super) fn power_law(&mut self, [smallest, largest]: [f32; 2]) -> f32 {
        self.uniform(smallest.powi(-2), largest.powi(-2)).powf(-0.5)
    }

    /// A number of mean 0 and variance 1, nearly normal: the sum of twelve uniform ones.
    pub(super) fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.0.random::<f32>()).sum::<f32>() - 6.0
    }

    /// Whether something of the given probability happens.
    pub(super) fn chance(&mut self, probability: f32) -> bool {
        self.0.random::<f32>() < probability
    }

    /// A whole number, both ends included.
    pub(super) fn count(&mut self, from: usize, to: usize) -> usize {
        self.0.random_range(from..=to.max(from))
    }

    /// One of several values.
    pub(super) fn pick<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.0.random_range(0..values.len())]
    }

    /// An angle in radians.
    pub(super) fn angle(&mut self) -> f32 {
        self.uniform(0.0, std::f32::consts::TAU)
    }

    /// A point of an image of height and width, or up to `beyond` outside of it.
    pub(super) fn point(&mut self, [height, width]: [f32; 2], beyond: f32) -> Point {
        [self.uniform(-beyond, width + beyond), self.uniform(-beyond, height + beyond)]
    }
}

/// Mean area of discs with radii of [`Draw::power_law`].
pub(super) fn mean_disc_area([smallest, largest]: [f32; 2]) -> f32 {
    std::f32::consts::TAU * (largest / smallest).ln() / (smallest.powi(-2) - largest.powi(-2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng;

    #[test]
    fn radii_follow_the_power_law() {
        let mut draw = Draw(rng::stream(1, "test"));
        let radii: Vec<f32> = (0..40_000).map(|_| draw.power_law([1.0, 64.0])).collect();
        assert!(radii.iter().all(|r| (1.0..=64.001).contains(r)));
        // P(r > 4) = (4⁻² − 64⁻²)/(1 − 64⁻²), six standard deviations of 40 000 draws.
        let share = radii.iter().filter(|r| **r > 4.0).count() as f32 / 4e4;
        assert!((share - 0.0623).abs() < 6.0 * (0.0623f32 * 0.94 / 4e4).sqrt(), "{share}");
        // Octaves share the area evenly, so that few large discs hold much of the mean: a tenth is its error here.
        let mean = radii.iter().map(|r| std::f32::consts::PI * r * r).sum::<f32>() / 4e4;
        assert!((mean / mean_disc_area([1.0, 64.0]) - 1.0).abs() < 0.1, "{mean}");
    }
}
