//! Turns values out of range, and keys that do not fit together, into errors that name the key.

use crate::core::error::{Error, Result};

use crate::psf::MAX_SIZE_PX;

use super::{DisplayConfig, IrregularityConfig, LayoutConfig, LayoutKind, RegionConfig, SpectrumConfig};

impl DisplayConfig {
    /// Makes sure that every value is in its range and belongs to the kind of layout.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key.
    pub fn check(&self) -> Result<()> {
        require("sensor.pixel-pitch-um", self.sensor.pixel_pitch_um, is_positive, "a positive length")?;
        if !(1..=MAX_SIZE_PX).contains(&self.sensor.size_px) {
            let reason = format!("must be between 1 and {MAX_SIZE_PX}, found {}", self.sensor.size_px);
            return Err(Error::config("sensor.size-px", reason));
        }
        self.spectrum.check()?;
        self.display.check()
    }
}

impl SpectrumConfig {
    fn check(&self) -> Result<()> {
        for (name, lines) in ["red", "green", "blue"].into_iter().zip(self.channels()) {
            let key = format!("spectrum.{name}");
            for &(wavelength_nm, weight) in lines {
                require(
                    &key,
                    wavelength_nm,
                    |v| (100.0..=20_000.0).contains(&v),
                    "wavelengths in nanometres",
                )?;
                require(&key, weight, |v| v.is_finite() && v >= 0.0, "weights from 0 up")?;
            }
            if lines.iter().map(|(_, weight)| weight).sum::<f64>() <= 0.0 {
                let reason = "needs at least one [wavelength nm, weight] pair of positive weight";
                return Err(Error::config(key, reason));
            }
        }
        Ok(())
    }
}

impl LayoutConfig {
    fn check(&self) -> Result<()> {
        require("display.angle-deg", self.angle_deg, f64::is_finite, "an angle in degrees")?;
        for offset in self.offset_um {
            require("display.offset-um", offset, f64::is_finite, "a length in micrometres")?;
        }
        self.check_kind()?;
        if let Some(pitch) = self.pitch_um {
            require("display.pitch-um", pitch, is_positive, "a positive length")?;
        }
        if let Some(size) = self.pixel_size_um {
            require("display.pixel-size-um", size, is_positive, "a positive length")?;
        }
        if let Some(background) = self.background_transmittance {
            require_transmittance("display.background-transmittance", background)?;
        }
        let pitch_um = self.pitch_um.unwrap_or(f64::INFINITY);
        // What lies further off is another pixel's: a mistake in the unit, or of another panel.
        let is_place = |v: f64| v.is_finite() && v.abs() <= pitch_um;
        let place = "a length of at most one pitch";
        for (name, region) in [("red", &self.red), ("green", &self.green), ("blue", &self.blue)] {
            if let Some(region) = region {
                region.check(&format!("display.{name}"), pitch_um)?;
            }
        }
        for opening in &self.openings {
            opening.region().check("display.openings", pitch_um)?;
            require("display.openings.x-um", opening.x_um, is_place, place)?;
            require("display.openings.y-um", opening.y_um, is_place, place)?;
        }
        for line in &self.wiring {
            require("display.wiring.position-um", line.position_um, is_place, place)?;
            let fits = |v: f64| is_positive(v) && v <= pitch_um;
            require(
                "display.wiring.width-um",
                line.width_um,
                fits,
                "a positive length of at most one pitch",
            )?;
            require_transmittance("display.wiring.transmittance", line.transmittance)?;
        }
        self.irregularity.map_or(Ok(()), |irregularity| irregularity.check(self.kind))
    }

    /// Refuses keys that the kind of layout would ignore, and asks for those that it needs.
    fn check_kind(&self) -> Result<()> {
        let panel = matches!(self.kind, LayoutKind::Pentile | LayoutKind::Stripe);
        let image = self.kind == LayoutKind::Image;
        let keys = [
            ("pitch-um", self.pitch_um.is_some(), panel),
            ("background-transmittance", self.background_transmittance.is_some(), panel),
            ("red", self.red.is_some(), panel),
            ("green", self.green.is_some(), panel),
            ("blue", self.blue.is_some(), panel),
            ("openings", !self.openings.is_empty(), panel),
            ("wiring", !self.wiring.is_empty(), panel),
            ("irregularity", self.irregularity.is_some(), panel),
            ("file", self.file.is_some(), image),
            ("pixel-size-um", self.pixel_size_um.is_some(), image),
            ("grey", self.grey.is_some(), image),
        ];
        if let Some((key, ..)) = keys.iter().find(|(_, present, allowed)| *present && !allowed) {
            let reason = format!("a layout of kind \"{}\" has no such key; remove it", self.kind.name());
            return Err(Error::config(format!("display.{key}"), reason));
        }
        let needed: &[usize] = match self.kind {
            LayoutKind::None => &[],
            LayoutKind::Pentile | LayoutKind::Stripe => &[0],
            LayoutKind::Image => &[8, 9],
        };
        match needed.iter().map(|&index| keys[index]).find(|(_, present, _)| !present) {
            Some((key, ..)) => {
                let reason = format!("a layout of kind \"{}\" needs this key", self.kind.name());
                Err(Error::config(format!("display.{key}"), reason))
            }
            None => Ok(()),
        }
    }
}

/// The most pixels along a side of what repeats: more would be drawn too coarsely.
const MOST_PIXELS: usize = 16;

impl IrregularityConfig {
    fn check(&self, kind: LayoutKind) -> Result<()> {
        let key = "display.irregularity";
        let fits = (2..=MOST_PIXELS).contains(&self.pixels);
        if !fits || (kind == LayoutKind::Pentile && self.pixels % 2 == 1) {
            let even = if kind == LayoutKind::Pentile { " and even, as red and blue alternate" } else { "" };
            let reason = format!("must be from 2 to {MOST_PIXELS}{even}, found {}", self.pixels);
            return Err(Error::config(format!("{key}.pixels"), reason));
        }
        let is_jitter = |v: f64| v.is_finite() && v >= 0.0;
        require(&format!("{key}.jitter-um"), self.jitter_um, is_jitter, "a length from 0 up")?;
        let is_spread = |v: f64| (0.0..1.0).contains(&v);
        require(&format!("{key}.size-spread"), self.size_spread, is_spread, "from 0 to below 1")
    }
}

impl RegionConfig {
    fn check(&self, key: &str, pitch_um: f64) -> Result<()> {
        for (name, extent) in [("width-um", self.width_um), ("height-um", self.height_um)] {
            let fits = |v: f64| is_positive(v) && v <= pitch_um;
            require(&format!("{key}.{name}"), extent, fits, "a positive length of at most one pitch")?;
        }
        let radius = self.width_um.min(self.height_um) / 2.0;
        let rounds = |v: f64| (0.0..=radius).contains(&v);
        require(&format!("{key}.corner-um"), self.corner_um, rounds, "at most half the shorter side")?;
        require_transmittance(&format!("{key}.transmittance"), self.transmittance)
    }
}

fn is_positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

fn require_transmittance(key: &str, value: f64) -> Result<()> {
    require(key, value, |v| (0.0..=1.0).contains(&v), "a factor from 0 to 1 on the field")
}

fn require(key: &str, value: f64, in_range: impl Fn(f64) -> bool, range: &str) -> Result<()> {
    if in_range(value) { Ok(()) } else { Err(Error::config(key, format!("must be {range}, found {value}"))) }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn parse(text: &str) -> Result<DisplayConfig> {
        DisplayConfig::parse(text, Path::new("panels/panel.toml"))
    }

    #[test]
    fn an_empty_file_is_the_bare_lens_of_the_defaults() {
        assert_eq!(parse("").unwrap(), DisplayConfig::default());
    }

    #[test]
    fn names_the_line_of_an_unknown_key() {
        let message = parse("[optics]\nfocal-lenght-mm = 3.8\n").unwrap_err().to_string();
        assert!(message.contains("line 2") && message.contains("focal-lenght-mm"), "{message}");
    }

    #[test]
    fn refuses_a_key_of_another_kind_and_asks_for_missing_ones() {
        let foreign = parse("[display]\nkind = \"none\"\npitch-um = 60\n").unwrap_err().to_string();
        assert!(foreign.contains("display.pitch-um") && foreign.contains("\"none\""), "{foreign}");
        let missing = parse("[display]\nkind = \"image\"\nfile = \"a.png\"\n").unwrap_err().to_string();
        assert!(missing.contains("display.pixel-size-um"), "{missing}");
    }

    #[test]
    fn finds_pictures_beside_the_file() {
        let text = "[display]\nkind = \"image\"\nfile = \"a.png\"\npixel-size-um = 1\n";
        assert_eq!(parse(text).unwrap().display.file.unwrap(), Path::new("panels/a.png"));
    }

    #[test]
    fn refuses_values_out_of_range() {
        for text in [
            "[sensor]\nsize-px = 0\n",
            "[sensor]\npixel-pitch-um = -1\n",
            "[spectrum]\nred = []\n",
            "[spectrum]\nred = [[0.61, 1.0]]\n",
            "[display]\nkind = \"stripe\"\npitch-um = 60\nbackground-transmittance = 1.5\n",
            "[display]\nkind = \"none\"\nirregularity = { pixels = 4 }\n",
            "[display]\nkind = \"stripe\"\npitch-um = 60\nirregularity = { pixels = 1 }\n",
            "[display]\nkind = \"stripe\"\npitch-um = 60\nirregularity = { pixels = 17 }\n",
            "[display]\nkind = \"pentile\"\npitch-um = 60\nirregularity = { pixels = 5 }\n",
            "[display]\nkind = \"stripe\"\npitch-um = 60\nirregularity = { pixels = 4, jitter-um = -1 }\n",
            "[display]\nkind = \"stripe\"\npitch-um = 60\nirregularity = { pixels = 4, size-spread = 1 }\n",
        ] {
            assert!(matches!(parse(text), Err(Error::Config { .. })), "{text}");
        }
    }

    #[test]
    fn lines_and_openings_lie_within_a_pitch() {
        let panel = |more: &str| parse(&format!("[display]\nkind = \"stripe\"\npitch-um = 60\n{more}"));
        let line = |position: f64, width: f64| {
            panel(&format!(
                "[[display.wiring]]\ndirection = \"vertical\"\nposition-um = {position}\nwidth-um = {width}\n"
            ))
        };
        line(-30.0, 60.0).unwrap();
        for (found, key) in [(line(0.0, 61.0), "width-um"), (line(-61.0, 4.0), "position-um")] {
            let said = found.unwrap_err().to_string();
            assert!(said.contains(&format!("display.wiring.{key}")) && said.contains("one pitch"), "{said}");
        }
        let opening = "[[display.openings]]\nx-um = 90\nshape = \"ellipse\"\nwidth-um = 9\nheight-um = 9\n\
            transmittance = 1\n";
        assert!(panel(opening).unwrap_err().to_string().contains("display.openings.x-um"));
    }

    #[test]
    fn numbers_too_many_are_refused_where_they_stand() {
        let message = parse("[spectrum]\nred = [[610.0, 1.0, 7.0]]\n").unwrap_err().to_string();
        assert!(message.contains("line 2") && message.contains("found 3 numbers"), "{message}");
        let message = parse("[display]\noffset-um = [1, 2, 3]\n").unwrap_err().to_string();
        assert!(message.contains("found 3"), "{message}");
    }

    #[test]
    fn a_wavelength_that_two_channels_see_is_listed_once() {
        let text = "[spectrum]\nred = [[600, 1], [570, 0.5], [640, 0]]\ngreen = [[530, 1], [570, 0.25]]\n";
        let lines = parse(text).unwrap().spectrum.lines();
        assert_eq!(lines.len(), 4);
        assert!(lines.contains(&(570.0, [0.5, 0.25, 0.0])));
    }

    #[test]
    fn the_resolved_configuration_reads_back() {
        let config = DisplayConfig::default();
        assert_eq!(parse(&toml::to_string(&config).unwrap()).unwrap(), config);
    }
}
