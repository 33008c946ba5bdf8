//! Finds large light around a frame, such as a window that the frame cuts in two, whose haze the scene would be taken for.
//!
//! Haze is smooth, and so can be light within the frame as well as beyond it: steps that begin with all of it in the frame leave it
//! there. What tells the two apart is how even the scene is without it.
//!
//! # Method
//! At reduced resolution, where steps cost next to nothing:
//! 1. The light beyond the border that explains as much of the capture as it can: what it leaves may be the frame's own light, and
//!    counts little; what it has beyond the capture cannot, and counts in full.
//! 2. The scene is restored with that light around the frame, and with what the frame goes on to. Haze is smooth: where the former
//!    varies less on a large scale, the haze lies to one side, some of what throws it is seen at the border, and all colours tell one
//!    light, it is taken to be there. A bright scene that is darkened towards the border varies more; a sky that is darkened may vary less after tone mapping, but
//!    what would take its place is nowhere seen.

use ndarray::{Array2, ArrayView1, ArrayView2, Axis, Zip};
use rayon::prelude::*;

use super::channel::first_smoothness;
use super::coarse::{between_blocks, mean_of_blocks};
use super::conjugate::{Preconditioner, Room, System};
use super::frame::{Blur, Frame, LEAST_POWER};
use super::known::{Known, NEAR_PX};
use super::noise_level::{NOISE_FREE, NoiseLevel};
use super::prior::{Edges, Prior};
use super::smooth::local_mean;
use super::sums::inner;
use crate::core::error::Result;
use crate::core::fft::Damping;
use crate::core::progress::Progress;

/// Sides down to which a frame is halved, in pixels: from there on haze is told from what throws it by few of them.
const HALVED_SIDE: usize = 64;

/// Sides of the reduced frame and of the reduced PSF that tell anything, in pixels.
const LEAST_SIDE: usize = 32;
const LEAST_PSF_SIDE: usize = 9;

/// What the square of light that the frame itself may have counts, that of light beyond the capture being one: with a tenth the
/// softboxes' haze is explained too well, with a thousandth too little.
const UNEXPLAINED: f32 = 1e-2;

/// The weight of squares of differences of neighbours beyond the border, relative to the frame's mean: hardly any, so that noise does
/// not shine there.
const EVENNESS: f32 = 1e-5;

/// Rounds, each with the pixels that explain too much in the one before, and steps in each: twice as many explain the same to 5 %.
const EFFORT: [usize; 2] = [10, 8];

/// Standard deviation of the bell that a scene's variation is looked at through, in pixels of reduced resolution: a tenth of a frame's
/// side at most, far below which are the scene's own edges.
const LARGE_PX: f32 = 3.0;

/// What is left of the variation at most where light is taken to come from around. Fourteen captures by softboxes that the frame cuts in
/// two have 0.40 to 0.86 of it, of 60 others and 60 by another simulator all have 0.95 and more; but of 101 more a sky through two panels
/// has 0.77 and 0.83, a night 0.79: as dark as they would be without that haze, they vary little.
const MOST_VARIATION: f64 = 0.9;

/// The contrast of the haze over the frame, times how bright the frame is at its border beside the brightest light beyond it, at least: light
/// that the frame cuts in two throws its haze to one side, and some of it is seen there. Eight such captures have 0.22 to 0.48 (a contrast
/// of 1.9 to 3.9, and 0.09 to 0.22 of the light), that sky and that night 0.02 to 0.08, strips of sky above a dark roof, which is their own
/// haze, 0.10 to 0.16.
const LEAST_CUT: f64 = 0.19;

/// How far from 1 the cosine of the angle between the light's planes of two colours may be, as a part of what the scene varies less: there is
/// one such light, and colours that tell several fit their own scene's detail. Ten captures of such light have 0.03 to 0.27; a street
/// through rows of lines, whose grain was taken for haze, 1.08, and came to 18.1 dB (`constrained`: 25.4).
const UNLIKENESS: f64 = 0.4;

/// Pixels of the border that may be brighter than what is seen there.
const OUTLIERS: usize = 2;

/// A channel at reduced resolution.
struct Reduced {
    capture: Array2<f32>,
    psf: Array2<f32>,
}

/// The light around a frame that explains most of a channel, and what tells whether it is there.
struct Look {
    light: Array2<f32>,
    /// How the scene varies as it is restored with what the frame goes on to around it, and with that light.
    own: f64,
    without: f64,
    /// The contrast of the light's haze over the frame.
    contrast: f64,
    /// How bright the frame is at its border beside that light.
    seen: f64,
}

/// Light around a frame.
pub(super) struct Around {
    halvings: usize,
    /// The frame at reduced resolution.
    frame: Frame,
    /// The light of each channel at reduced resolution, whole planes.
    planes: Vec<Array2<f32>>,
}

impl Around {
    /// Finds the light around a frame of several channels; none where their scenes vary more with it, they do not tell one light, nothing
    /// is unknown around the frame, pixels are saturated, which may be what throws the haze, or there is no noise.
    ///
    /// # Errors
    /// As [`Frame::blur`]; [`Error::Interrupted`](crate::core::error::Error::Interrupted) between steps.
    pub(super) fn of(
        frame: &Frame,
        (known, noise): (&[Known<'_>], &[NoiseLevel]),
        progress: &Progress,
    ) -> Result<Option<Self>> {
        let is_noisy = noise.iter().all(|noise| noise.middle() > NOISE_FREE);
        if !frame.has_surrounding() || !is_noisy || known.iter().any(Known::is_saturated) {
            return Ok(None);
        }
        let [height, width] = frame.size();
        let mut halvings = 0;
        while height.min(width) >> halvings >= HALVED_SIDE {
            halvings += 1;
        }
        let reduced: Vec<_> = known.iter().map(|known| Reduced::of(known, halvings)).collect();
        let Some(Reduced { capture, psf }) = reduced.first() else { return Ok(None) };
        let (size, of_psf) = ([capture.nrows(), capture.ncols()], [psf.nrows(), psf.ncols()]);
        if size.into_iter().min() < Some(LEAST_SIDE) || of_psf.into_iter().min() < Some(LEAST_PSF_SIDE) {
            return Ok(None);
        }
        let coarse = frame.surrounded_like(size, of_psf);
        // Planes are small, and channels are worked on side by side.
        let looks = reduced.par_iter().zip(known).zip(noise).map(|((reduced, known), noise)| {
            Look::at(reduced, &coarse, (known.config.alpha, first_smoothness(noise)), progress)
        });
        let looks = looks.collect::<Result<Vec<_>>>()?;
        let is_around = are_believed(&looks);
        let planes = looks.into_iter().map(|look| look.light).collect();
        Ok(is_around.then_some(Self { halvings, frame: coarse, planes }))
    }

    /// The light around a `frame` in one channel, zero within it.
    fn plane(&self, frame: &Frame, channel: usize) -> Array2<f32> {
        let places: [Vec<Option<usize>>; 2] = std::array::from_fn(|axis| {
            let [of_frame, whole] = [frame.size()[axis], frame.plane_size()[axis]];
            let [of_coarse, coarse] = [self.frame.size()[axis], self.frame.plane_size()[axis]];
            let place = |at: usize| {
                // What is before the frame stands at the end of the plane.
                let (behind, before) = (at.checked_sub(of_frame)?, whole - 1 - at);
                Some(match behind <= before {
                    true => (of_coarse + (behind >> self.halvings)).min(coarse - 1),
                    false => (coarse - 1 - (before >> self.halvings)).max(of_coarse),
                })
            };
            (0..whole).map(place).collect()
        });
        let [rows, columns] = places;
        let within = |at: usize| at >> self.halvings;
        Array2::from_shape_fn(frame.plane_size(), |(y, x)| match (rows[y], columns[x]) {
            (None, None) => 0.0,
            (row, column) => {
                self.planes[channel][[row.unwrap_or_else(|| within(y)), column.unwrap_or_else(|| within(x))]]
            }
        })
    }

    /// The first scene of a channel with this light around it.
    pub(super) fn scene(
        &self,
        blur: &Blur<'_>,
        (known, brightness): (&Known<'_>, &Array2<f32>),
        smoothness: f32,
    ) -> Array2<f32> {
        let light = self.plane(blur.frame, known.channel);
        let rest = rest_of(blur, known.capture, &light);
        let mut scene = blur.first_inverse(&blur.frame.surround(rest.view()), brightness, smoothness);
        let [height, width] = blur.frame.size();
        Zip::indexed(&mut scene).and(&light).par_for_each(|(y, x), scene, light| {
            if y >= height || x >= width {
                *scene = *light;
            }
        });
        scene
    }
}

impl Look {
    fn at(
        Reduced { capture, psf }: &Reduced,
        frame: &Frame,
        (alpha, smoothness): (f32, f32),
        progress: &Progress,
    ) -> Result<Self> {
        let blur = frame.blur(psf.view())?;
        let surrounded = frame.surround(capture.view());
        let brightness = local_mean(&surrounded, NEAR_PX).mapv_into(|mean| mean + alpha);
        let variation_of = |capture: ArrayView2<'_, f32>| {
            let scene = inverse(&blur, (capture, &brightness), smoothness);
            variation(frame.cut(&scene), alpha)
        };
        let light = most_around(&blur, (capture, &brightness), alpha, progress)?;
        let rest = rest_of(&blur, capture.view(), &light);
        Ok(Self {
            own: variation_of(capture.view()),
            without: variation_of(rest.view()),
            contrast: contrast_of(&(capture - &rest)),
            seen: share_seen(capture, &light),
            light,
        })
    }
}

impl Reduced {
    fn of(known: &Known<'_>, halvings: usize) -> Self {
        let (mut capture, mut psf) = (known.capture.to_owned(), known.psf.to_owned());
        for _ in 0..halvings {
            (capture, psf) = (mean_of_blocks(capture.view()), between_blocks(psf.view()));
        }
        Self { capture, psf }
    }
}

/// Light beyond the border that explains as much of a capture as it can.
///
/// # Equation
/// The least `Σ W·t(r)·r² + μ·v²·Σ (o − o′)²` over o ≥ 0, zero within the frame, with `r = y − A o`, `t = 0.01` where r is above zero
/// and 1 below (an expectile: Newey, Powell 1987), W the inverse square of the local brightness, v that of the mean, o′ the next pixels.
fn most_around(
    blur: &Blur<'_>,
    (capture, brightness): (&Array2<f32>, &Array2<f32>),
    alpha: f32,
    progress: &Progress,
) -> Result<Array2<f32>> {
    let frame = blur.frame;
    let mut inverse_brightness = frame.plane();
    inverse_brightness.fill(1.0 / (capture.mean().unwrap_or(0.0).max(0.0) + alpha));
    frame.cut_mut(&mut inverse_brightness).fill(0.0);
    let (told, ones) = (Array2::from_elem(frame.size(), true), Array2::ones(frame.plane_size()));
    let (edges, mut weights) = (Edges::unknown(), Array2::zeros(frame.size()));
    let (mut light, mut room) = (frame.plane(), Room::new(frame));
    let [rounds, steps] = EFFORT;
    for _ in 0..rounds {
        blur.apply(&light, room.image());
        let pixels = Zip::from(&mut weights).and(&*room.image()).and(capture).and(frame.cut(brightness));
        pixels.for_each(|weight, image, y, n| {
            *weight = if y > image { UNEXPLAINED } else { 1.0 } / (n * n);
        });
        let system = System {
            blur,
            capture: capture.view(),
            weights: &weights,
            prior: Prior {
                weight: EVENNESS,
                edges: &edges,
                inverse_brightness: &inverse_brightness,
                lamps: None,
            },
            told: Some(&told),
            preconditioner: Preconditioner::Framed { brightness, around: &ones },
        };
        system.descend(&mut light, steps, (&mut room, progress))?;
    }
    Ok(light)
}

/// What light around a frame leaves of a capture.
fn rest_of(blur: &Blur<'_>, capture: ArrayView2<'_, f32>, light: &Array2<f32>) -> Array2<f32> {
    let mut rest = Array2::zeros(capture.dim());
    blur.apply(light, &mut rest);
    Zip::from(&mut rest).and(capture).par_for_each(|rest, y| *rest = y - *rest);
    rest
}

/// The first inverse of a capture that goes on around its frame, below zero too: where light around it was taken away that was not there.
fn inverse(
    blur: &Blur<'_>,
    (capture, brightness): (ArrayView2<'_, f32>, &Array2<f32>),
    smoothness: f32,
) -> Array2<f32> {
    let mut scene = blur.frame.plane();
    blur.invert(
        &blur.frame.surround(capture),
        brightness,
        Damping { smoothness, floor: LEAST_POWER },
        &mut scene,
    );
    scene *= brightness;
    scene
}

/// Whether the light that the colours tell is taken to be there.
fn are_believed(looks: &[Look]) -> bool {
    let sum = |of: fn(&Look) -> f64| looks.iter().map(of).sum::<f64>();
    let [contrast, seen] =
        [sum(|look| look.contrast), sum(|look| look.seen)].map(|sum| sum / looks.len() as f64);
    let variation = sum(|look| look.without) / sum(|look| look.own);
    variation < MOST_VARIATION
        && contrast * seen >= LEAST_CUT
        && least_likeness(looks) >= 1.0 - UNLIKENESS * (1.0 - variation)
}

/// How alike the light of two colours is, of those that are least so.
fn least_likeness(looks: &[Look]) -> f64 {
    let pairs = looks.iter().enumerate().flat_map(|(index, a)| looks[..index].iter().map(move |b| (a, b)));
    let likeness = pairs.map(|(Look { light: a, .. }, Look { light: b, .. })| {
        let lengths = (inner(a, a) * inner(b, b)).sqrt();
        if lengths > 0.0 { inner(a, b) / lengths } else { 0.0 }
    });
    likeness.fold(1.0, f64::min)
}

/// The standard deviation of an image over its mean; zero in darkness.
fn contrast_of(image: &Array2<f32>) -> f64 {
    let (mean, deviation) = (image.mean().unwrap_or(0.0), image.std(0.0));
    if mean > 0.0 { f64::from(deviation / mean) } else { 0.0 }
}

/// How bright a capture is at its border, but for [`OUTLIERS`], beside the brightest light around it; zero in darkness.
fn share_seen(capture: &Array2<f32>, light: &Array2<f32>) -> f64 {
    let (height, width) = capture.dim();
    let ends = [capture.row(0), capture.row(height - 1), capture.column(0), capture.column(width - 1)];
    let mut border: Vec<f32> = ends.iter().flatten().copied().collect();
    border.sort_unstable_by(|a, b| b.total_cmp(a));
    let brightest = light.iter().copied().fold(0.0, f32::max);
    if brightest > 0.0 { f64::from(border[OUTLIERS.min(border.len() - 1)] / brightest) } else { 0.0 }
}

/// The sum of the moduli of the differences of a tone-mapped scene's neighbours, on a large scale; below zero φ goes on along its slope.
fn variation(scene: ArrayView2<'_, f32>, alpha: f32) -> f64 {
    let mapped = local_mean(&scene.mapv(|light| light / (light.max(0.0) + alpha)), LARGE_PX);
    let of_lines = |axis: usize| -> f64 {
        let lines = mapped.lanes(Axis(axis)).into_iter();
        let of_line = |line: ArrayView1<'_, f32>| -> f64 {
            line.iter().zip(line.iter().skip(1)).map(|(light, next)| f64::from((next - light).abs())).sum()
        };
        lines.map(of_line).sum()
    };
    of_lines(0) + of_lines(1)
}

#[cfg(test)]
mod tests {
    use ndarray::{Array3, s};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::core::fft::TransformPrecision;
    use crate::core::image::{CHANNELS, LinearImage};
    use crate::core::psf::Psf;
    use crate::core::rng;
    use crate::restore::deconvolution::{Border, DeconvolutionConfig, Method, deconvolve};

    const SIDE: usize = 128;
    const PSF_SIDE: usize = 97;
    const MARGIN: usize = PSF_SIDE / 2;

    /// A sharp core, and a third of the light in a bell of 20 pixels.
    fn psf() -> Array2<f32> {
        let lobe = |of: &dyn Fn(f32) -> f32| {
            let centre = (PSF_SIDE / 2) as f32;
            let lobe = Array2::from_shape_fn((PSF_SIDE, PSF_SIDE), |(y, x)| {
                of((y as f32 - centre).hypot(x as f32 - centre))
            });
            let sum = lobe.sum();
            lobe / sum
        };
        lobe(&|distance| (-2.0 * distance).exp()) * 0.67
            + lobe(&|distance| (-distance.powi(2) / 800.0).exp()) * 0.33
    }

    /// A scene of one channel that goes on around the frame.
    fn scene(light: impl Fn(f32, f32) -> f32) -> Array2<f32> {
        let side = SIDE + 2 * MARGIN;
        let of = |at: usize| at as f32 - MARGIN as f32;
        Array2::from_shape_fn((side, side), |(y, x)| light(of(y), of(x)))
    }

    /// The error of what `joint` makes of a capture of the scene, in decibels after tone mapping.
    fn psnr(scene: &Array2<f32>) -> f32 {
        let size = [scene.nrows(), scene.ncols()];
        let frame = Frame::new(size, [PSF_SIDE; 2], Border::Zero, TransformPrecision::Double);
        let mut seen = frame.plane();
        frame.blur(psf().view()).unwrap().apply(scene, &mut seen);
        let within = s![MARGIN..MARGIN + SIDE, MARGIN..MARGIN + SIDE];
        let mut rng = rng::stream(5, "around");
        let noisy = |y: &f32| {
            let normal: f32 = StandardNormal.sample(&mut rng);
            (y + 0.01 * (y + 0.25) * normal).max(0.0)
        };
        let seen = seen.slice(within).iter().map(noisy).collect();
        let seen = Array2::from_shape_vec((SIDE, SIDE), seen).unwrap();
        let of_channels = |plane: &Array2<f32>| {
            Array3::from_shape_fn((CHANNELS, plane.nrows(), plane.ncols()), |(_, y, x)| plane[[y, x]])
        };
        let image = LinearImage::from_planes(of_channels(&seen)).unwrap();
        let psf = Psf::from_energy(of_channels(&psf())).unwrap();
        let config = DeconvolutionConfig {
            border: Border::Smooth,
            saturation: [16.0; CHANNELS],
            ..DeconvolutionConfig::of_method(Method::Joint)
        };
        let restored = deconvolve(&image, &psf, &config, &Progress::default()).unwrap();
        let tone = |light: f32| light / (light + 0.25);
        let errors = restored
            .channel(1)
            .iter()
            .zip(scene.slice(within))
            .map(|(a, b)| (tone(*a) - tone(*b)).powi(2))
            .sum::<f32>();
        -10.0 * (errors / (SIDE * SIDE) as f32).log10()
    }

    /// Taken for light within the frame, its haze leaves 18 dB; known to come from the rest of the softbox, 30.
    #[test]
    fn a_softbox_that_the_frame_cuts_in_two_goes_on_beyond_it() {
        let side = SIDE as f32;
        let found = psnr(&scene(|y, x| {
            let is_box = (y - side / 2.0).abs() < 28.0 && (side - 3.0..side + 20.0).contains(&x);
            if is_box { 5.0 } else { 0.02 * (1.0 + 0.3 * (y / 9.0).sin() * (x / 7.0).cos()) }
        }));
        assert!(found > 27.0, "{found} dB");
    }

    /// 22 dB if light beyond the border were taken to throw what is the sky's own haze, 48 if not.
    #[test]
    fn a_strip_of_sky_above_a_roof_is_not_taken_for_haze() {
        let side = SIDE as f32;
        let found = psnr(&scene(|y, x| match y > 0.28 * side {
            true => 0.002 * (1.0 + 0.3 * (y / 3.0).sin() * (x / 4.0).cos()),
            false => 0.15 * (1.0 + 0.1 * (y / 5.0).sin() * (x / 4.0).cos()),
        }));
        assert!(found > 40.0, "{found} dB");
    }

    #[test]
    fn haze_to_one_side_has_more_contrast_than_haze_everywhere() {
        let contrast =
            |light: fn(usize) -> f32| contrast_of(&Array2::from_shape_fn((8, 40), |(_, x)| light(x)));
        assert!(contrast(|x| if x < 4 { 5.0 } else { 0.1 }) > 2.0);
        assert!(contrast(|x| 1.0 + 0.05 * x as f32) < 0.5);
        assert!(contrast(|_| 0.0).abs() < f64::EPSILON);
    }

    /// 14 dB if what is smooth in it were taken to come from beyond its border, 51 if not.
    #[test]
    fn a_bright_scene_is_not_taken_for_haze() {
        let found = psnr(&scene(|y, x| 0.4 * (1.0 + 0.3 * (y / 9.0).sin() * (x / 7.0).cos())));
        assert!(found > 45.0, "{found} dB");
    }

    /// A window above the frame, and what colours make of it that tell a part of it apart.
    #[test]
    fn light_is_believed_where_all_colours_tell_one() {
        let look = |apart: f32, without: f64| {
            let light = Array2::from_shape_fn((8, 8), |(y, x)| match (y, x) {
                (0, 2..6) => 1.0,
                (7, 7) => apart,
                _ => 0.0,
            });
            Look { light, own: 1.0, without, contrast: 2.0, seen: 0.11 }
        };
        let is_believed = |apart: f32, without: f64| {
            are_believed(&[look(0.0, without), look(apart, without), look(0.0, without)])
        };
        // Likeness of 2/√(4 + a²): 0.97, 0.89.
        assert!(is_believed(0.0, 0.6) && is_believed(0.5, 0.6) && is_believed(1.0, 0.6));
        assert!(is_believed(0.0, 0.88) && is_believed(0.5, 0.88));
        assert!(!is_believed(1.0, 0.88), "as of a street's grain");
        assert!(!is_believed(0.0, 0.95));
    }
}
