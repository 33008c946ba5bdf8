//! Finds the white of a capture whose shading was taken out after its sensor had clipped: it rises towards the corners, as the gain did.
//!
//! A saturated pixel has no noise of its own: beside others it is as bright as the gain makes it, far more exactly than light is. Such
//! pixels lie on one surface, over which the capture's brightest pixels end like a cut.

use ndarray::{Array2, ArrayView2, Zip};
use rand::RngExt as _;
use rayon::prelude::*;

use super::areas::visit_areas;
use super::plateau::{Plateau, Top};
use super::symmetric::{apply, inverse};
use crate::core::image::CHANNELS;
use crate::core::rng::stream;

/// How far a pixel of a white may be from the middle of its neighbours in a row and in a column, and those from each other, as a part
/// of it.
const EVEN: f32 = 0.002;
const STEEP: f32 = 0.03;

/// How many times as bright as the white of the middle that of a corner may be: lenses lose up to three quarters.
const MOST_GAIN: f32 = 4.0;

/// Even pixels that are looked at, and that a white has.
const MOST_LOOKED_AT: usize = 4096;
const LEAST_PIXELS: usize = 48;

/// Surfaces through three pixels that are tried.
const TRIALS: usize = 400;

/// How far from a surface a pixel of it may be, as a part of it.
const NEAR: f64 = 0.004;

/// Separate areas that a white has at least: of one or two, the light itself may be even.
const LEAST_AREAS: usize = 3;

/// The part of the pixels inside of such areas that are even, at least; of light that is no white, noise leaves few.
const LEAST_EVEN: f64 = 0.8;

/// Terms of a surface: a constant, the squared distance from the middle of the frame, and the square of that.
const TERMS: usize = 3;

/// White by the place in a frame.
#[derive(Clone, Copy, Debug)]
struct Surface {
    centre: [f64; 2],
    radius: f64,
    terms: [f64; TERMS],
    /// Between the darkest and the brightest pixel that it was found by.
    range: [f64; 2],
}

/// What saturates a channel whose shading was taken out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShadedWhite {
    /// The light that saturates it where it saturates at the least.
    pub(super) level: f32,
    /// How many pixels are saturated.
    pub(super) pixels: usize,
    /// No pixel of it is darker.
    pub(super) darkest: f32,
}

impl Surface {
    /// One that no pixel tells yet.
    fn of((height, width): (usize, usize)) -> Self {
        let centre = [height, width].map(|side| (side - 1) as f64 / 2.0);
        let radius = centre[0].hypot(centre[1]).max(1.0);
        Self { centre, radius, terms: [0.0; TERMS], range: [0.0, f64::INFINITY] }
    }

    fn basis(&self, (y, x): (usize, usize)) -> [f64; TERMS] {
        let [down, along] = [y as f64 - self.centre[0], x as f64 - self.centre[1]];
        let square = (down * down + along * along) / self.radius.powi(2);
        [1.0, square, square * square]
    }

    fn at(&self, place: (usize, usize)) -> f64 {
        let white: f64 = self.basis(place).iter().zip(self.terms).map(|(basis, term)| basis * term).sum();
        white.clamp(self.range[0], self.range[1])
    }

    fn is_near(&self, pixel: &Pixel) -> bool {
        let white = self.at(pixel.place);
        white > 0.0 && (pixel.value - white).abs() <= NEAR * white
    }

    /// A plane in multiples of it.
    fn relative(&self, plane: ArrayView2<'_, f32>) -> Array2<f32> {
        Array2::from_shape_fn(plane.dim(), |place| {
            #[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
            let white = self.at(place) as f32;
            plane[place] / white
        })
    }

    /// What saturates a channel that has this plateau in multiples of it.
    fn white(&self, plane: ArrayView2<'_, f32>, plateau: &Plateau) -> ShadedWhite {
        let (mut level, mut darkest, mut pixels) = (f64::INFINITY, f32::INFINITY, 0);
        Zip::indexed(&plateau.mask(&self.relative(plane))).for_each(|place, is_white| {
            if *is_white {
                level = level.min(self.at(place) * f64::from(plateau.brightest));
                darkest = darkest.min(plane[place]);
                pixels += 1;
            }
        });
        #[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
        let level = level as f32;
        ShadedWhite { level, pixels, darkest }
    }

    /// The surface that is nearest to pixels, relative to their light.
    fn through(self, pixels: impl Iterator<Item = Pixel>) -> Option<Self> {
        let (mut normal, mut sum) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
        for Pixel { place, value } in pixels {
            let basis = self.basis(place).map(|term| term / value);
            for (row, (sum, a)) in normal.iter_mut().zip(sum.iter_mut().zip(basis)) {
                *sum += a;
                row.iter_mut().zip(basis).for_each(|(of, b)| *of += a * b);
            }
        }
        Some(Self { terms: apply(&inverse(&normal)?, &sum), ..self })
    }
}

/// A pixel that is as bright as its neighbours tell.
#[derive(Clone, Copy)]
struct Pixel {
    place: (usize, usize),
    value: f64,
}

/// The white of each channel, if its brightest pixels lie on a surface that rises from the middle of the frame, its own or another
/// channel's, and end there like a cut; `brightest` are the brightest values but for outliers.
pub(super) fn shaded_whites(
    planes: [ArrayView2<'_, f32>; CHANNELS],
    brightest: [f32; CHANNELS],
) -> [Option<ShadedWhite>; CHANNELS] {
    let mut own: [Option<(Surface, Plateau)>; CHANNELS] = [None; CHANNELS];
    own.par_iter_mut().enumerate().for_each(|(channel, found)| {
        let plane = planes[channel];
        let even = even_pixels(plane, brightest[channel] / MOST_GAIN);
        *found = surface_of(Surface::of(plane.dim()), &even).and_then(|surface| {
            let relative = surface.relative(plane);
            let plateau = Top::of(relative.view()).plateau()?;
            are_even(plane, &plateau.mask(&relative)).then_some((surface, plateau))
        });
    });
    let another = own.iter().flatten().next().copied();
    std::array::from_fn(|channel| {
        let plane = planes[channel];
        let of_another = || {
            let (surface, plateau) = another?;
            let relative = surface.relative(plane);
            let top = Top::of(relative.view());
            let narrow = top.plateau().filter(|plateau| !plateau.is_wide());
            narrow.or_else(|| top.plateau_as(&plateau)).map(|plateau| (surface, plateau))
        };
        own[channel].or_else(of_another).map(|(surface, plateau)| surface.white(plane, &plateau))
    })
}

/// The pixels that are as bright as their neighbours tell, and not far darker than the brightest.
fn even_pixels(plane: ArrayView2<'_, f32>, least: f32) -> Vec<Pixel> {
    let (height, width) = plane.dim();
    let mut even = Vec::new();
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            if plane[[y, x]] > 0.0 && plane[[y, x]] >= least && is_even(plane, (y, x)) {
                even.push(Pixel { place: (y, x), value: f64::from(plane[[y, x]]) });
            }
        }
    }
    let step = even.len().div_ceil(MOST_LOOKED_AT).max(1);
    even.into_iter().step_by(step).collect()
}

fn is_even(plane: ArrayView2<'_, f32>, (y, x): (usize, usize)) -> bool {
    let value = plane[[y, x]];
    [[plane[[y - 1, x]], plane[[y + 1, x]]], [plane[[y, x - 1]], plane[[y, x + 1]]]].into_iter().all(
        |[before, behind]| {
            (before + behind - 2.0 * value).abs() <= EVEN * value && (behind - before).abs() <= STEEP * value
        },
    )
}

/// The surface that most of these pixels lie on, of those through some three.
fn surface_of(surface: Surface, even: &[Pixel]) -> Option<Surface> {
    if even.len() < LEAST_PIXELS {
        return None;
    }
    let mut rng = stream(0, "shaded white");
    let mut best: Option<(usize, Surface)> = None;
    for _ in 0..TRIALS {
        let three: [Pixel; TERMS] = std::array::from_fn(|_| even[rng.random_range(0..even.len())]);
        let Some(tried) = surface.through(three.into_iter()) else { continue };
        let near = even.iter().filter(|pixel| tried.is_near(pixel)).count();
        if best.as_ref().is_none_or(|(most, _)| near > *most) {
            best = Some((near, tried));
        }
    }
    let (most, mut found) = best?;
    if most < LEAST_PIXELS {
        return None;
    }
    for _ in 0..2 {
        found = surface.through(even.iter().filter(|pixel| found.is_near(pixel)).copied())?;
    }
    let values = even.iter().filter(|pixel| found.is_near(pixel)).map(|pixel| pixel.value);
    let range = values.fold([f64::INFINITY, 0.0], |[least, most], value| [value.min(least), value.max(most)]);
    (range[1] > 0.0).then_some(Surface { range, ..found })
}

/// Whether a white lies in separate areas, inside of which pixels are as bright as their neighbours tell.
fn are_even(plane: ArrayView2<'_, f32>, is_white: &Array2<bool>) -> bool {
    let (height, width) = plane.dim();
    let (mut areas, mut inside, mut even) = (0_usize, 0_usize, 0_usize);
    visit_areas(is_white.clone(), |area| {
        let mut is_area = false;
        for &(y, x) in area {
            let is_inner = (1..height - 1).contains(&y) && (1..width - 1).contains(&x);
            let around = |(down, along): (usize, usize)| is_white[[y + down - 1, x + along - 1]];
            if is_inner && [(0, 1), (2, 1), (1, 0), (1, 2)].into_iter().all(around) {
                inside += 1;
                even += usize::from(is_even(plane, (y, x)));
                is_area = true;
            }
        }
        areas += usize::from(is_area);
    });
    areas >= LEAST_AREAS && inside >= LEAST_PIXELS && even as f64 >= LEAST_EVEN * inside as f64
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::core::image::LinearImage;
    use crate::restore::levels::cut_levels;
    use ndarray::Array3;

    const SIDE: usize = 160;

    /// What a lens that loses this part of the light at the corner takes of a pixel.
    fn left_by_lens(loss: f32, (y, x): (usize, usize)) -> f32 {
        let middle = (SIDE as f32 - 1.0) / 2.0;
        let square = ((y as f32 - middle).powi(2) + (x as f32 - middle).powi(2)) / (2.0 * middle * middle);
        1.0 - loss * square * (1.3 - 0.3 * square)
    }

    /// Lamps of so much light, in noise, behind a lens whose loss was taken out after light of 1 was clipped.
    fn capture(loss: f32, light: f32, lamps: &[(f32, f32)]) -> Array2<f32> {
        let mut rng = stream(3, "shaded");
        Array2::from_shape_fn((SIDE, SIDE), |place| {
            let lamp: f32 = lamps
                .iter()
                .map(|lamp| {
                    let squares = (place.0 as f32 - lamp.0).powi(2) + (place.1 as f32 - lamp.1).powi(2);
                    light * (-squares.sqrt() / 2.5).exp()
                })
                .sum();
            let seen = (0.1 + lamp) * left_by_lens(loss, place);
            let error: f32 = StandardNormal.sample(&mut rng);
            (seen + 0.012 * seen.sqrt() * error).clamp(0.0, 1.0) / left_by_lens(loss, place)
        })
    }

    const LAMPS: [(f32, f32); 5] = [(20.0, 30.0), (80.0, 75.0), (140.0, 145.0), (30.0, 120.0), (120.0, 40.0)];

    fn levels(planes: [&Array2<f32>; 3]) -> [Option<(f32, usize)>; 3] {
        let planes = Array3::from_shape_fn((3, SIDE, SIDE), |(channel, y, x)| planes[channel][[y, x]]);
        cut_levels(&LinearImage::from_planes(planes).unwrap())
    }

    #[test]
    fn a_white_that_rises_to_the_corners_is_found_where_it_is_least() {
        for loss in [0.08, 0.2, 0.5] {
            let plane = capture(loss, 60.0, &LAMPS);
            let white: Vec<f32> = plane
                .indexed_iter()
                .filter(|(place, value)| **value * left_by_lens(loss, *place) >= 0.999)
                .map(|(_, value)| *value)
                .collect();
            let least = white.iter().copied().fold(f32::INFINITY, f32::min);
            for found in levels([&plane; 3]) {
                let (level, pixels) = found.expect("a white");
                assert!(
                    (level / least - 1.0).abs() < 0.012 && 0.99 * level <= least,
                    "{loss}: {level} {least}"
                );
                // The lens is none of the surfaces that are looked for.
                let part = pixels as f32 / white.len() as f32;
                assert!((0.75..1.1).contains(&part), "{loss}: {part}");
            }
        }
    }

    #[test]
    fn a_channel_with_few_saturated_pixels_has_the_white_of_the_others() {
        let (plane, small) = (capture(0.5, 60.0, &LAMPS), capture(0.5, 60.0, &LAMPS[..2]));
        let [red, _, blue] = levels([&plane, &plane, &small]);
        assert!(red.is_some());
        let (level, pixels) = blue.expect("a white");
        assert!((1.0..1.5).contains(&level) && pixels > 30, "{level} {pixels}");
        assert_eq!(levels([&small; 3]), [None; 3], "two lamps alone tell none");
    }

    #[test]
    fn lamps_that_are_not_clipped_and_bright_walls_have_none() {
        let faint = capture(0.5, 0.8, &LAMPS);
        assert_eq!(levels([&faint; 3]), [None; 3]);
        let mut rng = stream(4, "walls");
        let walls = Array2::from_shape_fn((SIDE, SIDE), |place| {
            let is_wall = place.0 % 60 < 25 && place.1 % 50 < 30;
            let error: f32 = StandardNormal.sample(&mut rng);
            (if is_wall { 0.8 } else { 0.2 }) * (1.0 + 0.01 * error) / left_by_lens(0.5, place)
        });
        assert_eq!(levels([&walls; 3]), [None; 3]);
    }
}
