//! Tells people of an image, with what its file says of the capture.

use std::fmt::{self, Write as _};

use super::ImageDescription;
use crate::core::camera_color::CameraColor;
use crate::core::capture::CaptureInfo;
use crate::core::exif::Exif;
use crate::core::primaries::Primaries;
use crate::inspect::layers::write_layers;
use crate::inspect::text::{number, write_lines};
use crate::io::RawMetadata;

impl fmt::Display for ImageDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_lines(f, |text| write_image(text, self))
    }
}

fn write_image(text: &mut String, image: &ImageDescription) -> fmt::Result {
    let channels = image.channels.len();
    let plural = if channels == 1 { "" } else { "s" };
    writeln!(
        text,
        "{} image, {} × {} (width × height), {channels} channel{plural} of {}",
        image.format, image.width, image.height, image.sample_type
    )?;
    write_layers(text, &image.layers)?;
    writeln!(text, "  domain    {}", image.domain.unwrap_or("not declared"))?;
    for tag in &image.color_tags {
        writeln!(text, "  colours   {tag}")?;
    }
    for doubt in &image.doubts {
        writeln!(text, "  warning   {doubt}")?;
    }
    if let Some(seconds) = image.exposure_s {
        writeln!(text, "  exposure  {} s", number(seconds))?;
    }
    if let Some(iso) = image.iso {
        writeln!(text, "  ISO       {}", number(iso))?;
    }
    if let Some(raw) = &image.raw {
        write_raw(text, raw)?;
    }
    if let Some(capture) = &image.capture {
        write_capture(text, capture)?;
    }
    writeln!(
        text,
        "  channel {:>10} {:>10} {:>10} {:>10} {:>10} {:>10} {:>10}",
        "min", "1 %", "median", "99 %", "99.9 %", "max", "mean"
    )?;
    for (index, s) in image.channels.iter().enumerate() {
        write!(text, "  {:<7}", channel_name(channels, index))?;
        for value in [s.min, s.percentile_1, s.median, s.percentile_99, s.percentile_99_9, s.max] {
            write!(text, " {:>10}", number(f64::from(value)))?;
        }
        writeln!(text, " {:>10}", number(s.mean))?;
    }
    if image.non_finite > 0 {
        writeln!(text, "  {} values are NaN or infinite", image.non_finite)?;
    }
    if image.negative > 0 {
        writeln!(text, "  {} values are negative", image.negative)?;
    }
    if let Some(provenance) = &image.provenance {
        writeln!(text, "  made by   {} {} {}", provenance.program, provenance.command, provenance.config)?;
    }
    Ok(())
}

fn write_raw(text: &mut String, raw: &RawMetadata) -> fmt::Result {
    if let Some(pattern) = raw.bayer {
        writeln!(text, "  mosaic    {}", format!("{pattern:?}").to_uppercase())?;
    }
    writeln!(text, "  levels    black {}, white {}", number(raw.black), number(raw.white))?;
    if let Some([red, green, blue]) = raw.white_balance {
        writeln!(text, "  gains     {} {} {}", number(red), number(green), number(blue))?;
    }
    if !raw.orientation.is_upright() {
        writeln!(text, "  lies      {}", raw.orientation)?;
    }
    if let (Some(color), Some(gains)) = (&raw.color, raw.white_balance) {
        write_color(text, color, gains)?;
    }
    if let Some(stops) = raw.baseline_exposure_ev {
        writeln!(text, "  baseline  {stops:+.2} stops")?;
    }
    if !raw.corrections.is_empty() {
        writeln!(text, "  corrected {}", raw.corrections.join(", "))?;
    }
    if let Some(exif) = &raw.exif {
        write_exif(text, exif)?;
    }
    let ignored = raw.ignored.iter().map(|opcode| match opcode.optional {
        true => format!("{} (optional)", opcode.name),
        false => opcode.name.clone(),
    });
    let ignored: Vec<String> = ignored.collect();
    if !ignored.is_empty() {
        writeln!(text, "  ignored   {}", ignored.join(", "))?;
    }
    Ok(())
}

/// What an image says of its capture.
fn write_capture(text: &mut String, capture: &CaptureInfo) -> fmt::Result {
    if let Some(levels) = capture.saturation {
        let [red, green, blue] = levels.map(|level| number(f64::from(level)));
        writeln!(text, "  clips at  {red} {green} {blue}")?;
    }
    if let Some(orientation) = capture.orientation.filter(|orientation| !orientation.is_upright()) {
        writeln!(text, "  lies      {orientation}")?;
    }
    if let (Some(color), Some(gains)) = (&capture.color, capture.white_balance) {
        write_color(text, color, gains)?;
    }
    if let Some(stops) = capture.baseline_exposure_ev {
        writeln!(text, "  baseline  {stops:+.2} stops")?;
    }
    if let Some(primaries) = &capture.primaries {
        write_primaries(text, primaries)?;
    }
    capture.exif.as_ref().map_or(Ok(()), |exif| write_exif(text, exif))
}

fn write_primaries(text: &mut String, primaries: &Primaries) -> fmt::Result {
    let Primaries { red, green, blue, white } = *primaries;
    let place = |[x, y]: [f64; 2]| format!("{x:.4} {y:.4}");
    let name = primaries.name().map_or(String::new(), |name| format!("{name}: "));
    let [red, green, blue, white] = [red, green, blue, white].map(place);
    writeln!(text, "  primaries {name}red {red}, green {green}, blue {blue}, white {white}")
}

/// The camera, the exposure, when and where, as far as they are said.
fn write_exif(text: &mut String, exif: &Exif) -> fmt::Result {
    let mut said: Vec<String> =
        [&exif.make, &exif.model, &exif.lens, &exif.taken].into_iter().flatten().cloned().collect();
    let seconds = |seconds: f64| match seconds < 0.5 {
        true => format!("1/{:.0} s", 1.0 / seconds),
        false => format!("{} s", number(seconds)),
    };
    said.extend(exif.exposure_s.map(seconds));
    said.extend(exif.f_number.map(|number| format!("f/{number:.1}")));
    said.extend(exif.iso.map(|iso| format!("ISO {iso:.0}")));
    said.extend(exif.focal_length_mm.map(|length| format!("{length:.1} mm")));
    let place = exif.position.as_ref();
    said.extend(place.map(|place| format!("at {:.5}° {:.5}°", place.latitude_deg, place.longitude_deg)));
    writeln!(text, "  camera    {}", said.join(", "))
}

/// The light that gains stand for, and the matrix to linear sRGB.
fn write_color(text: &mut String, color: &CameraColor, gains: [f64; 3]) -> fmt::Result {
    if let Some(kelvin) = color.temperature_k(gains) {
        writeln!(text, "  light     {kelvin:.0} K")?;
    }
    match color.matrix(gains) {
        None => writeln!(text, "  matrix    none: the file's matrices describe no camera"),
        Some(rows) => rows.iter().enumerate().try_for_each(|(index, [red, green, blue])| {
            let name = if index == 0 { "matrix" } else { "" };
            writeln!(text, "  {name:<9} {red:>8.4} {green:>8.4} {blue:>8.4}")
        }),
    }
}

fn channel_name(channels: usize, index: usize) -> &'static str {
    match channels {
        1 => "Y",
        3 => ["R", "G", "B"][index],
        _ => ["1", "2", "3", "4"][index.min(3)],
    }
}
