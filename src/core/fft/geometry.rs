//! Places an image and a kernel on one axis of a transform, so that the wrap-around of the circular
//! convolution never reaches a pixel that is kept.

use super::Boundary;
use crate::kernels::fourier::is_smooth;

/// One axis of a convolution: where the scene lies in the transform and where each kernel sample wraps to.
///
/// With a kernel of K samples about index c = K // 2, `out[i] = Σ k[c + d] · scene[i − d]` over the offsets
/// d from −`before` to `after`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct AxisGeometry {
    /// Pixels of the scene.
    pub(super) scene: usize,
    /// Samples of the kernel.
    pub(super) kernel: usize,
    /// Length of the transform.
    pub(super) transform: usize,
    /// Pixels of the scene with its border.
    pub(super) extended: usize,
    /// Index of the scene's first pixel in the extended scene.
    pub(super) lead: usize,
    /// Offsets below 0 that the kernel uses.
    before: usize,
    /// Offsets above 0 that the kernel uses.
    after: usize,
    boundary: Boundary,
}

impl AxisGeometry {
    /// Places `scene` pixels and `kernel` samples, both at least 1.
    ///
    /// - Zero: kept pixels lie in `0..scene`, so a wrapped offset must exceed every distance of two of them:
    ///   `scene + max(before, after)` samples do, `scene + kernel − 1` are not needed. Offsets of `scene` or
    ///   more never meet a pixel and are left out.
    /// - Replicate and reflect: the border is written out, `after` pixels in front and `before` behind; the
    ///   wrap-around spoils only the border.
    /// - Periodic: the wrap-around is the boundary.
    pub(super) fn new(scene: usize, kernel: usize, boundary: Boundary) -> Self {
        let (mut before, mut after) = (kernel / 2, kernel - 1 - kernel / 2);
        let (extended, lead, needed) = match boundary {
            Boundary::Zero => {
                before = before.min(scene - 1);
                after = after.min(scene - 1);
                (scene, 0, scene + before.max(after))
            }
            Boundary::Replicate | Boundary::Reflect => {
                (scene + before + after, after, scene + before + after)
            }
            Boundary::Periodic => (scene, 0, scene),
        };
        let transform = if boundary == Boundary::Periodic { needed } else { fast_length(needed) };
        Self { scene, kernel, transform, extended, lead, before, after, boundary }
    }

    /// The pixel of the scene that stands at `index` of the extended scene.
    pub(super) fn source(&self, index: usize) -> usize {
        let position = index.cast_signed() - self.lead.cast_signed();
        let last = self.scene.cast_signed() - 1;
        let source = match self.boundary {
            Boundary::Replicate => position.clamp(0, last),
            Boundary::Reflect if last > 0 => {
                let phase = position.rem_euclid(2 * last);
                phase.min(2 * last - phase)
            }
            Boundary::Reflect => 0,
            Boundary::Zero | Boundary::Periodic => position,
        };
        source.cast_unsigned()
    }

    /// The pixels of the scene that make up the extended scene.
    pub(super) fn sources(&self) -> impl Iterator<Item = usize> {
        (0..self.extended).map(|index| self.source(index))
    }

    /// The kernel samples in use, first to last, each with its place in the transform.
    pub(super) fn kernel_places(&self) -> Vec<(usize, usize)> {
        let centre = self.kernel / 2;
        (centre - self.before..=centre + self.after)
            .map(|sample| {
                let offset = sample.cast_signed() - centre.cast_signed();
                (sample, offset.rem_euclid(self.transform.cast_signed()).cast_unsigned())
            })
            .collect()
    }
}

/// The length of at least `needed` whose transform is fast: a product of 2, 3 and 5, and from 64 on a
/// multiple of 16, which the vectorised butterflies want (1200 = 2⁴·3·5² takes half the time of 1250 = 2·5⁴).
///
/// # Panics
/// Never for lengths below half of `usize`: there is a power of two above.
pub fn fast_length(needed: usize) -> usize {
    let step = if needed >= 64 { 16 } else { 1 };
    let first = needed.max(1).div_ceil(step) * step;
    (first..).step_by(step).find(|&length| is_smooth(length)).expect("there is a power of two above")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pads_no_more_than_the_kept_pixels_need() {
        assert_eq!(AxisGeometry::new(800, 800, Boundary::Zero).transform, 1200);
        assert_eq!(AxisGeometry::new(800, 801, Boundary::Zero).transform, 1200);
        assert_eq!(AxisGeometry::new(100, 5000, Boundary::Zero).transform, fast_length(199));
        assert_eq!(AxisGeometry::new(800, 800, Boundary::Reflect).transform, 1600);
        assert_eq!(AxisGeometry::new(797, 800, Boundary::Periodic).transform, 797);
    }

    #[test]
    fn fast_lengths_are_enough_and_smooth() {
        assert_eq!([1, 7, 11, 63, 65, 1201].map(fast_length), [1, 8, 12, 64, 80, 1280]);
    }

    #[test]
    fn continues_the_scene_as_each_boundary_says() {
        let sources = |boundary| {
            let axis = AxisGeometry::new(4, 7, boundary);
            (0..axis.extended).map(|index| axis.source(index)).collect::<Vec<_>>()
        };
        assert_eq!(sources(Boundary::Replicate), [0, 0, 0, 0, 1, 2, 3, 3, 3, 3]);
        assert_eq!(sources(Boundary::Reflect), [3, 2, 1, 0, 1, 2, 3, 2, 1, 0]);
        assert_eq!(sources(Boundary::Zero), [0, 1, 2, 3]);
        let far = AxisGeometry::new(2, 9, Boundary::Reflect);
        let mirrored: Vec<_> = (0..far.extended).map(|index| far.source(index)).collect();
        assert_eq!(mirrored, [0, 1, 0, 1, 0, 1, 0, 1, 0, 1]);
        let single = AxisGeometry::new(1, 3, Boundary::Reflect);
        assert_eq!((0..3).map(|index| single.source(index)).collect::<Vec<_>>(), [0, 0, 0]);
    }
}
