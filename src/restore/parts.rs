//! Restores captures for which there is no memory as a whole in parts that overlap.

use ndarray::{Array3, Axis, Zip, s};

use super::deconvolution::{Border, LampOutside, noise_of_capture};
use super::guided::{Part, Parted, Posed, Whole};
use super::lamps::{find_lamps, light_of_lamps};
use super::memory::MemoryPlan;
use super::restoration::Restoration;
use super::solved::{Solved, is_much};
use super::tiles::{Span, Tiling, WindowCost};
use super::unexplained::Unexplained;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::progress::{PIXELS, Progress};
use crate::core::saturation::saturated_from;
use crate::io::AnyImage;
use crate::network::Model;

/// Pixels on either side of where two parts meet over which one gives way to the other.
const BLEND_PX: usize = 32;

/// Pixels that parts share beyond that and the reach of the PSF: what is deconvolved at the border of a part is not well known.
const RESERVE_PX: usize = 32;

/// What parts start at multiples of, a multiple of what networks need.
const ALIGNMENT: usize = 16;

/// What a part of a capture takes.
struct PartCost<'a> {
    restoration: &'a Restoration,
    model: &'a Model,
    of_psf: [usize; 2],
}

impl WindowCost for PartCost<'_> {
    fn halo(&self) -> usize {
        let reach = self.of_psf.into_iter().max().unwrap_or(0) / 2;
        (reach + BLEND_PX + RESERVE_PX).next_multiple_of(ALIGNMENT)
    }

    fn alignment(&self) -> usize {
        ALIGNMENT
    }

    fn window_bytes(&self, height: usize, width: usize, _: u64) -> u64 {
        self.restoration.part_bytes(self.model, [height, width]).unwrap_or(u64::MAX)
    }
}

impl Restoration {
    /// Plans the parts of a capture for which there is no memory as a whole. There are none where what lies beyond the border is
    /// known, which it is not around a part, and where the network is told the kernel of every pixel.
    pub(super) fn plan_parts(&self, model: &Model, size: [usize; 2]) -> Option<Result<MemoryPlan>> {
        if self.border() != Border::Smooth || model.architecture().reads_code() {
            return None;
        }
        let psf = self.kernel().sized_psf().ok()?;
        let part = PartCost { restoration: self, model, of_psf: [psf.height(), psf.width()] };
        Some(self.memory().plan_parts(size, &part))
    }

    /// Restores a capture in parts, of which each has all that the PSF spreads light over to or from what is kept of it, and where they
    /// meet, over [`BLEND_PX`] on either side, the mean.
    ///
    /// What saturates it, its noise, the pose of the panel and the tone curve are those of the whole.
    pub(super) fn restore_in_parts<'s>(
        &'s self,
        (mut whole, parts): (Whole<'_>, &Tiling),
        image: &LinearImage,
        posed: &mut Posed<'s>,
        progress: &Progress,
    ) -> Result<Part> {
        let size = [image.height(), image.width()];
        let (config, (height, width)) = (whole.planes.deconvolution(), parts.window());
        let noise = noise_of_capture(image, &posed.psf, &config, [height, width])?;
        let from = whole.planes.saturation.map(saturated_from);
        let count = count_saturated(image, from);
        let relative_noise = noise.relative();
        whole.parted = Some(Parted { noise, has_lamps: count > 0 });
        let quiet = progress.without_bars();
        let has_flare = count > 0 && self.has_flare((&whole, parts), image, posed, &quiet)?;
        let (psf, noise) = (&*posed.psf, whole.parted.as_ref().map(|parted| &parted.noise));
        let alone = self.clone().with_memory(self.memory().of_part(size));
        let mut light = Array3::<f32>::zeros(image.planes().dim());
        let (mut joined, mut curve) = (Array3::<f32>::zeros(image.planes().dim()), None);
        let (mut shines_above, mut lamps_outside, mut smaller_windows) = (false, Vec::new(), None);
        let mut unexplained = Unexplained::default();
        let bar = progress.bar((size[0] * size[1]) as u64, PIXELS);
        for tile in parts.tiles() {
            progress.check()?;
            let [rows, columns] = tile;
            let window = cut(image, tile);
            let plan = alone.plan([window.height(), window.width()])?;
            let mut solved = Solved::of((&window, psf), (&whole.planes, false), noise, &quiet)?;
            // What lies outside of a part alone is known.
            let beyond = |lamp: &LampOutside| outside(lamp.clone(), tile, size).is_some();
            solved.has_flare = has_flare || solved.lamps_outside.iter().any(beyond);
            keep_saturated((&mut light, &window), solved.scene(), (tile, from));
            let part = alone.restore_part((&whole, &plan), (window, psf), solved, &quiet)?;
            lamps_outside.extend(part.lamps_outside.into_iter().filter_map(|lamp| outside(lamp, tile, size)));
            smaller_windows = smaller_windows.or(part.smaller_windows);
            curve = part.image.curve();
            shines_above |= part.shines_above;
            unexplained = unexplained.and(part.unexplained);
            add(&mut joined, &planes_of(part.image), tile);
            bar.inc(((rows.end - rows.start) * (columns.end - columns.start)) as u64);
        }
        bar.finish_and_clear();
        let joined = match curve {
            Some(_) => AnyImage::ToneMapped(ToneMappedImage::from_planes(joined)?, curve),
            None => AnyImage::Linear(LinearImage::from_planes(joined)?),
        };
        let lamps = find_lamps(image, &LinearImage::from_planes(light)?, whole.planes.saturation);
        Ok(Part {
            image: joined,
            relative_noise,
            unexplained,
            shines_above,
            lamps,
            lamps_outside,
            angle: None,
            lateral_colour: None,
            smaller_windows,
        })
    }

    /// Whether lamps throw much light over a capture, by about as much as those of the part with most saturated pixels have, which also says
    /// whether the pose is right: it has most of what that is told by.
    fn has_flare<'s>(
        &'s self,
        (whole, parts): (&Whole<'_>, &Tiling),
        image: &LinearImage,
        posed: &mut Posed<'s>,
        progress: &Progress,
    ) -> Result<bool> {
        let saturation = whole.planes.saturation;
        let saturated = |image: &LinearImage| count_saturated(image, saturation.map(saturated_from));
        let brightest = parts.tiles().map(|tile| cut(image, tile)).max_by_key(saturated);
        let Some(part) = brightest else { return Ok(false) };
        let solved = self.solved(&part, posed, whole, progress)?;
        let times = saturated(image) as f64 / saturated(&part) as f64;
        Ok(is_much(times * light_of_lamps(&part, solved.scene(), saturation), image))
    }
}

fn count_saturated(image: &LinearImage, from: [f32; CHANNELS]) -> usize {
    let of_channel = |channel: usize| image.channel(channel).iter().filter(|y| **y >= from[channel]).count();
    (0..CHANNELS).map(of_channel).sum()
}

fn planes_of(image: AnyImage) -> Array3<f32> {
    match image {
        AnyImage::Linear(image) => image.into_planes(),
        AnyImage::ToneMapped(image, _) => image.into_planes(),
    }
}

fn cut(image: &LinearImage, [rows, columns]: [Span; 2]) -> LinearImage {
    image.crop(rows.window_start, columns.window_start, rows.window_len(), columns.window_len())
}

/// Keeps the light of saturated pixels of what is kept of a part.
fn keep_saturated(
    (light, capture): (&mut Array3<f32>, &LinearImage),
    scene: &LinearImage,
    ([rows, columns], from): ([Span; 2], [f32; CHANNELS]),
) {
    let (top, left) = (rows.window_start, columns.window_start);
    let inner = s![rows.start - top..rows.end - top, columns.start - left..columns.end - left];
    for (channel, mut light) in light.axis_iter_mut(Axis(0)).enumerate() {
        let light = light.slice_mut(s![rows.start..rows.end, columns.start..columns.end]);
        let [captured, scene] = [capture, scene].map(|image| image.channel(channel).slice_move(inner));
        Zip::from(light).and(captured).and(scene).for_each(|light, captured, scene| {
            if *captured >= from[channel] {
                *light = *scene;
            }
        });
    }
}

/// A lamp outside of a part as one of the whole capture, if it lies outside of that, next to what is kept of the part.
fn outside(lamp: LampOutside, [rows, columns]: [Span; 2], size: [usize; 2]) -> Option<LampOutside> {
    let position =
        [lamp.position[0] + rows.window_start as f64, lamp.position[1] + columns.window_start as f64];
    let nearest: [f64; 2] = std::array::from_fn(|axis| position[axis].clamp(0.0, (size[axis] - 1) as f64));
    let is_kept = [rows, columns]
        .iter()
        .zip(nearest)
        .all(|(span, nearest)| (span.start as f64..span.end as f64).contains(&nearest));
    let is_outside = position.iter().zip(size).any(|(at, side)| !(0.0..=(side - 1) as f64).contains(at));
    (is_outside && is_kept).then_some(LampOutside { position, ..lamp })
}

/// Adds what a part has to the planes of the whole, as far as it counts there.
fn add(planes: &mut Array3<f32>, part: &Array3<f32>, [rows, columns]: [Span; 2]) {
    let (_, height, width) = planes.dim();
    let (down, along) = (shares(rows, height), shares(columns, width));
    let (top, left) = (down.first - rows.window_start, along.first - columns.window_start);
    let part = part.slice(s![.., top..top + down.shares.len(), left..left + along.shares.len()]);
    let (last_row, last_column) = (down.first + down.shares.len(), along.first + along.shares.len());
    let mut planes = planes.slice_mut(s![.., down.first..last_row, along.first..last_column]);
    for (mut plane, part) in planes.outer_iter_mut().zip(part.outer_iter()) {
        for ((mut out, row), down) in plane.rows_mut().into_iter().zip(part.rows()).zip(&down.shares) {
            for ((out, value), along) in out.iter_mut().zip(row).zip(&along.shares) {
                *out += down * along * value;
            }
        }
    }
}

/// How much a part counts from a row or a column on.
struct Shares {
    first: usize,
    shares: Vec<f32>,
}

/// How much a part counts along one axis: those of all parts are one everywhere.
fn shares(span: Span, side: usize) -> Shares {
    let first = span.start.saturating_sub(BLEND_PX);
    let last = side.min(span.end + BLEND_PX);
    // The share of what begins at a boundary.
    let rise = |at: usize, boundary: usize| match boundary {
        0 => 1.0,
        _ if boundary == side => 0.0,
        #[expect(clippy::cast_precision_loss, reason = "a few pixels")]
        _ => {
            ((at + BLEND_PX) as f32 + 0.5 - boundary as f32).clamp(0.0, (2 * BLEND_PX) as f32)
                / (2 * BLEND_PX) as f32
        }
    };
    Shares { first, shares: (first..last).map(|at| rise(at, span.start) - rise(at, span.end)).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::{Boundary, Convolver};
    use crate::core::psf::Psf;
    use crate::core::rng::stream;
    use crate::restore::{Capture, KernelKnowledge, MemoryBudget};
    use rand_distr::{Distribution, StandardNormal};

    const SIZE: [usize; 2] = [680, 900];

    fn psf() -> Psf {
        let energy = Array3::from_shape_fn((CHANNELS, 33, 33), |(_, y, x)| {
            let squares = (y as f32 - 16.0).powi(2) + (x as f32 - 16.0).powi(2);
            let is_order = y.abs_diff(16) % 8 == 0 && x.abs_diff(16) % 8 == 0;
            (-squares / 0.8).exp() + if is_order { 4e-3 } else { 1e-5 } * (-squares.sqrt() / 9.0).exp()
        });
        Psf::from_energy(energy).unwrap()
    }

    /// Lamps near where parts meet, and a pattern of light.
    fn capture(psf: &Psf) -> LinearImage {
        let scene = Array3::from_shape_fn((CHANNELS, SIZE[0], SIZE[1]), |(channel, y, x)| match (y, x) {
            (340..343, 460..463) | (90..92, 600..603) => 300.0,
            _ if (y / 17 + x / 23) % 3 == channel => 0.9,
            _ => 0.2 + 0.1 * ((y as f32 / 9.0).sin() + (x as f32 / 7.0).cos()).abs(),
        });
        let convolver = Convolver::new(SIZE, [33, 33], Boundary::Zero).unwrap();
        let mut noise = stream(5, "noise");
        let mut seen = Array3::zeros(scene.dim());
        for (channel, mut seen) in seen.outer_iter_mut().enumerate() {
            let spectrum = convolver.kernel_spectrum(psf.channel(channel)).unwrap();
            seen.assign(&convolver.convolve_plane(scene.index_axis(Axis(0), channel), &spectrum));
            seen.mapv_inplace(|y: f32| {
                let normal: f32 = StandardNormal.sample(&mut noise);
                (y + 0.004 * (y.max(0.0) + 0.02).sqrt() * normal).clamp(0.0, 4.0)
            });
        }
        LinearImage::from_planes(seen).unwrap()
    }

    #[test]
    fn parts_make_the_whole() {
        let (psf, progress) = (psf(), Progress::default());
        let image = capture(&psf);
        let restored = |limit_bytes: u64| {
            let memory = MemoryBudget { limit_bytes, counts_process: false, queued_frames: 0 };
            let restoration =
                Restoration::guided(KernelKnowledge::of_psf(psf.clone())).unwrap().with_memory(memory);
            let plan = restoration.plan(SIZE).unwrap();
            assert!(plan.bytes <= limit_bytes, "{plan}");
            (restoration.restore(Capture::from(image.clone()), &progress).unwrap(), plan)
        };
        let (whole, plan) = restored(1 << 30);
        assert_eq!(plan.parts, None);
        let (joined, plan) = restored(plan.bytes * 7 / 10);
        assert!(plan.parts.is_some_and(|parts| parts.len() > 1));
        let positions = |lamps: &[crate::restore::Lamp]| -> Vec<[f64; 2]> {
            lamps.iter().map(|lamp| lamp.position.map(f64::round)).collect()
        };
        assert_eq!(positions(&joined.lamps), positions(&whole.lamps));
        assert_eq!(joined.levels, whole.levels);
        let [whole, joined] = [whole, joined].map(super::super::Restored::into_tone_mapped);
        let differences = Zip::from(&whole.planes()).and(&joined.planes()).map_collect(|a, b| (a - b).abs());
        let of_squares = differences.iter().map(|d| d * d).sum::<f32>() / differences.len() as f32;
        assert!(of_squares.sqrt() < 4e-3, "{}", of_squares.sqrt());
    }

    #[test]
    fn less_memory_than_the_smallest_parts_take_is_refused() {
        let memory = MemoryBudget { limit_bytes: 1 << 20, counts_process: true, queued_frames: 0 };
        let restoration = Restoration::guided(KernelKnowledge::of_psf(psf())).unwrap().with_memory(memory);
        let message = restoration.plan(SIZE).unwrap_err().to_string();
        let least = message.split("at least ").nth(1).expect("a smallest limit");
        let limit_bytes = crate::core::bytes::parse_bytes(least).unwrap();
        assert!(restoration.clone().with_memory(MemoryBudget { limit_bytes, ..memory }).plan(SIZE).is_ok());
        // Around a part it is not dark.
        let dark = restoration.with_border(Border::Zero).plan(SIZE).unwrap_err().to_string();
        assert!(dark.contains("max-memory"), "{dark}");
    }

    #[test]
    fn shares_of_all_parts_are_one() {
        for (side, tile) in [(200, 64), (130, 48), (97, 96), (500, 112), (64, 64)] {
            let mut sums = vec![0.0f32; side];
            for start in (0..side).step_by(tile) {
                let end = side.min(start + tile);
                let window_start = start.saturating_sub(80);
                let Shares { first, shares } =
                    shares(Span { start, end, window_start, window_end: side.min(end + 80) }, side);
                assert!(first >= window_start && shares.iter().all(|share| (0.0..=1.0).contains(share)));
                sums[first..first + shares.len()]
                    .iter_mut()
                    .zip(&shares)
                    .for_each(|(sum, share)| *sum += share);
            }
            assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-6), "{side} {tile}: {sums:?}");
        }
    }
}
