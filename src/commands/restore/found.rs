//! Tells what a restoration found in a capture: its light, its levels, the pose of its panel.

use std::path::Path;

use serde_json::{Map, Value, json};

use udc::core::saturation::saturated_from;
use udc::core::tone::ToneCurve;
use udc::io::{AnyImage, DomainTag, Format};
use udc::restore::{Capture, Lamp, PoseEstimate, Restored, saturates_about};

use super::Session;

/// Lamps that are told of: the brightest.
const TOLD_LAMPS: usize = 16;

/// The share of a capture's pixels from which on its being saturated is warned of.
const MUCH_SATURATED: f64 = 0.5;

/// Multiples of the level that a user tells above which light contradicts it: noise and shading are less.
const ABOVE: f32 = 1.25;

/// The share of a capture's values from which on such light is told of.
const MUCH_ABOVE: f64 = 1e-4;

/// Steps of stored light, as a part of it, that are told of.
const COARSE: f32 = 0.02;

/// Tells where the level that a user tells of a capture contradicts the file, which is believed, or the capture's light.
pub(super) fn tell_of_level(session: &Session, name: &str, capture: &Capture, x_max: Option<f32>) {
    let (AnyImage::Linear(image), Some(x_max)) = (&capture.image, x_max) else { return };
    let of_file = capture.info.as_ref().and_then(|info| info.saturation);
    let most = of_file.map(|levels| levels.into_iter().fold(0.0, f32::max));
    if let Some(most) = most.filter(|most| *most < saturated_from(x_max)) {
        session.warn(format_args!(
            "{name}: its file says that it saturates at {most}, which is taken; --x-max {x_max} is above that and changes nothing"
        ));
        return;
    }
    let above = image.as_slice().iter().filter(|light| **light > ABOVE * x_max).count();
    let share = above as f64 / image.as_slice().len() as f64;
    if share > MUCH_ABOVE && !saturates_about(image, x_max) {
        session.warn(format_args!(
            "{name}: {:.2} % of its light is above --x-max {x_max}, up to {}, and is taken for saturated; a capture that saturates there \
             has none: tell the light at which it saturates, or leave --x-max out",
            100.0 * share,
            image.max()
        ));
    }
}

/// Tells where a file of a domain, perhaps of half floats, holds the light of a capture in other units than networks know in steps that
/// are seen.
pub(super) fn tell_of_steps(
    session: &Session,
    output: &Path,
    restored: &Restored,
    (domain, is_half): (DomainTag, bool),
) {
    match domain {
        DomainTag::ToneMapped => tell_of_mapped_steps(session, output, restored, is_half),
        _ if is_half => tell_of_small_light(session, output, restored),
        _ => {}
    }
}

/// The same of half floats of linear light, which are coarse in small units.
fn tell_of_small_light(session: &Session, output: &Path, restored: &Restored) {
    /// Half floats lie this far apart from 6·10⁻⁵ down.
    const STEP: f32 = 1.0 / (1 << 24) as f32;
    let is_half =
        Format::of_extension(output).is_ok_and(|format| matches!(format, Format::Exr | Format::Npy));
    // Its α is about as bright as the scene.
    if let Some(alpha) = restored.alpha.filter(|alpha| is_half && STEP > COARSE * alpha) {
        session.warn(format_args!(
            "{}: its light is about {alpha:.1e}, which half floats hold in steps of {:.0} %: leave --half out",
            output.display(),
            100.0 * STEP / alpha
        ));
    }
}

/// The same of tone-mapped files.
fn tell_of_mapped_steps(session: &Session, output: &Path, restored: &Restored, is_half: bool) {
    let (curve, Some(alpha)) = (restored.curve, restored.alpha) else { return };
    let Ok(format) = Format::of_extension(output) else { return };
    // Its α is about as bright as the scene.
    let mapped = alpha / (alpha + curve.alpha);
    let step = match format {
        Format::Exr | Format::Npy if is_half => mapped / 2048.0,
        // A JPEG is a photograph.
        Format::Exr | Format::Npy | Format::Jpeg => return,
        Format::Hdr => mapped / 256.0,
        Format::Png | Format::Tiff => 1.0 / 65535.0,
    };
    let relative = step * (alpha + curve.alpha) / (curve.alpha * mapped);
    if relative > COARSE {
        session.warn(format_args!(
            "{}: its light is about {alpha:.3} and the tone curve's α {}, so that the file's tone-mapped values hold it in steps of {:.0} %: \
             write linear light, or tell --alpha {alpha:.3}",
            output.display(),
            curve.alpha,
            100.0 * relative
        ));
    }
}

/// Tells it of the capture of this name.
pub(super) fn tell(session: &Session, name: &str, restored: &Restored) {
    let Restored { lamps, lamps_outside, .. } = restored;
    let pose = restored.pose.as_ref().map(of_pose);
    let angle = restored.angle.as_ref();
    let angle = angle.map(|angle| json!({ "angle-deg": angle.angle_deg, "lead-nats": angle.lead }));
    let found = json!({
        "lamps": brightest(lamps), "lamps-in-all": lamps.len(), "lamps-outside": lamps_outside,
        "saturation": restored.levels, "relative-noise": restored.relative_noise, "pose": pose, "angle": angle,
        "lateral-colour": restored.lateral_colour, "contradiction": restored.contradiction, "unlike": restored.unlike,
        "floor": restored.floor, "empty-lines": restored.empty_lines,
    });
    session.found(name, found);
    if let Some(levels) = restored.describe_levels() {
        session.note(format_args!("{name}: {levels}"));
    }
    warn(session, name, restored);
    if restored.through_grey {
        session.note(format_args!(
            "{name}: its colours are the same everywhere; it is restored as grey, with the colours of the PSF weighed by their luminance"
        ));
    }
    if let Some([height, width]) = restored.smaller_windows {
        session.note(format_args!(
            "{name}: the device has memory for windows of {height} × {width} pixels, and no larger ones"
        ));
    }
    if let Some(pose) = &restored.pose {
        session.note(format_args!("{name}: the flare moves the PSF: {pose}"));
    }
    if let Some(lateral) = restored.lateral_colour {
        session.detail(format_args!("{name}: {lateral}"));
    }
    if let Some(noise) = restored.describe_noise() {
        session.detail(format_args!("{name}: {noise}"));
    }
    for lamp in brightest(lamps) {
        session.detail(format_args!("{name}: {lamp}"));
    }
    if let Some(more) = lamps.len().checked_sub(TOLD_LAMPS).filter(|more| *more > 0) {
        let lamps = if more == 1 { "lamp" } else { "lamps" };
        session.detail(format_args!("{name}: {more} fainter {lamps}"));
    }
    for lamp in lamps_outside {
        session.detail(format_args!("{name}: {lamp}"));
    }
}

/// Warns of what may spoil it.
fn warn(session: &Session, name: &str, restored: &Restored) {
    let saturated = restored.lamps.iter().map(|lamp| lamp.pixels).sum::<usize>() as f64;
    let share = saturated / restored.image.size().into_iter().product::<usize>() as f64;
    if share > MUCH_SATURATED {
        session.warn(format_args!(
            "{name}: {:.0} % of its pixels are saturated, and what is there is guessed; expose for a shorter time, or fuse a bracket",
            100.0 * share
        ));
    }
    if let Some(doubt) = restored.doubt() {
        session.warn(format_args!("{name}: {doubt}"));
    }
    if let Some(lines) = &restored.empty_lines {
        session.warn(format_args!("{name}: {lines}"));
    }
    if let Some(floor) = &restored.floor {
        session.warn(format_args!("{name}: {floor}"));
    }
    if let Some(doubt) = &restored.doubted_noise {
        session.warn(format_args!("{name}: {doubt}"));
    }
    if let Some(doubt) = restored.doubt_psf() {
        session.warn(format_args!("{name}: {doubt}"));
    }
}

/// What stays with the image, in its provenance, if anything does; `curve` is what is said of its tone mapping beforehand, and
/// `is_mapped` whether it is written tone-mapped.
pub(super) fn lasting(restored: &Restored, curve: ToneCurve, is_mapped: bool) -> Option<Value> {
    let mut found = Map::new();
    // Of a capture with brighter light, which the curve that was said would cut where the image is mapped or shown; and of one that is
    // mapped, where the curve's end is that of the light.
    if restored.curve.x_max > curve.x_max || is_mapped && restored.curve != curve {
        found.insert("tone".to_owned(), json!(restored.curve));
    }
    if let Some(alpha) = restored.alpha {
        found.insert("alpha".to_owned(), json!(alpha));
    }
    if let Some(levels) = restored.levels {
        found.insert("saturation".to_owned(), json!(levels));
    }
    if let Some(noise) = restored.relative_noise {
        found.insert("relative-noise".to_owned(), json!(noise));
    }
    if let Some(pose) = &restored.pose {
        found.insert("pose".to_owned(), of_pose(pose));
    }
    if !restored.lamps.is_empty() {
        found.insert("lamps".to_owned(), json!(brightest(&restored.lamps)));
    }
    if !restored.lamps_outside.is_empty() {
        found.insert("lamps-outside".to_owned(), json!(restored.lamps_outside));
    }
    (!found.is_empty()).then(|| found.into())
}

fn of_pose(pose: &PoseEstimate) -> Value {
    json!({
        "turn-deg": pose.turn_deg, "scale": pose.scale, "turn-sigma-deg": pose.turn_sigma_deg, "scale-sigma": pose.scale_sigma,
    })
}

fn brightest(lamps: &[Lamp]) -> &[Lamp] {
    &lamps[..lamps.len().min(TOLD_LAMPS)]
}
