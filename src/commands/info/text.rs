//! Renders descriptions for people.

use std::fmt::Write;

use udc::core::camera_color::CameraColor;
use udc::core::capture::CaptureInfo;
use udc::io::{
    ArrayDescription, BankDescription, FileDescription, ImageDescription, ModelDescription, PsfDescription,
    RawMetadata,
};

/// Lines of text without a newline at the end.
pub(super) fn render(description: &FileDescription) -> String {
    let mut text = String::new();
    match description {
        FileDescription::Image(image) => render_image(&mut text, image),
        FileDescription::Psf(psf) => render_psf(&mut text, psf),
        FileDescription::KernelBank(bank) => render_bank(&mut text, bank),
        FileDescription::Model(model) => render_model(&mut text, model),
        FileDescription::Array(array) => render_array(&mut text, array),
    }
    .expect("writing to a string succeeds");
    text.trim_end().to_owned()
}

fn render_image(text: &mut String, image: &ImageDescription) -> std::fmt::Result {
    let channels = image.channels.len();
    let plural = if channels == 1 { "" } else { "s" };
    writeln!(
        text,
        "{} image, {} × {} (width × height), {channels} channel{plural} of {}",
        image.format, image.width, image.height, image.sample_type
    )?;
    writeln!(text, "  domain    {}", image.domain.unwrap_or("not declared"))?;
    for tag in &image.color_tags {
        writeln!(text, "  colours   {tag}")?;
    }
    if let Some(seconds) = image.exposure_s {
        writeln!(text, "  exposure  {} s", number(seconds))?;
    }
    if let Some(iso) = image.iso {
        writeln!(text, "  ISO       {}", number(iso))?;
    }
    if let Some(raw) = &image.raw {
        render_raw(text, raw)?;
    }
    if let Some(capture) = &image.capture {
        render_capture(text, capture)?;
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

fn render_raw(text: &mut String, raw: &RawMetadata) -> std::fmt::Result {
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
        render_color(text, color, gains)?;
    }
    if let Some(stops) = raw.baseline_exposure_ev {
        writeln!(text, "  baseline  {stops:+.2} stops")?;
    }
    if !raw.corrections.is_empty() {
        writeln!(text, "  corrected {}", raw.corrections.join(", "))?;
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
fn render_capture(text: &mut String, capture: &CaptureInfo) -> std::fmt::Result {
    if let Some(levels) = capture.saturation {
        let [red, green, blue] = levels.map(|level| number(f64::from(level)));
        writeln!(text, "  clips at  {red} {green} {blue}")?;
    }
    if let Some(orientation) = capture.orientation.filter(|orientation| !orientation.is_upright()) {
        writeln!(text, "  lies      {orientation}")?;
    }
    if let (Some(color), Some(gains)) = (&capture.color, capture.white_balance) {
        render_color(text, color, gains)?;
    }
    if let Some(stops) = capture.baseline_exposure_ev {
        writeln!(text, "  baseline  {stops:+.2} stops")?;
    }
    Ok(())
}

/// The light that gains stand for, and the matrix to linear sRGB.
fn render_color(text: &mut String, color: &CameraColor, gains: [f64; 3]) -> std::fmt::Result {
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

fn render_psf(text: &mut String, psf: &PsfDescription) -> std::fmt::Result {
    writeln!(text, "PSF, {} × {} (width × height)", psf.width, psf.height)?;
    writeln!(text, "  centre    row {}, column {}", psf.centre.0, psf.centre.1)?;
    for (channel, name) in psf.channels.iter().zip(["R", "G", "B"]) {
        writeln!(
            text,
            "  {name}         peak {} at row {}, column {}; half of the energy within {:.1} px, 90 % within {:.1} px",
            number(f64::from(channel.peak)),
            channel.peak_at.0,
            channel.peak_at.1,
            channel.radius_50_px,
            channel.radius_90_px
        )?;
    }
    for warning in &psf.warnings {
        writeln!(text, "  warning   {warning}")?;
    }
    writeln!(text, "  sha256    {}", psf.sha256)
}

fn render_bank(text: &mut String, bank: &BankDescription) -> std::fmt::Result {
    writeln!(
        text,
        "kernel bank, {} PSFs of {} × {} (width × height), codes of {}",
        bank.kernels, bank.width, bank.height, bank.code_dim
    )?;
    let shares: Vec<String> =
        bank.explained_share.iter().map(|share| format!("{:.2} %", share * 100.0)).collect();
    let sum: f64 = bank.explained_share.iter().sum();
    writeln!(text, "  variance  {} ({:.2} % together)", shares.join(", "), sum * 100.0)?;
    for (index, code) in bank.codes.iter().enumerate() {
        let name = match &bank.angles_deg {
            Some(angles) => format!("{:+}°", angles[index]),
            None => format!("#{}", index + 1),
        };
        let code: Vec<String> =
            code.iter().map(|&value| format!("{:>10}", number(f64::from(value)))).collect();
        writeln!(text, "  code {name:<5}{}", code.join(" "))?;
    }
    if let Some(rotation) = bank.origin.as_ref().and_then(|origin| origin["rotation"].as_str()) {
        writeln!(text, "  rotation  by {rotation}")?;
    }
    writeln!(text, "  sha256    {}", bank.sha256)
}

fn render_model(text: &mut String, model: &ModelDescription) -> std::fmt::Result {
    writeln!(text, "safetensors, {} tensors, {} parameters", model.tensors, model.parameters)?;
    for (key, value) in &model.metadata {
        let value = value.as_str().map_or_else(|| value.to_string(), ToOwned::to_owned);
        writeln!(text, "  {key:<9} {value}")?;
    }
    Ok(())
}

fn render_array(text: &mut String, array: &ArrayDescription) -> std::fmt::Result {
    writeln!(text, "NumPy array {:?}, from {} to {}", array.shape, number(array.min), number(array.max))?;
    if let Some(values) = &array.values {
        let values: Vec<String> = values.iter().map(|&value| number(value)).collect();
        writeln!(text, "  {}", values.join(" "))?;
    }
    Ok(())
}

/// Four significant digits, with an exponent where the number would be long.
fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if !(1e-3..1e5).contains(&size) {
        format!("{value:.3e}")
    } else if size >= 1000.0 {
        format!("{value:.0}")
    } else if size >= 1.0 {
        format!("{value:.3}")
    } else {
        format!("{value:.5}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stay_short() {
        let found: Vec<String> = [0.0, 0.25, -3.0, 12345.6, 1e-9, 2e8, f64::NAN].map(number).into();
        assert_eq!(found, ["0", "0.25000", "-3.000", "12346", "1.000e-9", "2.000e8", "NaN"]);
    }
}
