//! Tells PSFs that are not those of a capture, by its spectrum alone, before anything is restored.
//!
//! A panel leaves ripples in the spectrum of whatever is seen through it, and few scenes have such
//! ([`likelihood`](super::likelihood)). A capture is therefore likelier behind its own PSF than behind the same blur spread evenly in all
//! directions, which makes no ripples, and than behind its own PSF turned, resized or otherwise mistaken. Where it is not, the PSF is
//! another one, or was mistaken in the way that undoes it.

use std::fmt;

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, s};
use rayon::prelude::*;
use serde::Serialize;

use super::likelihood::{WindowModel, contrast, corners};
use crate::codes::rotate;
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;
use crate::io::AnyImage;

/// The largest side of the windows that are looked at.
const WINDOW_PX: usize = 384;

/// The smallest side of a capture that tells anything.
const SMALLEST_PX: usize = 64;

/// Pixels of a capture from which on two windows are looked at.
const TWO_WINDOWS_PX: usize = 2_000_000;

/// The part of a window that is saturated in some colour, and of the brightest light that counts as that, from which on it tells nothing.
const MOST_SATURATED: f64 = 0.2;
const BRIGHT: f32 = 0.98;

/// Nats for each sample of the spectrum by which a capture is likelier behind the even blur, and behind a PSF that was mistaken in another
/// way, that tell it; fewer than so many nats tell nothing. Of 590 captures by right PSFs two have so many, of 40 by those of other panels
/// 22.
const LEAD_OF_EVEN: f64 = 0.01;
const LEAD_OF_OTHER: f64 = 0.015;
const LEAST_LEAD: f64 = 60.0;

/// What the structure of the given PSF explains, as a part of what that of the other does, up to which the other is told: a sun
/// in a small window is likelier a little behind many.
const MOST_SHARED: f64 = 0.5;

/// The part of the frequency plane in which what is told leads.
const MOST_CELLS: f64 = 0.5;

/// The least noise of a part of the spectrum, as a part of its power.
const MISFIT: f64 = 0.01;

/// The least [`structure`] of a PSF that tells anything: a plain lens has 10⁻⁶, 30 panels have 4·10⁻⁶ to 5·10⁻³, three of them less than
/// this.
const LEAST_STRUCTURE: f64 = 1e-5;

/// Degrees by which a PSF is turned to see whether it stands wrong: less is found by its pose.
const TURN_DEG: f64 = 4.0;

/// Radius in pixels of a core, and by how much it is made brighter to see whether it is clipped.
const CORE_PX: f64 = 2.5;
const CORE_FACTOR: f32 = 3.0;

/// The exponent that stands for what screens do to encoded light.
const SCREEN: f32 = 2.2;

/// What a capture looks like more than like one behind its PSF, by what became of that PSF.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LookingLike {
    /// Spread evenly in all directions.
    Even,
    /// Turned by a quarter.
    QuarterTurned,
    /// Turned by some degrees counter-clockwise as displayed.
    TurnedLeft,
    /// Turned by some degrees clockwise.
    TurnedRight,
    /// With red and blue exchanged.
    ColorsExchanged,
    /// Of half its size.
    Halved,
    /// Of twice its size.
    Doubled,
    /// With a brighter core.
    BrighterCore,
    /// With its values decoded from those of a screen.
    Decoded,
}

impl LookingLike {
    /// All but the even blur.
    const MISTAKEN: [Self; 8] = [
        Self::QuarterTurned,
        Self::TurnedLeft,
        Self::TurnedRight,
        Self::ColorsExchanged,
        Self::Halved,
        Self::Doubled,
        Self::BrighterCore,
        Self::Decoded,
    ];

    /// The PSF as it would look.
    fn of(self, psf: &Psf) -> Result<Psf> {
        let planes = psf.planes();
        let each = |change: &(dyn Fn(ArrayView2<'_, f32>) -> Array2<f32> + Sync)| {
            let mut changed = Array3::zeros(planes.raw_dim());
            for (mut changed, plane) in changed.outer_iter_mut().zip(planes.outer_iter()) {
                changed.assign(&change(plane));
            }
            changed
        };
        Psf::from_energy(match self {
            Self::Even => each(&|plane| even(plane)),
            Self::QuarterTurned => return rotate(psf, 90.0),
            Self::TurnedLeft => each(&|plane| resampled(plane, TURN_DEG, 1.0)),
            Self::TurnedRight => each(&|plane| resampled(plane, -TURN_DEG, 1.0)),
            Self::ColorsExchanged => planes.slice(s![..;-1, .., ..]).to_owned(),
            Self::Halved => each(&|plane| resampled(plane, 0.0, 0.5)),
            Self::Doubled => each(&|plane| resampled(plane, 0.0, 2.0)),
            Self::BrighterCore => each(&with_brighter_core),
            Self::Decoded => each(&decoded),
        })
    }
}

/// That a capture looks like one behind another PSF than the one that is given.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Unlike {
    /// What it looks like.
    pub looks_like: LookingLike,
    /// By how much it is likelier so, in nats.
    pub lead_nats: f64,
}

impl Unlike {
    /// Of a capture, `curve` telling its light where it is tone-mapped and does not say it itself; none where its PSF explains it, or
    /// nothing tells.
    ///
    /// # Errors
    /// Those of [`WindowModel::new`]; [`Error::Interrupted`](crate::core::error::Error::Interrupted).
    pub(super) fn of(
        image: &AnyImage,
        psf: &Psf,
        curve: ToneCurve,
        progress: &Progress,
    ) -> Result<Option<Self>> {
        let curve = image.curve().unwrap_or(curve);
        let expand = |light: f32| match image {
            AnyImage::Linear(_) => light,
            AnyImage::ToneMapped(..) => curve.expand(light),
        };
        let planes = match image {
            AnyImage::Linear(image) => image.planes(),
            AnyImage::ToneMapped(image, _) => image.planes(),
        };
        let windows = windows(planes, expand);
        let Some(size) = windows.first().map(|window| [window.dim().1, window.dim().2]) else {
            return Ok(None);
        };
        // A PSF of a row of pixels, or without light near its centre, cannot be mistaken in these ways.
        let Some(seen) = seen_by(psf, size).ok().filter(|seen| structure(seen) >= LEAST_STRUCTURE) else {
            return Ok(None);
        };
        let others =
            LookingLike::MISTAKEN.par_iter().chain([&LookingLike::Even]).map(|other| other.of(&seen));
        let Ok(others) = others.collect::<Result<_>>() else { return Ok(None) };
        let leads = Leads::over(&seen, others, &windows, progress)?;
        let told = leads.told();
        let Some(Self { looks_like, .. }) = told.filter(|told| told.looks_like != LookingLike::Even) else {
            return Ok(told);
        };
        // Not by its envelope alone, which may be the scene's, but by its structure.
        let other = looks_like.of(&seen)?;
        let pair = Leads::over(&LookingLike::Even.of(&other)?, vec![other], &windows, progress)?;
        let is_by_structure = pair.nats[0] > pair.least(LEAD_OF_EVEN);
        Ok(if is_by_structure { told } else { leads.of_even() })
    }
}

/// By how much a capture is likelier behind other PSFs than behind the given one.
struct Leads {
    /// Those of each, in nats.
    nats: Vec<f64>,
    /// The part of the frequency plane's cells in which each leads.
    cells: Vec<f64>,
    samples: usize,
}

impl Leads {
    fn over(given: &Psf, mut others: Vec<Psf>, windows: &[Array3<f32>], progress: &Progress) -> Result<Self> {
        // The scene's covariance is found behind the PSF in the middle.
        let middle = others.len().div_ceil(2);
        others.insert(middle, given.clone());
        let (_, height, width) = windows[0].dim();
        let model = WindowModel::new([height, width], &others)?.with_misfit(MISFIT);
        let (mut nats, mut ahead) = (vec![0.0; others.len()], vec![0.0; others.len()]);
        let (mut cells, mut samples) = (0.0f64, 0);
        for window in windows {
            progress.check()?;
            for cell in model.by_cell(window.view()).unwrap_or_default() {
                let of_given = cell.log_likelihoods[middle];
                for (other, value) in cell.log_likelihoods.into_iter().enumerate() {
                    nats[other] += value - of_given;
                    ahead[other] += f64::from(u8::from(value > of_given));
                }
                cells += 1.0;
                samples += cell.samples;
            }
        }
        nats.remove(middle);
        ahead.remove(middle);
        Ok(Self { nats, cells: ahead.into_iter().map(|count| count / cells.max(1.0)).collect(), samples })
    }

    /// The lead that this many nats for each sample are, and no fewer than tell anything.
    fn least(&self, per_sample: f64) -> f64 {
        (per_sample * self.samples as f64).max(LEAST_LEAD)
    }

    /// What they tell where they are of [`LookingLike::MISTAKEN`], and of the even blur at last.
    fn told(&self) -> Option<Unlike> {
        let even = *self.nats.last()?;
        let leads = |place: &usize| {
            let lead = self.nats[*place];
            // By what structure explains, over a blur that has none.
            lead > self.least(LEAD_OF_OTHER)
                && lead > even
                && -even < MOST_SHARED * (lead - even)
                && self.cells[*place] > MOST_CELLS
        };
        let best = (0..LookingLike::MISTAKEN.len())
            .filter(leads)
            .max_by(|a, b| self.nats[*a].total_cmp(&self.nats[*b]));
        match best {
            Some(best) => {
                Some(Unlike { looks_like: LookingLike::MISTAKEN[best], lead_nats: self.nats[best] })
            }
            None => self.of_even(),
        }
    }

    /// What the last tells, that of the even blur.
    fn of_even(&self) -> Option<Unlike> {
        let (lead_nats, cells) = (*self.nats.last()?, *self.cells.last()?);
        let is_told = lead_nats > self.least(LEAD_OF_EVEN) && cells > MOST_CELLS;
        is_told.then_some(Unlike { looks_like: LookingLike::Even, lead_nats })
    }
}

/// Windows of light: those with the greatest contrast of what is saturated for a small part.
fn windows(planes: ArrayView3<'_, f32>, expand: impl Fn(f32) -> f32 + Sync) -> Vec<Array3<f32>> {
    let (_, height, width) = planes.dim();
    if height.min(width) < SMALLEST_PX {
        return Vec::new();
    }
    let size = [height, width].map(|side| side.min(WINDOW_PX));
    let full: Vec<f32> = planes
        .outer_iter()
        .map(|plane| BRIGHT * expand(plane.iter().fold(0.0, |most: f32, value| most.max(*value))))
        .collect();
    let light = |[top, left]: [usize; 2]| {
        planes.slice(s![.., top..top + size[0], left..left + size[1]]).mapv(&expand)
    };
    let mut found: Vec<(f64, [usize; 2])> = corners([height, width], size)
        .into_par_iter()
        .filter_map(|corner| {
            let light = light(corner);
            let is_saturated = |&[y, x]: &[usize; 2]| (0..CHANNELS).any(|c| light[[c, y, x]] >= full[c]);
            let pixels = (0..size[0]).flat_map(|y| (0..size[1]).map(move |x| [y, x]));
            let saturated = pixels.filter(is_saturated).count();
            let tells = saturated as f64 <= MOST_SATURATED * (size[0] * size[1]) as f64;
            tells.then(|| (contrast(light.view()), corner))
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(if height * width >= TWO_WINDOWS_PX { 2 } else { 1 });
    found.into_iter().map(|(_, corner)| light(corner)).collect()
}

/// The PSF as windows of this size see it: orders whose ripples are finer than a window resolves are taken out of it.
fn seen_by(psf: &Psf, size: [usize; 2]) -> Result<Psf> {
    let reach = size[0].min(size[1]) / 2;
    let (cy, cx) = psf.centre();
    let [rows, columns] = [(cy, psf.height()), (cx, psf.width())]
        .map(|(centre, side)| centre.saturating_sub(reach)..side.min(centre + reach + 1));
    let (cy, cx) = (cy - rows.start, cx - columns.start);
    let mut planes = psf.planes().slice(s![.., rows, columns]).to_owned();
    for ((_, y, x), value) in planes.indexed_iter_mut() {
        let distance = (distance(y, cy).powi(2) + distance(x, cx).powi(2)).sqrt() / reach as f64;
        *value *= narrow(0.5 + 0.5 * (std::f64::consts::PI * distance.min(1.0)).cos());
    }
    Psf::from_energy(planes)
}

/// As far from the centre as it is, light is the same in all directions.
fn even(plane: ArrayView2<'_, f32>) -> Array2<f32> {
    let (height, width) = plane.dim();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a distance in pixels")]
    let ring = |y: usize, x: usize| distance(y, height / 2).hypot(distance(x, width / 2)).round() as usize;
    let mut rings = vec![(0.0, 0u32); height + width];
    for ((y, x), value) in plane.indexed_iter() {
        let (sum, count) = &mut rings[ring(y, x)];
        (*sum, *count) = (*sum + f64::from(*value), *count + 1);
    }
    Array2::from_shape_fn(plane.dim(), |(y, x)| {
        let (sum, count) = rings[ring(y, x)];
        narrow(sum / f64::from(count))
    })
}

/// The squares of what differs from the even blur outside of the core, of a PSF of unit sum; of the middle one of its colours.
fn structure(psf: &Psf) -> f64 {
    let (cy, cx) = psf.centre();
    let mut sums: Vec<f64> = psf
        .planes()
        .outer_iter()
        .map(|plane| {
            let differences = even(plane) - plane;
            let outside = differences
                .indexed_iter()
                .filter(|((y, x), _)| distance(*y, cy).hypot(distance(*x, cx)) > CORE_PX);
            outside.map(|(_, value)| f64::from(*value).powi(2)).sum()
        })
        .collect();
    sums.sort_by(f64::total_cmp);
    sums[CHANNELS / 2]
}

fn with_brighter_core(plane: ArrayView2<'_, f32>) -> Array2<f32> {
    let (height, width) = plane.dim();
    Array2::from_shape_fn(plane.dim(), |(y, x)| {
        let is_core = distance(y, height / 2).hypot(distance(x, width / 2)) <= CORE_PX;
        plane[[y, x]] * if is_core { CORE_FACTOR } else { 1.0 }
    })
}

fn decoded(plane: ArrayView2<'_, f32>) -> Array2<f32> {
    let most = plane.iter().fold(0.0, |most: f32, value| most.max(*value));
    plane.mapv(|value| (value / most).powf(SCREEN))
}

/// Turned counter-clockwise as displayed, and larger by a factor, between pixels in straight lines; of a smaller one, each pixel is the
/// mean of four places.
fn resampled(plane: ArrayView2<'_, f32>, turn_deg: f64, factor: f64) -> Array2<f32> {
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    let [centre_y, centre_x] = [plane.nrows(), plane.ncols()].map(|side| (side / 2) as f64);
    let places: &[[f64; 2]] = if factor < 1.0 {
        &[[-0.25, -0.25], [-0.25, 0.25], [0.25, -0.25], [0.25, 0.25]]
    } else {
        &[[0.0; 2]]
    };
    let mut moved = Array2::zeros(plane.raw_dim());
    moved.outer_iter_mut().into_par_iter().enumerate().for_each(|(y, mut row)| {
        for (x, value) in row.iter_mut().enumerate() {
            for [below, right] in places {
                let dy = (y as f64 + below - centre_y) / factor;
                let dx = (x as f64 + right - centre_x) / factor;
                *value += between(plane, [centre_y + dy * cos + dx * sin, centre_x + dx * cos - dy * sin]);
            }
        }
    });
    moved
}

/// Light at a place between pixels; none from the border on.
fn between(plane: ArrayView2<'_, f32>, [y, x]: [f64; 2]) -> f32 {
    if y < 0.0 || x < 0.0 {
        return 0.0;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "places in a PSF")]
    let (top, left) = (y as usize, x as usize);
    if top + 1 >= plane.nrows() || left + 1 >= plane.ncols() {
        return 0.0;
    }
    let (below, right) = (narrow(y - top as f64), narrow(x - left as f64));
    let along = |y: usize| (1.0 - right) * plane[[y, left]] + right * plane[[y, left + 1]];
    (1.0 - below) * along(top) + below * along(top + 1)
}

fn distance(place: usize, centre: usize) -> f64 {
    place.abs_diff(centre) as f64
}

#[expect(clippy::cast_possible_truncation, reason = "PSF values are f32")]
fn narrow(value: f64) -> f32 {
    value as f32
}

impl fmt::Display for Unlike {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (other, advice) = match self.looks_like {
            LookingLike::Even => (
                "spread evenly in all directions",
                "it may be of another panel, or of another orientation, size or focus than the capture",
            ),
            LookingLike::QuarterTurned => {
                ("turned by a quarter", "bring PSF and capture into the orientation of the sensor")
            }
            LookingLike::TurnedLeft => ("turned by some degrees counter-clockwise", TURNED),
            LookingLike::TurnedRight => ("turned by some degrees clockwise", TURNED),
            LookingLike::ColorsExchanged => {
                ("with red and blue exchanged", "one of the two files has its channels in another order")
            }
            LookingLike::Halved => ("of half its size", RESIZED),
            LookingLike::Doubled => ("of twice its size", RESIZED),
            LookingLike::BrighterCore => {
                ("with a brighter core", "the core may be clipped: fuse it with a shorter exposure")
            }
            LookingLike::Decoded => (
                "with its values decoded as a screen's",
                "it may not be linear: say so by --psf-domain, or measure it in raw pictures",
            ),
        };
        write!(
            f,
            "the capture does not look like one behind this PSF: {other}, that would make it likelier by {:.0} nats; {advice}",
            self.lead_nats
        )
    }
}

const TURNED: &str = "turn the PSF: `udc codes psf.exr --angles=-10:10:1 -o bank.safetensors`, and restore with --bank bank.safetensors \
                      --angle auto";
const RESIZED: &str = "one of the two may have been resized, binned or cropped to another scale";

#[cfg(test)]
mod tests;
