//! Tells what a TOML file configures, by the keys that each kind of file has.

use std::path::Path;

use anyhow::{Context as _, Result, anyhow};
use serde_json::{Value, json};

use udc::core::config::parse_toml;
use udc::dataset::SensorConfig;
use udc::io::{read_field, read_text};
use udc::psf::DisplayConfig;
use udc::train::TrainConfig;

/// What a file is, for scripts and for people.
pub(super) fn examine(file: &Path) -> Result<(Value, String)> {
    let text = read_text(file)?;
    // What is no TOML at all is told as what most of these files are.
    let table: toml::Table = parse_toml(&text).unwrap_or_default();
    let has = |keys: &[&str]| keys.iter().any(|key| table.contains_key(*key));
    if has(&["display", "optics", "spectrum", "sampling", "sensor"]) {
        return examine_display(file, &text);
    }
    if has(&["psfs"]) {
        let (grid, _) = read_field(file)?;
        let object = json!({"kind": "psf-field", "rows": grid.rows(), "columns": grid.columns()});
        let text = format!("PSFs of {} × {} places of the frame, for --field", grid.rows(), grid.columns());
        return Ok((object, text));
    }
    if has(&["full-well-e", "read-noise-e", "white-irradiance", "electrons-per-unit"]) {
        let sensor: SensorConfig =
            parse_toml(&text).map_err(|reason| anyhow!("{}: {reason}", file.display()))?;
        let (white, x_max) = (sensor.white_irradiance(), sensor.saturation());
        let object = json!({"kind": "sensor", "sensor": sensor, "white_irradiance": white, "x_max": x_max});
        let text = format!(
            "sensor, for --noise sensor:{}: full at an irradiance of {white:.4} in the longest exposure and of {x_max:.4} \
             (x-max) in the shortest\n{}",
            file.display(),
            text.trim_end()
        );
        return Ok((object, text));
    }
    examine_training(file, &text)
}

fn examine_display(file: &Path, text: &str) -> Result<(Value, String)> {
    let config = DisplayConfig::parse(text, file)?;
    let (kind, size) = (config.display.kind.name(), config.sensor.size_px);
    let text =
        format!("display file, for `udc psf --display`: layout {kind}, a PSF of {size} × {size} pixels");
    Ok((json!({"kind": "display", "display": config}), text))
}

/// Describes the network that a training's configuration asks for.
fn examine_training(file: &Path, text: &str) -> Result<(Value, String)> {
    let config = TrainConfig::from_toml(text, &[])
        .with_context(|| format!("reading {} as a training's configuration", file.display()))?;
    let architecture = config.architecture;
    let object = json!({
        "kind": "training-configuration",
        "architecture": architecture.to_json(),
        "parameters": architecture.parameters(),
        "macs_800": architecture.macs(800, 800),
    });
    Ok((object, format!("training configuration\n{}", architecture.describe())))
}
